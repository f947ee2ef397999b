"""Findings W3xx about a structure's fit, and its gates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from fraclink._identify.findings import likelihood_ratio, rival_finding
from fraclink._identify.problem import CLEARLY_LESS, MOST, QUANTILE, RESOLUTION
from fraclink._identify.structure_certainty import Certainty
from fraclink._identify.structure_data import Lines, Signals
from fraclink._identify.structure_fit import StructureFit
from fraclink._identify.structure_search import Place
from fraclink.findings import Finding, worst_first

# Share of the squared output below which the residual may be smooth: 0.1 % in
# amplitude, the class of good force transducers. Share of noise in the residual's
# standard deviation below which it counts as smooth: no sensor is that quiet.
_RESOLUTION, _SMOOTH = 1e-6, 0.01


def structure_findings(
    fit: StructureFit,
    certain: Certainty,
    places: Sequence[Place],
    data: Signals | Lines,
) -> tuple[Finding, ...]:
    """All findings of a structure's fit at the first of its `places`, worst first."""
    return worst_first(
        [
            *_of_the_parameters(fit, certain),
            *_of_the_error(fit),
            *_of_the_residual(fit, data),
            *_of_rivals(fit, certain, places, data.measured.size),
        ]
    )


def _of_the_parameters(fit: StructureFit, certain: Certainty) -> Iterator[Finding]:
    for name in fit.at_bound:
        low, high = fit.limits[name]
        # A delay that ends at zero is merely not visible.
        yield Finding(
            "W301",
            "warning" if low == 0.0 and fit.parameters[name] < 1e-6 * high else "error",
            f"{name} ended at a bound, which is no estimate; the other intervals only hold with it there",
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
    if not fit.converged:
        yield Finding(
            "W302",
            "error",
            "the search stopped early: the data hardly distinguish the parameters",
            {},
            "excite more of the band, give parameters that are known in fixed, or narrower bounds",
        )


def _of_the_error(fit: StructureFit) -> Iterator[Finding]:
    if fit.nmse > CLEARLY_LESS:
        yield Finding(
            "W313",
            "error",
            "the structure leaves most of the output unexplained",
            {"nmse": fit.nmse, "most": CLEARLY_LESS},
            "check the channels and their units, or take another structure",
        )
    heldout = fit.heldout_nmse or 0.0
    if heldout > min(CLEARLY_LESS, max(fit.nmse / CLEARLY_LESS, RESOLUTION)):
        yield Finding(
            "W318",
            "error" if heldout > CLEARLY_LESS else "warning",
            "the structure predicts the held-out data much worse than the fitted data"
            if heldout * CLEARLY_LESS > fit.nmse
            else "the structure does not predict the held-out data",
            {"heldout_nmse": heldout, "nmse": fit.nmse},
            "look for drift, another operating point, or a structure with fewer parameters",
        )


def _of_the_residual(fit: StructureFit, data: Signals | Lines) -> Iterator[Finding]:
    """A residual that is not noise: the measurement contains more than the structure."""
    if fit.nmse < _RESOLUTION:
        return
    residual = fit.measured - fit.predicted
    if isinstance(data, Lines):
        # A missed resonance shifts neighbouring lines in the same way; their noise has
        # nothing in common.
        errors = residual[: fit.fitted] + 1j * residual[fit.fitted :]
        alike = float(
            np.vdot(errors[1:], errors[:-1]).real / np.vdot(errors, errors).real
        )
        smooth, evidence = alike > MOST, {"alike": alike, "most": MOST}
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
            "the residual is smooth, not noise: the structure misses part of what was measured",
            evidence,
            "take another structure, or give bounds that admit what is missing",
        )


def _of_rivals(
    fit: StructureFit, certain: Certainty, places: Sequence[Place], samples: int
) -> Iterator[Finding]:
    """Other parameters that fit equally well within the accuracy of the data.

    An interval covers one valley of the cost; another valley may be as good by the same
    measure. If the fit is perfect, every rival is perfect too: these are two parameter
    sets for the same function.
    """
    if fit.nmse <= RESOLUTION:
        return
    best, *rivals = places
    for rival in rivals:
        ratio = likelihood_ratio(rival.cost, best.cost, samples, certain.inflation)
        apart = [
            name
            for name, interval in fit.intervals.items()
            if not interval.contains(rival.values[name])
            and not math.isclose(rival.values[name], fit.parameters[name], rel_tol=1e-3)
        ]
        if ratio < QUANTILE**2 and apart:
            yield rival_finding({name: rival.values[name] for name in apart})
            return
