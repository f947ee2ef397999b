"""Zeros of fractional polynomials Σ a_k s^α_k, found on the log-plane with a certified
count.

With z = ln s a fractional polynomial becomes the entire function D(z) = Σ a_k e^(α_k
z). The sheets of its Riemann surface lie above each other in strips of the z-plane: |Im
z| ≤ π is the principal one, and the right half plane is |Im z| < π/2. Nothing is
truncated or made commensurate: 1.92 and √2 cost the same.

The count is the argument principle. Left and right of all zeros one term dominates;
between, a step of half-length ρ around z is accepted only if ρ|D'(z)| + ρ²/2 |D″(z)| +
ρ³/6 |D‴(z)| + ρ⁴/24 max |D⁗| is smaller than |D(z)|: the image then lies in a disc that
does not contain the origin, so that the change of phase is the principal argument of
the quotient of its ends (up to a stated allowance for rounding).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fracsys._exponential import LIMIT, ExponentialSum, count_strip
from fracsys._precision import BLUR, COINCIDENT, RESOLUTION, ROUNDING
from fracsys._terms import Term
from fracsys.checks import Complex, Mask
from fracsys.errors import NotConvergedError

# Candidate heights above `angle` for the upper edge of the counted strip: the first one
# without a zero nearby is used. The large ones are for multiple zeros on the edge: at
# smaller heights D is lost in rounding (0.13^12 of its terms).
_MARGINS = (0.0618, 0.0382, 0.0871, 0.0197, 0.1303, 0.0093, 0.2419, 0.3704)


def log_zeros(coefficients: ArrayLike, orders: ArrayLike, *, angle: float) -> Complex:
    """Return z = ln s of every zero of Σ a_k s^α_k with 0 ≤ arg s ≤ `angle`.

    Σ_k a_k e^(α_k z) = 0, with z = ln|s| + j arg s.

    Zeros are sorted by argument, then by modulus; an m-fold zero is listed m times with
    the same value. Zeros on the positive real axis have Im z = 0 exactly, zeros on the
    edge Im z = `angle` exactly. Conjugates (−arg s) are not repeated. A common factor
    s^a (a zero at s = 0, z = −∞) is not listed.

    Parameters
    ----------
    coefficients
        Real a_k. Equal orders are merged.
    orders
        Real α_k; only their differences matter.
    angle
        Largest argument [rad], ≥ 0. π is the principal sheet with its cut, π/2 the
        closed right half plane.

    Raises
    ------
    NotConvergedError
        The certified count could not be reached.

    References
    ----------
    Argument principle on the log-plane; Aberth, Math. Comp. 27 (1973) 339; Newton
    polygon as in Bini, Numer. Algorithms 13 (1996) 179.

    Examples
    --------
    >>> import numpy as np
    >>> z = log_zeros([1.0, 2.0, 1.0], [2.0, 1.0, 0.0], angle=np.pi)  # (s + 1)²
    >>> np.exp(z).real
    array([-1., -1.])
    """
    terms = ExponentialSum.of(coefficients, orders)
    if len(terms.rates) < 2:
        return np.empty(0, dtype=complex)
    if len(terms.rates) == 2:
        (low, high), gap = terms.coefficients, terms.rates[1]
        return np.array(two_term_zeros(low / high, gap, angle), dtype=complex)
    height, count = _counted(terms, angle)
    zeros = settle_clusters(terms, aberth(terms, height, count))
    # D is real: where only one of a pair was reached, the other is its conjugate. Both
    # agree to about 1e-14 where both were.
    distance = np.abs(zeros[:, None] - zeros.conj()[None, :])
    alone = distance.min(axis=1, initial=np.inf) > COINCIDENT
    zeros = np.append(zeros, zeros[alone].conj())
    if len(zeros) != count:
        raise NotConvergedError(
            "zeros found",
            reached=len(zeros),
            wanted=count,
            remedy="report the coefficients and orders",
        )
    return _upper(terms, zeros, angle)


def zeros_of_terms(terms: Sequence[Term], angle: float) -> Complex:
    """Return `log_zeros` of a sum of terms without delays, sorted by order."""
    a, orders = [t.coefficient for t in terms], [t.order for t in terms]
    return log_zeros(a, orders, angle=angle)


def two_term_zeros(ratio: float, gap: float, angle: float) -> list[complex]:
    """Zeros of s^gap + ratio = 0 (ratio ≠ 0, gap > 0) in closed form: gap z =
    ln(−ratio) + 2πjm, 0 ≤ Im z ≤ angle.

    Zeros next to the edge by rounding lie on it.

    >>> two_term_zeros(1.0, 2.0, 2.0)
    [1.5707963267948966j]
    """
    size = math.log(abs(ratio)) / gap
    first = math.pi if ratio > 0 else 0.0
    last = (
        int(((angle + RESOLUTION) * gap - first) / (2 * math.pi) + 1)
        if first <= (angle + RESOLUTION) * gap
        else 0
    )
    heights = ((first + 2 * math.pi * m) / gap for m in range(last))
    return [
        complex(size, angle if abs(y - angle) < RESOLUTION * (1 + angle) else y)
        for y in heights
    ]


def _counted(terms: ExponentialSum, angle: float) -> tuple[float, int]:
    for margin in _MARGINS:
        try:
            return angle + margin, count_strip(terms, angle + margin)
        except (
            NotConvergedError
        ):  # a zero lies near this height, or the phase near one was lost in rounding
            continue
    raise NotConvergedError(
        "counting zeros",
        reached=0,
        wanted=1,
        remedy="a zero lies near every height tried above the angle, or is of too high a multiplicity "
        "(above eight the digits run out); cancel common factors or choose another angle",
    )


def _upper(terms: ExponentialSum, points: Complex, angle: float) -> Complex:
    z = points.copy()
    # In a close group a zero is known to ε/|D'| only; without the tolerance one
    # slightly beyond the edge would be lost.
    values, moduli = terms.derivatives(z, 2)
    uncertainty = 4.0 * ROUNDING * moduli[0] / np.maximum(np.abs(values[1]), 1e-300)
    reach = np.clip(uncertainty, RESOLUTION, BLUR)  # a multiple zero has D' = 0
    z.imag[np.abs(z.imag) < reach] = 0.0
    z.imag[np.abs(z.imag - angle) < reach * (1 + angle)] = angle
    z = z[(z.imag >= 0) & (z.imag <= angle)]
    return z[np.lexsort((z.real, z.imag))]


# --- Where the zeros are: Aberth's iteration from the Newton polygon


def newton_polygon(sum_: ExponentialSum) -> list[tuple[int, int]]:
    """Edges (j, k) of the upper convex hull of the points (ν, ln|a|), from the lowest
    rate to the highest.
    """
    hull: list[int] = []
    x, y = sum_.rates, np.log(np.abs(sum_.coefficients))
    for k in range(len(x)):
        while len(hull) > 1:
            i, j = hull[-2:]
            if (y[j] - y[i]) * (x[k] - x[i]) > (y[k] - y[i]) * (x[j] - x[i]):
                break
            hull.pop()
        hull.append(k)
    return list(itertools.pairwise(hull))


def _starts(sum_: ExponentialSum, height: float) -> Complex:
    """Zeros of the two terms of each edge of the Newton polygon, in |Im z| ≤ height and
    one spacing beyond.
    """
    a, nu = sum_.coefficients, sum_.rates
    points: list[complex] = []
    for j, k in newton_polygon(sum_):
        gap = nu[k] - nu[j]
        x = math.log(abs(a[j] / a[k])) / gap
        first = math.pi / gap if a[j] * a[k] > 0 else 0.0
        reach = math.ceil((height + 0.5) * gap / (2 * math.pi)) + 1
        if len(points) + 2 * reach > LIMIT:
            raise NotConvergedError(
                "zeros to find",
                reached=2 * reach,
                wanted=LIMIT,
                remedy="lower the orders: no physical model needs thousands of poles",
            )
        points += [
            complex(x, first + 2 * math.pi * m / gap) for m in range(-reach, reach + 1)
        ]
    # With exact symmetry about the real axis, starts on it could never leave it for a
    # conjugate pair.
    return np.array(points) + 1e-3j


def aberth(sum_: ExponentialSum, height: float, count: int) -> Complex:
    """Simultaneous Newton iteration with mutual repulsion until `count` points with |Im
    z| ≤ height rest.

    D has infinitely many zeros: those beyond the points repel together like a factor
    e^(cz), and c is the mean rate of the terms. Points that leave the region of the zeros
    start again inside it, beside one of the starts.
    """
    starts = _starts(sum_, height)
    z, fresh = starts.copy(), 1
    (low, high), rest = sum_.bounds, np.zeros(len(z), dtype=bool)
    for _ in range(LIMIT):
        values, moduli = sum_.derivatives(z, 2)
        # At the level of rounding the quotient D/D' is noise and would throw points off
        # a multiple zero.
        settled = np.abs(values[0]) <= 4e-16 * moduli[0]
        slope = values[1] - moduli[1] / moduli[0] * values[0]
        newton = np.where(settled, 0, values[0] / np.where(slope == 0, 1e-300, slope))
        distance = z[:, None] - z[None, :]
        distance[distance == 0] = np.inf
        step = newton / (1 - newton * (1 / distance).sum(axis=1))
        # A step longer than the usual spacing of the zeros leaves the basin of the
        # starting zero. The zeros of two terms are 2π/ν apart; 0.7 is the smallest
        # spacing in practice, for ν ≤ 8.
        step *= np.minimum(1.0, 0.7 / np.maximum(np.abs(step), 1e-300))
        z = z - step
        # Newton's method converges quadratically: after a relative step of 1e-9 the
        # zero is known to 1e-18.
        rest = settled | (np.abs(step) < COINCIDENT * (1.0 + np.abs(z)))
        inside = np.abs(z.imag) <= height
        if np.count_nonzero(rest & inside) >= count:
            break
        for i in np.flatnonzero(
            ~rest & ((z.real < low) | (z.real > high) | (np.abs(z.imag) > height + 2))
        ):
            # Multiples of two irrational numbers, modulo 1, fill the square evenly.
            right, up = fresh * math.sqrt(2.0) % 1.0, fresh * math.sqrt(3.0) % 1.0
            beside = starts[fresh % len(starts)].real + right - 0.5
            z[i] = complex(beside, (2.0 * up - 1.0) * height)
            fresh += 1
    return z[rest & (np.abs(z.imag) <= height)]


def settle_clusters(sum_: ExponentialSum, points: Complex) -> Complex:
    """Refine every zero; points at the same multiple zero get the same value.

    m points near one m-fold zero are known to ε^(1/m) only, but that zero is a simple
    one of D^(m−1). The multiplicity is accepted if D … D^(m−2) vanish there within
    rounding.
    """
    result = np.empty_like(points)
    free = np.ones(len(points), dtype=bool)
    for i in range(len(points)):
        if free[i]:
            near, centre = _cluster(sum_, points, free, i)
            result[near] = centre
            free &= ~near
    return result


def _cluster(
    sum_: ExponentialSum, points: Complex, free: Mask, i: int
) -> tuple[Mask, complex]:
    """The points that represent the same zero as points[i], and that zero."""
    distance = np.where(free, np.abs(points - points[i]), math.inf)
    nearest = np.argsort(distance)
    # Most points first: two of the twelve around a twelvefold zero would pass for a
    # double zero.
    for m in range(int(free.sum()), 1, -1):
        # D is about |z|^m times its terms at a distance |z| from an m-fold zero: this
        # far off it cannot vanish within rounding any more.
        if distance[nearest[m - 1]] > 8.0 * RESOLUTION ** (1.0 / m):
            continue
        near = np.isin(np.arange(len(points)), nearest[:m])
        centre = _newton(sum_, points[near].mean(), m)
        values, moduli = sum_.derivatives(np.array([centre]), m)
        # At the centre of a true multiple zero only rounding is left of the lower
        # derivatives, 1e-14 of their terms. A limit of 1e-12 still separates zeros 1e-6
        # apart.
        if np.all(np.abs(values[: m - 1, 0]) <= 1e-12 * moduli[: m - 1, 0]):
            return near, centre
    alone = np.zeros(len(points), dtype=bool)
    alone[i] = True
    return alone, _newton(sum_, points[i], 1)


def _newton(sum_: ExponentialSum, z: complex, m: int) -> complex:
    """Newton's method for the simple zero of D^(m−1) near z."""
    # Newton's method converges quadratically: from 1e-2, three rounds reach rounding.
    # The length of the step reveals early a multiple zero that was taken for a simple
    # one.
    for _ in range(8):
        values, _ = sum_.derivatives(np.array([z]), m + 1)
        if values[m, 0] == 0:
            break
        step = complex(values[m - 1, 0] / values[m, 0])
        # A step this long has left the cluster: the assumed multiplicity is wrong, and
        # the caller tries another one.
        if abs(step) > 0.1:
            break
        z -= step
        if abs(step) < 1e-16:
            break
    return z
