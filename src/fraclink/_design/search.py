"""The controller for a request: the one with the least noise that meets every row at
every link, or else the one whose requested rows have to be eased least.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.controller import Controller
from fraclink._design.request import Request
from fraclink._design.rows import RESERVE, Row
from fraclink._design.solver import KEPT, RADIUS, Rows, eased, lowest
from fraclink._design.table import Figure, Outer, Table, Trial
from fraclink._law.requirement import Requirement

__all__ = ["Search", "Solution", "solved"]

Real = NDArray[np.float64]

# Bounds of ln δ [s]: ten periods of the slowest arm, and less than any control period.
_LONGEST, _SHORTEST = math.log(1.0), math.log(1e-4)
_LEAST_ORDER = 0.05  # β → 0 gives a constant Ĉ, which (28) excludes
# Least gain in ln of the noise that justifies another descent: the third digit, which is
# printed.
_IDLE = 1e-3


@dataclass(frozen=True, eq=False)
class Search:
    """A request over some links of its table, with n, and possibly with a notch in an
    interval [rad/s].

    ``reserves`` are the additional margins of the rows, by key. ``ringing`` says
    whether the damping of the vibration is evaluated, which costs as much as everything
    else.
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
        """The loops without Ĉ of these links."""
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
        """Return Ĉ for parameters (P, K)."""
        return Outer(x, self.request.reference, self.filter_order)

    def trial(self, x: Real) -> Trial:
        """Return these links with the Ĉ of each of the parameter sets (P, S), one after
        the other.

        The last result is cached, since a search evaluates its end point several times.
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

    def kept(self, trial: Trial) -> dict[str, Figure]:
        """Return the margin of each row at the links to which it applies."""
        found = {}
        for row, wanted in self.request.wanted:
            if row.key == "damping" and not self.ringing:
                continue
            figure = row.asked(trial, row.kept(trial, self.request, wanted))
            reserve = row.reserve + self.reserves.get(row.key, 0.0)
            found[row.key] = figure.scaled(1.0, -reserve)
        return found

    def rows(self, x: Real) -> list[Rows]:
        """Return the rows for each of the parameter sets (P, S)."""
        kept = self.kept(self.trial(x))
        figures = kept.values()
        value = np.concatenate([figure.value for figure in figures])
        gradient = np.concatenate([figure.gradient for figure in figures], axis=1)
        may_ease = [key in self.request.soft for key in kept]
        soft = np.repeat(may_ease, [figure.value.size for figure in figures])
        link = np.concatenate([figure.link for figure in figures])
        start = link // len(self.links)
        return [
            Rows(value[start == k], gradient[:, start == k], soft[start == k])
            for k in range(x.shape[1])
        ]

    def noise(self, x: Real) -> Real:
        """Return ln of the noise gain at the worst link for each of the parameter sets
        (P, S).
        """
        value = self.trial(x).noise.value
        return np.asarray(np.max(value.reshape(x.shape[1], -1), axis=1))

    def noise_and_rows(self, x: Real) -> tuple[Rows, Rows]:
        """Return the noise of every link, and the rows with their smallest value at
        every link, so that their number does not change when a loop gains a crossing.
        """
        trial = self.trial(x[:, None])
        count, noise = len(self.links), trial.noise
        value, gradient = [], []
        for figure in self.kept(trial).values():
            least, moved = np.ones(count), np.zeros((x.size, count))
            for entry in np.argsort(-figure.value):
                least[figure.link[entry]] = figure.value[entry]
                moved[:, figure.link[entry]] = figure.gradient[:, entry]
            value.append(least)
            gradient.append(moved)
        joined = np.concatenate(value)
        soft = np.zeros(joined.size, dtype=bool)
        return (
            Rows(noise.value, noise.gradient, np.zeros(noise.value.size, dtype=bool)),
            Rows(joined, np.concatenate(gradient, axis=1), soft),
        )

    # ---- where a search begins

    @property
    def starts(self) -> Real:
        """Starting parameters (P, S): at the heaviest payload |L| = 1 at ω_r, or at the
        resonance of the lightest; β at the quarters of its range; and the corner of the
        filter at the ends and in the middle of the band between the heaviest payload's
        resonance and the highest allowed crossing.
        """
        low, high = self.bounds
        request, loop = self.request, self.request.arms.loops[0]
        slow, fast = request.arms.resonance, request.highest
        corners = np.geomspace(slow, fast, 3) if low[2] < high[2] else [slow]
        shares = 0.25, 0.5, 0.75
        places = float(loop.peak(request.natural_frequencies[1])), request.reference
        return np.stack(
            [
                self._through(place, share * high[1], 1.0 / corner)
                for corner, share, place in product(corners, shares, places)
            ],
            axis=1,
        )

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
            x += [centre, 0.5 * (low[4] + high[4]), 0.5 * (low[5] + high[5])]
        return np.array(x)

    # ---- the search

    def over_links(self, starts: Real) -> Solution:
        """Return the end of a search from some starts (P, S), adding the worst links as
        they turn up.
        """
        search, near, feasible = self, starts, False
        while True:
            ends, rows = eased(search.rows, near, *search.bounds)
            if feasible and rows[0].slack > KEPT:
                # the added links leave nothing feasible near the last end
                near = np.column_stack([near, starts])
                ends, rows = eased(search.rows, near, *search.bounds)
            x, feasible = ends[:, 0], rows[0].slack <= KEPT
            if feasible:
                # the noise has several minima: descend from the quietest end
                x = search.quieter(ends[:, int(np.argmin(search.noise(ends)))])
            solution = Solution(search, x)
            wider = solution.wider()
            if wider is None:
                return solution
            search, near = wider, x[:, None]

    def quieter(self, x: Real) -> Real:
        """Return parameters with less noise that meet every row, by descents within the
        radius of a step, as long as they reduce it.

        A descent that violates the rows at a kink is led back to them.
        """
        before = self.noise(x[:, None])[0]
        low, high = self.bounds
        ended = False
        while not ended:
            near = np.maximum(low, x - RADIUS), np.minimum(high, x + RADIUS)
            lower, ended = lowest(self.noise_and_rows, x, *near)
            ends, (rows, *_) = eased(self.rows, lower[:, None], low, high)
            noise = self.noise(ends)[0]
            if rows.slack > KEPT or noise > before - _IDLE:
                break
            x, before = ends[:, 0], noise
        return x


@dataclass(frozen=True, eq=False)
class Solution:
    """The end of a search."""

    search: Search
    x: Real

    @cached_property
    def rows(self) -> Rows:
        """The rows at the links of the search."""
        return self.search.rows(self.x[:, None])[0]

    @property
    def slack(self) -> float:
        """0 if every row is met with half of its reserve."""
        missed = -float(np.min(self.rows.value, initial=0.0))
        return 0.0 if missed <= 0.5 * RESERVE else self.rows.slack

    @property
    def crossovers(self) -> tuple[float, float]:
        """Crossovers of the heaviest and of the lightest payload [rad/s]."""
        heavy, _, light, _ = self.search.request.first_links
        reached = np.exp(self._trial.crossover.value)
        return float(reached[heavy]), float(reached[light])

    @property
    def eases(self) -> bool:
        """Whether all missed rows may be eased."""
        return self.rows.missed <= 0.5 * RESERVE

    @property
    def noise_gain(self) -> float:
        """The noise gain at the worst link of the search."""
        return math.exp(self.search.noise(self.x[:, None])[0])

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
    def worst(self) -> dict[str, tuple[float, int]]:
        """(margin, link) at which each row is worst; the damping at the links that are
        worst in another row, and at those of the search.
        """
        found = {}
        kept = replace(self.search, ringing=False).kept(self._trial)
        for key, figure in kept.items():
            if figure.value.size:
                k = int(np.argmin(figure.value))
                found[key] = float(figure.value[k]), int(figure.link[k])
        links = {*self.search.links, *(link for _, link in found.values())}
        ringing = replace(self.search, links=tuple(sorted(links)), ringing=True)
        figure = ringing.kept(ringing.trial(self.x[:, None]))["damping"]
        if figure.value.size:
            k = int(np.argmin(figure.value))
            found["damping"] = float(figure.value[k]), ringing.links[figure.link[k]]
        return found

    def wider(self) -> Search | None:
        """Return the search extended by the links that are worse than its own; None if
        there are none.
        """
        search, easing = self.search, self.rows.easing
        soft = search.request.soft
        missed = {
            key: link
            for key, (value, link) in self.worst.items()
            if value + (easing if key in soft else 0.0) < -2.0 * KEPT
        }
        links = set(missed.values()) - set(search.links)
        ringing = search.ringing or "damping" in missed
        if not links and ringing == search.ringing:
            return None
        return replace(search, links=(*search.links, *sorted(links)), ringing=ringing)

    @cached_property
    def measured(self) -> tuple[tuple[Row, Requirement], ...]:
        """Every row, and the achieved value where it is worst."""
        request, found = self.search.request, []
        for row, wanted in request.wanted:
            trial, payloads = self._trial, request.arms.payloads_at
            if row.key == "damping":
                _, link = self.worst.get("damping", (0.0, 0))
                alone = replace(self.search, links=(link,))
                trial, payloads = alone.trial(self.x[:, None]), payloads[[link]]
            items = row.measured(trial, request, wanted, payloads)
            found += [(row, item) for item in items]
        return tuple(found)

    def tightened(self, reserves: dict[str, float]) -> Solution:
        """Return the solution with larger reserves for some rows."""
        own = self.search.reserves
        more = {key: own.get(key, 0.0) + value for key, value in reserves.items()}
        search = replace(self.search, reserves={**own, **more})
        return search.over_links(self.x[:, None])


def solved(request: Request) -> Solution:
    """Return the best controller of a request, or the one nearest to it: with every n
    without a notch, and if none of these keeps every row, with one.
    """
    found: list[Solution] = []
    for notch, order in product(request.notches, request.filter_orders):
        search = Search(request, request.first_links, order, notch)
        found.append(search.over_links(search.starts))
        if found[-1].slack == 0.0:
            break
    return min(found, key=lambda one: one.slack)
