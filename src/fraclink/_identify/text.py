"""A fit and a comparison in a few lines, as `print` shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from fraclink._arm.link import structure

if TYPE_CHECKING:
    from fraclink._identify.comparison import Comparison
    from fraclink._identify.fit import Fit

__all__ = ["SYMBOLS", "coincidence_text", "comparison_text", "fit_text", "frequency_text"]

SYMBOLS = {
    "natural_frequency": ("ω₀", "s^(-λ/2)"),
    "order": ("λ", ""),
    "damping": ("μ", "s^(α-λ)"),
    "damping_order": ("α", ""),
}


def _share(value: float | None) -> str:
    return "nothing held out" if value is None else f"held-out error {100 * value:.3g} %"


def _parameters(fit: Fit) -> str:
    """Every free parameter with its standard error, in its unit."""
    told = []
    for name in structure(fit.structure).free:
        symbol, unit = SYMBOLS[name]
        error = fit.standard_errors.get(name)
        value = f"{symbol} = {getattr(fit.model, name):.6g}" + ("" if error is None else f" ± {error:.2g}")
        told.append(f"{value} {unit}".rstrip())
    return ", ".join(told)


def frequency_text(fit: Fit) -> str:
    """ω₀ for a table; a dash where it ended at its bound, zero, and is no natural frequency."""
    return f"{fit.model.natural_frequency:.4f}" if fit.model.natural_frequency else "–"


def coincidence_text(fits: Mapping[str, Fit]) -> list[str]:
    """What the dash of a table means: s²/(s² + μ s^α) is s^(2−α)/(s^(2−α) + μ), one model by two names."""
    damped = fits.get("D-FOM")
    if damped is None or damped.model.natural_frequency:
        return []
    order, frequency = 2.0 - damped.model.damping_order, math.sqrt(damped.model.damping)
    return [f"– D-FOM ended at ω₀ = 0: it is UD-FOM with λ = 2 − α = {order:.4f}, ω₀ = √μ = {frequency:.4f}."]


def fit_text(fit: Fit) -> str:
    """Return structure, parameters, errors and findings of a fit."""
    lines = [
        f"{fit.structure}: {_parameters(fit)}",
        f"delay {1e3 * fit.delay:.3g} ms, offset {fit.offset:.3g}; error {100 * fit.nmse:.3g} % (NMSE), "
        f"{_share(fit.heldout_nmse)}; AIC {fit.aic:.1f}",
    ]
    return "\n".join([*lines, *map(str, fit.findings)])


def comparison_text(comparison: Comparison) -> str:
    """Return a line for each structure, the preferred one starred, and the verdict."""
    lines = [
        f"{'*' if name == comparison.preferred else ' '} {name:7} {_share(fit.heldout_nmse)}, "
        f"AIC {fit.aic:.1f}: {_parameters(fit)}"
        for name, fit in comparison.fits.items()
    ]
    return "\n".join([*lines, *coincidence_text(comparison.fits), comparison.verdict])
