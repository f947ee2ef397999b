"""Time responses from rest: `time_response`, `step_response`, `impulse_response`,
`discrete_modes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike

from fracsys._contour import (
    OVERSAMPLING,
    WINDOW,
    convolve,
    delay_free_part,
    feedthrough,
    invert,
)
from fracsys._fractional import FractionalTransferFunction
from fracsys._held import HeldQuotient, Part
from fracsys._modes import TOLERANCE, DiscreteModes
from fracsys._quotient import Quotient, singular_order
from fracsys._terms import BYTES, Term, grid, largest, refuse_beyond_memory
from fracsys.checks import Array, Between, Positive, Real, checked
from fracsys.checks.equality import compared
from fracsys.errors import FieldError, NotConvergedError, required

Signal = Annotated[ArrayLike, Array(1, flags=True)]
Times = Annotated[ArrayLike, Array(1, min_size=1), Between(0.0, unit="s")]
# Squares of periods and of spans, and their quotients, stay within doubles.
SamplePeriod = Annotated[float, Between(1e-12, 1e12, "s")]
Hold = Literal["zero", "first"]

_METHODS = ("modes", "contour", "fft")  # from the most to the least direct


@compared
@dataclass(frozen=True, eq=False)
class TimeResponse:
    """A response from rest at equally spaced samples (or at the times asked for).

    `time` [s] and `output` are read-only arrays of the same length. `method` is "modes"
    (exact sum of exponentials), "contour" (one contour integral per lag, where modes
    would cancel) or "fft" (numerical inversion). `error_estimate` is an estimate of the
    largest error of `output`, from an independent evaluation at a few times. `modes`
    counts the exponentials, a pair as two; `period` [s] and `hold` are those of the
    request.
    """

    time: Real
    output: Real
    method: str
    error_estimate: float
    modes: int
    period: float | None
    hold: str

    def __post_init__(self) -> None:
        self.time.flags.writeable = False
        self.output.flags.writeable = False

    def __repr__(self) -> str:
        last = f" to {self.time[-1]:.6g} s" if len(self.time) else ""
        summary = f"{len(self.time)} samples{last}, {self.method}, error {self.error_estimate:.1g}"
        return f"TimeResponse({summary})"


@checked
def time_response(
    G: FractionalTransferFunction,
    u: Signal,
    period: SamplePeriod,
    *,
    hold: Hold = "zero",
) -> TimeResponse:
    """Return the output of G for the sampled input u, from rest, exact at the samples
    for a held input.

    y(t) = ∫₀ᵗ g(t-τ) u(τ) dτ with u held between samples: constant (`hold="zero"`, a
    D/A converter) or straight (`"first"`, starting with a jump from 0 to u[0]). Before
    the first sample everything is at rest.

    Parameters
    ----------
    G
        Proper; integrators, unstable poles and delays are allowed.
    u
        Input at k·period, k = 0 … N-1, shape (N,). y[k] contains the jump of a direct
        feedthrough at k.
    period
        Sampling period, 1e-12 … 1e12 s.
    hold
        Movement of the input between samples.

    Raises
    ------
    FieldError
        Improper G, input that is not a finite vector, period or hold out of range, an
        unstable pole whose response leaves the range of doubles within the span.
    SizeError
        N beyond the machine's memory, refused before anything is allocated.

    Notes
    -----
    Method and error estimate: docs/explanation/numerics.md. Cost O(N · modes), state
    O(modes).

    Examples
    --------
    >>> from fracsys._fractional import s
    >>> result = time_response(1 / (s + 1), [1.0, 1.0, 1.0], 1.0)
    >>> result.output.round(6), result.method
    (array([0.      , 0.632121, 0.864665]), 'modes')
    """
    values = np.ascontiguousarray(u, np.float64)
    refuse_beyond_memory("u", len(values))
    if hold == "first" and len(values) and values[0]:
        # The jump to the first sample is added as a step, since a first-order hold
        # starts at 0.
        jump = time_response(G, np.full(len(values), values[0]), period)
        lines = time_response(G, values - values[0], period, hold=hold)
        return _added(jump.time, [jump, lines], period, hold)
    if any(t.delay for t in G.denominator):
        return _by_inversion(G, delay_free_part(G), values, period, hold)
    try:
        parts = [
            held_quotient(top, G.denominator).respond(
                values, period, hold=hold, tolerance=TOLERANCE, delay=delay
            )
            for delay, top in delay_groups(G).items()
        ]
    except (
        NotConvergedError
    ):  # the poles cannot be certified: zeros of high multiplicity
        return _by_inversion(G, feedthrough(G), values, period, hold)
    return _added(grid(len(values), period), parts, period, hold)


@checked
def step_response(
    G: FractionalTransferFunction,
    time: Positive | Times,
    period: Positive | None = None,
) -> TimeResponse:
    """Return the response of G to a unit step at t = 0, from rest.

    Parameters
    ----------
    G
        As for `time_response`.
    time
        Duration [s], with `period`; or times ≥ 0 [s] in any spacing, shape (N,). At t =
        0 the value is the one after the jump.
    period
        Sampling period [s], if `time` is a duration.

    Examples
    --------
    >>> from fracsys._fractional import s
    >>> float(step_response(1 / s**0.5, [0.0, 1.0]).output[1].round(12))  # 2 sqrt(t/π)
    1.128379167096
    """
    return _fixed(G, time, period, 1)


@checked
def impulse_response(
    G: FractionalTransferFunction,
    time: Positive | Times,
    period: Positive | None = None,
) -> TimeResponse:
    """Return the response of G to a unit impulse at t = 0, from rest; arguments as for
    `step_response`.

    A direct feedthrough D adds an impulse D·δ(t), which no sample shows. At t = 0 the
    value is the limit from the right; it is infinite where the relative degree is below
    1.

    Examples
    --------
    >>> from fracsys._fractional import s
    >>> impulse_response(1 / (s + 1), [0.0, 1.0]).output.round(6)
    array([1.      , 0.367879])
    """
    return _fixed(G, time, period, 0)


@checked
def discrete_modes(
    G: FractionalTransferFunction,
    period: SamplePeriod,
    *,
    hold: Hold = "zero",
    span: Annotated[float, Between(0.0, 1e15, "s")],
    tolerance: Annotated[float, Between(1e-14, 1e-2)] = TOLERANCE,
) -> DiscreteModes:
    """Return the exact held response of G at `period` as a sum of exponential modes.

    Parameters
    ----------
    G
        Proper, without delays in the denominator; the numerator's terms share one
        delay.
    period
        Sampling period T, 1e-12 … 1e12 s.
    hold
        How the input moves between samples.
    span
        Longest time [s] over which the response is remembered, T … 1e15 s.
    tolerance
        Error of the step response relative to its peak, 1e-14 … 1e-2, checked at nine
        times of the span; between them it may be up to six times as large. A larger
        tolerance takes fewer modes.

    Raises
    ------
    FieldError
        Improper G, several delays, a denominator with delays, singular powers s^-a with
        a ≥ 0.94 other than the integrator 1/s (use `time_response`, which convolves
        them), values out of range.

    Notes
    -----
    Branch-cut integral by a pole-corrected trapezoid rule; see
    docs/explanation/numerics.md.

    Examples
    --------
    >>> from fracsys._fractional import s
    >>> modes = discrete_modes(1 / (s + 1), 0.1, span=10.0)
    >>> modes.decays, modes.gains
    (array([0.90483742]), array([0.09516258]))
    """
    Between(
        period, 1e15, "s", remedy="the response is remembered for one period at least"
    ).check("span", span)
    groups = delay_groups(G)
    if len(groups) > 1:
        raise FieldError(
            "delay",
            sorted(groups),
            "several in the numerator",
            "one delay common to all terms",
            "take the parts one by one, or use time_response",
        )
    delay, top = next(iter(groups.items()), (0.0, ()))
    quotient = held_quotient(top, G.denominator)
    if not quotient.has_modes:
        order = singular_order(top, G.denominator)
        raise FieldError(
            "order",
            order,
            "a power of 1/s without a sum of modes",
            "singular powers s^-a with a < 0.94, and the integrator 1/s",
            "use time_response",
        )
    return quotient.modes(
        period, hold=hold, span=span, tolerance=tolerance, delay=delay
    )


def _instants(time: object, period: float | None) -> Real:
    """The times, given as a duration and a period or as an array."""
    if isinstance(time, float):
        period = required(
            "period",
            period,
            "> 0 s",
            "give the period of the samples, or an array of times",
        )
        refuse_beyond_memory("time", time / period)
        # 0.3/0.1 is 2.9999999999999996; the last sample would be missing.
        return grid(int(time / period * (1.0 + 1e-12)) + 1, period)
    if period is not None:
        raise FieldError(
            "period",
            period,
            "given beside an array of times",
            "a duration and a period, or times alone",
            "leave the period out",
        )
    return np.array(time, np.float64)


def _fixed(
    G: FractionalTransferFunction, time: object, period: float | None, degree: int
) -> TimeResponse:
    """The response to an impulse (degree 0) or a step (1)."""
    times = _instants(time, period)
    if any(t.delay for t in G.denominator):
        if period is None or degree == 0:
            raise FieldError(
                "time",
                "an array of times" if period is None else "an impulse",
                "not available with delays in the denominator",
                "step responses given by a duration and a period",
                "give a duration and a period; the impulse response is the step response of s·G",
            )
        return time_response(G, np.ones(len(times)), period)
    parts = []
    try:
        for delay, top in delay_groups(G).items():
            late = times - delay
            # A sample on the jump itself counts as after it, even where k·period -
            # delay rounds below 0.
            late[np.abs(late) <= 1e-12 * max(1.0, delay)] = 0.0
            quotient = held_quotient(top, G.denominator)
            parts.append(quotient.at(late) if degree else quotient.impulse(late))
    except NotConvergedError:
        # The inversion needs a grid, not single times, and an impulse has no samples to
        # take differences of.
        if period is None or degree == 0:
            raise
        return time_response(G, np.ones(len(times)), period)
    return _added(times, parts, period, "zero" if degree else "impulse")


def _added(
    time: Real,
    parts: Sequence[Part | TimeResponse],
    period: float | None,
    hold: str,
) -> TimeResponse:
    """The sum of responses; the method of the result is the least direct of its parts."""
    output = np.zeros(len(time))
    for part in parts:
        output += part.output
    method = max((p.method for p in parts), key=_METHODS.index, default="modes")
    error = sum(p.error_estimate for p in parts)
    modes = max((p.modes for p in parts), default=0)
    return TimeResponse(time, output, method, error, modes, period, hold)


def _by_inversion(
    G: FractionalTransferFunction,
    exact: FractionalTransferFunction,
    u: Real,
    period: float,
    hold: Hold,
) -> TimeResponse:
    """The exact response of `exact` plus the numerically inverted rest."""
    refuse_beyond_memory("u", len(u), WINDOW * OVERSAMPLING * BYTES)
    base = time_response(exact, u, period, hold=hold)
    if not len(u):
        return base
    degree = 1 if hold == "zero" else 2
    # One extra sample: the weights of a first-order hold look one period ahead.
    rest, error = invert(G, exact, len(u) + 1, period, degree)
    weights = np.diff(rest, prepend=0.0)
    if degree == 2:
        weights, error = np.diff(weights) / period, error / period
    output = base.output + convolve(weights[: len(u)], u)
    estimate = base.error_estimate + 4.0 * error * largest(u)
    return TimeResponse(base.time, output, "fft", estimate, base.modes, period, hold)


@lru_cache(maxsize=64)
def held_quotient(top: tuple[Term, ...], bottom: tuple[Term, ...]) -> HeldQuotient:
    """The poles and the low-frequency part of N/D, cached for the next period, hold or
    input.
    """
    return HeldQuotient.of(Quotient.of(top, bottom))


def delay_groups(G: FractionalTransferFunction) -> dict[float, tuple[Term, ...]]:
    """The numerator's terms by delay [s]; raises for an improper G or delays in the
    denominator.
    """
    if not G.is_proper:
        raise FieldError(
            "relative_degree",
            G.relative_degree,
            "negative: the system is improper",
            ">= 0",
            "add a filter: a time response of a derivative of a step does not exist",
        )
    if any(t.delay for t in G.denominator):
        longest, remedy = (
            max(t.delay for t in G.denominator),
            "use time_response, which inverts numerically",
        )
        raise FieldError(
            "delay",
            longest,
            "in the denominator",
            "delays in the numerator",
            remedy,
        )
    groups: dict[float, tuple[Term, ...]] = {}
    for t in G.numerator:
        groups[t.delay] = (*groups.get(t.delay, ()), Term(t.coefficient, t.order))
    return groups
