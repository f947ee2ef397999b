"""A frequency response on a grid that the response itself refines."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FieldError

if TYPE_CHECKING:
    pass

__all__ = ["Loop", "Response", "sweep"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]
Response = Callable[[Complex], Complex]

STEP = 0.5  # largest change of ln L between neighbours: 4.3 dB or 29°; crossings are then bracketed surely
CLOSEST = 1e-9  # neighbours closer than this in ln ω are a pole or zero on the axis itself
POINT_LIMIT = 50_000
QUIET = 1e-4  # below −80 dB the phase is not followed: a delay turns it without end
_TINY = 1e-300


@dataclass(frozen=True)
class Loop:
    """A response on the imaginary axis and what is known about it before it is evaluated."""

    evaluate: Response
    low: float  # ln of the lowest and the highest frequency that can matter
    high: float
    seeds: Real  # ln ω where the response moves fast (poles and zeros near the axis)

    def __call__(self, x: Real) -> Complex:
        """L(j e^x)."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            values = np.asarray(self.evaluate(1j * np.exp(x)), dtype=complex)
        if values.shape != x.shape:
            raise FieldError(
                "loop",
                values.shape,
                "of another shape than its argument",
                allowed=f"shape {x.shape}",
                remedy="write the callable with numpy operations on arrays of s",
            )
        return values


def sweep(loop: Loop, *, per_decade: int = 20, step: float = STEP) -> tuple[Real, Complex]:
    """Return (ln ω, L) on a grid where ln L changes by less than `step` between neighbours."""
    count = max(16, int((loop.high - loop.low) / math.log(10) * per_decade) + 1)
    x = np.linspace(loop.low, loop.high, count)
    if loop.seeds.size:
        x = np.unique(np.concatenate([x, loop.seeds]))
    values = loop(x)
    for _ in range(40):
        wide = _too_wide(x, values, step)
        if not wide.size:
            return x, values
        if x.size + wide.size > POINT_LIMIT:
            raise FieldError(
                "limit",
                math.exp(loop.high),
                "too high for a response that keeps turning",
                allowed=f"at most {POINT_LIMIT} points of the response",
                remedy="give limit=, the highest frequency of interest in rad/s",
            )
        middle = 0.5 * (x[wide] + x[wide + 1])
        x = np.insert(x, wide + 1, middle)
        values = np.insert(values, wide + 1, loop(middle))
    return x, values


def _too_wide(x: Real, values: Complex, step: float) -> NDArray[np.intp]:
    """Intervals to halve: ln L moves too far, or bends so that it may have moved in between."""
    modulus = np.abs(values)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.abs(np.log(values[1:] / values[:-1]))
    moved[~np.isfinite(moved)] = math.inf
    heard = np.maximum(modulus[1:], modulus[:-1]) > QUIET
    return np.flatnonzero((moved > step) & heard & (np.diff(x) > CLOSEST))
