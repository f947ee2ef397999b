"""Oustaloup's recursive filter in place of every fractional power, as zeros, poles and gain.

Multiplied out, the polynomials of such a filter over eight decades have coefficients that double precision
cannot hold. Here they stay products; the poles are zeros of a sum of products, found by Aberth's iteration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.fractional import FractionalTransferFunction, Term
from fraclink._systems.rational.zeros_poles import aberth

__all__ = ["oustaloup"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


def oustaloup(
    system: FractionalTransferFunction, band: tuple[float, float], order: int
) -> tuple[Complex, Complex, float]:
    """Zeros, poles and gain of the system with `order` pole-zero pairs for each fractional power."""
    top, bottom = _Sum(system.numerator, band, order), _Sum(system.denominator, band, order)
    zeros, poles = [top.zeros()], [bottom.zeros()]
    # A filter that only one side has leaves its poles to the quotient: as poles, or as zeros.
    for part in sorted(top.fractions - bottom.fractions):
        poles.append(-_corners(part, band, order)[1].astype(complex))
    for part in sorted(bottom.fractions - top.fractions):
        zeros.append(-_corners(part, band, order)[1].astype(complex))
    return np.concatenate(zeros), np.concatenate(poles), top.leading() / bottom.leading()


def _corners(part: float, band: tuple[float, float], order: int) -> tuple[Real, Real]:
    """ω′ and ω of s^part ≈ ω_h^part Π (s + ω′)/(s + ω)."""
    low, high = band
    i = np.arange(order)
    up = low * (high / low) ** ((i + 0.5 * (1 - part)) / order)
    down = low * (high / low) ** ((i + 0.5 * (1 + part)) / order)
    return up, down


class _Sum:
    """Σ c_k s^(n_k) O_k(s) with 0 ≤ a_k − n_k < 1 and O_k the filter of that fraction."""

    def __init__(self, terms: Sequence[Term], band: tuple[float, float], order: int) -> None:
        self.band, self.order = band, order
        self.terms = [
            (t.coefficient, math.floor(t.order), round(t.order - math.floor(t.order), 12)) for t in terms
        ]
        self.fractions = {f for _, _, f in self.terms if f}
        self.degree = max(n for _, n, _ in self.terms)

    def _logarithmic(self, s: Complex, c: float, n: int, f: float) -> tuple[Complex, Complex]:
        """One term and its logarithmic derivative."""
        value, rate = c * s**n, n / s
        if f:
            up, down = _corners(f, self.band, self.order)
            value = value * self.band[1] ** f * np.prod((s[:, None] + up) / (s[:, None] + down), axis=1)
            rate = rate + (1 / (s[:, None] + up) - 1 / (s[:, None] + down)).sum(1)
        return value, rate

    def value(self, s: Complex) -> Complex:
        return np.asarray(sum(self._logarithmic(s, *t)[0] for t in self.terms))

    def slope(self, s: Complex) -> Complex:
        pairs = [self._logarithmic(s, *t) for t in self.terms]
        return np.asarray(sum(v * r for v, r in pairs))

    def leading(self) -> float:
        """Coefficient of the highest power at infinity."""
        return math.fsum(c * self.band[1] ** f for c, n, f in self.terms if n == self.degree)

    def zeros(self) -> Complex:
        """All zeros of the polynomial that the sum is over its filters' poles."""
        at_origin = np.zeros(min(n for _, n, _ in self.terms), dtype=complex)
        if len(self.terms) == 1:
            up = [_corners(f, self.band, self.order)[0] for f in self.fractions]
            return np.concatenate([at_origin, *(-u.astype(complex) for u in up)])
        corners = [_corners(f, self.band, self.order)[1] for f in sorted(self.fractions)]
        down = np.concatenate([np.empty(0), *corners])
        count = self.degree + len(down) - len(at_origin)
        # Alternating sides of the real axis at 34°: pairs and real zeros are both near.
        spread = np.geomspace(self.band[0], self.band[1], 2 * count + 1)[1::2]
        start = np.asarray(-spread * np.exp(0.6j * np.where(np.arange(count) % 2, 1, -1)), dtype=complex)

        def rate(s: Complex) -> Complex:
            quotient = self.slope(s) / self.value(s) - len(at_origin) / s
            return np.asarray(quotient + (1 / (s[:, None] + down)).sum(1))

        return np.concatenate([at_origin, aberth(start, rate)])
