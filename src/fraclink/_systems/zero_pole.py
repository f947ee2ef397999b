"""Rational functions as zeros, poles and gain: evaluation, residues, sampled forms, a real realisation.

Multiplied out, polynomials with roots over eight decades have coefficients that double precision cannot hold.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fraclink._systems.terms import Complexes, Reals
from fraclink.errors import NotConvergedError


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
            # The product without that pole, and not a derivative: it keeps its digits where other poles are
            # near.
            found[i] = evaluate(np.array([p]), zeros, np.delete(poles, i), gain)[0]
    return found


def zeros_of_fractions(poles: Complexes, parts: Complexes, direct: float) -> tuple[Complexes, float]:
    """Zeros and gain of direct + Σ parts/(s − poles) with direct ≠ 0: eigenvalues, then Aberth's iteration.

    The eigenvalues are right to 1e-16 of the largest pole; zeros five decades below it need the polish.
    """
    # The realisation's own inverse: its poles are the zeros. Multiplying the fractions out first would give a
    # polynomial whose coefficients span forty decades.
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
    # By modulus, in zeros and poles alike: a section then has a zero and a pole of like size, and no state is
    # large where the output is not.
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


def bilinear(
    zeros: Complexes, found: Complexes, gain: float, period: float
) -> tuple[Complexes, Complexes, float]:
    """s = (2/T)(z − 1)/(z + 1): a root r goes to (1 + rT/2)/(1 − rT/2), missing zeros to −1."""
    half = 0.5 * period
    missing = len(found) - len(zeros)
    scale = np.prod(1 - half * zeros) / np.prod(1 - half * found) * half**missing
    moved = np.concatenate([(1 + half * zeros) / (1 - half * zeros), np.full(missing, -1.0)])
    return moved, (1 + half * found) / (1 - half * found), float(gain * scale.real)


def matched(
    zeros: Complexes, found: Complexes, gain: float, period: float, frequency: float
) -> tuple[Complexes, Complexes, float]:
    """z = e^(sT) for every root, all but one of the zeros at infinity at −1, |R| kept at `frequency`."""
    # One zero stays at infinity: it is the delay of a sample that a strictly proper system has.
    absent = max(len(found) - len(zeros) - 1, 0)
    at_zeros = np.concatenate([np.exp(zeros * period), np.full(absent, -1.0)])
    at_poles = np.exp(found * period)
    wanted = evaluate(np.array([1j * frequency]), zeros, found, gain)[0]
    here = evaluate(np.array([np.exp(1j * frequency * period)]), at_zeros, at_poles, 1.0)[0]
    # A zero at infinity is a factor with a positive value in the band, and so is what stands for it.
    return at_zeros, at_poles, float(np.copysign(abs(wanted / here), gain))
