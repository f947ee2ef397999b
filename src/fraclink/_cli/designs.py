"""Commands that make and run a design: run, design, simulate, twin, certify, report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fraclink._arm.reference import smooth_step
from fraclink._certify import certify as prove
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Writes, command, option
from fraclink._cli.console import steps
from fraclink._cli.options import (
    Columns,
    DesignFile,
    FilterTime,
    GainCrossover,
    Gear,
    Interpolate,
    LinkMass,
    LogPayload,
    ModeGain,
    ModelFile,
    MotorLoopKind,
    Payload,
    PayloadRange,
    PhaseMarginDeg,
    Placement,
    Resample,
    RigName,
    SeedNumber,
    load_design,
    load_link_model,
    load_log,
    load_rig,
    radians,
)
from fraclink._design import Design
from fraclink._files import output_path
from fraclink._show.report import write_report
from fraclink._simulate import Twin
from fraclink._simulate import simulate as run_law
from fraclink._workflow import design_for, load_study, simulate_move
from fraclink._workflow import run as run_study

app = group()

Amplitude = Annotated[float, option("--amplitude", help="Size of the move [rad].")]
MoveTime = Annotated[float, option("--move-time", help="Time of the move [s].")]


@app.command()
@command
def run(
    rig: RigName,
    log: Annotated[str, option("--log", help="The log; `demo` is the bundled one.")],
    out: Annotated[
        Path,
        option("--out", help="Folder to write to."),
        Writes(("model.json", "design.json", "report.html")),
    ] = Path("results"),
    structure: Annotated[
        str | None, option("--structure", help="Structure of the model; default: what the log supports.")
    ] = None,
    payload: LogPayload = None,
    column: Columns = None,
    resample: Resample = False,
    interpolate: Interpolate = False,
    payloads: PayloadRange = None,
    gain_crossover: GainCrossover = None,
    phase_margin_deg: PhaseMarginDeg = None,
    filter_time: FilterTime = None,
    mode_gain: ModeGain = None,
    certify: Annotated[bool, option("--certify", help="Prove the design, too; takes a few seconds.")] = False,
    arms: Annotated[
        int, option("--arms", help="Arms that differ from the model to try; 0 leaves them out.")
    ] = 1000,
    title: Annotated[str | None, option("--title", help="Title of the report.")] = None,
) -> Answer:
    """Take a log to a model, a controller, simulated moves and a report; the exit code is the verdict."""
    known = load_rig(rig)
    margin = radians(phase_margin_deg=phase_margin_deg)
    with steps(6 + certify) as begin:
        begin("reading the log")
        experiment = load_log(log, known, payload, column, resample=resample, interpolate=interpolate)
        study = run_study(
            known,
            experiment,
            structure=structure,
            certified=certify,
            arms=arms,
            out=out,
            begin=begin,
            payloads=payloads,
            gain_crossover=gain_crossover,
            phase_margin=margin,
            filter_time=filter_time,
            mode_gain=mode_gain,
        )
        begin("writing the report")
        place = write_report(study, out / "report.html", title=title)
    following = f"fraclink export c {out / 'design.json'} --out firmware" if study.law else ""
    if study.arms and study.arms.failure.count:
        worst = study.arms.failed[0]
        following = f"fraclink campaign replay {out / 'arms'} --run {worst}"
    return Answer(
        study,
        not study.verdict.refuted,
        values={"report": str(place), "out": str(out)},
        written=(place,),
        following=following,
    )


@app.command()
@command
def design(
    rig: RigName,
    model: ModelFile = None,
    payloads: PayloadRange = None,
    gain_crossover: GainCrossover = None,
    phase_margin_deg: PhaseMarginDeg = None,
    margins: Annotated[
        str,
        option("--margins", help="loop: filter, motor loop, hold and delay included; ideal: the paper's."),
    ] = "loop",
    filter_time: FilterTime = None,
    filter_order: Annotated[int | None, option("--filter-order", help="n, 1 or 2.")] = None,
    inner: MotorLoopKind = "ideal",
    placement: Placement = "tustin",
    max_sensitivity: Annotated[
        float | None,
        option("--max-sensitivity", help="Bound on Ms; alone it takes the phase margin's place."),
    ] = None,
    noise_gain: Annotated[
        float | None,
        option("--noise-gain", help="Bound on the motor reference's RMS per RMS of gauge noise."),
    ] = None,
    settling_time: Annotated[
        float | None,
        option("--settling-time", help="Bound on 2π/ω_c [s]; alone it takes the crossover's place."),
    ] = None,
    mode_gain: ModeGain = None,
    link_mass: LinkMass = None,
    out: Annotated[Path, option("--out", help="File to write the design to."), Writes()] = Path(
        "design.json"
    ),
) -> Answer:
    """Design the outer controller for a payload range; every requirement is listed with what was achieved."""
    made, assumptions = design_for(
        load_rig(rig, link_mass=link_mass),
        load_link_model(model),
        payloads=payloads,
        gain_crossover=gain_crossover,
        phase_margin=radians(phase_margin_deg=phase_margin_deg),
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
    made = made.with_law()
    made.save(out)
    assumed = tuple(f"assumed: {sentence}" for sentence in assumptions)
    step = f"simulate {out} --payload {made.payloads[0]:g}" if made.passed else f"assess {out}"
    return Answer(made, made.passed, remarks=assumed, written=(out,), following=f"fraclink {step}")


@app.command()
@command
def simulate(
    design_file: DesignFile,
    payload: Annotated[float, option("--payload", help="Payload at the tip [kg].")],
    out: Annotated[Path, option("--out", help="File to write the run to (npz)."), Writes()] = Path("run.npz"),
    amplitude: Amplitude = 1.0,
    move_time: MoveTime = 0.5,
    duration: Annotated[float, option("--duration", help="Time to simulate [s].")] = 4.0,
    gauge_offset: Annotated[
        float | None, option("--gauge-offset", help="Offset of the gauge [N·m]; default: the rig's.")
    ] = None,
    noise: Annotated[float | None, option("--noise", help="Gauge noise [N·m]; default: the rig's.")] = None,
    inner: MotorLoopKind = "sampled",
    seed: SeedNumber = 0,
) -> Answer:
    """Simulate a move of the tip with the law as it is shipped; the exit code says whether it settles."""
    made = Design.load(design_file)
    found = simulate_move(
        made,
        payload,
        amplitude=amplitude,
        move_time=move_time,
        duration=duration,
        inner=inner,
        gauge_offset=gauge_offset,
        noise=noise,
        seed=seed,
    )
    found.save(out)
    doubt = made.rig.payloads.doubt(payload)
    remarks = () if doubt is None else (str(doubt),)
    following = f"fraclink twin {design_file} --payload {payload:g}"
    return Answer(found, found.verdict.passed, remarks=remarks, written=(out,), following=following)


@app.command()
@command
def twin(
    design_file: DesignFile,
    payload: Payload = None,
    link_mass: LinkMass = None,
    gear: Gear = None,
    model: ModelFile = None,
    amplitude: Amplitude = 1.0,
    move_time: MoveTime = 1.0,
    seed: SeedNumber = 0,
) -> Answer:
    """Run the shipped law on the twin: an arm with distributed mass that is not the model."""
    made = load_design(design_file, gear=gear, model=model)
    arm = Twin.from_rig(made.rig, payload=payload, link_mass=link_mass)
    found = run_law(made.law(), smooth_step(amplitude, duration=move_time), arm=arm, seed=seed)
    doubt = None if payload is None else made.rig.payloads.doubt(payload)
    remarks = tuple(str(finding) for finding in (*arm.findings, doubt) if finding is not None)
    return Answer(found, found.verdict.passed, remarks=remarks)


@app.command()
@command
def certify(
    design_file: DesignFile,
    out: Annotated[Path, option("--out", help="File to write the certificate to."), Writes()] = Path(
        "certificate.json"
    ),
    modulus_margin: Annotated[
        float | None, option("--modulus-margin", help="|1 + L| to prove; default: what can be proved.")
    ] = None,
) -> Answer:
    """Prove stability for every payload and delay in range; exit code 1 where the proof fails."""
    with steps(1) as begin:
        begin("proving")
        certificate = prove(Design.load(design_file), modulus_margin=modulus_margin)
    if certificate.passed:
        certificate.save(out)
    written = (out,) if certificate.passed else ()
    return Answer(certificate, certificate.passed, values={} if written else {"out": None}, written=written)


@app.command()
@command
def report(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of results.")],
    out: Annotated[Path | None, option("--out", help="File to write; default: report.html there.")] = None,
    title: Annotated[str | None, option("--title", help="Title of the report.")] = None,
    force: bool = False,
) -> Answer:
    """Gather a folder of results into one self-contained HTML file."""
    place = output_path(out or folder / "report.html", force=force)
    study = load_study(folder)
    write_report(study, place, title=title)
    return Answer(text=str(place), values={"out": str(place), "passed": study.verdict.passed})
