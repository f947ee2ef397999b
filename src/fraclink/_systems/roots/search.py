"""Where the zeros are: Aberth's iteration from the Newton polygon, and bisection where that is not enough."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.roots.count import count_box
from fraclink._systems.roots.exponential import ExponentialSum, NearZeroError
from fraclink.errors import NotConvergedError

__all__ = ["aberth", "bisect", "newton_polygon", "settle_clusters"]

Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]
_ROUNDS = 120  # multiple zeros are approached linearly, halving the distance each time
# Widest first: twelve points that rounding leaves around a twelvefold zero fill a disc of radius 0.1, and two
# of them alone would pass for a double zero beside it.
_CLUSTERS = (0.25, 0.06, 0.015, 3e-3)
START_LIMIT = 4096  # zeros in one strip; orders up to about 4000 on the principal sheet


def newton_polygon(sum_: ExponentialSum) -> list[tuple[int, int]]:
    """Edges (j, k) of the upper convex hull of the points (ν, ln|a|), from the lowest rate to the highest."""
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
    """Zeros of each edge's two terms alone, in |Im z| ≤ height and one spacing beyond."""
    a, nu = sum_.coefficients, sum_.rates
    points: list[complex] = []
    for j, k in newton_polygon(sum_):
        gap = nu[k] - nu[j]
        x = math.log(abs(a[j] / a[k])) / gap
        first = math.pi / gap if a[j] * a[k] > 0 else 0.0
        reach = math.ceil((height + 0.5) * gap / (2 * math.pi)) + 1
        if len(points) + 2 * reach > START_LIMIT:
            raise NotConvergedError(
                "zeros to find",
                reached=2 * reach,
                wanted=START_LIMIT,
                remedy="lower the orders: no physical model needs thousands of poles",
            )
        points += [complex(x, first + 2 * math.pi * m / gap) for m in range(-reach, reach + 1)]
    # Exact symmetry about the real axis would hold a conjugate pair of starts on it for ever.
    return np.array(points) * (1 + 1e-4j) + 1e-3j


def aberth(sum_: ExponentialSum, height: float, count: int) -> Complex:
    """Simultaneous Newton iteration with mutual repulsion until `count` points with |Im z| ≤ height rest.

    Points that leave the region of the zeros start again inside it, at places of a Halton sequence.
    """
    z, fresh = _starts(sum_, height), 1
    (low, high), rest = sum_.bounds, np.zeros(len(z), dtype=bool)
    for _ in range(_ROUNDS):
        values, moduli = sum_.derivatives(z, 2)
        # At rounding level the quotient D/D' is noise and would throw points off a multiple zero.
        settled = np.abs(values[0]) <= 4e-16 * moduli[0]
        newton = np.where(settled, 0, values[0] / np.where(values[1] == 0, 1e-300, values[1]))
        distance = z[:, None] - z[None, :]
        distance[distance == 0] = np.inf
        step = newton / (1 - newton * (1 / distance).sum(axis=1))
        # A step longer than the zeros' usual spacing leaves the basin of the starting zero.
        step *= np.minimum(1.0, 0.7 / np.maximum(np.abs(step), 1e-300))
        z = z - step
        rest = settled | (np.abs(step) < 1e-9)
        inside = np.abs(z.imag) <= height
        if np.count_nonzero(rest & inside) >= count:
            break
        for i in np.flatnonzero(~rest & ((z.real < low) | (z.real > high) | (np.abs(z.imag) > height + 2))):
            z[i] = complex(low + _halton(fresh, 2) * (high - low), (2 * _halton(fresh, 3) - 1) * height)
            fresh += 1
    return np.asarray(z[rest & (np.abs(z.imag) <= height)])


def _halton(index: int, base: int) -> float:
    value, share = 0.0, 1.0
    while index:
        share /= base
        index, digit = divmod(index, base)
        value += digit * share
    return value


def settle_clusters(sum_: ExponentialSum, points: Complex) -> Complex:
    """Polish every zero; points that share one multiple zero get the same value.

    m points near one m-fold zero are known to ε^(1/m) only, but that zero is a simple one of D^(m−1).
    The multiplicity is accepted if D … D^(m−2) vanish there within rounding.
    """
    settled = np.empty_like(points)
    free = np.ones(len(points), dtype=bool)
    for i in range(len(points)):
        if free[i]:
            near, centre = _cluster(sum_, points, free, i)
            settled[near] = centre
            free &= ~near
    return settled


def _cluster(sum_: ExponentialSum, points: Complex, free: Mask, i: int) -> tuple[Mask, complex]:
    """The points that stand for the same zero as points[i], and that zero."""
    for radius in _CLUSTERS:
        near = free & (np.abs(points - points[i]) < radius)
        m = int(near.sum())
        if m < 2:
            break
        centre = _newton(sum_, points[near].mean(), m)
        values, moduli = sum_.derivatives(np.array([centre]), m)
        if np.all(np.abs(values[: m - 1, 0]) <= 1e-12 * moduli[: m - 1, 0]):
            return near, centre
    alone = np.zeros(len(points), dtype=bool)
    alone[i] = True
    return alone, _newton(sum_, points[i], 1)


def _newton(sum_: ExponentialSum, z: complex, m: int) -> complex:
    """Newton's method for the simple zero of D^(m−1) beside z."""
    for _ in range(8):
        values, _ = sum_.derivatives(np.array([z]), m + 1)
        if values[m, 0] == 0:
            break
        step = complex(values[m - 1, 0] / values[m, 0])
        if abs(step) > 0.1:
            break
        z -= step
        if abs(step) < 1e-16:
            break
    return z


def bisect(sum_: ExponentialSum, low: complex, high: complex, count: int) -> Complex:
    """All `count` zeros in a rectangle by halving it: slow (≈ 10 ms a zero) and certain."""
    found: list[complex] = []
    boxes = [(low, high, count)]
    while boxes:
        a, b, n = boxes.pop()
        if n == 0:
            continue
        centre, size = 0.5 * (a + b), max(b.real - a.real, b.imag - a.imag)
        if size < 1e-3:  # smaller boxes around a double zero drown in rounding: (1e-3)² · 1e-8 is left of D
            found += [centre] * n
            continue
        if n == 1:
            z = _newton(sum_, centre, 1)
            if a.real < z.real < b.real and a.imag < z.imag < b.imag and _is_zero(sum_, z):
                found.append(z)
                continue
        boxes += _halves(sum_, a, b, n)
    return np.array(found, dtype=complex)


def _is_zero(sum_: ExponentialSum, z: complex) -> bool:
    values, moduli = sum_.derivatives(np.array([z]), 1)
    return bool(abs(values[0, 0]) < 1e-12 * moduli[0, 0])


def _halves(sum_: ExponentialSum, a: complex, b: complex, n: int) -> list[tuple[complex, complex, int]]:
    # 0.513…: off every symmetric place where zeros of simple problems lie; the others are second tries.
    for share in (0.5131, 0.4637, 0.5519, 0.4213, 0.6, 0.38):
        if b.real - a.real > b.imag - a.imag:
            middle_b = complex(a.real + share * (b.real - a.real), b.imag)
            middle_a = complex(middle_b.real, a.imag)
        else:
            middle_b = complex(b.real, a.imag + share * (b.imag - a.imag))
            middle_a = complex(a.real, middle_b.imag)
        try:
            first = count_box(sum_, a, middle_b)
        except NearZeroError:
            continue
        return [(a, middle_b, first), (middle_a, b, n - first)]
    raise NotConvergedError(
        "halving a box of zeros",
        reached=abs(b - a),
        wanted=1e-4,
        remedy="the zeros lie too close together, or one of them is of too high a multiplicity: cancel "
        "common factors",
    )
