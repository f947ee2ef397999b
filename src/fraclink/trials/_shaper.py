"""Zero-vibration shaping: a reference convolved with two impulses whose vibrations
cancel.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.reference import Reference

__all__ = ["Shaped", "zv_impulses"]

Real = NDArray[np.float64]


def zv_impulses(frequency: float, ratio: float) -> tuple[Real, Real]:
    """Return times [s] and sizes of the impulses for a mode of `frequency` [rad/s] and
    damping `ratio`.

    (1, K)/(1 + K) at 0 and half a damped period, K = exp(−ζπ/√(1 − ζ²)). Source: Singer
    and Seering, ASME J. Dyn. Sys. 112 (1990) 76.

    >>> times, sizes = zv_impulses(10.0, 0.0)
    >>> times.round(4).tolist(), sizes.tolist()
    ([0.0, 0.3142], [0.5, 0.5])
    """
    root = math.sqrt(1.0 - ratio**2)
    # Half a damped period later, in opposite phase to the first one's vibration.
    times = np.array([0.0, math.pi / (frequency * root)])
    sizes = np.array([1.0, math.exp(-ratio * math.pi / root)])
    return times, sizes / sizes.sum()


class Shaped(Reference):
    """A reference convolved with impulses: exact, angle, velocity and acceleration."""

    def __init__(
        self, reference: Reference, times: tuple[float, ...], sizes: tuple[float, ...]
    ) -> None:
        self._reference, self._impulses = (
            reference,
            tuple(zip(times, sizes, strict=True)),
        )
        self.duration = float(reference.duration + times[-1])

    def derivative(self, time: ArrayLike, order: int) -> Real:
        """Return the derivative of `order` [rad/s^order] at `time` [s]."""
        parts = (
            a * self._reference.derivative(np.asarray(time) - t, order)
            for t, a in self._impulses
        )
        return np.asarray(sum(parts))
