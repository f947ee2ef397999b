"""How sure a structure's parameters are, and what a reader of its fit should know:
findings W35x.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink._identify.problem import (
    PERFECT,
    QUANTILE,
    Interval,
    interval_ends,
    inverted,
)
from fraclink._identify.structure_data import Lines, RecordStart
from fraclink._identify.structure_problem import GENERAL_POINTS, StructureProblem
from fraclink._identify.structure_search import Place
from fraclink._identify.uncertainty import sandwich
from fraclink.findings import Finding, worst_first
from fracsys._loops import log_corners

if TYPE_CHECKING:
    from fraclink._identify.structure_fit import StructureFit

__all__ = ["Certainty", "certainty_of", "in_order", "structure_findings"]

Reals = NDArray[np.float64]

_AT_BOUND = 1e-7  # of the range, in the coordinate
_SHARE = 0.1  # of a direction that the data do not see: parameters that take part in it
# Relative half-width of an interval of a coefficient, and half-width of an order's,
# beyond which the data are not said to determine it: a factor of two, and the
# difference between two structures people would tell apart.
_COEFFICIENT_MOST = 0.5
_ORDER_MOST = 0.25


@dataclass(frozen=True, eq=False)
class Certainty:
    """What is known of each parameter; `pairs` are the correlations of all pairs,
    `blind` what is not seen.

    `blind` are the parameters of directions in which nothing that was measured changes;
    `inflation` is the largest factor by which the residual's colour widens a variance.
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
    """Standard errors that allow for the residual's colour; profile intervals where
    `details` are wanted.
    """
    every = replace(searched, projected=False)
    stuck = tuple(
        name for name in every.names if _is_at_bound(every, name, best.values[name])
    )
    # What is stuck stays there, as the other parameters have it.
    known = {**every.fixed, **{name: best.values[name] for name in stuck}}
    problem = replace(every, fixed=known)
    free, data = problem.names, problem.data
    if not free:
        return Certainty({}, {}, stuck, (), (), {})
    place = problem.places_of(best.values)[0]
    rows, residual = problem.linearised(place)
    inverse, _ = inverted(rows @ rows.T)
    blind = _blind(rows, free)
    variance = best.cost / max(data.measured.size - len(rows), 1)
    white = variance * np.diag(inverse)
    wide = white
    perfect = best.cost <= PERFECT * problem.power
    if not perfect:
        # Colour may also narrow an estimate, but the sandwich is too noisy to be
        # believed there.
        wide = np.maximum(
            np.diag(
                sandwich(
                    inverse,
                    rows,
                    residual,
                    variance,
                    are_lines=isinstance(data, Lines),
                )[0]
            ),
            white,
        )
    size = np.sqrt(np.diag(inverse))
    related = inverse / np.outer(size, size)
    inflation = np.where(white > 0, wide / np.maximum(white, 1e-300), 1.0)
    intervals = {
        name: _straight_interval(
            problem,
            name,
            float(place[k]),
            QUANTILE * float(wide[k]) ** 0.5,
            best.values[name],
        )
        for k, name in enumerate(free)
        if name not in blind
    }
    # What the standard error says is unknown no profile makes known, and its valley is
    # long to follow.
    wanted = [
        k
        for k, name in enumerate(free)
        if name in intervals
        and _is_known(problem, name, best.values[name], intervals[name])
    ]
    if details and best.converged and not perfect and wanted:
        unit = np.eye(place.size)[wanted]
        ends = interval_ends(
            problem,
            place,
            best.cost,
            lambda x: (x[:, wanted], np.repeat(unit[None], len(x), axis=0)),
            inflation[wanted],
        )
        for k, end in zip(wanted, ends, strict=True):
            intervals[free[k]] = _in_values(problem, free[k], end, best.values[free[k]])
    errors = {
        name: float(wide[k]) ** 0.5
        * (abs(best.values[name]) if problem.is_logarithmic(name) else 1.0)
        for k, name in enumerate(free)
        if name in intervals
    }
    undetermined = tuple(
        name
        for name in free
        if name in blind
        or not _is_known(problem, name, best.values[name], intervals[name])
    )
    pairs = {
        (free[i], free[j]): float(related[i, j])
        for i, j in combinations(range(len(free)), 2)
    }
    widest = max((float(inflation[free.index(n)]) for n in intervals), default=1.0)
    return Certainty(intervals, errors, stuck, undetermined, blind, pairs, widest)


def _is_at_bound(problem: StructureProblem, name: str, value: float) -> bool:
    low, high = problem.box_of(name)
    # Of the range in the coordinate: of 1e-12 to 1e12 that is a factor of 1 + 5e-6.
    near, place = _AT_BOUND * (high - low), float(problem.coordinate(name, value))
    return place <= low + near or place >= high - near


def _blind(jacobian: Reals, names: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters of the directions in which nothing that was measured changes."""
    size = np.sqrt(np.einsum("qr,qr->q", jacobian, jacobian))
    none = {name for name, own in zip(names, size, strict=False) if own == 0.0}
    scaled = jacobian / np.where(size > 0, size, 1.0)[:, None]
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    # Differences are right to 1e-6, and squared in the normal matrix.
    unseen = vectors[:, values < 1e-11 * len(values)]
    shared = np.abs(unseen).max(axis=1, initial=0.0) > _SHARE
    return tuple(name for k, name in enumerate(names) if name in none or shared[k])


def _is_known(
    problem: StructureProblem, name: str, value: float, interval: Interval
) -> bool:
    """Whether an interval says something: closed, and narrower than what people would
    call an order apart.
    """
    role = problem.structure.roles[name]
    if interval.high_open or (interval.low_open and role != "delay"):
        return False
    # A delay of zero is the usual answer, and its interval begins at that limit: only
    # its open end counts against it.
    half = (interval.high - interval.low) / 2
    if role == "order":
        return half <= _ORDER_MOST
    return role == "delay" or half <= _COEFFICIENT_MOST * abs(value)


def _straight_interval(
    problem: StructureProblem, name: str, centre: float, reach: float, value: float
) -> Interval:
    """The interval of a cost that is a parabola in the coordinate."""
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
    if low > high:  # of a negative coefficient the larger size is the lower end
        return Interval(high, low, ends.high_open, ends.low_open)
    return Interval(low, high, ends.low_open, ends.high_open)


# --- exchangeable terms -------------------------------------------------------------------------------------


def in_order(own: StructureProblem, place: Place) -> Place:
    """The place with the orders of exchangeable terms falling in the order of the text.

    In a2*s**n2 + a1*s**n1 the two terms may change names: which is called n2 is a
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


# of the squared output: half of it in amplitude, as the gate of a frequency response
_UNEXPLAINED = 0.25
_CORRELATED = (
    0.99  # beyond, a parameter is known seven times better where the other one is given
)
_WORSE = 4.0  # held-out error over fitted error, both beyond what noise alone leaves
# Of the squared output: 0.1 % in amplitude, the class of good force transducers; and
# the part of a residual that may be noise where all else is smooth, as of a simulation:
# no sensor is that quiet.
_RESOLUTION, _SMOOTH = 1e-6, 0.01
_ALIKE = 0.5  # of the power of what lines leave with their neighbours, of noise 0
_FAR = 700.0  # the largest logarithm of a double
# a corner may lie outside of the excited band by that factor: its slope reaches in
_BEYOND = 3.0


def structure_findings(
    fit: StructureFit,
    certain: Certainty,
    rivals: Sequence[Place],
    data: RecordStart | Lines,
) -> tuple[Finding, ...]:
    """All findings, worst first."""
    found = [
        *_of_the_parameters(fit, certain),
        *_of_the_error(fit),
        *_of_the_residual(fit, data),
        *_of_rivals(fit, certain, rivals, data),
    ]
    found += _of_the_band(fit, data)
    return worst_first(found)


def _of_the_parameters(fit: StructureFit, certain: Certainty) -> Iterator[Finding]:
    for name in fit.at_bound:
        low, high = fit.limits[name]
        nothing = (
            fit.limits[name][0] == 0.0 and fit.parameters[name] < 1e-6 * high
        )  # no delay is seen
        yield Finding(
            "W301",
            "warning" if nothing else "error",
            f"{name} ended at a bound, which is no estimate; other intervals hold with it there only",
            {"value": fit.parameters[name], "low": low, "high": high},
            "leave the term out if it vanished; else widen bounds, or check the sign of a channel",
        )
    if certain.blind:
        yield Finding(
            "W354",
            "error",
            f"the data see {', '.join(certain.blind)} only in combination, however precise they are",
            {name: fit.parameters[name] for name in certain.blind},
            "give one of them in fixed, or write the structure with fewer parameters",
        )
    for name in fit.undetermined:
        if name not in certain.blind:
            interval = fit.intervals[name]
            yield Finding(
                "W303",
                "error",
                f"the data do not determine {name}",
                {
                    "value": fit.parameters[name],
                    "low": interval.low,
                    "high": interval.high,
                },
                "excite more of the band, record longer, or give a parameter that is known in fixed",
            )
    for (one, other), related in certain.pairs.items():
        if abs(related) > _CORRELATED and not {one, other} & set(certain.blind):
            yield Finding(
                "W354",
                "warning",
                f"{one} and {other} can be traded for each other",
                {"correlation": related},
                "their intervals already show it; if one is known, give it in fixed",
            )

    if not fit.converged:
        yield Finding(
            "W302",
            "error",
            "the search stopped early: the data hardly distinguish the parameters",
            {"evaluations": float(fit.evaluations)},
            "excite more of the band, give parameters that are known in fixed, or narrower bounds",
        )


def _of_the_error(fit: StructureFit) -> Iterator[Finding]:
    if fit.nmse > _UNEXPLAINED:
        yield Finding(
            "W313",
            "error",
            "the structure leaves most of the output unexplained",
            {"nmse": fit.nmse, "most": _UNEXPLAINED},
            "check the channels and their units, or take another structure",
        )
    held = fit.heldout_nmse
    if held is not None and held > max(_WORSE * fit.nmse, 1e-12):
        yield Finding(
            "W318",
            "error" if held > _UNEXPLAINED else "warning",
            "the structure predicts the held-out data worse than the data it was fitted to",
            {"heldout_nmse": held, "nmse": fit.nmse},
            "look for drift, another operating point, or a structure with fewer parameters",
        )


def _of_the_residual(fit: StructureFit, data: RecordStart | Lines) -> Iterator[Finding]:
    """A residual that is no noise: what was measured holds more than the structure."""
    if fit.nmse < _RESOLUTION:
        return
    residual = fit.measured - fit.predicted
    if isinstance(data, Lines):
        # A resonance that is missed moves neighbouring lines alike; noise does not.
        left = residual[: fit.fitted] + 1j * residual[fit.fitted :]
        alike = float(np.vdot(left[1:], left[:-1]).real / np.vdot(left, left).real)
        smooth, evidence = alike > _ALIKE, {"alike": alike, "most": _ALIKE}
    else:
        rest = residual[: fit.fitted]
        # The second difference of white noise has √6 times its size; the median leaves
        # out the samples at which the input jumps, 1.48 times it is the standard
        # deviation.
        noise = 1.4826 / math.sqrt(6.0) * float(np.median(np.abs(np.diff(rest, 2))))
        size = float(np.std(rest))
        smooth, evidence = noise < _SMOOTH * size, {"noise": noise, "residual": size}
    if smooth:
        yield Finding(
            "W310",
            "error",
            "what the structure leaves is smooth, not noise: the structure misses part of what was measured",
            evidence,
            "take another structure, or give bounds that admit what is missing",
        )


def _of_rivals(
    fit: StructureFit,
    certain: Certainty,
    rivals: Sequence[Place],
    data: RecordStart | Lines,
) -> Iterator[Finding]:
    """Other parameters that fit as well as the data can tell, and are not the same.

    An interval follows one valley of the cost; another valley is as good by the same
    measure.
    """
    least = fit.nmse
    for rival in rivals:
        ratio = rival.cost / max(_cost(fit, data), 1e-300)
        # n ln(cost/least) is the likelihood ratio of Gaussian noise, as the intervals
        # are cut by.
        told = data.measured.size * math.log(max(ratio, 1.0))
        apart = [
            name
            for name, interval in fit.intervals.items()
            if not interval.contains(rival.values[name])
            and not math.isclose(rival.values[name], fit.parameters[name], rel_tol=1e-3)
        ]
        # Where the fit is perfect every rival is as perfect: two names for one
        # function, which are no two answers.
        if told < QUANTILE**2 * certain.inflation and apart and least > 1e-12:
            values = {name: rival.values[name] for name in apart}
            yield Finding(
                "W357",
                "error",
                "other parameters fit as well as the data can tell",
                values,
                "give bounds that exclude them, or excite more of the band",
            )
            return


def _cost(fit: StructureFit, data: RecordStart | Lines) -> float:
    power = data.measured - (fit.offset if isinstance(data, RecordStart) else 0.0)
    return fit.nmse * float(power @ power)


def _of_the_band(fit: StructureFit, data: RecordStart | Lines) -> Iterator[Finding]:
    low, high = data.band
    G = fit.transfer_function
    # A term that vanished has no corner; orders that nearly agree put it beyond any
    # number.
    terms = () if fit.at_bound else (G.numerator, G.denominator)
    logs = [corner for part in terms for corner in log_corners(part)]
    corners = {float(f"{math.exp(min(x, _FAR)):.6g}") for x in logs}
    for corner in sorted(corners):
        if not low / _BEYOND <= corner <= high * _BEYOND:
            yield Finding(
                "W315",
                "warning",
                "a corner of the structure lies outside the band that was excited",
                {"corner": corner, "low": low, "high": high},
                "excite that frequency: beyond the band the structure is a guess",
            )
