"""Branch and bound on the distance from -1, until every box is proved.

A box is proved by a half plane that contains L, or 1/L, and no forbidden value. Along
the plane's normal the loop is bounded by its slopes: a parameter whose slope keeps its
sign is set to its worse end, the others cost half their width times the largest slope.
Many boxes are judged at once.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._certify.discs import ROUNDING, Disc
from fraclink._certify.enclosure import AXES, LEAVES, LETTERS, BoxLoop
from fracsys._precision import ROUNDS
from fracsys.checks import Complex, Mask, Real

__all__ = ["MarginFailure", "prove"]

# The proof is for slightly more than the claim, so that a different arithmetic confirms
# the same leaves.
_SLACK = 1.0 + 1e-6
# Weight of the frequency where the widths decide: near a pole of Ĉ the arc of
# frequencies alone makes F unbounded, and cuts along the other axes do not help. With a
# factor of 3 instead of 8 two proofs take 36 and 48 % more leaves, with 50 as many.
_FIRST = 8.0
_TURNED = (AXES.index("delay"), AXES.index("gauge_delay"))


@dataclass(frozen=True)
class MarginFailure:
    """The place where the proof stopped: the parameters by name, and |1 + L| there;
    `refuted` if it is too small.
    """

    reason: str
    place: dict[str, float]
    distance: float = math.nan

    @property
    def refuted(self) -> bool:
        """Whether the loop is too close there, instead of merely not proved to be far
        enough.
        """
        return math.isfinite(self.distance)


def _unit(value: Complex) -> Complex:
    return value / np.maximum(np.abs(value), 1e-300)


# A half plane Re(n* v) > b must not contain forbidden values: |1 + L| <= m and the ray
# (-∞, -1]; for Y = 1/L these are a disc and the segment from it to 0. `value` is the
# middle of the disc of L or Y; the plane is given by its normal n and its bound b.
def _plane_of_loop(value: Complex, m: Real) -> tuple[Complex, Real]:
    ahead = 1.0 + value
    # To the right of −1 the normal points away from it; to the left straight up or
    # down, since the ray to −∞ is forbidden too.
    normal = np.where(
        ahead.real >= 0.0, _unit(ahead), np.where(ahead.imag >= 0.0, 1j, -1j)
    )
    return normal, m - normal.real


def _plane_of_inverse(value: Complex, m: Real) -> tuple[Complex, Real]:
    # |1 + 1/Y| <= m is |Y + 1| <= m |Y|, the disc (of Apollonius) about -1/(1 - m²)
    # with radius m/(1 - m²). A half plane contains neither the disc nor 0 if b is the
    # larger of their two supports along n.
    centre = 1.0 / (1.0 - m**2)
    straight, away = _unit(value), _unit(value + centre)
    # The hull of the disc and 0 has two straight sides, the tangents from 0: along
    # their normal, whose real part is m, the supports of disc and 0 are both zero.
    kink = m + 1j * np.where(value.imag >= 0.0, 1.0, -1.0) * np.sqrt(1.0 - m**2)
    normal = np.where(
        straight.real >= m, straight, np.where(away.real <= m, away, kink)
    )
    return normal, np.maximum(m * centre - centre * normal.real, 0.0)


def _judge(
    loop: BoxLoop, low: Real, high: Real
) -> tuple[Mask, Mask, NDArray[np.int64], Real, Complex]:
    """For each box (whether it is proved, whether by 1/L, the axis to cut, a point in
    it, L at that point).
    """
    with np.errstate(
        all="ignore"
    ):  # a box that is too wide gives infinities and NaN, which prove nothing
        plain, inverse, alias = loop.forms(low, high)
        # Where |L| < 1 the disc of L is the smaller one, otherwise that of 1/L: at a
        # resonance L may be arbitrarily large, and 1/L is a small disc near 0.
        soft = np.isfinite(plain.r) & (np.abs(plain.c) < 1.0)
        loud = np.isfinite(inverse.r) & ~soft
        limit = loop.statement.modulus + alias
        of_loop = _plane_of_loop(plain.c, limit)
        of_inverse = _plane_of_inverse(inverse.c, np.minimum(limit, 0.999))
        normal, least = (
            np.where(loud, b, a) for a, b in zip(of_loop, of_inverse, strict=True)
        )
        point, loss, weight, gain = _downhill(
            loop.axes, plain, inverse, loud, normal, low, high
        )
        # With the same aliases as the box: the point lies in it, but may lie on the
        # other side of the frequency at which they begin.
        at_plain, at_inverse, _ = loop.forms(point, point, loop.held(low[:, 0]))
        value = np.where(loud, at_inverse.c, at_plain.c)
        radius = np.where(loud, at_inverse.r, at_plain.r)
        distance = (
            (np.conj(normal) * value).real
            - radius
            - 4 * ROUNDING * (1 + np.abs(value))
            - loss
        )
        # Where even exact slopes would not close the gap, no half plane contains the
        # whole box: it is cut along the axis that moves the value most.
        missing = least + (_SLACK - 1.0) - distance
        weight = np.where(
            (missing > np.maximum(weight, 0.0).sum(axis=1))[:, None], gain, weight
        )
        # The half planes are valid for limits below one only.
        bounded = (np.isfinite(plain.r) | np.isfinite(inverse.r)) & (limit < 0.99)
        quiet = plain.most() < 1.0 - limit
        proved = quiet | (bounded & (distance > least + (_SLACK - 1.0)))
        axis = _widest(low, high, weight)
        return proved, loud & ~quiet, axis, point, at_plain.c


def _downhill(
    axes: tuple[str, ...],
    plain: Disc,
    inverse: Disc,
    loud: Mask,
    normal: Complex,
    first: Real,
    second: Real,
) -> tuple[Real, Real, Real, Real]:
    """(point to evaluate, largest loss along the other axes, gain from a cut of each
    axis, and change of the value along each).
    """
    point, loss = 0.5 * (first + second), np.zeros(first.shape[0])
    weight, gain = np.full(first.shape, -1.0), np.full(first.shape, -1.0)
    for name in axes:
        k = AXES.index(name)
        a, b = plain.d[name], inverse.d[name]
        slope = Disc(np.where(loud, b.c, a.c), np.where(loud, b.r, a.r))
        along = (np.conj(normal) * slope.c).real
        spread = slope.r * (1 + ROUNDING) + 4 * ROUNDING * np.abs(slope.c)
        width = second[:, k] - first[:, k]
        # If the slope along the normal keeps its sign over the box, the worse end is
        # the minimum and causes no loss.
        fixed = np.abs(along) >= spread
        point[:, k] = np.where(
            fixed, np.where(along >= 0.0, first[:, k], second[:, k]), point[:, k]
        )
        steep = np.abs(along) + spread
        # half the width on either side of the middle, plus the rounding of the middle
        # itself
        cost = (
            0.5 * width * (1 + 4 * ROUNDING) + 4 * ROUNDING * np.abs(second[:, k])
        ) * steep
        # a zero width causes no loss, whatever the slope
        loss = loss + np.where(fixed | (width == 0.0), 0.0, cost)
        # With a slope of fixed sign a cut can only gain the spread of the slope.
        weight[:, k] = np.where(
            width > 0.0, width * np.where(fixed, spread, steep), -1.0
        )
        gain[:, k] = np.where(width > 0.0, width * slope.most(), -1.0)
    return point, loss, weight, gain


def _widest(low: Real, high: Real, weight: Real) -> NDArray[np.int64]:
    """The axis to cut: the one along which the slopes leave the largest uncertainty, or
    the widest one where they are unknown.
    """
    width = high - low
    relative = width / np.maximum(np.abs(high), 1e-300)
    # Where nothing is bounded yet, the widths decide; for a delay it is the width of
    # the angle ω τ.
    relative[:, 0] *= _FIRST
    for axis in _TURNED:
        relative[:, axis] = width[:, axis] * high[:, 0]
    unknown = ~np.isfinite(weight) & (width > 0.0)
    some = np.any(unknown, axis=1, keepdims=True)
    best = np.where(some, np.where(unknown, relative, -1.0), weight)
    return np.argmax(best, axis=1)


def cut(low: Real, high: Real, axis: NDArray[np.int64]) -> tuple[Real, Real]:
    """Halve boxes: frequencies at their geometric mean, all other axes in the middle;
    first halves come first.
    """
    rows = np.arange(low.shape[0])
    a, b = low[rows, axis], high[rows, axis]
    # The loop varies per octave of frequency, and the checker cuts in the same way. The
    # mean matters for the first cuts only: with the arithmetic mean four claims take
    # between 3 % fewer and 2 % more leaves.
    middle = np.where(axis == 0, np.sqrt(a * b), 0.5 * (a + b))
    top, bottom = high.copy(), low.copy()
    top[rows, axis] = bottom[rows, axis] = middle
    return np.concatenate([low, bottom]), np.concatenate([top, high])


def prove(loop: BoxLoop, *, most: int) -> str | MarginFailure:
    """Cut the box of the statement until every leaf is proved, or give up at `most`
    nodes and report the place.

    The proof is a tree that covers the box: one letter per node in preorder, for an
    axis to cut along or for a leaf. The box is cut generation by generation, and the
    letters are put into preorder at the end.
    """
    corner = loop.place(np.array([loop.low[name] for name in AXES]))
    if not all(abs(pole) < 1.0 for pole, _ in loop.modes):
        # The tree proves that the curve keeps away from −1; for stability the poles of
        # the law itself must lie inside the unit circle, too.
        return MarginFailure(
            "a pole of the law's correction lies outside the unit circle", corner
        )
    # One end is enough for the proof; the others tell in a millisecond why there is none.
    ends = ((loop.low[name], loop.high[name]) for name in ("delay", "motor"))
    for delay, motor in itertools.product(*ends):
        if not loop.inner_is_stable(delay, motor):
            return MarginFailure(
                "the sampled motor loop is not stable",
                corner | {"delay": delay, "motor": motor},
            )
    # Negated, so that a bound of NaN or infinity ends here as well.
    if not loop.low_bound() < 1.0 - loop.statement.modulus:
        return MarginFailure("the loop gain is not small at low frequency", corner)

    low, high = loop.root()
    generations: list[NDArray[np.int64]] = []
    nodes = 0
    while low.size:
        low, high, possible = loop.possible(low, high)
        proved, loud, axis, point, value = _judge(loop, low, high)
        nodes += low.shape[0]
        # A point of the box whose value violates the claim ends the search: further
        # cuts cannot help.
        wrong = possible & (np.abs(1.0 + value) < loop.statement.modulus)
        wrong &= loop.possible(point, point)[2]
        if wrong.any():
            k = int(np.argmin(np.where(wrong, np.abs(1.0 + value), np.inf)))
            return MarginFailure(
                "the loop is too close",
                loop.place(point[k]),
                float(abs(1.0 + value[k])),
            )
        rest = possible & ~proved
        leaves = np.where(loud, len(AXES) + 1, len(AXES))
        generations.append(np.where(rest, axis, leaves))
        # After so many cuts of one axis both ends are the same double.
        if rest.any() and (nodes > most or len(generations) > ROUNDS):
            k = int(np.argmax(rest))
            middle = 0.5 * (low[k] + high[k])
            return MarginFailure("the bound is not met", loop.place(middle))
        low, high = cut(low[rest], high[rest], axis[rest])
    return _preorder(generations)


def _preorder(generations: list[NDArray[np.int64]]) -> str:
    """Letters in preorder, from one row of axes per generation with all first halves
    before all second halves.
    """
    below: list[str] = []
    for axes in reversed(generations):
        cuts, count, text = 0, int(np.count_nonzero(axes < len(AXES))), []
        for axis in axes:
            if axis >= len(AXES):
                text.append(LEAVES[axis - len(AXES)])
            else:
                text.append(LETTERS[axis] + below[cuts] + below[count + cuts])
                cuts += 1
        below = text
    return below[0]
