"""Zeros of fractional polynomials Σ a_k s^α_k, found on the log-plane with a certified count.

With z = ln s a fractional polynomial becomes the entire function D(z) = Σ a_k e^(α_k z). The sheets of
its Riemann surface lie above each other in strips of the z-plane: |Im z| ≤ π is the principal one, and the
right half plane is |Im z| < π/2. Nothing is truncated or made commensurate: 1.92 and √2 cost the same.

The count is the argument principle. Left and right of all zeros one term dominates; between, a step
of half-length ρ around z is accepted only if ρ|D'(z)| + ρ²/2 |D″(z)| + ρ³/6 |D‴(z)| + ρ⁴/24 max |D⁗| is
smaller than |D(z)|: the image then lies in a disc that does not contain the origin, so that the change of
phase is the principal argument of the quotient of its ends (up to a stated allowance for rounding).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._systems.roots.count import count_strip
from fraclink._systems.roots.exponential import ROUNDING, ExponentialSum, NearZeroError
from fraclink._systems.roots.search import aberth, bisect, newton_polygon, settle_clusters
from fraclink.errors import FieldError, NotConvergedError

__all__ = [
    "ExponentialSum",
    "NearZeroError",
    "count_zeros",
    "log_zeros",
    "newton_polygon",
    "two_term_zeros",
]

# Heights at which the counted strip may end above `angle`: the first that no zero is near is taken.
# The wide ones are for multiple zeros on the edge: below them D is lost in rounding, 0.13^12 of its terms.
_MARGINS = (0.0618, 0.0382, 0.0871, 0.0197, 0.1303, 0.0093, 0.2419, 0.3704)
_ON_EDGE = 1e-12  # a zero computed this far above `angle` (or off the real axis) lies on it
_BLURRED = 1e-7  # and at most this far where rounding blurs it; a multiple zero has D' = 0


def count_zeros(coefficients: ArrayLike, orders: ArrayLike, *, angle: float) -> int:
    """Return the certified number of zeros of Σ a_k s^α_k with |arg s| < `angle`.

    Conjugates and multiplicities are counted, s = 0 is not. `angle` [rad] is > 0 and may exceed π (sheets
    of the Riemann surface). Raises `NotConvergedError` when a zero lies on |arg s| = `angle`.

    >>> count_zeros([1.0, 1.0], [0.0, 2.0], angle=3.0)
    2
    """
    terms = ExponentialSum.of(coefficients, orders)
    return 0 if len(terms.rates) < 2 else count_strip(terms, _checked(angle))


def log_zeros(coefficients: ArrayLike, orders: ArrayLike, *, angle: float) -> NDArray[np.complex128]:
    """Return z = ln s of every zero of Σ a_k s^α_k with 0 ≤ arg s ≤ `angle`.

    Σ_k a_k e^(α_k z) = 0, with z = ln|s| + j arg s.

    Parameters
    ----------
    coefficients : array_like, shape (K,)
        Real a_k. Equal orders are merged.
    orders : array_like, shape (K,)
        Real α_k; only their differences matter.
    angle : float
        Largest argument [rad], ≥ 0. π is the principal sheet with its cut, π/2 the closed right half plane.

    Returns
    -------
    ndarray of complex128
        Sorted by argument, then by modulus; an m-fold zero stands there m times with one value. Zeros on the
        positive real axis have Im z = 0 exactly, zeros on the edge Im z = `angle` exactly. Conjugates
        (−arg s) are not repeated. A common factor s^a (a zero at s = 0, z = −∞) is not listed.

    Raises
    ------
    FieldError
        Arrays of different shape, values that are not finite, all coefficients zero, a bad angle.
    NotConvergedError
        The certified count could not be reached.

    References
    ----------
    Argument principle on the log-plane; Aberth, Math. Comp. 27 (1973) 339; Newton polygon as in
    Bini, Numer. Algorithms 13 (1996) 179.

    Examples
    --------
    >>> import numpy as np
    >>> z = log_zeros([1.0, 2.0, 1.0], [2.0, 1.0, 0.0], angle=np.pi)  # (s + 1)²
    >>> np.exp(z).real
    array([-1., -1.])
    """
    angle = _checked(angle)
    terms = ExponentialSum.of(coefficients, orders)
    if len(terms.rates) < 2:
        return np.empty(0, dtype=complex)
    if len(terms.rates) == 2:
        (low, high), gap = terms.coefficients, terms.rates[1]
        return _upper(terms, np.array(two_term_zeros(low / high, gap, angle), dtype=complex), angle)
    height, count = _counted(terms, angle)
    found = settle_clusters(terms, aberth(terms, height, count))
    if not _complete(found, count):
        found = _by_bisection(terms, height, count)
    return _upper(terms, found, angle)


def two_term_zeros(ratio: float, gap: float, angle: float) -> list[complex]:
    """Zeros of s^gap + ratio = 0 (ratio ≠ 0, gap > 0) by hand: gap z = ln(−ratio) + 2πjm, 0 ≤ Im z ≤ angle.

    >>> two_term_zeros(1.0, 2.0, 2.0)
    [1.5707963267948966j]
    """
    size = math.log(abs(ratio)) / gap
    first = math.pi if ratio > 0 else 0.0
    last = (
        int(((angle + _ON_EDGE) * gap - first) / (2 * math.pi) + 1)
        if first <= (angle + _ON_EDGE) * gap
        else 0
    )
    return [complex(size, (first + 2 * math.pi * m) / gap) for m in range(last)]


def _checked(angle: float) -> float:
    if not (math.isfinite(angle) and angle >= 0):
        raise FieldError(
            "angle",
            angle,
            "not a usable argument",
            allowed="0 rad to a few turns",
            remedy="use math.pi for the principal sheet",
        )
    return float(angle)


def _counted(terms: ExponentialSum, angle: float) -> tuple[float, int]:
    for margin in _MARGINS:
        try:
            return angle + margin, count_strip(terms, angle + margin)
        except NotConvergedError:  # a zero lies near this height, or the phase drowned in rounding beside one
            continue
    raise NotConvergedError(
        "counting zeros",
        reached=0,
        wanted=1,
        remedy="a zero lies near every height tried above the angle, or is of too high a multiplicity "
        "(above eight the digits run out); cancel common factors or choose another angle",
    )


def _complete(found: NDArray[np.complex128], count: int) -> bool:
    """As many as certified, and closed under conjugation (two points on one zero would not be)."""
    if len(found) != count:
        return False
    distance = np.abs(found[:, None] - found.conj()[None, :])
    return bool(np.all(distance.min(axis=1, initial=np.inf) < 1e-9))


def _by_bisection(terms: ExponentialSum, height: float, count: int) -> NDArray[np.complex128]:
    low, high = terms.bounds
    # The walls stand a little beyond the bounds so that no side runs along a place of equal terms.
    found = bisect(terms, complex(low - 0.1, -height), complex(high + 0.1, height), count)
    found = settle_clusters(terms, found)
    if len(found) != count:
        raise NotConvergedError(
            "zeros found", reached=len(found), wanted=count, remedy="report the coefficients and orders"
        )
    return found


def _upper(terms: ExponentialSum, found: NDArray[np.complex128], angle: float) -> NDArray[np.complex128]:
    z = found.copy()
    # A zero in a close company is known to ε/|D'| only; left a hair beyond the edge it would be lost.
    values, moduli = terms.derivatives(z, 2)
    known = 4.0 * ROUNDING * moduli[0] / np.maximum(np.abs(values[1]), 1e-300)
    reach = np.clip(known, _ON_EDGE, _BLURRED)
    z.imag[np.abs(z.imag) < reach] = 0.0
    z.imag[np.abs(z.imag - angle) < reach * (1 + angle)] = angle
    z = z[(z.imag >= 0) & (z.imag <= angle)]
    return np.asarray(z[np.lexsort((z.real, z.imag))])
