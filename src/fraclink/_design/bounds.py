"""Bounds beside crossover and margin, and the nearest feasible request."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn

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
    "missed_bounds",
    "offered",
    "reach",
    "refuse",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Attempt = Callable[["Task"], "tuple[ClosedForm, int] | None"]
Figure = Callable[["Task", Controller], float]

_TURNS = 12
_LINKS = 9  # of the range, at which Ms and noise are asked for: both are smooth over ω₀


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


def edge(figure: Callable[[float], float], bound: float, good: float, bad: float) -> float:
    """Return the value nearest to `bad` whose `figure` is within `bound`: it is at `good`, hardly at `bad`.

    The figure is continuous where there is a controller, and infinite where there is none: the interval is
    halved until both ends have one, and the root is then a tenth of the work.
    """
    from scipy.optimize import brentq

    known: dict[float, float] = {}  # ln of a value: its figure

    def excess(log: float) -> float:
        if log not in known:
            known[log] = figure(math.exp(log))
        return math.log(known[log] / bound) if math.isfinite(known[log]) else 1.0

    near, far = math.log(bad), math.log(good)
    # The ends are the values that were judged, and not what rounding makes of their logarithms.
    known |= {near: figure(bad), far: figure(good)}
    if known[near] <= bound:
        return bad
    for _ in range(30):
        if math.isfinite(known[near]):
            break
        middle = 0.5 * (near + far)
        near, far = (near, middle) if excess(middle) <= 0.0 else (middle, far)
    brentq(excess, near, far, xtol=1e-11, rtol=1e-11, maxiter=60, disp=False)
    # The root lies on either side of the bound: what is returned was itself found within it.
    within = [log for log, found in known.items() if found <= bound]
    best = min(within, key=lambda log: abs(log - near))
    return good if best == math.log(good) else math.exp(best)


def first_within(
    figure: Callable[[float], float], bound: float, start: float, values: Real
) -> tuple[tuple[float, float] | None, float]:
    """((a value whose figure is within `bound`, one before it whose is not), the least figure seen).

    `start` lies before all `values` and is not within. Every fourth value first: as a rule the figure falls
    all the way. Then the others, where that finds none.
    """
    least = math.inf
    for part in (values[3::4], np.delete(values, np.s_[3::4])):
        bad = start
        for value in map(float, part):
            found = figure(value)
            least = min(least, found)
            if found <= bound:
                return (value, bad), least
            bad = value
    return None, least


# ---- bounds -----------------------------------------------------------------------------------------------


def _worst(task: Task, controller: Controller) -> tuple[tuple[float, float], tuple[float, float]]:
    """((Ms, its ω₀), (noise gain, its ω₀)) over the payload range."""
    found = task.loop(controller).achieved(np.geomspace(task.low, task.high, _LINKS), task.rig.period)
    pairs = []
    for values in (found.sensitivity_peak, found.noise_gain):
        at = int(np.argmax(values))
        pairs.append((float(values[at]), float(found.natural_frequency[at])))
    return pairs[0], pairs[1]


def _peak(task: Task, controller: Controller) -> float:
    loop, links = task.loop(controller), np.geomspace(task.low, task.high, _LINKS)
    stable = bool(np.all(loop.margins(links)[1] > 0.0))
    return float(np.max(loop.sensitivity_peak(links))) if stable else math.inf


def _noise(task: Task, controller: Controller) -> float:
    links = np.geomspace(task.low, task.high, _LINKS)
    return float(np.max(task.loop(controller).noise_gain(links, task.rig.period)))


def _mode_gain(task: Task) -> Figure:
    """The largest loop gain at a higher mode, as a function of a controller; the modes are those of any."""
    modes = higher_modes(task.model, task.rig, task.bare(1), task.payloads)
    assert modes is not None  # noqa: S101  # a link with one mode was refused with the bound
    return lambda changed, controller: float(np.max(modes.gains(changed.full_loop(controller))))


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

    peak = measured(_peak)
    bounds = [("noise_gain", spec.noise_gain, measured(_noise))]
    if spec.mode_gain is not None:
        bounds.append(("mode_gain", spec.mode_gain, measured(_mode_gain(task))))
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
    bound, margins = 1.0 + (asked - 1.0) * share, np.linspace(task.phase_margin, 0.9 * math.pi, 41)

    def figure(margin: float) -> float:
        return worst(replace(task, phase_margin=margin))

    # A margin may have no controller at all (Ms infinite), and Ms need not fall all the way: a scan first,
    # and only then the edge between one that failed and one that does not.
    ends, least = first_within(figure, bound, task.phase_margin, margins[1:])
    if ends is None:
        raise InfeasibleError(
            "sensitivity peak",
            f"no phase margin at {task.gain_crossover:.6g} rad/s brings Ms to {asked:g}",
            {"max_sensitivity": least} if math.isfinite(least) else None,
        )
    return replace(task, phase_margin=edge(figure, bound, *ends))


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
            {name: least},
        )
    return min(made, key=_lag)


def _lag(task: Task) -> float:
    time, order = task.filter_time or 0.0, task.filter_order or 1
    return order * math.atan(time * task.gain_crossover)


def _shortest(task: Task, bound: float, worst: Callable[[Task], float]) -> tuple[Task | None, float]:
    """(the task with the shortest δ within `bound`, None where there is none; the least that was seen)."""

    def figure(time: float) -> float:
        return worst(replace(task, filter_time=time))

    start = task.filter_time or 1e-5
    # From 0.1 ms, below every control period, to 1 s in steps of 27 %.
    ends, least = first_within(figure, bound, start, np.geomspace(max(1e-4, 1.001 * start), 1.0, 40))
    return None if ends is None else replace(task, filter_time=edge(figure, bound, *ends)), least


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

    ordered = sorted(map(float, values), key=lambda v: abs(math.log(v / asked)))
    # Every third value first, the nearest first; the others only where none of these is feasible. Between
    # one that is and the last on its side that is not, halving finds the edge.
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
    """The value with five digits, rounded up where `away`, and down elsewhere: off the edge it lies on."""
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
_LOOSER = (0.0, 1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.25)  # parts of a bound by which an offer may exceed the edge


def missed_bounds(requirements: tuple[Requirement, ...]) -> dict[str, float]:
    """Return the bounds that these requirements achieve, of those that are missed."""
    missed: dict[str, float] = {}
    for item in requirements:
        if not item.passed and item.name in _BOUNDS:
            name = _BOUNDS[item.name]
            missed[name] = max(item.achieved, missed.get(name, 0.0))
    return missed


def offered(
    nearest: dict[str, float], spec: Specification, misses: Callable[[Specification], dict[str, float] | None]
) -> dict[str, float]:
    """Return the nearest request in the words of `spec`, tried as a whole; empty where none near is feasible.

    `nearest` meets the one condition that refused `spec`; the other bounds may ask for more. `misses` tells
    which bounds a request misses and what it achieves instead: None where it meets all of them.
    """
    wanted: dict[str, Any] = dict(_worded(nearest, spec))
    for _ in range(3):
        missed = misses(replace(spec, **wanted)) if wanted else {}
        if missed is None:
            return wanted
        if not missed:
            break
        wanted |= {name: value for name, value in missed.items() if math.isfinite(value)}
    for share in _LOOSER:
        trial: dict[str, Any] = {name: _loosened(name, value, share, spec) for name, value in wanted.items()}
        if wanted and misses(replace(spec, **trial)) is None:
            return trial
    return {}


def _worded(nearest: dict[str, float], spec: Specification) -> dict[str, float]:
    """A crossover as settling time and a margin as Ms, where the request asked for these."""
    wanted = dict(nearest)
    if spec.settling_time is not None and "gain_crossover" in wanted:
        longest = max(spec.settling_time, 2.0 * math.pi / wanted["gain_crossover"])
        if longest > spec.settling_time * (1.0 + 1e-12):
            wanted["settling_time"] = _shortened(longest, away=True)
        if spec.gain_crossover is None:
            del wanted["gain_crossover"]
            wanted.setdefault("settling_time", spec.settling_time)
    if spec.phase_margin is None and "phase_margin" in wanted:
        # The margin that a bound on Ms asks for at least: the bound that this one belongs to.
        largest = 0.5 / math.sin(0.5 * wanted.pop("phase_margin"))
        wanted["max_sensitivity"] = max(largest, spec.max_sensitivity or 0.0)
    return wanted


def _loosened(name: str, value: float, share: float, spec: Specification) -> float:
    """The value moved on, away from what was asked; one that is as it was asked stays."""
    asked = getattr(spec, name)
    if asked is not None and math.isclose(asked, value, rel_tol=1e-12):
        return value
    lower = name in ("phase_margin", "gain_crossover") and (asked is None or value < asked)
    return _shortened(value * (1.0 - share if lower else 1.0 + share), away=not lower)


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
