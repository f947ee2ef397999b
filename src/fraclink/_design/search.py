"""The controller for a request: the one with the least noise that meets every row at
every link, or else the one whose requested rows have to be eased least.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
from scipy.optimize import minimize

from fraclink._arm.box import Arm
from fraclink._arm.controller import Controller
from fraclink._design.request import Request
from fraclink._design.rows import RESERVE, Row
from fraclink._design.table import Figure, Index, Outer, Table, Trial
from fraclink._law.requirement import Requirement
from fracsys.checks import Mask, Real

__all__ = ["Search", "Solution", "beside", "solved"]


# Starts within the span of β, at its quarters: the larger β, the steeper Ĉ and the longer
# its filter. The first two lie apart: two searches that end alike should not have begun
# in the same valley.
_SHARES = np.array([0.75, 0.25, 0.0, 0.5])
_LEAST_ORDER = 0.05  # β → 0 gives a constant Ĉ, which (28) excludes
_WIDTH, _DEPTH = 0.3, 0.1  # first guess of a notch: ζ of its poles and of its zeros
# Largest relative violation with which a row counts as kept, half of its reserve; a cost
# must fall by more than this to count as a gain.
_KEPT = 0.5 * RESERVE
# Largest change of a parameter (a logarithm or an order) in one descent: the rows are
# smooth over about 1; farther away, a descent has lost its way.
_REACH = 1.0


class _Stalled(Exception):
    """Ends a descent that no longer gains anything, or has gained enough."""


@dataclass(frozen=True, eq=False)
class Bounded:
    """Costs, of which the largest counts, and values that must not be negative, with
    their gradients (P, M).
    """

    cost: Real
    cost_gradient: Real
    value: Real
    gradient: Real

    @cached_property
    def missed(self) -> float:
        """The largest violation of a value, beyond the tolerance."""
        return max(-float(np.min(self.value, initial=0.0)) - _KEPT, 0.0)

    @cached_property
    def largest(self) -> float:
        """The largest cost."""
        return float(np.max(self.cost))

    def within(self, limit: float) -> bool:
        """Whether nothing is missed, and no cost is above a limit."""
        return not self.missed and self.largest <= limit

    def better(self, other: Bounded) -> bool:
        """Whether less is missed than in the other, or the cost is smaller."""
        if other.missed - self.missed > (_KEPT if self.missed else 0.0):
            return True
        return self.missed <= other.missed and self.largest < other.largest - _KEPT


def lowest(
    bounded_at: Callable[[Real], Bounded],
    start: Real,
    low: Real,
    high: Real,
    *,
    enough: float = -math.inf,
    once: bool = False,
) -> tuple[Real, Bounded]:
    """Return the best parameters that sequential quadratic programming tries, and their
    costs and values; it ends at the first with nothing missed and no cost above `enough`.

    A descent is given up after two points per unknown without a gain: at a kink, its
    line search makes no headway. The next one begins at the best point with a new
    curvature, until one gains nothing; with `once` there is only one. Together they try
    at most two points per entry of the curvature.
    """
    best = last = start, bounded_at(start)
    idle, left = 0, 2 * (start.size + 1) ** 2

    def at(z: Real) -> Bounded:
        nonlocal best, last, idle, left
        if not np.array_equal(z[:-1], last[0]):
            x = z[:-1].copy()
            last = x, bounded_at(x)
            idle, left = idle + 1, left - 1
            if last[1].better(best[1]):
                best, idle = last, 0
            if idle >= 2 * z.size or not left or best[1].within(enough):
                raise _Stalled
        return last[1]

    # the last unknown is the largest cost
    def kept(z: Real) -> Real:
        bounded = at(z)
        return np.concatenate([bounded.value, z[-1] - bounded.cost])

    def slopes(z: Real) -> Real:
        bounded = at(z)
        largest = np.repeat([0.0, 1.0], [bounded.value.size, bounded.cost.size])
        gradient = np.concatenate([bounded.gradient, -bounded.cost_gradient], axis=1)
        return np.column_stack([gradient.T, largest])

    direction = np.append(np.zeros(start.size), 1.0)
    gains = True
    while gains and left and not best[1].within(enough):
        (x, bounded), idle = best, 0
        near = np.maximum(low, x - _REACH), np.minimum(high, x + _REACH)
        with np.errstate(all="ignore"), suppress(_Stalled):
            minimize(
                lambda z: z[-1],
                np.append(x, bounded.largest),
                jac=lambda z: direction,
                method="SLSQP",
                bounds=[*zip(*near, strict=True), (None, None)],
                constraints={"type": "ineq", "fun": kept, "jac": slopes},
                options={"ftol": _KEPT},
            )
        gains = not once and best[1].better(bounded)
    return best


@dataclass(frozen=True, eq=False)
class Entries:
    """Figures of links (M,), each by its place in a trial, times a factor plus an offset."""

    place: Index
    factor: Real
    offset: Real

    @staticmethod
    def of(figures: Sequence[tuple[Figure, Mask]], table: Table) -> Entries:
        """Return the entries of figures, each at the given links of a table."""
        places = [table.places[figure.rows, links].ravel() for figure, links in figures]
        factors = [[figure.factor, figure.offset] for figure, _ in figures]
        repeated = np.repeat(np.array(factors), [*map(len, places)], axis=0)
        return Entries(np.concatenate(places), *repeated.T)

    def at(self, trial: Trial) -> tuple[Real, Real]:
        """Return (values, gradients (P, M)); the value is 1 if a link has no such figure."""
        value = self.factor * trial.figures.ravel()[self.place] + self.offset
        value[np.isnan(value)] = 1.0
        gradients = trial.gradients.reshape(len(trial.gradients), -1)
        return value, self.factor * gradients[:, self.place]


@dataclass(frozen=True, eq=False)
class Search:
    """The search for a request over some links of its table, with n and, if given, a
    notch in an interval [rad/s].

    ``reserves``, by the key of a row, are kept in addition to the row's own.
    """

    request: Request
    links: tuple[int, ...]
    filter_order: int
    notch: tuple[float, float] | None = None
    reserves: dict[str, float] = field(default_factory=dict)

    @cached_property
    def table(self) -> Table:
        """The loops of these links, without Ĉ."""
        return self.request.arms.table.rows(np.array(self.links))

    @cached_property
    def bounds(self) -> tuple[Real, Real]:
        """The least and the largest value of every parameter."""
        request = self.request
        own = request.spec.get("filter_time")
        highest = min(request.model.order, 2.0 if own == 0.0 else self.filter_order)
        # a filter that decays to e^-2π within a period has no effect in the law; with its
        # corner below the frequencies of the table, δ only changes the gain
        shortest = request.rig.period / math.tau
        delta = math.log(shortest), -math.log(self.table.w.min())
        if own is not None:
            delta = (math.log(max(own, 1e-12)),) * 2
        # added to 1, a smaller Ĉ vanishes in single precision
        nothing = math.log(np.finfo(np.float32).eps)
        pairs = [(nothing, math.inf), (_LEAST_ORDER, highest - 0.02), delta]
        if self.notch is not None:
            low, high = self.notch
            pairs += [
                (math.log(low), math.log(high)),
                (math.log(0.05), 0.0),
                (math.log(1e-2), 0.0),
            ]
        low_ends, high_ends = np.array(pairs).T
        return low_ends, high_ends

    def outer(self, x: Real) -> Outer:
        """Return Ĉ with the given parameters."""
        return Outer(x, self.request.reference, self.filter_order)

    def trial(self, x: Real) -> Trial:
        """Return the trial of Ĉ with the given parameters at these links."""
        return _trial(self, tuple(x))

    @cached_property
    def figures(self) -> list[tuple[str, Figure, Mask]]:
        """(key of a row, its slack, the links that must keep it) for every row; those
        that may be eased come first.
        """
        request = self.request
        wanted = [pair for pair in request.wanted if not pair[0].implied]
        return [
            (row.key, figure, self.table.empty == row.empty)
            for row, goal in sorted(wanted, key=lambda p: p[0].key not in request.soft)
            for figure in row.kept(request, goal, self.reserves.get(row.key, 0.0))
        ]

    @cached_property
    def _slacks(self) -> Entries:
        """The slack of every row at every link that must keep it."""
        figures = [(figure, asked) for _, figure, asked in self.figures]
        return Entries.of(figures, self.table)

    @cached_property
    def _eased(self) -> int:
        """How many of the slacks may be eased; they are the first ones."""
        return sum(
            self.table.places[figure.rows, asked].size
            for key, figure, asked in self.figures
            if key in self.request.soft
        )

    @cached_property
    def _noise(self) -> Entries:
        """ln of the noise gain of every link that has a payload."""
        return Entries.of([(Figure("noise"), ~self.table.empty)], self.table)

    def easing(self, x: Real) -> Bounded:
        """Return the required easing of the rows that may be eased, and the other slacks."""
        value, gradient = self._slacks.at(self.trial(x))
        eased = self._eased
        # no cost below zero: a row that is kept needs no easing
        cost = np.append(-value[:eased], 0.0)
        slope = np.column_stack([-gradient[:, :eased], np.zeros(x.size)])
        return Bounded(cost, slope, value[eased:], gradient[:, eased:])

    def noise(self, x: Real) -> Bounded:
        """Return ln of the noise gain of every link, and all slacks."""
        trial = self.trial(x)
        return Bounded(*self._noise.at(trial), *self._slacks.at(trial))

    # ---- where a search begins

    def starts(self, crossover: float) -> Real:
        """Parameters to begin from, (S, P): closed forms that cross at `crossover`
        [rad/s] at the heaviest payload, and meet the phase at the lightest.

        β lies between the least that the phase needs without a filter and its upper
        limit; the filter uses up the phase that β adds beyond this least value.
        """
        request, loop = self.request, self.request.arms.loops[0]
        low, high = request.natural_frequencies
        bottom, top = self.bounds
        # far above the resonance |G| falls as ω₀² ω^-λ
        fastest = crossover * (high / low) ** (2.0 / request.model.order)
        w = min(fastest, request.arms.highest)
        phase = request.phase_margin - math.pi - float(loop.log(w, high).imag)
        lag = math.exp(bottom[2]) if bottom[2] == top[2] else 0.0
        phase += self.filter_order * math.atan(lag * w)
        least = min(max(2.0 / math.pi * phase, bottom[1]), top[1])
        beta = least + _SHARES * (top[1] - least)
        delta = np.full_like(beta, bottom[2])
        if not lag:
            spare = 0.5 * math.pi * (beta - least) / self.filter_order
            delta = np.log(np.maximum(np.tan(spare) / w, math.exp(bottom[2])))
        # ln of the filter's attenuation at the crossover and at ω_r
        left, right = (
            0.5 * self.filter_order * np.log1p(np.square(np.exp(delta) * frequency))
            for frequency in (crossover, request.reference)
        )
        level = left - right - beta * math.log(crossover / request.reference)
        x = np.array([level - float(loop.log(crossover, low).real), beta, delta])
        if self.notch is not None:
            centre = 0.5 * (math.log(self.notch[0]) + math.log(self.notch[1]))
            notch = np.array([[centre], [math.log(_WIDTH)], [math.log(_DEPTH)]])
            x = np.concatenate([x, np.repeat(notch, beta.size, axis=1)])
        # where the phase needs the largest β, all of them are the same
        return np.array(list(dict.fromkeys(map(tuple, np.clip(x.T, *self.bounds)))))

    # ---- the search

    def over_links(self, start: Real) -> Solution:
        """Return where a search from a start ends; links that prove worse than those
        searched are added to them.
        """
        solution = self.descended(start)
        while (wider := solution.wider()) is not None:
            solution = wider.descended(solution.x)
        return solution

    def descended(self, start: Real, *, once: bool = False) -> Solution:
        """Return the point of least easing or, if no row needs any, of least noise."""
        x, end = lowest(self.easing, start, *self.bounds, enough=0.0, once=once)
        if end.missed > 0.0 or end.largest > _KEPT:
            return Solution(self, x, end.missed, end.largest)
        return Solution(
            self, lowest(self.noise, x, *self.bounds, once=once)[0], 0.0, 0.0
        )


# one entry: the descent in noise begins at the point where the one in easing ended
@lru_cache(maxsize=1)
def _trial(search: Search, x: tuple[float, ...]) -> Trial:
    """The trial of Ĉ with the given parameters at the links of a search."""
    return Trial(search.table, search.outer(np.array(x)))


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a search ended."""

    search: Search
    x: Real
    missed: float  # largest violation of the rows that may not be eased
    easing: float  # largest easing of the others

    @property
    def kept(self) -> bool:
        """Whether every row is kept, with at least half of its reserve."""
        return self.missed == 0.0 and self.easing == 0.0

    @cached_property
    def lost(self) -> bool:
        """Whether rows are missed that may not be eased, or some loop does not cross."""
        return self.missed > 0.0 or bool(
            np.isnan(self._trial.value(Figure("crossover"))).any()
        )

    def equals(self, other: Solution) -> bool:
        """Whether neither is lost and both ease the rows equally, both with a notch or
        both without: a notch that becomes flat ends where the search without a notch did,
        which says nothing about deep notches.
        """
        return (
            self.x.size == other.x.size
            and not (self.lost or other.lost)
            and abs(self.easing - other.easing) <= _KEPT
        )

    @property
    def crossovers(self) -> tuple[float, float]:
        """The crossovers of the heaviest and the lightest payload [rad/s]; 0 for none."""
        heavy, _, light, _ = self.search.request.first_links
        frequencies = np.nan_to_num(np.exp(self._trial.value(Figure("crossover"))))
        return float(frequencies[0, heavy]), float(frequencies[0, light])

    def worst_arm(self, key: str) -> Arm:
        """Return the arm on which the slack of a row is least."""
        _, link = self._worst[key]
        arms = self.search.request.arms
        return arms.cases[arms.table.arm[link]].arm

    @property
    def noise_gain(self) -> float:
        """The noise gain at the worst link."""
        return math.exp(float(np.nanmax(self._trial.value(Figure("noise")))))

    @cached_property
    def controller(self) -> Controller:
        """The controller."""
        request, x = self.search.request, self.x
        delta = request.spec.get("filter_time", math.exp(x[2]))
        lagged = (delta * request.reference) ** 2
        order = self.search.filter_order
        gain = x[0] - x[1] * math.log(request.reference)
        return Controller(
            derivative_gain=math.exp(gain + 0.5 * order * math.log1p(lagged)),
            derivative_order=float(x[1]),
            filter_time=delta,
            filter_order=self.search.filter_order,
            link=request.model.at_payload(request.rig.payloads.nominal),
            motor_loop=request.motor_loop,
            period=request.rig.period,
            notch=self.search.outer(x).notch,
        )

    @cached_property
    def _trial(self) -> Trial:
        """The trial at every link of the table."""
        return self._every.trial(self.x)

    @cached_property
    def _every(self) -> Search:
        """The search at every link of the table."""
        every = tuple(range(len(self.search.request.arms.table)))
        own = self.search.links == every
        return self.search if own else replace(self.search, links=every)

    @cached_property
    def _worst(self) -> dict[str, tuple[float, int]]:
        """(slack, link) of each row at the link where its slack is least."""
        worst: dict[str, tuple[float, int]] = {}
        for key, figure, asked in self._every.figures:
            value = np.where(asked, self._trial.value(figure), math.nan)
            least = np.nan_to_num(value, nan=1.0).min(axis=0)
            link = int(np.argmin(least))
            worst[key] = min(worst.get(key, (math.inf, 0)), (float(least[link]), link))
        return worst

    def wider(self) -> Search | None:
        """Return the search with added links that are worse than those searched; None if
        there are none.
        """
        search, easing = self.search, self.easing
        soft = search.request.soft
        misses = {
            key: link
            for key, (value, link) in self._worst.items()
            if value + (easing if key in soft else 0.0) < -2.0 * _KEPT
        }
        links = set(misses.values()) - set(search.links)
        return replace(search, links=(*search.links, *sorted(links))) if links else None

    @cached_property
    def measured(self) -> tuple[tuple[Row, Requirement], ...]:
        """Every row with its worst achieved value."""
        request = self.search.request
        return tuple(
            (row, item)
            for row, goal in request.wanted
            for item in row.measured(
                self._trial, request, goal, request.arms.payloads_at
            )
        )

    def tightened(self, reserves: dict[str, float]) -> Solution:
        """Return the solution with additional reserves for some rows."""
        own = self.search.reserves
        more = {key: own.get(key, 0.0) + value for key, value in reserves.items()}
        search = replace(self.search, reserves={**own, **more})
        return search.over_links(self.x)


def beside(request: Request, controller: Controller) -> Solution:
    """Return where a single descent from a controller ends, over every link of a
    request.
    """
    notch = None if controller.notch is None else request.notches[-1]
    # the controller's own n, if the request allows it
    order = max(request.filter_orders, key=lambda n: n == controller.filter_order)
    search = Search(request, tuple(range(len(request.arms.table))), order, notch)
    x = Outer.of(controller, request.reference).x[: search.bounds[0].size]
    return search.descended(x.clip(*search.bounds), once=True)


def solved(request: Request, near: Solution | None = None) -> Solution:
    """Return the solution of a request, or the nearest one.

    `near` is tried first. Unless it leads to a solution that keeps every row, each n is
    searched, first without a notch, then with one, from each start until a solution keeps
    every row, or two of them ease the rows equally.
    """
    known = (
        []
        if near is None
        else [replace(near.search, request=request).over_links(near.x)]
    )
    if known and known[0].kept:
        return known[0]
    # A loop that crosses below the resonance does not affect the vibration. From an
    # unreachable crossover a descent may fail to meet the rows that may not be eased: then
    # all begin once more at the geometric mean of the fastest and the slowest crossover.
    slowest = request.arms.resonance
    fastest = max(request.reference, slowest)
    for crossover in dict.fromkeys((fastest, math.sqrt(fastest * slowest))):
        solutions = [*known]
        for notch, order in product(request.notches, request.filter_orders):
            search = Search(request, request.first_links, order, notch)
            for start in search.starts(crossover):
                solution = search.over_links(start)
                if solution.kept:
                    return solution
                again = any(solution.equals(other) for other in solutions)
                solutions.append(solution)
                if again:
                    break
        best = min(solutions, key=lambda one: (one.lost, one.missed, one.easing))
        if not best.missed:
            break
    return best
