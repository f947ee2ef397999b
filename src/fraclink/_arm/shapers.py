"""Input shapers: a reference convolved with impulses whose vibrations cancel at, or
around, one frequency.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.reference import Reference

__all__ = ["SHAPERS", "Shaped", "Shaper", "shaper_impulses"]

Real = NDArray[np.float64]
Shaper = Literal["ZV", "ZVD", "EI"]

SHAPERS: tuple[Shaper, ...] = ("ZV", "ZVD", "EI")
# of the vibration, which an EI shaper leaves at the frequency it is made for: the usual
# value
_LEFT = 0.05


def shaper_impulses(kind: Shaper, frequency: float, ratio: float) -> tuple[Real, Real]:
    """Return times [s] and sizes of the impulses for a mode of `frequency` [rad/s] and
    damping `ratio`.

    K = exp(−ζπ/√(1 − ζ²)); ZV: (1, K)/(1 + K) at 0 and half a damped period; ZVD: (1,
    2K, K²)/(1 + K)². EI leaves 5 % at the mode and none at one frequency below and one
    above it, so that 5 % is not exceeded over a range half as wide again as that of
    ZVD. Source: Singer and Seering, ASME J. Dyn. Sys. 112 (1990) 76; Singhose, Seering,
    Singer, ASME J. Mech. Des. 116 (1994) 654, with its fits for ζ > 0.

    >>> times, sizes = shaper_impulses("ZV", 10.0, 0.0)
    >>> times.round(4).tolist(), sizes.tolist()
    ([0.0, 0.3142], [0.5, 0.5])
    """
    root = math.sqrt(1.0 - ratio**2)
    # The second impulse comes half a damped period later, in opposite phase to the
    # first one's vibration.
    half = math.pi / (frequency * root)
    if kind == "EI":
        return _extra_insensitive(half, ratio)
    k = math.exp(-ratio * math.pi / root)
    # ZVD is ZV convolved with itself: a double zero at the mode, so that a frequency x
    # % off leaves x² of it.
    sizes = np.array([1.0, 2.0 * k, k * k] if kind == "ZVD" else [1.0, k])
    times: Real = half * np.arange(len(sizes), dtype=np.float64)
    return times, np.asarray(sizes / sizes.sum())


def _extra_insensitive(half: float, z: float) -> tuple[Real, Real]:
    v = _LEFT
    # The fits leave 4.8 to 5.1 % of the vibration at the mode for ζ up to 0.3.
    first = (
        0.24968
        + 0.24962 * v
        + 0.80008 * z
        + 1.23328 * v * z
        + 0.49599 * z**2
        + 3.17316 * v * z**2
    )
    last = (
        0.25149
        + 0.21474 * v
        - 0.83249 * z
        + 1.41498 * v * z
        + 0.85181 * z**2
        - 4.90094 * v * z**2
    )
    late = 0.49990 + 0.46159 * v * z + 4.26169 * v * z**2 + 1.75601 * v * z**3
    late += v**2 * z * (8.57843 - 108.644 * z + 336.989 * z**2)
    sizes = np.array([first, 1.0 - first - last, last])
    return np.array([0.0, 2.0 * half * late, 2.0 * half]), sizes


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
