"""Bounds instead of, or beside, crossover and margin: sensitivity peak, noise gain, settling time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fraclink.design.measure import measure
from fraclink.design.plan import Requirement, open_loop
from fraclink.design.request import Request, payload_of
from fraclink.errors import FieldError, InfeasibleError
from fraclink.quantity import checked_between

if TYPE_CHECKING:
    from fraclink.controller import Controller
    from fraclink.design.solve import Solution
    from fraclink.rig import Rig

__all__ = ["Goals", "check_goals", "goal_requirements", "reach"]

Attempt = Callable[[Request], "tuple[Solution, int] | None"]


@dataclass(frozen=True)
class Goals:
    """Bounds a design must keep; None where nothing is asked."""

    max_sensitivity: float | None = None  # Ms
    noise_gain: float | None = None
    settling_time: float | None = None  # s

    @property
    def any(self) -> bool:
        """Whether anything is asked."""
        return not (self.max_sensitivity is None and self.noise_gain is None and self.settling_time is None)


def check_goals(max_sensitivity: object, noise_gain: object, settling_time: object) -> Goals:
    """Return the bounds with every number checked."""

    def number(field: str, value: object, low: float, high: float, unit: str) -> float | None:
        return None if value is None else checked_between(field, value, low, high, unit, open_low=True)

    return Goals(
        number("max_sensitivity", max_sensitivity, 1.0, 100.0, ""),
        number("noise_gain", noise_gain, 0.0, 1e6, ""),
        number("settling_time", settling_time, 0.0, 1e4, "s"),
    )


def crossover_for(goals: Goals, gain_crossover: object) -> object:
    """The crossover asked for; ``2π/t_s`` (section 6) where only a settling time is."""
    if gain_crossover is not None:
        return gain_crossover
    if goals.settling_time is None:
        raise FieldError(
            "gain_crossover", None, "missing", allowed="> 0 rad/s", remedy="give it, or a settling_time"
        )
    return 2.0 * math.pi / goals.settling_time


def margin_for(goals: Goals, phase_margin: object) -> object:
    """The margin asked for; where only Ms is, the least that it allows, ``2 asin(1/(2 Ms))``."""
    if phase_margin is not None:
        return phase_margin
    if goals.max_sensitivity is None:
        raise FieldError(
            "phase_margin", None, "missing", allowed="> 0 rad", remedy="give it, or a max_sensitivity"
        )
    return 2.0 * math.asin(0.5 / goals.max_sensitivity)


def _worst(request: Request, rig: Rig, controller: Controller) -> tuple[tuple[float, float], ...]:
    """((Ms, its ϖ), (noise gain, its ϖ)) over the payload range."""
    loop = open_loop(controller, request.model, rig, margins=request.margins)
    highest = math.pi / request.period if request.margins == "loop" else math.inf
    got = measure(loop, np.geomspace(request.low, request.high, 9), request.period, highest=highest)
    pairs = []
    for values in (got.sensitivity_peak, got.noise_gain):
        at = int(np.argmax(values))
        pairs.append((float(values[at]), float(got.natural_frequency[at])))
    return tuple(pairs)


def goal_requirements(
    request: Request, rig: Rig, controller: Controller, goals: Goals, slowest: float
) -> tuple[Requirement, ...]:
    """Return a requirement for each bound; `slowest` is the smallest crossover of the range [rad/s]."""
    if not goals.any:
        return ()
    (peak, at_peak), (noise, at_noise) = _worst(request, rig, controller)
    found = []
    if goals.max_sensitivity is not None:
        place = payload_of(request.model, rig, at_peak)
        found.append(Requirement.at_most("sensitivity peak", goals.max_sensitivity, peak, "", place))
    if goals.noise_gain is not None:
        place = payload_of(request.model, rig, at_noise)
        found.append(Requirement.at_most("noise gain", goals.noise_gain, noise, "", place))
    if goals.settling_time is not None:
        time = 2.0 * math.pi / slowest
        found.append(
            Requirement.at_most("settling time", goals.settling_time, time, "s", request.payloads[1])
        )
    return tuple(found)


def reach(
    request: Request,
    rig: Rig,
    goals: Goals,
    attempt: Attempt,
    controller_of: Callable[[Request, Solution, int], Controller],
    *,
    free_margin: bool,
) -> Request:
    """Return the request changed so that the bounds hold: more filter for noise, more margin for Ms.

    Raises InfeasibleError naming the bound that no filter or margin reaches.
    """

    def worst(changed: Request) -> tuple[float, float] | None:
        found = attempt(changed)
        if found is None:
            return None
        (peak, _), (noise, _) = _worst(changed, rig, controller_of(changed, *found))
        return peak, noise

    free_filter = request.filter_time is None and request.margins == "loop"
    for turn in range(_TURNS):
        before = request
        # More filter costs margin, more margin costs noise: after the first turn each asks for a little more
        # than its bound, so that both hold after few.
        share = 1.0 if turn == 0 else 1.0 - 2e-3
        if goals.max_sensitivity is not None and free_margin:
            request = _raise_margin(request, goals.max_sensitivity, share, worst)
        if goals.noise_gain is not None and free_filter:
            request = _raise_filter(request, goals.noise_gain, share, worst)
        if request == before:
            break
    return request


_TURNS = 12
Worst = Callable[[Request], "tuple[float, float] | None"]


def _raise_margin(request: Request, bound: float, share: float, worst: Worst) -> Request:
    """The smallest phase margin whose sensitivity peak is within `bound`."""
    start, asked = request.phase_margin, bound
    now = worst(request)
    if now is not None and now[0] <= bound:
        return request
    bound = 1.0 + (bound - 1.0) * share
    bad, best = start, math.inf
    for margin in np.linspace(start, 0.9 * math.pi, 40):
        got = worst(replace(request, phase_margin=float(margin)))
        best = min(best, got[0]) if got else best
        if got and got[0] <= bound:
            good = float(margin)
            break
        bad = float(margin)
    else:
        raise InfeasibleError(
            "sensitivity peak",
            f"no phase margin at {request.gain_crossover:.6g} rad/s brings Ms to {asked:g}",
            {"max_sensitivity": 1.0001 * best} if math.isfinite(best) else None,
        )
    for _ in range(30 if good > bad else 0):
        middle = 0.5 * (good + bad)
        got = worst(replace(request, phase_margin=middle))
        good, bad = (middle, bad) if got and got[0] <= bound else (good, middle)
    return replace(request, phase_margin=good)


def _raise_filter(request: Request, bound: float, share: float, worst: Worst) -> Request:
    """The rule's filter where it is enough, else the shortest δ that keeps the noise within `bound`."""
    ruled = worst(request)
    if ruled is not None and ruled[1] <= bound:
        return request
    asked, bound = bound, bound * share
    bad, least = request.filter_time or 1e-5, math.inf if ruled is None else ruled[1]
    for time in np.geomspace(max(1e-4, 1.001 * bad), 1.0, 40):
        got = worst(replace(request, filter_time=float(time)))
        least = min(least, got[1]) if got else least
        if got and got[1] <= bound:
            good = float(time)
            break
        bad = float(time)
    else:
        raise InfeasibleError(
            "noise gain",
            f"no filter keeps the noise gain within {asked:g} at this crossover and margin",
            {"noise_gain": 1.0001 * least} if math.isfinite(least) else None,
        )
    for _ in range(30):
        middle = math.sqrt(good * bad)
        got = worst(replace(request, filter_time=middle))
        good, bad = (middle, bad) if got and got[1] <= bound else (good, middle)
    return replace(request, filter_time=good)
