"""What a reader of a structure's fit should know: findings W35x."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

from fraclink._identify.intervals import QUANTILE
from fraclink._identify.structure_certainty import Certainty
from fraclink._identify.structure_data import Lines, RecordStart
from fraclink._identify.structure_search import Place
from fraclink._systems.terms import Term
from fraclink.findings import Finding

if TYPE_CHECKING:
    from fraclink._identify.structure_fit import StructureFit

__all__ = ["structure_findings"]

_UNEXPLAINED = 0.25  # of the squared output: half of it in amplitude, as the gate of a frequency response
_CORRELATED = 0.99  # beyond, a parameter is known seven times better where the other one is given
_WORSE = 4.0  # held-out error over fitted error, both beyond what noise alone leaves
_FAR = 200.0  # of the logarithm of a corner: orders that nearly agree put it beyond any number
_BEYOND = 3.0  # a corner may lie outside of the excited band by that factor: its slope reaches in


def structure_findings(
    fit: StructureFit, certain: Certainty, rivals: Sequence[Place], data: RecordStart | Lines
) -> tuple[Finding, ...]:
    """All findings, worst first."""
    rank = {"error": 0, "warning": 1, "info": 2}
    found = [*_of_the_parameters(fit, certain), *_of_the_error(fit), *_of_rivals(fit, rivals, data)]
    found += _of_the_band(fit, data)
    return tuple(sorted(found, key=lambda finding: rank[finding.severity]))


def _of_the_parameters(fit: StructureFit, certain: Certainty) -> Iterator[Finding]:
    for name in fit.at_bound:
        low, high = fit.limits[name]
        nothing = fit.limits[name][0] == 0.0 and fit.parameters[name] < 1e-6 * high  # no delay is seen
        yield Finding(
            "W351",
            "warning" if nothing else "error",
            f"{name} ended at a bound, which is no estimate; other intervals hold with it there only",
            {"value": fit.parameters[name], "low": low, "high": high},
            "leave the term out if it vanished; else widen bounds, or check the sign of a channel",
        )
    if certain.blind:
        yield Finding(
            "W352",
            "error",
            f"the data see {', '.join(certain.blind)} together only, no matter how precise they are",
            {name: fit.parameters[name] for name in certain.blind},
            "give one of them in fixed, or write the structure with fewer parameters",
        )
    for name in fit.undetermined:
        if name not in certain.blind:
            interval = fit.intervals[name]
            yield Finding(
                "W353",
                "error",
                f"the data do not determine {name}",
                {"value": fit.parameters[name], "low": interval.low, "high": interval.high},
                "excite more of the band, record longer, or give a parameter that is known in fixed",
            )
    for (one, other), related in certain.pairs.items():
        if abs(related) > _CORRELATED and not {one, other} & set(certain.blind):
            yield Finding(
                "W354",
                "warning",
                f"{one} and {other} trade against each other",
                {"correlation": related},
                "their intervals say so already; one that is known belongs into fixed",
            )

    if not fit.converged:
        yield Finding(
            "W359",
            "error",
            "the descent stopped short: the data hardly tell the parameters apart",
            {"evaluations": float(fit.evaluations)},
            "excite more of the band, give parameters that are known in fixed, or narrower bounds",
        )


def _of_the_error(fit: StructureFit) -> Iterator[Finding]:
    if fit.nmse > _UNEXPLAINED:
        yield Finding(
            "W355",
            "error",
            "the structure leaves most of the output unexplained",
            {"nmse": fit.nmse, "most": _UNEXPLAINED},
            "check the channels and their units, or take another structure",
        )
    held = fit.heldout_nmse
    if held is not None and held > max(_WORSE * fit.nmse, 1e-12):
        yield Finding(
            "W356",
            "error" if held > _UNEXPLAINED else "warning",
            "the structure predicts what it has not seen worse than what it was fitted to",
            {"heldout_nmse": held, "nmse": fit.nmse},
            "look for drift, another operating point, or a structure with fewer parameters",
        )


def _of_rivals(fit: StructureFit, rivals: Sequence[Place], data: RecordStart | Lines) -> Iterator[Finding]:
    """Other parameters that fit as well as the data can tell, and are not the same."""
    least = fit.nmse
    for rival in rivals:
        ratio = rival.cost / max(_cost(fit, data), 1e-300)
        told = data.measured.size * math.log(max(ratio, 1.0))
        apart = [
            name
            for name, interval in fit.intervals.items()
            if not interval.contains(rival.values[name])
            and not math.isclose(rival.values[name], fit.parameters[name], rel_tol=1e-3)
        ]
        if told < QUANTILE**2 and apart and least > 1e-12:
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
    corners = sorted({float(f"{w:.6g}") for terms in (G.numerator, G.denominator) for w in _corners(terms)})
    for corner in corners if not fit.at_bound else ():  # a term that vanished has no corner
        if not low / _BEYOND <= corner <= high * _BEYOND:
            yield Finding(
                "W358",
                "warning",
                "a corner of the structure lies outside of the band that was excited",
                {"corner": corner, "low": low, "high": high},
                "excite that frequency: beyond the band the structure is a guess",
            )


def _corners(terms: Sequence[Term]) -> list[float]:
    """Frequencies [rad/s] at which neighbouring terms are equal: corners of the magnitude's asymptotes."""
    rows = sorted((t.order, math.log(abs(t.coefficient))) for t in terms)
    hull: list[tuple[float, float]] = []
    for x, y in rows:
        while len(hull) > 1:
            (x1, y1), (x2, y2) = hull[-2:]
            if (y2 - y1) * (x - x1) > (y - y1) * (x2 - x1):
                break
            hull.pop()
        hull.append((x, y))
    logs = [(y1 - y2) / (x2 - x1) for (x1, y1), (x2, y2) in pairwise(hull) if x2 > x1]
    return [math.exp(min(max(log, -_FAR), _FAR)) for log in logs]
