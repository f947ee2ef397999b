"""Minimax partial fractions: the poles and residues with the smallest worst error at given frequencies.

    R(x) = P(x) [ d + Σ r_i σ_i/(x + σ_i) + Σ Re-symmetric pairs ],      x = jΩ

The worst error is reached through the p-norm with p = 2, 4, … 128: each is a smooth problem solved by
Newton's method (the exact Hessian of the p-norm of a linearised error) from the solution of the last,
which ends within ln(rows)/128 ≈ 4 % of the minimax error and never leaves the stable half plane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "PartialFractions",
    "Target",
    "best_residues",
    "improve",
    "log_spaced_start",
    "newton",
    "score",
]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

_POWERS = (2, 4, 8, 16, 32, 64, 128)
_STEPS = 12  # Newton steps for each power; quadratic convergence needs 4 to 8


@dataclass(frozen=True)
class Target:
    """What is to be met: R(jΩ_k) = wanted_k, with the errors' real and imaginary parts weighted."""

    omega: Real  # Ω, the frequency on the plane of x
    factor: Complex  # P(jΩ)
    wanted: Complex
    turn: Complex  # the error is multiplied by this: 1/(offset + wanted), so that Re is nepers and Im radians
    weight_real: Real
    weight_imag: Real

    def rows(self, values: Complex) -> Real:
        """Real rows of a complex error (or of columns of a Jacobian): tolerances are 1."""
        turned = values * (self.turn if values.ndim == 1 else self.turn[:, None])
        shape = (-1,) if values.ndim == 1 else (-1, 1)
        return np.concatenate(
            [turned.real * self.weight_real.reshape(shape), turned.imag * self.weight_imag.reshape(shape)]
        )


@dataclass(frozen=True)
class PartialFractions:
    """Poles x = −e^θ (real) and −e^(θ ± jψ) (pairs), |ψ| < π/2, with residues; all parameters real.

    A pair's term is Re-symmetric: ½ [c q/(x + q) + c̄ q̄/(x + q̄)] with q = e^(θ + jψ).
    """

    direct: float
    real_logs: Real
    real_gains: Real
    pair_logs: Real
    pair_angles: Real  # η: ψ = (π/2) tanh η keeps every pair in the stable half plane
    pair_gains: Complex

    def columns(self, omega: Real) -> Complex:
        """The basis: 1, σ/(x+σ), and for each pair the columns of Re c and Im c; shape (M, order + 1)."""
        return self._linear_columns(*self.shapes(omega))

    def all_columns(self, omega: Real) -> Complex:
        """`columns`, and the derivatives of R/P by θ of the real poles, θ and η of the pairs."""
        shapes = self.shapes(omega)
        return np.concatenate([self._linear_columns(*shapes), self._pole_columns(*shapes)], axis=1)

    def _linear_columns(self, real: Complex, pair: Complex, mirrored: Complex) -> Complex:
        return np.concatenate(
            [np.ones((len(real), 1)), real, 0.5 * (pair + mirrored), 0.5j * (pair - mirrored)], axis=1
        )

    def shapes(self, omega: Real) -> tuple[Complex, Complex, Complex]:
        """σ/(x + σ), q/(x + q) and q̄/(x + q̄) at x = jΩ, one column for each pole."""
        x = 1j * omega[:, None]
        sigma, q = np.exp(self.real_logs), self.poles_of_pairs()
        return sigma / (x + sigma), q / (x + q), q.conj() / (x + q.conj())

    def poles_of_pairs(self) -> Complex:
        """q = e^(θ + jψ), so that the poles are −q and −q̄."""
        return np.exp(self.pair_logs + 0.5j * math.pi * np.tanh(self.pair_angles))

    def _pole_columns(self, real: Complex, pair: Complex, mirrored: Complex) -> Complex:
        # d/dθ of q/(x+q) is q x/(x+q)² = shape · (1 − shape).
        by_real = self.real_gains * real * (1 - real)
        up, down = self.pair_gains * pair * (1 - pair), self.pair_gains.conj() * mirrored * (1 - mirrored)
        slope = 0.5 * math.pi / np.cosh(self.pair_angles) ** 2
        return np.concatenate([by_real, 0.5 * (up + down), 0.5j * slope * (up - down)], axis=1)

    def linear(self) -> Real:
        """The linear parameters in the order of `columns`."""
        c = self.pair_gains
        return np.concatenate([[self.direct], self.real_gains, c.real, c.imag])

    def with_linear(self, values: Real) -> PartialFractions:
        """The same poles with other residues."""
        n, m = len(self.real_logs), len(self.pair_logs)
        gains = values[1 + n : 1 + n + m] + 1j * values[1 + n + m :]
        return PartialFractions(
            float(values[0]), self.real_logs, values[1 : 1 + n], self.pair_logs, self.pair_angles, gains
        )

    def moved(self, step: Real) -> PartialFractions:
        """All parameters moved by a step in the order of `all_columns`."""
        n, m = len(self.real_logs), len(self.pair_logs)
        linear, poles = step[: 1 + n + 2 * m], step[1 + n + 2 * m :]
        there = PartialFractions(
            self.direct,
            self.real_logs + poles[:n],
            self.real_gains,
            self.pair_logs + poles[n : n + m],
            self.pair_angles + poles[n + m :],
            self.pair_gains,
        )
        return there.with_linear(self.linear() + linear)

    def error(self, target: Target) -> Real:
        """Weighted error in rows."""
        return target.rows(target.factor * (self.columns(target.omega) @ self.linear()) - target.wanted)


def log_spaced_start(low: float, high: float, real: int, pairs: int) -> PartialFractions:
    """Poles spread evenly on a logarithmic scale of Ω: real ones below, pairs at 45° above."""
    count = real + pairs
    logs = math.log(low) + (np.arange(count) + 0.5) / count * math.log(high / low)
    return PartialFractions(
        0.0, logs[:real], np.zeros(real), logs[real:], np.full(pairs, 0.55), np.zeros(pairs, dtype=complex)
    )


def improve(start: PartialFractions, target: Target) -> PartialFractions:
    """The best fractions of the start's structure that Newton's method reaches from it."""
    current = best_residues(start, target)
    for power in _POWERS:
        current = newton(current, target, power)
    return current


def best_residues(at: PartialFractions, target: Target) -> PartialFractions:
    columns = target.rows(target.factor[:, None] * at.columns(target.omega))
    size = np.linalg.norm(columns, axis=0)
    solution = np.linalg.lstsq(columns / size, target.rows(target.wanted), rcond=1e-12)[0] / size
    return at.with_linear(solution)


def newton(at: PartialFractions, target: Target, power: int) -> PartialFractions:
    """Newton's method with Marquardt's damping for the smallest Σ |error|^power near `at`."""
    error, damping = at.error(target), 1e-3
    for _ in range(_STEPS):
        peak = float(np.max(np.abs(error)))
        if peak == 0:
            return at
        directions = _Directions.of(at, target, error / peak, power)
        old = _norm(error / peak, power)
        for _ in range(8):
            there = at.moved(peak * directions.step(damping, len(at.linear()), peak))
            error = there.error(target)
            new = _norm(error / peak, power)
            if new < old:
                break
            damping = max(damping, 1e-9) * 10
        else:
            return at
        at, damping = there, damping * 0.1
        if 1 - new / old < 1e-4 * power:
            return at
    return at


def _norm(ratio: Real, power: int) -> float:
    # 10^128 is far below the largest double; a step that makes the worst error ten times larger is refused.
    return math.inf if np.max(np.abs(ratio)) > 10 else float(np.sum(np.abs(ratio) ** power))


@dataclass(frozen=True)
class _Directions:
    """Newton's equations (p−1) Jᵀ W² J δ = −Jᵀ W² e, factored: every damping costs two small products."""

    values: Real
    right: Real
    back: Real
    size: Real

    @classmethod
    def of(cls, at: PartialFractions, target: Target, ratio: Real, power: int) -> _Directions:
        columns = at.all_columns(target.omega)
        weight = np.abs(ratio) ** (0.5 * power - 1)
        left = target.rows(target.factor[:, None] * columns) * weight[:, None]
        size = np.linalg.norm(left, axis=0) + 1e-300
        both = np.column_stack([left / size, -weight * ratio / (power - 1)])
        triangle = np.asarray(np.linalg.qr(both, mode="r"))
        u, values, back = np.linalg.svd(triangle[:, :-1], full_matrices=False)
        return cls(values, u.T @ triangle[:, -1], back, size)

    def step(self, damping: float, first_pole: int, peak: float) -> Real:
        """The damped step; no pole moves by more than e at once, so that none jumps over its neighbours."""
        filtered = self.right * self.values / (self.values**2 + damping * self.values[0] ** 2)
        step: Real = (self.back.T @ filtered) / self.size
        longest = peak * float(np.max(np.abs(step[first_pole:]), initial=0.0))
        return step * min(1.0, 1.0 / max(longest, 1e-300))


def score(fit: PartialFractions, target: Target) -> float:
    """Worst weighted error: 1 is the tolerance."""
    return float(np.max(np.abs(fit.error(target))))
