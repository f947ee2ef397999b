"""A frequency response on a grid that the response itself refines."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FieldError

__all__ = ["CLOSEST", "Loop", "sweep"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

TURN = 0.5  # largest change of phase between neighbours [rad]: a crossing is then bracketed surely
RISE = 1.5  # largest change of ln |L| between neighbours: 13 dB
CLOSEST = 1e-9  # neighbours closer than this in ln ω have a pole or zero of the axis between them
POINT_LIMIT = 50_000
# |L| below which a delay's turning is no longer followed, and the points that may be spent on it: a loop that
# rolls off like ω^(−1/2) would need millions for crossings at −60 dB that say nothing.
_PATIENCE = ((1e-3, 4000), (1e-2, 6000), (0.1, 12_000), (0.5, POINT_LIMIT))


class Loop(Protocol):
    """A response on the imaginary axis and what is known about it before it is evaluated."""

    @property
    def low(self) -> float:
        """ln of the lowest frequency that can matter [rad/s]."""

    @property
    def high(self) -> float:
        """ln of the highest frequency that can matter [rad/s]."""

    @property
    def seeds(self) -> Real:
        """ln ω where the response moves fast: near poles and zeros beside the axis."""

    def __call__(self, x: Real) -> Complex:
        """L(j e^x)."""

    @property
    def delayed(self) -> bool:
        """Whether there may be a delay: where |L| is small its phase crossings are countless."""

    @property
    def follow(self) -> float:
        """ln of the frequency up to which the phase is followed however small |L| is."""

    @property
    def ends(self) -> tuple[complex, complex]:
        """L at ω → 0 and ω → ∞ where it has a limit that is known, else nan."""

    def point(self, x: float) -> tuple[complex, complex]:
        """L(j e^x) and d ln L/dx at one frequency."""


def sweep(loop: Loop, *, per_decade: int = 20) -> tuple[Real, Complex, float]:
    """Return (ln ω, L, quiet): neither ln L nor 1 + L moves far between neighbours where |L| > quiet.

    `quiet` is the loop's own, or higher for a delay in a loop that rolls off slowly.
    """
    count = max(16, int((loop.high - loop.low) / math.log(10) * per_decade) + 1)
    x = np.linspace(loop.low, loop.high, count)
    if loop.seeds.size:
        inside = (loop.seeds > loop.low) & (loop.seeds < loop.high)
        x = np.unique(np.concatenate([x, loop.seeds[inside]]))
    values = loop(x)
    levels = _PATIENCE if loop.delayed else ((0.0, POINT_LIMIT),)
    for quiet, limit in levels:
        refined = _refined(loop, x, values, quiet, limit)
        if refined is not None:
            return *refined, quiet
    raise FieldError(
        "limit",
        math.exp(loop.high),
        "too high for a response that keeps turning",
        allowed=f"at most {POINT_LIMIT} points of the response",
        remedy="give limit=, the highest frequency of interest in rad/s",
    )


def _refined(loop: Loop, x: Real, values: Complex, quiet: float, limit: int) -> tuple[Real, Complex] | None:
    while (wide := _too_wide(loop, x, values, quiet)).size:
        if x.size + wide.size > limit:
            return None
        middle = 0.5 * (x[wide] + x[wide + 1])
        x = np.insert(x, wide + 1, middle)
        values = np.insert(values, wide + 1, loop(middle))
    return x, values


def _too_wide(loop: Loop, x: Real, values: Complex, quiet: float) -> NDArray[np.intp]:
    """Intervals to halve: ln L moves too far, or 1 + L more than its distance from zero."""
    change = np.log(values[1:] / values[:-1])
    fine = (np.abs(change.imag) <= TURN) & (np.abs(change.real) <= RISE)
    away = np.abs(1 + values)
    fine &= np.abs(np.diff(values)) <= np.minimum(away[1:], away[:-1])
    width = np.diff(x)
    if quiet:
        # A delay turns a wide interval by 2π and it looks still: but then its neighbour was refined.
        fine[1:] &= width[1:] < 2.1 * width[:-1]
        fine[:-1] &= width[:-1] < 2.1 * width[1:]
        loud = np.abs(values) > quiet
        fine |= ~(loud[1:] | loud[:-1] | (x[:-1] < loop.follow))
    return np.flatnonzero(~fine & (width > CLOSEST))
