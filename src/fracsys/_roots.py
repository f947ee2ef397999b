"""Zeros of fractional polynomials Σ a_k s^α_k, found on the log-plane with a certified
count.

With z = ln s a fractional polynomial becomes the entire function D(z) = Σ a_k e^(α_k
z). The sheets of its Riemann surface lie above each other in strips of the z-plane: |Im
z| ≤ π is the principal one, and the right half plane is |Im z| < π/2. Nothing is
truncated or made commensurate: 1.92 and √2 cost the same.

The zeros are counted by the argument principle. Left and right of all zeros one term
dominates; in between, a step of half-length ρ around z is accepted only if ρ|D'(z)| +
ρ²/2 |D″(z)| + ρ³/6 |D‴(z)| + ρ⁴/24 max |D⁗| is smaller than |D(z)|: the image then lies
in a disc that does not contain the origin, so that the change of phase is the principal
argument of the quotient of its ends (up to a stated allowance for rounding).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fracsys._exponential import LIMIT, ExponentialSum, count_strip
from fracsys._precision import COINCIDENT, RESOLUTION, ROUNDING
from fracsys._terms import Term
from fracsys.checks import Complex, Real
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
        return np.empty(0, complex)
    if len(terms.rates) == 2:
        (low, high), gap = terms.coefficients, terms.rates[1]
        return np.array(two_term_zeros(low / high, gap, angle), complex)
    height, count = _counted(terms, angle)
    zeros, reach = settle_clusters(terms, aberth(terms, height, count))
    if len(zeros) != count:
        raise NotConvergedError(
            "zeros found",
            reached=len(zeros),
            wanted=count,
            remedy="report the coefficients and orders",
        )
    z, reach = symmetric(zeros, reach)
    z.imag[np.abs(z.imag) < reach] = 0.0
    z.imag[np.abs(z.imag - angle) < reach * (1 + angle)] = angle
    z = z[(z.imag >= 0) & (z.imag <= angle)]
    return z[np.lexsort((z.real, z.imag))]


def zeros_of_terms(terms: Sequence[Term], angle: float) -> Complex:
    """Return `log_zeros` of a sum of terms without delays, sorted by order."""
    a, orders = [t.coefficient for t in terms], [t.order for t in terms]
    return log_zeros(a, orders, angle=angle)


def two_term_zeros(ratio: float, gap: float, angle: float) -> list[complex]:
    """Zeros of s^gap + ratio = 0 (ratio ≠ 0, gap > 0) in closed form: gap z =
    ln(−ratio) + 2πjm, 0 ≤ Im z ≤ angle.

    Zeros within rounding of the edge are placed on it.

    >>> two_term_zeros(1.0, 2.0, 2.0)
    [1.5707963267948966j]
    """
    size = math.log(abs(ratio)) / gap
    first = math.pi if ratio > 0 else 0.0
    last = (
        int(((angle + RESOLUTION) * gap - first) / math.tau + 1)
        if first <= (angle + RESOLUTION) * gap
        else 0
    )
    heights = ((first + math.tau * m) / gap for m in range(last))
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
        reach = math.ceil((height + 0.5) * gap / math.tau) + 1
        if len(points) + 2 * reach > LIMIT:
            raise NotConvergedError(
                "zeros to find",
                reached=2 * reach,
                wanted=LIMIT,
                remedy="lower the orders: no physical model needs thousands of poles",
            )
        points += [
            complex(x, first + math.tau * m / gap) for m in range(-reach, reach + 1)
        ]
    # With exact symmetry about the real axis, starts on it could never leave it for a
    # conjugate pair.
    return np.array(points) + 1e-3j


def aberth(sum_: ExponentialSum, height: float, count: int) -> Complex:
    """Simultaneous Newton iteration with mutual repulsion until `count` points with |Im
    z| ≤ height are at rest.

    D has infinitely many zeros: those beyond the points repel together like a factor
    e^(cz), and c is the mean rate of the terms. Points that leave the region of the zeros
    start again inside it, beside one of the starts.
    """
    starts = _starts(sum_, height)
    z, fresh = starts.copy(), 1
    (low, high), rest = sum_.bounds, np.zeros(len(z), bool)
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
        # starting zero. The zeros of two terms are 2π/ν apart, farther than 0.7 up to ν
        # = 8.
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


def settle_clusters(sum_: ExponentialSum, points: Complex) -> tuple[Complex, Real]:
    """The points, with those near a multiple zero moved onto it, and how far rounding
    of D may have moved each.

    m points near one m-fold zero are known to ε^(1/m) only, but that zero is a simple
    one of D^(m−1). The multiplicity is accepted if D … D^(m−2) vanish there within
    rounding.
    """
    values, moduli = sum_.derivatives(points, len(points) + 1)
    power = np.arange(1, len(points) + 1)[:, None]
    # |D^(k)| r^k / k! = ε Σ|terms|: within r this term of Taylor's series is lost in
    # the rounding of D, and the m points of an m-fold zero lie within the r of k = m.
    lost = ROUNDING * np.cumprod(power, axis=0) * moduli[0]
    radius = (lost / np.maximum(np.abs(values[1:]), 1e-300)) ** (1 / power)
    zeros, reach = points.copy(), radius.min(axis=0, initial=math.inf)
    free = np.ones(len(points), bool)
    for i in range(len(points)):
        distance = np.where(free, np.abs(points - points[i]), math.inf)
        nearest = np.argsort(distance)
        # Most points first: two of the twelve around a twelvefold zero would pass for a
        # double zero.
        for m in range(int(free.sum()) if free[i] else 0, 1, -1):
            near = nearest[:m]
            # twice the radius around the zero (Fujiwara's bound), on either side
            if distance[near[-1]] > 4 * radius[m - 1, i]:
                continue
            centre = _newton(sum_, points[near].mean(), m)
            at, scale = sum_.derivatives(np.array([centre]), m + 1)
            if np.all(np.abs(at[: m - 1]) <= ROUNDING * scale[: m - 1]):
                zeros[near], free[near] = centre, False
                reach[near] = ROUNDING * scale[m - 1] / abs(at[m])
                break
    return zeros, np.maximum(reach, RESOLUTION)


def symmetric(zeros: Complex, reach: Real) -> tuple[Complex, Real]:
    """The zeros of a real D as pairs of conjugates and real ones, closest first.

    Rounding moves the two of a pair apart, or both to one side of the axis. Each is
    matched with the conjugate of another, or of itself.
    """
    z, reach = zeros.copy(), reach.copy()
    distance = np.abs(zeros[:, None] - zeros.conj()[None, :])
    free = np.ones(len(zeros), bool)
    for index in np.argsort(distance, axis=None, kind="stable"):
        i, j = divmod(int(index), len(zeros))
        if free[i] and free[j]:
            free[i] = free[j] = False
            z[i] = 0.5 * (zeros[i] + zeros[j].conj())
            z[j] = z[i].conj()
            reach[i] = reach[j] = max(reach[i], reach[j])
    return z, reach


def _newton(sum_: ExponentialSum, z: complex, m: int) -> complex:
    """Newton's method for the simple zero of D^(m−1) near z."""
    # Newton's method converges quadratically: from 1e-2, four steps reach rounding error.
    for _ in range(4):
        values, _ = sum_.derivatives(np.array([z]), m + 1)
        if values[m, 0] == 0:
            break
        step = complex(values[m - 1, 0] / values[m, 0])
        # A step this long has left the cluster: the assumed multiplicity is wrong, and
        # the caller tries another one.
        if abs(step) > 0.1:
            break
        z -= step
    return z
