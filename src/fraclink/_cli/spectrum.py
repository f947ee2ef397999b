"""The verb identify-spectrum: modes from a table of gain and phase."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from fraclink._cli.console import emit, emit_json, table
from fraclink._cli.options import Json
from fraclink._cli.outcome import HOLDS

__all__ = ["register"]


def identify_spectrum(
    response: Annotated[
        Path,
        typer.Argument(
            metavar="TABLE",
            help="Table with frequency_rad_s or frequency_Hz, gain or gain_dB, phase_rad or phase_deg.",
        ),
    ],
    resonances: Annotated[int, typer.Option("--resonances", min=1, max=6, help="Number of resonances.")] = 1,
    anti_resonances: Annotated[
        int, typer.Option("--anti-resonances", min=0, max=6, help="Number of anti-resonances.")
    ] = 0,
    json: Json = False,
) -> int:
    """Fit modes with one common λ to a table of gain and phase; a column `coherence` is used."""
    from fraclink._identify import identify_frequency_response
    from fraclink._logs import read_columns

    columns = read_columns(response)
    frequency = _one_of(columns, {"frequency_rad_s": 1.0, "frequency_Hz": 2 * np.pi})
    decibel = "gain_dB" in columns and "gain" not in columns
    level = _one_of(columns, {"gain": 1.0, "gain_dB": 1.0})
    phase = _one_of(columns, {"phase_rad": 1.0, "phase_deg": np.pi / 180})
    gain = 10 ** (level / 20) if decibel else level
    fit = identify_frequency_response(
        frequency,
        gain * np.exp(1j * phase),
        coherence=columns.get("coherence"),
        resonances=resonances,
        anti_resonances=anti_resonances,
    )
    told = {
        "order": fit.order,
        "resonances": list(fit.resonances),
        "anti_resonances": list(fit.anti_resonances),
        "gain": fit.gain,
        "delay": fit.delay,
        "fit_percent": fit.fit,
        "outliers": [float(frequency[k]) for k in fit.outliers],
        "standard_errors": fit.standard_errors,
    }
    if json:
        emit_json(told)
        return HOLDS
    errors = fit.standard_errors
    rows = [("λ", f"{fit.order:.5f}", f"± {errors.get('order', 0.0):.2g}")]
    rows += [
        (f"resonance {i + 1} [rad/s]", f"{w:.5g}", f"± {errors[f'resonance {i + 1}']:.2g}")
        for i, w in enumerate(fit.resonances)
    ]
    rows += [
        (f"anti-resonance {i + 1} [rad/s]", f"{w:.5g}", f"± {errors[f'anti-resonance {i + 1}']:.2g}")
        for i, w in enumerate(fit.anti_resonances)
    ]
    rows += [
        ("delay [ms]", f"{1e3 * fit.delay:.4g}", f"± {1e3 * errors.get('delay', 0.0):.2g}"),
        ("gain", f"{fit.gain:.5g}", ""),
        ("fit [%]", f"{fit.fit:.2f}", ""),
    ]
    emit(table(("frequency response", "value", "error"), rows))
    if fit.outliers:
        emit("set aside: " + ", ".join(f"{frequency[k]:.4g} rad/s" for k in fit.outliers))
    return HOLDS


def _one_of(columns: Mapping[str, NDArray[np.float64]], scales: Mapping[str, float]) -> NDArray[np.float64]:
    """The first column that is there, in SI units."""
    from fraclink.errors import LogError

    for name, scale in scales.items():
        if name in columns:
            return np.asarray(columns[name] * scale, dtype=np.float64)
    raise LogError(
        "column",
        ", ".join(columns),
        "without one that is needed",
        allowed=" or ".join(scales),
        remedy="rename it in the table's header",
    )


def register(app: typer.Typer) -> None:
    """Add the verb of this module to the application."""
    app.command(name="identify-spectrum")(identify_spectrum)
