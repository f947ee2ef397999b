"""Minimax partial fractions: the poles and residues with the smallest worst error at
given frequencies.

    R(x) = P(x) [ d + Σ r_i σ_i/(x + σ_i) + Σ conjugate pairs ],      x = jΩ

The minimum of the worst error is approached through the p-norms, p = 2, 4, … 128: each
is a smooth problem, solved by Newton's method (csrc/kernels/minimax.c, the exact Hessian
of the p-norm of a linearised error) from the solution for the previous p. The last one
lies within ln(rows)/128 ≈ 4 % of the minimax error; no pole leaves the stable half
plane.
"""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter

import numpy as np
from numpy.typing import ArrayLike

from fracsys import _kernels
from fracsys._precision import BLUR
from fracsys.checks import Complex, Real

# With 2 and 128 alone, three of six controllers need more poles, and the best fit of
# order 8 has twice the error: each norm must start near its minimum. Stopping at 32
# raises the error by 1 to 4 %.
_POWERS = (2, 4, 8, 16, 32, 64, 128)


@dataclass(frozen=True)
class Target:
    """The goal R(jΩ_k) = F_k, with the weights of the real and the imaginary part of
    the relative errors.
    """

    omega: Real  # Ω, the frequency in the x-plane
    factor: Complex  # P(jΩ)
    # 1/(offset + F) times P and times F: the real part of the error is in nepers, its
    # imaginary part in radians
    whole: Complex
    wanted: Complex
    weights: Real  # of the real and of the imaginary part, shape (2, K)

    @cached_property
    def aim(self) -> Real:
        """The wanted values as rows."""
        return self.rows(self.wanted)

    @cached_property
    def real_rows(self) -> Real:
        """The coefficients that turn a complex R/P into real rows, in the kernel's
        layout.
        """
        real, imag = self.whole * self.weights
        return np.stack([real.real, -real.imag, imag.imag, imag.real])

    def rows(self, errors: Complex) -> Real:
        """Real parts, then imaginary parts of relative errors, along the last axis, in
        units of their tolerances.
        """
        parts = np.stack([errors.real, errors.imag], axis=-2) * self.weights
        return parts.reshape(*errors.shape[:-1], -1)

    def columns(self, fractions: PartialFractions) -> Real:
        """The basis of the fractions as real columns."""
        return self.rows(self.whole * fractions.basis(self.omega)).T


@dataclass(frozen=True)
class PartialFractions:
    """Poles x = −e^θ (real) and −e^(θ ± jψ) (pairs), |ψ| < π/2, with residues; all
    parameters real.

    A pair contributes ½ [c q/(x + q) + c̄ q̄/(x + q̄)] with q = e^(θ + jψ).
    """

    direct: float
    real_logs: Real
    real_gains: Real
    pair_logs: Real
    pair_angles: Real  # η: ψ = (π/2) tanh η keeps every pair in the stable half plane
    pair_gains: Complex

    def basis(self, omega: Real) -> Complex:
        """1, σ/(x+σ), and for each pair the factors of Re c and Im c, at x = jΩ; shape
        (order + 1, K).
        """
        shapes, n, m = self.shapes(omega), len(self.real_logs), len(self.pair_logs)
        pair, mirrored = shapes[n : n + m], shapes[n + m :]
        return np.concatenate(
            [
                np.ones((1, omega.size)),
                shapes[:n],
                0.5 * (pair + mirrored),
                0.5j * (pair - mirrored),
            ]
        )

    def shapes(self, omega: Real) -> Complex:
        """s/(x + s) at x = jΩ, for σ of each real pole, then q of each pair, then q̄."""
        q = self.poles_of_pairs()
        s = np.concatenate([np.exp(self.real_logs), q, q.conj()])[:, None]
        return np.asarray(s / (1j * omega + s))

    def poles_of_pairs(self) -> Complex:
        """q = e^(θ + jψ), so that the poles are −q and −q̄."""
        return np.exp(self.pair_logs + 0.5j * math.pi * np.tanh(self.pair_angles))

    def with_linear(self, values: Real) -> PartialFractions:
        """The same poles with other residues."""
        n, m = len(self.real_logs), len(self.pair_logs)
        gains = values[1 + n : 1 + n + m] + 1j * values[1 + n + m :]
        return PartialFractions(
            float(values[0]),
            self.real_logs,
            values[1 : 1 + n],
            self.pair_logs,
            self.pair_angles,
            gains,
        )

    def figures(self, target: Target) -> tuple[float, float]:
        """The worst weighted error, 1 at the tolerance, and the cancellation: the
        largest sum of the moduli of all terms over the largest modulus of their sum,
        ideally 1.
        """
        shapes, c = self.shapes(target.omega), 0.5 * self.pair_gains
        gains = np.concatenate([self.real_gains, c, c.conj()])
        whole = self.direct + gains @ shapes
        error = target.rows(target.whole * whole) - target.aim
        parts = abs(self.direct) + np.abs(gains) @ np.abs(shapes)
        factor = np.abs(target.factor)
        return float(np.max(np.abs(error))), float(
            np.max(parts * factor) / np.max(factor * np.abs(whole))
        )


def improve(
    start: PartialFractions, target: Target, powers: Sequence[int] = _POWERS
) -> PartialFractions:
    """The best fractions with the structure of the start, by Newton's method, norm by
    norm.
    """
    n, m = len(start.real_logs), len(start.pair_logs)
    residues = _best_residues(start, target)
    values = np.concatenate(
        [residues, start.real_logs, start.pair_logs, start.pair_angles]
    )
    _kernels.minimax_improve(
        target.omega, target.real_rows, target.aim, n, m, powers, values
    )
    linear, *poles = np.split(values, np.cumsum([1 + n + 2 * m, n, m]))
    return _fractions(*poles).with_linear(linear)


def _best_residues(at: PartialFractions, target: Target) -> Real:
    columns = target.columns(at)
    size = np.linalg.norm(columns, axis=0)
    # Poles that coincide have columns that are equal up to rounding. The cut-off gives
    # both poles the same residue instead of two huge ones of opposite sign, which no
    # single-precision law could run.
    return np.linalg.lstsq(columns / size, target.aim, rcond=1e-12)[0] / size


def score(fit: PartialFractions, target: Target) -> float:
    """Worst weighted error: 1 is the tolerance."""
    return fit.figures(target)[0]


# --- From order to order: the best fractions found, started from those of the order below -------------
#
# The minimax problem over the poles has many local minima. Adding one real pole or one
# pair to the best three fractions of the order below, at places spread over the band,
# ends as low as the best of 60 random starts (benchmarks/bench_stability.py compares),
# needs no random numbers, and gives every lower order.

_KEPT = 3  # fractions kept at each order
_TRIED = 8  # starts that are iterated: those with the smallest least-squares error
# cancellation above which a smaller error is lost again in single precision
_NOISY = 20.0


def grow(
    target: Target,
    band: tuple[float, float],
    *,
    resonances: Sequence[complex] = (),
    pairs: float = math.inf,
) -> Iterator[list[PartialFractions]]:
    """Yield the best few fractions of order 0, 1, …, the best first; `finish` selects
    one of them.

    `band` is the range of Ω to spread poles over, `resonances` are q (poles −q, −q̄)
    that are tried as they are, `pairs` is the largest number of pairs.
    """
    # Nine places, the last ones up to e³ beyond the band. Without those, a controller
    # with a filter takes 6 poles instead of 5, and the best fit of order 8 to an
    # unfiltered one of order 1.2 is 12 % worse.
    spots = np.linspace(math.log(band[0]), math.log(band[1]) + 3.0, 9)
    # η = 0.7 lies 54° off the negative real axis: between two real poles and a
    # resonance.
    twos = [_fractions((), spot, 0.7) for spot in spots[3:]]
    for q in resonances:
        angle = min(abs(cmath.phase(q)) / (0.5 * math.pi), 1 - 1e-9)
        twos.append(_fractions((), math.log(abs(q)), math.atanh(angle)))
    # additions to fractions one order lower (a real pole) and two orders lower (a pair)
    additions = [_fractions(spot) for spot in spots], twos
    columns = [
        np.stack(
            [np.column_stack([target.columns(x)[:, 1:], target.aim]) for x in those]
        )
        for those in additions
    ]
    below: list[PartialFractions] = []
    best = [_fractions().with_linear(_best_residues(_fractions(), target))]
    for order in itertools.count(1):
        yield best
        starts = [
            (square, base, one)
            for bases, those, own in zip((best, below), additions, columns, strict=True)
            for base in bases
            for square, one in zip(_squares_left(base, own, target), those, strict=True)
        ]
        starts.sort(key=itemgetter(0))
        candidates = [_joined(base, one) for _, base, one in starts[:_TRIED]]
        spread = _relocated(band, order, target)
        candidates += [spread] if len(spread.pair_logs) <= pairs else []
        # The 8-norm ranks the candidates almost as their largest errors do. With least
        # squares alone, two of six controllers need one more pole, and a third misses
        # its tolerance.
        fits = [improve(one, target, (2, 8)) for one in candidates]
        below = [one for one in best[:2] if len(one.pair_logs) < pairs]
        best = _distinct(fits, target)


def finish(candidates: list[PartialFractions], target: Target) -> PartialFractions:
    """The best of the candidates after the full sequence of norms."""
    return min((improve(c, target) for c in candidates), key=lambda c: _cost(c, target))


def _cost(fit: PartialFractions, target: Target) -> float:
    error, cancellation = fit.figures(target)
    return error * max(1.0, cancellation / _NOISY)


def _fractions(
    real_logs: ArrayLike = (), pair_logs: ArrayLike = (), pair_angles: ArrayLike = ()
) -> PartialFractions:
    """Fractions with these poles and no residues yet."""
    reals, logs, angles = map(np.atleast_1d, (real_logs, pair_logs, pair_angles))
    return PartialFractions(
        0.0, reals, np.zeros(reals.size), logs, angles, np.zeros(logs.size, complex)
    )


def _joined(one: PartialFractions, more: PartialFractions) -> PartialFractions:
    return _fractions(
        np.append(one.real_logs, more.real_logs),
        np.append(one.pair_logs, more.pair_logs),
        np.append(one.pair_angles, more.pair_angles),
    )


def _squares_left(base: PartialFractions, beyond: Real, target: Target) -> Real:
    """The least sum of squares with the poles of `base` and those of each addition,
    from the parts of `beyond` (columns of the addition, then the aim) that are
    orthogonal to the columns of the base.
    """
    span, _ = np.linalg.qr(target.columns(base))
    beyond = beyond - span @ (span.T @ beyond)
    return np.asarray(np.linalg.qr(beyond, mode="r"))[:, -1, -1] ** 2


def _distinct(
    candidates: list[PartialFractions], target: Target
) -> list[PartialFractions]:
    ranked = sorted(((_cost(c, target), i) for i, c in enumerate(candidates)))
    distinct: list[tuple[float, PartialFractions]] = []
    for cost, i in ranked:
        # Starts that ended in the same minimum agree to 1e-4 in cost; keeping both
        # would waste one of three places.
        if all(abs(cost - other) > 1e-3 * cost for other, _ in distinct):
            distinct.append((cost, candidates[i]))
        if len(distinct) == _KEPT:
            break
    return [c for _, c in distinct]


# --- Starting poles by pole relocation (vector fitting), reflected into the stable half plane ---------
#
# Source: Gustavsen and Semlyen, IEEE Trans. Power Delivery 14 (1999) 1052; with the
# weights of the target.


def _relocated(
    band: tuple[float, float], order: int, target: Target
) -> PartialFractions:
    """The poles after twelve rounds, each of which solves a linear problem. The starts
    are spread evenly over ln Ω: for an odd order a real pole at the lowest place, and
    pairs at 45° at the others.

    R = N/σ with N = d + Σ r φ and σ = 1 + Σ c φ over the present poles: P N − F Σ c φ =
    F is linear, and the zeros of σ are the next poles.
    """
    pairs, real = divmod(order, 2)
    places = (np.arange(real + pairs) + 0.5) / (real + pairs)
    logs = math.log(band[0]) + places * math.log(band[1] / band[0])
    here = _fractions(logs[:real], logs[real:], np.full(pairs, 0.55))
    for _ in range(12):
        basis = here.basis(target.omega)
        both = [target.whole * basis, -target.wanted * basis[1:]]
        columns = target.rows(np.concatenate(both)).T
        size = np.linalg.norm(columns, axis=0) + 1e-300
        # Columns are scaled to equal length: poles three decades apart give columns of
        # very different size, and the cut-off at 1e-13 is meant for dependent columns,
        # not for small ones.
        solution = np.linalg.lstsq(columns / size, target.aim, rcond=1e-13)[0] / size
        here = _from_poles(_zeros_of_denominator(here, solution[len(basis) :]), target)
    return here


def _zeros_of_denominator(at: PartialFractions, weights: Real) -> Complex:
    """Eigenvalues of A − b c for σ(x) = 1 + c (x − A)^(-1) b."""
    sigma, q = np.exp(at.real_logs), at.poles_of_pairs()
    n, m = len(sigma), len(q)
    a = np.diag(-np.concatenate([sigma, q.real, q.real]))
    # Column Re c: ½[q/(x+q) + q̄/(x+q̄)], column Im c: ½j[q/(x+q) − q̄/(x+q̄)]. The block
    # of −q with the states Re and Im, driven by b = (1, 0), gives 1/(x+q) = first + j
    # second.
    first = np.arange(n, n + m)
    a[first, first + m], a[first + m, first] = q.imag, -q.imag
    gain = q * (weights[n : n + m] + 1j * weights[n + m :])
    c = np.concatenate([weights[:n] * sigma, gain.real, -gain.imag])
    a[: n + m] -= c
    return np.asarray(np.linalg.eigvals(a), complex)


def _from_poles(x: Complex, target: Target) -> PartialFractions:
    x = -np.abs(x.real) + 1j * x.imag
    # A pair off the real axis by rounding alone is two real poles.
    real = np.sort(-x.real[np.abs(x.imag) <= BLUR * np.abs(x)])
    q = -x[x.imag < -BLUR * np.abs(x)]
    # A pole three decades outside the band acts as a constant or an integrator there;
    # farther out the slope vanishes and Newton's method could not bring it back.
    low, high = target.omega[0] * 1e-3, target.omega[-1] * 1e3
    angle = np.clip(np.angle(q) * 2 / math.pi, 0.01, 0.995)
    return _fractions(
        np.log(np.clip(real, low, high)),
        np.log(np.clip(np.abs(q), low, high)),
        np.arctanh(angle),
    )
