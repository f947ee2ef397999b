"""The discrete minimax fit: its accuracy, its structure and its bounds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fraclink.errors import FieldError
from fracsys._discrete import DiscreteFits, DiscreteRational

PERIOD = 0.004
Array = np.ndarray


def correction(filter_time: float, gain: float = 0.148, order: float = 0.65) -> object:
    """Ĉ of eq. (58): k (jω)^β/(1 + δjω)²."""
    return lambda w: gain * (1j * w) ** order / (1 + 1j * filter_time * w) ** 2


def fit(filter_time: float, order: int | None, high: float) -> DiscreteRational:
    fits = DiscreteFits(
        correction(filter_time),
        period=PERIOD,
        band=(0.05, high),
        zeros_at_one=1,
        offset=1.0,
    )
    return fits.fit(order)


@pytest.fixture(scope="module")
def slow_filter() -> DiscreteRational:
    return fit(0.16, 4, 785.0)


@pytest.fixture(scope="module")
def fast_filter() -> DiscreteRational:
    return fit(0.016, 6, 600.0)


def worst(
    made: DiscreteRational, filter_time: float, high: float
) -> tuple[float, float]:
    """Errors on an independent grid, from poles and residues written out here."""
    w = np.concatenate([np.geomspace(0.05, high, 5003), np.linspace(0.05, high, 4001)])
    z = np.exp(1j * w * PERIOD)
    h = np.full(w.shape, made.feedthrough, dtype=complex)
    for p, g in zip(made.decays, made.gains, strict=True):
        h += g / (z - p)
    for q, c in zip(made.pole_decays, made.pole_gains, strict=True):
        h += 0.5 * c / (z - q) + 0.5 * np.conj(c) / (z - np.conj(q))
    ratio = (1 + (1 - 1 / z) * h) / (1 + correction(filter_time)(w))  # type: ignore[operator]
    return float(np.max(np.abs(20 * np.log10(np.abs(ratio))))), float(
        np.max(np.abs(np.degrees(np.angle(ratio))))
    )


def test_four_states_hold_the_slow_filter_to_nyquist(
    slow_filter: DiscreteRational,
) -> None:
    db, deg = worst(slow_filter, 0.16, 785.0)
    assert slow_filter.order == 4
    assert db < 0.1 and deg < 0.5
    assert (slow_filter.error_db, slow_filter.error_deg) == pytest.approx(
        (db, deg), rel=0.02
    )


def test_six_states_hold_the_fast_filter_to_600(fast_filter: DiscreteRational) -> None:
    db, deg = worst(fast_filter, 0.016, 600.0)
    assert fast_filter.order == 6
    assert db < 0.1 and deg < 0.5


def test_the_lowest_sufficient_order_is_chosen(slow_filter: DiscreteRational) -> None:
    chosen = fit(0.16, None, 785.0)
    assert chosen.order == 4
    np.testing.assert_array_equal(chosen.decays, slow_filter.decays)
    assert fit(0.16, 3, 785.0).error_db > 0.1  # order 3 is not sufficient


def test_no_filter() -> None:
    """Ĉ = k s^β itself: approximated up to 200 rad/s; up to 0.8 of the Nyquist
    frequency only as far as causality allows.
    """
    bare = lambda w: 0.06988 * (1j * w) ** 0.6122  # noqa: E731
    low = DiscreteFits(
        bare, period=PERIOD, band=(0.05, 200.0), zeros_at_one=1, offset=1.0
    ).fit()
    assert low.order <= 5
    assert low.error_db < 0.1 and low.error_deg < 0.5
    high = DiscreteFits(
        bare, period=PERIOD, band=(0.05, 628.0), zeros_at_one=1, offset=1.0
    ).fit(5)
    assert high.error_db < 1.0 and high.error_deg < 5.0
    # Above the band, the gain is bounded by twice the response times the error in units
    # of its tolerance.
    w = np.linspace(628.0, math.pi / PERIOD, 400)
    assert np.max(np.abs(high(w))) < 20 * np.max(np.abs(bare(w)))


def test_feed_forward_operator() -> None:
    """s^(λ−2) = s^(−0.08) with stable real poles, the slowest below the band."""
    made = DiscreteFits(
        lambda w: np.power(1j * w, -0.08 + 0j), period=PERIOD, band=(0.05, 300.0)
    ).fit()
    assert made.order <= 6 and made.zeros_at_one == 0
    assert made.error_db < 0.1 and made.error_deg < 0.5
    assert made.pole_decays.size == 0
    assert np.all(np.abs(made.decays) < 1)
    assert np.max(made.decays) > 1 - 0.1 * PERIOD
    assert np.all(
        np.isfinite(made(np.array([1e-9, 1e-3])))
    )  # G(0) is finite, unlike s^(−0.08)


@pytest.mark.slow
def test_zero_at_one_is_exact(slow_filter: DiscreteRational) -> None:
    assert slow_filter(0.0) == 0.0
    assert slow_filter(1e-9) == pytest.approx(
        1e-9j * slow_filter(1e-6).imag / 1e-6, rel=1e-3
    )


def test_poles_are_stable_and_apart(
    slow_filter: DiscreteRational, fast_filter: DiscreteRational
) -> None:
    for made in (slow_filter, fast_filter):
        assert np.all(np.abs(made.poles) < 1)
        assert np.all(made.pole_decays.imag > 0)


def test_an_exact_rational_is_found_again() -> None:
    """A response with the structure of the fit is approximated to rounding."""
    p, q = np.array([0.995, 0.6]), 0.9 * np.exp(0.2j)

    def exact(w: Array) -> Any:
        z = np.exp(1j * w * PERIOD)
        pair = 0.5 * ((0.3 + 0.1j) / (z - q) + (0.3 - 0.1j) / (z - np.conj(q)))
        return (1 - 1 / z) * (0.5 + 0.01 / (z - p[0]) + 0.2 / (z - p[1]) + pair)

    made = DiscreteFits(exact, period=PERIOD, band=(0.1, 780.0), zeros_at_one=1).fit(4)
    assert made.error_db < 1e-7 and made.error_deg < 1e-6
    np.testing.assert_allclose(np.sort(made.decays), np.sort(p), rtol=1e-6)
    np.testing.assert_allclose(made.pole_decays, [q], rtol=1e-6)


def test_weight_moves_the_error() -> None:
    focus = DiscreteFits(
        correction(0.016), period=PERIOD, band=(0.05, 600.0), zeros_at_one=1, offset=1.0,
        weight=lambda w: np.where(w < 50, 10.0, 1.0),
    ).fit(4)  # fmt: skip
    plain = fit(0.016, 4, 600.0)
    w = np.geomspace(0.05, 49, 500)
    wanted = 1 + correction(0.016)(w)  # type: ignore[operator]
    inside = [np.max(np.abs(np.log((1 + made(w)) / wanted))) for made in (focus, plain)]
    assert inside[0] < 0.5 * inside[1]


@pytest.mark.slow
@given(
    st.floats(0.2, 0.9),
    st.floats(0.02, 0.5),
    st.floats(0.004, 0.3),
    st.integers(1, 2),
    st.floats(0.001, 0.02),
)
@settings(max_examples=6, deadline=None)
def test_any_controller_gets_a_stable_law(
    order: float, gain: float, filter_time: float, power: int, period: float
) -> None:
    nyquist = math.pi / period
    made = DiscreteFits(
        lambda w: gain * (1j * w) ** order / (1 + 1j * filter_time * w) ** power,
        period=period,
        band=(1e-4 * nyquist, 0.5 * nyquist),
        zeros_at_one=1,
        offset=1.0,
    ).fit(4)
    assert np.all(np.abs(made.poles) < 1)
    assert made.error_db < 2.0 and made.error_deg < 12.0
    assert made(0.0) == 0.0


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"band": (0.0, 100.0)}, "band[0]"),
        ({"band": (10.0, 1.0)}, "band"),
        ({"band": (1.0, 800.0)}, "band"),
        ({"response": lambda w: np.full(w.shape, np.nan)}, "response"),
        ({"response": lambda w: np.zeros(w.shape)}, "response"),
    ],
)
def test_bad_input(options: dict[str, object], field: str) -> None:
    request = {
        "response": correction(0.1),
        "period": PERIOD,
        "band": (0.1, 700.0),
        **options,
    }
    response = request.pop("response")
    with pytest.raises(FieldError) as caught:
        DiscreteFits(response, **request)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_the_stated_error_is_that_of_an_independent_grid(
    fast_filter: DiscreteRational,
) -> None:
    db, deg = worst(fast_filter, 0.016, 600.0)
    assert (fast_filter.error_db, fast_filter.error_deg) == pytest.approx(
        (db, deg), rel=0.02
    )
    assert fast_filter.order == len(fast_filter.decays) + 2 * len(
        fast_filter.pole_decays
    )
    assert fast_filter.order == len(fast_filter.poles)
    assert fast_filter.band == (0.05, 600.0) and fast_filter.period == PERIOD


@pytest.mark.parametrize("zeros", [0, 1, 2, 3])
def test_zeros_at_one_are_factors_of_the_response(zeros: int) -> None:
    made = DiscreteRational(0.1, zeros, 0.5, np.array([0.8]), np.array([0.3]), np.array([0.2 + 0.5j]),
                            np.array([0.1 - 0.4j]), (1.0, 2.0))  # fmt: skip
    z = np.exp(2.3j * 0.1)
    q, c = 0.2 + 0.5j, 0.1 - 0.4j
    inner = (
        0.5
        + 0.3 / (z - 0.8)
        + 0.5 * c / (z - q)
        + 0.5 * c.conjugate() / (z - q.conjugate())
    )
    assert made(2.3) == pytest.approx((1 - 1 / z) ** zeros * inner, rel=1e-12)
