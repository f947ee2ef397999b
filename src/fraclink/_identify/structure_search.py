"""The best parameters of a structure, without a start value.

1. Orders and delays are drawn over their ranges. Where numerator and denominator are
   straight in the coefficients (nearly every structure that people write), these follow
   by linear least squares (Sanathanan and Koerner, IEEE Trans. Autom. Control 8 (1963)
   56); besides, all are drawn. Coefficients keep the sign that they came with.
2. The best draws descend together on the screen (a recording in a thousand blocks, a
   candidate some microseconds).
3. The best of these descend on the samples, each candidate by its exact response.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from fraclink._identify.problem import descend
from fraclink._identify.structure_data import Lines, RecordStart, Samples
from fraclink._identify.structure_problem import StructureCoordinates, StructureProblem
from fraclink._identify.structure_starts import Starts
from fraclink.errors import NotConvergedError

__all__ = ["PERFECT", "Place", "StructureSearch"]

Reals = NDArray[np.float64]

_DESCENTS = 16
_LAST_STEPS = 20
_FIRST_STEPS = 10  # tell a promising descent from a lost one
_NEARLY = 1.05  # costs on the samples within 5 % are followed to their end
_TRIED = 4  # places of the screen that are followed to their end on the samples
# costs closer than that are those of one function, found twice or with its parameters
# exchanged
_SAME = 1e-6
# Of the cost: in 10 000 samples a tenth of a parameter's standard error; a transform's
# slopes tell no more.
_ENDED = 1e-5
PERFECT = 1e-16  # of the power: a cost below is rounding


@dataclass(frozen=True, eq=False)
class Place:
    """Parameters of a structure with the output's offset, and the cost there."""

    values: Mapping[str, float]
    offset: float
    cost: float
    converged: bool


@dataclass(frozen=True, eq=False)
class _Candidate:
    """Coordinates of a structure with the signs of its coefficients."""

    own: StructureCoordinates
    place: Reals
    cost: float
    converged: bool = False

    @property
    def rises(self) -> int:
        """How often an order is above the one before it in the text."""
        roles = self.own.structure.roles
        orders = [roles[name] == "order" for name in self.own.moving]
        return int(np.count_nonzero(np.diff(self.place[orders]) > 0))


@dataclass(eq=False)
class StructureSearch:
    """The search for one structure in one set of data; `offset` is None where it is
    free.
    """

    coordinates: StructureCoordinates
    offset: float | None
    evaluations: int = 0

    def run(
        self, data: RecordStart | Lines, start: Mapping[str, float] | None
    ) -> list[Place]:
        """Places that no step improves, best first."""
        draws = Starts(self.coordinates, data.spectrum, self.offset is None).values()
        if start is not None:
            # Before the others and not in their place: a wrong start costs one descent
            # and hides nothing.
            draws = {
                n: np.concatenate([[start.get(n, 1.0)], v]) for n, v in draws.items()
            }
        first, best = [], []
        # Positive coefficients apart: most functions with a negative one are unstable,
        # which a transform does not see, and would crowd them out.
        for ranked in self._ranked(data.screen, draws):
            parts = _distinct(self._descended(data.screen, ranked, _FIRST_STEPS))
            best += _distinct(self._descended(data.screen, parts[:_TRIED], 100))
            first += parts[_TRIED:]
        if isinstance(data, RecordStart):
            if start is not None:
                best = [
                    *chain(*self._ranked(data, {n: v[:1] for n, v in draws.items()})),
                    *best,
                ]
            # A transform does not know an unstable function from a stable one; its
            # samples do.
            best = self._costed(data, [*best, *first])
            near = [c for c in best if c.cost <= _NEARLY * best[0].cost]
            best = near[:_TRIED]
            best = self._descended(data, best, 100)
            # The last step by exact slopes: those of a transform are off by up to 1 %.
            last = self._descended(replace(data, exact=True), best[:1], _LAST_STEPS)
            best = [*last, *best[1:]]
            if data.hold == "zero" and best:
                best = [*self._within_periods(data, best[0]), *best]
        best = [c for c in sorted(best, key=lambda c: c.cost) if math.isfinite(c.cost)]
        if not best:
            remedy = "check that the structure is proper (use a frequency response if it is not), or give start"
            raise NotConvergedError(
                self.coordinates.structure.text,
                reached=math.inf,
                wanted=0.0,
                remedy=remedy,
            )
        return [self.place_of(data, candidate) for candidate in best]

    def _ranked(
        self, data: Samples, draws: Mapping[str, Reals]
    ) -> tuple[list[_Candidate], list[_Candidate]]:
        """The best draws with positive coefficients, and those with other signs."""
        own = self.coordinates
        both = [name for name in own.moving if own.has_both_signs(name)]
        groups: dict[tuple[float, ...], list[int]] = {}
        for k in range(len(draws[own.names[0]])):
            pattern = tuple(math.copysign(1.0, draws[name][k]) for name in both)
            groups.setdefault(pattern, []).append(k)
        found: tuple[list[_Candidate], list[_Candidate]] = [], []
        for pattern, rows in groups.items():
            part = replace(own, signs=dict(zip(both, pattern, strict=True)))
            places = np.array([part.place(n, draws[n][rows]) for n in own.moving])
            places = places.reshape(len(own.moving), len(rows)).T
            problem = StructureProblem(part, data, self.offset)
            places = problem.clip(places)
            costs = problem.costs(places)
            self.evaluations += len(places)
            found[min(pattern, default=1.0) < 0].extend(
                _Candidate(part, place, float(cost))
                for place, cost in zip(places, costs, strict=True)
                if math.isfinite(cost)
            )
        one, other = (sorted(c, key=lambda c: c.cost)[:_DESCENTS] for c in found)
        return one, other

    def _descended(
        self, data: Samples, candidates: Sequence[_Candidate], iterations: int
    ) -> list[_Candidate]:
        """The ends of descents, best first; candidates of one sign descend together."""
        found = []
        perfect = PERFECT * float(data.measured @ data.measured)
        ended = _ENDED if isinstance(data, RecordStart) else 1e-10
        for own in dict.fromkeys(candidate.own for candidate in candidates):
            places = np.array([c.place for c in candidates if c.own is own])
            problem = StructureProblem(own, data, self.offset)
            ends = descend(
                problem, places, iterations=iterations, ended=ended, perfect=perfect
            )
            self.evaluations += ends.evaluations
            rows = zip(ends.places, ends.costs, ends.converged, strict=True)
            found += [_Candidate(own, p, float(c), bool(ok)) for p, c, ok in rows]
        return sorted(found, key=lambda candidate: candidate.cost)

    def _costed(
        self, data: Samples, candidates: Sequence[_Candidate]
    ) -> list[_Candidate]:
        """The candidates with their costs in these data, best first."""
        self.evaluations += len(candidates)
        costs = [
            float(StructureProblem(c.own, data, self.offset).costs(c.place[None, :])[0])
            for c in candidates
        ]
        rows = [replace(c, cost=x) for c, x in zip(candidates, costs, strict=True)]
        return sorted((c for c in rows if math.isfinite(c.cost)), key=lambda c: c.cost)

    def _within_periods(self, data: RecordStart, best: _Candidate) -> list[_Candidate]:
        """Descents with each delay within the sampling intervals before and behind it.

        A held input jumps, and the response to a jump may begin with a vertical
        tangent: as a function of the delay the cost has a cusp wherever a sample passes
        a jump, and is smooth only between two of them.
        """
        found, own = [], best.own
        for k, name in enumerate(own.moving):
            if own.structure.roles[name] != "delay":
                continue
            periods = float(best.place[k]) / data.period
            # A delay on a sample (to 1e-9 of the period) belongs to one interval, any
            # other to the two beside it.
            for whole in {math.floor(periods + 1e-9), math.ceil(periods - 1e-9)}:
                low = max((whole - 1 + 1e-6) * data.period, own.limits[name][0])
                high = min(whole * data.period, own.limits[name][1])
                if low >= high:
                    continue
                inner = replace(own, limits={**own.limits, name: (low, high)})
                begin = best.place.copy()
                # From the sample itself, where the cost is smooth from below.
                begin[k] = high
                found += self._descended(data, [_Candidate(inner, begin, 0.0)], 100)
        return found

    def descended(self, data: Samples, values: Mapping[str, float]) -> Place:
        """The place that the descent from values ends at."""
        own = self.coordinates
        signs = {
            n: math.copysign(1.0, values[n])
            for n in own.moving
            if own.has_both_signs(n)
        }
        own = replace(own, signs=signs)
        place = np.array([float(own.place(n, values[n])) for n in own.moving])
        begin = _Candidate(own, place, 0.0)
        return self.place_of(data, self._descended(data, [begin], 100)[0])

    def place_of(self, data: Samples, candidate: _Candidate) -> Place:
        """Parameters and offset of a candidate."""
        own = candidate.own
        problem = StructureProblem(own, data, self.offset)
        at = problem.quadratic(candidate.place[None, :])
        values = {
            name: float(np.ravel(v)[0])
            for name, v in own.values(candidate.place[None, :]).items()
        }
        if own.gain is not None:
            values[own.gain] = float(at.gain[0])
        ordered = {name: values[name] for name in own.structure.names}
        return Place(ordered, float(at.offset[0]), candidate.cost, candidate.converged)


def _distinct(candidates: Sequence[_Candidate]) -> list[_Candidate]:
    """Candidates, best first, without repetitions.

    Where one function has several sets of parameters, as (s^a + c s^b + w)/k has after
    a division by c, the one is taken whose orders fall in the order of the text.
    """
    kept: list[_Candidate] = []
    for candidate in candidates:
        if not math.isfinite(candidate.cost):
            continue
        if not kept or candidate.cost > kept[-1].cost * (1 + _SAME):
            kept.append(candidate)
        elif candidate.rises < kept[-1].rises:
            kept[-1] = candidate
    return kept
