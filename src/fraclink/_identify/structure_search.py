"""The best parameters of a structure, without a start value.

1. Orders and delays are drawn over their ranges. Where numerator and denominator are
   straight in the coefficients (nearly every structure that people write), these follow
   by linear least squares (Sanathanan and Koerner, IEEE Trans. Autom. Control 8 (1963)
   56); elsewhere they are drawn, too.
2. The best draws descend together on the transform, some microseconds each.
3. The best of these descend on the samples themselves, each candidate by its exact
   response.

The gain (a coefficient that multiplies the whole) and the output's offset are projected
out all along.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fraclink._identify.least_squares import (
    ENOUGH,
    Blocks,
    Descent,
    Stepped,
    decrement,
    descend,
    differences,
    project,
    stepped,
)
from fraclink._identify.structure_problem import (
    RecordStart,
    Samples,
    Spectrum,
    StructureCoordinates,
)
from fraclink._identify.structure_slopes import Coarse, Rows
from fraclink._identify.structure_starts import Starts
from fraclink.errors import NotConvergedError

__all__ = ["PERFECT", "Place", "StructureSearch"]

Reals = NDArray[np.float64]

_DESCENTS = 10
_TRIED = 3  # places of the transform that are compared on the samples
_FIRST_STEPS = 10
# costs closer than that are those of one function, found twice or with its parameters
# exchanged
_SAME = 1e-6
_ENOUGH = 1e-9  # of the cost on samples: what a step gains at the end of a descent
_CALLS = 150
PERFECT = 1e-16  # of the power: a cost below is rounding
_VANISHED = 14.0  # in the logarithm: within a factor of a million of the range's end
_RETURNS = 29
# times the least cost of these: values that hardly disturb what was found, or improve
# it
_RETURNED = 3.0
_NEARLY = 1.05  # costs on the samples within 5 % are both followed to their end


@dataclass(frozen=True, eq=False)
class Place:
    """Parameters of a structure with the output's offset, and the cost there."""

    values: Mapping[str, float]
    offset: float
    cost: float
    converged: bool


@dataclass(eq=False)
class StructureSearch:
    """The search for one structure in one set of data; `offset` is None where it is
    free.
    """

    coordinates: StructureCoordinates
    offset: float | None
    evaluations: int = 0
    rows: Rows | None = None

    def residuals(self, data: Samples, places: Reals) -> Reals:
        """Residuals (M, R) with gain and offset at their best."""
        return self._projected(data, places)[0]

    def _projected(self, data: Samples, places: Reals) -> tuple[Reals, Reals]:
        own = self.coordinates
        simulated = data.simulated(own.structure, own.values(places), len(places))
        measured = data.measured
        columns, limits = [], []
        # Without a gain the whole response counts as measured: only the offset is left
        # to be fitted to it.
        if own.gain is None:
            measured = measured - simulated
        else:
            columns.append(simulated)
            limits.append(own.limits[own.gain])
        if data.offset is not None and self.offset is None:
            columns.append(np.broadcast_to(data.offset, simulated.shape))
            limits.append((-math.inf, math.inf))
        elif data.offset is not None and self.offset is not None:
            measured = measured - self.offset * data.offset
        if not columns:
            return np.broadcast_to(measured, simulated.shape), np.zeros(
                (len(places), 0)
            )
        low, high = np.array(limits).T
        if measured.ndim == 1:
            return project(measured, np.stack(columns, axis=1), low, high)
        # No gain: only the offset is linear, and what is left differs from candidate to
        # candidate.
        column = columns[0]
        with np.errstate(all="ignore"):
            best = np.einsum("mr,mr->m", measured, column) / np.einsum(
                "mr,mr->m", column, column
            )
            return measured - best[:, None] * column, best[:, None]

    def place(
        self, data: Samples, coordinates: Reals, cost: float, *, converged: bool
    ) -> Place:
        """Parameters and offset at coordinates."""
        own = self.coordinates
        linear = self._projected(data, coordinates[None, :])[1][0].tolist()
        values = {
            name: float(v[0, 0]) for name, v in own.values(coordinates[None, :]).items()
        }
        if own.gain is not None:
            values[own.gain] = linear.pop(0)
        ordered = {name: values[name] for name in own.structure.names}
        return Place(
            ordered, linear[0] if linear else (self.offset or 0.0), cost, converged
        )

    def run(
        self, data: RecordStart | Spectrum, start: Mapping[str, float] | None
    ) -> list[Place]:
        """Places that no step improves, best first."""
        spectrum = data.spectrum if isinstance(data, RecordStart) else data
        low, high = self.coordinates.box(self.coordinates.moving)
        begin = Starts(self.coordinates, spectrum, self.offset is None).places()
        screen: Samples = spectrum
        if isinstance(data, RecordStart) and data.earlier.size:
            screen = self._rows_of(data).screen()
        draws = self._ranked(screen, np.clip(begin, low, high))
        if start is not None:
            # Before the others and not in their place: a wrong start costs one descent
            # and hides nothing.
            given = [
                float(self.coordinates.place(name, start[name]))
                for name in self.coordinates.moving
            ]
            draws = np.concatenate([np.array([given]), draws])
        # Few steps tell a promising descent from a lost one; only the former are worth
        # an end.
        names = self.coordinates.moving
        orders = [
            k
            for k, n in enumerate(names)
            if self.coordinates.structure.roles[n] == "order"
        ]
        first = _distinct(
            self._descend(screen, draws, low, high, iterations=_FIRST_STEPS), orders
        )
        if not first:
            raise self._lost()
        again = self._descend(
            screen, np.array(first[:_TRIED]), low, high, iterations=60
        )
        ranked = _distinct(again, orders)
        if isinstance(data, RecordStart):
            if start is not None:
                ranked = [draws[0], *ranked]
            # The transform does not know an unstable function from a stable one; its
            # samples do.
            ranked = self._on_samples(data, [*ranked, *first[_TRIED:]])[:_TRIED]
            if not ranked:
                raise self._lost()
            last = self._ended(data, ranked, low, high)
            if data.hold == "zero":
                last = self._over_the_jumps(data, last, low, high)
        else:
            last = self._settled(data, np.array(ranked[:_TRIED]), low, high)
        last = self._back_from_zero(data, screen, last, low, high)
        order = [k for k in np.argsort(last.costs) if np.isfinite(last.costs[k])]
        return [
            self.place(
                data,
                last.places[k],
                float(last.costs[k]),
                converged=bool(last.converged[k]),
            )
            for k in order
        ]

    def _over_the_jumps(
        self, data: RecordStart, found: Descent, low: Reals, high: Reals
    ) -> Descent:
        """The best place again with each delay within the sampling interval before and
        behind it.

        A held input jumps, and the response to a jump may begin with a vertical
        tangent: as a function of the delay the cost has a cusp wherever a sample passes
        a jump, and is smooth only between two of them.
        """
        best = int(np.argmin(found.costs))
        for k, name in enumerate(self.coordinates.moving):
            if self.coordinates.structure.roles[name] != "delay":
                continue
            periods = float(found.places[best, k]) / data.period
            # A delay on a sample (to 1e-9 of the period) belongs to one interval, any
            # other to the two beside it.
            for whole in sorted(
                {math.floor(periods + 1e-9), math.ceil(periods - 1e-9)}
            ):
                inner = low.copy(), high.copy()
                inner[0][k] = max((whole - 1 + 1e-6) * data.period, low[k])
                inner[1][k] = min(whole * data.period, high[k])
                if inner[0][k] >= inner[1][k]:
                    continue
                begin = found.places[best : best + 1].copy()
                # From the sample itself, where the cost is smooth from below.
                begin[0, k] = inner[1][k]
                _take_over(found, best, self._settled(data, begin, *inner))
        return found

    def _back_from_zero(
        self, data: Samples, screen: Samples, found: Descent, low: Reals, high: Reals
    ) -> Descent:
        """The best place again from larger values of coefficients that vanished.

        In the logarithm the cost of a vanishing coefficient is flat, and a descent that
        has come there for a passing reason has no slope to return by.
        """
        best = int(np.argmin(found.costs))
        for k, name in enumerate(self.coordinates.moving):
            if (
                not self.coordinates.is_logarithmic(name)
                or found.places[best, k] > low[k] + _VANISHED
            ):
                continue
            tried = np.repeat(found.places[best : best + 1], _RETURNS, axis=0)
            # A factor e a step over twelve decades: a valley of a coefficient is wider
            # than that in the logarithm.
            tried[:, k] = np.linspace(
                max(low[k], -_VANISHED), min(high[k], _VANISHED), _RETURNS
            )
            costs = np.einsum("mr,mr->m", rest := self.residuals(screen, tried), rest)
            near = np.flatnonzero(costs <= _RETURNED * np.nanmin(costs))
            begin = tried[near[-_TRIED:]]
            # The transform does not tell them apart as the samples do: each is settled
            # there.
            _take_over(found, best, self._settled(data, begin, low, high))
        return found

    def descended(self, data: Samples, begin: Reals) -> Place:
        """The place that the descent from one set of coordinates, shape (1, p), ends
        at.
        """
        low, high = self.coordinates.box(self.coordinates.moving)
        found = self._settled(data, begin, low, high)
        return self.place(
            data,
            found.places[0],
            float(found.costs[0]),
            converged=bool(found.converged[0]),
        )

    def _lost(self) -> NotConvergedError:
        remedy = "check that the structure is proper (use a frequency response if it is not), or give start"
        return NotConvergedError(
            self.coordinates.structure.text, reached=math.inf, wanted=0.0, remedy=remedy
        )

    def _descend(
        self, data: Samples, places: Reals, low: Reals, high: Reals, *, iterations: int
    ) -> Descent:
        # The unit of time is the middle of the band: there coefficients and orders
        # trade least.
        shear = self.coordinates.shear(math.sqrt(math.prod(data.band)))
        found = descend(
            lambda x: self.residuals(data, x),
            places,
            low,
            high,
            iterations=iterations,
            shear=shear,
        )
        self.evaluations += found.evaluations
        return found

    def _ended(
        self, data: RecordStart, places: list[Reals], low: Reals, high: Reals
    ) -> Descent:
        """The ends of descents on the samples: first on a transform back, then with the
        exact response.
        """
        ends = [
            self._stepped(data, np.clip(place, low + 1e-9, high - 1e-9), low, high)
            for place in places
        ]
        rows = [(end.place, end.cost, end.converged) for end in ends]
        reached, costs, converged = (
            np.array(column) for column in zip(*rows, strict=True)
        )
        found = Descent(reached, costs, converged, 0)
        for k in np.flatnonzero(~found.converged):
            again = self._settled(data, found.places[k : k + 1], low, high)
            found.places[k], found.costs[k] = again.places[0], again.costs[0]
            found.converged[k] = again.converged[0]
        return found

    def _stepped(
        self, data: RecordStart, begin: Reals, low: Reals, high: Reals
    ) -> Stepped:
        """Steps whose Jacobian is that of a transform back, which no candidate is
        simulated for.
        """
        own = self.coordinates
        moving = [own.names.index(name) for name in own.moving]

        def descent(samples: Samples, place: Reals, *, damped: bool = False) -> Stepped:
            found = stepped(
                lambda x: self.residuals(samples, x[None, :])[0],
                lambda x: self.blocks(
                    samples, self.place(samples, x, 0.0, converged=False)
                ),
                place,
                (low, high),
                moving,
                PERFECT * float(samples.measured @ samples.measured),
                damped=damped,
            )
            self.evaluations += found.evaluations
            return found

        found = descent(data, begin)
        if found.ended or not math.isfinite(found.cost):
            return found
        # The exact response failed to lead on, mostly from a place far off: there a
        # crude transform is good enough.
        values = self.place(data, found.place, 0.0, converged=False).values
        coarse = self._rows_of(data).coarse(own, values, crude=True)
        if coarse is None:
            return found
        again = descent(data, descent(coarse, found.place, damped=True).place)
        return again if again.cost < found.cost else found

    def _settled(
        self, data: Samples, places: Reals, low: Reals, high: Reals
    ) -> Descent:
        """The ends of descents by a trust region, one after another.

        Its radius keeps to a curved valley that a swinging damping crosses again and
        again: 30 calls instead of hundreds where two terms of a sum have nearly one
        order.
        """

        def residuals(x: Reals) -> Reals:
            self.evaluations += 1
            return np.asarray(self.residuals(data, x[None, :])[0])

        def jacobian(x: Reals) -> Reals:
            self.evaluations += x.size
            many = partial(self.residuals, data)
            return np.asarray(
                differences(many, x[None, :], residuals(x)[None, :], low, high)[0].T
            )

        ends, costs, converged = [], [], []
        for place in places:
            begin = np.clip(
                place, low + 1e-9, high - 1e-9
            )  # strictly inside, as the method demands
            first = residuals(begin)
            if not begin.size or not np.isfinite(first).all():
                ends.append(begin)
                costs.append(
                    float(first @ first) if np.isfinite(first).all() else math.inf
                )
                converged.append(not begin.size)
                continue
            with np.errstate(
                all="ignore"
            ):  # a parameter that nothing depends on divides by zero
                found = least_squares(
                    residuals,
                    begin,
                    jacobian,
                    bounds=(low, high),
                    x_scale="jac",
                    ftol=_ENOUGH,
                    xtol=1e-10,
                    gtol=None,
                    max_nfev=_CALLS,
                )
            ends.append(found.x)
            # scipy's cost is half a sum of squares.
            costs.append(2.0 * float(found.cost))
            least = max(
                ENOUGH * costs[-1], PERFECT * float(data.measured @ data.measured)
            )
            converged.append(found.status > 0 and decrement(found) <= least)
        return Descent(np.array(ends), np.array(costs), np.array(converged), 0)

    def _ranked(self, screen: Samples, draws: Reals) -> Reals:
        """The best draws."""
        costs = np.einsum("mr,mr->m", rest := self.residuals(screen, draws), rest)
        self.evaluations += len(draws)
        return draws[
            np.argsort(np.where(np.isfinite(costs), costs, np.inf), kind="stable")
        ][:_DESCENTS]

    def _on_samples(self, data: RecordStart, places: list[Reals]) -> list[Reals]:
        """The places whose exact response is nearly as near to the samples as the best
        one's.
        """
        if not places:
            return []
        rest = self.residuals(data, np.array(places))
        costs = np.einsum("mr,mr->m", rest, rest)
        self.evaluations += len(places)
        costs = np.where(np.isfinite(costs), costs, np.inf)
        order = np.argsort(costs, kind="stable")
        return [
            places[k]
            for k in order
            if np.isfinite(costs[k]) and costs[k] <= _NEARLY * costs[order[0]]
        ]

    # --- derivatives of the whole ---------------------------------------------------------------------------

    def blocks(self, data: Samples, place: Place) -> Blocks | None:
        """∂(measured)/∂(free parameters' coordinates, then the offset where it is
        free), of a recording.

        None where no transform back knows them.
        """
        own = self.coordinates
        coarse = data if isinstance(data, Coarse) else None
        if isinstance(data, RecordStart):
            coarse = self._rows_of(data).coarse(own, place.values)
        if coarse is None:
            return None
        found = coarse.rows(own, place.values)
        if found is None:
            return None
        if self.offset is None:
            found = np.concatenate([found, coarse.offset[None, :]])
        return (
            Blocks(found, 1, True)
            if coarse is data
            else Blocks(found, coarse.width, coarse.sharp)
        )

    def _rows_of(self, data: RecordStart) -> Rows:
        if self.rows is None or self.rows.data is not data:
            self.rows = Rows(data)
        return self.rows

    def jacobian(self, data: Samples, place: Place) -> Blocks:
        """As `blocks`, with differences where no transform knows the slopes well, shape
        (q, R).
        """
        found = self.blocks(data, place)
        if found is not None and found.sharp:
            return found
        own, names = self.coordinates, self.coordinates.names
        at = np.array([[float(own.place(name, place.values[name])) for name in names]])
        low, high = own.box(names)

        def simulated(places: Reals) -> Reals:
            return data.simulated(
                own.structure, own.values(places, projected=False), len(places)
            )

        # With the gain as a coordinate: its error is asked for, too, though the search
        # projects it out.
        rows = differences(simulated, at, simulated(at), low, high)[0]
        self.evaluations += len(names) + 1
        if data.offset is not None and self.offset is None:
            rows = np.concatenate([rows, data.offset[None, :]])
        return Blocks(rows, 1)


def _take_over(found: Descent, k: int, again: Descent) -> None:
    """Put the best end of another descent in place k where it is lower."""
    least = int(np.argmin(again.costs))
    if again.costs[least] < found.costs[k]:
        found.places[k], found.costs[k] = again.places[least], again.costs[least]
        found.converged[k] = again.converged[least]


def _rises(place: Reals, orders: Sequence[int]) -> int:
    return int(np.count_nonzero(np.diff(place[list(orders)]) > 0))


def _distinct(found: Descent, orders: Sequence[int]) -> list[Reals]:
    """The places of a descent without repetitions, best first.

    Where one function has several sets of parameters, as (s^a + c s^b + w)/k has after
    a division by c, the one is taken whose orders (the columns `orders`) fall in the
    order of the text.
    """
    kept: list[Reals] = []
    last = -math.inf
    for k in np.argsort(found.costs, kind="stable"):
        cost = float(found.costs[k])
        if not math.isfinite(cost):
            break
        if not kept or cost > last * (1 + _SAME):
            kept.append(found.places[k])
            last = cost
        elif _rises(found.places[k], orders) < _rises(kept[-1], orders):
            kept[-1] = found.places[k]
    return kept
