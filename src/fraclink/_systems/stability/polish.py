"""Roots and extremes of a response, polished from brackets by Newton's method with exact slopes."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

from fraclink._systems.stability.sweep import Loop

__all__ = ["extreme", "gain_level", "modulus_slope", "phase_level", "polish"]

Level = Callable[[complex, complex], tuple[float, float]]

_DONE = 1e-9  # the error that a last Newton step of this length leaves is far below rounding


def gain_level(value: complex, slope: complex) -> tuple[float, float]:
    """ln |L| and its derivative by ln ω."""
    size = abs(value)
    return (math.log(size) if 0 < size < math.inf else math.copysign(math.inf, size - 1)), slope.real


def phase_level(value: complex, slope: complex) -> tuple[float, float]:
    """arg(−L) and its derivative by ln ω."""
    return cmath.phase(-value), slope.imag


def modulus_slope(value: complex, slope: complex) -> float:
    """½ d|1 + L|²/d ln ω."""
    return ((1 + value).conjugate() * value * slope).real


def polish(loop: Loop, level: Level, a: float, b: float, at_a: float, at_b: float) -> tuple[float, complex]:
    """The root of `level` in the bracket [a, b], and L there; a step that leaves the bracket halves it."""
    x = a - at_a * (b - a) / (at_b - at_a)
    if not a <= x <= b:
        x = 0.5 * (a + b)
    for _ in range(100):
        value, slope = loop.point(x)
        f, rate = level(value, slope)
        if (f < 0) == (at_a < 0):
            a = x
        else:
            b = x
        step = f / rate if rate and math.isfinite(f) else math.inf
        new = x - step
        if not a <= new <= b:
            new = 0.5 * (a + b)
        moved, x = new - x, new
        if abs(moved) < _DONE or f == 0:
            return x, value * cmath.exp(slope * moved)
    return x, loop.point(x)[0]


def extreme(
    loop: Loop, tendency: Callable[[complex, complex], float], a: float, b: float
) -> tuple[float, complex]:
    """A zero of `tendency`, which has the sign of a derivative, between a and b (Anderson and Björck)."""
    at_a, at_b = tendency(*loop.point(a)), tendency(*loop.point(b))
    if at_a == 0 or at_b == 0:  # an end is the extreme itself
        c = a if at_a == 0 else b
        return c, loop.point(c)[0]
    c, value = a, 0j
    for _ in range(100):
        last = c
        c = b - at_b * (b - a) / (at_b - at_a) if at_b != at_a else 0.5 * (a + b)
        if not min(a, b) <= c <= max(a, b):
            c = 0.5 * (a + b)
        value, slope = loop.point(c)
        at_c = tendency(value, slope)
        if at_c == 0 or abs(c - last) < _DONE:
            break
        if at_c * at_b < 0:
            a, at_a = b, at_b
        else:
            share = 1 - at_c / at_b
            at_a *= share if share > 0 else 0.5
        b, at_b = c, at_c
    return c, value
