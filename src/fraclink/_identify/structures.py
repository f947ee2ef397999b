"""Any fractional structure, fitted to a recording or to a frequency response."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._arm.recording import FrequencyResponse, Recording, coherence_weights
from fraclink._identify.expression import Expression, parse_expression
from fraclink._identify.fitting import HeldOut, check_motion, fitted_samples
from fraclink._identify.problem import LEAST_EACH
from fraclink._identify.shape import Hold, moving_angle
from fraclink._identify.structure_certainty import certainty_of
from fraclink._identify.structure_data import Lines, Signals
from fraclink._identify.structure_findings import structure_findings
from fraclink._identify.structure_fit import StructureFit
from fraclink._identify.structure_problem import (
    COEFFICIENT_LIMITS,
    ORDER_LIMITS,
    StructureProblem,
    Values,
)
from fraclink._identify.structure_search import Place, best_places, in_order
from fraclink.errors import FieldError
from fracsys._precision import BLUR
from fracsys.checks import Between, Real, checked, checked_choice

Weighting = Literal["relative", "coherence", "magnitude", "absolute"]
Bounds = Mapping[str, tuple[float, float]]

# Wider than any use, and narrow enough for s^order to stay finite in double precision
# over six decades of frequency.
_ADMITTED = {
    "order": Between(-20.0, 20.0, remedy="give finite numbers in this range"),
    "delay": Between(0.0, 1e6, "s", remedy="give finite numbers in this range"),
    "coefficient": Between(-1e15, 1e15, remedy="give finite numbers in this range"),
}


@checked
def identify_structure(
    data: Experiment | Recording | FrequencyResponse,
    expression: str,
    *,
    start: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    hold: Hold = "auto",
    heldout: HeldOut | None = None,
    weighting: Weighting | None = None,
    details: bool = True,
) -> StructureFit:
    """Fit a transfer function that is written as text; no start value is needed.

        y = G(s) u + offset,    G = expression of s and named parameters

    Parameters
    ----------
    data
        a log (motor angle to output, with the angle from before a cut), any two
        channels as a `Recording`, or a `FrequencyResponse`.
    expression
        numbers, names, ``s``, ``+ - * / **`` and ``exp(-T*s)``. A name may occur
        several times; one in an exponent of s is an order, one in ``exp`` a delay, any
        other a coefficient.
    start
        values of all free parameters from which to begin, in addition to the usual
        starts.
    fixed
        values of parameters that are known; ``"offset"`` is the output's constant part.
    bounds
        ranges of parameters. By default orders lie in 0.02 to 4, coefficients of either
        sign are 1e-12 to 1e12 in size, and delays lie in 0 s to the length of the
        record, or to half a turn of the phase from one line to the next.
    hold
        what the input does between samples: "zero", "first", or "auto": "zero" if it
        jumps and rests, else "first".
    heldout
        share of the samples at the end that are predicted and not fitted. By default
        0.4, or a cut that leaves motion in both parts; none if the input never changes.
    weighting
        of a frequency response's errors: "relative" to |H|, by "coherence" (the default
        where there is one), by the input's "magnitude" at each line, or "absolute".
    details
        False: intervals from the standard errors alone, which takes less time.

    Raises
    ------
    FieldError
        an unknown piece in the expression, a name that does not occur in it, too few
        data, an option that does not apply to these data (`heldout` with a frequency
        response).
    NotConvergedError
        no candidate has a response.

    References
    ----------
    Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973) 413.

    Examples
    --------
    >>> import fraclink as fl
    >>> log = fl.read_log(fl.bundled_log("prbs_30g"))
    >>> fit = identify_structure(log, "k*s**a/(s**a + w)*exp(-T*s)", details=False)
    >>> round(fit.parameters["a"], 2), round(fit.parameters["w"] ** 0.5, 1)
    (1.92, 10.8)
    """
    structure = parse_expression(expression)
    values = dict(fixed or {})
    _check_used(data, values, hold, heldout, weighting)
    _check_names(structure, values, bounds or {}, start or {})
    offset = values.pop("offset", math.nan)
    if isinstance(data, FrequencyResponse):
        samples: Signals | Lines = _lines_of(data, weighting)
        # No line of a response shows a constant output.
        offset = 0.0
        # with a longer delay, the phase turns by more than half a turn between two lines
        gap = np.max(np.diff(np.sort(data.frequency)), initial=0.0)
        longest = math.pi / float(gap or data.frequency[0])
        whole, fitted = samples, data.frequency.size
    else:
        record, moved = (
            (data, data.input)
            if isinstance(data, Recording)
            else (Recording.of(data), moving_angle(data))
        )
        # A single step: its end cannot be predicted from its beginning.
        share = 0.0 if heldout is None and np.ptp(record.input) == 0 else heldout
        fitted = fitted_samples(record.input, record.output, share)
        samples, whole = (
            Signals.of(record, hold, count, moved)
            for count in (fitted, record.input.size)
        )
        longest = record.period * fitted
        # With the rest before it: a step at the first sample is a motion.
        check_motion(input=np.append(0.0, samples.input), output=samples.measured)
    problem = _problem(structure, samples, values, bounds or {}, longest, offset)
    _check_start(problem, start, samples.measured.size)
    places = [
        in_order(problem, place) for place in best_places(problem, samples, start)
    ]
    best = places[0]
    # Everything on the fitted part; the held-out part is predicted once and influences
    # nothing.
    certain = certainty_of(problem, best, details=details)
    predicted = best.offset * whole.constant + dataclasses.replace(
        problem, data=whole
    ).output(best.values)
    power = samples.measured - best.offset * samples.constant
    if isinstance(whole, Signals):
        heldout_error = _heldout(whole, fitted, best.offset, predicted)
        place = whole.period * np.arange(whole.measured.size, dtype=np.float64)
        weight = np.ones(1)
    else:
        heldout_error = _lines_held(problem, best)
        # Real parts first, then imaginary parts, each with the weight of its line,
        # which is divided out for plots.
        place = whole.points.imag
        weight = np.tile(whole.weight, 2)
    fit = StructureFit(
        expression=structure.text,
        parameters=best.values,
        fixed=tuple(problem.fixed),
        limits={name: problem.limits[name] for name in problem.names},
        intervals=certain.intervals,
        standard_errors=certain.standard_errors,
        at_bound=certain.at_bound,
        undetermined=certain.undetermined,
        offset=best.offset,
        period=whole.period if isinstance(whole, Signals) else None,
        hold=whole.hold if isinstance(whole, Signals) else None,
        fitted=fitted,
        nmse=best.cost / float(power @ power),
        heldout_nmse=heldout_error,
        place=place,
        measured=whole.measured / weight,
        predicted=predicted / weight,
        converged=best.converged,
        source=data.source,
        sha256=data.sha256,
    )
    return dataclasses.replace(
        fit, findings=structure_findings(fit, certain, places, samples)
    )


def _lines_of(measured: FrequencyResponse, weighting: Weighting | None) -> Lines:
    """Lines in ascending order, with their weights."""
    order = np.argsort(measured.frequency, kind="stable")
    h, coherence = measured.response, measured.coherence
    # A line of zero would have an infinite relative weight, and with any other weight a
    # meaningless phase.
    if not np.all(np.abs(h) > 0):
        raise FieldError(
            "response",
            0,
            "zero at a line",
            "|H| > 0",
            "leave that line out",
        )
    kind = weighting or ("relative" if coherence is None else "coherence")
    weight = {
        "relative": 1.0 / np.abs(h),
        "absolute": np.ones(h.size),
        "magnitude": measured.magnitude,
        "coherence": None if coherence is None else coherence_weights(h, coherence),
    }[kind]
    if weight is None:
        raise FieldError(
            "weighting",
            kind,
            f"without a {kind}",
            f"a response with {kind}",
            "weigh errors as relative",
        )
    # Scaled to a sum of squares of 1: the error is then a share, as used by the gates
    # and limits of the search.
    points = np.asarray(1j * measured.frequency[order])
    return Lines(points, h[order], (weight / np.linalg.norm(weight * h))[order])


def _check_used(
    data: Any, known: Values, hold: Hold, heldout: float | None, weighting: str | None
) -> None:
    """Raise FieldError for an option that does not apply to these data and would be
    ignored.
    """
    of_a_recording: dict[str, object] = {
        "heldout": heldout,
        "hold": None if hold == "auto" else hold,
        "fixed['offset']": known.get("offset"),
    }
    beside, other, options = (
        ("a frequency response", "a recording", of_a_recording)
        if isinstance(data, FrequencyResponse)
        else ("a recording", "a frequency response", {"weighting": weighting})
    )
    for field, value in options.items():
        if value is not None:
            raise FieldError(
                field,
                value,
                f"given beside {beside}",
                f"{other} with it",
                "leave it out",
            )


def _check_names(
    structure: Expression, fixed: Values, bounds: Bounds, start: Values
) -> None:
    # `offset` is the constant of the output and occurs in no formula: it may be fixed,
    # but has neither range nor start.
    for field, given, others in (
        ("fixed", fixed, ("offset",)),
        ("bounds", bounds, ()),
        ("start", start, ()),
    ):
        for name in given:
            checked_choice(
                field,
                name,
                (*structure.names, *others),
                remedy="name a parameter of the expression",
            )
    for name in bounds:
        if name in fixed:
            raise FieldError(
                f"bounds[{name!r}]",
                bounds[name],
                f"given beside fixed[{name!r}]",
                "one of the two",
                "leave one of them out",
            )


def _problem(
    structure: Expression,
    samples: Signals | Lines,
    known: Values,
    bounds: Bounds,
    longest: float,
    offset: float,
) -> StructureProblem:
    usual = {
        "order": ORDER_LIMITS,
        "delay": (0.0, longest),
        "coefficient": COEFFICIENT_LIMITS,
    }
    limits = {name: usual[role] for name, role in structure.roles.items()}
    for name, pair in bounds.items():
        admitted = _ADMITTED[structure.roles[name]]
        low, high = (admitted.check(f"bounds[{name!r}]", value) for value in pair)
        if not low < high:
            raise FieldError(
                f"bounds[{name!r}]",
                pair,
                "empty",
                "low < high",
                "give the lower one first; a known value belongs in fixed",
            )
        limits[name] = (low, high)
    fixed = {
        name: _ADMITTED[structure.roles[name]].check(f"fixed[{name!r}]", value)
        for name, value in known.items()
    }
    problem = StructureProblem(structure, samples, limits, fixed, offset)
    if not problem.names:
        raise FieldError(
            "expression",
            structure.text,
            "without a free parameter",
            ">= 1 free parameter",
            "leave one out of fixed",
        )
    return problem


def _check_start(
    problem: StructureProblem, start: Values | None, measured: int
) -> None:
    least = LEAST_EACH * len(problem.names)
    if measured < least:
        raise FieldError(
            "data",
            measured,
            "too few to fit",
            f">= {least} numbers for {len(problem.names)} parameters",
            "measure more, or fix parameters that are known",
        )
    for name, value in (start or {}).items():
        Between(*problem.limits[name], remedy="begin inside the bounds").check(
            f"start[{name!r}]", value
        )
    missing = {*problem.names} - {*(start or problem.names)}
    if missing:
        raise FieldError(
            "start",
            ", ".join(sorted(missing)),
            "without a parameter that is free",
            ", ".join(problem.names),
            "give all of them, or leave start out",
        )


def _heldout(
    whole: Signals, count: int, offset: float, predicted: Real
) -> float | None:
    """Error over the samples not used for the parameters."""
    # Relative to (output − offset)² as for the fitted part, so that a constant error of
    # the gauge explains nothing.
    error = whole.measured[count:] - predicted[count:]
    power = whole.measured[count:] - offset
    if not np.any(power) or not np.isfinite(error).all():
        return None
    return float(error @ error / (power @ power))


def _lines_held(problem: StructureProblem, best: Place) -> float:
    """Error with which each number of a line is predicted from all others: its residual
    over one minus its leverage (Allen, Technometrics 16 (1974) 125).
    """
    rows, residual = problem.linearised(problem.place_of(best.values))
    leverage = np.sum(np.linalg.qr(rows.T)[0] ** 2, axis=1)
    # A number with a leverage of one is predicted by no other.
    error = residual / np.maximum(1.0 - leverage, BLUR)
    return float(error @ error / problem.power)
