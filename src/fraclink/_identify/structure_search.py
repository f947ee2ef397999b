"""The best parameters of a structure, without a start value.

1. Parameters are drawn over their ranges; the size of the response and the offset
   follow by linear least squares.
2. The best draws descend together on the screen: a recording in blocks, at a few
   microseconds per candidate.
3. The best of these descend on the samples, each candidate by its exact response.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from fraclink._identify.problem import (
    FIRST_STEPS,
    Descent,
    descend,
    descend_within_samples,
)
from fraclink._identify.structure_data import Blocks, Lines, Signals
from fraclink._identify.structure_problem import StructureProblem
from fraclink.errors import NotConvergedError
from fracsys.checks import Real

# Number of draws, of the descents that begin from the best of them, and of those that
# are continued after a few steps: on the screen each stage takes about equally long.
_DRAWS, _DESCENTS, _FOLLOWED = 1000, 64, 16
# blocks of a screen: orders, corners and delays show in its lowest 250 lines
_BLOCKS = 500
# Costs on the samples within 5 % are followed: following all that are tried takes up to
# twice the time and found no better place on the examples of benchmarks/bench_structures.py.
_NEARLY = 1.05
_TRIED = 4  # number of descents on the samples


@dataclass(frozen=True, eq=False)
class Place:
    """Parameters of a structure with the output's offset, and the cost there."""

    values: Mapping[str, float]
    offset: float
    cost: float
    converged: bool


# A candidate may overflow: its cost is infinite, and it is dropped.
@np.errstate(all="ignore")
def best_places(
    problem: StructureProblem, data: Signals | Lines, start: Mapping[str, float] | None
) -> list[Place]:
    """The place that no step improves, then its rivals after their first steps."""
    width = math.ceil(data.measured.size / _BLOCKS)
    # A candidate for the lines of a response costs microseconds as it is.
    screen = replace(
        problem, data=Blocks(data, width) if isinstance(data, Signals) else data
    )
    places = screen.sized(_drawn_places(problem, data))
    costs = screen.costs(places)
    candidates: list[Real] = []
    # Positive coefficients separately: most functions with a negative one are unstable,
    # which a transform does not show, and they would crowd out the others.
    positive = np.all(places >= 0.0, axis=1)
    for group in (positive, ~positive):
        rows = places[group & np.isfinite(costs)]
        rows = rows[np.argsort(costs[group & np.isfinite(costs)])[:_DESCENTS]]
        if not len(rows):
            continue
        first = descend(screen, rows, iterations=FIRST_STEPS)
        promising = _distinct(problem, first)[:_FOLLOWED]
        last = descend(screen, first.places[promising])
        candidates += [*last.places[_distinct(problem, last)]]
    if start is not None:
        # In addition to the others: a wrong start only costs one descent.
        candidates += [*problem.clip(problem.places_of(start))]
    # A transform does not distinguish unstable functions from stable ones; the samples
    # do.
    rows = np.reshape(candidates, (len(candidates), len(problem.names)))
    costs = problem.costs(rows)
    near = np.argsort(costs)[:_TRIED]
    near = near[
        np.isfinite(costs[near])
        & (costs[near] <= _NEARLY * costs.min(initial=math.inf))
    ]
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
    if isinstance(data, Signals) and data.hold == "zero":
        ends += [
            descend_within_samples(problem, ends[0].places[0], k, data.period)
            for k, name in enumerate(problem.names)
            if problem.structure.roles[name] == "delay"
        ]
    best = min(
        (place_of(problem, end, int(np.argmin(end.costs))) for end in ends),
        key=lambda place: place.cost,
    )
    return [best, *(place_of(problem, first, k) for k in others)]


def _drawn_places(problem: StructureProblem, data: Signals | Lines) -> Real:
    """Places (M, p) spread over the ranges of orders, delays and coefficients."""
    # The same in every run.
    generator = np.random.default_rng(0)
    slowest, fastest = data.band
    values = {}
    for name in problem.names:
        low, high = problem.limits[name]
        even, other, chance = generator.random((3, _DRAWS))
        if problem.structure.roles[name] == "order":
            values[name] = low + (high - low) * even
        elif problem.structure.roles[name] == "delay":
            # Small delays matter most, and no delay at all is the most usual case.
            longest = min(high, 1.0 / slowest)
            delay = longest * (slowest / fastest) ** even
            values[name] = np.where(chance < 0.25, low, np.maximum(delay, low))
        else:
            # ω^(−4 … 4) for a frequency of the band: coefficients are powers of a
            # frequency, whatever the structure.
            size = (slowest * (fastest / slowest) ** other) ** (8.0 * even - 4.0)
            value = np.where(chance < 0.25, -size, size)
            inside = (value >= low) & (value <= high)
            ends = problem.coordinate(name, np.array([low, high]))
            anywhere = problem.value(name, ends[0] + (ends[1] - ends[0]) * even)
            values[name] = np.where(inside, value, anywhere)
    return problem.places_of(values)


def place_of(problem: StructureProblem, found: Descent, k: int) -> Place:
    """Parameters and offset at the end of a descent."""
    values = {
        name: float(np.ravel(value)[0])
        for name, value in problem.values(found.places[[k]]).items()
    }
    return Place(
        values,
        problem.best_offset(values),
        float(found.costs[k]),
        bool(found.converged[k]),
    )


def _distinct(problem: StructureProblem, found: Descent) -> NDArray[np.int_]:
    """Indices of the ends of descents, best first, without repetitions."""
    order = np.argsort(found.costs)[: np.count_nonzero(np.isfinite(found.costs))]
    costs = found.costs[order]
    # Costs that agree within the precision of a descent belong to the same function,
    # found twice or with its parameters exchanged.
    return order[np.diff(costs, prepend=-math.inf) > problem.precision * costs]


def in_order(problem: StructureProblem, place: Place) -> Place:
    """The place with the orders of exchangeable terms decreasing in the order of the
    text.

    In a2*s**n2 + a1*s**n1 the two terms may be exchanged: which order is called n2 is a
    convention.
    """
    values, roles = dict(place.values), problem.structure.roles
    orders = [n for n in problem.names if roles[n] == "order"]
    others = [n for n in problem.names if roles[n] == "coefficient"]
    for first, second in combinations(orders, 2):
        for partners in [(), *combinations(others, 2)]:
            pairs = [(first, second), (second, first), *permutations(partners, 2)]
            swapped = values | {one: values[other] for one, other in pairs}
            alike = all(
                problem.limits[one] == problem.limits[two] for one, two in pairs
            )
            if not alike or values[first] >= values[second]:
                continue
            here, there = problem.output(values), problem.output(swapped)
            least = problem.precision * float(np.ptp(here))
            if np.allclose(there, here, rtol=0.0, atol=least):
                values = swapped
    return replace(place, values=values)
