"""Bounds beside crossover and margin, and the nearest feasible request."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, NoReturn

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.controller import Controller
from fraclink._arm.loop import Loop
from fraclink._design.modes import higher_modes, mode_requirements
from fraclink._design.specification import Requirement, Specification
from fraclink.errors import InfeasibleError

if TYPE_CHECKING:
    from fraclink._design.equations import ClosedForm, Task

__all__ = [
    "bound_requirements",
    "boundary",
    "reach",
    "refuse",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Attempt = Callable[["Task"], "tuple[ClosedForm, int] | None"]
Figure = Callable[["Task", Controller], float]

_TURNS = 12


# ---- a bound as a boundary --------------------------------------------------------------------------------


def boundary(
    feasible: Callable[[float], bool], good: float, bad: float, *, halvings: int = 30, log: bool = True
) -> float:
    """Return the feasible value nearest to `bad`: the edge between `good` and `bad`, to 2^-`halvings`.

    What is feasible or not has no value whose root could be sought, so the interval is halved, in ln of the
    value unless `log` is off. The value returned was itself found feasible.
    """
    for _ in range(halvings):
        middle = math.sqrt(good * bad) if log else 0.5 * (good + bad)
        good, bad = (middle, bad) if feasible(middle) else (good, middle)
    return good


# ---- bounds -----------------------------------------------------------------------------------------------


def _worst(task: Task, controller: Controller) -> tuple[tuple[float, float], tuple[float, float]]:
    """((Ms, its ω₀), (noise gain, its ω₀)) over the payload range."""
    found = task.loop(controller).achieved(np.geomspace(task.low, task.high, 9), task.rig.period)
    pairs = []
    for values in (found.sensitivity_peak, found.noise_gain):
        at = int(np.argmax(values))
        pairs.append((float(values[at]), float(found.natural_frequency[at])))
    return pairs[0], pairs[1]


def _mode_gain(task: Task, controller: Controller) -> float:
    loop = task.full_loop(controller)
    modes = higher_modes(task.model, task.rig, loop, task.payloads)
    assert modes is not None  # noqa: S101  # a link with one mode was refused with the bound
    return float(np.max(modes.gains(loop)))


def bound_requirements(
    task: Task, controller: Controller, spec: Specification, slowest: float
) -> tuple[Requirement, ...]:
    """Return a requirement for each bound; `slowest` is the smallest crossover of the range [rad/s]."""
    found: list[Requirement] = []
    if spec.max_sensitivity is not None or spec.noise_gain is not None:
        (peak, at_peak), (noise, at_noise) = _worst(task, controller)
        where = task.model.payload_at
        if spec.max_sensitivity is not None:
            bound = spec.max_sensitivity
            found.append(Requirement.at_most("sensitivity peak", bound, peak, "", where(at_peak)))
        if spec.noise_gain is not None:
            found.append(Requirement.at_most("noise gain", spec.noise_gain, noise, "", where(at_noise)))
    if spec.settling_time is not None:
        time = 2.0 * math.pi / slowest if slowest else math.inf
        found.append(Requirement.at_most("settling time", spec.settling_time, time, "s", task.payloads[1]))
    if spec.mode_gain is not None:
        loop = task.full_loop(controller)
        modes = higher_modes(task.model, task.rig, loop, task.payloads)
        assert modes is not None  # noqa: S101  # a link with one mode was refused with the bound
        found += [item for _, item in mode_requirements(modes, loop, spec.mode_gain)]
    return tuple(found)


def reach(task: Task, spec: Specification, attempt: Attempt) -> Task:
    """Return the task changed so that the bounds are kept: more filter for noise and modes, margin for Ms.

    Raises InfeasibleError naming the bound that no filter or margin reaches.
    """

    def measured(figure: Figure) -> Callable[[Task], float]:
        def worst(changed: Task) -> float:
            found = attempt(changed)
            return math.inf if found is None else figure(changed, changed.controller(*found))

        return worst

    peak = measured(lambda changed, controller: _worst(changed, controller)[0][0])
    bounds = (
        ("noise_gain", spec.noise_gain, measured(lambda changed, found: _worst(changed, found)[1][0])),
        ("mode_gain", spec.mode_gain, measured(_mode_gain)),
    )
    for turn in range(_TURNS):
        before = task
        # More filter costs margin, more margin costs noise: after the first turn each asks for a little more
        # than its bound, so that both are kept after few.
        share = 1.0 if turn == 0 else 1.0 - 2e-3
        if spec.max_sensitivity is not None and spec.phase_margin is None:
            task = _raise_margin(task, spec.max_sensitivity, share, peak)
        for name, bound, worst in bounds:
            if bound is not None and spec.filter_time is None and task.inside:
                task = _raise_filter(task, name, bound, share, worst)
        if task == before:
            break
    return task


def _raise_margin(task: Task, asked: float, share: float, worst: Callable[[Task], float]) -> Task:
    """The smallest phase margin whose sensitivity peak is within `asked`."""
    if worst(task) <= asked:
        return task
    bound, bad, least = 1.0 + (asked - 1.0) * share, task.phase_margin, math.inf
    # A margin may have no controller at all (Ms infinite), and Ms need not fall all the way: a scan first,
    # and only then the edge between the last that failed and the first that does not.
    for margin in map(float, np.linspace(task.phase_margin, 0.9 * math.pi, 40)):
        found = worst(replace(task, phase_margin=margin))
        least = min(least, found)
        if found <= bound:
            break
        bad = margin
    else:
        raise InfeasibleError(
            "sensitivity peak",
            f"no phase margin at {task.gain_crossover:.6g} rad/s brings Ms to {asked:g}",
            # A part in 1e4 above the least: the printed digits of an offer must themselves be feasible.
            {"max_sensitivity": 1.0001 * least} if math.isfinite(least) else None,
        )
    if margin > bad:
        margin = boundary(
            lambda value: worst(replace(task, phase_margin=value)) <= bound, margin, bad, log=False
        )
    return replace(task, phase_margin=margin)


def _raise_filter(task: Task, name: str, bound: float, share: float, worst: Callable[[Task], float]) -> Task:
    """The rule's filter where it is enough, else the shortest that keeps the figure `name` within `bound`.

    Where n is free, the n is taken whose filter lags least at the crossover asked for.
    """
    ruled = worst(task)
    if ruled <= bound:
        return task
    orders = (1, 2) if task.filter_order is None else (task.filter_order,)
    tried = [_shortest(replace(task, filter_order=n), bound * share, worst) for n in orders]
    made = [found for found, _ in tried if found is not None]
    if not made:
        least = min([ruled, *(value for _, value in tried)])
        if least == math.inf:
            return task  # crossover and margin are infeasible with any filter: `refuse` names the nearest
        words = name.replace("_", " ")
        raise InfeasibleError(
            words,
            f"no filter keeps the {words} within {bound:g} at this crossover and margin",
            {name: 1.0001 * least},
        )
    return min(made, key=_lag)


def _lag(task: Task) -> float:
    time, order = task.filter_time or 0.0, task.filter_order or 1
    return order * math.atan(time * task.gain_crossover)


def _shortest(task: Task, bound: float, worst: Callable[[Task], float]) -> tuple[Task | None, float]:
    """(the task with the shortest δ within `bound`, None where there is none; the least that was seen)."""
    bad, least = task.filter_time or 1e-5, math.inf
    # From 0.1 ms, below every control period, to 1 s in steps of 27 %.
    for time in map(float, np.geomspace(max(1e-4, 1.001 * bad), 1.0, 40)):
        found = worst(replace(task, filter_time=time))
        least = min(least, found)
        if found <= bound:
            best = boundary(lambda value: worst(replace(task, filter_time=value)) <= bound, time, bad)
            return replace(task, filter_time=best), least
        bad = time
    return None, least


# ---- the nearest feasible request -------------------------------------------------------------------------


def refuse(task: Task, attempt: Attempt, found: tuple[ClosedForm, ...], fastest: float) -> NoReturn:
    """Raise InfeasibleError with the binding condition and the nearest feasible request.

    `found` are the solutions of the two equations, admissible or not; `fastest` [rad/s] is the crossover
    that the motor loop and the sampling admit at most.
    """
    top = 0.999 * (fastest if task.inside else 1e4)
    start = min(task.low ** (2.0 / task.model.order), top) / 3.0
    # Steps of 2.3° and, from a third of the heaviest payload's resonance on, of some percent: finer than what
    # a person would try next, and the edge itself is then found by halving.
    margin = _nearest(task, "phase_margin", np.linspace(0.01, math.pi - 0.01, 80), attempt)
    crossover = _nearest(task, "gain_crossover", np.geomspace(start, top, 60), attempt)
    condition, reason = _reason(task, found)
    parts, nearest, change = [reason], {}, math.inf
    asked = {"phase_margin": task.phase_margin, "gain_crossover": task.gain_crossover}
    if margin is not None:
        word = "largest" if margin < task.phase_margin else "smallest"
        degrees = math.degrees(margin)
        parts.append(f"at {task.gain_crossover:.6g} rad/s the {word} phase margin is {degrees:.4g}°")
        change = abs(math.log(margin / task.phase_margin))
        nearest = asked | {"phase_margin": margin}
    if crossover is not None:
        word = "highest" if crossover < task.gain_crossover else "lowest"
        degrees = math.degrees(task.phase_margin)
        parts.append(f"with {degrees:.4g}° the {word} gain crossover is {crossover:.6g} rad/s")
        if abs(math.log(crossover / task.gain_crossover)) < change:
            nearest = asked | {"gain_crossover": crossover}
    if not nearest:
        nearest = _both_lower(task, top, attempt)
        parts += [
            f"with {math.degrees(nearest['phase_margin']):.3g}° and {nearest['gain_crossover']:.6g} rad/s "
            "there is a controller"
            if nearest
            else "no smaller margin at another crossover has a controller either"
        ]
    raise InfeasibleError(condition, "; ".join(parts), nearest)


def _both_lower(task: Task, top: float, attempt: Attempt) -> dict[str, float]:
    """A smaller margin and the nearest crossover that has it: a late gauge may leave neither alone.

    It leaves a narrow band right of the modes, which is therefore searched in steps of 2 %.
    """
    low, high = (float(Loop.ideal(task.model).peak(w0)) for w0 in (task.low, task.high))
    band = np.geomspace(0.8 * low, min(2.5 * high, top), 80)
    for margin in np.radians([40.0, 30.0, 20.0, 10.0]):
        if margin < task.phase_margin:
            crossover = _nearest(replace(task, phase_margin=float(margin)), "gain_crossover", band, attempt)
            if crossover is not None:
                return {"phase_margin": float(margin), "gain_crossover": crossover}
    return {}


def _nearest(task: Task, field: str, values: Real, attempt: Attempt) -> float | None:
    """The feasible value of one field closest to the one asked for: a scan, then the boundary."""
    asked = float(getattr(task, field))

    def feasible(value: float) -> bool:
        if field == "phase_margin":
            return attempt(replace(task, phase_margin=value)) is not None
        return attempt(replace(task, gain_crossover=value)) is not None

    for value in sorted(map(float, values), key=lambda v: abs(math.log(v / asked))):
        if feasible(value):
            # To about 1e-8 and not to the last bit: what is offered must pass when it is typed in again.
            return boundary(feasible, value, asked, halvings=20)
    return None


def _reason(task: Task, found: tuple[ClosedForm, ...]) -> tuple[str, str]:
    """(condition, sentence) of the bound that is hit."""
    if not found:
        where = "below the Nyquist frequency " if task.inside else ""
        return "phase margin unreachable", f"no ω̄_c {where}solves equation (55) for this phase margin"
    # Of several inadmissible solutions the one in the middle of 0 < β < 2 is the closest to being one.
    best = min(found, key=lambda s: abs(s.order - 1.0))
    violated = best.violated(task.model.order)
    if violated is None:
        return (
            "phase margin at the other gain crossing",
            f"β = {best.order:.6g} solves (55), but where |L| rises through one the loop passes -1 closer",
        )
    if "peak" not in violated:
        return f"phase margin unreachable ({violated})", f"equation (55) asks for β = {best.order:.6g}"
    needed = Loop.ideal(task.model).sufficient(task.low)
    return violated, (
        f"ω_c = {task.gain_crossover:.6g} rad/s lies left of the peak of |L|, where the margins fall the "
        f"other way; condition (39) asks for more than {needed:.6g} rad/s"
    )
