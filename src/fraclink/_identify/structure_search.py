"""The best parameters of a structure, without a start value.

1. Orders and delays are drawn over their ranges; coefficients follow by linear least
   squares where possible, and are drawn as well (see `structure_starts`).
2. The best draws descend together on the screen: a recording in a thousand blocks, at
   a few microseconds per candidate.
3. The best of these descend on the samples, each candidate by its exact response.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fraclink._identify.problem import (
    FIRST_STEPS,
    Descent,
    descend,
    descend_within_samples,
)
from fraclink._identify.structure_data import Lines, RecordStart
from fraclink._identify.structure_problem import StructureProblem
from fraclink._identify.structure_starts import drawn_starts
from fraclink.errors import NotConvergedError

__all__ = ["Place", "best_places", "place_of"]


_DESCENTS = 16
_NEARLY = 1.05  # costs on the samples within 5 % are followed to their end
_TRIED = 4  # number of descents followed to their end
# closer costs belong to the same function, found twice or with its parameters exchanged
_SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Place:
    """Parameters of a structure with the output's offset, and the cost there."""

    values: Mapping[str, float]
    offset: float
    cost: float
    converged: bool


def best_places(
    problem: StructureProblem,
    data: RecordStart | Lines,
    start: Mapping[str, float] | None,
) -> tuple[list[Place], int]:
    """Places that no step improves, best first, and the number of candidates used."""
    places = problem.clip(problem.places_of(drawn_starts(problem, data.spectrum)))
    screen = replace(problem, data=data.screen)
    costs = screen.costs(places)
    evaluations, candidates = len(places), []
    # Positive coefficients separately: most functions with a negative one are unstable,
    # which a transform does not show, and they would crowd out the others.
    positive = np.all(places[:, len(problem.moving) :] > 0, axis=1)
    for group in (positive, ~positive):
        rows = places[group & np.isfinite(costs)]
        rows = rows[np.argsort(costs[group & np.isfinite(costs)])[:_DESCENTS]]
        if not len(rows):
            continue
        first = descend(screen, rows, iterations=FIRST_STEPS)
        order = _distinct(problem, first)
        last = descend(screen, first.places[order[:_TRIED]])
        candidates += [*last.places, *first.places[order[_TRIED:]]]
        evaluations += first.evaluations + last.evaluations
    if start is not None:
        # In addition to the others: a wrong start only costs one descent.
        begin = {name: start.get(name, 1.0) for name in problem.names}
        candidates += [*problem.clip(problem.places_of(begin))]
    # A transform does not distinguish unstable functions from stable ones; the samples
    # do.
    rows = np.reshape(candidates, (len(candidates), len(problem.low)))
    costs = problem.costs(rows)
    near = np.argsort(costs)[:_TRIED]
    near = near[np.isfinite(costs[near]) & (costs[near] <= _NEARLY * costs[near[0]])]
    if not near.size:
        raise NotConvergedError(
            problem.structure.text,
            reached=math.inf,
            wanted=0.0,
            remedy="check that the structure is proper (use a frequency response if it is not), or give start",
        )
    first = descend(problem, rows[near], iterations=FIRST_STEPS)
    lowest, *others = _distinct(problem, first)
    ends = [descend(problem, first.places[[lowest]])]
    if isinstance(data, RecordStart):
        # The last steps with exact slopes: those of a transform are up to 1 % off.
        exact = replace(problem, data=replace(data, exact=True))
        ends += [descend(exact, ends[0].places)]
        ends += [
            descend_within_samples(exact, ends[1].places[0], k, data.period)
            for k, name in enumerate(problem.moving)
            if problem.structure.roles[name] == "delay" and data.hold == "zero"
        ]
    evaluations += len(rows) + first.evaluations + sum(e.evaluations for e in ends)
    end = Descent.together(ends)
    best = place_of(problem, end, int(np.argmin(end.costs)))
    return [best, *(place_of(problem, first, k) for k in others)], evaluations


def place_of(problem: StructureProblem, found: Descent, k: int) -> Place:
    """Parameters and offset at the end of a descent."""
    at = problem.fitted(found.places[k : k + 1])
    values = {
        name: float(np.ravel(value)[0])
        for name, value in problem.values(found.places[k : k + 1]).items()
    }
    if problem.projected and problem.gain is not None:
        values[problem.gain] = float(at.gain[0])
    ordered = {name: values[name] for name in problem.structure.names}
    return Place(
        ordered, float(at.offset[0]), float(at.cost[0]), bool(found.converged[k])
    )


def _distinct(problem: StructureProblem, found: Descent) -> list[int]:
    """Indices of the ends of descents, best first, without repetitions.

    If a function has several sets of parameters, like (s^a + c s^b + w)/k after a
    division by c, the set whose orders decrease in the order of the text is taken.
    """
    roles = problem.structure.roles
    orders = [k for k, name in enumerate(problem.moving) if roles[name] == "order"]
    rises = np.count_nonzero(np.diff(found.places[:, orders]) > 0, axis=1)
    best: list[int] = []
    for k in np.argsort(found.costs).tolist():
        if not math.isfinite(found.costs[k]):
            break
        if not best or found.costs[k] > found.costs[best[-1]] * (1 + _SAME):
            best.append(k)
        elif rises[k] < rises[best[-1]]:
            best[-1] = k
    return best
