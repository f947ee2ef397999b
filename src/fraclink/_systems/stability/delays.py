"""Quasi-polynomials Σ d_k s^(b_k) e^(−σ_k s): how many zeros have Re s > 0."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.fractional import Term
from fraclink._systems.roots import NearZeroError
from fraclink.errors import FieldError

__all__ = ["right_half_plane_zeros"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_PIECES = 200_000  # a delay of τ needs about 10 τ R pieces up to the frequency R that bounds the zeros


def right_half_plane_zeros(terms: Sequence[Term]) -> int:
    """Return the certified number of zeros with Re s > 0 of a retarded quasi-polynomial.

    In Re s ≥ 0 every |e^(−σs)| ≤ 1, so beyond a radius R the highest order dominates and inside a radius r
    the lowest one does; between, the change of phase along the imaginary axis is followed by steps that a
    bound on the derivative makes certain. Raises `FieldError` for a neutral type and for zeros on the axis.
    """
    quasi = _Quasi.of(terms)
    x = np.linspace(*quasi.range(), 65)
    try:
        turned = quasi.phase_change(x[:-1], x[1:])
    except NearZeroError as error:
        raise FieldError(
            "denominator",
            list(terms),
            "zero on the imaginary axis, or too close to it to tell",
            allowed="poles away from the axis",
            remedy="change the gain or the delay a little",
        ) from error
    # Large arc: from the positive real axis, where D has the sign of d_0, the phase turns by b_0 π/2 + rest.
    high = quasi.top * 0.5 * math.pi + quasi.deviation(x[-1], quasi.top)
    low = quasi.bottom * 0.5 * math.pi + quasi.deviation(x[0], quasi.bottom)
    return round((high - low - turned) / math.pi)


@dataclass(frozen=True)
class _Quasi:
    coefficients: Real
    orders: Real
    delays: Real
    top: float
    bottom: float

    @classmethod
    def of(cls, terms: Sequence[Term]) -> _Quasi:
        top, bottom = terms[0].order, terms[-1].order
        leading = [t for t in terms if t.order == top]
        if len(leading) > 1 or leading[0].delay:
            raise FieldError(
                "denominator",
                list(terms),
                "of neutral or advanced type: its highest order is delayed",
                allowed="a highest order without delay",
                remedy="add roll-off to the loop: a strictly proper loop gives a retarded denominator",
            )
        if math.fsum(t.coefficient for t in terms if t.order == bottom) == 0:
            raise FieldError(
                "denominator",
                list(terms),
                "zero at s = 0 through terms that cancel there",
                allowed="lowest-order coefficients with a sum that is not zero",
                remedy="cancel the zero at the origin by hand",
            )
        return cls(
            np.array([t.coefficient for t in terms]),
            np.array([t.order for t in terms]),
            np.array([t.delay for t in terms]),
            top,
            bottom,
        )

    def range(self) -> tuple[float, float]:
        """ln ω below which the lowest order and above which the highest order exceeds all others."""
        a, b = np.abs(self.coefficients), self.orders
        lowest = b == self.bottom
        base = abs(self.coefficients[lowest].sum())
        others = math.log(4 * len(a))
        low = []
        for size, order, delay in zip(a, b, self.delays, strict=True):
            if order > self.bottom:
                low.append((math.log(base / size) - others) / (order - self.bottom))
            elif delay:  # e^(−σ s) moves the lowest terms from their sum by at most σ|s| each
                low.append(math.log(base / (size * delay)) - others)
        below = b < b[0]
        high = np.max((np.log(a[below] / a[0]) + others) / (b[0] - b[below]))
        return min(low), max(float(high), min(low) + 1.0)

    def value(self, x: Real, shift: float | Real) -> Complex:
        """D(j e^x) e^(−shift x)."""
        w = np.exp(x)
        phase = 0.5 * math.pi * self.orders[:, None] - self.delays[:, None] * w
        size = self.coefficients[:, None] * np.exp((self.orders[:, None] - shift) * x)
        return np.asarray((size * np.exp(1j * phase)).sum(0))

    def deviation(self, x: float, order: float) -> float:
        """arg of D(jω) over its dominant term, within ±π/2."""
        value = self.value(np.array([x]), order)[0] * np.exp(-0.5j * math.pi * order)
        sign = math.copysign(1.0, math.fsum(self.coefficients[self.orders == order]))
        return float(np.angle(sign * value))

    def phase_change(self, a: Real, b: Real) -> float:
        """Certified change of arg D(j e^x) over the pieces [a, b]."""
        total = 0.0
        while a.size:
            if a.size > _PIECES or np.min(b - a) < 1e-13:
                raise NearZeroError(a.size)
            middle = 0.5 * (a + b)
            weights = np.abs(self.coefficients)[:, None] * np.exp(
                self.orders[:, None] * (middle - middle.max())
            )
            shift = (weights * self.orders[:, None]).sum(0) / weights.sum(0)
            at_a, at_b = self._centred(a, middle, shift), self._centred(b, middle, shift)
            rate = np.abs(self.orders[:, None] - shift) + self.delays[:, None] * np.exp(b)
            largest = np.maximum(self._sizes(a, middle, shift), self._sizes(b, middle, shift))
            sure = (b - a) * (rate * largest).sum(0) + 1e-14 * largest.sum(0) < np.abs(at_a) + np.abs(at_b)
            total += float(np.angle(at_b * at_a.conj())[sure].sum())
            a, b = np.concatenate([a[~sure], middle[~sure]]), np.concatenate([middle[~sure], b[~sure]])
        return total

    def _sizes(self, x: Real, middle: Real, shift: Real) -> Real:
        exponent = self.orders[:, None] * x - shift * (x - middle)
        return np.abs(self.coefficients)[:, None] * np.exp(exponent - self._level(middle))

    def _level(self, middle: Real) -> Real:
        level: Real = (np.log(np.abs(self.coefficients))[:, None] + self.orders[:, None] * middle).max(0)
        return level

    def _centred(self, x: Real, middle: Real, shift: Real) -> Complex:
        phase = 0.5 * math.pi * self.orders[:, None] - self.delays[:, None] * np.exp(x)
        signed = np.sign(self.coefficients)[:, None] * self._sizes(x, middle, shift)
        return np.asarray((signed * np.exp(1j * phase)).sum(0))
