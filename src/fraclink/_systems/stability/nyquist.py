"""The Nyquist criterion on a swept response, with indentations around poles of the axis."""

from __future__ import annotations

import cmath
import math

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.stability.sweep import Loop

__all__ = ["unstable_closed_loop_poles"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

_ON_AXIS = 1e3  # |L| on both sides of an interval that turned by more than half a radian: a pole between them


def unstable_closed_loop_poles(
    loop: Loop, x: Real, values: Complex, *, open_loop: int, ends_real: bool
) -> int | None:
    """Poles of 1/(1 + L) with Re s > 0, by the change of arg(1 + L); None where it is not a whole number.

    Half the contour suffices, L being real on the positive real axis: from there along a small arc to jω_low,
    up the axis (passing its poles on the right), and along a large arc back. Up the axis the right half plane
    lies to the right, so that the change is −π (Z − P). A sampled loop (`ends_real`) is real at the Nyquist
    frequency and needs no second arc.
    """
    ahead = 1 + values
    steps = np.angle(ahead[1:] / ahead[:-1])
    modulus = np.abs(values)
    jumps = (np.abs(steps) > 0.5) & (np.minimum(modulus[1:], modulus[:-1]) > _ON_AXIS)
    # Passing a simple pole of the axis on its right turns L by −π along an arc of infinite radius.
    steps[jumps] -= np.where(steps[jumps] > 0, 2 * math.pi, 0.0)
    change = float(steps.sum()) + _arc(complex(values[0]), loop.point(float(x[0]))[1].real)
    if not ends_real or abs(values[-1]) < 1:
        change -= _arc(complex(values[-1]), loop.point(float(x[-1]))[1].real)
    turns = -change / math.pi
    if not math.isfinite(turns) or abs(turns - round(turns)) > 0.2:
        return None
    return open_loop + round(turns)


def _arc(value: complex, slope: float) -> float:
    """Change of arg(1 + L) from the positive real axis to jω along |s| = ω, where L ≈ c s^slope."""
    phase = cmath.phase(value)
    if abs(value) < 1:
        return cmath.phase(1 + value)
    # L starts at a multiple of π and turns by slope π/2, which the phase itself says more exactly.
    turned = phase - math.pi * round((phase - 0.5 * math.pi * slope) / math.pi)
    return turned + cmath.phase(1 + 1 / value)
