"""Arrays of intervals and of complex discs that contain every value, including
rounding.

The relative error of one IEEE operation is at most 2^-50 (the worst case is a complex
quotient), and numpy's elementary functions are accurate to a few units in the last
place. Every result is widened by at least `ROUNDING` of its size, four times 2^-50. The
proof does not rest on these bounds, since the checker recomputes every leaf.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fracsys.checks import Complex, Mask, Real

__all__ = ["ROUNDING", "Disc", "Span"]

ROUNDING = 2.0**-48


class Span:
    """Arrays of real intervals, given by their ends."""

    __slots__ = ("high", "low")

    def __init__(self, low: Real, high: Real) -> None:
        self.low, self.high = low, high

    @staticmethod
    def around(first: Real, second: Real) -> Span:
        """The intervals between computed ends, in either order, widened by their
        rounding.
        """
        low, high = np.minimum(first, second), np.maximum(first, second)
        # Rounded outwards on both sides: an interval that is slightly too wide costs a
        # leaf, one that is too narrow invalidates the proof.
        return Span(
            low - 4 * ROUNDING * np.abs(low), high + 4 * ROUNDING * np.abs(high)
        )

    @property
    def middle(self) -> Real:
        """Midpoints."""
        return 0.5 * (self.low + self.high)

    def inverse(self) -> Span:
        """1/x of positive intervals."""
        return Span.around(1.0 / self.high, 1.0 / self.low)

    def disc(self) -> Disc:
        """The discs about the midpoints that contain the intervals."""
        middle = self.middle
        # The midpoint is rounded, so the two halves differ; the larger one covers both
        # ends.
        half = np.maximum(self.high - middle, middle - self.low)
        return Disc(middle, half * (1 + ROUNDING) + ROUNDING * np.abs(middle))


class Disc:
    """Discs |z − c| <= r; an infinite radius means the whole plane. `d`: their slopes,
    by variable.
    """

    __slots__ = ("c", "d", "r")

    def __init__(
        self,
        centre: Complex | Real | complex,
        radius: Real | float = 0.0,
        slopes: Slopes | None = None,
    ) -> None:
        self.c, self.r, self.d = np.asarray(centre), np.asarray(radius), slopes or {}

    @property
    def plain(self) -> Disc:
        """The discs without their slopes."""
        return Disc(self.c, self.r)

    def __add__(self, other: Disc | complex) -> Disc:
        other = other if isinstance(other, Disc) else Disc(other)
        centre = self.c + other.c
        # Relative to the terms, which is cautious: the rounding of a sum is relative to
        # the sum, which is smaller where the terms cancel.
        rounding = ROUNDING * (np.abs(self.c) + np.abs(other.c))
        slopes = dict(self.d)
        for name, slope in other.d.items():
            slopes[name] = slopes[name] + slope if name in slopes else slope
        return Disc(centre, (self.r + other.r) * (1 + ROUNDING) + rounding, slopes)

    def __neg__(self) -> Disc:
        return Disc(-self.c, self.r, {name: -slope for name, slope in self.d.items()})

    def __sub__(self, other: Disc | complex) -> Disc:
        return self + (-other)

    def __rsub__(self, other: complex) -> Disc:
        return -self + other

    def __mul__(self, other: Disc | Real | complex) -> Disc:
        other = other if isinstance(other, Disc) else Disc(other)
        size, by = np.abs(self.c), np.abs(other.c)
        # (|a| + r)(|b| + s) − |a||b|: the largest distance of the product of two points
        # from the product of the centres.
        radius = (size + self.r) * other.r + by * self.r + 2 * ROUNDING * size * by
        slopes = {name: slope * other.plain for name, slope in self.d.items()}
        for name, slope in other.d.items():
            part = slope * self.plain
            slopes[name] = slopes[name] + part if name in slopes else part
        return Disc(self.c * other.c, radius * (1 + 2 * ROUNDING), slopes)

    __radd__, __rmul__ = __add__, __mul__

    def inverse(self) -> Disc:
        """1/z; the whole plane for a disc that contains zero.

        The image of a disc is the disc of centre c*/(|c|² − r²) and radius r/(|c|² −
        r²). The closer the disc comes to zero, the larger the relative rounding error
        of |c|² − r².
        """
        # The divisor |c|² − r² cancels where the disc nearly contains zero. A disc
        # whose margin is below twice the rounding of the difference counts as
        # containing it, so that `share` stays of the order of one.
        square = np.abs(self.c) ** 2
        room = square - self.r**2
        rounding = 8 * ROUNDING * (square + self.r**2)
        clear = room > 2 * rounding
        room = np.where(clear, room, 1.0)
        share = np.where(clear, 2 * rounding / room + 8 * ROUNDING, 0.0)
        centre = np.where(clear, np.conj(self.c) / room, 0.0)
        disc = Disc(
            centre,
            np.where(
                clear, self.r / room * (1 + share) + share * np.abs(centre), np.inf
            ),
        )
        slopes = {name: -(slope * disc * disc) for name, slope in self.d.items()}
        return Disc(disc.c, disc.r, slopes)

    def exp(self) -> Disc:
        """e^z: |e^(c + h) − e^c| <= |e^c| (e^|h| − 1)."""
        centre = np.exp(self.c)
        # The library's exponential is accurate to a few units in the last place; |c|
        # times as much is added for the rounding of its argument.
        disc = Disc(
            centre,
            np.abs(centre) * (np.expm1(self.r) + ROUNDING * (1 + np.abs(self.c))),
        )
        return Disc(
            disc.c, disc.r, {name: slope * disc for name, slope in self.d.items()}
        )

    def closer(self, middle: Disc, steps: Mapping[str, Real]) -> Disc:
        """The smaller of each disc and the one about the value at the middle of the
        variables, whose radius follows from the slopes.

        `steps`: largest distance of each variable from its middle.
        """
        # Mean value theorem along each variable: the slopes hold over the whole box,
        # which is convex. This is the tighter bound where a variable occurs several
        # times, since term by term each occurrence adds its own width.
        reach = sum(
            (slope.most() * steps[name] for name, slope in self.d.items()), np.zeros(())
        )
        radius = (middle.r + reach) * (1 + 8 * ROUNDING)
        smaller = radius < self.r
        return Disc(
            np.where(smaller, middle.c, self.c),
            np.where(smaller, radius, self.r),
            self.d,
        )

    def placed(self, where: Mask) -> Disc:
        """The discs, in their order, at the places where the flag is set, and zero at
        all others.
        """
        centre, radius = np.zeros(where.shape, complex), np.zeros(where.shape)
        centre[where], radius[where] = self.c, self.r
        return Disc(
            centre,
            radius,
            {name: slope.placed(where) for name, slope in self.d.items()},
        )

    def most(self) -> Real:
        """Upper bound of |z|."""
        return (np.abs(self.c) + self.r) * (1 + ROUNDING)


Slopes = dict[str, Disc]
