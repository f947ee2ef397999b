"""Rational functions as zeros, poles and gain, and Oustaloup's filter for s^f.

Multiplied out, polynomials with roots over eight decades have coefficients that double
precision cannot hold: everything here stays in factored form. A system with a filter in
place of every fractional power is a quotient of sums of such products; its poles and
zeros are found by Aberth's iteration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import tf2ss, zpk2sos

from fracsys._precision import ROUNDS
from fracsys._terms import Term
from fracsys.checks import Complex, Real
from fracsys.errors import NotConvergedError

Band = tuple[float, float]


def evaluate(s: Complex, zeros: Complex, poles: Complex, gain: float) -> Complex:
    """gain Π(s − z)/Π(s − p) at any shape of s, factor by factor so that nothing
    overflows.
    """
    flat = s.reshape(-1, 1)
    count = min(len(zeros), len(poles))
    value = np.prod((flat - zeros[:count]) / (flat - poles[:count]), axis=1)
    value = (
        value
        * np.prod(flat - zeros[count:], axis=1)
        / np.prod(flat - poles[count:], axis=1)
    )
    return (gain * value).reshape(s.shape)


def zeros_of_fractions(
    poles: Complex, parts: Complex, direct: float
) -> tuple[Complex, float]:
    """Zeros and gain of direct + Σ parts/(s − poles) with direct ≠ 0: eigenvalues, then
    Aberth's iteration.

    The eigenvalues are accurate to 1e-16 of the largest pole; zeros five decades below
    it need the refinement.
    """
    # The poles of the inverse realisation are the zeros. Multiplying out the fractions
    # would give a polynomial whose coefficients span forty decades.
    matrix = np.diag(poles) - np.outer(np.ones(len(poles)), parts) / direct
    start = np.asarray(np.linalg.eigvals(matrix), complex)

    def rate(s: Complex) -> Complex:
        distance = 1 / (s[:, None] - poles)
        value, slope = direct + (parts * distance).sum(1), -(parts * distance**2).sum(1)
        return slope / value + distance.sum(1)

    return aberth(start, rate), direct


def aberth(start: Complex, rate: Callable[[Complex], Complex]) -> Complex:
    """All zeros of a real polynomial P of degree len(start) from P′/P = `rate`; exactly
    real or conjugate.
    """
    # The iteration preserves exact symmetry about the real axis; a small rotation of
    # the starts breaks it.
    s = start * np.exp(1e-3j) + 0j
    step = np.zeros_like(s)
    for _ in range(ROUNDS):
        distance = s[:, None] - s[None, :]
        distance[distance == 0] = np.inf
        with np.errstate(all="ignore"):
            step = 1 / (rate(s) - (1 / distance).sum(1))
        # Where the quotient is not a number, a zero coincides with a pole of the form
        # in which P is written.
        step = np.where(np.isfinite(step), step, 0)
        s = s - step
        if np.all(np.abs(step) <= 1e-14 * np.abs(s)):
            break
    change = float(np.max(np.abs(step) / np.maximum(np.abs(s), 1e-300), initial=0.0))
    # Double zeros are known to 1e-8 only, and a double real zero may end on either side
    # of the axis.
    real = np.abs(s.imag) < 1e-6 * np.abs(s)
    upper = s[~real & (s.imag > 0)]
    if change > 1e-6 or len(s) != np.count_nonzero(real) + 2 * len(upper):
        raise NotConvergedError(
            "zeros of the approximation",
            reached=change,
            wanted=1e-6,
            remedy="narrow the band or lower the order",
        )
    return np.concatenate([s[real].real.astype(complex), upper, upper.conj()])


def cascade(
    zeros: Complex, poles: Complex, gain: float
) -> tuple[Real, Real, Real, Real]:
    """Real A, B, C, D: sections of second order in series."""
    a, b = np.zeros((0, 0)), np.zeros((0, 1))
    c, d = np.zeros((1, 0)), np.ones((1, 1))
    # Second-order sections; the coefficients of a single polynomial would span forty
    # decades.
    for section in zpk2sos(zeros, poles, gain, pairing="minimal", analog=True):
        a2, b2, c2, d2 = tf2ss(
            *(np.trim_zeros(part, "f") for part in np.split(section, 2))
        )
        n, m = len(a), len(a2)
        a = np.block([[a, np.zeros((n, m))], [b2 @ c, a2]])
        b = np.vstack([b, b2 @ d])
        c, d = np.hstack([d2 * c, c2]), d2 * d
    return a, b, c, d


# ---- filters that stand for s^f ---------------------------------------------------------------------


@dataclass(frozen=True)
class PowerFilter:
    """s^f ≈ gain · Π(s − z)/Π(s − p), with as many zeros as poles."""

    zeros: Complex
    poles: Complex
    gain: float


def oustaloup(fraction: float, band: Band, order: int) -> PowerFilter:
    """The filter ω_h^f Π (s + ω′)/(s + ω) for s^f, its corners spread evenly over the
    band.

    Source: Oustaloup et al., IEEE Trans. Circuits Syst. I 47 (2000) 25.
    """
    low, high = band
    i = np.arange(order)
    up = low * (high / low) ** ((i + 0.5 * (1 - fraction)) / order)
    down = low * (high / low) ** ((i + 0.5 * (1 + fraction)) / order)
    return PowerFilter(-up.astype(complex), -down.astype(complex), high**fraction)


def substituted(
    numerator: Sequence[Term],
    denominator: Sequence[Term],
    power: Callable[[float], PowerFilter],
) -> tuple[Complex, Complex, float]:
    """Zeros, poles and gain of a system with `power(f)` for each s^f, 0 < f < 1."""
    fractions = {_split(t.order)[1] for t in (*numerator, *denominator)} - {0.0}
    none = PowerFilter(np.empty(0, complex), np.empty(0, complex), 1.0)
    filters = {0.0: none} | {f: power(f) for f in fractions}
    top, bottom = _Sum(numerator, filters), _Sum(denominator, filters)
    zeros, poles = [top.zeros()], [bottom.zeros()]
    # The poles of a filter that occurs in only one of the sums are poles or zeros of
    # the quotient.
    poles += [filters[f].poles for f in sorted(top.fractions - bottom.fractions)]
    zeros += [filters[f].poles for f in sorted(bottom.fractions - top.fractions)]
    return (
        np.concatenate(zeros),
        np.concatenate(poles),
        top.leading() / bottom.leading(),
    )


def _split(order: float) -> tuple[int, float]:
    whole = math.floor(order)
    # 1.92 − 1 is 0.9199999999999999; without rounding, two terms with the same fraction
    # would get two filters.
    return whole, round(order - whole, 12)


class _Sum:
    """Σ c_k s^(n_k) F_k(s) with 0 ≤ a_k − n_k < 1 and F_k the filter for that fraction."""

    def __init__(
        self, terms: Sequence[Term], filters: dict[float, PowerFilter]
    ) -> None:
        split = [(t.coefficient, *_split(t.order)) for t in terms]
        self.fractions = {f for _, _, f in split if f}
        summands = [(c, n, filters[f]) for c, n, f in split]
        self.terms = [(c * part.gain, n, part) for c, n, part in summands]
        self.degree = max(n for _, n, _ in summands)
        self.down = np.concatenate(
            [np.empty(0, complex), *(filters[f].poles for f in sorted(self.fractions))]
        )

    def value_and_slope(self, s: Complex) -> tuple[Complex, Complex]:
        value, slope = np.zeros_like(s), np.zeros_like(s)
        for c, n, part in self.terms:
            term = c * s**n * evaluate(s, part.zeros, part.poles, 1.0)
            rate = (1 / (s[:, None] - part.zeros)).sum(1) - (
                1 / (s[:, None] - part.poles)
            ).sum(1)
            value, slope = value + term, slope + term * (n / s + rate)
        return value, slope

    def leading(self) -> float:
        """Coefficient of the highest power at infinity."""
        return math.fsum(c for c, n, _ in self.terms if n == self.degree)

    def zeros(self) -> Complex:
        """All zeros of the numerator polynomial of the sum over its filters' poles."""
        at_origin = np.zeros(min(n for _, n, _ in self.terms), complex)
        if len(self.terms) == 1:
            return np.concatenate([at_origin, self.terms[0][2].zeros])
        count = self.degree + len(self.down) - len(at_origin)
        # Starts alternate between both sides of the real axis at 34°, near pairs as
        # well as real zeros.
        sizes = np.abs(self.down) if self.down.size else np.ones(1)
        spread = np.geomspace(0.5 * sizes.min(), 2.0 * sizes.max(), 2 * count + 1)[1::2]
        start = np.asarray(
            -spread * np.exp(0.6j * np.where(np.arange(count) % 2, 1, -1)),
            complex,
        )

        def rate(s: Complex) -> Complex:
            value, slope = self.value_and_slope(s)
            quotient = slope / value - len(at_origin) / s
            return quotient + (1 / (s[:, None] - self.down)).sum(1)

        return np.concatenate([at_origin, aberth(start, rate)])
