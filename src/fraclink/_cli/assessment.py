"""What a finished design is worth: `assess` gathers budget, margins, tolerances, rivals and spillover."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from fraclink._cli.console import emit, emit_json, table, tell
from fraclink._cli.figures import save_axes
from fraclink._cli.options import Force, Json, LinkMass
from fraclink._cli.outcome import FAILS, HOLDS
from fraclink._cli.verdicts import DesignFile
from fraclink._files import output_path, write_json

if TYPE_CHECKING:
    from fraclink._design import Design, Requirement
    from fraclink._design.alternatives import Rival
    from fraclink._design.assess import PhaseShare, Tolerances

__all__ = ["register", "sentences", "spillover_of"]

KINDS = ("ideal", "motor", "loop", "sampled")
FIGURES, NUMBERS = ("margins.svg", "phase-budget.svg"), "assessment.json"
_POINTS = 41  # payloads of a curve: the sampled margins take most of the second it costs


def spillover_of(
    design: Design, *, link_mass: float | None, damping: float | None
) -> tuple[Requirement, ...]:
    """Return the loop gain at modes 2 and 3 of the link; empty where the link has no mass.

    The mass is the rig's unless `link_mass` [kg] is given; the damping the model's unless a ratio is.
    """
    from fraclink._design.assess import mode_gains

    if link_mass is not None:
        design = replace(design, rig=replace(design.rig, link=replace(design.rig.link, mass=link_mass)))
    return mode_gains(design, damping_ratio=damping)


def sentences(rivals: tuple[Rival, ...]) -> tuple[str, ...]:
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


def assess(
    plan_file: DesignFile,
    max_sensitivity: Annotated[
        float | None,
        typer.Option("--max-sensitivity", help="Ms at which rivals are compared; default: the design's own."),
    ] = None,
    link_mass: LinkMass = None,
    mode_damping: Annotated[
        float | None,
        typer.Option("--mode-damping", help="Damping ratio of modes 2 and 3; default: the model's damping."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder to write two figures and assessment.json to."),
    ] = None,
    json: Json = False,
    force: Force = False,
) -> int:
    """Tell what a design is worth: phase budget, margins, tolerances, rivals at equal Ms, spillover."""
    from fraclink._design import Design
    from fraclink._design.alternatives import compare_at_equal_sensitivity
    from fraclink._design.assess import margin_curve, phase_budget, tolerances

    if out is not None:
        for name in (*FIGURES, NUMBERS):
            output_path(out / name, force=force)
    design = Design.load(plan_file)
    low, high = design.payloads
    payloads = (high, math.sqrt(low * high), low)
    budget = phase_budget(design, low)
    curves = [margin_curve(design, payloads, kind=kind) for kind in KINDS]
    held = tolerances(design)
    peak = max_sensitivity or 1.0 / float(min(curves[2].modulus_margin))
    rivals = compare_at_equal_sensitivity(design, max_sensitivity=peak)
    spill = spillover_of(design, link_mass=link_mass, damping=mode_damping)
    said = sentences(rivals)
    code = HOLDS if all(item.passed for item in spill) else FAILS
    told = {
        "phase_budget": {share.element: share.phase for share in budget},
        "payloads": list(payloads),
        "phase_margin": {c.kind: c.phase_margin.tolist() for c in curves},
        "tolerances": {k: v if math.isfinite(v) else None for k, v in asdict(held).items()},
        "max_sensitivity": peak,
        "rivals": list(said),
        "spillover": [asdict(item) for item in spill],
    }
    if out is not None:
        _write(out, design, budget, told)
    if json:
        emit_json(told if out is None else told | {"out": str(out)})
        return code
    shown = [(share.element, f"{math.degrees(share.phase):+.2f}°") for share in budget]
    emit(table((f"phase at {1e3 * low:g} g", "share"), shown) + "\n")
    rows = [(c.kind, *(f"{math.degrees(float(p)):.2f}°" for p in c.phase_margin)) for c in curves]
    emit(table(("phase margin", *(f"{1e3 * m:.3g} g" for m in payloads)), rows) + "\n")
    emit(_tolerated(held) + "\n")
    emit(f"at equal worst Ms = {peak:.3f} (the paper's printed controllers as they are):\n" + "\n".join(said))
    if not spill:
        tell("no spillover: a massless link has one mode; give --link-mass [kg]")
    for item in spill:
        verdict = "passed" if item.passed else "MISSED"
        damped = "the model's damping" if mode_damping is None else f"ζ = {mode_damping:g}"
        emit(f"{item.name}: {item.achieved:.3f} (limit {item.wanted:g}, {damped}) {verdict}")
    if out is not None:
        tell("written: " + ", ".join(str(out / name) for name in (*FIGURES, NUMBERS)))
    return code


def _write(out: Path, design: Design, budget: tuple[PhaseShare, ...], told: dict[str, object]) -> None:
    """Figures of margins and budget, and the numbers of both."""
    from fraclink._design.assess import margin_curve
    from fraclink._show.plots import margins_against_payload, phase_shares

    low, high = design.payloads
    masses = np.geomspace(low / 2.5, 1.25 * high, _POINTS)
    curves = [margin_curve(design, masses, kind=kind) for kind in KINDS]
    save_axes(
        out / FIGURES[0],
        lambda ax: margins_against_payload(
            curves, payloads=design.payloads, wanted=design.phase_margin, ax=ax
        ),
    )
    save_axes(out / FIGURES[1], lambda ax: phase_shares(budget, ax=ax))
    drawn = {c.kind: c.phase_margin.tolist() for c in curves}
    write_json(out / NUMBERS, "assessment", 1, told | {"curves": {"payload": masses.tolist()} | drawn})


def _tolerated(held: Tolerances) -> str:
    def bound(word: str, value: float, unit: str) -> str:
        return f"{word} {value:.3g}{unit}" if 0.0 < value < math.inf else "without a limit found"

    return "\n".join(
        (
            "stable with",
            f"  delay: {1e3 * held.delay:.3g} ms more",
            f"  lighter payload: {bound('down to', 1e3 * held.payload_low, ' g')}",
            f"  heavier payload: {bound('up to', 1e3 * held.payload_high, ' g')}",
            f"  softer link: {bound('down to', held.stiffness_low, ' of the stiffness')}",
            f"  stiffer link: {bound('up to', held.stiffness_high, ' of the stiffness')}",
            f"  slower motor loop: {bound('down to', held.motor_pole, ' rad/s')}",
        )
    )


def register(app: typer.Typer) -> None:
    """Add the verb to the application."""
    app.command()(assess)
