"""Least squares from many starts at once with linear parameters projected out; profiled
intervals.

Levenberg and Marquardt's method in a box, on residuals of any shape (M, R) for M
parameter vectors: what the arrays of one call can do for one start they do for all of
them. Variable projection: gain and offset are solved for inside the residual, so that a
start needs no value of theirs and a step cannot trade one for the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq
from scipy.optimize import OptimizeResult

__all__ = [
    "ENOUGH", "QUANTILE", "Blocks", "Descent", "Interval", "Profile", "Stepped", "blocks_of", "decrement",
    "descend", "differences", "interval_end", "project", "stepped",
]  # fmt: skip

Reals = NDArray[np.float64]
Residuals = Callable[
    [Reals], Reals
]  # (M, p) -> (M, R); rows that have no value are not finite

# of the differences: responses are known to 1e-12 of their peak, so that slopes are to
# 1e-6
_STEP = 1e-6
_DAMPING = (1e-12, 1e12)
_STUCK = 1e9  # damping at which a step is none
_ENDED = (
    1e-10  # of the cost: in 10 000 samples a step of a thousandth of a standard error
)
# of the cost: what a last step still gains; in 10 000 samples a tenth of a parameter's
ENOUGH = 1e-5
_STEPS = 60
_DAMPED, _MOST_DAMPED = 1e-4, 1e4  # of a normal matrix with ones on its diagonal
_SINGULAR = 1e-11  # of that matrix: a direction that is hardly seen


@dataclass(frozen=True, eq=False)
class Descent:
    """Where M descents ended: places (M, p), costs (M,), and the calls that it took."""

    places: Reals
    costs: Reals
    converged: NDArray[np.bool_]
    evaluations: int


def differences(
    residuals: Residuals, places: Reals, at: Reals, low: Reals, high: Reals
) -> Reals:
    """Jacobians (M, p, R) by one-sided differences that stay inside the box."""
    count, size = places.shape
    # One-sided, since a second response would double the cost of the search; 1e-6 of a
    # coordinate of order one.
    step = _STEP * np.where(places + _STEP > high, -1.0, 1.0)
    # A limit of the domain that is no limit of the box (an improper function) is left
    # backwards.
    for side in (1.0, -1.0):
        moved = np.repeat(places[:, None, :], size, axis=1)
        moved[:, range(size), range(size)] += side * step
        moved = np.clip(moved, low, high)
        # What was really moved, after clipping and rounding.
        taken = moved[:, range(size), range(size)] - places
        taken = np.where(taken == 0.0, np.inf, taken)
        there = residuals(moved.reshape(count * size, size)).reshape(count, size, -1)
        slopes = (there - at[:, None, :]) / taken[:, :, None]
        if np.isfinite(slopes).all():
            return np.asarray(slopes)
    return np.where(np.isfinite(slopes), slopes, 0.0)


def descend(
    residuals: Residuals,
    places: Reals,
    low: Reals,
    high: Reals,
    *,
    iterations: int,
    shear: Reals | None = None,
) -> Descent:
    """The descent from every row of `places`; one ends where the next step would gain
    1e-10 of its cost.

    `shear` (p, p) gives coordinates in which the valleys of the cost lie along the
    axes: damping counts there. What a step would gain is the Newton decrement: a short
    step says only that the damping is large.
    """
    places = np.clip(np.array(places, dtype=np.float64), low, high)
    count, size = places.shape
    at = np.array(residuals(places))  # rows are written below
    costs, evaluations = _costs(at), count
    # A start without a value has no slope to leave it by: it is done, and its cost
    # stays infinite.
    damping, done = np.full(count, 1e-3), ~np.isfinite(costs)
    if size == 0:
        return Descent(places, costs, ~done, evaluations)
    shear = np.eye(size) if shear is None else shear
    normal, slope = np.zeros((count, size, size)), np.zeros((count, size))
    settled = np.zeros(count, dtype=bool)
    fresh = np.zeros(count, dtype=bool)
    for _ in range(iterations):
        moving = np.flatnonzero(~done)
        if not moving.size:
            break
        # A refused step changes the damping only: its derivatives stand, and trying
        # again costs one evaluation.
        stale = moving[~fresh[moving]]
        if stale.size:
            jacobian = differences(residuals, places[stale], at[stale], low, high)
            evaluations += stale.size * size
            normal[stale] = jacobian @ jacobian.transpose(0, 2, 1)
            slope[stale] = np.einsum("mpr,mr->mp", jacobian, at[stale])
            fresh[stale] = True
        steps, gains = _steps(
            normal[moving],
            slope[moving],
            damping[moving],
            places[moving],
            (low, high),
            shear,
        )
        # By what the step would gain and not by its length: in a long valley short
        # steps still gain.
        settled[moving] = gains <= _ENDED * costs[moving]
        tried = np.clip(places[moving] - steps, low, high)
        there = residuals(tried)
        evaluations += moving.size
        cost = _costs(there)
        better = cost < costs[moving]
        done[moving] = settled[moving] | (~better & (damping[moving] > _STUCK))
        won, lost = moving[better], moving[~better]
        places[won], at[won], costs[won], fresh[won] = (
            tried[better],
            there[better],
            cost[better],
            False,
        )
        # Down faster than up, and by no power of each other: a damping that failed is
        # not tried again.
        damping[won] = np.maximum(damping[won] * 0.1, _DAMPING[0])
        damping[lost] = np.minimum(damping[lost] * 8.0, _DAMPING[1])
    return Descent(places, costs, settled & np.isfinite(costs), evaluations)


def _steps(
    normal: Reals,
    slope: Reals,
    damping: Reals,
    places: Reals,
    box: tuple[Reals, Reals],
    shear: Reals,
) -> tuple[Reals, Reals]:
    """Damped Gauss–Newton steps (M, p), and what undamped ones would gain if the cost
    were a parabola (M,).

    A coordinate that a limit stops is held, or it would bend the others' step.
    """
    matrix, right = normal.copy(), slope.copy()
    held = ((places <= box[0]) & (right > 0)) | ((places >= box[1]) & (right < 0))
    matrix[held] = 0.0
    matrix.transpose(0, 2, 1)[held] = 0.0
    right[held] = 0.0
    # Marquardt's scaling: damping counts in units of each coordinate's own curvature,
    # so that a step does not depend on the units of the parameters.
    back = np.linalg.inv(shear)
    along = np.einsum(
        "ip,mij,jp->mp", back, matrix, back
    )  # diagonal in the sheared coordinates
    # A direction without curvature would be undamped, and its step infinite.
    along = np.maximum(along, 1e-12 * along.max(axis=1, keepdims=True) + 1e-300)
    damper = np.einsum("pi,mp,pj->mij", shear, along, shear)
    matrix[:, range(matrix.shape[1]), range(matrix.shape[1])] += np.where(
        held, 1.0, 0.0
    )
    # A trace of damping alone keeps a singular matrix solvable; what it says a step
    # would gain is that of the undamped one.
    whole = np.linalg.solve(matrix + 1e-12 * damper, right[:, :, None])[:, :, 0]
    steps = np.linalg.solve(
        matrix + damping[:, None, None] * damper, right[:, :, None]
    )[:, :, 0]
    return np.asarray(steps), np.asarray(np.einsum("mp,mp->m", whole, right))


def _costs(residual: Reals) -> Reals:
    with np.errstate(over="ignore", invalid="ignore"):
        costs = np.einsum("mr,mr->m", residual, residual)
    return np.where(np.isfinite(costs), costs, np.inf)


# --- one place at a time, where a Jacobian costs less than a response -----------------------------------


@dataclass(frozen=True, eq=False)
class Blocks:
    """Rows of a Jacobian, one value for each block of samples: sums over blocks are
    sums over samples.
    """

    rows: Reals
    width: int
    sharp: bool = True  # a descent may end on them

    def of(self, samples: Reals) -> Reals:
        """Samples (N,) as one value for each block, of the same variance where they are
        white.
        """
        return blocks_of(samples, self.width)


def blocks_of(samples: Reals, width: int) -> Reals:
    """Means of blocks, times the root of their width: white noise keeps its variance."""
    whole = samples.size // width * width
    return np.asarray(samples[:whole].reshape(-1, width).sum(axis=1) / math.sqrt(width))


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
    """The descent of |residual|² from a place, to a cost `least` or a step that gains
    hardly more.

    `moving` are the rows of the coordinates; other rows belong to parameters that
    `residual` projects out. It ends not converged at a limit of the box, where there
    are no rows or they do not tell a step or are not sharp enough to end on, and,
    unless `damped` steps are wanted, at one that does not gain.
    """
    place, rest = begin, residual(begin)
    cost, count = float(rest @ rest), 1
    gain, damping, found = math.inf, 0.0, None
    for _ in range(_STEPS if math.isfinite(cost) else 0):
        # A step moves the parameters by a standard error where it gains p σ² = p
        # cost/n: within that the valley's slope is the same.
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
            # As in `descend`: up by eight, down by ten, so that no damping that failed
            # is tried again.
            damping = max(8.0 * damping, _DAMPED)
            continue
        place, rest, cost, damping = tried, there, reached, 0.1 * damping
        # At a limit the other coordinates need a step of their own, which a trust
        # region takes and this does not.
        if np.any((place <= box[0]) | (place >= box[1])):
            break
        if done:
            return Stepped(place, cost, True, found.sharp, count)
    return Stepped(place, cost, False, False, count)


def _newton(rows: Reals, rest: Reals, damping: float) -> tuple[Reals, float]:
    """The damped step, and what it would gain undamped; not finite where the rows do
    not tell it.
    """
    normal, slope = rows @ rows.T, rows @ rest
    # Unit columns, so that 1e-11 says how much two parameters trade and not in which
    # units they are.
    size = np.sqrt(np.diag(normal))
    with np.errstate(all="ignore"):
        values, vectors = np.linalg.eigh(np.nan_to_num(normal / np.outer(size, size)))
        if not values[0] > _SINGULAR:
            return np.full(slope.size, np.nan), math.inf
        # In the axes of the valley one decomposition serves every damping, and the
        # undamped gain is a sum of squares.
        along = vectors.T @ (slope / size)
        return vectors @ (along / (values + damping)) / size, float(
            along @ (along / values)
        )


def decrement(found: OptimizeResult) -> float:
    """What a Gauss–Newton step in the coordinates that no limit holds would gain."""
    jacobian = found.jac[:, found.active_mask == 0]
    size = np.linalg.norm(jacobian, axis=0)
    # By QR of the Jacobian and not by its square: at the end of a curved valley the
    # latter loses the digits that decide.
    gained = lstsq(jacobian / np.where(size > 0, size, 1.0), found.fun, cond=1e-9)[0]
    along = jacobian / np.where(size > 0, size, 1.0) @ gained
    return float(along @ along)


# --- linear parameters --------------------------------------------------------------------------------------


def project(
    measured: Reals, columns: Reals, low: Reals, high: Reals
) -> tuple[Reals, Reals]:
    """Residuals (M, R) and coefficients (M, c) of c <= 2 columns (M, c, R) fitted to
    (R,) in limits.
    """
    count, size, _ = columns.shape
    if size == 0:
        return np.repeat(measured[None, :], count, axis=0), np.zeros((count, 0))
    with np.errstate(all="ignore"):
        normal = np.einsum("mir,mjr->mij", columns, columns)
        right = columns @ measured
        best = np.stack(
            [_solved(normal, right, low, high, order) for order in range(size)]
        )
        # The first column is fitted inside its limits, then the others to what it
        # leaves, and the other way round; where no limit is met both are the
        # least-squares solution.
        left = measured - np.einsum("omi,mir->omr", best, columns)
        choice = np.argmin(
            np.nan_to_num(np.einsum("omr,omr->om", left, left), nan=np.inf), axis=0
        )
    picked = (choice, np.arange(count))
    return left[picked], best[picked]


def _solved(normal: Reals, right: Reals, low: Reals, high: Reals, first: int) -> Reals:
    if normal.shape[1] == 1:
        return np.clip(right / normal[:, :, 0], low, high)
    other = 1 - first
    # Two columns by Cramer's rule for all candidates at once: a call of `solve` each
    # would take longer than the response.
    determinant = normal[:, 0, 0] * normal[:, 1, 1] - normal[:, 0, 1] ** 2
    own = (
        right[:, first] * normal[:, other, other] - right[:, other] * normal[:, 0, 1]
    ) / determinant
    result = np.empty_like(right)
    result[:, first] = np.clip(own, low[first], high[first])
    rest = (right[:, other] - normal[:, 0, 1] * result[:, first]) / normal[
        :, other, other
    ]
    result[:, other] = np.clip(rest, low[other], high[other])
    return result


Near = TypeVar("Near")

QUANTILE = 1.959963984540054  # of the normal distribution at 97.5 %


@dataclass(frozen=True)
class Interval:
    """A 95 % interval; an open end is a limit of the parameter's range that the log
    does not exclude.

    >>> Interval(1.91, 1.93, False, False).contains(1.92)
    True
    """

    low: float
    high: float
    low_open: bool
    high_open: bool

    def contains(self, value: float) -> bool:
        """Whether `value` lies in the interval."""
        return self.low <= value <= self.high


class Profile(Protocol[Near]):
    """The best cost at given values of one parameter; `Near` is where the search at the
    next value begins.
    """

    @property
    def samples(self) -> int:
        """Number of samples."""
        ...

    @property
    def least(self) -> float:
        """Cost of the fit."""
        ...

    @property
    def begin(self) -> Near:
        """Where the fit stands."""
        ...

    def cost(self, value: float, near: Near) -> tuple[float, Near]:
        """The best cost at a value, and where it is reached."""
        ...


def interval_end(
    profile: Profile[Near], centre: float, step: float, limit: float, inflation: float
) -> tuple[float, bool]:
    """One end of an interval and whether it is open; `step` is where it is expected,
    from the centre.

    The root of the log-likelihood is nearly straight (exactly so for a linear model),
    so that secants through it meet the quantile in two or three fits where bisection
    would take twenty.
    """
    samples, least, shape = profile.samples, profile.least, profile.begin
    # A bracket from the start: the fit itself is inside, and nothing is known to be
    # outside.
    inside, inside_root, outside, outside_root = centre, 0.0, math.nan, math.inf
    value = centre + step
    for _ in range(25):
        beyond = (limit - value) * step <= 0
        value = limit if beyond else value
        cost, near = profile.cost(value, shape)
        height = math.inf
        if math.isfinite(cost):
            height = math.sqrt(
                max(samples * math.log(max(cost / least, 1.0)) / inflation, 0.0)
            )
        if (
            abs(height - QUANTILE) < 2e-3
        ):  # a thousandth of the quantile: 0.01 % of the coverage
            return value, False
        if height < QUANTILE:
            if beyond:
                return limit, True
            inside, inside_root, shape = value, height, near
        else:
            outside, outside_root = value, height
        if math.isnan(outside):
            # As far as the straight root says, at least 5 % farther (or rounding stops
            # it) and at most four times: behind that the profile may have another
            # valley.
            ratio = QUANTILE / inside_root if inside_root > 0 else 4.0
            value = centre + (inside - centre) * min(max(ratio, 1.05), 4.0)
        elif math.isfinite(outside_root):
            # 5 % away from either end, or a secant along a bent root would creep up to
            # the end it came from.
            part = (QUANTILE - inside_root) / (outside_root - inside_root)
            value = inside + (outside - inside) * min(max(part, 0.05), 0.95)
        else:  # no fit there at all: the secant has nothing to go by
            value = (inside + outside) / 2
        if abs(outside - inside) < 1e-9 * abs(centre):
            return outside, False
    # Open where 25 fits never left the likelihood's reach.
    return value, math.isnan(outside)
