"""The arithmetic of the prover, whose discs must contain every value with its rounding,
against the same operations on points with fifty digits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest

from fraclink._certify.discs import Disc, Span

DISCS, POINTS = 40, 12
TURNS = np.exp(2j * np.pi * np.arange(POINTS) / POINTS)
Operation = Callable[..., Any]
# An operation on discs, and the same on numbers of mpmath.
OPERATIONS: dict[str, tuple[Operation, Operation]] = {
    "a + b": (lambda a, b: a + b, lambda x, y: x + y),
    "a - b": (lambda a, b: a - b, lambda x, y: x - y),
    "2j - a": (lambda a, b: 2j - a, lambda x, y: 2j - x),
    "a b": (lambda a, b: a * b, lambda x, y: x * y),
    "1/a": (lambda a, b: a.inverse(), lambda x, y: 1 / x),
    "exp a": (lambda a, b: a.exp(), lambda x, y: mpmath.exp(x)),
    "exp(a b)/(a + b)": (
        lambda a, b: (a * b).exp() * (a + b).inverse(),
        lambda x, y: mpmath.exp(x * y) / (x + y),
    ),
}


def drawn(seed: int, *, points: bool) -> Disc:
    """Return discs of all sizes, from single points to those that contain zero."""
    draw = np.random.default_rng(seed)
    size, angle = 10.0 ** draw.uniform(-3.0, 0.7, DISCS), draw.uniform(-3.2, 3.2, DISCS)
    radius = 0.0 if points else size * 10.0 ** draw.uniform(-16.0, 0.2, DISCS)
    return Disc(size * np.exp(1j * angle), radius * np.ones(DISCS))


def exact(value: complex) -> mpmath.mpc:
    return mpmath.mpc(float(np.real(value)), float(np.imag(value)))


def on_edge(disc: Disc, k: int, turn: complex) -> mpmath.mpc:
    """A point on the edge of one disc, or inside by less than 1e-30 of its radius."""
    direction = exact(turn) / abs(exact(turn))
    return exact(disc.c[k]) + mpmath.mpf(float(disc.r[k])) * direction * (
        1 - mpmath.mpf("1e-30")
    )


def contains(disc: Disc, k: int, value: mpmath.mpc) -> bool:
    radius = float(disc.r[k])
    return bool(np.isinf(radius) or abs(value - exact(disc.c[k])) <= radius)


@pytest.mark.slow
@pytest.mark.parametrize("points", [False, True], ids=["discs", "points"])
@pytest.mark.parametrize("name", OPERATIONS)
def test_an_operation_contains_that_of_every_point(name: str, points: bool) -> None:
    on_discs, on_numbers = OPERATIONS[name]
    first, second = drawn(1, points=points), drawn(2, points=points)
    result = on_discs(first, second)
    with mpmath.workdps(50):
        for k in range(DISCS):
            for turn in TURNS:
                x = on_edge(first, k, turn)
                y = on_edge(second, k, turn**5 * np.exp(0.3j * k))
                assert contains(result, k, on_numbers(x, y))
    # Where the operands are points, rounding is all there is.
    if points:
        assert np.all(result.r <= 1e-12 * (1.0 + np.abs(first.c) + np.abs(result.c)))


@pytest.mark.slow
def test_slopes_contain_the_derivatives_and_discs_from_them_the_values() -> None:
    """The mean value theorem over a box of two real variables."""
    draw = np.random.default_rng(3)
    at = draw.uniform(0.5, 2.0, (2, DISCS))
    reach = at * 10.0 ** draw.uniform(-6.0, -1.0, (2, DISCS))

    def value(low: np.ndarray, high: np.ndarray) -> Disc:
        x, y = (Span(low[i], high[i]).disc() for i in range(2))
        a = Disc(x.c * 1j, x.r, {"x": Disc(1j * np.ones(DISCS))})
        b = Disc(y.c, y.r, {"y": Disc(np.ones(DISCS))})
        return OPERATIONS["exp(a b)/(a + b)"][0](a, b)

    def number(x: Any, y: Any) -> Any:
        return OPERATIONS["exp(a b)/(a + b)"][1](1j * x, y)

    whole, middle = value(at - reach, at + reach), value(at, at)
    closer = whole.closer(middle, {"x": reach[0], "y": reach[1]})
    with mpmath.workdps(50):
        for k in range(DISCS):
            for shares in draw.uniform(-1.0, 1.0, (POINTS, 2)):
                x, y = (float(p) for p in at[:, k] + shares * reach[:, k])
                x, y = mpmath.mpf(x), mpmath.mpf(y)
                assert contains(closer, k, number(x, y))
                for name, order in (("x", (1, 0)), ("y", (0, 1))):
                    slope = mpmath.diff(number, (x, y), order)
                    assert contains(whole.d[name], k, slope)
    assert np.all(closer.r <= whole.r) and np.any(closer.r < 0.7 * whole.r)


def test_a_disc_with_zero_has_no_inverse_and_intervals_keep_their_ends() -> None:
    with_zero = Disc(np.array([0.1, 1.0, 1.0]), np.array([0.2, 1.0, 0.5])).inverse()
    assert np.array_equal(np.isinf(with_zero.r), [True, True, False])
    low, high = np.array([0.1, 1.0, 3.0]), np.array([0.3, 1.0, 1e3])
    inverse, disc = Span(low, high).inverse(), Span(low, high).disc()
    with mpmath.workdps(50):
        for k in range(3):
            for end in (low[k], high[k]):
                assert inverse.low[k] <= 1 / mpmath.mpf(end) <= inverse.high[k]
                assert contains(disc, k, mpmath.mpc(end))
    # and are no wider than rounding needs: what is too wide proves nothing
    assert inverse.low * high == pytest.approx(1.0, rel=1e-12)
    assert inverse.high * low == pytest.approx(1.0, rel=1e-12)
    assert disc.c + disc.r == pytest.approx(high, rel=1e-12)
