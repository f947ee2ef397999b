"""Held responses by one weight per lag, each from a contour of its own.

O(N log N) and a few microseconds per lag: for the functions whose modes cancel (poles and singular powers
that are much slower than the whole span), where relative accuracy needs a contour that grows with time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.response.contour import held_response
from fraclink._systems.response.powers import convolve
from fraclink._systems.response.quotient import Quotient

__all__ = ["respond_by_weights", "sample_response"]

Reals = NDArray[np.float64]


def sample_response(quotient: Quotient, times: Reals, power: int, start: float) -> Reals:
    """Step (power 1), ramp (2) or impulse (0) response at any times; `start` at 0 and nothing before."""
    values, later = np.where(times == 0.0, start, 0.0), times > 0.0
    values[later] = held_response(quotient, times[later], power)
    return values


def respond_by_weights(
    quotient: Quotient, direct: float, u: Reals, period: float, hold: str, lag: int, ahead: float
) -> Reals:
    """Response to u delayed by `lag` periods and seen `ahead` [s] after its samples."""
    output, count = np.zeros(len(u)), len(u) - lag
    if count <= 0:
        return output
    times = np.arange(count, dtype=np.float64) * period + ahead
    step = sample_response(quotient, times, 1, direct)
    if hold == "zero":
        output[lag:] = convolve(np.diff(step, prepend=0.0), u[:count])
        return output
    rise = np.diff(sample_response(quotient, times, 2, 0.0), prepend=0.0)
    slopes = np.diff(u[: count + 1]) / period
    slopes = np.concatenate((slopes, np.zeros(count - len(slopes))))
    output[lag:] = u[0] * step + convolve(rise, slopes)
    return output
