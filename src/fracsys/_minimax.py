"""Minimax partial fractions: the poles and residues with the smallest worst error at
given frequencies.

    R(x) = P(x) [ d + Σ r_i σ_i/(x + σ_i) + Σ Re-symmetric pairs ],      x = jΩ

The worst error is reached through the p-norm with p = 2, 4, … 128: each is a smooth
problem solved by Newton's method (csrc/kernels/minimax.c, the exact Hessian of the
p-norm of a linearised error) from the solution of the previous norm, which ends within
ln(rows)/128 ≈ 4 % of the minimax error and never leaves the stable half plane.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fracsys import _kernels
from fracsys._precision import BLUR
from fracsys.checks import Complex, Real

# Going from 2 to 128 directly, three of six controllers need more poles, and the best
# fit of order 8 has twice the error: each norm must start near its minimum. Stopping at
# 32 costs 3 % of the error.
_POWERS = (2, 4, 8, 16, 32, 64, 128)

Shapes = tuple[Complex, Complex, Complex]


@dataclass(frozen=True)
class Target:
    """What is to be met: R(jΩ_k) = wanted_k, with the errors' real and imaginary parts
    weighted.
    """

    omega: Real  # Ω, the frequency in the x-plane
    factor: Complex  # P(jΩ)
    wanted: Complex
    # The error is multiplied by 1/(offset + wanted), so that its real part is in nepers
    # and its imaginary part in radians.
    turn: Complex
    weight_real: Real
    weight_imag: Real

    @cached_property
    def x(self) -> Complex:
        """jΩ as a column."""
        return np.asarray(1j * self.omega[:, None], complex)

    @cached_property
    def real_rows(self) -> tuple[Real, Real]:
        """What makes a complex R/P real rows, as the kernel takes it, and the rows that
        are wanted.
        """
        whole = self.turn * self.factor
        by_real, by_imag = whole * self.weight_real, whole * self.weight_imag
        return np.stack(
            [by_real.real, -by_real.imag, by_imag.imag, by_imag.real]
        ), self.rows(self.wanted)

    def rows(self, values: Complex) -> Real:
        """Real rows of a complex error (or of columns of a Jacobian): tolerances are 1."""
        own = (self.turn, self.weight_real, self.weight_imag)
        turn, real, imag = own if values.ndim == 1 else (part[:, None] for part in own)
        product, count = values * turn, len(values)
        rows = np.empty((2 * count, *values.shape[1:]))
        np.multiply(product.real, real, out=rows[:count])
        np.multiply(product.imag, imag, out=rows[count:])
        return rows


@dataclass(frozen=True)
class PartialFractions:
    """Poles x = −e^θ (real) and −e^(θ ± jψ) (pairs), |ψ| < π/2, with residues; all
    parameters real.

    A pair's term is Re-symmetric: ½ [c q/(x + q) + c̄ q̄/(x + q̄)] with q = e^(θ + jψ).
    """

    direct: float
    real_logs: Real
    real_gains: Real
    pair_logs: Real
    pair_angles: Real  # η: ψ = (π/2) tanh η keeps every pair in the stable half plane
    pair_gains: Complex

    def columns(self, x: Complex) -> Complex:
        """The basis: 1, σ/(x+σ), and for each pair the columns of Re c and Im c; shape
        (M, order + 1).
        """
        real, pair, mirrored = self.shapes(x)
        return np.concatenate(
            [
                np.ones((len(real), 1)),
                real,
                0.5 * (pair + mirrored),
                0.5j * (pair - mirrored),
            ],
            axis=1,
        )

    def shapes(self, x: Complex) -> Shapes:
        """σ/(x + σ), q/(x + q) and q̄/(x + q̄) at a column x = jΩ, one column for each
        pole.
        """
        sigma = np.exp(self.real_logs)
        real = sigma / (x + sigma)
        q = self.poles_of_pairs()
        return real, q / (x + q), q.conj() / (x + q.conj())

    def poles_of_pairs(self) -> Complex:
        """q = e^(θ + jψ), so that the poles are −q and −q̄."""
        return np.exp(self.pair_logs + 0.5j * math.pi * np.tanh(self.pair_angles))

    def linear(self) -> Real:
        """The linear parameters in the order of `columns`."""
        c = self.pair_gains
        return np.concatenate([[self.direct], self.real_gains, c.real, c.imag])

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

    def improved(self, target: Target, powers: Sequence[int]) -> PartialFractions:
        """The result of Newton's method from here, norm by norm."""
        n, m = len(self.real_logs), len(self.pair_logs)
        values = np.concatenate(
            [self.linear(), self.real_logs, self.pair_logs, self.pair_angles]
        )
        _kernels.minimax_improve(target.omega, *target.real_rows, n, m, powers, values)
        linear, logs, pairs, angles = np.split(values, np.cumsum([1 + n + 2 * m, n, m]))
        return replace(
            self, real_logs=logs, pair_logs=pairs, pair_angles=angles
        ).with_linear(linear)

    def error(self, target: Target) -> Real:
        """Weighted error in rows."""
        return target.rows(
            target.factor * (self.columns(target.x) @ self.linear()) - target.wanted
        )


def log_spaced_start(
    low: float, high: float, real: int, pairs: int
) -> PartialFractions:
    """Poles spread evenly on a logarithmic scale of Ω: real ones below, pairs at 45°
    above.
    """
    count = real + pairs
    logs = math.log(low) + (np.arange(count) + 0.5) / count * math.log(high / low)
    return PartialFractions(
        0.0,
        logs[:real],
        np.zeros(real),
        logs[real:],
        np.full(pairs, 0.55),
        np.zeros(pairs, complex),
    )


def improve(
    start: PartialFractions, target: Target, powers: Sequence[int] = _POWERS
) -> PartialFractions:
    """The best fractions with the structure of the start, by Newton's method, norm by
    norm.
    """
    return best_residues(start, target).improved(target, powers)


def best_residues(at: PartialFractions, target: Target) -> PartialFractions:
    columns = target.rows(target.factor[:, None] * at.columns(target.x))
    size = np.linalg.norm(columns, axis=0)
    # Poles that coincide have columns that are equal to rounding. The cut-off gives
    # both poles the same residue instead of two huge ones of opposite sign, which no
    # single-precision law could run.
    solution = (
        np.linalg.lstsq(columns / size, target.rows(target.wanted), rcond=1e-12)[0]
        / size
    )
    return at.with_linear(solution)


def score(fit: PartialFractions, target: Target) -> float:
    """Worst weighted error: 1 is the tolerance."""
    return float(np.max(np.abs(fit.error(target))))


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
    highest: int,
    *,
    resonances: Sequence[complex] = (),
    pairs: int | None = None,
) -> Iterator[list[PartialFractions]]:
    """Yield the best few fractions of order 0, 1, … `highest`, the best first; `finish`
    makes one of them.

    `band` is the range of Ω to spread poles over, `resonances` are q (poles −q, −q̄)
    that are tried as they are, `pairs` is the largest number of pairs.
    """
    # Nine places, the last ones up to e³ beyond the band. Without those, a controller
    # with a filter takes 6 poles instead of 5, and the best fit of order 8 to an
    # unfiltered one of order 1.2 is 12 % worse.
    spots = np.linspace(math.log(band[0]), math.log(band[1]) + 3.0, 9)
    most = highest if pairs is None else pairs
    empty = np.zeros(0)
    nothing = PartialFractions(0.0, empty, empty, empty, empty, empty.astype(complex))
    best = [[best_residues(nothing, target)]]
    yield best[0]
    for order in range(1, highest + 1):
        starts = [_with_real(c, x) for c in best[order - 1] for x in spots]
        for c in best[order - 2][:2] if order > 1 else ():
            starts += [_with_pair(c, x) for x in spots[3:]] + [
                _with_known(c, q) for q in resonances
            ]
        spread = log_spaced_start(*band, order % 2, order // 2)
        candidates = [
            *_promising(starts, target, most),
            relocate(spread, target),
        ]
        # The 8-norm ranks the candidates almost as their largest errors do. With least
        # squares alone, two of six controllers need one more pole, and a third misses
        # its tolerance.
        fits = [
            improve(c, target, (2, 8)) for c in candidates if len(c.pair_logs) <= most
        ]
        best.append(_distinct(fits, target))
        yield best[order]


def finish(candidates: list[PartialFractions], target: Target) -> PartialFractions:
    """The best of the candidates after the full sequence of norms."""
    return min((improve(c, target) for c in candidates), key=lambda c: _cost(c, target))


def cancellation(fit: PartialFractions, target: Target) -> float:
    """Largest sum of the moduli of all terms over the largest modulus of their sum: 1
    is ideal.
    """
    real, pair, mirrored = fit.shapes(target.x)
    parts = abs(fit.direct) + np.abs(fit.real_gains * real).sum(1)
    parts = parts + 0.5 * (
        np.abs(fit.pair_gains) * (np.abs(pair) + np.abs(mirrored))
    ).sum(1)
    factor = np.abs(target.factor)
    whole = factor * np.abs(fit.columns(target.x) @ fit.linear())
    return float(np.max(parts * factor) / np.max(whole))


def _cost(fit: PartialFractions, target: Target) -> float:
    return score(fit, target) * max(1.0, cancellation(fit, target) / _NOISY)


def _with_real(c: PartialFractions, log: float) -> PartialFractions:
    return replace(
        c,
        real_logs=np.append(c.real_logs, log),
        real_gains=np.append(c.real_gains, 0.0),
    )


def _with_pair(c: PartialFractions, log: float, angle: float = 0.7) -> PartialFractions:
    # η = 0.7 lies 54° off the negative real axis: between two real poles and a
    # resonance.
    return replace(
        c,
        pair_logs=np.append(c.pair_logs, log),
        pair_angles=np.append(c.pair_angles, angle),
        pair_gains=np.append(c.pair_gains, 0j),
    )


def _with_known(c: PartialFractions, q: complex) -> PartialFractions:
    angle = min(abs(cmath.phase(q)) / (0.5 * math.pi), 1 - 1e-9)
    return _with_pair(c, math.log(abs(q)), math.atanh(angle))


def _promising(
    starts: list[PartialFractions], target: Target, pairs: int
) -> list[PartialFractions]:
    fits = [best_residues(c, target) for c in starts if len(c.pair_logs) <= pairs]
    return sorted(fits, key=lambda c: float(np.sum(c.error(target) ** 2)))[:_TRIED]


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
# Source: Gustavsen and Semlyen, IEEE Trans. Power Delivery 14 (1999) 1052; weighted as
# the target asks.


def relocate(start: PartialFractions, target: Target) -> PartialFractions:
    """A fraction (poles only) after twelve rounds, each of which solves a linear
    problem.

    R = N/σ with N = d + Σ r φ and σ = 1 + Σ c φ over the present poles: P N − F Σ c φ =
    F is linear, and the zeros of σ are the next poles.
    """
    here = start
    for _ in range(12):
        basis = here.columns(target.x)
        columns = np.concatenate(
            [target.factor[:, None] * basis, -target.wanted[:, None] * basis[:, 1:]],
            axis=1,
        )
        rows = target.rows(columns)
        size = np.linalg.norm(rows, axis=0) + 1e-300
        # Columns are scaled to equal length: poles three decades apart give columns of
        # very different size, and the cut-off at 1e-13 is meant for dependent columns,
        # not for small ones.
        solution = (
            np.linalg.lstsq(rows / size, target.rows(target.wanted), rcond=1e-13)[0]
            / size
        )
        here = _from_poles(
            _zeros_of_denominator(here, solution[basis.shape[1] :]), target
        )
    return here


def _zeros_of_denominator(at: PartialFractions, weights: Real) -> Complex:
    """Eigenvalues of A − b c for σ(x) = 1 + c (x − A)^(-1) b."""
    n, m = len(at.real_logs), len(at.pair_logs)
    a = np.zeros((n + 2 * m, n + 2 * m))
    c = np.empty(n + 2 * m)
    b = np.ones(n + 2 * m)
    sigma, q = np.exp(at.real_logs), at.poles_of_pairs()
    a[range(n), range(n)] = -sigma
    c[:n] = weights[:n] * sigma
    for k in range(m):
        i = n + 2 * k
        # Column Re c: ½[q/(x+q) + q̄/(x+q̄)], column Im c: ½j[q/(x+q) − q̄/(x+q̄)]. The
        # block of −q with the state (Re, Im), driven by b = (1, 0), gives 1/(x+q) =
        # first + j second.
        gain = q[k] * (weights[n + k] + 1j * weights[n + m + k])
        a[i : i + 2, i : i + 2] = [[-q[k].real, q[k].imag], [-q[k].imag, -q[k].real]]
        b[i : i + 2] = [1.0, 0.0]
        c[i : i + 2] = [gain.real, -gain.imag]
    return np.asarray(np.linalg.eigvals(a - np.outer(b, c)), complex)


def _from_poles(x: Complex, target: Target) -> PartialFractions:
    x = -np.abs(x.real) + 1j * x.imag
    # A pair that rounding alone parts from the real axis is two real poles.
    real = np.sort(-x.real[np.abs(x.imag) <= BLUR * np.abs(x)])
    q = -x[x.imag < -BLUR * np.abs(x)]
    # A pole three decades outside the band acts as a constant or an integrator there;
    # farther out the slope vanishes and Newton's method could not bring it back.
    low, high = target.omega[0] * 1e-3, target.omega[-1] * 1e3
    angle = np.clip(np.angle(q) * 2 / math.pi, 0.01, 0.995)
    return PartialFractions(
        0.0,
        np.log(np.clip(real, low, high)),
        np.zeros(len(real)),
        np.log(np.clip(np.abs(q), low, high)),
        np.arctanh(angle),
        np.zeros(len(q), complex),
    )
