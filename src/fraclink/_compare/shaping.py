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


class Shaped:
    """A reference convolved with impulses: exact, angle, velocity and acceleration."""

    def __init__(self, reference: Reference, times: tuple[float, ...], sizes: tuple[float, ...]) -> None:
        self._reference, self._impulses = reference, tuple(zip(times, sizes, strict=True))

    @property
    def duration(self) -> float:
        """Time at which the shaped reference comes to rest [s]."""
        return float(self._reference.duration + self._impulses[-1][0])

    def angle(self, time: ArrayLike) -> Real:
        """Angle [rad]."""
        return np.asarray(sum(a * self._reference.angle(np.asarray(time) - t) for t, a in self._impulses))

    def velocity(self, time: ArrayLike) -> Real:
        """Velocity [rad/s]."""
        return np.asarray(sum(a * self._reference.velocity(np.asarray(time) - t) for t, a in self._impulses))

    def acceleration(self, time: ArrayLike) -> Real:
        """Acceleration [rad/s²]."""
        return np.asarray(
            sum(a * self._reference.acceleration(np.asarray(time) - t) for t, a in self._impulses)
        )
