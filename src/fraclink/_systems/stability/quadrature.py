"""Adaptive Gauss–Legendre quadrature of a smooth function, all panels at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import NotConvergedError

__all__ = ["integrate"]

Real = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_PANELS = 20_000


def integrate(f: Callable[[Real], Real], edges: Real, tolerance: float, *, smooth: float) -> float:
    """∫ f over the panels between `edges`; a panel is halved until its halves agree with the whole.

    `tolerance` is relative to the integral; f takes an array of any shape. On panels shorter than `smooth`
    the rule is exact to rounding: what they still disagree by is rounding, and no reason to go on.
    """
    a, b = edges[:-1], edges[1:]
    coarse = _panels(f, a, b)
    total, scale = 0.0, float(np.abs(coarse).sum())
    while a.size:
        if a.size > _PANELS:
            raise NotConvergedError(
                "quadrature of the norm",
                reached=float(a.size),
                wanted=_PANELS,
                remedy="a pole lies extremely close to the imaginary axis",
            )
        middle = 0.5 * (a + b)
        halves = _panels(f, np.concatenate([a, middle]), np.concatenate([middle, b])).reshape(2, -1)
        fine = halves.sum(0)
        # The halves are 2^32 times better than the whole where f is smooth: their difference is the error
        # of the whole, and the error of the halves is far below it.
        scale = max(scale, abs(total) + float(np.abs(fine).sum()))
        done = (np.abs(fine - coarse) <= tolerance * scale / 16) | (b - a < smooth)
        total += float(fine[done].sum())
        left = ~done
        coarse = np.concatenate([halves[0, left], halves[1, left]])
        a, b = np.concatenate([a[left], middle[left]]), np.concatenate([middle[left], b[left]])
    return total


def _panels(f: Callable[[Real], Real], a: Real, b: Real) -> Real:
    half = 0.5 * (b - a)
    x = 0.5 * (a + b)[:, None] + half[:, None] * _NODES
    return np.asarray((f(x) * _WEIGHTS).sum(1) * half)
