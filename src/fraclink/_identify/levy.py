"""Starting points for a frequency fit: peaks and dips, and Levy's linear equations in x = s^λ.

With H D(x) = N(x) linear in the coefficients of D and N, no guess is needed; the roots of D and N in x are
−p^λ and −z^λ where the response is what the model says. Where a response has more modes than the model,
Levy's roots pair up beside a strong one; its most prominent peaks and dips do not.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

__all__ = ["starting_points"]

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_ORDERS = (1.98, 1.9, 1.75)
_DELAYS = (0.0, 0.3, 1.0)  # in radians at the highest frequency
_ROUNDS = 6
_SPARE = 2  # peaks and dips more than there are modes


def starting_points(
    frequency: Reals,
    response: Complexes,
    weight: Reals,
    resonances: int,
    anti_resonances: int,
    derivative: int,
    *,
    order: float | None,
    delay: float | None,
) -> list[Reals]:
    """Vectors (λ, τ, ln p…, ln z…) to start from, the best of a small grid in λ and τ first."""
    found = []
    scale = float(np.exp(np.mean(np.log(frequency))))
    delays = [d / frequency.max() for d in _DELAYS] if delay is None else [delay]
    for lam in _ORDERS if order is None else (order,):
        x = np.asarray((1j * frequency / scale) ** lam, dtype=np.complex128)
        for tau in delays:
            moved = np.asarray(response * np.exp(1j * frequency * tau) / x**derivative, dtype=np.complex128)
            top, bottom, error = _levy(x, moved, weight, anti_resonances, resonances)
            places = [_places(c, lam, scale) for c in (bottom, top)]
            found.append((error, np.array([lam, tau, *places[0], *places[1]])))
    found.sort(key=lambda pair: pair[0])
    by_eye = []
    for lam in _ORDERS[:2] if order is None else (order,):
        x = np.asarray((1j * frequency) ** lam, dtype=np.complex128)
        for spots in _seen(frequency, response, resonances, anti_resonances):
            error = _misfit(x, response, weight, np.exp(lam * np.array(spots)), resonances, derivative)
            by_eye.append((error, np.array([lam, delays[0], *spots])))
    by_eye.sort(key=lambda pair: pair[0])
    return [point for _, point in found[:2] + by_eye[:3]]


def _seen(frequency: Reals, response: Complexes, peaks: int, dips: int) -> list[tuple[float, ...]]:
    """ln of prominent peaks and dips of |H|, every choice of them; noise may stand out like a mode."""
    level = np.log(np.abs(response) + 1e-300)
    smooth = np.array([np.median(level[max(0, k - 1) : k + 2]) for k in range(level.size)])
    ups, downs = _prominent(smooth, peaks + _SPARE), _prominent(-smooth, dips + _SPARE)
    logs = np.log(frequency)
    return [
        tuple(float(logs[k]) for k in (*up, *down))
        for up in combinations(ups, peaks)
        for down in combinations(downs, dips)
    ]


def _misfit(
    x: Complexes, response: Complexes, weight: Reals, powers: Reals, resonances: int, derivative: int
) -> float:
    basis = x**derivative
    for power in powers[resonances:]:
        basis = basis * (x + power)
    for power in powers[:resonances]:
        basis = basis / (x + power)
    a, b = weight * basis, weight * response
    gain = np.real(np.vdot(a, b)) / np.real(np.vdot(a, a))
    return float(np.linalg.norm(b - gain * a))


def _prominent(level: Reals, count: int) -> list[int]:
    """The `count` local maxima that stand highest over the saddle to a higher one."""
    rows = []
    for k in range(1, level.size - 1):
        if not level[k - 1] < level[k] >= level[k + 1]:
            continue
        saddles = []
        for side in (level[k::-1], level[k:]):
            higher = np.flatnonzero(side > level[k])
            saddles.append(float(np.min(side[: higher[0]] if higher.size else side)))
        rows.append((level[k] - max(saddles), k))
    return sorted(k for _, k in sorted(rows, reverse=True)[:count])


def _levy(
    x: Complexes, response: Complexes, weight: Reals, zeros: int, poles: int
) -> tuple[Reals, Reals, float]:
    """Coefficients (highest first) of N and D with D monic, and the weighted error of their ratio."""
    divisor: Complexes = np.ones(x.size, dtype=np.complex128)
    top, bottom, error = np.ones(zeros + 1), np.ones(poles + 1), np.inf
    for _ in range(_ROUNDS):
        row = (weight / np.abs(divisor))[:, None]
        matrix = row * np.column_stack(
            [x**k for k in range(zeros, -1, -1)] + [-response * x**k for k in range(poles - 1, -1, -1)]
        )
        right = row[:, 0] * response * x**poles
        solution = np.linalg.lstsq(
            np.concatenate([matrix.real, matrix.imag]), np.concatenate([right.real, right.imag]), rcond=None
        )[0]
        top, bottom = solution[: zeros + 1], np.concatenate([[1.0], solution[zeros + 1 :]])
        divisor = np.asarray(np.polyval(bottom, x), dtype=np.complex128)
        error = float(np.linalg.norm(weight * (response - np.polyval(top, x) / divisor)))
    return top, bottom, error


def _places(coefficients: Reals, order: float, scale: float) -> list[float]:
    """ln of the frequencies |root|^(1/λ) of a polynomial in x."""
    roots = np.roots(coefficients) if np.any(coefficients[:-1]) else np.zeros(0)
    missing = coefficients.size - 1 - roots.size
    sizes = np.sort(np.abs(roots)).tolist() + [1.0] * missing
    return [float(np.log(max(size, 1e-9)) / order + np.log(scale)) for size in sizes]
