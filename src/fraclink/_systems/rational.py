"""Integer-order stand-ins for fractional systems: Oustaloup's filter and the minimax rational."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike

from fraclink._systems.discrete import Band, checked_band, fit_discrete
from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.minimax import Target, finish, grow
from fraclink._systems.stability import poles
from fraclink._systems.terms import Complexes, Reals, Term
from fraclink._validate import Between, Positive, checked
from fraclink.errors import FieldError, NotConvergedError


@dataclass(frozen=True, eq=False)
class RationalApproximation:
    """R(s) = k Π(s − z_i)/Π(s − p_i), or the same in the variable z where `period` is given.

    Attributes
    ----------
    zeros, poles
        z_i and p_i, conjugates included [rad/s]; in the z-plane without unit.
    gain
        k.
    period
        Sampling period [s] of a discrete approximation.
    band
        Frequencies [rad/s] it was made for.
    method
        "oustaloup" or "minimax".
    error_db, error_deg
        Largest error of modulus [dB] and phase [°] inside the band.
    """

    zeros: Complexes
    poles: Complexes
    gain: float
    period: float | None
    band: tuple[float, float]
    method: str
    error_db: float = math.nan
    error_deg: float = math.nan

    def __post_init__(self) -> None:
        for name in ("zeros", "poles"):
            array = np.array(getattr(self, name), dtype=complex).reshape(-1)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def order(self) -> int:
        """Number of poles."""
        return len(self.poles)

    @property
    def residues(self) -> Complexes:
        """Residues at the poles, shape (order,); infinite at a multiple pole."""
        return residues(self.zeros, self.poles, self.gain)

    @property
    def direct(self) -> float:
        """R at infinity: 0 where there are more poles than zeros."""
        return self.gain if len(self.zeros) == len(self.poles) else 0.0

    def __call__(self, s: ArrayLike) -> Complexes:
        """R at s [rad/s], or at z for a discrete approximation; any shape."""
        return evaluate(np.asarray(s, dtype=complex), self.zeros, self.poles, self.gain)

    def frequency_response(self, frequency: ArrayLike) -> Complexes:
        """R(jω) or R(e^(jωT)) at frequencies ω [rad/s], shape kept."""
        w = np.asarray(frequency, dtype=float)
        return self(1j * w if self.period is None else np.exp(1j * w * self.period))

    def state_space(self) -> tuple[Reals, Reals, Reals, Reals]:
        """Real matrices A, B, C, D of second-order sections in series.

        Shapes (n, n), (n, 1), (1, n), (1, 1); ready for `control.ss(*r.state_space())`.
        """
        return cascade(self.zeros, self.poles, self.gain)


@checked
def approximate(
    system: FractionalTransferFunction,
    band: Band,
    order: Annotated[int, Between(1, 40)],
    *,
    method: Literal["oustaloup", "minimax"] = "oustaloup",
    period: Positive | None = None,
) -> RationalApproximation:
    """Return an integer-order approximation of a fractional system in a band, with its achieved error.

    Parameters
    ----------
    system
        Proper, or improper by less than one order; no delay.
    band
        Lowest and highest frequency [rad/s], 0 < low < high (≤ π/period).
    order
        "oustaloup": pole-zero pairs in place of each fractional power s^(a − ⌊a⌋), 1 … 40.
        "minimax": number of poles of the whole, 1 … 12.
    method
        "oustaloup" is the recursive filter that FOMCON and others use, known to be poor at the band's ends;
        "minimax" has the smallest worst relative error over the band for its number of poles.
    period
        Sampling period [s] for a discrete result: Oustaloup's filter by the bilinear map, or the minimax fit
        on the unit circle.


    Raises
    ------
    FieldError
        Bad band, order or method, a delay, a system improper by one order or more, unstable poles (minimax).

    References
    ----------
    Oustaloup et al., IEEE Trans. Circuits Syst. I 47 (2000) 25.

    Examples
    --------
    >>> from fraclink._systems.fractional import s
    >>> r = approximate(100 / (s**1.92 + 100), (0.1, 1000.0), 6, method="minimax")
    >>> r.order, r.error_db < 0.5, r.error_deg < 3.0
    (6, True, True)
    """
    _check(system, band, period)
    if method == "minimax":  # more poles than this are below the rounding of the fit
        Between(1, 12).check("order", order)
    if method == "oustaloup":
        zeros, found, gain = oustaloup(system, band, order)
        if period is not None:
            zeros, found, gain = _bilinear(zeros, found, gain, period)
    elif period is None:
        zeros, found, gain = _continuous(system, band, order)
    else:
        fit = fit_discrete(lambda w: system(1j * w), period=period, band=band, order=order)
        half = 0.5 * fit.pole_gains
        parts = np.concatenate([fit.gains, half, half.conj()])
        found = fit.poles
        zeros, gain = zeros_of_fractions(found, parts, fit.feedthrough)
    made = RationalApproximation(zeros, found, gain, period, band, method)
    w = np.unique(np.concatenate([np.geomspace(*band, 2000), np.linspace(*band, 1000)]))
    ratio = np.log(made.frequency_response(w) / system(1j * w))
    return replace(
        made,
        error_db=float(np.max(np.abs(ratio.real)) * 20 / math.log(10)),
        error_deg=float(np.degrees(np.max(np.abs(ratio.imag)))),
    )


def _check(system: FractionalTransferFunction, band: tuple[float, float], period: float | None) -> None:
    """What involves several arguments, or the system's own structure."""
    checked_band(band, period)
    if any(t.delay for t in (*system.numerator, *system.denominator)):
        remedy = "approximate the system without its delay and keep the delay as samples"
        allowed = "systems without delay"
        raise FieldError("system", repr(system), "delayed", allowed=allowed, remedy=remedy)
    if system.relative_degree <= -1:
        problem, remedy = "improper by one order or more", "divide by a power of s: s^1.65 is s times s^0.65"
        allowed = "relative degree > -1"
        raise FieldError("system", repr(system), problem, allowed=allowed, remedy=remedy)


def _continuous(
    system: FractionalTransferFunction, band: tuple[float, float], order: int
) -> tuple[Complexes, Complexes, float]:
    known = poles(system)
    if np.any(known.real >= 0):
        allowed, remedy = "stable poles for method='minimax'", "use method='oustaloup'"
        raise FieldError("system", repr(system), "not stable", allowed=allowed, remedy=remedy)
    w = np.geomspace(*band, 160)
    near = known[(np.abs(known) > band[0]) & (np.abs(known) < band[1]) & (known.imag > 0)]
    for p in near:  # a resonance needs points of its own
        # ±4 in sinh are 27 half widths: there the resonance is its own skirt, which the even points show.
        width = max(abs(p.real) / abs(p), 1e-6)
        w = np.append(w, abs(p) * np.exp(width * np.sinh(np.linspace(-4, 4, 25))))
    w = np.unique(w[(w >= band[0]) & (w <= band[1])])
    wanted = system(1j * w)
    nepers, radians = np.full(w.size, 20 / math.log(10) / 0.1), np.full(w.size, 180 / math.pi / 0.5)
    target = Target(w, np.ones(w.size, dtype=complex), wanted, 1 / wanted, nepers, radians)
    grown = list(grow(target, band, order, resonances=[-p for p in near]))
    fit = finish(grown[-1], target)
    sigma, q = np.exp(fit.real_logs), fit.poles_of_pairs()
    found = np.concatenate([-sigma, -q, -q.conj()])
    half = 0.5 * fit.pair_gains * q
    zeros, gain = zeros_of_fractions(
        found, np.concatenate([fit.real_gains * sigma, half, half.conj()]), fit.direct
    )
    return zeros, found, gain


def _bilinear(
    zeros: Complexes, found: Complexes, gain: float, period: float
) -> tuple[Complexes, Complexes, float]:
    """s = (2/T)(z − 1)/(z + 1): a root r goes to (1 + rT/2)/(1 − rT/2), missing zeros to −1."""
    half = 0.5 * period
    missing = len(found) - len(zeros)
    scale = np.prod(1 - half * zeros) / np.prod(1 - half * found) * half**missing
    moved = np.concatenate([(1 + half * zeros) / (1 - half * zeros), np.full(missing, -1.0)])
    return moved, (1 + half * found) / (1 - half * found), float(gain * scale.real)


# --- Oustaloup's filter in place of every fractional power --------------------------------------------
#
# Multiplied out, the polynomials of such a filter over eight decades have coefficients that double precision
# cannot hold. Here they stay products; the poles are zeros of a sum of products, found by Aberth's iteration.


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
