"""Commands on designs: run, design, simulate, twin, certify, assess, optimise, compare, map, report."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
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
    Payload,
    PayloadRange,
    PhaseMarginDeg,
    Resample,
    RigName,
    SeedNumber,
    load_design,
    load_link_model,
    load_log,
    load_rig,
    radians,
    required_model,
)
from fraclink._compare import compare as run_rivals
from fraclink._design import Design
from fraclink._design import optimise as better
from fraclink._design.alternatives import Rival, compare_at_equal_sensitivity, feasibility_map
from fraclink._design.assess import margin_curve, mode_gains, phase_budget, tolerances
from fraclink._files import output_path, write_json, write_text
from fraclink._show.drawing import save_axes
from fraclink._show.plots import feasibility, margins_against_payload, phase_shares
from fraclink._show.records import finite
from fraclink._show.report import write_report
from fraclink._show.tables import requirements_table
from fraclink._show.text import Table, View, degrees, grams, number
from fraclink._simulate import Twin
from fraclink._simulate import simulate as run_law
from fraclink._validate import Ordered, checked
from fraclink._workflow import design_for, load_study, simulate_move
from fraclink._workflow import run as run_study
from fraclink.errors import FieldError

app = group()

Inner = Literal["ideal", "sampled"]
Placement = Annotated[
    Literal["tustin", "direct"], option("--placement", help="Poles of the sampled motor loop.")
]
MotorLoopKind = Annotated[Inner, option("--inner", help="Motor loop.")]
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


# --- what a design is worth -------------------------------------------------------------------------------

_KINDS = ("ideal", "motor", "loop", "sampled")
_FIGURES, _NUMBERS = ("margins.svg", "phase-budget.svg"), "assessment.json"
_POINTS = 41  # payloads of a curve: the sampled margins take most of the second it costs


@app.command()
@command
def assess(
    design_file: DesignFile,
    max_sensitivity: Annotated[
        float | None,
        option("--max-sensitivity", help="Ms at which rivals are compared; default: the design's own."),
    ] = None,
    link_mass: LinkMass = None,
    mode_damping: Annotated[
        float | None,
        option("--mode-damping", help="Damping ratio of modes 2 and 3; default: the model's damping."),
    ] = None,
    out: Annotated[
        Path | None,
        option("--out", help="Folder to write two figures and assessment.json to."),
        Writes((*_FIGURES, _NUMBERS)),
    ] = None,
) -> Answer:
    """Assess a design: phase budget, margins, tolerances, rivals at equal Ms, higher modes."""
    made = Design.load(design_file)
    low, high = made.payloads
    payloads = (high, math.sqrt(low * high), low)
    budget = phase_budget(made, low)
    curves = [margin_curve(made, payloads, kind=kind) for kind in _KINDS]
    tolerated = tolerances(made)
    peak = max_sensitivity or 1.0 / float(min(curves[2].modulus_margin))
    rivals = rival_sentences(compare_at_equal_sensitivity(made, max_sensitivity=peak))
    massive = made
    if link_mass is not None:
        massive = replace(made, rig=replace(made.rig, link=replace(made.rig.link, mass=link_mass)))
    modes = mode_gains(massive, damping_ratio=mode_damping)
    passed = all(item.passed for item in modes)
    values: dict[str, Any] = {
        "phase_budget": {share.element: share.phase for share in budget},
        "payloads": list(payloads),
        "phase_margin": {c.kind: c.phase_margin.tolist() for c in curves},
        "tolerances": {name: finite(value) for name, value in asdict(tolerated).items()},
        "max_sensitivity": peak,
        "rivals": list(rivals),
        "spillover": [asdict(item) for item in modes],
    }
    if out is not None:
        masses = np.geomspace(low / 2.5, 1.25 * high, _POINTS)
        drawn = [margin_curve(made, masses, kind=kind) for kind in _KINDS]
        save_axes(
            out / _FIGURES[0],
            lambda ax: margins_against_payload(drawn, payloads=(low, high), wanted=made.phase_margin, ax=ax),
        )
        save_axes(out / _FIGURES[1], lambda ax: phase_shares(budget, ax=ax))
        shown = {"payload": masses.tolist()} | {c.kind: c.phase_margin.tolist() for c in drawn}
        write_json(out / _NUMBERS, "assessment", 1, values | {"curves": shown})
    tables = (
        requirements_table(modes),
        Table((f"phase at {grams(low)}", "share"), tuple((s.element, degrees(s.phase, 2)) for s in budget)),
        Table(
            ("phase margin", *(grams(float(f"{m:.3g}")) for m in payloads)),
            tuple((c.kind, *(degrees(float(p), 2) for p in c.phase_margin)) for c in curves),
        ),
        _tolerance_table(asdict(tolerated)),
    )
    notes = (f"at equal worst-case Ms = {peak:.3f}, the paper's printed controllers as they are:", *rivals)
    if not modes:
        notes = (*notes, "higher modes: none, as the link has no mass; give --link-mass [kg]")
    headline = f"stable with {1e3 * tolerated.delay:.3g} ms more delay"
    return Answer(
        text=View(headline, tables, notes, "passed" if passed else "failed"),
        passed=passed,
        values=values if out is None else values | {"out": str(out)},
        written=() if out is None else tuple(out / name for name in (*_FIGURES, _NUMBERS)),
    )


def _tolerance_table(tolerated: dict[str, float]) -> Table:
    """Up to where the loop stays stable, one thing changed at a time."""
    rows = (
        ("delay", "delay", "ms more", 1e3),
        ("lighter payload", "payload_low", "g", 1e3),
        ("heavier payload", "payload_high", "g", 1e3),
        ("softer link", "stiffness_low", "of the stiffness", 1.0),
        ("stiffer link", "stiffness_high", "of the stiffness", 1.0),
        ("slower motor loop", "motor_pole", "rad/s", 1.0),
    )

    def shown(value: float, unit: str, factor: float) -> str:
        return f"{number(factor * value, 3)} {unit}" if 0.0 < value < math.inf else "no limit found"

    return Table(
        ("stable with", "up to"), tuple((what, shown(tolerated[name], u, f)) for what, name, u, f in rows)
    )


def rival_sentences(rivals: tuple[Rival, ...]) -> tuple[str, ...]:
    """Return what the comparison at equal Ms says, each rival against the design's own controller."""
    own, *others = rivals
    found = []
    for rival in others:
        if not rival.stable:
            found.append(f"{rival.name}: unstable for some payload of the range")
            continue
        if rival.gain_crossover == 0.0:
            found.append(f"{rival.name} (β = {rival.controller.order:.3g}) crosses nowhere at this Ms")
            continue
        speed, noise = rival.gain_crossover / own.gain_crossover, rival.noise_gain / own.noise_gain
        found.append(
            f"{rival.name} (β = {rival.controller.order:.3g}) crosses at {speed:.2f} times the crossover of "
            f"{own.name} (β = {own.controller.order:.3g}), with {noise:.2f} times its noise"
        )
    return tuple(found)


@app.command()
@command
def optimise(
    design_file: DesignFile,
    out: Annotated[Path, option("--out", help="File to write the design to."), Writes()] = Path(
        "optimised.json"
    ),
    goal: Annotated[
        Literal["noise", "crossover"],
        option("--goal", help="noise: least at the motor reference; crossover: the fastest loop."),
    ] = "noise",
    max_sensitivity: Annotated[
        float | None, option("--max-sensitivity", help="Bound on Ms; default: the design's own.")
    ] = None,
    gain_crossover: Annotated[
        float | None,
        option("--gain-crossover", help="Least crossover [rad/s], for the goal noise; default: as designed."),
    ] = None,
    noise_gain: Annotated[
        float | None,
        option("--noise-gain", help="Bound on the noise, for the goal crossover; default: as designed."),
    ] = None,
    mode_gain: ModeGain = None,
    least_percent: Annotated[
        float, option("--least-percent", help="Improvement below which the simpler structure is kept.")
    ] = 2.0,
) -> Answer:
    """Optimise k_d, β, δ and n for the worst payload, from a closed-form design."""
    with steps(1) as begin:
        begin("optimising")
        found = better(
            Design.load(design_file),
            goal=goal,
            max_sensitivity=max_sensitivity,
            gain_crossover=gain_crossover,
            noise_gain=noise_gain,
            mode_gain=mode_gain,
            least=0.01 * least_percent,
        )
    found = replace(found, design=found.design.with_law())
    found.design.save(out)
    return Answer(found, found.design.passed, written=(out,), following=f"fraclink assess {out}")


@app.command()
@command
def compare(
    rig: RigName,
    out: Annotated[
        Path,
        option("--out", help="Folder for table, figure and figures as JSON."),
        Writes(("comparison.md",)),
    ] = Path("comparison"),
    only: Annotated[
        list[str] | None,
        option("--only", metavar="TEXT", help="Run rivals whose name contains this; may be repeated."),
    ] = None,
    model: ModelFile = None,
    link_mass: LinkMass = None,
    gain_crossover: Annotated[float, option("--gain-crossover", help="Of fraclink's design [rad/s].")] = 12.0,
    phase_margin_deg: Annotated[
        float, option("--phase-margin-deg", help="Of fraclink's design [degrees].")
    ] = 50.0,
    filter_time: FilterTime = None,
    seed: SeedNumber = 0,
) -> Answer:
    """Run the design and its rivals on one twin, each tuned by a stated rule."""
    table = out / "comparison.md"
    with steps(15) as begin:
        result = run_rivals(
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
    return Answer(result, result.standings[0].passed, values={"out": str(out)}, written=(table,))


@checked
def _crossover_axis(*, crossovers: Annotated[tuple[float, float], Ordered(strict=True)], points: int) -> Any:
    return np.linspace(*crossovers, points)


@app.command()
@command
def design_map(
    rig: RigName,
    out: Annotated[
        Path,
        option("--out", help="Figure, .svg or .png; a .json with the numbers lies beside it."),
        Writes(),
    ] = Path("design-map.svg"),
    payloads: PayloadRange = None,
    points: Annotated[int, option("--points", min=5, max=400, help="Values on each axis.")] = 80,
    crossovers: Annotated[
        tuple[float, float], option("--crossovers", metavar="LOW HIGH", help="Range of ω_c [rad/s].")
    ] = (8.0, 45.0),
    filter_time: FilterTime = None,
    filter_order: Annotated[int, option("--filter-order", help="n, 1 or 2, the same for the whole map.")] = 1,
    inner: MotorLoopKind = "ideal",
    placement: Placement = "tustin",
    model: ModelFile = None,
    force: bool = False,
) -> Answer:
    """Map which crossovers and margins are feasible, with noise and settling contours."""
    if out.suffix.lower() not in (".svg", ".png"):
        allowed, remedy = ".svg or .png", "end the figure's name in one of these"
        raise FieldError("out", out.name, "of another kind", allowed=allowed, remedy=remedy)
    numbers = output_path(out.with_suffix(".json"), force=force)
    known = load_rig(rig, model=model)
    found = feasibility_map(
        required_model(known),
        known,
        payloads=payloads,
        gain_crossovers=_crossover_axis(crossovers=crossovers, points=points),
        phase_margins=np.radians(np.linspace(10.0, 110.0, points)),
        filter_time=filter_time,
        filter_order=filter_order,
        inner=inner,
        placement=placement,
    )
    save_axes(out, lambda ax: feasibility(found, ax=ax))
    names = ("gain", "order", "upper", "filter_time", "settling_time", "noise_gain")
    values = {name: [list(map(finite, row)) for row in getattr(found, name).tolist()] for name in names}
    axes = {"gain_crossover": found.gain_crossover.tolist(), "phase_margin": found.phase_margin.tolist()}
    write_json(numbers, "design-map", 1, values | axes)
    share = float(np.mean(found.feasible))
    return Answer(
        text=f"{100 * share:.0f} % of the map is feasible",
        passed=share > 0.0,
        values={"feasible": share},
        written=(out, numbers),
    )
