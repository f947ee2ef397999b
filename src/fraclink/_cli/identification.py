"""Verbs of identification beyond the single log: all structures, payloads, spectra, motor, experiment."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from fraclink._cli.console import emit, emit_json, steps, table
from fraclink._cli.options import Columns, Json, LogName, RigName, load_log, load_rig
from fraclink._cli.outcome import FAILS, HOLDS

__all__ = ["register"]

StructureName = Annotated[str, typer.Option("--structure", help="UD-IOM, D-IOM, UD-FOM or D-FOM.")]


def identify_all(
    log: LogName,
    rig: RigName,
    payload: Annotated[float | None, typer.Option("--payload", help="Payload of the log [kg].")] = None,
    column: Columns = None,
    json: Json = False,
) -> int:
    """Fit all four structures to a log and say what it tells apart."""
    from fraclink._cli.logs import what_is_wrong
    from fraclink._cli.summary import finding_text, finding_values, findings_text, fit_values
    from fraclink._identify import coincidence_text, frequency_text
    from fraclink._identify import identify_all as fit_all

    known = load_rig(rig)
    experiment = load_log(log, known, payload, column)
    stiffness = known.link.stiffness if experiment.output_kind == "deflection" else None
    with steps(2) as begin:
        begin("examining the log")
        wrong = what_is_wrong(experiment, known)
        begin("fitting four structures")
        comparison = fit_all(experiment, stiffness=stiffness)
    if json:
        fits = {name: fit_values(fit) for name, fit in comparison.fits.items()}
        findings = [*map(finding_values, wrong)]
        emit_json(
            {
                "preferred": comparison.preferred,
                "verdict": comparison.verdict,
                "fits": fits,
                "findings": findings,
            }
        )
        return FAILS if wrong else HOLDS
    rows = [
        (
            name,
            frequency_text(fit),
            f"{fit.model.order:.4f}",
            f"{fit.model.damping:.4g}",
            f"{1e3 * fit.delay:.2f}",
            f"{fit.mse:.4g}",
            f"{fit.aic:.1f}",
            f"{fit.heldout_nmse:.4g}" if fit.heldout_nmse is not None else "",
        )
        for name, fit in comparison.fits.items()
    ]
    emit(table(("model", "ω₀", "λ", "μ", "delay [ms]", "MSE", "AIC", "held-out NMSE"), rows))
    emit("\n".join([*coincidence_text(comparison.fits), comparison.verdict]))
    warned = [
        f"{name}: {finding_text(f)}"
        for name, fit in comparison.fits.items()
        for f in fit.findings
        if f.severity != "info"
    ]
    if warned:
        emit("\n".join(warned))
    if wrong:
        emit(findings_text(wrong).lstrip())
    return FAILS if wrong else HOLDS


def identify_payloads(
    logs: Annotated[
        list[str], typer.Argument(metavar="LOG", help="Two or more logs, each of another payload.")
    ],
    rig: RigName,
    structure: StructureName = "UD-FOM",
    payload: Annotated[
        list[float] | None,
        typer.Option("--payload", metavar="KG", help="Payload of a log [kg]; once for each, in their order."),
    ] = None,
    tied: Annotated[bool, typer.Option("--tied", help="Tie ω₀ to the payload by equation (5).")] = False,
    column: Columns = None,
    json: Json = False,
) -> int:
    """Fit several payloads together and test whether their parameters may be common."""
    from fraclink._arm.link import structure as structure_row
    from fraclink._identify import identify_payloads as fit_together
    from fraclink.errors import FieldError

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
    free = structure_row(fit.structure).free
    rows = [
        (
            log,
            f"{m.natural_frequency:.4f}",
            f"{m.order:.4f}",
            f"{m.damping:.4g}" if "damping" in free else "–",
            f"{m.damping_order:.3f}" if "damping_order" in free else "–",
            f"{mse:.4g}",
            f"{alone:.4g}",
        )
        for log, m, mse, alone in zip(logs, fit.models, fit.mse, fit.alone_mse, strict=True)
    ]
    emit(table(("log", "ω₀", "λ", "μ", "α", "MSE", "MSE alone"), rows))
    emit(fit.verdict)
    return HOLDS


def identify_motor(
    log: Annotated[str, typer.Argument(metavar="LOG", help="A log with the amplifier's voltage.")],
    rig: RigName,
    column: Columns = None,
    json: Json = False,
) -> int:
    """Identify the motor from voltage and angle: K/J, ν/J, Coulomb torque, dead zone, delay."""
    from dataclasses import asdict

    from fraclink._identify import identify_motor as fit_motor
    from fraclink.errors import LogError

    known = load_rig(rig)
    experiment = load_log(log, known, None, column)
    if experiment.voltage is None:
        raise LogError(
            "log",
            log,
            "without the amplifier's voltage",
            allowed="a log with a voltage column",
            remedy='name it in the rig file\'s [log], or by --column "voltage=NAME [V]"',
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
    standard_error: Annotated[
        float, typer.Option("--standard-error", help="Standard error of λ that is wanted.")
    ],
    noise: Annotated[float, typer.Option("--noise", help="Standard deviation of the gauge's noise [N·m].")],
    duration: Annotated[float, typer.Option("--duration", help="Length of the log [s].")] = 20.0,
    deflection_limit: Annotated[
        float, typer.Option("--deflection-limit", help="Largest |θm − θt| [rad].")
    ] = float("inf"),
    kind: Annotated[Literal["prbs", "multisine"], typer.Option("--kind", help="Excitation.")] = "prbs",
    json: Json = False,
) -> int:
    """Choose amplitude and band of an excitation for a wanted standard error of λ."""
    from fraclink._identify import design_experiment
    from fraclink.errors import FieldError

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
        rows = [
            ("kind", plan.kind),
            ("amplitude [rad]", f"{plan.amplitude:.5g}"),
            *([] if plan.bit is None else [("bit [s]", f"{plan.bit:.5g}")]),
            ("band [rad/s]", f"{plan.band[0]:.3g} to {plan.band[1]:.3g}"),
            ("duration [s]", f"{plan.duration:.5g}"),
            ("standard error of λ", f"{plan.standard_error:.5g}"),
            ("peak deflection [rad]", f"{plan.peak_deflection:.5g}"),
            *([] if plan.peak_voltage is None else [("peak voltage [V]", f"{plan.peak_voltage:.5g}")]),
        ]
        emit(table(("experiment", "value"), rows))
    return HOLDS


def register(app: typer.Typer) -> None:
    """Add the verbs of this module to the application."""
    for verb in (identify_all, identify_payloads, identify_motor, plan_experiment):
        app.command(verb.__name__.replace("_", "-"))(verb)
