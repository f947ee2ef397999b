"""Bisection until every box is proved, or the place where a box cannot be."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fraclink._certify.balls import Ball, Disc, Loop, Window, outside

__all__ = ["Box", "Failure", "Proof", "clear", "halves", "prove", "widest_side"]

Box = tuple[float, float, float, float, float, float]  # ω, payload, delay: low and high of each
_DEPTH = 60
# Near the motor loop's resonance X is small and blurred; until it is sharp no other cut helps.
_SHARP = 100.0
_SLACK = 1.0 + 1e-3  # proved a little more than claimed, so that other arithmetic confirms the same leaves


@dataclass(frozen=True)
class Proof:
    """A tree that covers the box: one letter a node in preorder; w, m, t split, "." is a leaf."""

    tree: str
    leaves: int
    nodes: int


@dataclass(frozen=True)
class Failure:
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


def prove(loop: Loop, *, most: int = 200_000) -> Proof | Failure:
    """Bisect the statement's box until every leaf is proved, or give up at `most` nodes and say where."""
    s = loop.statement
    if not loop.correction_is_stable():
        return Failure(
            "a pole of the law's correction lies outside the unit circle", 0.0, s.payload_low, s.delay_low
        )
    if not loop.inner_is_stable():
        return Failure(
            "the sampled motor loop is not stable for every delay", 0.0, s.payload_low, s.delay_high
        )
    if not loop.low_bound() < 1.0 - s.modulus:
        return Failure("the loop gain is not small at low frequency", s.lowest, s.payload_low, s.delay_low)
    nyquist = math.nextafter(math.pi / float(loop.period.mid()), math.inf)
    root: Box = (s.lowest, nyquist, s.payload_low, s.payload_high, s.delay_low, s.delay_high)
    windows: dict[tuple[float, float], Window] = {}
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
            return Failure("the bound is not met", *(0.5 * (box[i] + box[i + 1]) for i in (0, 2, 4)))
        side = widest_side(loop, box, window, value)
        letters.append("wmt"[side])
        first, second = halves(box, side)
        stack += [(second, depth + 1), (first, depth + 1)]
    return Proof("".join(letters), leaves, len(letters))


def _proved(value: Disc, size: Ball, modulus: float) -> bool:
    """A leaf: |L| < 1 - m, or the rectangle of 1/L is clear."""
    if size.is_finite() and outside(size)[0] * (1.0 - modulus) > 1.0:
        return True
    return value.is_finite() and clear(outside(value.real), outside(value.imag), modulus)


def widest_side(loop: Loop, box: Box, window: Window, value: Disc) -> int:
    if not value.is_finite():
        return 0
    from_w, from_t = loop.closing_spread(window, box[4:6]) if loop.sampled else (0.0, 0.0)
    scale = float(abs(window.factor).mid())
    swing = scale * float(abs(window.inertia).mid()) * 0.5 * (box[2] + box[3])
    return _split(box, (float(abs(value).mid()), swing), (from_w, from_t))
