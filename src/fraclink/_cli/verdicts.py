"""Verbs on a design: certify, twin, compare."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from fraclink._cli.console import emit, emit_json, steps, tell
from fraclink._cli.options import (
    Force,
    Gear,
    Json,
    LinkMass,
    ModelFile,
    Payload,
    RigName,
    load_link_model,
    load_rig,
)
from fraclink._cli.outcome import FAILS, HOLDS
from fraclink._files import output_path

__all__ = ["DesignFile", "register"]

DesignFile = Annotated[Path, typer.Argument(metavar="DESIGN", help="Design made by `fraclink design`.")]


def certify(
    plan_file: DesignFile,
    out: Annotated[Path, typer.Option("--out", help="File to write the certificate to.")] = Path(
        "certificate.json"
    ),
    modulus_margin: Annotated[
        float | None, typer.Option("--modulus-margin", help="|1 + L| to prove; default: what can be proved.")
    ] = None,
    json: Json = False,
    force: Force = False,
) -> int:
    """Prove stability for every payload and delay in range; exit code 1 where the proof fails."""
    from fraclink._certify import certify as prove
    from fraclink._design import Design

    place = output_path(out, force=force)
    with steps(1) as begin:
        begin("proving")
        certificate = prove(Design.load(plan_file), modulus_margin=modulus_margin)
    if certificate.passed:
        certificate.save(place)
    told = {
        "passed": certificate.passed,
        "verdict": certificate.verdict,
        "payload": certificate.payload,
        "frequency": certificate.frequency,
        "sha256": certificate.sha256 if certificate.passed else None,
        "out": str(place) if certificate.passed else None,
    }
    emit_json(told) if json else emit(certificate.verdict)
    if certificate.passed and not json:
        tell(f"written: {place}")
    return HOLDS if certificate.passed else FAILS


def twin(
    plan_file: DesignFile,
    payload: Payload = None,
    link_mass: LinkMass = None,
    gear: Gear = None,
    amplitude: Annotated[float, typer.Option("--amplitude", help="Size of the move [rad].")] = 1.0,
    move_time: Annotated[float, typer.Option("--move-time", help="Time of the move [s].")] = 1.0,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the noise.")] = 0,
    json: Json = False,
) -> int:
    """Run the shipped law on the twin: an arm with distributed mass that is not the model."""
    from fraclink._arm.reference import smooth_step
    from fraclink._cli.summary import metrics_values
    from fraclink._design import Design
    from fraclink._simulate import Twin, geared, simulate

    design = Design.load(plan_file)
    rig = design.rig if gear is None else geared(design.rig, gear)
    arm = Twin.from_rig(rig, payload=payload, link_mass=link_mass)
    law = replace(design, rig=rig).law()
    run = simulate(law, smooth_step(amplitude, duration=move_time), arm=arm, seed=seed)
    if json:
        emit_json(
            {
                "passed": run.verdict.passed,
                "reason": run.verdict.reason,
                "metrics": metrics_values(run.metrics),
            }
        )
    else:
        doubt = None if payload is None else rig.payloads.doubt(payload)
        for finding in (*arm.findings, *filter(None, [doubt])):
            tell(str(finding))
        metrics = run.metrics
        emit(
            f"overshoot {100 * metrics.overshoot:.2f} %, vibration left "
            f"{1e3 * metrics.residual_vibration:.3g} mrad, peak voltage {metrics.peak_voltage:.3g} V\n"
            f"{run.verdict}"
        )
    return HOLDS if run.verdict.passed else FAILS


def compare(
    rig: RigName,
    out: Annotated[Path, typer.Option("--out", help="Folder for table, figure and figures as JSON.")] = Path(
        "comparison"
    ),
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="TEXT", help="Run rivals whose name contains this; may be repeated."),
    ] = None,
    model: ModelFile = None,
    link_mass: LinkMass = None,
    gain_crossover: Annotated[float, typer.Option("--gain-crossover", help="Of our design [rad/s].")] = 12.0,
    phase_margin_deg: Annotated[
        float, typer.Option("--phase-margin-deg", help="Of our design [degrees].")
    ] = 50.0,
    filter_time: Annotated[
        float | None, typer.Option("--filter-time", help="δ of our design [s]; default: the 10 % rule.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the noise, the same for all.")] = 0,
    json: Json = False,
    force: Force = False,
) -> int:
    """Run our design and its rivals on one twin, each tuned by a stated rule."""
    from fraclink._compare import compare as hold
    from fraclink._files import write_text

    table = output_path(out / "comparison.md", force=force)
    with steps(14) as begin:
        result = hold(
            load_rig(rig),
            model=load_link_model(model),
            link_mass=link_mass,
            gain_crossover=gain_crossover,
            phase_margin=math.radians(phase_margin_deg),
            filter_time=filter_time,
            names=only or None,
            seed=seed,
            progress=begin,
        )
    write_text(table, result.markdown())
    result.save(out / "comparison.json")
    result.draw(out / "comparison.svg")
    if json:
        emit_json({"verdicts": list(result.verdicts()), "winners": result.winners(), "out": str(out)})
    else:
        emit("\n".join((*result.verdicts(), str(table))))
    return HOLDS if result.standings[0].passed else FAILS


def register(app: typer.Typer) -> None:
    """Add the verbs of this module to the application."""
    for verb in (certify, twin, compare):
        app.command()(verb)
