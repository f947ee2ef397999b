"""The controller for a request: the one with the least noise that meets every row at
every link, or else the one whose requested rows have to be eased least.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np

from fraclink._arm.controller import Controller
from fraclink._design.outer import Outer
from fraclink._design.request import Request
from fraclink._design.rows import RESERVE, Row
from fraclink._design.solver import KEPT, Rows, eased, lowest
from fraclink._design.table import Figure, Table, Trial
from fraclink._law.requirement import Requirement
from fracsys.checks import Real

__all__ = ["Search", "Solution", "solved"]


# δ times the crossover at the first start: a long filter with a steep Ĉ makes a quiet
# loop
_LAG = 1.2
# The other starts: δ times the resonance, and β as a share of its limit; the feasible
# set may be disconnected.
_LAGS, _ORDERS = (0.1, 0.4, 1.5), (0.3, 0.5, 0.7, 0.85)
# Bounds of ln δ [s]: ten periods of the slowest arm, and less than any control period.
_LONGEST, _SHORTEST = math.log(1.0), math.log(1e-4)
_LEAST_ORDER = 0.05  # β → 0 gives a constant Ĉ, which (28) excludes
_WIDTH, _DEPTH = 0.3, 0.1  # first guess of a notch: ζ of its poles and of its zeros
# Number of restarts of the descent of the noise, and the least gain in ln of the noise
# that justifies another one.
_TURNS, _IDLE = 4, 0.001
# radius of a descent in each parameter; its gradients are useless farther away
_REACH = 2.0
# Share of the remaining distance that five steps must gain to continue the search:
# towards the rows, and towards a row that is an aim.
_FAR, _AIMING = 0.1, 0.003


@dataclass(frozen=True, eq=False)
class Search:
    """A request over some links of its table, with n and with a notch in an interval
    [rad/s], where there is one.

    ``reserves`` is what is aimed at beyond a row, by its key. ``ringing`` says whether
    the damping of the vibration is looked at: it costs as much as all the rest.
    """

    request: Request
    links: tuple[int, ...]
    filter_order: int
    notch: tuple[float, float] | None = None
    reserves: dict[str, float] = field(default_factory=dict)
    ringing: bool = False
    _last: dict[bytes, Trial] = field(default_factory=dict, init=False)

    @cached_property
    def table(self) -> Table:
        """The loops beside Ĉ of these links."""
        return self.request.arms.table.rows(np.array(self.links))

    @cached_property
    def bounds(self) -> tuple[Real, Real]:
        """The least and the largest value of every parameter."""
        own = self.request.spec.get("filter_time")
        highest = min(
            self.request.model.order, 2.0 if own == 0.0 else self.filter_order
        )
        delta = (_SHORTEST, _LONGEST)
        if own is not None:
            delta = (math.log(max(own, 1e-12)),) * 2
        pairs = [(-16.0, 16.0), (_LEAST_ORDER, highest - 0.02), delta]
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
        """Return Ĉ of parameters (P, K)."""
        return Outer(x, self.request.reference, self.filter_order)

    def trial(self, x: Real) -> Trial:
        """Return these links under Ĉ of each of some parameters (P, S), one after the
        other.

        The last one is kept: a search asks for where it ended several times.
        """
        key = x.tobytes()
        if key not in self._last:
            count, table = x.shape[1], self.table
            if count > 1:
                table = table.rows(np.tile(np.arange(len(table)), count))
            outer = self.outer(np.repeat(x, len(self.links), axis=1))
            self._last.clear()
            self._last[key] = Trial(table, outer, self.request.arms.loops)
        return self._last[key]

    def kept(self, trial: Trial, only: str | None = None) -> dict[str, Figure]:
        """Return the slack of each row, or of `only` one, at the links to which it
        applies.
        """
        figures = {}
        for row, goal in self.request.wanted:
            if only not in (None, row.key) or (
                row.key == "damping" and not self.ringing
            ):
                continue
            reserve = row.reserve + self.reserves.get(row.key, 0.0)
            figure = row.kept(trial, self.request, goal).scaled(1.0, -reserve)
            figures[row.key] = row.asked(trial, figure)
        return figures

    def rows(self, x: Real) -> list[Rows]:
        """Return the rows of each of some parameters (P, S)."""
        margins = self.kept(self.trial(x))
        figures = margins.values()
        value = np.concatenate([figure.value for figure in figures])
        gradient = np.concatenate([figure.gradient for figure in figures], axis=1)
        may_ease = [key in self.request.soft for key in margins]
        soft = np.repeat(may_ease, [figure.value.size for figure in figures])
        link = np.concatenate([figure.link for figure in figures])
        start = link // len(self.links)
        return [
            Rows(value[start == k], gradient[:, start == k], soft[start == k])
            for k in range(x.shape[1])
        ]

    def noise(self, x: Real) -> float:
        """Return ln of the noise gain at the worst link."""
        return float(np.max(self.trial(x[:, None]).noise.value))

    def noise_and_rows(self, x: Real) -> tuple[Rows, Rows]:
        """Return the noise of every link, and the smallest slack of each row at every
        link, so that their number does not change when a loop gains a crossing.
        """
        trial = self.trial(x[:, None])
        count, noise = len(self.links), trial.noise
        value, gradient = [], []
        for figure in self.kept(trial).values():
            least, slopes = np.ones(count), np.zeros((x.size, count))
            # In falling order, so that the smallest entry of a link is written last.
            falling = figure.at(np.argsort(-figure.value))
            least[falling.link] = falling.value
            slopes[:, falling.link] = falling.gradient
            value.append(least)
            gradient.append(slopes)
        joined = np.concatenate(value)
        return (
            Rows(noise.value, noise.gradient, np.zeros(noise.value.size, dtype=bool)),
            Rows(
                joined,
                np.concatenate(gradient, axis=1),
                np.zeros(joined.size, dtype=bool),
            ),
        )

    # ---- where a search begins

    def first(self) -> Real:
        """Parameters to begin from: the closed form of the lightest link, whose phase is
        met at the crossover, with a long filter.
        """
        request, loop = self.request, self.request.arms.loops[0]
        low, high = request.natural_frequencies
        ratio = (high / low) ** (2.0 / request.model.order)
        # a loop that crosses below the resonance does not affect the vibration
        least = max(request.reference, 1.1 * request.arms.resonance)
        w = min(least * ratio, 0.6 * request.highest)
        delta = request.spec.get("filter_time", _LAG / w)
        beta = request.phase_margin - math.pi - float(loop.log(w, high).imag)
        beta += self.filter_order * math.atan(delta * w)
        return self._through(least, 2.0 / math.pi * beta, delta)

    def others(self) -> Real:
        """More of them, (P, S)."""
        request, limit = self.request, self.bounds[1][1]
        places = 1.1 * request.arms.resonance, request.reference
        return np.stack(
            [
                self._through(place, order * limit, lag / request.arms.resonance)
                for lag, order, place in product(_LAGS, _ORDERS, places)
            ],
            axis=1,
        )

    def elsewhere(self) -> Real:
        """The one with the shortest filter and the steepest Ĉ."""
        request, steepest = self.request, _ORDERS[-1] * self.bounds[1][1]
        lag = _LAGS[0] / request.arms.resonance
        return self._through(request.reference, steepest, lag)

    def _through(self, w: float, beta: float, delta: float) -> Real:
        """Parameters with |L| = 1 at `w` at the heaviest payload."""
        low, high = self.bounds
        beta = min(max(beta, low[1] + 0.05), high[1] - 0.05)
        gain = -float(
            self.request.arms.loops[0].log(w, self.request.natural_frequencies[0]).real
        )
        gain -= beta * math.log(w / self.request.reference)
        gain += 0.5 * self.filter_order * math.log1p((delta * w) ** 2)
        x = [gain, beta, math.log(max(delta, 1e-12))]
        if self.notch is not None:
            centre = 0.5 * (math.log(self.notch[0]) + math.log(self.notch[1]))
            x += [centre, math.log(_WIDTH), math.log(_DEPTH)]
        return np.array(x)

    # ---- the search

    def over_links(self, starts: Real) -> Solution:
        """Return where a search ends from some starts (P, S), the links that are worst
        taken in as they turn up.
        """
        search = self
        while True:
            idle = _FAR if self.request.aim is None else _AIMING
            x, rows = eased(search.rows, starts, *search.bounds, idle=idle)
            if rows.slack <= KEPT:
                x = search.quieter(x)
            solution = Solution(search, x)
            wider = solution.wider()
            if wider is None:
                return solution
            search, starts = wider, x[:, None]

    def quieter(self, x: Real) -> Real:
        """Return parameters with less noise that keep every row.

        A descent that lost its way at a kink is led back to the rows, and goes on from
        there as long as that is less noise.
        """
        before, radius = self.noise(x), _REACH
        low, high = self.bounds
        for _ in range(_TURNS):
            near = np.maximum(low, x - radius), np.minimum(high, x + radius)
            lower, ended = lowest(self.noise_and_rows, x, *near)
            lower, rows = eased(self.rows, lower[:, None], low, high)
            noise = self.noise(lower)
            if rows.slack <= KEPT and noise <= before - _IDLE:
                x, before = lower, noise
            elif not ended:
                radius *= 0.25
            if ended:
                break
        return x


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a search ended."""

    search: Search
    x: Real

    @cached_property
    def rows(self) -> Rows:
        """The rows at the links of the search."""
        return self.search.rows(self.x[:, None])[0]

    @property
    def slack(self) -> float:
        """0 where every row is kept, with half of what is kept in reserve."""
        miss = -float(np.min(self.rows.value, initial=0.0))
        return 0.0 if miss <= 0.5 * RESERVE else self.rows.slack

    @property
    def crossovers(self) -> tuple[float, float]:
        """Of the heaviest and of the lightest payload [rad/s]."""
        heavy, _, light, _ = self.search.request.first_links
        frequencies = np.exp(self._trial.crossover.value)
        return float(frequencies[heavy]), float(frequencies[light])

    @property
    def eases(self) -> bool:
        """Whether all that is missed may be eased."""
        return self.rows.missed <= 0.5 * RESERVE

    @property
    def noise_gain(self) -> float:
        """The noise gain at the worst link."""
        return math.exp(float(np.max(self._trial.noise.value)))

    @cached_property
    def controller(self) -> Controller:
        """The controller."""
        request, x = self.search.request, self.x
        free = request.spec.get("filter_time")
        return Controller(
            derivative_gain=math.exp(x[0] - x[1] * math.log(request.reference)),
            derivative_order=float(x[1]),
            filter_time=math.exp(x[2]) if free is None else free,
            filter_order=self.search.filter_order,
            link=request.model.at_payload(request.rig.payloads.nominal),
            motor_loop=request.motor_loop,
            period=request.rig.period,
            notch=self.search.outer(x[:, None]).notch,
        )

    @cached_property
    def _trial(self) -> Trial:
        """The trial at every link of the table."""
        every = tuple(range(len(self.search.request.arms.table)))
        return replace(self.search, links=every).trial(self.x[:, None])

    @cached_property
    def _worst(self) -> dict[str, tuple[float, int]]:
        """(by how much it is kept, the link) where each row but the damping is kept
        least.
        """
        margins = replace(self.search, ringing=False).kept(self._trial)
        return {key: one.least for key, one in margins.items() if one.value.size}

    @cached_property
    def _ringing(self) -> Search:
        """The search at the links whose damping is looked at: those that are worst in
        another row, and its own.
        """
        links = {*self.search.links, *(link for _, link in self._worst.values())}
        return replace(self.search, links=tuple(sorted(links)), ringing=True)

    @cached_property
    def _damping(self) -> dict[str, tuple[float, int]]:
        """The same of the damping; empty where no vibration is left."""
        ringing = self._ringing
        figure = ringing.kept(ringing.trial(self.x[:, None]), only="damping")["damping"]
        if not figure.value.size:
            return {}
        value, link = figure.least
        return {"damping": (value, ringing.links[link])}

    def wider(self) -> Search | None:
        """Return the search with the links that are worse than its own; None where there
        are none.
        """
        search, easing = self.search, self.rows.easing
        soft = search.request.soft
        misses = {
            key: link
            for key, (value, link) in (self._worst | self._damping).items()
            if value + (easing if key in soft else 0.0) < -2.0 * KEPT
        }
        links = set(misses.values()) - set(search.links)
        ringing = search.ringing or "damping" in misses
        if not links and ringing == search.ringing:
            return None
        return replace(search, links=(*search.links, *sorted(links)), ringing=ringing)

    @cached_property
    def measured(self) -> tuple[tuple[Row, Requirement], ...]:
        """Every row, and what is achieved where it is worst."""
        request, pairs = self.search.request, []
        for row, goal in request.wanted:
            trial, payloads = self._trial, request.arms.payloads_at
            if row.key == "damping":
                trial = self._ringing.trial(self.x[:, None])
                payloads = payloads[list(self._ringing.links)]
            items = row.measured(trial, request, goal, payloads)
            pairs += [(row, item) for item in items]
        return tuple(pairs)

    def quieter(self) -> Solution:
        """Return this one or another with less noise: the noise has several valleys, and
        a second descent begins elsewhere.

        At more links there is only more noise, so that they are looked at last.
        """
        search = self.search
        low, high = search.bounds
        if low[2] == high[2]:
            return self  # with δ given there is a single minimum
        x, rows = eased(search.rows, search.elsewhere()[:, None], low, high)
        if rows.slack > KEPT:
            return self
        x = search.quieter(x)
        if search.noise(x) > math.log(self.noise_gain) - _IDLE:
            return self
        other = search.over_links(x[:, None])
        quieter = other.slack == 0.0 and other.noise_gain < self.noise_gain
        return other if quieter else self

    def tightened(self, reserves: dict[str, float]) -> Solution:
        """Return the solution with more in reserve for some rows."""
        own = self.search.reserves
        more = {key: own.get(key, 0.0) + value for key, value in reserves.items()}
        search = replace(self.search, reserves={**own, **more})
        return search.over_links(self.x[:, None])


def solved(request: Request, *, patient: bool) -> Solution:
    """Return the best controller of a request, or the one nearest to it.

    Every n without a notch, then with one; and only where none of these keeps every
    row, and the caller is patient, the same from other starts. What aims at a row out
    of reach begins from all of them.
    """
    searches = [
        Search(request, request.first_links, order, notch)
        for notch, order in product(request.notches, request.filter_orders)
    ]
    solutions: list[Solution] = []
    for search in searches:
        starts = search.first()[:, None]
        if request.aim is not None:
            starts = np.column_stack([starts, search.others()])
        solutions.append(search.over_links(starts))
        if solutions[-1].slack == 0.0:
            return solutions[-1].quieter()
    for one in tuple(solutions) if patient and request.aim is None else ():
        others = np.column_stack([one.x, one.search.others()])
        solutions.append(one.search.over_links(others))
        if solutions[-1].slack == 0.0:
            return solutions[-1].quieter()
    return min(solutions, key=lambda one: one.slack)
