"""Commands that say what a design is worth: assess, optimise, compare, design-map."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from fraclink._cli.app import group
from fraclink._cli.command import Answer, Writes, command, option
from fraclink._cli.console import steps
from fraclink._cli.options import (
    DesignFile,
    FilterTime,
    LinkMass,
    ModeGain,
    ModelFile,
    MotorLoopKind,
    PayloadRange,
    Placement,
    RigName,
    SeedNumber,
    load_link_model,
    load_rig,
    required_model,
)
from fraclink._compare import compare as run_rivals
from fraclink._design import Design
from fraclink._design import optimise as better
from fraclink._design.alternatives import Alternative, compare_at_equal_sensitivity, feasibility_map
from fraclink._design.assess import margin_curve, mode_gains, phase_budget, tolerances
from fraclink._files import output_path, write_json, write_text
from fraclink._show.drawing import save_axes
from fraclink._show.plots import feasibility, margins_against_payload, phase_shares
from fraclink._show.records import finite, requirement_json
from fraclink._show.tables import requirements_table
from fraclink._show.text import Table, View, degrees, grams, number
from fraclink._validate import Ordered, checked
from fraclink.errors import FieldError

app = group()

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
        "spillover": [requirement_json(item) for item in modes],
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


def rival_sentences(rivals: tuple[Alternative, ...]) -> tuple[str, ...]:
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
