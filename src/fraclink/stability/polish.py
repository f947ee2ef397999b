"""Roots and minima of a response, polished from brackets; all of them at once."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fraclink.stability.sweep import Loop

__all__ = ["polish_minimum", "polish_roots"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


def polish_roots(
    loop: Loop, height: Callable[[Complex], Real], a: Real, b: Real, at_a: Complex, at_b: Complex
) -> Real:
    """Roots of height(L(j e^x)) in the brackets [a, b], by the Anderson–Björck secant method."""
    fa, fb = height(at_a), height(at_b)
    for _ in range(60):
        with np.errstate(invalid="ignore", divide="ignore"):
            c = b - fb * (b - a) / (fb - fa)
        c = np.where(np.isfinite(c) & ((c - a) * (c - b) <= 0), c, 0.5 * (a + b))
        fc = height(loop(c))
        crossed = fc * fb < 0
        with np.errstate(invalid="ignore", divide="ignore"):
            shrink = 1 - fc / fb
        fa = np.where(crossed, fb, fa * np.where(shrink > 0, shrink, 0.5))
        a = np.where(crossed, b, a)
        b, fb = c, fc
        if np.all((np.abs(fc) < 1e-15) | (np.abs(b - a) < 1e-15)):
            break
    return b


def polish_minimum(
    loop: Loop, height: Callable[[Complex], Real], x: Real, values: Complex
) -> tuple[float, float]:
    """Smallest height(L) over the sweep, and its frequency [rad/s]; zooms into the lowest bracket."""
    y = height(values)
    i = int(np.nanargmin(y))
    best, at = float(y[i]), float(x[i])
    low, high = x[max(i - 1, 0)], x[min(i + 1, len(x) - 1)]
    for _ in range(12):
        grid = np.linspace(low, high, 9)
        y = height(loop(grid))
        i = int(np.nanargmin(y))
        if y[i] < best:
            best, at = float(y[i]), float(grid[i])
        low, high = grid[max(i - 1, 0)], grid[min(i + 1, 8)]
    return best, math.exp(at)
