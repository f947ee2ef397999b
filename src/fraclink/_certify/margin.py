"""An enclosure of the worst phase margin over a range of payloads, in ball arithmetic.

``φ_m >= φ`` holds for every payload if no box has both ``|L| >= 1`` and ``|arg(-L)| < φ``: on each box
|1/L| > 1, or the rectangle around 1/L misses the sector of half-angle φ about the negative real axis.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._certify.balls import Disc, Loop, Window, outside
from fraclink._certify.numeric import loop_values
from fraclink._certify.search import Box, halves, widest_side
from fraclink._certify.statement import Statement
from fraclink._law import Law
from fraclink._systems.brackets import bracketed_roots
from fraclink._validate import checked_between, checked_noun, checked_whole

__all__ = ["Enclosure", "enclose_phase_margin"]


Real = NDArray[np.float64]
Windows = dict[tuple[float, float], Window]


@dataclass(frozen=True)
class Enclosure:
    """``low <= worst phase margin <= high`` [rad]; `payload` [kg] and `frequency` [rad/s] attain `high`."""

    low: float
    high: float
    payload: float
    frequency: float
    nodes: int


def _misses_sector(real: tuple[float, float], imaginary: tuple[float, float], tangent: float) -> bool:
    """Whether a rectangle holds no point with ``|Im| < -Re·tan φ``, φ < 90°: the widest corner decides."""
    across = max(0.0, imaginary[0], -imaginary[1])
    return real[0] >= 0.0 or across > -real[0] * tangent


def _proved(loop: Loop, windows: Windows, box: Box, margin: float) -> Disc | None:
    """None where the box is proved, else the enclosure of 1/L that was too wide."""
    window = windows.get(box[:2])
    if window is None:
        window = windows[box[:2]] = loop.window(*box[:2])
    value, size, alias = loop.inverse(window, box[2:4], box[4:6])
    if size.is_finite() and outside(size)[0] * (1.0 - alias) > 1.0:
        return None
    # Where |L| >= 1 - a an alias of modulus a turns L by no more than asin(a/(1 - a)) < 2a.
    turned = margin + 2.0 * alias
    if not (value.is_finite() and turned < 0.5 * math.pi):
        return value
    missed = _misses_sector(outside(value.real), outside(value.imag), math.tan(turned))
    return None if missed else value


def holds_everywhere(
    loop: Loop, margin: float, windows: dict[tuple[float, float], Window], most: int
) -> int | None:
    """Number of nodes of a proof that every crossing keeps `margin` [rad] < π/2; None where there is none."""
    s = loop.statement
    nyquist = math.nextafter(math.pi / float(loop.period.mid()), math.inf)
    root: Box = (s.lowest, nyquist, s.payload_low, s.payload_high, s.delay_low, s.delay_high)
    stack = [(root, 0)]
    nodes = 0
    while stack:
        box, depth = stack.pop()
        nodes += 1
        value = _proved(loop, windows, box, margin)
        if value is None:
            continue
        if depth > 50 or nodes > most:
            return None
        cut = widest_side(loop, box, windows[box[:2]], value)
        stack += [(half, depth + 1) for half in halves(box, cut)]
    return nodes


def enclose_phase_margin(
    statement: Statement, law: Law, *, width: float = math.radians(0.01), most: int = 60_000
) -> Enclosure:
    """Enclose the worst phase margin over the statement's payloads and delays to `width` [rad].

    The upper end is attained at a crossing, known to rounding; the lower end is proved by bisection. For
    margins below 90°.
    """
    checked_noun("statement", statement, Statement, remedy="certify(design).statement")
    checked_noun("law", law, Law, remedy="the law that was certified")
    checked_between("width", width, 0.0, 0.5 * math.pi, "rad", open_low=True)
    checked_whole("most", most, 1, 10**9)
    high, payload, frequency = _attained(statement, law)
    loop = Loop(statement, law.coefficients)
    windows: Windows = {}
    nodes = holds_everywhere(loop, high - width, windows, most)
    if nodes is not None:
        return Enclosure(high - width, high, payload, frequency, nodes)
    low, bad = 0.0, high - width
    for _ in range(12):
        middle = 0.5 * (low + bad)
        found = holds_everywhere(loop, middle, windows, most // 4)
        low, bad, nodes = (middle, bad, found) if found is not None else (low, middle, nodes)
    return Enclosure(low, high, payload, frequency, nodes or 0)


def _attained(statement: Statement, law: Law) -> tuple[float, float, float]:
    """(margin, payload, frequency) of the worst falling crossing at the corners of the box."""
    best = (math.pi, statement.payload_low, 0.0)
    mode = (statement.softness * statement.payload_low) ** (-1.0 / statement.order)
    w = np.geomspace(0.3 * mode, min(6.0 * mode, math.pi / law.period), 4000)
    payloads = sorted({statement.payload_low, statement.payload_high})
    delays = sorted({statement.delay_low, statement.delay_high})
    for payload, late in itertools.product(payloads, delays):

        def level(at: Real, payload: float = payload, late: float = late) -> Real:
            return np.asarray(np.log(np.abs(loop_values(statement, law, at, payload, late))))

        loud = np.abs(loop_values(statement, law, w, payload, late)) > 1.0
        for i in np.flatnonzero(loud[:-1] != loud[1:]):
            crossing = float(bracketed_roots(level, w[i], w[i + 1]))
            margin = float(np.abs(np.angle(-loop_values(statement, law, crossing, payload, late))))
            best = min(best, (margin, payload, crossing))
    return best
