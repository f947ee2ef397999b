"""Uncertainty of the parameters of a structure, and the findings W35x about its fit."""

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

_AT_BOUND = 1e-7  # share of the range of the coordinate
# share in an undetermined direction beyond which a parameter belongs to it
_SHARE = 0.1
# Relative half-width of the interval of a coefficient, and half-width of that of an
# order, beyond which the data do not determine it: a factor of two, and the difference
# between two structures that people would distinguish.
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
    # A parameter at a limit is held there for the others.
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
        # Colour may also reduce the error of an estimate, but the sandwich covariance
        # is too noisy to be trusted there.
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
    # A profile cannot determine a parameter that is undetermined by its standard error,
    # and its valley takes long to follow.
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
    # Share of the range of the coordinate: for 1e-12 to 1e12 it is a factor of 1 +
    # 5e-6.
    near, place = _AT_BOUND * (high - low), float(problem.coordinate(name, value))
    return place <= low + near or place >= high - near


def _blind(jacobian: Reals, names: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters in the directions along which the measured output does not change."""
    size = np.sqrt(np.einsum("qr,qr->q", jacobian, jacobian))
    none = {name for name, own in zip(names, size, strict=False) if own == 0.0}
    scaled = jacobian / np.where(size > 0, size, 1.0)[:, None]
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    # Differences are accurate to 1e-6, which is squared in the normal matrix.
    unseen = vectors[:, values < 1e-11 * len(values)]
    shared = np.abs(unseen).max(axis=1, initial=0.0) > _SHARE
    return tuple(name for k, name in enumerate(names) if name in none or shared[k])


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
        return half <= _ORDER_MOST
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


# share of the squared output: half of it in amplitude, as for the gate of a frequency
# response
_UNEXPLAINED = 0.25
# correlation beyond which a parameter would be known seven times better if the other
# one were given
_CORRELATED = 0.99
# ratio of held-out to fitted error, when both exceed what noise alone leaves
_WORSE = 4.0
# Shares of the squared output: 0.1 % in amplitude, the class of good force transducers;
# and the largest share of noise in a residual that is otherwise smooth, as from a
# simulation: no sensor is that quiet.
_RESOLUTION, _SMOOTH = 1e-6, 0.01
# share of the power of lines that they have in common with their neighbours; 0 for
# noise
_ALIKE = 0.5
_FAR = 700.0  # the largest logarithm of a double
# factor by which a corner may lie outside the excited band, since its slope extends
# into it
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
    """A residual that is not noise: the measurement contains more than the structure."""
    if fit.nmse < _RESOLUTION:
        return
    residual = fit.measured - fit.predicted
    if isinstance(data, Lines):
        # A missed resonance shifts neighbouring lines in the same way; noise does not.
        left = residual[: fit.fitted] + 1j * residual[fit.fitted :]
        alike = float(np.vdot(left[1:], left[:-1]).real / np.vdot(left, left).real)
        smooth, evidence = alike > _ALIKE, {"alike": alike, "most": _ALIKE}
    else:
        rest = residual[: fit.fitted]
        # The second difference of white noise has √6 times its size. The median ignores
        # the samples at which the input jumps; 1.48 times the median is the standard
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
    """Other parameters that fit equally well within the accuracy of the data.

    An interval covers one valley of the cost; another valley may be as good by the same
    measure.
    """
    least = fit.nmse
    for rival in rivals:
        ratio = rival.cost / max(_cost(fit, data), 1e-300)
        # n ln(cost/least) is the likelihood ratio for Gaussian noise, which also
        # defines the intervals.
        told = data.measured.size * math.log(max(ratio, 1.0))
        apart = [
            name
            for name, interval in fit.intervals.items()
            if not interval.contains(rival.values[name])
            and not math.isclose(rival.values[name], fit.parameters[name], rel_tol=1e-3)
        ]
        # If the fit is perfect, every rival is perfect too: these are two parameter
        # sets for the same function.
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
    # A vanished term has no corner frequency; nearly equal orders move it beyond any
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
