"""Rows that must be kept, and a descent along them with one variable as its goal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

__all__ = ["Astray", "Kept", "Rows", "descended", "peaks"]

Real = NDArray[np.float64]

# Towards the rows alone it takes ten measurements; behind sixty a search is astray, and
# the next one begins where the best of it was.
_FEW, _MANY = 40, 60
# of a parameter: how far a run goes from where it began, as its rows are known there
_REACH = 1.0


@dataclass(frozen=True, eq=False)
class Rows:
    """Values that must not be negative (M,), their gradients over x, goal and slack
    (P + 2, M), which of them the slack may give, and the link and the key of each.
    """

    value: Real
    gradient: Real
    soft: NDArray[np.bool_]
    link: NDArray[np.int64]
    key: list[str]


class Astray(Exception):
    """A search measured the rows more often than one that converges."""


class Kept(Exception):
    """Every row is kept: what was looked for."""


def descended(
    start: Real,
    rows: Callable[[Real], Rows],
    limits: Sequence[tuple[float, float]],
    *,
    skipped: int,
) -> Real:
    """Where the last of some variables is least while every row is kept, from `start`;
    `skipped` is the column of the gradient that is none of them.
    """
    low, high = np.array(limits).T
    z = np.clip(start, low, high)
    low[:-1] = np.maximum(low[:-1], z[:-1] - _REACH)
    high[:-1] = np.minimum(high[:-1], z[:-1] + _REACH)
    free = np.flatnonzero(high > low)
    direction = np.zeros(free.size)
    direction[-1] = 1.0
    columns = np.delete(np.arange(low.size + 1), skipped)[free]
    last: dict[bytes, Rows] = {}
    trials = 0

    def at(part: Real) -> Rows:
        nonlocal trials
        key = part.tobytes()
        if key not in last:
            trials += 1
            if trials > _MANY:
                raise Astray
            last.clear()
            z[free] = part
            last[key] = rows(z)
        return last[key]

    try:
        found = minimize(
            lambda part: (float(np.dot(direction, part)), direction),
            z[free],
            jac=True,
            bounds=np.stack([low, high], axis=1)[free],
            constraints={
                "type": "ineq",
                "fun": lambda part: at(part).value,
                "jac": lambda part: at(part).gradient[columns].T,
            },
            method="SLSQP",
            options={"maxiter": _FEW, "ftol": 1e-6},
        )
    except Astray:
        return z
    z[free] = found.x
    return z


def peaks(merit: Real) -> NDArray[np.int64]:
    """The flat indices of the points of a lattice of three axes that are no worse than
    their neighbours, the best first.
    """
    walled = np.pad(merit, 1, constant_values=-np.inf)
    best = np.ones(merit.shape, dtype=bool)
    for step in product((0, 1, 2), repeat=3):
        part = tuple(slice(k, k + n) for k, n in zip(step, merit.shape, strict=True))
        best &= merit >= walled[part]
    chosen = np.flatnonzero(best)
    return chosen[np.argsort(-merit.ravel()[chosen], kind="stable")]
