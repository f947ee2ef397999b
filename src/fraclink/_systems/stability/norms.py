"""The H2 and H∞ norms of stable fractional systems."""

from __future__ import annotations

import cmath
import itertools
import math

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.fractional.checks import checked_system
from fraclink._systems.stability.fractional_loop import FractionalLoop
from fraclink._systems.stability.poles import is_stable
from fraclink._systems.stability.polish import extreme, gain_level
from fraclink._systems.stability.quadrature import integrate
from fraclink._systems.stability.sweep import sweep
from fraclink.errors import FieldError, UnstableError

__all__ = ["norm"]

Real = NDArray[np.float64]

_TOLERANCE = 1e-13
# In ln ω: where terms a gap of orders apart differ by e^(−37) ≈ 1e-16 the response is its own asymptote.
_NEGLIGIBLE = 37.0


def norm(system: FractionalTransferFunction, p: float) -> float:
    """Return the H2 norm (p = 2) or the H∞ norm (p = inf) of a stable system.

    ‖G‖₂² = (1/π) ∫₀^∞ |G(jω)|² dω,      ‖G‖∞ = sup |G(jω)|

    Parameters
    ----------
    system : FractionalTransferFunction
        Stable; for p = 2 with a relative degree > 1/2, for p = inf proper. Delays are allowed.
    p : float
        2 or `math.inf` [1].

    Returns
    -------
    float
        p = 2: adaptive quadrature over ln ω to 1e-13 with the tails beyond it by their known powers;
        p = inf: the highest peak polished to rounding, or a limit at ω → 0 or ∞.

    Raises
    ------
    UnstableError
        A pole in Re s > 0 or on the imaginary axis (an undamped resonance), an integrator.
    FieldError
        Another p; a system that decays too slowly for p = 2; an improper system for p = inf.

    References
    ----------
    Malti et al., Automatica 47 (2011) 2425, for the H2 norm's condition on the relative degree.

    Examples
    --------
    >>> import math
    >>> from fraclink._systems.fractional import s
    >>> G = 100 / (s**2 + 2 * s + 100)
    >>> round(norm(G, 2), 12), round(norm(G, math.inf), 12)
    (5.0, 5.025189076296)
    """
    checked_system("system", system)
    if not (isinstance(p, int | float) and p in (2, math.inf)):
        raise FieldError("p", p, "not a norm offered here", allowed="2 or inf", remedy="use 2 or math.inf")
    if not system.numerator:
        return 0.0
    verdict = is_stable(system)
    if not verdict:
        raise UnstableError(
            "system",
            repr(system),
            f"not stable: {verdict.reason}",
            allowed="stable systems",
            remedy="close a loop around it, add damping, or use margins",
        )
    degree = system.relative_degree
    if p == 2 and degree <= 0.5:
        raise FieldError(
            "system",
            repr(system),
            f"of relative degree {degree:g}: its H2 norm is infinite",
            allowed="relative degree > 1/2",
            remedy="multiply by a low-pass filter, as the real input would",
        )
    if degree < 0:
        raise FieldError(
            "system",
            repr(system),
            "improper: its gain grows without bound",
            allowed="proper systems",
            remedy="multiply by a low-pass filter, as the real input would",
        )
    loop = FractionalLoop.of(system, None)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return _h2(system, loop) if p == 2 else _peak(loop)


def _h2(system: FractionalTransferFunction, loop: FractionalLoop) -> float:
    gap = min((b - a for a, b in _neighbours(system)), default=1.0)
    spare = _NEGLIGIBLE / max(gap, 0.02)
    low, high = loop.low - spare, loop.high + spare

    def density(x: Real) -> Real:
        return np.asarray(np.exp(2 * loop.log_modulus(x.ravel()).reshape(x.shape) + x))

    seeds = loop.seeds[::4]
    edges = np.unique(np.concatenate([np.arange(low, high, 2.0), [high], seeds]))
    # A pole at the distance d from the axis: 16 Gauss points on d/4 are exact to 1e-16.
    distance = min((abs(z.imag - 0.5 * math.pi) for z in loop.zeros), default=0.3)
    inside = integrate(density, edges, _TOLERANCE, smooth=0.25 * min(distance, 0.3))
    # Beyond the edges |G|² ω ~ ω^p: ∫ = density/|p|.
    rise = 1 + 2 * _slope(system, -1)
    fall = 2 * system.relative_degree - 1
    ends = density(np.array([low, high]))
    return math.sqrt((inside + float(ends[0]) / rise + float(ends[1]) / fall) / math.pi)


def _neighbours(system: FractionalTransferFunction) -> list[tuple[float, float]]:
    """Pairs of neighbouring orders in numerator and denominator that differ."""
    pairs = []
    for terms in (system.numerator, system.denominator):
        orders = sorted({t.order for t in terms})
        pairs += list(itertools.pairwise(orders))
    return pairs


def _slope(system: FractionalTransferFunction, end: int) -> float:
    """Order of G at ω → 0 (end = −1) or at ω → ∞ (end = 0)."""
    return system.numerator[end].order - system.denominator[end].order


def _peak(loop: FractionalLoop) -> float:
    x, values, _ = sweep(loop)
    size = np.abs(values)
    inner = (size[1:-1] >= size[:-2]) & (size[1:-1] >= size[2:])
    largest = float(size.max())
    for i in (np.flatnonzero(inner) + 1).tolist():
        if size[i] > 0.5 * largest:
            _, value = extreme(loop, lambda v, s: gain_level(v, s)[1], float(x[i - 1]), float(x[i + 1]))
            largest = max(largest, abs(value))
    # A response that approaches its supremum at ω → 0 or ∞ has it as the ratio of two coefficients.
    return max(largest, *(abs(limit) for limit in loop.ends if not cmath.isnan(limit)))
