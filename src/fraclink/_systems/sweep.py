"""A frequency response on a grid that the response itself refines."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.loops import FractionalLoop, SampledLoop, as_loop
from fraclink._systems.terms import Complexes, Reals
from fraclink.errors import FieldError

TURN = 0.5  # largest change of phase between neighbours [rad]: a crossing is then bracketed surely
RISE = 1.5  # largest change of ln |L| between neighbours: 13 dB
CLOSEST = 1e-9  # neighbours closer than this in ln ω have a pole or zero of the axis between them
POINT_LIMIT = 50_000
# |L| below which a delay's turning is no longer followed, and the points that may be spent on it: a loop that
# rolls off like ω^(−1/2) would need millions for crossings at −60 dB that say nothing.
_PATIENCE = ((1e-3, 4000), (1e-2, 6000), (0.1, 12_000), (0.5, POINT_LIMIT))


def sweep(loop: SampledLoop, *, per_decade: int = 20) -> tuple[Reals, Complexes, float]:
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


def _refined(
    loop: SampledLoop, x: Reals, values: Complexes, quiet: float, limit: int
) -> tuple[Reals, Complexes] | None:
    while (wide := _too_wide(loop, x, values, quiet)).size:
        if x.size + wide.size > limit:
            return None
        middle = 0.5 * (x[wide] + x[wide + 1])
        x = np.insert(x, wide + 1, middle)
        values = np.insert(values, wide + 1, loop(middle))
    return x, values


def _too_wide(loop: SampledLoop, x: Reals, values: Complexes, quiet: float) -> NDArray[np.intp]:
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


# --- Frequencies for plots and for python-control: even on a logarithmic scale, finer where L moves fast

_DECADES = math.log(100.0)
_FAINT = 1e-3


def frequency_grid(
    loop: FractionalTransferFunction | Callable[[Complexes], Complexes],
    *,
    points: int = 300,
    limit: float | None = None,
) -> Reals:
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
    frequencies: Reals = np.exp(grid[np.concatenate([[True], np.diff(grid) > 1e-10])])
    return frequencies


def _bent(x: Reals, values: Complexes, *, keep_top: bool) -> tuple[Reals, Complexes]:
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
    curve: Callable[[Reals], tuple[Reals, Reals]], x: Reals, *, bend: float = 0.03, limit: int = 4000
) -> Reals:
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
