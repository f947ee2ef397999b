"""The nearest feasible request: what a refusal offers, tried as a whole before it is
offered.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.loop import Loop
from fraclink._design.bounds import Attempt
from fraclink._law.design import Requirement, Specification
from fraclink.errors import FieldError, InfeasibleError

if TYPE_CHECKING:
    from fraclink._design.equations import ClosedForm, Task

__all__ = ["boundary", "missed_bounds", "offered", "refuse"]

Real = NDArray[np.float64]


def boundary(
    feasible: Callable[[float], bool],
    good: float,
    bad: float,
    *,
    halvings: int = 30,
    log: bool = True,
) -> float:
    """Return the feasible value nearest to `bad`: the edge between `good` and `bad`, to
    2^-`halvings`.

    What is feasible or not has no value whose root could be sought, so the interval is
    halved, in ln of the value unless `log` is off. The value returned was itself found
    feasible.
    """
    for _ in range(halvings):
        middle = math.sqrt(good * bad) if log else 0.5 * (good + bad)
        good, bad = (middle, bad) if feasible(middle) else (good, middle)
    return good


def refuse(
    task: Task,
    attempt: Attempt,
    found: tuple[ClosedForm, ...],
    fastest: float,
    *,
    nearest: bool = True,
) -> NoReturn:
    """Raise InfeasibleError with the binding condition and, with `nearest`, the nearest
    feasible request.

    `found` are the solutions of the two equations, admissible or not; `fastest` [rad/s]
    is the crossover that the motor loop and the sampling admit at most.
    """
    condition, reason = _reason(task, found)
    if not nearest:
        raise InfeasibleError(condition, reason, {})
    # Just inside what `task_of` refuses; in the paper's reading nothing bounds a
    # crossover, and 1e4 rad/s is beyond any arm.
    top = 0.999 * (fastest if task.inside else 1e4)
    start = min(task.low ** (2.0 / task.model.order), top) / 3.0
    # Steps of 2.3° and, from a third of the heaviest payload's resonance on, of some
    # percent: finer than what a person would try next, and the edge itself is then
    # found by halving.
    margin = _nearest(
        task, "phase_margin", np.linspace(0.01, math.pi - 0.01, 80), attempt
    )
    crossover = _nearest(task, "gain_crossover", np.geomspace(start, top, 60), attempt)
    parts, offer, change = [reason], {}, math.inf
    asked = {"phase_margin": task.phase_margin, "gain_crossover": task.gain_crossover}
    if margin is not None:
        word = "largest" if margin < task.phase_margin else "smallest"
        degrees = math.degrees(margin)
        parts.append(
            f"at {task.gain_crossover:.6g} rad/s the {word} phase margin is {degrees:.4g}°"
        )
        change = abs(math.log(margin / task.phase_margin))
        offer = asked | {"phase_margin": margin}
    if crossover is not None:
        word = "highest" if crossover < task.gain_crossover else "lowest"
        degrees = math.degrees(task.phase_margin)
        parts.append(
            f"with {degrees:.4g}° the {word} gain crossover is {crossover:.6g} rad/s"
        )
        # Near is a ratio: 10 % of a margin against 10 % of a crossover, whatever their
        # units.
        if abs(math.log(crossover / task.gain_crossover)) < change:
            offer = asked | {"gain_crossover": crossover}
    if not offer:
        offer = _both_lower(task, top, attempt)
        parts += [
            f"with {math.degrees(offer['phase_margin']):.3g}° and {offer['gain_crossover']:.6g} rad/s "
            "there is a controller"
            if offer
            else "no smaller margin at another crossover has a controller either"
        ]
    raise InfeasibleError(condition, "; ".join(parts), offer)


def _both_lower(task: Task, top: float, attempt: Attempt) -> dict[str, float]:
    """A smaller margin and the nearest crossover that has it: a late gauge may leave
    neither alone.

    It leaves a narrow band right of the modes, which is therefore searched in steps of
    2 %.
    """
    low, high = (float(Loop.ideal(task.model).peak(w0)) for w0 in (task.low, task.high))
    band = np.geomspace(0.8 * low, min(2.5 * high, top), 80)
    for margin in np.radians(np.arange(45.0, 5.0, -5.0)):
        if margin < task.phase_margin:
            crossover = _nearest(
                replace(task, phase_margin=float(margin)),
                "gain_crossover",
                band,
                attempt,
            )
            if crossover is not None:
                return {"phase_margin": float(margin), "gain_crossover": crossover}
    return {}


def _nearest(task: Task, field: str, values: Real, attempt: Attempt) -> float | None:
    """The feasible value of one field closest to the one asked for: a scan, then the
    boundary.
    """
    asked = float(getattr(task, field))

    def feasible(value: float) -> bool:
        if field == "phase_margin":
            return attempt(replace(task, phase_margin=value)) is not None
        return attempt(replace(task, gain_crossover=value)) is not None

    ordered = sorted(map(float, values), key=lambda v: abs(math.log(v / asked)))
    # Every third value first, the nearest first; the others only where none of these is
    # feasible. Between one that is and the last on its side that is not, halving finds
    # the edge.
    for part in (ordered[::3], [v for i, v in enumerate(ordered) if i % 3]):
        last = {True: asked, False: asked}
        for value in part:
            if feasible(value):
                # To 1e-5: an offer is typed in again with five or six digits.
                found = boundary(feasible, value, last[value > asked], halvings=14)
                short = _shortened(found, away=found > asked)
                return short if feasible(short) else found
            last[value > asked] = value
    return None


def _shortened(value: float, *, away: bool) -> float:
    """The value with five digits, rounded up where `away`, and down elsewhere: off the
    edge it lies on.
    """
    digit = 10.0 ** (4 - math.floor(math.log10(value)))
    return (math.ceil if away else math.floor)(value * digit) / digit


# The bound of a request behind a requirement that is not met.
_BOUNDS = {
    "noise gain": "noise_gain",
    "sensitivity peak": "max_sensitivity",
    "settling time": "settling_time",
    "loop gain at mode 2": "mode_gain",
    "loop gain at mode 3": "mode_gain",
}
_LOOSER = (
    0.0,
    1e-4,
    1e-3,
    1e-2,
    0.03,
    0.1,
    0.25,
)  # parts of a bound by which an offer may exceed the edge


def missed_bounds(requirements: tuple[Requirement, ...]) -> dict[str, float]:
    """Return the bounds that these requirements achieve, of those that are missed."""
    missed: dict[str, float] = {}
    for item in requirements:
        if not item.passed and item.name in _BOUNDS:
            name = _BOUNDS[item.name]
            missed[name] = max(item.achieved, missed.get(name, 0.0))
    return missed


def offered(
    nearest: dict[str, float],
    spec: Specification,
    misses: Callable[[Specification], dict[str, float] | None],
) -> dict[str, float]:
    """Return the nearest request in the words of `spec`, tried as a whole; empty where
    none near is feasible.

    `nearest` meets the one condition that refused `spec`; the other bounds may ask for
    more. `misses` tells which bounds a request misses and what it achieves instead:
    None where it meets all of them.
    """
    wanted: dict[str, Any] = dict(_worded(nearest, spec))

    def missing(values: dict[str, Any]) -> dict[str, float] | None:
        try:
            return misses(replace(spec, **values)) if values else {}
        except FieldError:
            # what would be needed is out of its range: nothing near is feasible
            return {}

    # What is missed is asked for as it was achieved, which may cost another bound:
    # three rounds let noise, Ms and the mode answer one another.
    for _ in range(3):
        missed = missing(wanted)
        if missed is None:
            return wanted
        if not missed:
            break
        wanted |= {
            name: value for name, value in missed.items() if math.isfinite(value)
        }

    def looser(share: float) -> dict[str, Any]:
        return {
            name: _loosened(name, value, share, spec) for name, value in wanted.items()
        }

    # Beyond a quarter the offer is another request, and better asked for anew.
    works = next((share for share in _LOOSER if missing(looser(share)) is None), None)
    if works is None:
        return {}
    short = _LOOSER[max(_LOOSER.index(works) - 1, 0)]
    # Halved seven times, the last step of the list ends within a thousandth of the
    # edge.
    edge = boundary(
        lambda share: missing(looser(share)) is None,
        works,
        short,
        halvings=7,
        log=False,
    )
    return looser(edge)


def _worded(nearest: dict[str, float], spec: Specification) -> dict[str, float]:
    """A crossover as settling time and a margin as Ms, where the request asked for
    these.
    """
    wanted = dict(nearest)
    if spec.settling_time is not None and "gain_crossover" in wanted:
        longest = max(spec.settling_time, 2.0 * math.pi / wanted["gain_crossover"])
        if longest > spec.settling_time * (1.0 + 1e-12):
            wanted["settling_time"] = _shortened(longest, away=True)
        if spec.gain_crossover is None:
            del wanted["gain_crossover"]
            wanted.setdefault("settling_time", spec.settling_time)
    if spec.phase_margin is None and "phase_margin" in wanted:
        # The margin that a bound on Ms asks for at least: the bound that this one
        # belongs to.
        largest = 0.5 / math.sin(0.5 * wanted.pop("phase_margin"))
        wanted["max_sensitivity"] = max(largest, spec.max_sensitivity or 0.0)
    return wanted


def _loosened(name: str, value: float, share: float, spec: Specification) -> float:
    """The value moved on, away from what was asked; one that is as it was asked stays."""
    asked = getattr(spec, name)
    if asked is not None and math.isclose(asked, value, rel_tol=1e-12):
        return value
    lower = name in ("phase_margin", "gain_crossover") and (
        asked is None or value < asked
    )
    return _shortened(value * (1.0 - share if lower else 1.0 + share), away=not lower)


def _reason(task: Task, found: tuple[ClosedForm, ...]) -> tuple[str, str]:
    """(condition, sentence) of the bound that is hit."""
    if not found:
        where = "below the Nyquist frequency " if task.inside else ""
        return (
            "phase margin unreachable",
            f"no ω̄_c {where}solves equation (55) for this phase margin",
        )
    # Of several inadmissible solutions the one in the middle of 0 < β < 2 is the
    # closest to being one.
    best = min(found, key=lambda s: abs(s.order - 1.0))
    violated = best.violated(task.model.order)
    if violated is None:
        return (
            "phase margin at the other gain crossing",
            f"β = {best.order:.6g} solves (55), but where |L| rises through one the loop passes -1 closer",
        )
    if "peak" not in violated:
        return (
            f"phase margin unreachable ({violated})",
            f"equation (55) asks for β = {best.order:.6g}",
        )
    needed = Loop.ideal(task.model).sufficient(task.low)
    return violated, (
        f"ω_c = {task.gain_crossover:.6g} rad/s lies left of the peak of |L|, where the margins fall the "
        f"other way; condition (39) asks for more than {needed:.6g} rad/s"
    )
