"""Time responses from rest: the verbs `time_response`, `step_response` and `impulse_response`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.fractional.checks import checked_system
from fraclink._systems.response.checks import (
    FFT_BYTES,
    grid,
    instants,
    largest,
    positive,
    refuse_beyond_memory,
    samples,
)
from fraclink._systems.response.discrete import check_request, delay_groups, held_quotient
from fraclink._systems.response.held import Part
from fraclink._systems.response.inversion import delay_free_part, feedthrough, invert
from fraclink._systems.response.powers import convolve
from fraclink.errors import FieldError, NotConvergedError

__all__ = ["TimeResponse", "impulse_response", "step_response", "time_response"]

Reals = NDArray[np.float64]
TOLERANCE = 1e-12
_METHODS = ("modes", "modes+convolution", "contour")


@dataclass(frozen=True)
class TimeResponse:
    """A response from rest at equally spaced samples (or at the times asked for).

    `time` [s] and `output` are read-only arrays of one length. `method` is "modes" (exact sum of
    exponentials), "modes+convolution" (a singular power of 1/s was convolved exactly besides), "contour" (one
    contour integral per lag, where modes would cancel) or "fft" (numerical inversion). `error_estimate` is an
    estimate of the largest error of `output`, from an independent evaluation at a few times. `modes` counts
    the exponentials, a pair as two; `period` [s] and `hold` are those of the request.
    """

    time: Reals
    output: Reals
    method: str
    error_estimate: float
    modes: int
    period: float | None
    hold: str

    def __post_init__(self) -> None:
        self.time.flags.writeable = False
        self.output.flags.writeable = False


def time_response(
    G: FractionalTransferFunction, u: ArrayLike, period: float, *, hold: str = "zero"
) -> TimeResponse:
    """Return the output of G for the sampled input u, from rest, exact at the samples for a held input.

    y(t) = ∫₀ᵗ g(t-τ) u(τ) dτ with u held between samples: constant (`hold="zero"`) or straight (`"first"`,
    starting with a jump from 0 to u[0]). Before the first sample everything is at rest.

    Parameters
    ----------
    G : FractionalTransferFunction
        Proper; integrators, unstable poles and delays are allowed.
    u : array_like, shape (N,)
        Input at k·period, k = 0 … N-1. y[k] contains the jump of a direct feedthrough at k.
    period : float
        Sampling period [s].
    hold : {"zero", "first"}
        Movement of the input between samples.

    Raises
    ------
    FieldError
        Improper G, input that is not a finite vector, period or hold out of range.
    SizeError
        N beyond the machine's memory, refused before anything is allocated.

    Source: docs/explanation/numerics.md. Cost O(N · modes), state O(modes).

    >>> from fraclink._systems.fractional import s
    >>> result = time_response(1 / (s + 1), [1.0, 1.0, 1.0], 1.0)
    >>> result.output.round(6), result.method
    (array([0.      , 0.632121, 0.864665]), 'modes')
    """
    checked_system("G", G)
    values = samples(u)
    period = positive("period", period)
    check_request(period, hold, max(len(values), 1) * period, TOLERANCE)
    if any(t.delay for t in G.denominator):
        return _by_inversion(G, delay_free_part(G), values, period, hold)
    try:
        parts = [
            held_quotient(top, G.denominator).respond(
                values, period, hold=hold, tolerance=TOLERANCE, delay=delay
            )
            for delay, top in delay_groups(G).items()
        ]
    except NotConvergedError:  # the poles cannot be certified: zeros of high multiplicity
        return _by_inversion(G, feedthrough(G), values, period, hold)
    return _assembled(grid(len(values), period), parts, period, hold)


def step_response(
    G: FractionalTransferFunction, time: float | ArrayLike, period: float | None = None
) -> TimeResponse:
    """Return the response of G to a unit step at t = 0, from rest.

    `time` is the duration [s] with `period` [s], or an array of times ≥ 0 [s] in any spacing. At t = 0 the
    value is the one after the jump.

    >>> from fraclink._systems.fractional import s
    >>> float(step_response(1 / s**0.5, [0.0, 1.0]).output[1].round(12))  # 2 sqrt(t/π)
    1.128379167096
    """
    return _fixed(G, time, period, 1)


def impulse_response(
    G: FractionalTransferFunction, time: float | ArrayLike, period: float | None = None
) -> TimeResponse:
    """Return the response of G to a unit impulse at t = 0, from rest; arguments as for `step_response`.

    A direct feedthrough D gives an impulse D·δ(t) besides, which no sample shows. At t = 0 the value is the
    limit from the right; it is infinite where the relative degree is below 1.

    >>> from fraclink._systems.fractional import s
    >>> impulse_response(1 / (s + 1), [0.0, 1.0]).output.round(6)
    array([1.      , 0.367879])
    """
    return _fixed(G, time, period, 0)


def _fixed(
    G: FractionalTransferFunction, time: float | ArrayLike, period: float | None, degree: int
) -> TimeResponse:
    checked_system("G", G)
    times = instants(time, period)
    if any(t.delay for t in G.denominator):
        return _fixed_by_inversion(G, times, period, degree)
    parts = []
    try:
        for delay, top in delay_groups(G).items():
            late = times - delay
            late[np.abs(late) <= 1e-12 * max(1.0, delay)] = 0.0
            parts.append(held_quotient(top, G.denominator).at(late, degree, TOLERANCE))
    except NotConvergedError:
        if period is None or degree == 0:
            raise
        return time_response(G, np.ones(len(times)), period)
    return _assembled(times, parts, period, "impulse" if degree == 0 else "zero")


def _assembled(time: Reals, parts: list[Part], period: float | None, hold: str) -> TimeResponse:
    """The sum over the delays; the least direct method of all parts names the result."""
    output = parts[0].output if parts else np.zeros(len(time))
    for part in parts[1:]:
        output += part.output
    method = max((p.method for p in parts), key=_METHODS.index, default="modes")
    error, modes = sum(p.error for p in parts), max((p.modes for p in parts), default=0)
    return TimeResponse(time, output, method, error, modes, period, hold)


def _by_inversion(
    G: FractionalTransferFunction, exact: FractionalTransferFunction, u: Reals, period: float, hold: str
) -> TimeResponse:
    """The response of `exact`, which has one, plus the numerically inverted rest."""
    refuse_beyond_memory("u", len(u), FFT_BYTES)
    base = time_response(exact, u, period, hold=hold)
    if not len(u):
        return base
    degree = 1 if hold == "zero" else 2
    # One sample more than asked for: the weights of a first-order hold look one period ahead.
    rest, error = invert(G, exact, len(u) + 1, period, degree)
    output = base.output + convolve(_weights(rest, period, degree), u)
    error = error / period if degree == 2 else error  # the weights of a first-order hold are slopes of it
    if degree == 2 and u[0] != 0.0:
        jump, jump_error = invert(G, exact, len(u), period, 1)
        output += u[0] * (jump - np.diff(rest) / period)
        error += jump_error
    estimate = base.error_estimate + 4.0 * error * largest(u)
    return TimeResponse(base.time, output, "fft", estimate, base.modes, period, hold)


def _weights(rest: Reals, period: float, degree: int) -> Reals:
    """Differences of step or ramp samples: the weights of the hold at lags 0 … N-1."""
    if degree == 1:
        return np.diff(rest[:-1], prepend=0.0)
    return np.diff(np.diff(rest, prepend=0.0), prepend=0.0)[1:] / period


def _fixed_by_inversion(
    G: FractionalTransferFunction, times: Reals, period: float | None, degree: int
) -> TimeResponse:
    if period is None or degree == 0:
        raise FieldError(
            "time",
            "an array of times" if period is None else "an impulse",
            "not available with delays in the denominator",
            allowed="step responses given by a duration and a period",
            remedy="give a duration and a period; the impulse response is the step response of s·G",
        )
    return time_response(G, np.ones(len(times)), period)
