"""The engine of all fits: the problem, its descent, and the ends of its intervals.

A problem gives, for M candidates at once, the cost of each and its change around it,

    cost(x + d) = cost − 2 slopeᵀ d + dᵀ normal d,

with the offset, and the gain of a link, projected out (Golub and Pereyra, SIAM J. Numer.
Anal. 10 (1973) 413): a start needs no values for them, and no step can trade them for
other parameters. Each problem computes these numbers in its own way (a Gram matrix of the compiled kernel, a
Laplace transform, exact responses).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from fracsys._precision import BLUR, EPSILON, ROUNDS
from fracsys.checks import Mask, Real

# Chance below which something counts as shown.
LEVEL = 1e-3
# In standard errors: the deviation that noise exceeds with this chance (two-sided), and
# half the width of a 95 % interval.
CERTAIN, QUANTILE = (float(-ndtri(chance / 2)) for chance in (LEVEL, 0.05))
# Share of a power that is clearly less than the whole: half of the amplitude, 6 dB. A law
# whose model leaves more than this of an unseen motion cannot cancel more than half of the
# vibration.
CLEARLY_LESS = 0.25
# Share of a power that is most of it: no two causes can each explain as much.
MOST = 0.5
# Half-width of an order's interval beyond which the data do not determine it: the
# difference between two structures that people would distinguish.
ORDER_MOST = 0.25
# Share of the output's power that 16 bits resolve. What is fitted more closely is a
# simulation, whose residual is rounding or the interpolation between its samples.
RESOLUTION = 2.0**-32
# Smallest eigenvalue of a normal matrix scaled to ones on its diagonal: since its
# entries are sums of products of doubles, a weaker direction is rounding.
_UNSEEN = 1e-10
# Factors on the damping after a success and a failure: one tenth and eight, so that no
# damping that failed is tried again.
_FASTER, _SLOWER = 0.1, 8.0
# Measured numbers per free parameter, at least: a fit of noise then leaves four fifths of
# its sum of squares, which a gate rejects.
LEAST_EACH = 5
FIRST_STEPS = 10  # enough to tell a promising descent from a lost one


@dataclass(frozen=True, eq=False)
class Quadratic:
    """Costs (M,) of M candidates with half their negative slopes (M, p) and their
    Gauss–Newton matrices (M, p, p).
    """

    cost: Real
    slope: Real
    normal: Real


class Problem(ABC):
    """A least-squares problem in a box of p coordinates."""

    @property
    @abstractmethod
    def box(self) -> tuple[Real, Real]:
        """Lower and upper limits (p,)."""

    @property
    @abstractmethod
    def measured(self) -> Real:
        """The values that are fitted (n,), weighted as in the cost."""

    @property
    def samples(self) -> int:
        """Number of measured values."""
        return self.measured.size

    @cached_property
    def power(self) -> float:
        """The sum of the squared measured values."""
        return float(self.measured @ self.measured)

    @property
    def precision(self) -> float:
        """The share of the cost that a step must gain for its descent to continue."""
        return 1e-10

    @property
    def reach(self) -> Real:
        """The longest step (p,) within the validity of a quadratic model: 1 for a
        logarithm, for which the linearised parameter reaches zero there.
        """
        return np.full(self.box[0].size, math.inf)

    def clip(self, places: Real) -> Real:
        """The nearest admissible places."""
        return np.clip(places, *self.box)

    @abstractmethod
    def quadratic(self, places: Real) -> Quadratic:
        """Costs and quadratic models at places (M, p)."""


def at_limits(places: Real, low: Real, high: Real) -> Mask:
    """Which coordinates (p,) ended on a limit of their range."""
    # Share of the range: on the logarithmic scale of a coefficient from 1e-12 to 1e12, a
    # factor of 1 + 7e-6.
    near = BLUR * (high - low)
    return (places <= low + near) | (places >= high - near)


# --- the descent ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Descent:
    """The ends of M descents: places (M, p), costs (M,), Gauss–Newton matrices (M, p,
    p), and whether no step would gain anything.
    """

    places: Real
    costs: Real
    normal: Real
    converged: Mask


# A candidate may overflow: its cost is infinite, and it is dropped.
@np.errstate(all="ignore")
def descend(
    problem: Problem,
    places: Real,
    *,
    iterations: int = ROUNDS,
    box: tuple[Real, Real] | None = None,
) -> Descent:
    """Levenberg-Marquardt descents from all rows of `places` at once, within the
    problem's limits, or within a narrower `box`: low and high, (M, p) each.

    A descent ends where an undamped step would gain less than the problem's precision
    (the Newton decrement: a short step says only that the damping is large) or less
    than the rounding of a perfect fit.
    """
    shape = np.shape(places)
    low, high = (np.broadcast_to(x, shape) for x in box or problem.box)
    places = np.clip(problem.clip(np.array(places, np.float64)), low, high)
    at = problem.quadratic(places)
    costs, slope, normal = at.cost.copy(), at.slope.copy(), at.normal.copy()
    damping = np.full(len(places), 1e-3)
    # A start whose cost is not finite has no slope along which to leave it.
    moving, settled = np.isfinite(costs), np.zeros(len(places), bool)
    for _ in range(iterations):
        own = np.flatnonzero(moving)
        if not own.size:
            break
        step, gain = _damped_steps(
            normal[own],
            slope[own],
            damping[own],
            np.maximum(low[own] - places[own], -problem.reach),
            np.minimum(high[own] - places[own], problem.reach),
        )
        least = np.maximum(problem.precision * costs[own], EPSILON * problem.power)
        settled[own] = gain <= least
        trial = np.clip(problem.clip(places[own] + step), low[own], high[own])
        at = problem.quadratic(trial)
        better = at.cost < costs[own]
        # After a success a descent continues while a step may gain 1 % of `least`; after
        # a failure, if it has not settled and the damping still leaves a step.
        moving[own] = np.where(
            better,
            gain > 0.01 * least,
            ~settled[own] & (BLUR * damping[own] < 1.0),
        )
        damping[own] *= np.where(better, _FASTER, _SLOWER)
        successes = own[better]
        places[successes], costs[successes] = trial[better], at.cost[better]
        slope[successes], normal[successes] = at.slope[better], at.normal[better]
    return Descent(places, costs, normal, settled & np.isfinite(costs))


def descend_within_samples(
    problem: Problem, place: Real, k: int, period: float
) -> Descent:
    """Descents with coordinate k, a delay, held within its sampling interval, and
    within the one before.

    A held input jumps, and the response to a jump may begin with a vertical tangent: as
    a function of the delay the cost has a cusp wherever a sample passes a jump, and is
    smooth only from a sample (included) back to the one before. For a delay on a
    sample, to 1e-9 of the period, the interval that ends there suffices.
    """
    delay = place[k] / period
    whole = np.unique([math.floor(delay + 1e-9), math.ceil(delay - 1e-9)])
    low, high = (np.tile(x, (whole.size, 1)) for x in problem.box)
    low[:, k] = np.maximum((whole - 1 + 1e-6) * period, low[:, k])
    high[:, k] = np.minimum(whole * period, high[:, k])
    # At a delay of zero the interval is that single value, and only the others are
    # fitted.
    inside = low[:, k] <= high[:, k]
    # The descent starts at the sample, where the cost is smooth from below.
    rows = np.where(np.arange(place.size) == k, high, place)
    box = low[inside], high[inside]
    return descend(problem, rows[inside], box=box)


def _damped_steps(
    normal: Real, slope: Real, damping: Real, low: Real, high: Real
) -> tuple[Real, Real]:
    """Damped steps (M, p) between `low` and `high`, and the gain of undamped ones (M,).

    A coordinate that would go beyond its limit is held there, and the others follow from
    the quadratic model given that step. If it were only cut off, the step would lead out
    of the valley.
    """
    held = (low >= 0) & (slope < 0) | (high <= 0) & (slope > 0)
    # An overflow says nothing about the other entries.
    normal = np.where(np.isfinite(normal), normal, 0.0)
    step, gain = _free_steps(normal, slope, damping, held)
    while (beyond := ~held & ((step < low) | (step > high))).any():
        held |= beyond
        given = np.where(held, np.clip(step, low, high), 0.0)
        rest = slope - np.einsum("mpq,mq->mp", normal, given)
        step = given + _free_steps(normal, rest, damping, held)[0]
    return step, gain


def _free_steps(
    normal: Real, slope: Real, damping: Real, held: Mask
) -> tuple[Real, Real]:
    """Damped steps (M, p), zero for held coordinates, and the gain of undamped ones
    (M,).

    In units of each coordinate's own curvature (Marquardt) a step does not depend on
    the units of the parameters, and in the axes of the valley one decomposition serves
    damped and undamped steps.
    """
    values, vectors, size = _axes(normal, held)
    along = np.einsum("mpk,mp->mk", vectors, np.where(held, 0.0, slope) / size)
    visible = values > _UNSEEN
    gain = np.where(visible, along**2 / np.maximum(values, _UNSEEN), 0.0).sum(axis=1)
    # Along an undetermined direction any step is equally good, and rounding would
    # choose it.
    step = np.where(visible, along / (values + damping[:, None]), 0.0)
    return np.where(held, 0.0, np.einsum("mpk,mk->mp", vectors, step) / size), gain


def _axes(normal: Real, held: Mask) -> tuple[Real, Real, Real]:
    """Eigenvalues, eigenvectors and column scales of normal matrices scaled to ones on
    their diagonals, without the held coordinates.
    """
    square = normal.diagonal(axis1=1, axis2=2)
    size = np.sqrt(np.where((square > 0) & np.isfinite(square), square, 1.0))
    matrix = normal / (size[:, :, None] * size[:, None, :])
    matrix = np.where(np.isfinite(matrix), matrix, 0.0)
    apart = held[:, :, None] | held[:, None, :]
    matrix = np.where(apart, np.eye(held.shape[1]), matrix)
    values, vectors = np.linalg.eigh(matrix)
    return values, vectors, size


def inverted(normal: Real) -> tuple[Real, Real]:
    """Inverse of a normal matrix (p, p), and the directions (p, k) that the data leave
    undetermined, in units of each coordinate's own curvature.

    Along such a direction the error is not zero but 1e7 times the others': large enough
    to fail every gate, and finite for printing.
    """
    if not normal.size:
        return normal, normal
    values, vectors, size = (
        x[0] for x in _axes(normal[None], np.zeros((1, len(normal)), bool))
    )
    inverse = (vectors / np.maximum(values, 1e-14)) @ vectors.T / np.outer(size, size)
    return inverse, vectors[:, values < _UNSEEN]


# --- intervals --------------------------------------------------------------------------------------------


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


Parameters = Callable[
    [Real], tuple[Real, Real]
]  # (M, p) -> values (M, q), gradients (M, q, p)

# Ends that no limit stops are found in 4 to 13 iterations; for others the cost never
# rises far enough.
_TURNS = 30
_MET = 2e-3  # relative to the quantile: 0.02 % of coverage at each end
_FAR = 1.5  # multiple of the quantile, beyond which the quadratic model fails


@np.errstate(all="ignore")
def interval_ends(
    problem: Problem,
    best: Real,
    least: float,
    parameters: Parameters,
    inflation: Real,
) -> tuple[Interval, ...]:
    """95 % likelihood intervals of parameters: n ln(cost/least) ≤ 1.96² `inflation`
    (q,) with all others at their best.

    Every end is the largest (or least) value of the parameter on the surface of that
    cost (Venzon and Moolgavkar, Appl. Statist. 37 (1988) 87): on the quadratic model at
    x it is x + H⁻¹ slope ± H⁻¹ g √((c − m)/gᵀH⁻¹g) with the parameter's gradient g and
    the model's least value m. All ends are computed together.
    """
    count = len(inflation)
    rows, sign = np.tile(np.arange(count), 2), np.repeat([-1.0, 1.0], count)
    height = QUANTILE**2 * inflation[rows] / problem.samples
    centre = parameters(best[None, :])[0][0][rows]
    places = np.repeat(best[None, :], 2 * count, axis=0)
    before, steps, values = places.copy(), np.zeros(places.shape), centre.copy()
    active, blocked = np.ones(2 * count, bool), np.zeros(2 * count, bool)
    share = np.ones(2 * count)  # share of the step of the quadratic model
    for _ in range(_TURNS):
        own = np.flatnonzero(active)
        if not own.size:
            break
        at = problem.quadratic(places[own])
        value, gradient = (
            x[np.arange(own.size), rows[own]] for x in parameters(places[own])
        )
        # The root of the log-likelihood is nearly linear in a parameter.
        root = np.sqrt(np.log(np.maximum(at.cost / least, 1.0)) / height[own])
        far = ~(root < _FAR)
        still = np.abs(value - values[own]) <= 1e-3 * np.abs(value - centre[own])
        values[own] = np.where(far, values[own], value)
        ready = still & ((np.abs(root - 1.0) < _MET) | (blocked[own] & (root < 1.0)))
        active[own] = ~ready
        # Beyond the range of the quadratic model: go back, and take a shorter step.
        share[own] = np.where(far, 0.3 * share[own], np.minimum(2.0 * share[own], 1.0))
        step, stopped = _outward(
            problem, at, gradient, sign[own], least * np.exp(height[own]), places[own]
        )
        blocked[own] = np.where(ready | far, blocked[own], stopped)
        steps[own] = np.where(far[:, None], steps[own], step)
        before[own] = np.where(far[:, None], before[own], places[own])
        ahead = problem.clip(before[own] + share[own][:, None] * steps[own])
        places[own] = np.where(ready[:, None], places[own], ahead)
    # Open at a limit that the likelihood does not exclude, and where no end was found.
    is_open = blocked | active
    return tuple(
        Interval(
            float(values[i]),
            float(values[i + count]),
            bool(is_open[i]),
            bool(is_open[i + count]),
        )
        for i in range(count)
    )


def _outward(
    problem: Problem,
    at: Quadratic,
    gradient: Real,
    sign: Real,
    target: Real,
    places: Real,
) -> tuple[Real, Mask]:
    """The steps to the extreme value of a parameter on the target surface, with all
    others optimal, and flags where limits stop the parameter.
    """
    (low, high), at_limit = problem.box, np.zeros(places.shape, bool)
    # Twice: a coordinate stopped by a limit is held in the second pass.
    for _ in range(2):
        values, vectors, size = _axes(at.normal, at_limit)
        # The floor on the eigenvalues keeps the step along an undetermined direction
        # finite.
        inverse = np.einsum(
            "mpk,mk,mqk->mpq", vectors, 1.0 / np.maximum(values, _UNSEEN), vectors
        ) / (size[:, :, None] * size[:, None, :])
        g, slope = np.where(at_limit, 0.0, gradient), np.where(at_limit, 0.0, at.slope)
        down, along = (np.einsum("mpq,mq->mp", inverse, x) for x in (slope, g))
        across = np.einsum("mp,mp->m", along, g)
        room = np.maximum(target - at.cost + np.einsum("mp,mp->m", down, slope), 0.0)
        reach = np.where(across > 0, sign * np.sqrt(room / across), 0.0)
        step = np.where(at_limit, 0.0, down + reach[:, None] * along)
        step = np.where(np.isfinite(step), step, 0.0)
        at_limit = (places <= low) & (step < 0) | (places >= high) & (step > 0)
    return step, ~(across > 0)
