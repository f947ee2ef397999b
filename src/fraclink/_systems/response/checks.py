"""What a request for a time response is checked against, before anything is allocated."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._validate import checked_number
from fraclink.errors import FieldError, SizeError

__all__ = ["FFT_BYTES", "grid", "instants", "largest", "positive", "refuse_beyond_memory", "samples"]

Reals = NDArray[np.float64]
_BYTES = 40  # per sample: input, output, time and what a hold needs
FFT_BYTES = 2000  # per sample of the numerical inversion: four spans, eight times oversampled


def largest(values: Reals) -> float:
    """Largest modulus, NaN where there is one; two passes and no copy."""
    return max(float(values.max()), -float(values.min())) if len(values) else 0.0


def grid(count: int, period: float) -> Reals:
    """Times k·period [s], k = 0 … count - 1."""
    times = np.arange(count, dtype=np.float64)
    times *= period
    return times


def positive(name: str, value: object) -> float:
    return checked_number(
        name, value, allowed="> 0 s", remedy="give the sampling period in seconds", holds=lambda x: x > 0
    )


def _array(name: str, values: ArrayLike) -> NDArray[Any]:
    try:
        return np.asarray(values)
    except ValueError as error:  # rows of different lengths
        raise FieldError(
            name,
            type(values).__name__,
            "not an array",
            allowed="shape (N,)",
            remedy="give one number a sample",
        ) from error


def samples(u: ArrayLike) -> Reals:
    values = _array("u", u)
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
    if values.size and not math.isfinite(largest(values)):
        bad = np.flatnonzero(~np.isfinite(values))
        raise FieldError(
            "u",
            float(values[bad[0]]),
            f"not finite (sample {bad[0]})",
            allowed="finite numbers",
            remedy="fill or cut the gap first",
        )
    return values


def instants(time: float | ArrayLike, period: float | None) -> Reals:
    values = _array("time", time)
    if values.ndim == 0:
        duration = positive("time", values.item())
        if period is None:
            raise FieldError(
                "period",
                None,
                "missing",
                allowed="> 0 s",
                remedy="give the period of the samples, or an array of times",
            )
        step = positive("period", period)
        refuse_beyond_memory("time", duration / step)
        count = int(duration / step * (1.0 + 1e-12)) + 1
        return grid(count, step)
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
    # Where the system does not tell, 8 GiB: every machine that runs numpy in earnest has them.
    known = hasattr(os, "sysconf")
    available = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if known else 8 << 30
    if not count * each < available:
        raise SizeError(
            field,
            count,
            f"too many samples: they need {count * each:.2g} bytes",
            allowed=f"at most {available // each:.3g} samples on this machine",
            remedy="shorten the span or lengthen the period",
        )
