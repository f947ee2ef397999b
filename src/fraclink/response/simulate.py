"""Time responses from rest: the verbs `time_response`, `step_response` and `impulse_response`."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink.errors import FieldError, SizeError
from fraclink.fractional import FractionalTransferFunction
from fraclink.response.discrete import check_request, delay_groups, held_quotient
from fraclink.response.held import HeldQuotient
from fraclink.response.inversion import delay_free_part, invert
from fraclink.response.powers import convolve

__all__ = ["TimeResponse", "impulse_response", "step_response", "time_response"]

Reals = NDArray[np.float64]
TOLERANCE = 1e-12
_BYTES = 40  # per sample: input, output, time and what a hold needs
_FFT_BYTES = 2000  # per sample of the numerical inversion: four spans, eight times oversampled


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

    >>> from fraclink.fractional import s
    >>> result = time_response(1 / (s + 1), [1.0, 1.0, 1.0], 1.0)
    >>> result.output.round(6), result.method
    (array([0.      , 0.632121, 0.864665]), 'modes')
    """
    values = _vector(u)
    period = _number("period", period)
    check_request(period, hold, max(len(values), 1) * period, TOLERANCE)
    time = np.arange(len(values), dtype=np.float64) * period
    if any(t.delay for t in G.denominator):
        output, error, modes = _by_inversion(G, values, period, hold)
        return TimeResponse(time, output, "fft", error, modes, period, hold)
    output, error, modes, method = np.zeros(len(values)), 0.0, 0, "modes"
    for delay, top in delay_groups(G).items():
        held = held_quotient(top, G.denominator)
        part, part_error, count = held.respond(values, period, hold=hold, tolerance=TOLERANCE, delay=delay)
        output += part
        error, modes = error + part_error, max(modes, count)
        method = _method(method, count, held)
    return TimeResponse(time, output, method, error, modes, period, hold)


def step_response(
    G: FractionalTransferFunction, time: float | ArrayLike, period: float | None = None
) -> TimeResponse:
    """Return the response of G to a unit step at t = 0, from rest.

    `time` is the duration [s] with `period` [s], or an array of times ≥ 0 [s] in any spacing. At t = 0 the
    value is the one after the jump.

    >>> from fraclink.fractional import s
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

    >>> from fraclink.fractional import s
    >>> impulse_response(1 / (s + 1), [0.0, 1.0]).output.round(6)
    array([1.      , 0.367879])
    """
    return _fixed(G, time, period, 0)


def _fixed(
    G: FractionalTransferFunction, time: float | ArrayLike, period: float | None, degree: int
) -> TimeResponse:
    times = _times(time, period)
    if any(t.delay for t in G.denominator):
        return _fixed_by_inversion(G, times, period, degree)
    output, error, modes, method = np.zeros(len(times)), 0.0, 0, "modes"
    for delay, top in delay_groups(G).items():
        held = held_quotient(top, G.denominator)
        late = times - delay
        late[np.abs(late) <= 1e-12 * max(1.0, delay)] = 0.0
        part, part_error, count = held.at(late, degree, TOLERANCE)
        output += part
        error, modes = error + part_error, max(modes, count)
        method = _method(method, count, held)
    return TimeResponse(times, output, method, error, modes, period, "impulse" if degree == 0 else "zero")


def _method(before: str, count: int, held: HeldQuotient) -> str:
    """The least direct method of all parts names the result."""
    if before == "contour" or (count == 0 and held.quotient is not None):
        return "contour"
    return "modes+convolution" if held.low.powers else before


def _by_inversion(
    G: FractionalTransferFunction, u: Reals, period: float, hold: str
) -> tuple[Reals, float, int]:
    refuse_beyond_memory("u", len(u), _FFT_BYTES)
    exact = delay_free_part(G)
    base = time_response(exact, u, period, hold=hold)
    if not len(u):
        return base.output, 0.0, base.modes
    degree = 1 if hold == "zero" else 2
    # One sample more than asked for: the weights of a first-order hold look one period ahead.
    rest, error = invert(G, exact, len(u) + 1, period, degree)
    output = base.output + convolve(_weights(rest, period, degree), u)
    error = error / period if degree == 2 else error  # the weights of a first-order hold are slopes of it
    if degree == 2 and u[0] != 0.0:
        jump, jump_error = invert(G, exact, len(u), period, 1)
        output += u[0] * (jump - np.diff(rest) / period)
        error += jump_error
    return output, base.error_estimate + 4.0 * error * float(np.max(np.abs(u))), base.modes


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


def _number(name: str, value: object) -> float:
    if isinstance(value, (int, float, np.integer, np.floating)) and np.isfinite(value) and value > 0:
        return float(value)
    raise FieldError(
        name, value, "not a positive number", allowed="> 0 s", remedy="give the sampling period in seconds"
    )


def _vector(u: ArrayLike) -> Reals:
    values = np.asarray(u)
    if values.ndim != 1 or values.dtype.kind not in "biuf":
        raise FieldError(
            "u",
            f"array of shape {values.shape} and type {values.dtype}",
            "not a vector of real numbers",
            allowed="shape (N,)",
            remedy="give one channel at a time",
        )
    refuse_beyond_memory("u", len(values))
    values = np.ascontiguousarray(values, np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise FieldError(
            "u",
            float(values[bad[0]]),
            f"not finite (sample {bad[0]})",
            allowed="finite numbers",
            remedy="fill or cut the gap first",
        )
    return values


def _times(time: float | ArrayLike, period: float | None) -> Reals:
    values = np.asarray(time)
    if values.ndim == 0:
        duration = _number("time", values.item())
        if period is None:
            raise FieldError(
                "period",
                None,
                "missing",
                allowed="> 0 s",
                remedy="give the period of the samples, or an array of times",
            )
        step = _number("period", period)
        refuse_beyond_memory("time", duration / step)
        count = int(duration / step * (1.0 + 1e-12)) + 1
        return np.arange(count, dtype=np.float64) * step
    if period is not None:
        raise FieldError(
            "period",
            period,
            "given beside an array of times",
            allowed="a duration and a period, or times alone",
            remedy="leave the period out",
        )
    if values.ndim != 1 or not values.size or values.dtype.kind not in "iuf":
        raise FieldError(
            "time", values.shape, "not a vector of times", allowed="shape (N,), N ≥ 1", remedy="give seconds"
        )
    times = values.astype(np.float64)
    if not (np.isfinite(times).all() and (times >= 0.0).all()):
        raise FieldError(
            "time",
            float(times.min()),
            "negative or not finite",
            allowed="≥ 0 s",
            remedy="give times from rest",
        )
    return times


def refuse_beyond_memory(field: str, count: float, each: int = _BYTES) -> None:
    """Raise `SizeError` where `count` samples need more memory than the machine has; nothing is allocated."""
    available = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if not count * each < available:
        raise SizeError(
            field,
            count,
            f"too many samples: they need {count * each:.2g} bytes",
            allowed=f"at most {available // each:.3g} samples on this machine",
            remedy="shorten the span or lengthen the period",
        )
