"""Starting poles by pole relocation (vector fitting), reflected into the stable half plane.

Source: Gustavsen and Semlyen, IEEE Trans. Power Delivery 14 (1999) 1052; weighted as the target asks.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.rational.minimax import PartialFractions, Target

__all__ = ["relocate"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

_REAL = 1e-6  # a pair closer than this to the real axis (relative) is two real poles


def relocate(start: PartialFractions, target: Target, rounds: int) -> list[PartialFractions]:
    """Fractions (poles only) after each of the last rounds; each round solves one linear problem.

    R = N/σ with N = d + Σ r φ and σ = 1 + Σ c φ over the present poles: P N − F Σ c φ = F is linear, and
    the zeros of σ are the next poles.
    """
    visited, here = [], start
    for _ in range(rounds):
        basis = here.columns(target.omega)
        left = np.concatenate(
            [target.factor[:, None] * basis, -target.wanted[:, None] * basis[:, 1:]], axis=1
        )
        rows = target.rows(left)
        size = np.linalg.norm(rows, axis=0) + 1e-300
        solution = np.linalg.lstsq(rows / size, target.rows(target.wanted), rcond=1e-13)[0] / size
        here = _from_poles(_zeros_of_denominator(here, solution[basis.shape[1] :]), target)
        visited.append(here)
    return visited


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
        # Column Re c: ½[q/(x+q) + q̄/(x+q̄)], column Im c: ½j[q/(x+q) − q̄/(x+q̄)]: the block of −q with
        # state (Re, Im) driven by b = (1, 0) gives 1/(x+q) = first + j second.
        gain = q[k] * (weights[n + k] + 1j * weights[n + m + k])
        a[i : i + 2, i : i + 2] = [[-q[k].real, q[k].imag], [-q[k].imag, -q[k].real]]
        b[i : i + 2] = [1.0, 0.0]
        c[i : i + 2] = [gain.real, -gain.imag]
    return np.asarray(np.linalg.eigvals(a - np.outer(b, c)), dtype=complex)


def _from_poles(x: Complex, target: Target) -> PartialFractions:
    x = -np.abs(x.real) + 1j * x.imag
    real = np.sort(-x.real[np.abs(x.imag) <= _REAL * np.abs(x)])
    q = -x[x.imag < -_REAL * np.abs(x)]
    low, high = target.omega[0] * 1e-3, target.omega[-1] * 1e3
    angle = np.clip(np.angle(q) * 2 / math.pi, 0.01, 0.995)
    return PartialFractions(
        0.0,
        np.log(np.clip(real, low, high)),
        np.zeros(len(real)),
        np.log(np.clip(np.abs(q), low, high)),
        np.arctanh(angle),
        np.zeros(len(q), dtype=complex),
    )
