"""Sums of exponentials and quasi-polynomials: values without overflow, certified
numbers of zeros.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from fracsys._terms import Complexes, Reals, Term
from fracsys.errors import FieldError, NotConvergedError

# relative to Σ|terms|: 40 units in the last place, for six terms of three roundings
# each
ROUNDING = 1e-14
PIECE_LIMIT = (
    20_000  # intervals of one walk; a line that needs more passes through a zero
)


class NearZeroError(NotConvergedError):
    """A path of the argument principle passes too close to a zero; the caller moves the
    path.
    """

    def __init__(self, pieces: int) -> None:
        super().__init__(
            "phase along the path",
            reached=pieces,
            wanted=PIECE_LIMIT,
            remedy="move the path off the zero",
        )


@dataclass(frozen=True)
class ExponentialSum:
    """D(z) = Σ a_k e^(ν_k z) with real a_k ≠ 0 and 0 = ν_0 < ν_1 < …; every value is
    scaled to be finite.
    """

    coefficients: Reals
    rates: Reals

    @classmethod
    def of(cls, coefficients: ArrayLike, orders: ArrayLike) -> ExponentialSum:
        """Merge equal orders, drop zero coefficients and divide by the lowest power of
        s.
        """
        a = np.atleast_1d(np.asarray(coefficients, dtype=float))
        nu = np.atleast_1d(np.asarray(orders, dtype=float))
        if a.shape != nu.shape or a.ndim != 1:
            raise FieldError(
                "orders",
                f"{nu.shape} orders for {a.shape} coefficients",
                "of another shape",
                allowed="one order for each coefficient",
                remedy="give two lists of the same length",
            )
        for field, values in (("coefficients", a), ("orders", nu)):
            if not np.all(np.isfinite(values)):
                raise FieldError(
                    field,
                    values.tolist(),
                    "not finite",
                    allowed="finite numbers",
                    remedy="remove NaN and inf",
                )
        # To the bit, other than `collect` in terms.py: what comes from a transfer
        # function is merged already.
        nu, index = np.unique(nu, return_inverse=True)
        merged = np.zeros_like(nu)
        np.add.at(merged, index, a)
        nu, merged = nu[merged != 0], merged[merged != 0]
        if merged.size == 0:
            raise FieldError(
                "coefficients",
                a.tolist(),
                "zero everywhere",
                allowed="at least one coefficient that is not zero",
                remedy="check the signs: the terms cancel",
            )
        return cls(merged, nu - nu[0])

    @cached_property
    def _logs(self) -> Reals:
        return np.log(np.abs(self.coefficients))

    @cached_property
    def _signs(self) -> Reals:
        return np.sign(self.coefficients)

    def terms(self, z: Complexes) -> tuple[Complexes, Reals]:
        """All terms at each z, shape (K, *z.shape), divided by the largest one, and
        their sum of moduli.
        """
        column = (-1, *[1] * np.ndim(z))
        exponents = np.asarray(
            self._logs.reshape(column) + np.multiply.outer(self.rates, z), dtype=complex
        )
        # The zeros of D do not depend on its size: s^6 at 1e100 rad/s would leave the
        # range of doubles, its share of the largest term does not.
        exponents -= exponents.real.max(axis=0)
        terms = np.asarray(self._signs.reshape(column) * np.exp(exponents))
        moduli: Reals = np.abs(terms).sum(axis=0)
        return terms, moduli

    def derivatives(self, z: Complexes, count: int) -> tuple[Complexes, Reals]:
        """D, D', …, D^(count−1) at z divided by the largest term, and the sums of
        moduli of each.
        """
        terms = self.terms(z)[0]
        powers = self.rates ** np.arange(count)[:, None]
        values: Complexes = np.einsum("jk,k...->j...", powers, terms)
        moduli: Reals = np.einsum("jk,k...->j...", powers, np.abs(terms))
        return values, moduli

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """Two real parts between which every zero lies: beyond them one term exceeds
        twice the others.
        """
        a, nu = self._logs, self.rates
        # Each other term below 1/(2K) of the dominant one: a sufficient and cheap form
        # of the condition.
        spare = np.log(2.0 * len(a))
        low = np.min((a[0] - a[1:] - spare) / nu[1:])
        high = np.max((a[:-1] - a[-1] + spare) / (nu[-1] - nu[:-1]))
        return float(low), float(high)

    def phase_change(self, start: Complexes, end: Complexes) -> float:
        """Change of arg D along straight pieces start→end [rad], certified by Taylor's
        formula.

        On a piece of half-length ρ around z: |D − D(z)| ≤ ρ|D'(z)| + … + ρ³/6 |D‴(z)| +
        ρ⁴/24 max |D⁗|. Where this is below |D(z)| the image lies in a disc without the
        origin. (With |D'| alone a path at the distance r from an m-fold zero would need
        steps like r^m, here r^(m/4).)
        """
        a, b, total = start, end, 0.0
        while a.size:
            # Pieces of 1e-13 are as short as rounding lets them be: halving them again
            # shows nothing new.
            if a.size > PIECE_LIMIT or np.min(np.abs(b - a)) < 1e-13:
                raise NearZeroError(a.size)
            turned, sure = self._pieces(a, b)
            total += float(turned[sure].sum())
            # Only what is uncertain is halved: the pieces are as many as the zeros
            # beside the path ask for, and not as its length does.
            a, b = a[~sure], b[~sure]
            middle = 0.5 * (a + b)
            a, b = np.concatenate([a, middle]), np.concatenate([middle, b])
        return total

    def _pieces(self, a: Complexes, b: Complexes) -> tuple[Reals, NDArray[np.bool_]]:
        """Phase change of each piece and whether it is certain.

        D is multiplied by e^(−cz), whose phase is known, with c the mean rate there:
        where one term dominates a piece may then be long.
        """
        nu, middle = self.rates[:, None], 0.5 * (a.real + b.real)
        weights = self._logs[:, None] + nu * middle
        top = weights.max(axis=0)
        weights = np.exp(weights - top)
        c = (weights * nu).sum(axis=0) / weights.sum(axis=0)
        left, centre, right = (
            self._signs[:, None]
            * np.exp(self._logs[:, None] + nu * z - c * (z - middle) - top)
            for z in (a, 0.5 * (a + b), b)
        )
        moduli = np.maximum(
            np.abs(left), np.abs(right)
        )  # e^((ν−c)x) is monotone between the ends
        radius, gap = 0.5 * np.abs(b - a), nu - c
        strayed, power = ROUNDING * moduli.sum(axis=0), np.ones_like(radius)
        for j in (1, 2, 3):
            centre_terms = centre * gap**j
            power = power * radius / j
            strayed = strayed + power * np.abs(centre_terms.sum(axis=0))
        strayed = strayed + power * radius / 4 * (moduli * gap**4).sum(axis=0)
        sure = strayed < np.abs(centre.sum(axis=0))
        # Both ends lie in one disc without the origin: the principal argument of their
        # quotient is the change itself.
        turned = np.angle(right.sum(axis=0) * left.sum(axis=0).conj())
        return turned + c * (b.imag - a.imag), sure


# --- How many zeros: the argument principle on strips and boxes of the log-plane ----------------------


def _whole(turns: float) -> int:
    # Rounding of some hundred pieces adds up to 1e-12; anything near 1e-3 is a phase
    # that drowned.
    if abs(turns - round(turns)) > 1e-3:
        raise NotConvergedError(
            "winding number",
            reached=turns,
            wanted=round(turns),
            remedy="the coefficients differ by too many orders of magnitude; scale s",
        )
    return round(turns)


def count_strip(sum_: ExponentialSum, height: float) -> int:
    """Number of zeros with |Im z| < `height`, multiplicities and conjugates counted.

    D is real on the real axis, so half the contour suffices: right side up, top line
    back, left side down.
    """
    low, high = sum_.bounds
    # Ten pieces are right for three terms; the walk halves those that are too long.
    top = np.linspace(high, low, 11) + 1j * height
    start = np.concatenate([[high], top])
    end = np.concatenate([top, [low]])
    return _whole(sum_.phase_change(start.astype(complex), end.astype(complex)) / np.pi)


def count_box(sum_: ExponentialSum, low: complex, high: complex) -> int:
    """Number of zeros in the open rectangle with the corners `low` (left, below) and
    `high`.
    """
    corners = np.array(
        [low, complex(high.real, low.imag), high, complex(low.real, high.imag), low]
    )
    start, end = corners[:-1], corners[1:]
    pieces = np.linspace(0, 1, 5)
    path = start[:, None] + pieces * (end - start)[:, None]
    return _whole(
        sum_.phase_change(path[:, :-1].ravel(), path[:, 1:].ravel()) / (2 * np.pi)
    )


# --- Quasi-polynomials Σ d_k s^(b_k) e^(−σ_k s): how many zeros have Re s > 0 -------------------------

# a delay of τ needs about 10 τ R pieces up to the frequency R that bounds the zeros
_PIECES = 200_000


def right_half_plane_zeros(terms: Sequence[Term]) -> int:
    """Return the certified number of zeros with Re s > 0 of a quasi-polynomial, −1 for
    infinitely many.

    In Re s ≥ 0 every |e^(−σs)| ≤ 1, so beyond a radius R the highest order dominates
    and inside a radius r the lowest one does; between, the change of phase along the
    imaginary axis is followed by steps that a bound on the derivative makes certain. Of
    the neutral type (delays on the highest order, too) that holds where the delayed
    coefficients' moduli add up to less than the undelayed one's; otherwise zeros of any
    size lie in Re s > 0 or come as near to the axis as one likes. Raises `FieldError`
    for zeros on the axis.

    Source: Hale and Verduyn Lunel, Introduction to Functional Differential Equations
    (1993), chapter 9.
    """
    # Without delay a leading term rules in the whole of Re s ≥ 0; a delayed one of its
    # order is as large as it on the axis, and where it is larger a chain of zeros
    # without end lies in Re s > 0.
    leading = [t for t in terms if t.order == terms[0].order]
    if leading[0].delay or 2.0 * abs(leading[0].coefficient) <= sum(
        abs(t.coefficient) for t in leading
    ):
        return -1
    quasi = _Quasi.of(terms)
    # A start for the walk, which halves what it cannot certify: the count is the same
    # from any other.
    x = np.linspace(*quasi.range(), 65)
    try:
        turned = quasi.phase_change(x[:-1], x[1:])
    except NearZeroError as error:
        problem = "zero on the imaginary axis, or too close to it to tell"
        remedy = "change the gain or the delay a little"
        raise FieldError(
            "denominator",
            list(terms),
            problem,
            allowed="poles away from the axis",
            remedy=remedy,
        ) from error
    # Large arc: from the positive real axis, where D has the sign of d_0, the phase
    # turns by b_0 π/2 + rest.
    high = quasi.top * 0.5 * math.pi + quasi.deviation(x[-1], quasi.top)
    low = quasi.bottom * 0.5 * math.pi + quasi.deviation(x[0], quasi.bottom)
    return round((high - low - turned) / math.pi)


def _balance(sizes: Reals, gaps: Reals, wanted: float) -> float:
    """x where Σ sizes e^(gaps x) = `wanted`, with gaps > 0; 0 where there is nothing to
    sum.
    """
    if not sizes.size:
        return 0.0
    places = (
        np.log(wanted / sizes.size) - np.log(sizes)
    ) / gaps  # each term alone has its share here

    def excess(x: float) -> float:
        return float(np.exp(np.minimum(np.log(sizes) + gaps * x, 700.0)).sum()) - wanted

    low, high = float(places.min()), float(places.max())
    # Ten tolerances of the root to the safe side: the dominance that is claimed must
    # hold, not nearly hold.
    return (
        low
        if excess(high) <= 0.0 or low == high
        else float(brentq(excess, low, high, xtol=1e-3)) - 1e-2
    )


@dataclass(frozen=True)
class _Quasi:
    coefficients: Reals
    orders: Reals
    delays: Reals
    top: float
    bottom: float

    @classmethod
    def of(cls, terms: Sequence[Term]) -> _Quasi:
        top, bottom = terms[0].order, terms[-1].order
        if math.fsum(t.coefficient for t in terms if t.order == bottom) == 0:
            problem = "zero at s = 0 through terms that cancel there"
            allowed = "lowest-order coefficients with a sum that is not zero"
            remedy = "cancel the zero at the origin by hand"
            raise FieldError(
                "denominator", list(terms), problem, allowed=allowed, remedy=remedy
            )
        return cls(
            np.array([t.coefficient for t in terms]),
            np.array([t.order for t in terms]),
            np.array([t.delay for t in terms]),
            top,
            bottom,
        )

    def range(self) -> tuple[float, float]:
        """ln ω below which the lowest order and above which the highest order exceeds
        all others.

        The sum of the others over the dominant one is monotone in ln ω, so that the
        place is a root. Slow roll-off makes it far away, and a delay turns D once more
        in every 2π/τ up to there: a bound that is ten times too high in D costs a
        hundred times the pieces for orders half apart.
        """
        a, b = np.abs(self.coefficients), self.orders
        lowest = b == self.bottom
        base = abs(float(self.coefficients[lowest].sum()))
        # e^(−σ s) moves the lowest terms from their sum by at most σ|s| each.
        moved = lowest & (self.delays > 0.0)
        low = _balance(
            np.concatenate([a[~lowest], (a * self.delays)[moved]]) / base,
            np.concatenate(
                [b[~lowest] - self.bottom, np.ones(np.count_nonzero(moved))]
            ),
            0.5,
        )
        # In Re s >= 0 the delayed terms of the highest order take at most their sum
        # from the first one.
        highest = b == b[0]
        taken = float(a[highest][1:].sum() / a[0])
        high = -_balance(a[~highest] / a[0], b[0] - b[~highest], 0.5 * (1.0 - taken))
        return low, max(high, low + 1.0)

    def value(self, x: Reals, shift: float | Reals) -> Complexes:
        """D(j e^x) e^(−shift x)."""
        w = np.exp(x)
        phase = 0.5 * math.pi * self.orders[:, None] - self.delays[:, None] * w
        size = self.coefficients[:, None] * np.exp((self.orders[:, None] - shift) * x)
        return np.asarray((size * np.exp(1j * phase)).sum(0))

    def deviation(self, x: float, order: float) -> float:
        """arg of D(jω) over its dominant term, within ±π/2."""
        # What is left is smaller than the ruling term: it turns it by less than a
        # quarter turn.
        value = self.value(np.array([x]), order)[0] * np.exp(-0.5j * math.pi * order)
        sign = math.copysign(1.0, math.fsum(self.coefficients[self.orders == order]))
        return float(np.angle(sign * value))

    def phase_change(self, a: Reals, b: Reals) -> float:
        """Certified change of arg D(j e^x) over the pieces [a, b].

        A path that is shorter than the sum of its ends' distances from 0 cannot pass
        round it. Where the delayed terms together stay below the others, A, the phase
        is that of A and the principal one of D/A: there a piece may be long though a
        delay turns it many times.
        """
        total, free = 0.0, self.delays == 0.0
        while a.size:
            # Ends that are 1e-13 of ln ω apart are one number but for rounding: between
            # them lies a zero.
            if a.size > _PIECES or np.min(b - a) < 1e-13:
                raise NearZeroError(a.size)
            middle = 0.5 * (a + b)
            weights = np.abs(self.coefficients)[:, None] * np.exp(
                self.orders[:, None] * (middle - middle.max())
            )
            shift = (weights * self.orders[:, None]).sum(0) / weights.sum(0)
            at_a, at_b = (
                self._centred(a, middle, shift),
                self._centred(b, middle, shift),
            )
            rate = np.abs(self.orders[:, None] - shift)
            largest = np.maximum(
                self._sizes(a, middle, shift), self._sizes(b, middle, shift)
            )
            # Forty units in the last place of every term, as ROUNDING: a value below
            # that has no phase.
            noise = 1e-14 * largest.sum(0)
            path = (b - a) * ((rate + self.delays[:, None] * np.exp(b)) * largest).sum(
                0
            ) + noise
            whole_a, whole_b = at_a.sum(0), at_b.sum(0)
            sure = path < np.abs(whole_a) + np.abs(whole_b)
            free_a, free_b = at_a[free].sum(0), at_b[free].sum(0)
            path = (
                (b - a) * (rate * largest)[free].sum(0)
                + noise
                + 2.0 * largest[~free].sum(0)
            )
            ruled = ~sure & (path < np.abs(free_a) + np.abs(free_b))
            turned = np.angle(whole_b * whole_a.conj())
            turned[ruled] = (
                np.angle(free_b * free_a.conj())
                + np.angle(whole_b * free_b.conj())
                - np.angle(whole_a * free_a.conj())
            )[ruled]
            sure |= ruled
            total += float(turned[sure].sum())
            a, b = (
                np.concatenate([a[~sure], middle[~sure]]),
                np.concatenate([middle[~sure], b[~sure]]),
            )
        return total

    def _sizes(self, x: Reals, middle: Reals, shift: Reals) -> Reals:
        exponent = self.orders[:, None] * x - shift * (x - middle)
        return np.abs(self.coefficients)[:, None] * np.exp(
            exponent - self._level(middle)
        )

    def _level(self, middle: Reals) -> Reals:
        level: Reals = (
            np.log(np.abs(self.coefficients))[:, None] + self.orders[:, None] * middle
        ).max(0)
        return level

    def _centred(self, x: Reals, middle: Reals, shift: Reals) -> Complexes:
        phase = 0.5 * math.pi * self.orders[:, None] - self.delays[:, None] * np.exp(x)
        signed = np.sign(self.coefficients)[:, None] * self._sizes(x, middle, shift)
        return np.asarray(signed * np.exp(1j * phase))
