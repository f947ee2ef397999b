"""Bounds beside crossover and margin: what a controller makes of them, and the filter
or margin they need.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from fraclink._arm.controller import Controller
from fraclink._design.modes import higher_modes, mode_requirements
from fraclink._law.design import Requirement, Specification
from fraclink.errors import InfeasibleError

if TYPE_CHECKING:
    from fraclink._design.equations import ClosedForm, Task

__all__ = ["Attempt", "bound_requirements", "reach"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Attempt = Callable[["Task"], "tuple[ClosedForm, int] | None"]
Figure = Callable[["Task", Controller], float]

# Filter and margin answer each other: two or three turns settle it, and twelve are far
# beyond.
_TURNS = 12
_LINKS = 9  # of the range, at which Ms and noise are asked for: both are smooth over ω₀


# ---- a bound as an edge --------------------------------------------------------------------------------


def edge(
    figure: Callable[[float], float], bound: float, good: float, bad: float
) -> float:
    """Return the value nearest to `bad` whose `figure` is within `bound`: it is at
    `good`, hardly at `bad`.

    The figure is continuous where there is a controller, and infinite where there is
    none: the interval is halved until both ends have one, and the root is then a tenth
    of the work.
    """

    known: dict[float, float] = {}  # ln of a value: its figure

    # In logarithms: margins and filters span decades, and the figures fall like powers
    # of them.
    def excess(log: float) -> float:
        if log not in known:
            known[log] = figure(math.exp(log))
        return math.log(known[log] / bound) if math.isfinite(known[log]) else 1.0

    near, far = math.log(bad), math.log(good)
    # The ends are the values that were judged, and not what rounding makes of their
    # logarithms.
    known |= {near: figure(bad), far: figure(good)}
    if known[near] <= bound:
        return bad
    for _ in range(30):
        if math.isfinite(known[near]):
            break
        middle = 0.5 * (near + far)
        near, far = (near, middle) if excess(middle) <= 0.0 else (middle, far)
    brentq(excess, near, far, xtol=1e-11, rtol=1e-11, maxiter=60, disp=False)
    # The root lies on either side of the bound: what is returned was itself found
    # within it.
    within = [log for log, found in known.items() if found <= bound]
    best = min(within, key=lambda log: abs(log - near))
    return good if best == math.log(good) else math.exp(best)


def first_within(
    figure: Callable[[float], float], bound: float, start: float, values: Real
) -> tuple[tuple[float, float] | None, float]:
    """((a value whose figure is within `bound`, one before it whose is not), the least
    figure seen).

    `start` lies before all `values` and is not within. Every fourth value first: as a
    rule the figure falls all the way. Then the others, where that finds none.
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


def _worst(
    task: Task, controller: Controller
) -> tuple[tuple[float, float], tuple[float, float]]:
    """((Ms, its ω₀), (noise gain, its ω₀)) over the payload range."""
    found = task.loop(controller).achieved(
        np.geomspace(task.low, task.high, _LINKS), task.rig.period
    )
    pairs = []
    for values in (found.sensitivity_peak, found.noise_gain):
        at = int(np.argmax(values))
        pairs.append((float(values[at]), float(found.natural_frequency[at])))
    return pairs[0], pairs[1]


def _peak(task: Task, controller: Controller) -> float:
    loop, links = task.loop(controller), np.geomspace(task.low, task.high, _LINKS)
    # An unstable loop may keep its distance from −1: 1/|1 + L| alone would take it for
    # a good one.
    stable = bool(np.all(loop.margins(links)[1] > 0.0))
    return float(np.max(loop.sensitivity_peak(links))) if stable else math.inf


def _noise(task: Task, controller: Controller) -> float:
    links = np.geomspace(task.low, task.high, _LINKS)
    return float(np.max(task.loop(controller).noise_gain(links, task.rig.period)))


def _mode_gain(task: Task) -> Figure:
    """The largest loop gain at a higher mode, as a function of a controller; the modes
    are those of any.
    """
    modes = higher_modes(task.model, task.rig, task.bare(1), task.payloads)
    assert modes is not None  # a link with one mode was refused with the bound  # noqa: S101
    return lambda changed, controller: float(
        np.max(modes.gains(changed.full_loop(controller)))
    )


def bound_requirements(
    task: Task, controller: Controller, spec: Specification, slowest: float
) -> tuple[Requirement, ...]:
    """Return a requirement for each bound; `slowest` is the smallest crossover of the
    range [rad/s].
    """
    found: list[Requirement] = []
    if spec.max_sensitivity is not None or spec.noise_gain is not None:
        (peak, at_peak), (noise, at_noise) = _worst(task, controller)
        where = task.model.payload_at
        if spec.max_sensitivity is not None:
            bound = spec.max_sensitivity
            found.append(
                Requirement.at_most("sensitivity peak", bound, peak, "", where(at_peak))
            )
        if spec.noise_gain is not None:
            found.append(
                Requirement.at_most(
                    "noise gain", spec.noise_gain, noise, "", where(at_noise)
                )
            )
    if spec.settling_time is not None:
        # Section 6 of the paper takes 2π/ω_c for the settling time; the slowest
        # crossover of the range decides.
        time = 2.0 * math.pi / slowest if slowest else math.inf
        found.append(
            Requirement.at_most(
                "settling time", spec.settling_time, time, "s", task.payloads[1]
            )
        )
    if spec.mode_gain is not None:
        loop = task.full_loop(controller)
        modes = higher_modes(task.model, task.rig, loop, task.payloads)
        assert modes is not None  # a link with one mode was refused with the bound  # noqa: S101
        found += [item for _, item in mode_requirements(modes, loop, spec.mode_gain)]
    return tuple(found)


def reach(task: Task, spec: Specification, attempt: Attempt) -> Task:
    """Return the task changed so that the bounds are kept: more filter for noise and
    modes, margin for Ms.

    Raises InfeasibleError naming the bound that no filter or margin reaches.
    """

    def measured(figure: Figure) -> Callable[[Task], float]:
        def worst(changed: Task) -> float:
            found = attempt(changed)
            return (
                math.inf
                if found is None
                else figure(changed, changed.controller(*found))
            )

        return worst

    peak = measured(_peak)
    bounds = [("noise_gain", spec.noise_gain, measured(_noise))]
    if spec.mode_gain is not None:
        bounds.append(("mode_gain", spec.mode_gain, measured(_mode_gain(task))))
    for turn in range(_TURNS):
        before = task
        # More filter costs margin, more margin costs noise: after the first turn each
        # asks for a little more than its bound, so that both are kept after few.
        share = 1.0 if turn == 0 else 1.0 - 2e-3
        if spec.max_sensitivity is not None and spec.phase_margin is None:
            task = _raise_margin(task, spec.max_sensitivity, share, peak)
        for name, bound, worst in bounds:
            # A filter that was given is kept, and what it misses is reported. In the
            # paper's reading it stands behind the equations, where it could reach no
            # bound.
            if bound is not None and spec.filter_time is None and task.inside:
                task = _raise_filter(task, name, bound, share, worst)
        if task == before:
            break
    return task


def _raise_margin(
    task: Task, asked: float, share: float, worst: Callable[[Task], float]
) -> Task:
    """The smallest phase margin whose sensitivity peak is within `asked`."""
    if worst(task) <= asked:
        return task
    # Steps of 2.8° from 50° on. Above the mode the link's own phase is −λπ/2, so that
    # (55) asks for β = λ − 2 (1 − φ_m/π): at 0.9 π that is 0.2 below the λ at which
    # Theorem 1 ends.
    bound, margins = (
        1.0 + (asked - 1.0) * share,
        np.linspace(task.phase_margin, 0.9 * math.pi, 41),
    )

    def figure(margin: float) -> float:
        return worst(replace(task, phase_margin=margin))

    # A margin may have no controller at all (Ms infinite), and Ms need not fall all the
    # way: a scan first, and only then the edge between one that failed and one that
    # does not.
    ends, least = first_within(figure, bound, task.phase_margin, margins[1:])
    if ends is None:
        raise InfeasibleError(
            "sensitivity peak",
            f"no phase margin at {task.gain_crossover:.6g} rad/s brings Ms to {asked:g}",
            {"max_sensitivity": least} if math.isfinite(least) else None,
        )
    return replace(task, phase_margin=edge(figure, bound, *ends))


def _raise_filter(
    task: Task, name: str, bound: float, share: float, worst: Callable[[Task], float]
) -> Task:
    """The rule's filter where it is enough, else the shortest that keeps the figure
    `name` within `bound`.

    Where n is free, the n is taken whose filter lags least at the crossover asked for.
    """
    ruled = worst(task)
    if ruled <= bound:
        return task
    # Which n lags less for the same bound depends on how far above the crossover the
    # noise or the mode lies: both are tried.
    orders = (1, 2) if task.filter_order is None else (task.filter_order,)
    tried = [
        _shortest(replace(task, filter_order=n), bound * share, worst) for n in orders
    ]
    made = [found for found, _ in tried if found is not None]
    if not made:
        least = min([ruled, *(value for _, value in tried)])
        if least == math.inf:
            # crossover and margin are infeasible with any filter: `refuse` names the
            # nearest
            return task
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


def _shortest(
    task: Task, bound: float, worst: Callable[[Task], float]
) -> tuple[Task | None, float]:
    """(the task with the shortest δ within `bound`, None where there is none; the least
    that was seen).
    """

    def figure(time: float) -> float:
        return worst(replace(task, filter_time=time))

    start = task.filter_time or 1e-5
    # From 0.1 ms, below every control period, to 1 s in steps of 27 %.
    ends, least = first_within(
        figure, bound, start, np.geomspace(max(1e-4, 1.001 * start), 1.0, 40)
    )
    return None if ends is None else replace(
        task, filter_time=edge(figure, bound, *ends)
    ), least
