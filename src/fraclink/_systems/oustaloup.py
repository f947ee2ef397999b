"""Oustaloup's recursive filter in place of every fractional power, as zeros, poles and gain.

Multiplied out, the polynomials of such a filter over eight decades have coefficients that double precision
cannot hold. Here they stay products; the poles are zeros of a sum of products, found by Aberth's iteration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.terms import Complexes, Reals, Term
from fraclink.errors import NotConvergedError


def oustaloup(
    system: FractionalTransferFunction, band: tuple[float, float], order: int
) -> tuple[Complexes, Complexes, float]:
    """Zeros, poles and gain of the system with `order` pole-zero pairs for each fractional power."""
    top, bottom = _Sum(system.numerator, band, order), _Sum(system.denominator, band, order)
    zeros, poles = [top.zeros()], [bottom.zeros()]
    # A filter that only one side has leaves its poles to the quotient: as poles, or as zeros.
    for part in sorted(top.fractions - bottom.fractions):
        poles.append(-_corners(part, band, order)[1].astype(complex))
    for part in sorted(bottom.fractions - top.fractions):
        zeros.append(-_corners(part, band, order)[1].astype(complex))
    return np.concatenate(zeros), np.concatenate(poles), top.leading() / bottom.leading()


def _corners(part: float, band: tuple[float, float], order: int) -> tuple[Reals, Reals]:
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

    def _logarithmic(self, s: Complexes, c: float, n: int, f: float) -> tuple[Complexes, Complexes]:
        """One term and its logarithmic derivative."""
        value, rate = c * s**n, n / s
        if f:
            up, down = _corners(f, self.band, self.order)
            value = value * self.band[1] ** f * np.prod((s[:, None] + up) / (s[:, None] + down), axis=1)
            rate = rate + (1 / (s[:, None] + up) - 1 / (s[:, None] + down)).sum(1)
        return value, rate

    def value(self, s: Complexes) -> Complexes:
        return np.asarray(sum(self._logarithmic(s, *t)[0] for t in self.terms))

    def slope(self, s: Complexes) -> Complexes:
        pairs = [self._logarithmic(s, *t) for t in self.terms]
        return np.asarray(sum(v * r for v, r in pairs))

    def leading(self) -> float:
        """Coefficient of the highest power at infinity."""
        return math.fsum(c * self.band[1] ** f for c, n, f in self.terms if n == self.degree)

    def zeros(self) -> Complexes:
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

        def rate(s: Complexes) -> Complexes:
            quotient = self.slope(s) / self.value(s) - len(at_origin) / s
            return np.asarray(quotient + (1 / (s[:, None] + down)).sum(1))

        return np.concatenate([at_origin, aberth(start, rate)])


# --- Rational functions as zeros, poles and gain: evaluation, residues, a real realisation ------------


def evaluate(s: Complexes, zeros: Complexes, poles: Complexes, gain: float) -> Complexes:
    """gain Π(s − z)/Π(s − p) at any shape of s, factor by factor so that nothing overflows."""
    flat = s.reshape(-1, 1)
    shared = min(len(zeros), len(poles))
    value = np.prod((flat - zeros[:shared]) / (flat - poles[:shared]), axis=1)
    value = value * np.prod(flat - zeros[shared:], axis=1) / np.prod(flat - poles[shared:], axis=1)
    return np.asarray((gain * value).reshape(s.shape))


def residues(zeros: Complexes, poles: Complexes, gain: float) -> Complexes:
    """Residues at simple poles; infinite at a multiple one."""
    found = np.empty(len(poles), dtype=complex)
    with np.errstate(divide="ignore", invalid="ignore"):
        for i, p in enumerate(poles):
            found[i] = evaluate(np.array([p]), zeros, np.delete(poles, i), gain)[0]
    return found


def zeros_of_fractions(poles: Complexes, parts: Complexes, direct: float) -> tuple[Complexes, float]:
    """Zeros and gain of direct + Σ parts/(s − poles) with direct ≠ 0: eigenvalues, then Aberth's iteration.

    The eigenvalues are right to 1e-16 of the largest pole; zeros five decades below it need the polish.
    """
    matrix = np.diag(poles) - np.outer(np.ones(len(poles)), parts) / direct
    start = np.asarray(np.linalg.eigvals(matrix), dtype=complex)

    def rate(s: Complexes) -> Complexes:
        distance = 1 / (s[:, None] - poles)
        value, slope = direct + (parts * distance).sum(1), -(parts * distance**2).sum(1)
        return np.asarray(slope / value + distance.sum(1))

    return aberth(start, rate), direct


def aberth(start: Complexes, rate: Callable[[Complexes], Complexes]) -> Complexes:
    """All zeros of a real polynomial P of degree len(start) from P′/P = `rate`; exactly real or conjugate."""
    # Exact conjugates and reals cannot leave their symmetry: turn the starts a little.
    s = start * np.exp(1e-3j) + 0j
    step = np.zeros_like(s)
    for _ in range(300):
        distance = s[:, None] - s[None, :]
        distance[distance == 0] = np.inf
        with np.errstate(all="ignore"):
            step = 1 / (rate(s) - (1 / distance).sum(1))
        # Where the quotient is not a number, a zero has met a pole of the form that P is written in.
        step = np.where(np.isfinite(step), step, 0)
        s = s - step
        if np.all(np.abs(step) <= 1e-14 * np.abs(s)):
            break
    left = float(np.max(np.abs(step) / np.maximum(np.abs(s), 1e-300), initial=0.0))
    # Double zeros are known to 1e-8 only, and a double real one may lie on either side of the axis.
    real = np.abs(s.imag) < 1e-6 * np.abs(s)
    upper = s[~real & (s.imag > 0)]
    if left > 1e-6 or len(s) != np.count_nonzero(real) + 2 * len(upper):
        raise NotConvergedError(
            "zeros of the approximation",
            reached=left,
            wanted=1e-6,
            remedy="narrow the band or lower the order",
        )
    return np.concatenate([s[real].real.astype(complex), upper, upper.conj()])


def cascade(zeros: Complexes, poles: Complexes, gain: float) -> tuple[Reals, Reals, Reals, Reals]:
    """Real A, B, C, D: sections of second order in series, slow ones first; needs as many poles as zeros."""
    a, b = np.zeros((0, 0)), np.zeros((0, 1))
    c, d = np.zeros((1, 0)), np.array([[gain]])
    tops, bottoms = _quadratics(zeros), _quadratics(poles)
    for i, bottom in enumerate(bottoms):
        top = tops[i] if i < len(tops) else np.array([1.0])
        a2, b2, c2, d2 = _section(top, bottom)
        n, m = len(a), len(a2)
        a = np.block([[a, np.zeros((n, m))], [b2 @ c, a2]])
        b = np.vstack([b, b2 @ d])
        c, d = np.hstack([d2 * c, c2]), d2 * d
    return a, b, c, d


def _quadratics(roots: Complexes) -> list[Reals]:
    """Monic real polynomials of degree 2 (one may have 1) with these roots, ordered by modulus."""
    real = sorted(roots[roots.imag == 0].real, key=abs)
    factors = [np.array([1.0, -2 * z.real, abs(z) ** 2]) for z in roots if z.imag > 0]
    factors += [np.array([1.0, -(x + y), x * y]) for x, y in zip(real[::2], real[1::2], strict=False)]
    factors.sort(key=lambda p: float(p[2]))
    if len(real) % 2:
        factors.append(np.array([1.0, -real[-1]]))
    return factors


def _section(top: Reals, bottom: Reals) -> tuple[Reals, Reals, Reals, float]:
    """Controllable form of top/bottom; the degree of top is at most that of bottom."""
    n = len(bottom) - 1
    padded = np.concatenate([np.zeros(n + 1 - len(top)), top])
    d = float(padded[0])
    a = np.zeros((n, n))
    a[0] = -bottom[1:]
    a[range(1, n), range(n - 1)] = 1.0
    b = np.zeros((n, 1))
    b[0, 0] = 1.0
    return a, b, (padded[1:] - d * bottom[1:]).reshape(1, n), d
