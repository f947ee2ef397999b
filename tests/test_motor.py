"""The motor's inner loop against pole placement itself, and its discretisations against each other."""

from __future__ import annotations

import math

import numpy as np
import pytest

import fraclink as fl
from fraclink._arm.motor import ContinuousPid, place_pid
from fraclink.errors import FieldError

A, B = 0.21 / 6.87e-5, 1.041e-3 / 6.87e-5


def _loop(pole: float = 80.0) -> ContinuousPid:
    return place_pid(fl.Rig.named("paper-2023").motor, pole)


def test_coefficients_of_table_1() -> None:
    loop = _loop()
    assert loop.gain == pytest.approx(3056.7686, abs=5e-5)
    assert loop.decay == pytest.approx(15.152838, abs=5e-7)
    assert loop.a0 == pytest.approx(13399.771, abs=5e-4)
    assert loop.a1 == loop.b0 == pytest.approx(334.99429, abs=5e-6)
    assert loop.a2 == pytest.approx(2.0937143, abs=5e-8)
    assert loop.b1 == pytest.approx(8.9574005, abs=5e-8)
    assert loop.filter_pole == pytest.approx(304.84716, abs=5e-6)


@pytest.mark.parametrize("pole", [20.0, 80.0, 200.0])
def test_the_loop_is_m_of_s(pole: float) -> None:
    loop = _loop(pole)
    s = 1j * np.geomspace(0.1, 1e4, 50)
    c1 = (loop.a2 * s**2 + loop.a1 * s + loop.a0) / (s * (s + loop.filter_pole))
    c2 = (loop.b1 * s + loop.b0) / (s + loop.filter_pole)
    plant = loop.gain / (s * (s + loop.decay))
    closed = plant * c1 / (1 + plant * (c1 + c2))
    np.testing.assert_allclose(closed, 1 / (1 + s / pole) ** 2, rtol=1e-12)
    np.testing.assert_allclose(loop.closed()(s), closed, rtol=1e-12)


def test_only_tustin_is_stable_at_4_ms_with_one_sample_of_delay() -> None:
    loop = _loop()
    assert loop.sampled_radius(0.004) == pytest.approx(0.951, abs=5e-4)
    assert loop.sampled_radius(0.004, method="backward") == pytest.approx(1.004, abs=5e-4)
    assert loop.sampled_radius(0.004, method="zero-order-hold") == pytest.approx(1.006, abs=5e-4)


def test_every_method_approaches_the_double_pole_at_a_short_period() -> None:
    period = 1e-6
    for method in ("tustin", "backward", "zero-order-hold"):
        radius = _loop().sampled_radius(period, delay_samples=0, method=method)
        # four poles at one place: a perturbation of size T spreads them by T^(1/4)
        assert -math.log(radius) / period == pytest.approx(80.0, rel=0.25)


def test_discrete_filters_have_the_response_of_the_continuous_ones() -> None:
    loop, period = _loop(), 1e-5
    d = loop.discretize(period)
    s = 1j * np.geomspace(1.0, 1000.0, 20)
    shift = np.exp(-s * period)
    integral = (d.integral_now + d.integral_before * shift) / (1 - shift)
    filtered = (d.filter_now + d.filter_before * shift) / (1 - d.filter_decay * shift)
    c1 = d.direct + d.integral_gain * integral + d.filter_gain * filtered
    c2 = d.angle_direct + d.angle_filter_gain * filtered
    np.testing.assert_allclose(
        c1, (loop.a2 * s**2 + loop.a1 * s + loop.a0) / (s * (s + loop.filter_pole)), rtol=1e-4
    )
    np.testing.assert_allclose(c2, (loop.b1 * s + loop.b0) / (s + loop.filter_pole), rtol=1e-4)


@pytest.mark.parametrize("pole", [0.0, -80.0, math.nan, math.inf, B / 4])
def test_a_pole_without_a_stable_filter_is_refused(pole: float) -> None:
    with pytest.raises(FieldError, match=r"inner\.pole"):
        _loop(pole)


@pytest.mark.parametrize("period", [0.0, -1.0, math.nan])
def test_a_period_must_be_positive(period: float) -> None:
    with pytest.raises(FieldError, match="period"):
        _loop().discretize(period)


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(FieldError, match="euler"):
        _loop().discretize(0.004, method="euler")  # type: ignore[arg-type]
