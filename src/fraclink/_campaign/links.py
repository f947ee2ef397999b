"""The links of many runs at once: the recursion of `fraclink._simulate.plant`, vectorised over the arms.

The step response of ``G = ω₀²/(s^λ + ω₀²)`` is, in the link's own time x = Ω t with Ω = ω₀^(2/λ),

``S = 1 − (2/λ) Re e^(x e^(iπ/λ)) − (1/π) ∫ sin(πλ) e^(λv) / |1 + e^(λv + iπλ)|² · e^(−x e^v) dv``,

so one grid in v = ln(r/Ω) serves every payload (Lemma 1's homothety) and only exponentials are left to do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._simulate.plant import LONGEST, POWERS
from fraclink.errors import FieldError

__all__ = ["BatchLinks", "batch_links"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Trapezoidal step in ln r. The integrand's poles lie at distances π(1 − 1/λ) and π(3/λ − 1); the first is
# corrected exactly, and the second, which cannot be (its exponential grows), leaves e^(−2π·1.57/0.6) = 7e-8.
STEP = 0.6
NEGLIGIBLE = 15.0  # e^-15 = 3e-7 of the step response: a Monte Carlo metric is read to 1e-4


@dataclass(frozen=True)
class BatchLinks:
    """Decays and weights of every run's link: first axis the runs, then the powers 0 … 5, then the modes."""

    decay: Real
    weight: Real
    pair: Complex
    pair_weight: Complex
    first: Real


def batch_links(stiff: Real, order: Real, period: float) -> BatchLinks:
    """Return the recursions of links ``G = ω₀²/(s^λ + ω₀²)`` at `period` [s] for a motor angle of degree 5.

    Parameters
    ----------
    stiff
        ω₀² of each run [s^−λ], shape (R,), > 0.
    order
        λ of each run, shape (R,), 1 < λ ≤ 2.
    period
        control period [s]; |pole|·period < 2, beyond that no loop at that period holds.

    Raises
    ------
    FieldError
        a link too fast for the period.

    >>> import numpy as np
    >>> links = batch_links(np.array([123.1, 184.6]), np.array([1.92, 2.0]), 0.004)
    >>> links.weight.shape[:2], links.pair_weight.shape
    ((2, 6), (2, 6, 1))
    """
    speed = stiff ** (1.0 / order)
    reach = speed * period
    if float(reach.max()) >= LONGEST:
        raise FieldError(
            "period",
            period,
            "too long for the fastest link of the campaign",
            allowed=f"< {LONGEST / float(speed.max()):.3g} s",
            remedy="draw heavier payloads or a smaller stiffness",
        )
    grid = _grid(float(reach.min()), float(order.min()))
    density = -np.sin(np.pi * order)[:, None] * np.exp(np.multiply.outer(order, grid)) / np.pi
    density /= np.abs(1.0 + np.exp(order[:, None] * (grid + 1j * np.pi))) ** 2
    # Weight of e^(−r t) in S; over one period a mode answers a step by −gain·(1 − e^(−rT)) of it.
    real = STEP * density
    log_decay = -reach[:, None] * np.exp(grid)
    pole = reach * np.exp(1j * np.pi / order)
    pair = -(2.0 / order) * _correction(order, float(grid[0]))
    weight = _answers(real, log_decay)
    pair_weight = _answers(pair[:, None], pole[:, None])
    at_end = _powers_at_end(stiff, order, period)
    first = at_end - weight.sum(axis=2) - pair_weight.sum(axis=2).real
    return BatchLinks(
        decay=np.exp(log_decay),
        weight=np.ascontiguousarray(weight),
        pair=np.exp(pole[:, None]),
        pair_weight=np.ascontiguousarray(pair_weight),
        first=np.ascontiguousarray(first),
    )


def _grid(reach: float, order: float) -> Real:
    """Nodes v: the density falls like e^(−λ|v|), and above like e^(−e^v ΩT) from one period on."""
    low = -NEGLIGIBLE / order
    high = min(NEGLIGIBLE / order, math.log(NEGLIGIBLE / reach))
    return np.asarray(np.arange(math.floor(low / STEP), math.ceil(high / STEP) + 1) * STEP + 0.5 * STEP)


def _correction(order: Real, start: float) -> Complex:
    """What the trapezoidal rule leaves of a pole's residue: the rule counts the rest of it by itself.

    The density has simple poles at v = ±i y, y = π(1 − 1/λ), whose exponential is the link's own pair.
    """
    y = np.pi * (1.0 - 1.0 / order)
    phase = np.exp(2j * np.pi * start / STEP)
    return np.asarray(1.0 / (1.0 - phase * np.exp(-2.0 * np.pi * y / STEP)))


def _answers(gain: NDArray[np.inexact], log_decay: NDArray[np.inexact]) -> NDArray[np.inexact]:
    """Answer of gain·e^(zt/T), a part of a step response, to x^j over one period, at its end: (R, 6, modes).

    A step's share is gain·(e^z − 1) = gain·z·φ_0, so x^j's is gain·z·φ_j with φ_j = ∫₀¹ x^j e^(z(1−x)) dx.
    """
    near = np.abs(log_decay) < 1.0
    small, large = np.where(near, log_decay, 0.0), np.where(near, 1.0, log_decay)
    rows = []
    by_recursion = np.expm1(large) / large
    for j in range(POWERS):
        by_series = _series(small, j)
        if j:
            by_recursion = (j * by_recursion - 1.0) / large
        rows.append(gain * log_decay * np.where(near, by_series, by_recursion))
    return np.stack(rows, axis=1)


def _series(z: NDArray[np.inexact], power: int) -> NDArray[np.inexact]:
    """φ_j(z) = j! Σ zⁿ/(n + j + 1)! by Horner's rule: 16 terms give 1e-15 for |z| < 1."""
    total = np.zeros_like(z)
    for n in range(16, -1, -1):
        total = math.factorial(power) / math.factorial(n + power + 1) + z * total
    return total


def _powers_at_end(stiff: Real, order: Real, period: float) -> Real:
    """Response of G to x^j at x = 1, from the power series −Σ (−X)ⁿ of G: shape (R, 6)."""
    from scipy.special import gammaln

    ratio = (stiff * period**order)[:, None, None]
    power = np.arange(POWERS)[None, :, None]
    n = np.arange(1, 40)[None, None, :]
    size = n * np.log(ratio) + gammaln(power + 1.0) - gammaln(order[:, None, None] * n + power + 1.0)
    return np.asarray(-np.sum((-1.0) ** n * np.exp(size), axis=2))
