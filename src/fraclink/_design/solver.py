"""Solver for rows of inequalities: each step is the shortest one that meets them to
first order.

A row may be soft: a request that may be eased, or an unreachable goal that is eased as
little as possible. Each step is a least distance problem, solved as a non-negative
least squares problem (Lawson and Hanson, Solving Least Squares Problems, chapter 23); a
weight between the rows and the length of the step is raised after a step that agreed
with the gradients, and lowered otherwise, as in the Levenberg-Marquardt method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, nnls

__all__ = ["KEPT", "Rows", "eased", "least_distance", "lowest"]

Real = NDArray[np.float64]

KEPT = 2e-5  # relative violation that counts as met: a tenth of the reserve of the rows
# Weights in a step of the rows that may not be eased, relative to those that may.
_FIRST, _DEAR, _NEAR = 1e6, 1e3, 10.0
# Ten to twenty steps suffice from a start; a search that takes more is at a kink.
_STEPS = 40
_ASIDE = 0.03  # relative violation that a step may cause in a row that was met
# Weight of the easing against the length of the step: little more easing than in an
# equally good step within its bounds.
_EASED = 100.0
# Largest step in each parameter (all are logarithms or orders, in which the rows are
# smooth up to about one), and the step at which a search ends.
_RADIUS, _STILL = 1.0, 1e-4
_FINE = 1e-4  # absolute decrease of the cost at which a descent ends


@dataclass(frozen=True, eq=False)
class Rows:
    """Values that must not be negative (M,), their gradients (P, M), and which of them
    may be eased.
    """

    value: Real
    gradient: Real
    soft: NDArray[np.bool_]

    @cached_property
    def easing(self) -> float:
        """By how much the soft rows have to be eased."""
        return -float(np.min(self.value[self.soft], initial=0.0))

    @cached_property
    def missed(self) -> float:
        """By how much a row is missed that may not be eased."""
        return max(-float(np.min(self.value[~self.soft], initial=0.0)) - KEPT, 0.0)

    @cached_property
    def slack(self) -> float:
        """Both as one number, zero where every row is kept; what may not be eased comes
        first.
        """
        return self.easing + _FIRST * self.missed

    @cached_property
    def near(self) -> float:
        """Both, as a step weighs them that is judged by them."""
        return self.easing + _NEAR * self.missed

    def beside(self, other: Rows) -> bool:
        """Whether these rows are better than others in one of the two."""
        less = other.easing - 0.1 * self.missed
        return self.missed < 0.99 * other.missed or self.easing < less

    def step(self, low: Real, high: Real) -> tuple[Real, float]:
        """(the step within bounds, the slack that it leaves to first order)."""
        size, count = self.gradient.shape
        # columns: the step, the easing, and the violations
        system = np.zeros((count + 2 * size + 2, size + 2))
        system[:count, :size] = self.gradient.T
        system[:count, size] = np.where(self.soft, 1.0 / _EASED, 0.0)
        system[:count, size + 1] = np.where(self.soft, 0.0, 1.0 / (_EASED * _DEAR))
        system[count:-2, :size] = np.vstack([np.eye(size), -np.eye(size)])
        system[-2:, size:] = np.eye(2)
        least = np.concatenate([-self.value, low, -high, [0.0, 0.0]])
        answer = least_distance(system, least)
        step = answer[:size]
        easing, miss = answer[size:] / _EASED
        slack = float(easing + _NEAR * miss / _DEAR)
        return np.clip(step, low, high), slack


def least_distance(rows: Real, least: Real) -> Real:
    """Return the shortest y with ``rows @ y >= least``.

    >>> least_distance(np.array([[1.0, 0.0], [1.0, 1.0]]), np.array([1.0, 3.0])).round(9)
    array([1.5, 1.5])
    """
    system = np.vstack([rows.T, least])
    aim = np.zeros(len(system))
    aim[-1] = 1.0
    residual = system @ nnls(system, aim)[0] - aim
    return np.asarray(-residual[:-1] / residual[-1])


def eased(
    rows_at: Callable[[Real], list[Rows]],
    starts: Real,
    low: Real,
    high: Real,
    *,
    idle: float = 0.1,
) -> tuple[Real, Rows]:
    """Return the parameters where the slack is least, and their rows: from some starts
    (P, S) at once, the first that keep every row.

    Every four steps the worse half of the starts is left. The search ends where five
    steps gain less than the share `idle` of what is left.
    """
    x = np.clip(starts, low[:, None], high[:, None])
    rows, radius = rows_at(x), np.full(x.shape[1], _RADIUS)
    trail: list[list[Rows]] = [[] for _ in rows]
    best = min(zip(rows, x.T.copy(), strict=True), key=lambda pair: pair[0].slack)
    near = [best[0].near]
    for turn in range(_STEPS):
        going = np.flatnonzero(radius > _STILL)
        ranks = np.argsort([rows[start].slack for start in going], kind="stable")
        going = going[ranks][: max(len(rows) >> (turn // 4), 1)]
        idling = turn > 5 and near[-6] - near[-1] < idle * near[-1]
        if not going.size or best[0].slack <= KEPT or idling:
            break
        trial, gain = x[:, going], np.zeros(going.size)
        for k, start in enumerate(going):
            at, old = x[:, start], rows[start]
            reach = radius[start]
            step, least = old.step(
                np.maximum(low - at, -reach), np.minimum(high - at, reach)
            )
            trial[:, k], gain[k] = at + step, old.near - least
        for k, (start, new) in enumerate(zip(going, rows_at(trial), strict=True)):
            old = rows[start]
            best = min(best, (new, trial[:, k]), key=lambda pair: pair[0].slack)
            fine = all(new.beside(other) for other in (*trail[start], old))
            if fine and new.missed <= max(old.missed, _ASIDE):
                trail[start].append(old)
                more = 2.0 if old.near - new.near > 0.5 * gain[k] else 1.0
                radius[start] = min(more * radius[start], _RADIUS)
                x[:, start], rows[start] = trial[:, k], new
            else:
                radius[start] = 0.25 * float(np.max(np.abs(trial[:, k] - x[:, start])))
            if gain[k] < KEPT:
                radius[start] = 0.0
        near.append(min(near[-1], *(rows[start].near for start in going)))
    return best[1], best[0]


def lowest(
    costs_and_rows: Callable[[Real], tuple[Rows, Rows]],
    start: Real,
    low: Real,
    high: Real,
) -> tuple[Real, bool]:
    """Return where the largest of some costs is least while rows are kept, by sequential
    quadratic programming, and whether it got there; both keep their number. What it ends
    at may miss rows.
    """

    @lru_cache(maxsize=1)
    def at(parameters: bytes) -> tuple[Rows, Rows]:
        return costs_and_rows(np.frombuffer(parameters))

    # the last unknown is the largest cost
    def kept(z: Real) -> Real:
        costs, rows = at(z[:-1].tobytes())
        return np.concatenate([rows.value, z[-1] - costs.value])

    def slopes(z: Real) -> Real:
        costs, rows = at(z[:-1].tobytes())
        largest = np.repeat([0.0, 1.0], [rows.value.size, costs.value.size])
        gradient = np.concatenate([rows.gradient, -costs.gradient], axis=1)
        return np.column_stack([gradient.T, largest])

    direction = np.append(np.zeros(start.size), 1.0)
    with np.errstate(all="ignore"):
        largest = float(np.max(at(start.tobytes())[0].value))
        end = minimize(
            lambda z: (z[-1], direction),
            np.append(start, largest),
            jac=True,
            method="SLSQP",
            bounds=[*zip(low, high, strict=True), (None, None)],
            constraints={"type": "ineq", "fun": kept, "jac": slopes},
            options={"maxiter": _STEPS, "ftol": _FINE},
        )
    return np.clip(end.x[:-1], low, high), bool(end.success)
