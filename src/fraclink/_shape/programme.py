"""The linear programme: a spline whose coefficients keep every limit and bring the tip nearest to its target.

The reference's velocity is a quadratic B-spline with a knot every few periods, so that angle, velocity and
acceleration are continuous and each coefficient c_j is a smooth step of c_j rad in three knots. The loop is
linear: tip, voltage and motor answer with the sum of c_j times their answer to one such step, later by j
knots, for every payload at once.

    minimise e  subject to  |Σ c_j y_p(t − jh) − target(t)| <= e  and  |Σ c_j V_p(t − jh)| <= V  for all p, t
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from fraclink._arm.reference import Path
from fraclink._shape.responses import SIGNALS, Responses

__all__ = ["MoveBounds", "MoveSolution", "Programme", "spline_path"]

Real = NDArray[np.float64]

# Pieces of the unit step in powers of x = t/h: angle over the three knots in which it rises, then rest.
_STEP = np.array(
    [
        [0.0, 0.0, 0.0, 1 / 6],
        [1 / 6, 1 / 2, 1 / 2, -1 / 3],
        [5 / 6, 1 / 2, -1 / 2, 1 / 6],
        [1.0, 0.0, 0.0, 0.0],
    ]
)
_AFTER = 25  # periods after the reference's end in which a limit may still be reached
_TIP = SIGNALS.index("tip")
_FIRST = 9  # every ninth row is in the programme from the beginning
# Of a row's side, or of a thousandth of the largest one: 0.1 mrad of a move of 1 rad, 1 mV of 8 V.
_BROKEN, _PART = 1e-4, 1e-3


@dataclass(frozen=True)
class MoveBounds:
    """Largest magnitude of each signal but the tip, and of the reference's velocity and acceleration."""

    signals: dict[str, float]
    velocity: float
    acceleration: float


@dataclass(frozen=True)
class MoveSolution:
    """Coefficients [rad] and the largest distance of the tip to its target [rad]."""

    coefficients: Real
    distance: float


@dataclass(frozen=True)
class Programme:
    """Loops for every payload, the periods between two knots, and the bounds."""

    loops: Responses
    knot: int
    bounds: MoveBounds

    @property
    def period(self) -> float:
        """Of the law [s]."""
        return self.loops.period

    @property
    def length(self) -> int:
        """Samples that are known of every response."""
        return self.loops.length

    @cached_property
    def _answers(self) -> Real:
        """To one smooth step of 1 rad: shape (payloads, signals, N)."""
        return self.loops.to(spline_path(np.ones(1), self.knot * self.period))

    def solve(
        self, count: int, target: Real, first: int, last: int, *, within: float | None = None
    ) -> MoveSolution | None:
        """Return the spline of `count` coefficients whose tip is nearest to `target` from row first to last.

        The reference ends where the target ends. With `within` [rad] the tip keeps that distance and the
        acceleration varies as little as it can: of all such references the gentlest. None where no
        reference keeps the bounds.
        """
        rows, sides = self._kept(count, target, first, last)
        ends = np.append(np.ones(count), 0.0)
        free: list[tuple[float | None, float | None]] = [(None, None)] * count
        most: list[tuple[float | None, float | None]] = [(0.0, within)]
        end = [float(target[-1])]
        cost = np.append(np.zeros(count), 1.0)
        if within is not None:
            jerk = self._jerk(count)
            extra = len(jerk)
            rows = np.block(
                [[rows, np.zeros((len(rows), extra))], [jerk, -np.eye(extra)], [-jerk, -np.eye(extra)]]
            )
            sides = np.append(sides, np.zeros(2 * extra))
            cost, ends = np.append(np.zeros(count + 1), np.ones(extra)), np.append(ends, np.zeros(extra))
            most += [(0.0, None)] * extra
        found = _least(cost, rows, sides, ends[None, :], end, free + most)
        return None if found is None else MoveSolution(found[:count], float(found[count]))

    def _kept(self, count: int, target: Real, first: int, last: int) -> tuple[Real, Real]:
        """Every inequality as rows @ (c, e) <= sides."""
        until = min(count * self.knot + _AFTER, self.length)
        rows, sides = [], []
        for answer in self._answers:
            moved = self._shifted(answer[_TIP], count)[first:last]
            wanted, one = target[first:last], np.ones((len(moved), 1))
            rows += [np.hstack([moved, -one]), np.hstack([-moved, -one])]
            sides += [wanted, -wanted]
            for name, most in self.bounds.signals.items():
                part = self._shifted(answer[SIGNALS.index(name)], count)[:until]
                rows += [np.pad(sign * part, ((0, 0), (0, 1))) for sign in (1.0, -1.0)]
                sides += [np.full(len(part), most)] * 2
        for own, most in self._of_reference(count):
            rows += [np.pad(sign * own, ((0, 0), (0, 1))) for sign in (1.0, -1.0)]
            sides += [np.full(len(own), most)] * 2
        return np.vstack(rows), np.concatenate(sides)

    def _shifted(self, answer: Real, count: int) -> Real:
        found = np.zeros((len(answer), count))
        for j in range(count):
            found[j * self.knot :, j] = answer[: len(answer) - j * self.knot]
        return found

    def _of_reference(self, count: int) -> tuple[tuple[Real, float], ...]:
        """Velocity and acceleration at the knots, which bound them in between."""
        step = self.knot * self.period
        return (
            (np.eye(count) / step, self.bounds.velocity),
            (self._difference(count) / step**2, self.bounds.acceleration),
        )

    @staticmethod
    def _difference(count: int) -> Real:
        return np.diff(np.vstack([np.zeros((1, count)), np.eye(count), np.zeros((1, count))]), axis=0)

    def _jerk(self, count: int) -> Real:
        """Differences of the acceleration between knots over the most that it may be; a column for e."""
        second = np.pad(self._difference(count), ((1, 1), (0, 0)))
        scale = (self.knot * self.period) ** 2 * self.bounds.acceleration
        return np.pad(np.diff(second, axis=0) / scale, ((0, 0), (0, 1)))

    def path(self, solution: MoveSolution) -> Path:
        """Return the reference."""
        return spline_path(solution.coefficients, self.knot * self.period)

    def count_for(self, time: float) -> int:
        """Coefficients of a reference that goes on for two knots after `time` [s]."""
        return max(1, math.ceil(time / (self.knot * self.period) - 1e-9)) + 2


def _least(
    cost: Real,
    rows: Real,
    sides: Real,
    ends: Real,
    end: list[float],
    bounds: list[tuple[float | None, float | None]],
) -> Real | None:
    """Minimise cost @ x with rows @ x <= sides and ends @ x = end; None where nothing fulfils them.

    Of thousands of rows some dozens bind: the programme is solved with a few of them and again with all
    that its solution breaks, until it breaks none. That is exact, and takes a third of the time of all rows
    at once.
    """
    scale = np.maximum(np.abs(sides), _PART * np.max(np.abs(sides)))
    chosen = np.zeros(len(rows), dtype=bool)
    chosen[::_FIRST] = True
    while True:
        # presolve removes nothing from a dense programme, and costs more than the solution
        found = linprog(
            cost, rows[chosen], sides[chosen], ends, end, bounds, method="highs", options={"presolve": False}
        )
        if found.x is None:
            return None
        broken = rows @ found.x - sides > _BROKEN * scale
        if not np.any(broken & ~chosen):
            return np.asarray(found.x)
        # with their neighbours, which are next where the peak moves to one side
        chosen |= np.convolve(broken, np.ones(5), mode="same") > 0


def spline_path(coefficients: Real, step: float) -> Path:
    """Return the sum of smooth steps of these sizes [rad], one every `step` [s]."""
    count = len(coefficients)
    pieces = np.zeros((count + 3, 4))
    for j, size in enumerate(coefficients):
        pieces[j : j + 3] += size * _STEP[:3]
        pieces[j + 3 :, 0] += size
    pieces /= step ** np.arange(4.0)
    return Path("shaped", step * np.arange(count + 3.0), pieces, step * (count + 2))
