"""Brackets of every crossing and of the modulus margin, from a swept response."""

from __future__ import annotations

import cmath
import math

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.stability.polish import extreme, gain_level, modulus_slope, phase_level, polish
from fraclink._systems.stability.results import GainCrossing, PhaseCrossing
from fraclink._systems.stability.sweep import Loop

__all__ = ["crossings", "modulus_margin"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]
Bracket = tuple[float, float, float, float]  # ln ω at both ends, and the function there

_FLAT = 1e-12  # rad: a phase of −180° at every frequency (1/s²) crosses nothing; this is its rounding


def crossings(
    loop: Loop, x: Real, values: Complex, quiet: float
) -> tuple[tuple[GainCrossing, ...], tuple[PhaseCrossing, ...]]:
    """Every gain crossing and every phase crossing where |L| > `quiet`, polished."""
    level, turn = np.log(np.abs(values)), np.angle(-values)
    turn[np.abs(turn) < _FLAT] = 0.0
    gain = []
    for bracket in _brackets(loop, "gain", x, level, np.isfinite(level)):
        root, value = polish(loop, gain_level, *bracket)
        frequency, margin = math.exp(root), cmath.phase(-value)
        gain.append(GainCrossing(frequency, margin, (margin % (2 * math.pi)) / frequency))
    phase = []
    for bracket in _brackets(loop, "phase", x, turn, _followed(loop, x, values, turn, quiet)):
        root, value = polish(loop, phase_level, *bracket)
        phase.append(PhaseCrossing(math.exp(root), 1 / abs(value)))
    return tuple(gain), tuple(phase)


def _followed(loop: Loop, x: Real, values: Complex, turn: Real, quiet: float) -> NDArray[np.bool_]:
    """Points near the negative real axis whose phase was followed there."""
    near = np.abs(turn) < 0.5 * math.pi
    if quiet:
        near &= (np.abs(values) > quiet) | (x <= loop.follow)
    return near


def _brackets(loop: Loop, kind: str, x: Real, y: Real, usable: Mask) -> list[Bracket]:
    """Changes of sign, and the pairs of them that hide around an extreme that almost touches zero."""
    place = np.flatnonzero(usable & (y != 0))
    here = y[place]
    if here.size < 2:
        return []
    # One zero between two signs is a root that a point of the grid hit; a run of them is a flat response.
    gap = np.diff(place)
    whole = (gap == 1) | ((gap == 2) & usable[np.minimum(place[:-1] + 1, len(x) - 1)])
    change = np.flatnonzero(((here[1:] > 0) != (here[:-1] > 0)) & whole)
    found = [_bracket(x, y, place[i], place[i + 1]) for i in change]
    for i in _near_touches(place, here):
        found += _hidden(loop, kind, _bracket(x, y, place[i - 1], place[i + 1]))
    return sorted(found)


def _bracket(x: Real, y: Real, i: int, j: int) -> Bracket:
    return float(x[i]), float(x[j]), float(y[i]), float(y[j])


def _hidden(loop: Loop, kind: str, around: Bracket) -> list[Bracket]:
    a, b, at_a, at_b = around
    level = gain_level if kind == "gain" else phase_level
    x, value = extreme(loop, lambda v, s: level(v, s)[1], a, b)
    reached = level(value, 0j)[0]
    return [(a, x, at_a, reached), (x, b, reached, at_b)] if reached * at_a < 0 else []


def _near_touches(place: Index, y: Real) -> list[int]:
    """Indices of extremes nearer to zero than the steps beside them, with neighbours of the same sign."""
    size, step = np.abs(y), np.abs(np.diff(y))
    inner = size[1:-1]
    close = (inner <= size[:-2]) & (inner <= size[2:]) & (inner < np.maximum(step[:-1], step[1:]))
    if not close.any():
        return []
    same = (y[:-2] * y[1:-1] > 0) & (y[1:-1] * y[2:] > 0) & (place[2:] - place[:-2] == 2)
    return (np.flatnonzero(same & close) + 1).tolist()


def modulus_margin(loop: Loop, x: Real, values: Complex) -> tuple[float, float]:
    """inf |1 + L| and its frequency [rad/s], 0 or inf where it is approached and not reached."""
    distance = np.abs(1 + values)
    distance[np.isnan(distance)] = math.inf
    best = int(np.argmin(distance))
    inner = distance[1:-1]
    # The sweep lets 1 + L move by its own size from point to point: part of that may still be lost.
    low = (inner <= distance[:-2]) & (inner <= distance[2:]) & (inner < 3 * distance[best])
    smallest, at = float(distance[best]), float(x[best])
    for i in (np.flatnonzero(low) + 1).tolist():
        place, value = extreme(loop, modulus_slope, float(x[i - 1]), float(x[i + 1]))
        if abs(1 + value) <= smallest:
            smallest, at = abs(1 + value), place
    frequency = math.exp(at)
    # A distance that falls towards an end of the axis has its infimum there and nowhere on the way.
    for limit, place in zip(loop.ends, (0.0, math.inf), strict=True):
        if abs(1 + limit) < smallest:
            smallest, frequency = abs(1 + limit), place
    return smallest, frequency
