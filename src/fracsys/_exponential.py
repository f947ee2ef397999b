"""Sums of exponentials: values without overflow, certified numbers of zeros."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from fracsys._precision import ROUNDING
from fracsys.checks import Complex, Mask, Real
from fracsys.errors import NotConvergedError

# Largest number of zeros in one strip (orders of about 3500 on the principal sheet),
# and of pieces of one path: a path that needs more passes through a zero.
LIMIT = 4096


@dataclass(frozen=True)
class ExponentialSum:
    """D(z) = Σ a_k e^(ν_k z) with real a_k ≠ 0 and 0 = ν_0 < ν_1 < …; every value is
    scaled to be finite.
    """

    coefficients: Real
    rates: Real

    @classmethod
    def of(cls, coefficients: ArrayLike, orders: ArrayLike) -> ExponentialSum:
        """Merge equal orders, drop zero coefficients and divide by the lowest power of
        s.
        """
        a = np.atleast_1d(np.asarray(coefficients, float))
        nu = np.atleast_1d(np.asarray(orders, float))
        # Merge only exponents that are equal to the last bit, unlike `collect` in
        # _terms.py: the terms of a transfer function are merged already.
        nu, index = np.unique(nu, return_inverse=True)
        merged = np.zeros_like(nu)
        np.add.at(merged, index, a)
        nu, merged = nu[merged != 0], merged[merged != 0]
        return cls(merged, nu - nu[0])

    @cached_property
    def _logs(self) -> Real:
        return np.log(np.abs(self.coefficients))

    @cached_property
    def _signs(self) -> Real:
        return np.sign(self.coefficients)

    def derivatives(self, z: Complex, count: int) -> tuple[Complex, Real]:
        """D, D', …, D^(count−1) at z, divided by the largest term, and for each the sum
        of the moduli of its terms.
        """
        column = (-1, *[1] * np.ndim(z))
        exponents = np.asarray(
            self._logs.reshape(column) + np.multiply.outer(self.rates, z), complex
        )
        # The zeros of D do not depend on its scale. s^6 at 1e100 rad/s would overflow,
        # its ratio to the largest term does not.
        exponents -= exponents.real.max(axis=0)
        terms = self._signs.reshape(column) * np.exp(exponents)
        powers = self.rates ** np.arange(count)[:, None]
        values: Complex = np.einsum("jk,k...->j...", powers, terms)
        moduli: Real = np.einsum("jk,k...->j...", powers, np.abs(terms))
        return values, moduli

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """Two real parts between which every zero lies: beyond them one term exceeds
        twice the sum of the others.
        """
        a, nu = self._logs, self.rates
        # Each other term is below 1/(2K) of the dominant one: a sufficient condition
        # that is cheap to test.
        spare = np.log(2.0 * len(a))
        low = np.min((a[0] - a[1:] - spare) / nu[1:])
        high = np.max((a[:-1] - a[-1] + spare) / (nu[-1] - nu[:-1]))
        return float(low), float(high)

    def phase_change(self, start: Complex, end: Complex) -> float:
        """Change of arg D along straight pieces start→end [rad], certified by Taylor's
        formula.

        On a piece of half-length ρ around z: |D − D(z)| ≤ ρ|D'(z)| + … + ρ³/6 |D‴(z)| +
        ρ⁴/24 max |D⁗|. Where this is below |D(z)| the image lies in a disc without the
        origin. (With |D'| alone a path at the distance r from an m-fold zero would need
        steps like r^m, here r^(m/4).)
        """
        a, b, total = start, end, 0.0
        while a.size:
            # Pieces of 1e-13 are at the limit of rounding; halving them again shows
            # nothing new.
            if a.size > LIMIT or np.min(np.abs(b - a)) < 1e-13:
                raise NotConvergedError(
                    "phase along the path",
                    reached=a.size,
                    wanted=LIMIT,
                    remedy="move the path off the zero",
                )
            phase, sure = self._pieces(a, b)
            total += float(phase[sure].sum())
            # Only uncertain pieces are halved: their number grows with the zeros close
            # to the path, not with its length.
            a, b = a[~sure], b[~sure]
            middle = 0.5 * (a + b)
            a, b = np.concatenate([a, middle]), np.concatenate([middle, b])
        return total

    def _pieces(self, a: Complex, b: Complex) -> tuple[Real, Mask]:
        """Phase change of each piece, and whether it is certain.

        D is multiplied by e^(−cz), whose phase is known; c is the mean rate on the
        piece. Where one term dominates, a piece may then be long.
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
        remainder, power = ROUNDING * moduli.sum(axis=0), np.ones_like(radius)
        for j in (1, 2, 3):
            centre_terms = centre * gap**j
            power = power * radius / j
            remainder = remainder + power * np.abs(centre_terms.sum(axis=0))
        remainder = remainder + power * radius / 4 * (moduli * gap**4).sum(axis=0)
        sure = remainder < np.abs(centre.sum(axis=0))
        # Both ends lie in a disc that does not contain the origin: the principal
        # argument of their quotient is the phase change.
        phase = np.angle(right.sum(axis=0) * left.sum(axis=0).conj())
        return phase + c * (b.imag - a.imag), sure


# --- How many zeros: the argument principle on strips of the log-plane ----------------------


def _whole(turns: float) -> int:
    # The rounding of a few hundred pieces adds up to 1e-12; a remainder near 1e-3 means
    # that the phase was lost in rounding.
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
    # Ten pieces suit three terms; the walk halves those that are too long.
    top = np.linspace(high, low, 11) + 1j * height
    start = np.concatenate([[high], top])
    end = np.concatenate([top, [low]])
    return _whole(sum_.phase_change(start.astype(complex), end.astype(complex)) / np.pi)
