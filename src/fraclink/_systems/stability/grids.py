"""Frequencies for plots and for python-control: even on a logarithmic scale, finer where L moves fast."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.stability.fractional_loop import FractionalLoop
from fraclink._systems.stability.loops import as_loop
from fraclink._systems.stability.sweep import sweep
from fraclink.errors import FieldError

__all__ = ["frequency_grid", "refined"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_DECADES = math.log(100.0)
_FAINT = 1e-3


def frequency_grid(
    loop: FractionalTransferFunction | Callable[[Complex], Complex],
    *,
    points: int = 300,
    limit: float | None = None,
) -> Real:
    """Return frequencies [rad/s] that show a loop: `points` even ones and those where it moves fast.

    The range is two decades beyond the corners of a transfer function; for a callable it is what is left of
    1e-6 … 1e6 rad/s when both ends, as far as they are straight lines in a Bode plot, are cut to one decade.
    `limit` [rad/s] is the highest frequency.

    >>> from fraclink._systems.fractional import s
    >>> w = frequency_grid(100 / (s**2 + 0.02 * s + 100))
    >>> bool(np.min(np.diff(np.log(w))) < 1e-3 and w[0] < 1 and w[-1] > 100)
    True
    """
    known = as_loop(loop, limit)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if isinstance(known, FractionalLoop):
            low, high = known.span[0] - _DECADES, known.span[1] + _DECADES
            if limit is not None:
                high = min(high, math.log(limit))
            known = replace(known, low=min(low, high - _DECADES), high=high)
        x, values, _ = sweep(known)
        if not isinstance(known, FractionalLoop):
            x, values = _bent(x, values, keep_top=limit is not None)
    even = np.linspace(x[0], x[-1], points)
    grid = np.union1d(even, x[np.isfinite(values)])
    frequencies: Real = np.exp(grid[np.concatenate([[True], np.diff(grid) > 1e-10])])
    return frequencies


def _bent(x: Real, values: Complex, *, keep_top: bool) -> tuple[Real, Complex]:
    """Cut the ends where d ln L/dx is constant, leaving one decade of each."""
    slope = np.diff(np.log(np.abs(values))) / np.diff(x)
    turn = np.abs(np.angle(values[1:] / values[:-1])) / np.diff(x)
    still = (turn < 0.02) & np.isfinite(slope)
    first = _leading(still & (np.abs(slope - slope[0]) < 0.02))
    last = len(x) - 1 - _leading((still & (np.abs(slope - slope[-1]) < 0.02))[::-1])
    loud = np.flatnonzero(np.abs(values) > _FAINT)  # above, a delay turns the phase without end
    last = min(last, int(loud[-1])) if loud.size else last
    if first >= last:  # a straight line from end to end: four decades around 1 rad/s show it
        inside = np.abs(x) < _DECADES
    else:
        margin = 0.5 * _DECADES
        inside = (x > x[first] - margin) & (keep_top | (x < x[last] + margin))
    return x[inside], values[inside]


def _leading(flags: NDArray[np.bool_]) -> int:
    """How many flags are set before the first that is not."""
    return int(np.argmin(flags)) if not flags.all() else len(flags)


def refined(
    curve: Callable[[Real], tuple[Real, Real]], x: Real, *, bend: float = 0.03, limit: int = 4000
) -> Real:
    """Return a grid on which the drawn curve looks smooth.

    `curve` maps x to the two coordinates as they are drawn, in units of the axes' sizes. Intervals are
    halved while the chords beside a point meet at more than `bend` [rad] and are longer than a line's width.
    """
    if len(x) < 3:
        raise FieldError(
            "x", len(x), "too short a grid", allowed="3 points or more", remedy="give a longer grid"
        )
    for _ in range(12):
        across, up = curve(x)
        run, rise = np.diff(across), np.diff(up)
        length = np.hypot(run, rise)
        angle = np.arctan2(rise, run)
        turn = np.abs((np.diff(angle) + math.pi) % (2 * math.pi) - math.pi)
        # 0.002 of the axes is a line's width: shorter chords cannot be seen.
        sharp = (turn > bend) & (np.minimum(length[1:], length[:-1]) > 0.002)
        long = length > 0.1
        halve = np.flatnonzero(np.concatenate([sharp, [False]]) | np.concatenate([[False], sharp]) | long)
        halve = halve[np.diff(x)[halve] > 1e-9 * np.abs(x[halve]) + 1e-12]
        if not halve.size or x.size + halve.size > limit:
            break
        x = np.sort(np.concatenate([x, 0.5 * (x[halve] + x[halve + 1])]))
    return x
