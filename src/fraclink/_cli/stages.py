"""The stages of the way, chained through files: identify, design, simulate, report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fraclink._cli.console import emit, emit_json, steps, tell
from fraclink._cli.options import (
    Columns,
    Force,
    GainCrossover,
    Interpolate,
    Json,
    LinkMass,
    LogName,
    ModeGain,
    ModelFile,
    PayloadRange,
    PhaseMarginDeg,
    Resample,
    RigName,
    load_link_model,
    load_log,
    load_rig,
    radians,
)
from fraclink._cli.outcome import FAILS, HOLDS
from fraclink._files import output_path

if TYPE_CHECKING:
    pass

__all__ = ["register"]

Inner = Literal["ideal", "sampled"]


def identify(
    log: LogName,
    rig: RigName,
    out: Annotated[Path, typer.Option("--out", help="File to write the model to.")] = Path("model.json"),
    structure: Annotated[str, typer.Option("--structure", help="UD-IOM, D-IOM, UD-FOM or D-FOM.")] = "UD-FOM",
    payload: Annotated[float | None, typer.Option("--payload", help="Payload of the log [kg].")] = None,
    column: Columns = None,
    resample: Resample = False,
    interpolate: Interpolate = False,
    json: Json = False,
    force: Force = False,
) -> int:
    """Fit a link model to a log; gain, offset and sensor delay are fitted along."""
    from fraclink._cli.logs import what_is_wrong
    from fraclink._cli.summary import finding_values, findings_text, fit_text, fit_values
    from fraclink._identify import identify as fit_log

    place = output_path(out, force=force)
    with steps(3) as begin:
        begin("reading the log")
        known = load_rig(rig)
        experiment = load_log(log, known, payload, column, resample=resample, interpolate=interpolate)
        begin("examining the log")
        wrong = what_is_wrong(experiment, known)
        begin(f"fitting {structure}")
        # A deflection log cannot show the stiffness; a torque log measures it.
        stiffness = known.link.stiffness if experiment.output_kind == "deflection" else None
        fit = fit_log(experiment, structure, stiffness=stiffness)
    fit.save(place)
    if json:
        emit_json(fit_values(fit) | {"findings": [*map(finding_values, wrong)], "out": str(place)})
    else:
        emit(fit_text(fit) + findings_text(wrong))
        tell(f"written: {place}")
    return FAILS if wrong else HOLDS


def design(
    rig: RigName,
    model: ModelFile = None,
    payloads: PayloadRange = None,
    gain_crossover: GainCrossover = None,
    phase_margin_deg: PhaseMarginDeg = None,
    margins: Annotated[
        str,
        typer.Option(
            "--margins", help="loop: filter, motor loop, hold and delay included; ideal: the paper's."
        ),
    ] = "loop",
    filter_time: Annotated[
        float | None, typer.Option("--filter-time", help="δ [s], 0 for none; default: the 10 % rule.")
    ] = None,
    filter_order: Annotated[int | None, typer.Option("--filter-order", help="n, 1 or 2.")] = None,
    inner: Annotated[Inner, typer.Option("--inner", help="Motor loop.")] = "ideal",
    placement: Annotated[
        Literal["tustin", "direct"], typer.Option("--placement", help="Poles of the sampled motor loop.")
    ] = "tustin",
    max_sensitivity: Annotated[
        float | None,
        typer.Option("--max-sensitivity", help="Bound on Ms; alone it takes the phase margin's place."),
    ] = None,
    noise_gain: Annotated[
        float | None,
        typer.Option("--noise-gain", help="Bound on the motor reference's RMS per RMS of gauge noise."),
    ] = None,
    settling_time: Annotated[
        float | None,
        typer.Option("--settling-time", help="Bound on 2π/ω_c [s]; alone it takes the crossover's place."),
    ] = None,
    mode_gain: ModeGain = None,
    link_mass: LinkMass = None,
    out: Annotated[Path, typer.Option("--out", help="File to write the design to.")] = Path("design.json"),
    json: Json = False,
    force: Force = False,
) -> int:
    """Design the outer controller for a payload range; every requirement is listed with what was achieved."""
    from fraclink._cli.summary import plan_text, plan_values
    from fraclink._workflow import Request, design_for

    place = output_path(out, force=force)
    request = Request(
        payloads=payloads,
        gain_crossover=gain_crossover,
        phase_margin=radians(phase_margin_deg),
        margins=margins,
        filter_time=filter_time,
        filter_order=filter_order,
        inner=inner,
        placement=placement,
        max_sensitivity=max_sensitivity,
        noise_gain=noise_gain,
        settling_time=settling_time,
        mode_gain=mode_gain,
    )
    design, assumptions = design_for(load_rig(rig, link_mass=link_mass), load_link_model(model), request)
    design = design.with_law()
    design.save(place)
    if json:
        emit_json(plan_values(design) | {"out": str(place)})
        return HOLDS if design.passed else FAILS
    for sentence in assumptions:
        tell(f"assumed: {sentence}")
    emit(plan_text(design))
    for finding in design.findings:
        tell(str(finding))
    tell(f"written: {place}")
    return HOLDS if design.passed else FAILS


def simulate(
    plan_file: Annotated[Path, typer.Argument(metavar="DESIGN", help="Design made by `fraclink design`.")],
    payload: Annotated[float, typer.Option("--payload", help="Payload at the tip [kg].")],
    out: Annotated[Path, typer.Option("--out", help="File to write the run to (npz).")] = Path("run.npz"),
    amplitude: Annotated[float, typer.Option("--amplitude", help="Size of the move [rad].")] = 1.0,
    move_time: Annotated[float, typer.Option("--move-time", help="Time of the move [s].")] = 0.5,
    duration: Annotated[float, typer.Option("--duration", help="Time to simulate [s].")] = 4.0,
    gauge_offset: Annotated[
        float | None, typer.Option("--gauge-offset", help="Offset of the gauge [N·m]; default: the rig's.")
    ] = None,
    noise: Annotated[
        float | None, typer.Option("--noise", help="Gauge noise [N·m]; default: the rig's.")
    ] = None,
    inner: Annotated[Inner, typer.Option("--inner", help="Motor loop.")] = "sampled",
    seed: Annotated[int, typer.Option("--seed", help="Seed of the noise.")] = 0,
    json: Json = False,
    force: Force = False,
) -> int:
    """Simulate a move of the tip with the law as it is shipped; the exit code says whether it holds."""
    from fraclink._cli.summary import run_text, run_values
    from fraclink._design import Design
    from fraclink._workflow import Move, simulate_move

    place = output_path(out, force=force)
    move = Move(
        amplitude, move_time, duration, gauge_offset=gauge_offset, noise=noise, inner=inner, seed=seed
    )
    design = Design.load(plan_file)
    run = simulate_move(design, move, payload)
    run.save(place)
    emit_json(run_values(run) | {"out": str(place)}) if json else emit(run_text(run))
    if not json:
        if doubt := design.rig.payloads.doubt(payload):
            tell(str(doubt))
        tell(f"written: {place}")
    return HOLDS if run.verdict.passed else FAILS


def report(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder with what the stages wrote.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="File to write; default: report.html there.")
    ] = None,
    title: Annotated[str | None, typer.Option("--title", help="Title of the report.")] = None,
    json: Json = False,
    force: Force = False,
) -> int:
    """Gather a folder of results into one self-contained HTML file."""
    from fraclink._show.report import write_report
    from fraclink._workflow import load_study

    place = output_path(out or folder / "report.html", force=force)
    study = load_study(folder)
    write_report(study, place, title=title)
    emit_json({"out": str(place), "passed": study.passed}) if json else emit(str(place))
    return HOLDS


def register(app: typer.Typer) -> None:
    """Add the verbs of this module to the application."""
    for verb in (identify, design, simulate, report):
        app.command()(verb)
