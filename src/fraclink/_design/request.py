"""From a specification to the solver's problem and back: which arms and links it looks
at, what each has to keep, and what the controller that comes of it achieves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.box import Arm, ParameterBox, arms_of
from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.rig import Rig
from fraclink._design.descent import peaks
from fraclink._design.equations import check_bandwidth, check_modes, range_of
from fraclink._design.sheet import Sheet, stacked, tabulated
from fraclink._design.solver import (
    EMPTY,
    LAW,
    MODEL,
    Goal,
    Problem,
    Rows,
    Solution,
    Wanted,
)
from fraclink._law.design import Specification
from fraclink._law.modes import (
    MODE_LIMIT,
    HigherModes,
    higher_modes,
    vibration,
)
from fraclink._law.requirement import least_modulus
from fraclink._law.rows import (
    DAMPING,
    EMPTY_SHARE,
    NOISE_SHARE,
    SENSITIVITY,
)
from fraclink.errors import FieldError

__all__ = ["Request", "Solved"]

Real = NDArray[np.float64]

_ALLOWANCE = math.radians(0.5)  # of the law's fit, which states it as its own error
_LINKS = 3  # of the range, on the model; on an arm of a box its two ends
_ROUNDS = 6  # in which arms of a box are taken in
# δ times the crossover of the start, as a loop is quiet with a long filter and a steep
# Ĉ; and times the resonance, of the lattice
_LAG, _LAGS = 1.2, np.geomspace(0.01, 6.0, 7)
# of the lattice: where it crosses, by what is asked for; the values of β, and how far
# they keep from their limits
_PLACES, _ORDERS, _LEAST = np.array([0.2, 0.45, 1.02, 1.15, 1.4, 2.0]), 7, 0.1
_TRIED = 4  # of the lattice
_SAME = 1e-3  # of two slacks: both searches ended at the same point
_GIVEN = 0.1  # of a goal reached, for less noise
_ASIDE = 1.1  # of the second mode, to either side: where its notch may lie
_TOLERANCE = 1e-4  # of a row in the table, before the engine measures it


@dataclass(frozen=True)
class Solved:
    """A controller with its slack (0 where every row is kept), and where it comes from."""

    controller: Controller
    solution: Solution
    problem: Problem
    active: tuple[int, ...]  # the arms that were taken in


@dataclass(frozen=True, eq=False)
class Request:
    """A specification on one arm, or on every arm of a box."""

    model: LinkModel  # with a known payload
    rig: Rig
    spec: Specification
    box: ParameterBox | None
    goal: Goal

    # ---- what is asked

    @cached_property
    def _range(self) -> tuple[float, float, tuple[float, float]]:
        return range_of(self.model, self.rig, self.spec)

    @property
    def payloads(self) -> tuple[float, float]:
        """(lightest, heaviest) [kg]."""
        return self._range[2]

    @property
    def natural_frequencies(self) -> tuple[float, float]:
        """ω₀ of the heaviest and of the lightest payload."""
        return self._range[:2]

    def check(self) -> None:
        """FieldError for what contradicts the arm."""
        check_modes(self.model, self.rig, self.spec)
        if self.gain_crossover is not None:
            check_bandwidth(self.gain_crossover, self.rig)
        if self.spec.inner == "sampled":
            # refused at once where its poles cannot be placed
            self.motor_loop.sampled(self.rig.motor, self.rig.period)

    @cached_property
    def gain_crossover(self) -> float | None:
        """The least crossover asked for [rad/s]; 2π/t_s for a settling time."""
        if self.spec.gain_crossover is not None or self.spec.settling_time is None:
            return self.spec.gain_crossover
        return 2.0 * math.pi / self.spec.settling_time

    @cached_property
    def max_sensitivity(self) -> float | None:
        """The bound on Ms; the customary one where no margin is asked for."""
        if self.spec.max_sensitivity is not None or self.spec.phase_margin is not None:
            return self.spec.max_sensitivity
        return SENSITIVITY

    @cached_property
    def phase_margin(self) -> float:
        """The least phase margin [rad]; the least that the bound on Ms allows where
        only that one is asked for.
        """
        if self.spec.phase_margin is not None:
            return self.spec.phase_margin
        assert self.max_sensitivity is not None  # one of the two is  # noqa: S101
        return 2.0 * math.asin(0.5 / self.max_sensitivity)

    @cached_property
    def highest(self) -> float:
        """Where nothing may cross any more [rad/s]: the motor loop's pole."""
        return min(self.rig.motor_loop.pole, 0.9 * math.pi / self.rig.period)

    @cached_property
    def mode_gain(self) -> float | None:
        """The bound on the loop gain at the higher modes; None where they are part of
        the loop's own margins, or none is known.
        """
        if self.rig.link.mass <= 0.0 and self.model.second_mode is None:
            return None
        if self.spec.mode_gain is not None:
            return self.spec.mode_gain
        return MODE_LIMIT

    @cached_property
    def empty(self) -> float:
        """The payload of the empty gripper [kg]."""
        stated = self.rig.payloads.empty
        return EMPTY_SHARE * self.payloads[0] if stated is None else stated

    @property
    def voltage(self) -> tuple[float, float, float] | None:
        """(The gauge's noise as an angle over the voltage limit [rad/V], A, B of the
        motor); None where nothing is known of the noise.
        """
        rig = self.rig
        if rig.gauge.noise <= 0.0:
            return None
        size = rig.gauge.noise / self.model.stiffness / rig.motor.voltage_limit
        return size, rig.motor.gain, rig.motor.decay

    def wanted(self, soft: frozenset[str]) -> Wanted:
        """Return the rows as the solver has them."""
        return Wanted(
            gain_crossover=self.gain_crossover or self.resonance,
            phase_margin=self.phase_margin,
            highest=self.highest,
            allowance=0.5 * _ALLOWANCE,
            modulus=least_modulus(self.phase_margin),
            max_sensitivity=self.max_sensitivity,
            noise_gain=self.spec.noise_gain,
            mode_gain=self.mode_gain,
            noise_voltage=None if self.voltage is None else NOISE_SHARE,
            filter_time=self.spec.filter_time,
            link_order=self.model.order,
            soft=soft,
        )

    @property
    def soft(self) -> frozenset[str]:
        """The rows that the slack may give: what was asked for, or stands for it."""
        keys = {"phase_margin", "max_sensitivity", "noise_gain", "mode_gain"}
        if self.gain_crossover is not None:
            keys.add("gain_crossover")
        return frozenset(keys)

    # ---- where it is asked

    @cached_property
    def motor_loop(self) -> MotorLoop:
        """The motor loop that the design assumes."""
        settings = self.rig.motor_loop
        return MotorLoop(
            settings.pole,
            int(settings.delay_samples),
            self.spec.inner,
            self.spec.placement,
        )

    @cached_property
    def motor_loops(self) -> tuple[MotorLoop, ...]:
        """The assumed motor loop, and the one that the law runs where it is another."""
        assumed = self.motor_loop
        if assumed.kind == "sampled":
            return (assumed,)
        shipped = replace(assumed, kind="sampled")
        try:
            shipped.sampled(self.rig.motor, self.rig.period)
        except FieldError:
            return (assumed,)
        return assumed, shipped

    @cached_property
    def arms(self) -> tuple[Arm, ...]:
        """The model, and the corners of the box."""
        corners = () if self.box is None else arms_of(self.box, self.model)
        return (Arm(self.model), *corners)

    def links(self, number: int, count: int) -> Real:
        """ω₀ of `count` payloads on an arm; the box widens the range of its corners."""
        low, high = self.natural_frequencies
        if number and self.box is not None:
            known = self.model.natural_frequency
            low *= self.box.natural_frequency[0] / known
            high *= self.box.natural_frequency[1] / known
        return np.geomspace(low, high, count)

    def bare(self, number: int, settings: MotorLoop) -> Loop:
        """The loop beside Ĉ of an arm."""
        unit = Controller(gain=1.0, order=1.0, inner=settings, period=self.rig.period)
        loop = self.arms[number].loop(unit, self.rig)
        return replace(loop, gain=1.0, order=0.0, filter_time=0.0)

    @cached_property
    def loops(self) -> tuple[Loop, ...]:
        """The loop beside Ĉ of every arm and motor loop."""
        return tuple(
            self.bare(number, settings)
            for number in range(len(self.arms))
            for settings in self.motor_loops
        )

    def sheet(self, number: int) -> Sheet:
        """Return the table of one arm: its links under either motor loop, the empty
        gripper on the model.
        """
        rig, parts = self.rig, []
        count = 2 if number else _LINKS
        for i in range(len(self.motor_loops)):
            arm = number * len(self.motor_loops) + i
            bare = self.loops[arm]
            w0 = self.links(number, count)
            found = None
            if i == 0 and self.mode_gain is not None:
                modes = self.modes(number, bare)
                found = modes.frequency.ravel(), modes.level.ravel()
            parts.append(
                tabulated(
                    bare,
                    w0,
                    rig.period,
                    kind=LAW if i else MODEL,
                    arm=arm,
                    noisy=i == 0,
                    voltage=self.voltage,
                    modes=found,
                )
            )
            if not number:
                light = np.array([self.model.at_payload(self.empty).natural_frequency])
                parts.append(
                    tabulated(
                        bare,
                        light,
                        rig.period,
                        kind=EMPTY,
                        arm=arm,
                        noisy=False,
                        voltage=None,
                        modes=None,
                    )
                )
        return stacked(parts)

    def modes(self, number: int, loop: Loop) -> HigherModes:
        """Return the higher modes of an arm, where their gain is bounded."""
        modes = higher_modes(self.arms[number].model, self.rig, loop, self.payloads)
        assert modes is not None  # a mode_gain is asked for  # noqa: S101
        return modes

    @cached_property
    def sheets(self) -> tuple[Sheet, ...]:
        """The table of every arm."""
        return tuple(self.sheet(number) for number in range(len(self.arms)))

    # ---- the answer

    def start(self, order: int) -> Real:
        """Parameters to begin from: the closed form of one link, whose phase is met at
        the crossover, with a long filter.
        """
        loop, high = self.loops[0], self.natural_frequencies[1]
        reference = self.reference()
        ratio = (high / self.natural_frequencies[0]) ** (2.0 / self.model.order)
        w = min(reference * ratio, 0.6 * self.highest)
        delta = _LAG / w if self.spec.filter_time is None else self.spec.filter_time
        rest = complex(loop.log(w, high))
        beta = 2.0 / math.pi * (self.phase_margin - math.pi - rest.imag)
        beta += 2.0 / math.pi * order * math.atan(delta * w)
        beta = min(max(beta, 0.1), min(self.model.order, float(order)) - 0.05)
        return self._through(reference, beta, delta, order)

    def _through(self, w: float, beta: float, delta: float, order: int) -> Real:
        """Parameters with which |L| is one at `w` at the heaviest payload."""
        gain = -float(self.loops[0].log(w, self.natural_frequencies[0]).real)
        gain -= beta * math.log(w / self.reference())
        gain += 0.5 * order * math.log1p((delta * w) ** 2)
        return np.array([gain, beta, math.log(max(delta, 1e-12))])

    def scanned(self, problem: Problem) -> list[Real]:
        """The best points of a lattice, each better than its neighbours at the two ends
        of the payloads: what is feasible may be in parts, and every part has its own.
        """
        given, reference = self.spec.filter_time, self.reference()
        lags = _LAGS / self.resonance if given is None else np.array([given])
        orders = np.linspace(_LEAST, self.model.order - _LEAST, _ORDERS)
        sheet = self.sheets[0]
        change = np.diff(sheet.kind, prepend=-1) != 0
        ends = np.flatnonzero(change | np.roll(change, -1))
        shape = lags.size, _ORDERS, _PLACES.size
        lattice = np.array(
            [
                problem.widened(
                    self._through(
                        float(place) * reference,
                        float(beta),
                        float(delta),
                        problem.filter_order,
                    )
                )
                for delta, beta, place in product(lags, orders, _PLACES)
            ]
        )
        with np.errstate(all="ignore"):
            coarse = problem.with_sheet(sheet.rows(ends))
            merit = coarse.merits(lattice.T).reshape(shape)
        return [lattice[k] for k in peaks(merit)[:_TRIED]]

    def reference(self) -> float:
        """ω_r [rad/s]: the crossover asked for, or just above the heaviest payload's
        resonance.
        """
        if self.gain_crossover is not None:
            return self.gain_crossover
        return 1.1 * self.resonance

    @cached_property
    def resonance(self) -> float:
        """The heaviest payload's [rad/s]: a loop that crosses below it leaves the
        vibration as it is, and is no answer where no crossover is asked for.
        """
        return float(self.loops[0].peak(self.natural_frequencies[0]))

    @property
    def filter_orders(self) -> tuple[int, ...]:
        """The n to try: with a free δ two poles can do what one does."""
        if self.spec.filter_order is not None:
            return (self.spec.filter_order,)
        if self.spec.filter_time is None:
            return (2,)
        return (1,) if self.spec.filter_time == 0.0 else (1, 2)

    @cached_property
    def notches(self) -> tuple[tuple[float, float] | None, ...]:
        """The intervals of a notch [rad/s] to try: none first, then about the second
        mode, where that one is bounded and below the Nyquist frequency.
        """
        if self.mode_gain is None:
            return (None,)
        modes = self.modes(0, self.loops[0])
        w = modes.frequency[modes.number == 2]
        low, high = float(w.min()) / _ASIDE, float(w.max()) * _ASIDE
        if low >= self.loops[0].highest:
            return (None,)
        return None, (low, min(high, self.loops[0].highest))

    def solved(self) -> Solved:
        """Return the best controller, or the one nearest to the request.

        Every n without a notch, then with one; and only where none of these keeps every
        row the same from other starts.
        """
        answers: list[Solved] = []
        for notch, order in product(self.notches, self.filter_orders):
            problem = Problem(
                self.sheets[0],
                self.loops,
                self.wanted(self.soft),
                self.goal,
                self.reference(),
                order,
                notch,
            )
            answers.append(self._over_arms(problem, *self._quiet_start(problem)))
            if answers[-1].solution.slack == 0.0:
                return self._quieter(answers[-1])
        for k, answer in enumerate(answers):
            answers[k] = self._from_elsewhere(answer)
            if answers[k].solution.slack == 0.0:
                return self._quieter(answers[k])
        return min(answers, key=lambda one: one.solution.slack)

    def _from_elsewhere(self, answer: Solved) -> Solved:
        """The better of an answer and of those from other starts, with every arm that
        was taken in on the way, until two searches end with the same slack.
        """
        best, problem = answer, replace(answer.problem, patient=True)
        for x in self.scanned(problem):
            other = self._over_arms(problem, x, best.active)
            slack, least = other.solution.slack, best.solution.slack
            if slack < least:
                best = other
            if slack == 0.0 or abs(slack - least) < _SAME:
                break
        return best

    def _quiet_start(self, problem: Problem) -> tuple[Real, tuple[int, ...]]:
        """(parameters to begin from, the arms that are known to be worst).

        For another goal than noise the quiet loop of a modest crossover: from a loop
        without a filter, where δ counts for nothing, the search ends without one.
        """
        start = problem.widened(self.start(problem.filter_order))
        if self.goal == "noise":
            return start, (0,)
        least = problem.wanted.gain_crossover or self.reference()
        wanted = replace(problem.wanted, gain_crossover=least)
        quiet = replace(problem, goal="noise", wanted=wanted)
        answer = self._over_arms(quiet, start)
        return (
            (answer.solution.x, answer.active)
            if answer.solution.slack < 1.0
            else (start, (0,))
        )

    def _quieter(self, best: Solved) -> Solved:
        """The least noise with nine tenths of what the goal reached.

        The last tenth costs most: the fastest loop alone has no filter at all. (A tenth
        is what the published procedure gives its filter, too.)
        """
        if self.goal == "noise":
            return best
        problem, goal = best.problem, best.solution.goal
        wanted = problem.wanted
        if self.goal == "settling":
            least = math.exp(goal) * (1.0 - _GIVEN)
            wanted = replace(
                wanted, gain_crossover=max(least, wanted.gain_crossover or 0.0)
            )
        else:
            wanted = replace(
                wanted, phase_margin=max((1.0 - _GIVEN) * goal, wanted.phase_margin)
            )
        problem = replace(problem, wanted=wanted, goal="noise")
        answers = [best]
        # The fastest loop has hardly a filter, whose time no longer counts there: its
        # gradient would not lengthen it.
        longer = best.solution.x.copy()
        longer[2] = max(longer[2], math.log(0.2 / self.reference()))
        starts = [longer]
        if longer[2] > best.solution.x[2]:
            starts.append(best.solution.x)
        for start in starts:
            quiet = self._over_arms(problem, start, best.active)
            if quiet.solution.slack == 0.0:
                answers.append(quiet)
        return min(answers[1:], key=lambda one: one.solution.goal, default=best)

    def tightened(self, solved: Solved, reserves: dict[str, float]) -> Solved:
        """Return the solution with more in reserve for some rows."""
        old = solved.problem
        total = {
            key: old.reserves.get(key, 0.0) + more for key, more in reserves.items()
        }
        problem = replace(old, reserves={**old.reserves, **total})
        return self._over_arms(problem, solved.solution.x, solved.active)

    def _over_arms(
        self, problem: Problem, start: Real, active: tuple[int, ...] = (0,)
    ) -> Solved:
        """The solution for every arm, the worst ones taken in as they turn up."""
        if len(active) > 1:
            parts = [self.sheets[number] for number in active]
            problem = problem.with_sheet(stacked(parts))
        solution = problem.solve(start)
        for _ in range(_ROUNDS):
            if solution.slack == math.inf:
                break  # more arms do not help
            changed = False
            if not problem.wanted.damping and self._rings(problem, solution):
                changed = True
                problem = replace(problem, wanted=replace(problem.wanted, damping=True))
            worse = self._worse(problem, solution, active)
            if worse:
                changed, active = True, (*active, *worse)
                sheets = [self.sheets[number] for number in active]
                problem = problem.with_sheet(stacked(sheets))
            if not changed:
                break
            solution = problem.solve(solution.x)
        controller = self.controller(problem, solution)
        return Solved(controller, solution, problem, active)

    def _rings(self, problem: Problem, solution: Solution) -> bool:
        controller = self.controller(problem, solution)
        loop = self.arms[0].loop(controller, self.rig)
        for w0 in self.natural_frequencies:
            found = vibration(loop, w0)
            if found is not None and found.damping_ratio < DAMPING:
                return True
        return False

    @cached_property
    def _whole(self) -> Sheet:
        return stacked(self.sheets)

    def _missed(
        self, problem: Problem, solution: Solution
    ) -> tuple[Rows, NDArray[np.int64]]:
        """(the rows at every arm of the box, the arm of each)."""
        wanted = replace(problem.wanted, damping=False)
        with np.errstate(all="ignore"):
            rows = replace(problem, wanted=wanted).rows(
                solution.x,
                solution.goal,
                min(solution.slack, 1.0),
                sheet=self._whole,
            )
        return rows, self._whole.arm[rows.link] // len(self.motor_loops)

    def _worse(
        self, problem: Problem, solution: Solution, active: tuple[int, ...]
    ) -> list[int]:
        """The arms that miss some row by most, of those that are not in."""
        if len(self.arms) == 1:
            return []
        rows, number = self._missed(problem, solution)
        worst: dict[str, tuple[float, int]] = {}
        for key, value, arm in zip(rows.key, rows.value, number, strict=True):
            if arm not in active and value < worst.get(key, (-_TOLERANCE, 0))[0]:
                worst[key] = float(value), int(arm)
        return sorted({arm for _, arm in worst.values()})

    def asking(self, spec: Specification) -> Request:
        """Return the same for another request on the same arms, whose tables it takes
        over.
        """
        other = replace(self, spec=spec)
        kept = ("arms", "loops", "sheets", "_whole")
        same = (self.mode_gain is None) == (other.mode_gain is None)
        if same:
            vars(other).update({k: v for k, v in vars(self).items() if k in kept})
        return other

    def worst_arms(self, solved: Solved) -> dict[str, int]:
        """The arm of the box that is worst for each row, by the table."""
        if len(self.arms) == 1:
            return {}
        rows, number = self._missed(solved.problem, solved.solution)
        found: dict[str, tuple[float, int]] = {}
        for key, value, arm in zip(rows.key, rows.value, number, strict=True):
            if key not in found or value < found[key][0]:
                found[key] = float(value), int(arm)
        return {key: arm for key, (_, arm) in found.items()}

    def controller(self, problem: Problem, solution: Solution) -> Controller:
        """The controller of a solution."""
        x = solution.x
        free = self.spec.filter_time
        return Controller(
            gain=math.exp(x[0] - x[1] * math.log(problem.reference)),
            order=float(x[1]),
            filter_time=math.exp(x[2]) if free is None else free,
            filter_order=solution.filter_order,
            link=self.model.at_payload(self.rig.payloads.nominal),
            inner=self.motor_loop,
            period=self.rig.period,
            notch=problem.outer(x).notch,
        )
