"""The linear programme that shapes a reference for the loops of a set of arms.

As long as no limit acts, the law, its motor loop and an arm are linear and
time-invariant. The reference's velocity is a quadratic B-spline with a knot every few
periods, so that angle, velocity and acceleration are continuous and each coefficient
c_j is a smooth step of c_j rad in three knots. One run of law.c for such a step, on the
arm without friction, noise and limits, determines the response to every reference: the
sum of c_j times that run, delayed by j knots.

    minimise e  subject to  |Σ c_j y_a(t − jh) − end| <= e     from the settling time on
                       and  |Σ c_j V_a(t − jh)| <= V           for all arms a, all t
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.optimize import linprog

from fraclink._arm.reference import Path
from fraclink._simulate.arm_set import STEP, ArmSet
from fracsys.checks import Real

__all__ = ["Programme"]

Bounds = list[tuple[float, float]]

# Stride of the rows that are in the programme from the beginning; it changes the time of a
# solution, not the solution.
FIRST = 31
# Tolerance relative to the right-hand side of a row (0.1 mrad of 1 rad, 1 mV of 8 V), or
# to PART of the largest one if that is more.
BROKEN, PART = 1e-4, 1e-3
# Pieces of the unit step in powers of x = t/h: the angle over the three knots of its
# rise, then rest.
_PIECES = np.array(
    [
        [0.0, 0.0, 0.0, 1 / 6],
        [1 / 6, 1 / 2, 1 / 2, -1 / 3],
        [5 / 6, 1 / 2, -1 / 2, 1 / 6],
        [1.0, 0.0, 0.0, 0.0],
    ]
)


def spline_path(coefficients: Real, step: float) -> Path:
    """Return the sum of smooth steps of these sizes [rad], one every `step` [s]."""
    count = len(coefficients)
    pieces = np.zeros((count + 3, 4))
    for j, size in enumerate(coefficients):
        pieces[j : j + 3] += size * _PIECES[:3]
        pieces[j + 3 :, 0] += size
    # convert powers of t/h to powers of t
    pieces /= step ** np.arange(4.0)
    return Path("shaped", step * np.arange(count + 3.0), pieces, step * (count + 2))


@dataclass(frozen=True, eq=False)
class Programme:
    """Responses of every arm to one smooth step, and the limits of a reference.

    answers: tip angle, then voltage, step of the motor reference and torque relative to
    limits, shape (arms, 4, N). knot: periods between two steps. largest: limit of
    a coefficient [rad], as the velocity lies between the c_j/h. acceleration: limit of
    the reference [rad/s²].
    """

    answers: Real
    knot: int
    period: float
    largest: float
    acceleration: float

    @staticmethod
    def of(
        arms: ArmSet,
        knot: int,
        duration: float,
        *,
        voltage: float,
        motor_step: float,
        torque: float,
    ) -> Programme:
        """Return the programme for references of `duration` [s], within limits of
        voltage [V], step of the motor reference in a period [rad] and torque [N·m].
        """
        linear, period = arms.linear, arms.law.period
        step = spline_path(np.array([STEP]), knot * period)
        answers = []
        for link in linear.links.values():
            for payload in linear.payloads:
                run = linear.run(link, payload, step, duration=duration)
                signals = (
                    run.tip_angle,
                    run.voltage / voltage,
                    np.diff(run.motor_reference, prepend=0.0) / motor_step,
                    run.torque / torque,
                )
                answers.append(np.array(signals) / STEP)
        # A row may be violated by a ten-thousandth; for a guard that acts exactly at
        # the limit the margin is ten times as large.
        margin, own = 1.0 - 10.0 * BROKEN, arms.law.limits
        return Programme(
            np.stack(answers),
            knot,
            period,
            margin * own.reference_step * knot,
            margin * own.acceleration_limit,
        )

    @property
    def length(self) -> int:
        """Number of known periods of every response."""
        return int(self.answers.shape[2])

    def count(self, time: float) -> int:
        """Return the number of steps of a reference at rest four knots after `time` [s]."""
        return max(1, math.ceil(time / (self.knot * self.period) - 1e-9)) + 2

    def path(self, coefficients: Real) -> Path:
        """Return the reference."""
        return spline_path(coefficients, self.knot * self.period)

    def tips(self, coefficients: Real) -> Real:
        """Return the tip angle of every arm along a reference, shape (arms, N)."""
        count = len(coefficients)
        return np.stack(
            [self._moved(answer[0], count) @ coefficients for answer in self.answers]
        )

    def least_distance(self, count: int, end: float, first: int, last: int) -> float:
        """Return the largest distance [rad] of any tip from `end` in rows first to last,
        minimised over the references of `count` coefficients; infinite if none keeps
        the limits.
        """
        rows, sides = self._rows(count, end, first, last)
        bounds = [(-self.largest, self.largest)] * count + [(0.0, math.inf)]
        ends = np.append(np.ones(count), 0.0)
        # The last unknown is e, the distance, which is the only cost.
        solution = _least(1.0 - ends, rows, sides, ends, end, bounds)
        return math.inf if solution is None else float(solution[-1])

    def gentlest(
        self, count: int, end: float, first: int, last: int, within: float
    ) -> Real | None:
        """Return the reference whose acceleration varies least among those whose tips
        stay `within` [rad] of `end`; the reference of least distance would switch
        between its limits.
        """
        rows, sides = self._rows(count, end, first, last)
        # Σ |differences of the acceleration| as a linear programme: each one is bounded
        # by an unknown of its own.
        jerk = np.diff(_differences(count), axis=0, prepend=0.0, append=0.0)
        more = len(jerk)
        bent = np.pad(jerk, ((0, 0), (0, 1)))
        rows = np.block(
            [
                [rows, np.zeros((len(rows), more))],
                [bent, -np.eye(more)],
                [-bent, -np.eye(more)],
            ]
        )
        sides = np.append(sides, np.zeros(2 * more))
        cost = np.append(np.zeros(count + 1), np.ones(more))
        ends = np.append(np.ones(count), np.zeros(1 + more))
        bounds = [(-self.largest, self.largest)] * count + [(0.0, within)]
        bounds += [(0.0, math.inf)] * more
        solution = _least(cost, rows, sides, ends, end, bounds)
        return None if solution is None else solution[:count]

    def _rows(self, count: int, end: float, first: int, last: int) -> tuple[Real, Real]:
        """Every inequality as rows @ (c, e) <= sides."""
        step = self.knot * self.period
        # acceleration at the knots, which bound it in between
        limited = [_differences(count) / (step**2 * self.acceleration)]
        rows, sides = [], []
        for tip, *signals in self.answers:
            response = self._moved(tip, count)[first:last]
            distance = np.ones((len(response), 1))
            rows += [
                np.hstack([response, -distance]),
                np.hstack([-response, -distance]),
            ]
            sides += [np.full(len(response), end), np.full(len(response), -end)]
            limited += [self._moved(signal, count)[:last] for signal in signals]
        every = np.pad(np.vstack(limited), ((0, 0), (0, 1)))
        rows += [every, -every]
        sides += [np.ones(2 * len(every))]
        return np.vstack(rows), np.concatenate(sides)

    def _moved(self, answer: Real, count: int) -> Real:
        """A response in columns, each delayed by one more knot; shape (N, count)."""
        late = np.pad(answer, ((count - 1) * self.knot, 0))
        columns = sliding_window_view(late, len(answer))[:: -self.knot].T
        return np.ascontiguousarray(columns)


def _differences(count: int) -> Real:
    """Changes of the velocity from knot to knot, from rest to rest."""
    return np.diff(np.eye(count), axis=0, prepend=0.0, append=0.0)


def _least(
    cost: Real, rows: Real, sides: Real, ends: Real, end: float, bounds: Bounds
) -> Real | None:
    """Minimise cost @ x with rows @ x <= sides and ends @ x = end; None if this is
    infeasible.

    Of thousands of rows only dozens are active: the programme is solved with a few of
    them, those that the solution violates are added, and so on until none is violated.
    This is exact, and takes a third of the time of all rows at once.
    """
    scale = np.maximum(np.abs(sides), PART * np.max(np.abs(sides)))
    active = np.zeros(len(rows), bool)
    active[::FIRST] = True
    while True:
        # presolve removes nothing from a dense programme and takes longer than the
        # solution
        solution = linprog(
            cost,
            rows[active],
            sides[active],
            ends[None, :],
            [end],
            bounds,
            method="highs",
            options={"presolve": False},
        )
        if solution.x is None:
            return None
        broken = rows @ solution.x - sides > BROKEN * scale
        if not np.any(broken & ~active):
            return solution.x
        # including their neighbours, which are next if the peak moves sideways
        active |= np.convolve(broken, np.ones(5), mode="same") > 0
