"""Sweeps of a frequency response: a self-refining grid, roots in known brackets, and
extremes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracsys._fractional import FractionalTransferFunction
from fracsys._loops import FAINT, SampledLoop, as_loop
from fracsys._precision import BLUR, COINCIDENT, ROUNDS
from fracsys.checks import Complex, Real
from fracsys.errors import FieldError

# largest change of ln L between neighbours (radians, or nepers), so that no crossing is
# missed
TURN = 0.5
POINT_LIMIT = 50_000
# |L| below which the phase of a delay is not followed, and the largest number of points
# of the sweep; if more are needed, the next pair applies. A loop that rolls off like
# ω^(−1/2) would need millions of points for irrelevant crossings at −60 dB.
_PATIENCE = ((FAINT, 4000), (1e-2, 6000), (0.1, 12_000), (0.5, POINT_LIMIT))


def sweep(loop: SampledLoop, turn: float = TURN) -> tuple[Real, Complex, float]:
    """Return (ln ω, L, quiet): between neighbours with |L| > quiet, ln L changes by at
    most `turn`, and 1 + L by at most its own modulus.

    `quiet` is 0 without a delay, else `FAINT`, or higher if the loop rolls off slowly.
    """
    # twenty per decade
    count = max(16, int((loop.high - loop.low) / math.log(10) * 20) + 1)
    x = np.linspace(loop.low, loop.high, count)
    if loop.seeds.size:
        inside = (loop.seeds > loop.low) & (loop.seeds < loop.high)
        x = np.unique(np.concatenate([x, loop.seeds[inside]]))
    values = loop(x)
    levels = _PATIENCE if loop.delayed else ((0.0, POINT_LIMIT),)
    for quiet, limit in levels:
        refined = _refined(loop, x, values, quiet, limit, turn)
        if refined is not None:
            return *refined, quiet
    raise FieldError(
        "limit",
        math.exp(loop.high),
        "too high for a response that keeps turning",
        f"at most {POINT_LIMIT} points of the response",
        "give limit=, the highest frequency of interest in rad/s",
    )


def _refined(
    loop: SampledLoop, x: Real, values: Complex, quiet: float, limit: int, turn: float
) -> tuple[Real, Complex] | None:
    while (wide := _too_wide(loop, x, values, quiet, turn)).size:
        if x.size + wide.size > limit:
            return None
        middle = 0.5 * (x[wide] + x[wide + 1])
        x = np.insert(x, wide + 1, middle)
        values = np.insert(values, wide + 1, loop(middle))
    return x, values


def _too_wide(
    loop: SampledLoop, x: Real, values: Complex, quiet: float, turn: float
) -> NDArray[np.intp]:
    """Intervals to halve: ln L changes too much, or 1 + L by more than its modulus."""
    change = np.log(values[1:] / values[:-1])
    fine = np.abs(change) <= turn
    # A chord shorter than the distance of its ends from −1 cannot hide an encirclement
    # of −1.
    away = np.abs(1 + values)
    fine &= np.abs(np.diff(values)) <= np.minimum(away[1:], away[:-1])
    width = np.diff(x)
    if quiet:
        # A delay may turn the phase by 2π within a wide interval, which then looks
        # constant; but its neighbour was refined in that case.
        fine[1:] &= width[1:] < 2.1 * width[:-1]
        fine[:-1] &= width[:-1] < 2.1 * width[1:]
        loud = np.abs(values) > quiet
        fine |= ~(loud[1:] | loud[:-1] | (x[:-1] < loop.follow))
    return np.flatnonzero(~fine & (width > COINCIDENT))


# --- Frequencies for plots and for python-control: even on a logarithmic scale, finer where L moves fast

_DECADES = math.log(100.0)


def frequency_grid(
    loop: FractionalTransferFunction | Callable[[Complex], Complex],
    *,
    limit: float | None = None,
) -> Real:
    """Return frequencies [rad/s] for plotting a loop: 300 evenly spaced ones and those
    where it changes fast.

    The range is two decades beyond the corners of a transfer function; for a callable
    it is 1e-6 … 1e6 rad/s, with the straight ends of the Bode plot cut to one decade
    each. `limit` [rad/s] is the highest frequency.

    >>> from fracsys._fractional import s
    >>> w = frequency_grid(100 / (s**2 + 0.02 * s + 100))
    >>> bool(np.min(np.diff(np.log(w))) < 1e-3 and w[0] < 1 and w[-1] > 100)
    True
    """
    sampled = as_loop(loop, limit)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if sampled.system is not None:
            low, high = sampled.span[0] - _DECADES, sampled.span[1] + _DECADES
            if limit is not None:
                high = min(high, math.log(limit))
            sampled = replace(sampled, low=min(low, high - _DECADES), high=high)
        # A chord over 0.2 rad leaves its arc by 0.5 % of the radius: less than the width
        # of a line.
        x, values, _ = sweep(sampled, 0.2)
        if sampled.system is None:
            x, values = _bent(x, values, keep_top=limit is not None)
    even = np.linspace(x[0], x[-1], 300)
    # The even points cover the range where the phase turns slowly, the points of the
    # sweep the range where L changes fast.
    grid = np.union1d(even, x[np.isfinite(values)])
    frequencies: Real = np.exp(
        grid[np.concatenate([[True], np.diff(grid) > COINCIDENT])]
    )
    return frequencies


def _bent(x: Real, values: Complex, *, keep_top: bool) -> tuple[Real, Complex]:
    """Cut the ends where d ln L/dx is constant, down to one decade each."""
    slope = np.log(values[1:] / values[:-1]) / np.diff(x)
    # 0.02 is 0.4 dB per decade; a smaller change of slope is not visible in a Bode
    # plot.
    first, last = (
        np.flatnonzero(~(np.abs(slope - slope[end].real) < 0.02)) for end in (0, -1)
    )
    # at higher frequencies the delay turns the phase without end
    loud = np.flatnonzero(np.abs(values) > FAINT)
    end = min(loud[-1:].tolist() + (last[-1:] + 1).tolist(), default=0)
    # a straight line from end to end: show four decades around 1 rad/s
    if not first.size or first[0] >= end:
        inside = np.abs(x) < _DECADES
    else:
        margin = 0.5 * _DECADES
        inside = (x > x[first[0]] - margin) & (keep_top | (x < x[end] + margin))
    return x[inside], values[inside]


# --- Roots inside known brackets, many at once --------------------------------------------------------


def bracketed_roots(
    function: Callable[[Real], Real],
    low: ArrayLike,
    high: ArrayLike,
    ends: tuple[Real, Real] | None = None,
) -> Real:
    """Return the root of a continuous function in each bracket [low, high], to
    rounding.

    The secant method with the value at the retained end halved (Illinois) is
    superlinear and cannot stall at one end; a step that would leave its bracket is
    replaced by a bisection.

    Parameters
    ----------
    function
        elementwise over an array of the shape of `low`; of opposite sign (or zero) at
        the two ends.
    low, high
        ends of the brackets, of the same shape.
    ends
        values of the function at `low` and `high`, where they are known.

    Examples
    --------
    >>> bracketed_roots(lambda x: x**2 - np.array([2.0, 3.0]), [1.0, 1.0], [2.0, 2.0]).round(12).tolist()
    [1.414213562373, 1.732050807569]
    """
    a, b = np.array(low, float), np.array(high, float)
    at_a, at_b = ends or (function(a), function(b))
    # A bracket of four units in the last place cannot be narrowed any further.
    size = np.abs(a) + np.abs(b)
    tolerance, settled = 4e-16 * size, np.zeros(a.shape, bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(ROUNDS):
            x = b - at_b * (b - a) / (at_b - at_a)
            inside = (x >= np.minimum(a, b)) & (x <= np.maximum(a, b))
            x = np.where(inside, x, 0.5 * (a + b))
            at_x = function(x)
            stays = (at_x > 0.0) == (at_b > 0.0)  # b moves on, a stays
            a, at_a = np.where(stays, a, b), np.where(stays, 0.5 * at_a, at_b)
            step = np.abs(x - b)
            # Where the rounding of the function exceeds that of x, the sign is random,
            # and the iteration would only wander.
            settled |= (step <= BLUR * size) & (np.abs(at_x) >= np.abs(at_b))
            b, at_b = x, at_x
            if np.all((step <= tolerance) | (at_x == 0.0) | settled):
                break
    return b


# --- Roots and extremes of a response inside their brackets -------------------------------------------


def valleys(values: Real, *, spare: float) -> list[int]:
    """Indices of the inner points not above their neighbours, if below `spare` times
    the least value.

    Every valley that may contain the infimum, not only the lowest point: between two
    points of a sweep a narrow resonance may come closer than at either.
    """
    inner = values[1:-1]
    low = (
        (inner <= values[:-2]) & (inner <= values[2:]) & (inner < spare * values.min())
    )
    return (np.flatnonzero(low) + 1).tolist()


# a function of ln ω, elementwise
Tendency = Callable[[SampledLoop, Real], Real]


def gain_level(loop: SampledLoop, x: Real) -> Real:
    """ln |L|, finite even at a pole or zero on the axis, which counts as e^±745, the
    range of doubles.
    """
    return np.clip(np.log(np.abs(loop(x))), -745.0, 745.0)


def phase_level(loop: SampledLoop, x: Real) -> Real:
    """arg(−L)."""
    return np.angle(-loop(x))


def gain_slope(loop: SampledLoop, x: Real) -> Real:
    """d ln |L|/d ln ω."""
    return loop.slope(x).real


def phase_slope(loop: SampledLoop, x: Real) -> Real:
    """d arg L/d ln ω."""
    return loop.slope(x).imag


def modulus_slope(loop: SampledLoop, x: Real) -> Real:
    """½ d|1 + L|²/d ln ω."""
    value = loop(x)
    return ((1 + value).conj() * value * loop.slope(x)).real


def zeros_of(
    loop: SampledLoop, tendency: Tendency, brackets: list[tuple[float, float]]
) -> list[tuple[float, complex]]:
    """ln ω of a zero of `tendency` in each bracket, and L there; the better end if
    there is no change of sign.

    A crossing is a zero of the level, an extreme is a zero of the slope.
    """
    if not brackets:
        return []
    a, b = np.array(brackets).T
    at_a, at_b = tendency(loop, a), tendency(loop, b)
    # Without a change of sign the extreme is at an end of the bracket, or the slope
    # next to a pole on the axis is not a number.
    x = np.where(np.abs(at_a) < np.abs(at_b), a, b)
    changes = at_a * at_b < 0
    x[changes] = bracketed_roots(
        lambda x: tendency(loop, x),
        a[changes],
        b[changes],
        (at_a[changes], at_b[changes]),
    )
    return list(zip(x.tolist(), loop(x).tolist(), strict=True))
