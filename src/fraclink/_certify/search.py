"""Bisection until every box is proved: the distance from -1, or the phase margin.

``φ_m >= φ`` holds for every payload if no box has both ``|L| >= 1`` and ``|arg(-L)| < φ``: on each box
|1/L| > 1, or the rectangle around 1/L misses the sector of half-angle φ about the negative real axis.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._certify.balls import Ball, BallLoop, BallWindow, Disc, outside
from fraclink._certify.numeric import loop_values
from fraclink._certify.statement import Statement
from fraclink._law import Law
from fraclink._systems.sweep import bracketed_roots
from fraclink._validate import checked_between, checked_noun, checked_whole

__all__ = [
    "Box",
    "Enclosure",
    "MarginFailure",
    "MarginProof",
    "clear",
    "enclose_phase_margin",
    "halves",
    "prove",
]

Real = NDArray[np.float64]
Windows = dict[tuple[float, float], BallWindow]
Box = tuple[float, float, float, float, float, float]  # ω, payload, delay: low and high of each
_DEPTH = 60
# Near the motor loop's resonance X is small and blurred; until it is sharp no other cut helps.
_SHARP = 100.0
_SLACK = 1.0 + 1e-3  # proved a little more than claimed, so that other arithmetic confirms the same leaves


@dataclass(frozen=True)
class MarginProof:
    """A tree that covers the box: one letter a node in preorder; w, m, t split, "." is a leaf."""

    tree: str
    leaves: int
    nodes: int


@dataclass(frozen=True)
class MarginFailure:
    """The middle of the box at which the proof stopped."""

    reason: str
    frequency: float
    payload: float
    delay: float


def clear(real: tuple[float, float], imaginary: tuple[float, float], modulus: float) -> bool:
    """Whether a rectangle of 1/L stays clear of what |1 + L| <= modulus and L <= -1 make of it.

    |1 + 1/L| > m |1/L| excludes the disc of centre -1/(1-m²) and radius m/(1-m²); L in (-∞, -1] is 1/L in
    [-1, 0).

    >>> clear((0.1, 2.0), (-1.0, 1.0), 0.5), clear((-2.0, -0.5), (0.1, 1.0), 0.5)
    (True, False)
    """
    if modulus >= 1.0:
        return False
    on_axis = imaginary[0] <= 0.0 <= imaginary[1]
    if on_axis and not (real[1] < -1.0 or real[0] > 0.0):
        return False
    centre, radius = -1.0 / (1.0 - modulus**2), modulus / (1.0 - modulus**2)
    across = max(0.0, imaginary[0], -imaginary[1])
    along = max(0.0, real[0] - centre, centre - real[1])
    return across * across + along * along > radius * radius * (1.0 + 1e-12)


def _split(box: Box, value: tuple[float, float], closing: tuple[float, float]) -> int:
    """The side whose width moves 1/L most: 0 frequency, 1 payload, 2 delay."""
    w0, w1, m0, m1, t0, t1 = box
    size, swing = value
    ratio = (w1 - w0) / (w0 + w1)
    along_w = ratio * (2.0 * swing + 3.0 * size) + _SHARP * closing[0] * size
    along_m = (m1 - m0) / (m0 + m1) * swing
    along_t = 0.5 * (t1 - t0) * w1 * size + _SHARP * closing[1] * size
    return max(range(3), key=(along_w, along_m, along_t).__getitem__)


def halves(box: Box, side: int) -> tuple[Box, Box]:
    """A box cut in two: frequencies at their geometric mean, payloads and delays in the middle."""
    low, high = box[2 * side], box[2 * side + 1]
    middle = math.sqrt(low * high) if side == 0 else 0.5 * (low + high)
    first, second = list(box), list(box)
    first[2 * side + 1] = second[2 * side] = middle
    return (*first,), (*second,)  # type: ignore[return-value]


def prove(loop: BallLoop, *, most: int = 200_000) -> MarginProof | MarginFailure:
    """Bisect the statement's box until every leaf is proved, or give up at `most` nodes and say where."""
    s = loop.statement
    if not loop.correction_is_stable():
        return MarginFailure(
            "a pole of the law's correction lies outside the unit circle", 0.0, s.payload_low, s.delay_low
        )
    if not loop.inner_is_stable():
        return MarginFailure(
            "the sampled motor loop is not stable for every delay", 0.0, s.payload_low, s.delay_high
        )
    if not loop.low_bound() < 1.0 - s.modulus:
        return MarginFailure(
            "the loop gain is not small at low frequency", s.lowest, s.payload_low, s.delay_low
        )
    nyquist = math.nextafter(math.pi / float(loop.period.mid()), math.inf)
    root: Box = (s.lowest, nyquist, s.payload_low, s.payload_high, s.delay_low, s.delay_high)
    windows: dict[tuple[float, float], BallWindow] = {}
    stack, letters, leaves = [(root, 0)], [], 0
    while stack:
        box, depth = stack.pop()
        window = windows.get(box[:2])
        if window is None:
            window = windows[box[:2]] = loop.window(*box[:2])
        value, size, alias = loop.inverse(window, box[2:4], box[4:6])
        if _proved(value, size, s.modulus * _SLACK + alias):
            letters.append(".")
            leaves += 1
            continue
        if depth == _DEPTH or len(letters) >= most:
            return MarginFailure("the bound is not met", *(0.5 * (box[i] + box[i + 1]) for i in (0, 2, 4)))
        side = widest_side(loop, box, window, value)
        letters.append("wmt"[side])
        first, second = halves(box, side)
        stack += [(second, depth + 1), (first, depth + 1)]
    return MarginProof("".join(letters), leaves, len(letters))


def _proved(value: Disc, size: Ball, modulus: float) -> bool:
    """A leaf: |L| < 1 - m, or the rectangle of 1/L is clear."""
    if size.is_finite() and outside(size)[0] * (1.0 - modulus) > 1.0:
        return True
    return value.is_finite() and clear(outside(value.real), outside(value.imag), modulus)


def widest_side(loop: BallLoop, box: Box, window: BallWindow, value: Disc) -> int:
    if not value.is_finite():
        return 0
    from_w, from_t = loop.closing_spread(window, box[4:6]) if loop.sampled else (0.0, 0.0)
    scale = float(abs(window.factor).mid())
    swing = scale * float(abs(window.inertia).mid()) * 0.5 * (box[2] + box[3])
    return _split(box, (float(abs(value).mid()), swing), (from_w, from_t))


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


def _keeps_margin(loop: BallLoop, windows: Windows, box: Box, margin: float) -> Disc | None:
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
    loop: BallLoop, margin: float, windows: dict[tuple[float, float], BallWindow], most: int
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
        value = _keeps_margin(loop, windows, box, margin)
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
    loop = BallLoop(statement, law.coefficients)
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
