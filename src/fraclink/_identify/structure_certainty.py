"""Uncertainty of the parameters of a structure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from fraclink._identify.problem import (
    AT_LIMIT,
    ORDER_MOST,
    QUANTILE,
    RESOLUTION,
    Interval,
    interval_ends,
)
from fraclink._identify.structure_data import Lines
from fraclink._identify.structure_problem import GENERAL_POINTS, StructureProblem
from fraclink._identify.structure_search import Place
from fraclink._identify.uncertainty import Covariance

__all__ = ["Certainty", "certainty_of", "in_order"]


# share in an undetermined direction beyond which a parameter belongs to it
_SHARE = 0.1
# Relative half-width of the interval of a coefficient beyond which the data do not
# determine it: a factor of two.
_COEFFICIENT_MOST = 0.5


@dataclass(frozen=True, eq=False)
class Certainty:
    """The uncertainty of each parameter; `pairs` are the correlations of all pairs,
    `blind` the undetermined parameters.

    `blind` are the parameters in directions along which the measured output does not
    change; `inflation` is the largest factor by which the residual's colour widens a
    variance.
    """

    intervals: Mapping[str, Interval]
    standard_errors: Mapping[str, float]
    at_bound: tuple[str, ...]
    undetermined: tuple[str, ...]
    blind: tuple[str, ...]
    pairs: Mapping[tuple[str, str], float]
    inflation: float = 1.0


def certainty_of(
    searched: StructureProblem, best: Place, *, details: bool
) -> Certainty:
    """Standard errors that account for the residual's colour; profile intervals with
    `details`.
    """
    every = replace(searched, projected=False)
    stuck = tuple(
        name for name in every.names if _is_at_bound(every, name, best.values[name])
    )
    # A parameter at a limit is held there for the others.
    fixed = {**every.fixed, **{name: best.values[name] for name in stuck}}
    problem = replace(every, fixed=fixed)
    free, data = problem.names, problem.data
    if not free:
        return Certainty({}, {}, stuck, (), (), {})
    place = problem.places_of(best.values)[0]
    rows, residual = problem.linearised(place)
    perfect = best.cost <= RESOLUTION * problem.power
    covariance = Covariance.of(
        (*free, "offset")[: len(rows)],
        rows,
        residual,
        best.cost,
        coloured=not perfect,
        are_lines=isinstance(data, Lines),
    )
    shares = np.abs(covariance.unseen).max(axis=1, initial=0.0)
    blind = tuple(
        name
        for name, share in zip(free, shares, strict=False)  # the offset comes last
        if share > _SHARE
    )
    intervals = {
        name: _straight_interval(
            problem,
            name,
            float(place[k]),
            QUANTILE * covariance.errors[name],
            best.values[name],
        )
        for k, name in enumerate(free)
        if name not in blind
    }
    # A profile cannot determine a parameter that is undetermined by its standard error,
    # and its valley takes long to follow.
    indices = [
        k
        for k, name in enumerate(free)
        if name in intervals
        and _is_known(problem, name, best.values[name], intervals[name])
    ]
    if details and best.converged and not perfect and indices:
        unit = np.eye(place.size)[indices]
        ends = interval_ends(
            problem,
            place,
            best.cost,
            lambda x: (x[:, indices], np.repeat(unit[None], len(x), axis=0)),
            np.array([covariance.inflation[free[k]] for k in indices]),
        )
        for k, end in zip(indices, ends, strict=True):
            intervals[free[k]] = _in_values(problem, free[k], end, best.values[free[k]])
    errors = {
        name: covariance.errors[name]
        * (abs(best.values[name]) if problem.is_logarithmic(name) else 1.0)
        for name in intervals
    }
    undetermined = tuple(
        name
        for name in free
        if name in blind
        or not _is_known(problem, name, best.values[name], intervals[name])
    )
    pairs = {
        (free[i], free[j]): float(covariance.correlations[i, j])
        for i, j in combinations(range(len(free)), 2)
    }
    widest = max((covariance.inflation[name] for name in intervals), default=1.0)
    return Certainty(intervals, errors, stuck, undetermined, blind, pairs, widest)


def _is_at_bound(problem: StructureProblem, name: str, value: float) -> bool:
    low, high = problem.box_of(name)
    # Share of the range of the coordinate: for 1e-12 to 1e12 it is a factor of 1 +
    # 5e-6.
    near, place = AT_LIMIT * (high - low), float(problem.coordinate(name, value))
    return place <= low + near or place >= high - near


def _is_known(
    problem: StructureProblem, name: str, value: float, interval: Interval
) -> bool:
    """Whether an interval is informative: closed, and narrow enough (see
    `_COEFFICIENT_MOST`).
    """
    role = problem.structure.roles[name]
    if interval.high_open or (interval.low_open and role != "delay"):
        return False
    # A delay of zero is the usual result, and its interval begins at that limit: only
    # the upper end has to be closed.
    half = (interval.high - interval.low) / 2
    if role == "order":
        return half <= ORDER_MOST
    return role == "delay" or half <= _COEFFICIENT_MOST * abs(value)


def _straight_interval(
    problem: StructureProblem, name: str, centre: float, reach: float, value: float
) -> Interval:
    """The interval for a cost that is a parabola in the coordinate."""
    low, high = problem.box_of(name)
    below, above = max(centre - reach, low), min(centre + reach, high)
    ends = Interval(below, above, below <= low, above >= high)
    return _in_values(problem, name, ends, value)


def _in_values(
    problem: StructureProblem, name: str, ends: Interval, value: float
) -> Interval:
    """The interval of a parameter from that of its coordinate."""
    low, high = (
        float(problem.value(name, end, math.copysign(1.0, value)))
        for end in (ends.low, ends.high)
    )
    if low > high:  # for a negative coefficient the larger magnitude is the lower end
        return Interval(high, low, ends.high_open, ends.low_open)
    return Interval(low, high, ends.low_open, ends.high_open)


# --- exchangeable terms -------------------------------------------------------------------------------------


def in_order(own: StructureProblem, place: Place) -> Place:
    """The place with the orders of exchangeable terms decreasing in the order of the
    text.

    In a2*s**n2 + a1*s**n1 the two terms may be exchanged: which order is called n2 is a
    convention.
    """
    values = dict(place.values)
    orders = [n for n in own.names if own.structure.roles[n] == "order"]
    others = [n for n in own.names if own.structure.roles[n] == "coefficient"]
    partners = [(), *combinations(others, 2)]
    for first, second in combinations(orders, 2):
        for partner in partners:
            if values[first] < values[second] and _exchangeable(
                own, (first, second), partner
            ):
                for one, other in ((first, second), partner or (first, first)):
                    values[one], values[other] = values[other], values[one]
    return replace(place, values=values)


def _exchangeable(
    own: StructureProblem, orders: tuple[str, str], others: tuple[str, ...]
) -> bool:
    pairs = [orders, others] if others else [orders]
    if any(own.limits[one] != own.limits[other] for one, other in pairs):
        return False
    values = own.middle()
    swapped = dict(values)
    for one, other in pairs:
        swapped[one], swapped[other] = values[other], values[one]
    here, there = (own.structure.response(x, GENERAL_POINTS) for x in (values, swapped))
    return bool(np.allclose(here, there, rtol=1e-12, atol=0.0))
