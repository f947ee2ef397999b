"""Verbs of identification beyond the single log: all structures, payloads, spectra, motor, experiment."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer
from numpy.typing import NDArray

from fraclink.cli.console import emit, emit_json, steps, table
from fraclink.cli.options import Columns, Json, RigName, load_log, load_rig
from fraclink.cli.outcome import HOLDS

__all__ = ["register"]

StructureName = Annotated[str, typer.Option("--structure", help="UD-IOM, D-IOM, UD-FOM or D-FOM.")]


def identify_all(
    log: Annotated[str, typer.Argument(help="The log; `demo` is the bundled one.")],
    rig: RigName,
    payload: Annotated[float | None, typer.Option("--payload", help="Payload of the log [kg].")] = None,
    column: Columns = None,
    json: Json = False,
) -> int:
    """Fit all four structures to a log and say what it tells apart."""
    from fraclink.cli.summary import finding_text, fit_values
    from fraclink.identify import identify_all as fit_all

    known = load_rig(rig)
    experiment = load_log(log, known, payload, column)
    stiffness = known.link.stiffness if experiment.output_kind == "deflection" else None
    with steps(1) as begin:
        begin("fitting four structures")
        comparison = fit_all(experiment, stiffness=stiffness)
    if json:
        fits = {name: fit_values(fit) for name, fit in comparison.fits.items()}
        emit_json({"preferred": comparison.preferred, "verdict": comparison.verdict, "fits": fits})
        return HOLDS
    rows = [
        (
            name,
            f"{fit.model.natural_frequency:.4f}",
            f"{fit.model.order:.4f}",
            f"{fit.model.damping:.4g}",
            f"{1e3 * fit.delay:.2f}",
            f"{fit.mse:.4g}",
            f"{fit.aic:.1f}",
            f"{fit.heldout_nmse:.4g}" if fit.heldout_nmse is not None else "",
        )
        for name, fit in comparison.fits.items()
    ]
    emit(table(("model", "ϖ", "λ", "μ", "delay [ms]", "MSE", "AIC", "held-out NMSE"), rows))
    emit(comparison.verdict)
    warned = [
        f"{name}: {finding_text(f)}"
        for name, fit in comparison.fits.items()
        for f in fit.findings
        if f.severity != "info"
    ]
    if warned:
        emit("\n".join(warned))
    return HOLDS


def identify_payloads(
    logs: Annotated[list[str], typer.Argument(help="Two or more logs, each of another payload.")],
    rig: RigName,
    structure: StructureName = "UD-FOM",
    payload: Annotated[
        list[float] | None, typer.Option("--payload", help="Payload of each log [kg], in their order.")
    ] = None,
    tied: Annotated[bool, typer.Option("--tied", help="Tie ϖ to the payload by equation (5).")] = False,
    column: Columns = None,
    json: Json = False,
) -> int:
    """Fit several payloads together and test whether their parameters may be common."""
    from fraclink.errors import FieldError
    from fraclink.identify import identify_payloads as fit_together

    if payload and len(payload) != len(logs):
        raise FieldError(
            "payload",
            len(payload),
            "not one for each log",
            allowed=f"{len(logs)} values",
            remedy="repeat --payload",
        )
    known = load_rig(rig)
    masses: list[float | None] = list(payload) if payload else [None] * len(logs)
    experiments = [load_log(log, known, mass, column) for log, mass in zip(logs, masses, strict=True)]
    fit = fit_together(experiments, structure, tied=tied, length=known.link.length)
    if json:
        emit_json(
            {
                "structure": fit.structure,
                "common": list(fit.common),
                "natural_frequencies": [model.natural_frequency for model in fit.models],
                "orders": [model.order for model in fit.models],
                "dampings": [model.damping for model in fit.models],
                "damping_orders": [model.damping_order for model in fit.models],
                "mse": list(fit.mse),
                "standard_errors": fit.standard_errors,
                "stiffness": fit.stiffness,
                "p_value": fit.test.p_value,
                "verdict": fit.verdict,
            }
        )
        return HOLDS
    rows = [
        (
            log,
            f"{m.natural_frequency:.4f}",
            f"{m.order:.4f}",
            f"{m.damping:.4g}",
            f"{m.damping_order:.3f}",
            f"{mse:.4g}",
            f"{alone:.4g}",
        )
        for log, m, mse, alone in zip(logs, fit.models, fit.mse, fit.alone_mse, strict=True)
    ]
    emit(table(("log", "ϖ", "λ", "μ", "α", "MSE", "MSE alone"), rows))
    emit(fit.verdict)
    return HOLDS


def identify_spectrum(
    response: Annotated[
        Path,
        typer.Argument(
            help="Table with frequency_rad_s or frequency_Hz, gain or gain_dB, phase_rad or phase_deg."
        ),
    ],
    resonances: Annotated[int, typer.Option("--resonances", min=1, max=6, help="How many.")] = 1,
    anti_resonances: Annotated[int, typer.Option("--anti-resonances", min=0, max=6, help="How many.")] = 0,
    json: Json = False,
) -> int:
    """Fit modes with one common λ to a table of gain and phase; a column `coherence` is used."""
    from fraclink.identify import identify_frequency_response
    from fraclink.readers import read_columns

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


def identify_motor(
    log: Annotated[str, typer.Argument(help="A log with the amplifier's voltage.")],
    rig: RigName,
    column: Columns = None,
    json: Json = False,
) -> int:
    """Identify the motor from voltage and angle: K/J, ν/J, Coulomb torque, dead zone, delay."""
    from dataclasses import asdict

    from fraclink.errors import LogError
    from fraclink.identify import identify_motor as fit_motor

    known = load_rig(rig)
    experiment = load_log(log, known, None, column)
    if experiment.voltage is None:
        raise LogError(
            "voltage",
            log,
            "not in this log",
            allowed="a voltage column",
            remedy="name it in the rig file's [log]",
        )
    torque = experiment.output if experiment.output_kind == "torque" else None
    fit = fit_motor(
        experiment.voltage,
        experiment.motor_angle,
        period=experiment.period,
        torque=torque,
        inertia=None if torque is not None else known.motor.inertia,
    )
    if json:
        emit_json(asdict(fit))
        return HOLDS
    errors = fit.standard_errors
    rows = [
        ("K/J [rad/(V·s²)]", f"{fit.gain:.5g}", f"± {errors['gain']:.2g}", f"{known.motor.gain:.5g}"),
        ("ν/J [1/s]", f"{fit.decay:.5g}", f"± {errors['decay']:.2g}", f"{known.motor.decay:.5g}"),
        ("Coulomb friction [V]", f"{fit.coulomb_voltage:.4g}", f"± {errors['coulomb_voltage']:.2g}", ""),
        (
            "Coulomb torque [N·m]",
            "" if fit.coulomb_torque is None else f"{fit.coulomb_torque:.4g}",
            "",
            f"{known.motor.coulomb_torque:.4g}",
        ),
        ("dead zone [V]", f"{fit.dead_zone:.4g}", "", ""),
        ("delay [ms]", f"{1e3 * fit.delay:.3g}", "", ""),
    ]
    emit(table(("motor", "value", "error", "rig"), rows))
    return HOLDS


def plan_experiment(
    rig: RigName,
    standard_error: Annotated[float, typer.Option("--standard-error", help="Wanted of λ.")],
    noise: Annotated[float, typer.Option("--noise", help="Standard deviation of the gauge [N·m].")],
    duration: Annotated[float, typer.Option("--duration", help="Of the log [s].")] = 20.0,
    deflection_limit: Annotated[
        float, typer.Option("--deflection-limit", help="Largest |θm − θt| [rad].")
    ] = float("inf"),
    kind: Annotated[Literal["prbs", "multisine"], typer.Option("--kind", help="Of excitation.")] = "prbs",
    json: Json = False,
) -> int:
    """Choose amplitude and band of an excitation for a wanted standard error of λ."""
    from fraclink.errors import FieldError
    from fraclink.identify import design_experiment

    known = load_rig(rig)
    if known.model is None:
        raise FieldError(
            "model", rig, "without a model", allowed="a rig with [model]", remedy="add a first guess to it"
        )
    plan = design_experiment(
        known.model,
        standard_error=standard_error,
        noise=noise,
        period=known.period,
        duration=duration,
        kind=kind,
        motor=known.motor,
        deflection_limit=deflection_limit,
    )
    told = {
        "kind": plan.kind,
        "amplitude": plan.amplitude,
        "bit": plan.bit,
        "band": list(plan.band),
        "duration": plan.duration,
        "standard_error": plan.standard_error,
        "peak_deflection": plan.peak_deflection,
        "peak_voltage": plan.peak_voltage,
    }
    if json:
        emit_json(told)
    else:
        told["band"] = f"{plan.band[0]:.3g} to {plan.band[1]:.3g}"
        rows = [
            (name.replace("_", " "), f"{value:.5g}" if isinstance(value, float) else str(value))
            for name, value in told.items()
            if value is not None
        ]
        emit(table(("experiment", "value"), rows))
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
    """Add the verbs of this module to the application."""
    for verb in (identify_all, identify_payloads, identify_spectrum, identify_motor, plan_experiment):
        app.command(verb.__name__.replace("_", "-"))(verb)
