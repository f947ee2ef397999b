"""Uncertainty of the parameters of a structure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from fraclink._identify.problem import (
    ORDER_MOST,
    QUANTILE,
    RESOLUTION,
    Interval,
    at_limits,
    interval_ends,
)
from fraclink._identify.structure_data import Lines
from fraclink._identify.structure_problem import StructureProblem
from fraclink._identify.structure_search import Place
from fraclink._identify.uncertainty import Covariance

# share of a parameter in an undetermined direction that makes it undetermined
_SHARE = 0.1
# Relative half-width of the interval of a coefficient beyond which the data do not
# determine it: a factor of two.
_COEFFICIENT_MOST = 0.5


@dataclass(frozen=True, eq=False)
class Certainty:
    """The uncertainty of each parameter.

    `blind` are the parameters in directions along which the measured output does not
    change; `inflation` is the largest factor by which the residual's colour widens a
    variance.
    """

    intervals: Mapping[str, Interval]
    standard_errors: Mapping[str, float]
    at_bound: tuple[str, ...]
    undetermined: tuple[str, ...]
    blind: tuple[str, ...]
    inflation: float = 1.0


def certainty_of(
    searched: StructureProblem, best: Place, *, details: bool
) -> Certainty:
    """Standard errors that account for the residual's colour; profile intervals with
    `details`.
    """
    values, place = best.values, searched.place_of(best.values)
    ended = at_limits(place, *searched.box)
    stuck = tuple(compress(searched.names, ended))
    # The other parameters are judged with these held at their limits.
    held = {name: values[name] for name in stuck}
    problem = replace(searched, fixed={**searched.fixed, **held})
    if not problem.names:
        return Certainty({}, {}, stuck, (), ())
    names, place = problem.names, place[~ended]
    rows, residual = problem.linearised(place)
    perfect = best.cost <= RESOLUTION * problem.power
    covariance = Covariance.of(
        (*names, "offset")[: len(rows)], rows @ rows.T, best.cost, residual.size
    )
    if not perfect:
        covariance = (
            covariance.of_lines(rows, residual)
            if isinstance(problem.data, Lines)
            else covariance.coloured(rows, residual)
        )
    shares = np.abs(covariance.unseen).max(axis=1, initial=0.0)
    blind = tuple(compress(names, shares > _SHARE))  # the offset comes last
    # Exact for a cost that is quadratic in the coordinates.
    reach = QUANTILE * np.array([covariance.errors[name] for name in names])
    bounded = zip(names, place - reach, place + reach, *problem.box, strict=True)
    intervals = {
        name: _in_values(
            problem,
            name,
            Interval(max(below, low), min(above, high), below <= low, above >= high),
        )
        for name, below, above, low, high in bounded
        if name not in blind
    }
    # Where the standard error leaves a parameter undetermined, so does its profile, and
    # that valley takes long to follow.
    indices = [
        k
        for k, name in enumerate(names)
        if name in intervals and _is_known(problem, name, values[name], intervals[name])
    ]
    if details and best.converged and not perfect and indices:
        unit = np.eye(place.size)[indices]
        ends = interval_ends(
            problem,
            place,
            best.cost,
            lambda x: (x[:, indices], np.repeat(unit[None], len(x), axis=0)),
            np.array([covariance.inflation[names[k]] for k in indices]),
        )
        for k, end in zip(indices, ends, strict=True):
            intervals[names[k]] = _in_values(problem, names[k], end)
    undetermined = tuple(
        name
        for name in names
        if name in blind or not _is_known(problem, name, values[name], intervals[name])
    )
    widest = max((covariance.inflation[name] for name in intervals), default=1.0)
    standard_errors = {
        name: covariance.errors[name] * float(problem.slope(name, values[name]))
        for name in intervals
    }
    return Certainty(intervals, standard_errors, stuck, undetermined, blind, widest)


def _is_known(
    problem: StructureProblem, name: str, value: float, interval: Interval
) -> bool:
    """Whether an interval is informative: closed, and narrow enough (see
    `_COEFFICIENT_MOST`).
    """
    role = problem.structure.roles[name]
    # A delay of zero is the usual result, and its interval begins at that limit: only
    # the upper end has to be closed.
    is_open = interval.high_open or (interval.low_open and role != "delay")
    most = {
        "order": ORDER_MOST,
        "delay": math.inf,
        "coefficient": _COEFFICIENT_MOST * abs(value),
    }
    return not is_open and (interval.high - interval.low) / 2 <= most[role]


def _in_values(problem: StructureProblem, name: str, ends: Interval) -> Interval:
    """The interval of a parameter from that of its coordinate."""
    low, high = (float(problem.value(name, x)) for x in (ends.low, ends.high))
    return replace(ends, low=low, high=high)
