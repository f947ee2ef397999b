"""Damped steps of Gauss and Newton where a Jacobian costs less than a response.

Levenberg and Marquardt's method for one place: every step costs one residual, and the Jacobian is asked for
again only where the last step was longer than a standard error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq
from scipy.optimize import OptimizeResult

from fraclink._identify.structure_slopes import Blocks

__all__ = ["ENOUGH", "Stepped", "decrement", "stepped"]

Reals = NDArray[np.float64]

ENOUGH = 1e-5  # of the cost: what a last step still gains; in 10 000 samples a tenth of a parameter's
_STEPS = 60
_DAMPED, _MOST_DAMPED = 1e-4, 1e4  # of a normal matrix with ones on its diagonal
_SINGULAR = 1e-11  # of that matrix: a direction that is hardly seen


@dataclass(frozen=True, eq=False)
class Stepped:
    """Where the steps led, the cost there, and the residuals that they took.

    `ended`: no step gained more; `converged`: nor would one with a sharper Jacobian.
    """

    place: Reals
    cost: float
    ended: bool
    converged: bool
    evaluations: int


def stepped(
    residual: Callable[[Reals], Reals],
    rows: Callable[[Reals], Blocks | None],
    begin: Reals,
    box: tuple[Reals, Reals],
    moving: list[int],
    least: float,
    *,
    damped: bool,
) -> Stepped:
    """The descent of |residual|² from a place, to a cost `least` or a step that gains hardly more.

    `moving` are the rows of the coordinates; other rows belong to parameters that `residual` projects out.
    It ends not converged at a limit of the box, where there are no rows or they do not tell a step or are not
    sharp enough to end on, and, unless `damped` steps are wanted, at one that does not gain.
    """
    place, rest = begin, residual(begin)
    cost, count = float(rest @ rest), 1
    gain, damping, found = math.inf, 0.0, None
    for _ in range(_STEPS if math.isfinite(cost) else 0):
        # A step moves the parameters by a standard error where it gains p σ² = p cost/n: within that the
        # valley's slope is the same.
        if found is None or gain * rest.size > cost * begin.size:
            found = rows(place)
        if found is None:
            break
        step, gain = _newton(found.rows, found.of(rest), damping)
        if not np.isfinite(step).all():
            break
        tried = np.clip(place + step[moving], *box)
        done = gain <= max(ENOUGH * cost, least)
        there = residual(tried)
        count += 1
        reached = float(there @ there)
        if not reached < cost:
            if done or not damped or not damping < _MOST_DAMPED:
                return Stepped(place, cost, done, done and found.sharp, count)
            # As in `descend`: up by eight, down by ten, so that no damping that failed is tried again.
            damping = max(8.0 * damping, _DAMPED)
            continue
        place, rest, cost, damping = tried, there, reached, 0.1 * damping
        # At a limit the other coordinates need a step of their own, which a trust region takes and this does
        # not.
        if np.any((place <= box[0]) | (place >= box[1])):
            break
        if done:
            return Stepped(place, cost, True, found.sharp, count)
    return Stepped(place, cost, False, False, count)


def _newton(rows: Reals, rest: Reals, damping: float) -> tuple[Reals, float]:
    """The damped step, and what it would gain undamped; not finite where the rows do not tell it."""
    normal, slope = rows @ rows.T, rows @ rest
    # Unit columns, so that 1e-11 says how much two parameters trade and not in which units they are.
    size = np.sqrt(np.diag(normal))
    with np.errstate(all="ignore"):
        values, vectors = np.linalg.eigh(np.nan_to_num(normal / np.outer(size, size)))
        if not values[0] > _SINGULAR:
            return np.full(slope.size, np.nan), math.inf
        # In the axes of the valley one decomposition serves every damping, and the undamped gain is a sum of
        # squares.
        along = vectors.T @ (slope / size)
        return vectors @ (along / (values + damping)) / size, float(along @ (along / values))


def decrement(found: OptimizeResult) -> float:
    """What a Gauss–Newton step in the coordinates that no limit holds would gain."""
    jacobian = found.jac[:, found.active_mask == 0]
    size = np.linalg.norm(jacobian, axis=0)
    # By QR of the Jacobian and not by its square: at the end of a curved valley the latter loses the digits
    # that decide.
    gained = lstsq(jacobian / np.where(size > 0, size, 1.0), found.fun, cond=1e-9)[0]
    along = jacobian / np.where(size > 0, size, 1.0) @ gained
    return float(along @ along)
