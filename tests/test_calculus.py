"""Derivatives and integrals of signals against closed forms and mpmath."""

from __future__ import annotations

import math
from collections.abc import Callable

import mpmath
import numpy as np
import pytest

from fracsys import derivative, integral, s, time_response
from fracsys.errors import FieldError

T = np.linspace(0.0, 1.0, 1001)


def caputo(slope: Callable[[object], object], n: int, order: float, t: float) -> float:
    """(I^(n−a) y^(n))(t) by quadrature in mpmath; `slope` is y^(n)."""
    with mpmath.workdps(30):
        # The substitution τ = t − x^(1/(n−a)) removes the singularity.
        a = mpmath.mpf(n) - mpmath.mpf(order)
        whole = mpmath.quad(lambda x: slope(t - x ** (1 / a)), [0, mpmath.mpf(t) ** a])
        return float(whole / mpmath.gamma(a + 1))


def test_a_half_derivative_has_six_digits_everywhere() -> None:
    found = derivative(T, T**2 + np.sin(3 * T), 0.5)
    for k in (1, 2, 10, 300, 999, 1000):
        exact = caputo(lambda x: 2 * x + 3 * mpmath.cos(3 * x), 1, 0.5, float(T[k]))
        assert found[k] == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("order", [1.1, 1.5, 1.9])
def test_derivatives_above_one(order: float) -> None:
    found = derivative(T, np.sin(3 * T), order)
    for k in (50, 300, 1000):
        exact = caputo(lambda x: -9 * mpmath.sin(3 * x), 2, order, float(T[k]))
        assert found[k] == pytest.approx(exact, rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("order", [0.1, 0.5, 0.999, 1.0, 1.7, 3.2])
@pytest.mark.parametrize("power", [0, 1, 3])
def test_integrals_of_powers_are_exact(order: float, power: int) -> None:
    exact = math.gamma(power + 1) / math.gamma(power + 1 + order) * T ** (power + order)
    assert integral(T, T**power, order) == pytest.approx(exact, rel=1e-10, abs=1e-14)


def test_a_derivative_undoes_an_integral_and_halves_make_a_whole() -> None:
    y = T**2 * np.exp(-T)
    assert derivative(T, integral(T, y, 0.4), 0.4) == pytest.approx(y, abs=1e-6)
    twice = derivative(T, derivative(T, y, 0.5), 0.5)
    assert twice[5:] == pytest.approx(((2 * T - T**2) * np.exp(-T))[5:], abs=2e-4)
    assert derivative(T, y, 1.0) == pytest.approx((2 * T - T**2) * np.exp(-T), abs=1e-8)


def test_a_jump_at_the_first_sample_is_what_the_definitions_differ_by() -> None:
    y = 2.0 + T
    assert derivative(T, y, 0.5)[1:] == pytest.approx(2 * np.sqrt(T[1:] / np.pi))
    rest = derivative(T, y, 0.5, definition="riemann-liouville")
    assert math.isinf(rest[0])
    exact = 2 / np.sqrt(np.pi * T[1:]) + 2 * np.sqrt(T[1:] / np.pi)
    assert rest[1:] == pytest.approx(exact)
    # Effect of s^0.5: the limit of the Grünwald–Letnikov sums.
    weights = np.cumprod([1.0, *(1.0 - 1.5 / np.arange(1.0, len(y)))])
    assert weights @ y[::-1] / T[1] ** 0.5 == pytest.approx(rest[-1], rel=1e-3)


def test_an_integral_is_the_response_of_a_power_of_s() -> None:
    u = np.sin(5 * T)
    exact = time_response(1 / s**0.6, u, T[1], hold="first").output
    assert integral(T, u, 0.6) == pytest.approx(exact, abs=1e-5)


def test_the_times_may_begin_anywhere() -> None:
    y = np.sin(3 * T)
    assert derivative(T + 40.0, y, 0.5) == pytest.approx(
        derivative(T, y, 0.5), abs=1e-9
    )


def test_bad_input_is_named() -> None:
    with pytest.raises(FieldError, match="not uniform"):
        derivative(T**2, T, 0.5)
    with pytest.raises(FieldError, match="not one for each time"):
        integral(T, T[1:], 0.5)
    # a cubic has four coefficients
    with pytest.raises(FieldError, match="N >= 4"):
        integral(T[:3], T[:3], 0.5)
    cube = integral(T[:4], T[:4] ** 3, 1.0)
    assert cube == pytest.approx(T[:4] ** 4 / 4, abs=1e-12)
    for operator, order in ((derivative, 2.5), (derivative, 0.0), (integral, 0.0)):
        with pytest.raises(FieldError, match="order"):
            operator(T, T, order)
    with pytest.raises(FieldError, match="definition"):
        derivative(T, T, 0.5, definition="weyl")  # type: ignore[arg-type]
