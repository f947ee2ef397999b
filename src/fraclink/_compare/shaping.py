"""ZV and ZVD input shaping: a reference that leaves no vibration behind, if the frequency is right."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.reference import Reference

__all__ = ["Shaped", "shaper_impulses"]

Real = NDArray[np.float64]


def shaper_impulses(frequency: float, ratio: float, *, derivative: bool) -> tuple[Real, Real]:
    """Return times [s] and sizes of the ZV shaper's impulses (two), or the ZVD's (three).

    K = exp(−ζπ/√(1 − ζ²)); ZV: (1, K)/(1 + K) at 0 and half a damped period; ZVD: (1, 2K, K²)/(1 + K)².
    Source: Singer and Seering, ASME J. Dyn. Sys. 112 (1990) 76.

    >>> times, sizes = shaper_impulses(10.0, 0.0, derivative=False)
    >>> times.round(4).tolist(), sizes.tolist()
    ([0.0, 0.3142], [0.5, 0.5])
    """
    root = math.sqrt(1.0 - ratio**2)
    half = math.pi / (frequency * root)
    k = math.exp(-ratio * math.pi / root)
    sizes = np.array([1.0, 2.0 * k, k * k] if derivative else [1.0, k])
    times: Real = half * np.arange(len(sizes), dtype=np.float64)
    return times, np.asarray(sizes / sizes.sum())


class Shaped(Reference):
    """A reference convolved with impulses: exact, angle, velocity and acceleration."""

    def __init__(self, reference: Reference, times: tuple[float, ...], sizes: tuple[float, ...]) -> None:
        self._reference, self._impulses = reference, tuple(zip(times, sizes, strict=True))
        self.duration = float(reference.duration + times[-1])

    def derivative(self, time: ArrayLike, order: int) -> Real:
        """Return the derivative of `order` [rad/s^order] at `time` [s]."""
        parts = (a * self._reference.derivative(np.asarray(time) - t, order) for t, a in self._impulses)
        return np.asarray(sum(parts))
