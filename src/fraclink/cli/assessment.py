"""What a finished design is worth: `assess` gathers budget, margins, tolerances, rivals and spillover."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from fraclink.cli.console import emit, emit_json, table, tell
from fraclink.cli.options import Json
from fraclink.cli.outcome import FAILS, HOLDS
from fraclink.cli.verdicts import DesignFile

if TYPE_CHECKING:
    from fraclink.design import Plan, Requirement
    from fraclink.design.assess import Tolerances
    from fraclink.design.rivals import Rival

__all__ = ["register", "sentences", "spillover_of"]

KINDS = ("ideal", "motor", "loop", "sampled")


def spillover_of(plan: Plan, *, link_mass: float | None, damping: float) -> tuple[Requirement, ...]:
    """Return the loop gain at modes 2 and 3 of the twin's beam at the lightest payload, ζ = `damping`.

    A mode's share in the tip estimate θm − Γ/c is Γi²ωi²/c: participation times base curvature over c.
    Empty where the link has no mass and so no further mode.
    """
    from fraclink.design.assess import VibrationMode, spillover
    from fraclink.twin import Beam

    beam = Beam.from_rig(plan.rig, payload=plan.payloads[0], link_mass=link_mass)
    modes = beam.modes(3)
    shares = modes.participation * modes.curvature / plan.model.stiffness
    higher = [
        VibrationMode(float(w), damping, float(share))
        for w, share in zip(modes.frequencies[1:], shares[1:], strict=True)
    ]
    return spillover(plan, higher)


def sentences(rivals: tuple[Rival, ...]) -> tuple[str, ...]:
    """Return what the comparison at equal Ms says, each rival against the plan's own controller."""
    own, *others = rivals
    found = []
    for rival in others:
        if not rival.stable:
            found.append(f"{rival.name}: unstable for some payload of the range")
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
    link_mass: Annotated[
        float | None, typer.Option("--link-mass", help="Mass of the link [kg]; default: the rig's.")
    ] = None,
    mode_damping: Annotated[
        float, typer.Option("--mode-damping", help="Damping ratio assumed for modes 2 and 3.")
    ] = 0.02,
    json: Json = False,
) -> int:
    """Tell what a design is worth: phase budget, margins, tolerances, rivals at equal Ms, spillover."""
    from fraclink.design import Plan
    from fraclink.design.assess import margin_curve, phase_budget, tolerances
    from fraclink.design.rivals import compare_at_equal_sensitivity

    plan = Plan.load(plan_file)
    low, high = plan.payloads
    payloads = (high, math.sqrt(low * high), low)
    budget = phase_budget(plan, low)
    curves = [margin_curve(plan, payloads, kind=kind) for kind in KINDS]
    held = tolerances(plan)
    peak = max_sensitivity or 1.0 / float(min(curves[2].modulus_margin))
    rivals = compare_at_equal_sensitivity(plan, max_sensitivity=peak)
    spill = spillover_of(plan, link_mass=link_mass, damping=mode_damping)
    said = sentences(rivals)
    code = HOLDS if all(item.holds for item in spill) else FAILS
    if json:
        emit_json(
            {
                "phase_budget": {share.element: share.phase for share in budget},
                "payloads": list(payloads),
                "phase_margin": {c.kind: c.phase_margin.tolist() for c in curves},
                "tolerances": {k: v if math.isfinite(v) else None for k, v in asdict(held).items()},
                "max_sensitivity": peak,
                "rivals": list(said),
                "spillover": [asdict(item) for item in spill],
            }
        )
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
        verdict = "holds" if item.holds else "MISSED"
        emit(f"{item.name}: {item.achieved:.3f} (limit {item.wanted:g}, ζ = {mode_damping:g}) {verdict}")
    return code


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
