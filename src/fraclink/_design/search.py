"""The search of `optimise`: what a trial must keep, the best of each structure, the design accepted."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fraclink._arm.controller import Controller, Lead
from fraclink._design.goals import Goals, check_goals, goal_requirements, margin_for
from fraclink._design.higher_modes import HigherModes, higher_modes
from fraclink._design.loop import OpenLoop
from fraclink._design.measure import Measured, measure
from fraclink._design.plan import Design, open_loop
from fraclink._design.problem import Bounds, Goal, Problem, solve
from fraclink._design.request import check_request
from fraclink._design.verify import findings_of, verify
from fraclink._validate import checked_between, checked_choice
from fraclink.errors import FieldError

__all__ = ["Found", "Search"]

_ROUNDS = 6
# Added to β, and δ in units of 1/ω at the crossover: from the closed form's short filter alone the steps
# towards a long one, where n = 2 is quiet, go astray on some links.
_STEEPER = ((0.4, 0.2), (0.8, 0.4))
# Zero and pole of the first leads, in units of 1/ω at twice the crossover: leads and lags, narrow and wide.
_STARTS = ((1.5, 0.7), (0.7, 1.5), (4.0, 2.0), (4.0, 1.0))
_ROUNDING = 1.0 + 1e-10  # a bound met with equality is kept

Found = tuple[str, Controller, float]


@dataclass(frozen=True, eq=False)
class Search:
    """The design to better, what every trial must keep, and which figure is to be improved."""

    origin: Design
    goal: Goal
    bounds: Bounds
    modes: HigherModes | None

    @staticmethod
    def of(design: Design, goal: Goal, asked: tuple[float | None, ...]) -> Search:
        """The search with what was left out taken from the design."""
        if design.margins_kind != "loop":
            raise FieldError(
                "plan.margins_kind",
                design.margins_kind,
                "the paper's reading, without the motor loop and the delay",
                allowed="loop",
                remedy='design with margins="loop" first',
            )
        checked_choice("goal", goal, ("noise", "crossover"))
        goals = check_goals(asked[0], asked[2], None, asked[3], design.rig)
        crossover = design.gain_crossover if asked[1] is None else asked[1]
        crossover = checked_between("gain_crossover", crossover, 0.0, 1e6, "rad/s", open_low=True)
        own = _measured(design, design.controller)
        bounds = Bounds(
            max_sensitivity=goals.max_sensitivity or float(np.max(own.sensitivity_peak)),
            gain_crossover=crossover,
            noise_gain=goals.noise_gain or float(np.max(own.noise_gain)),
            mode_gain=goals.mode_gain,
        )
        modes = None
        if goals.mode_gain is not None:
            modes = higher_modes(design.model, design.rig, design.loop, design.payloads)
        return Search(design, goal, bounds, modes)

    def kept(self, controller: Controller) -> float:
        """The objective of a controller that keeps the bounds, NaN of one that does not."""
        got = _measured(self.origin, controller)
        noise, crossover = float(np.max(got.noise_gain)), float(np.min(got.gain_crossover))
        loud = self.goal == "crossover" and noise > self.bounds.noise_gain * _ROUNDING
        slow = self.goal == "noise" and crossover < self.bounds.gain_crossover / _ROUNDING
        close = float(np.max(got.sensitivity_peak)) > self.bounds.max_sensitivity * _ROUNDING
        if loud or slow or close or self._reaches_a_mode(controller) or not np.all(got.phase_margin > 0.0):
            return math.nan
        return noise if self.goal == "noise" else crossover

    def _reaches_a_mode(self, controller: Controller) -> bool:
        if self.modes is None or self.bounds.mode_gain is None:
            return False
        loop = _loop(self.origin, controller)
        return bool(np.max(self.modes.gains(loop)) > self.bounds.mode_gain * _ROUNDING)

    def simple(self, closed: Controller) -> list[Found]:
        """The best controller of the paper's structure for n = 1 and for n = 2."""
        starts = [closed, *(_steeper(closed, pair, self.bounds.gain_crossover) for pair in _STEEPER)]
        return [(f"k_d, β, δ, n = {n}", *self._best(starts, n, lead=False)) for n in (1, 2)]

    def widened(self, simple: list[Found]) -> list[Found]:
        """The same with a lead."""
        found = []
        for _, controller, _ in simple:
            n = controller.filter_order
            starts = [_with_lead(controller, pair, 2.0 * self.bounds.gain_crossover) for pair in _STARTS]
            found.append((f"k_d, β, δ, n = {n}, a, b, ν", *self._best(starts, n, lead=True)))
        return found

    def _best(self, starts: list[Controller], n: int, *, lead: bool) -> tuple[Controller, float]:
        made = [self._solved(start, n, lead=lead) for start in starts]
        better = min if self.goal == "noise" else max
        kept = [pair for pair in made if not math.isnan(pair[1])]
        return better(kept, key=lambda pair: pair[1]) if kept else made[0]

    def _solved(self, start: Controller, n: int, *, lead: bool) -> tuple[Controller, float]:
        """One solution; its bounds are drawn in until the finer measure finds them kept."""
        loop = replace(
            _loop(self.origin, self.origin.controller), gain=1.0, order=0.0, filter_time=0.0, lead=None
        )
        asked = self.bounds
        controller, value = start, math.nan
        for _ in range(_ROUNDS):
            problem = Problem(
                loop,
                self.origin.natural_frequencies,
                self.origin.rig.period,
                n,
                lead,
                self.goal,
                asked,
                self.modes,
            )
            x = solve(problem, problem.start(controller))
            if not np.all(np.isfinite(x)):
                break
            controller = problem.controller(x, self.origin.controller)
            value = self.kept(controller)
            if not math.isnan(value):
                break
            asked = self._tightened(asked, controller)
        return controller, value

    def _tightened(self, asked: Bounds, controller: Controller) -> Bounds:
        """The bounds less what the last trial exceeded them by, between the points or in the last digits."""
        got, wanted = _measured(self.origin, controller), self.bounds
        peak, noise = float(np.max(got.sensitivity_peak)), float(np.max(got.noise_gain))
        crossover = float(np.min(got.gain_crossover))
        drawn = {
            "max_sensitivity": max(asked.max_sensitivity / _over(peak / wanted.max_sensitivity), 1.0 + 1e-6)
        }
        if self.goal == "crossover":
            drawn["noise_gain"] = asked.noise_gain / _over(noise / wanted.noise_gain)
        elif crossover > 0.0:
            drawn["gain_crossover"] = asked.gain_crossover * _over(wanted.gain_crossover / crossover)
        return replace(asked, **drawn)

    def design(self, controller: Controller) -> Design:
        """The design of an accepted controller; its requirements are the bounds that it was found under."""
        origin, bounds = self.origin, self.bounds
        goals = Goals(bounds.max_sensitivity, bounds.noise_gain, None, bounds.mode_gain)
        settings = controller.inner
        request = check_request(
            origin.model,
            origin.rig,
            payloads=None,
            natural_frequencies=origin.natural_frequencies,
            gain_crossover=bounds.gain_crossover,
            phase_margin=margin_for(goals, None),
            margins="loop",
            filter_time=None,
            filter_order=controller.filter_order,
            inner="ideal" if settings is None else settings.kind,
            placement="tustin" if settings is None else settings.placement,
        )
        requirements = verify(request, origin.rig, controller)
        requirements += goal_requirements(request, origin.rig, controller, goals, requirements[0].achieved)
        upper = float(np.max(_measured(origin, controller).gain_crossover))
        asked_mode = bounds.mode_gain is not None
        return replace(
            origin,
            controller=controller,
            requirements=requirements,
            gain_crossover=bounds.gain_crossover,
            phase_margin=request.phase_margin,
            chi=controller.gain * bounds.gain_crossover**controller.order,
            gain_crossover_upper=upper,
            findings=findings_of(request, origin.rig, controller, upper, asked_mode=asked_mode),
        )


def _over(ratio: float) -> float:
    """What a bound is divided by next: the part by which it was exceeded, at most 2 %, and a millionth."""
    return min(max(ratio, 1.0), 1.02) * (1.0 + 1e-6) if ratio > _ROUNDING else 1.0


def _loop(design: Design, controller: Controller) -> OpenLoop:
    return open_loop(controller, design.model, design.rig, margins="loop")


def _measured(design: Design, controller: Controller) -> Measured:
    pi = np.geomspace(*design.natural_frequencies, 9)
    nyquist = math.pi / design.rig.period
    return measure(_loop(design, controller), pi, design.rig.period, highest=nyquist)


def _steeper(controller: Controller, pair: tuple[float, float], frequency: float) -> Controller:
    """The controller with a larger β, a longer filter and the same gain at `frequency` [rad/s]."""
    order, time = min(controller.order + pair[0], 1.95), pair[1] / frequency
    made = replace(controller, order=order, filter_time=time, filter_order=2)
    level = abs(complex(controller.response(frequency))) / abs(complex(made.response(frequency)))
    return replace(made, gain=made.gain * level)


def _with_lead(controller: Controller, pair: tuple[float, float], frequency: float) -> Controller:
    """The controller with a first lead and the same gain at `frequency` [rad/s]."""
    lead = Lead(pair[0] / frequency, pair[1] / frequency, 0.8)
    return replace(controller, lead=lead, gain=controller.gain / abs(complex(lead.response(frequency))))
