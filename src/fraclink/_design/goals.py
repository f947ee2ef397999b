"""Bounds instead of, or beside, crossover and margin: on Ms, noise, settling time and higher modes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fraclink._design.higher_modes import HigherModes, higher_modes, spillover_requirements
from fraclink._design.measure import measure
from fraclink._design.plan import Requirement, open_loop
from fraclink._design.request import Request, payload_of
from fraclink._validate import checked_between
from fraclink.errors import FieldError, InfeasibleError

if TYPE_CHECKING:
    from fraclink._arm.controller import Controller
    from fraclink._arm.rig import Rig
    from fraclink._design.loop import OpenLoop
    from fraclink._design.solve import Solution

__all__ = ["Goals", "check_goals", "goal_requirements", "reach"]

Attempt = Callable[[Request], "tuple[Solution, int] | None"]


@dataclass(frozen=True)
class Goals:
    """Bounds a design must keep; None where nothing is asked."""

    max_sensitivity: float | None = None  # Ms
    noise_gain: float | None = None
    settling_time: float | None = None  # s
    mode_gain: float | None = None  # of the loop at modes 2 and 3 of the link

    @property
    def any(self) -> bool:
        """Whether anything is asked."""
        asked = (self.max_sensitivity, self.noise_gain, self.settling_time, self.mode_gain)
        return any(bound is not None for bound in asked)


def check_goals(
    max_sensitivity: object, noise_gain: object, settling_time: object, mode_gain: object, rig: Rig
) -> Goals:
    """Return the bounds with every number checked."""

    def number(field: str, value: object, low: float, high: float, unit: str) -> float | None:
        return None if value is None else checked_between(field, value, low, high, unit, open_low=True)

    if mode_gain is not None and rig.link.mass <= 0.0:
        raise FieldError(
            "mode_gain",
            mode_gain,
            "asked for on a massless link, which has one mode",
            allowed="a rig that states the mass of its link",
            remedy="state mass_kg in [link] (--link-mass on the command line)",
        )
    return Goals(
        number("max_sensitivity", max_sensitivity, 1.0, 100.0, ""),
        number("noise_gain", noise_gain, 0.0, 1e6, ""),
        number("settling_time", settling_time, 0.0, 1e4, "s"),
        number("mode_gain", mode_gain, 0.0, 1e3, ""),
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
    """((Ms, its ω₀), (noise gain, its ω₀)) over the payload range."""
    loop = open_loop(controller, request.model, rig, margins=request.margins)
    highest = math.pi / request.period if request.margins == "loop" else math.inf
    got = measure(loop, np.geomspace(request.low, request.high, 9), request.period, highest=highest)
    pairs = []
    for values in (got.sensitivity_peak, got.noise_gain):
        at = int(np.argmax(values))
        pairs.append((float(values[at]), float(got.natural_frequency[at])))
    return tuple(pairs)


def _modes(request: Request, rig: Rig, controller: Controller) -> tuple[OpenLoop, HigherModes]:
    """The loop that runs, and modes 2 and 3 of a link that has mass."""
    loop = open_loop(controller, request.model, rig, margins="loop")
    modes = higher_modes(request.model, rig, loop, request.payloads)
    assert modes is not None  # noqa: S101  # a massless link was refused with the bound
    return loop, modes


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
    if goals.mode_gain is not None:
        loop, modes = _modes(request, rig, controller)
        found += spillover_requirements(modes, loop, goals.mode_gain)
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
    """Return the request changed so that the bounds hold: more filter for noise and modes, margin for Ms.

    Raises InfeasibleError naming the bound that no filter or margin reaches.
    """

    def measured(figure: Figure) -> Worst:
        def worst(changed: Request) -> float | None:
            found = attempt(changed)
            return None if found is None else figure(changed, controller_of(changed, *found))

        return worst

    def peak(changed: Request, controller: Controller) -> float:
        return _worst(changed, rig, controller)[0][0]

    def noise(changed: Request, controller: Controller) -> float:
        return _worst(changed, rig, controller)[1][0]

    def mode(changed: Request, controller: Controller) -> float:
        loop, modes = _modes(changed, rig, controller)
        return float(np.max(modes.gains(loop)))

    free_filter = request.filter_time is None and request.margins == "loop"
    for turn in range(_TURNS):
        before = request
        # More filter costs margin, more margin costs noise: after the first turn each asks for a little more
        # than its bound, so that both hold after few.
        share = 1.0 if turn == 0 else 1.0 - 2e-3
        if goals.max_sensitivity is not None and free_margin:
            request = _raise_margin(request, goals.max_sensitivity, share, measured(peak))
        for name, bound, figure in (
            ("noise gain", goals.noise_gain, noise),
            ("mode gain", goals.mode_gain, mode),
        ):
            if bound is not None and free_filter:
                request = _raise_filter(request, name, bound, share, measured(figure))
        if request == before:
            break
    return request


_TURNS = 12
Figure = Callable[[Request, "Controller"], float]
Worst = Callable[[Request], "float | None"]


def _raise_margin(request: Request, bound: float, share: float, worst: Worst) -> Request:
    """The smallest phase margin whose sensitivity peak is within `bound`."""
    start, asked = request.phase_margin, bound
    now = worst(request)
    if now is not None and now <= bound:
        return request
    bound = 1.0 + (bound - 1.0) * share
    bad, best = start, math.inf
    for margin in np.linspace(start, 0.9 * math.pi, 40):
        got = worst(replace(request, phase_margin=float(margin)))
        best = best if got is None else min(best, got)
        if got is not None and got <= bound:
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
        good, bad = (middle, bad) if got is not None and got <= bound else (good, middle)
    return replace(request, phase_margin=good)


def _raise_filter(request: Request, name: str, bound: float, share: float, worst: Worst) -> Request:
    """The rule's filter where it is enough, else the shortest that keeps the figure `name` within `bound`.

    Where n is free, the n is taken whose filter lags least at the crossover asked for.
    """
    ruled = worst(request)
    if ruled is not None and ruled <= bound:
        return request
    orders = (1, 2) if request.filter_order is None else (request.filter_order,)
    tried = [_shortest(replace(request, filter_order=n), bound * share, worst) for n in orders]
    made = [found for found, _ in tried if found is not None]
    if not made:
        least = min([math.inf if ruled is None else ruled, *(value for _, value in tried)])
        raise InfeasibleError(
            name,
            f"no filter keeps the {name} within {bound:g} at this crossover and margin",
            {name.replace(" ", "_"): 1.0001 * least} if math.isfinite(least) else None,
        )
    return min(made, key=_lag)


def _lag(request: Request) -> float:
    time, order = request.filter_time or 0.0, request.filter_order or 1
    return order * math.atan(time * request.gain_crossover)


def _shortest(request: Request, bound: float, worst: Worst) -> tuple[Request | None, float]:
    """(the request with the shortest δ within `bound`, None where there is none; the least that was seen)."""
    bad, least = request.filter_time or 1e-5, math.inf
    for time in np.geomspace(max(1e-4, 1.001 * bad), 1.0, 40):
        got = worst(replace(request, filter_time=float(time)))
        least = least if got is None else min(least, got)
        if got is not None and got <= bound:
            good = float(time)
            break
        bad = float(time)
    else:
        return None, least
    for _ in range(30):
        middle = math.sqrt(good * bad)
        got = worst(replace(request, filter_time=middle))
        good, bad = (middle, bad) if got is not None and got <= bound else (good, middle)
    return replace(request, filter_time=good), least
