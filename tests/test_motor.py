"""The motor loop against pole placement itself, and its discretisations against each
other.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink._arm.motor import held_motor
from fraclink.errors import FieldError
from fraclink.extend import place_pid

A, B = 0.21 / 6.87e-5, 1.041e-3 / 6.87e-5


def _loop(pole: float = 80.0) -> Any:
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


def test_the_loop_is_stable_at_4_ms_with_one_sample_of_delay() -> None:
    sampled = fl.MotorLoop(80.0, 1).sampled(fl.Rig.named("paper-2023").motor, 0.004)
    assert abs(sampled.poles()[0]) == pytest.approx(0.951, abs=5e-4)


def test_it_approaches_the_double_pole_at_a_short_period() -> None:
    period = 1e-6
    sampled = fl.MotorLoop(80.0, 0).sampled(fl.Rig.named("paper-2023").motor, period)
    # four coincident poles: a perturbation of size T spreads them by T^(1/4)
    slowest = -math.log(abs(sampled.poles()[0])) / period
    assert slowest == pytest.approx(80.0, rel=0.25)


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
        c1,
        (loop.a2 * s**2 + loop.a1 * s + loop.a0) / (s * (s + loop.filter_pole)),
        rtol=1e-4,
    )
    np.testing.assert_allclose(
        c2, (loop.b1 * s + loop.b0) / (s + loop.filter_pole), rtol=1e-4
    )


@pytest.mark.parametrize("pole", [0.0, -80.0, math.nan, math.inf, B / 4])
def test_a_pole_without_a_stable_filter_is_refused(pole: float) -> None:
    with pytest.raises(FieldError, match=r"motor_loop\.pole"):
        _loop(pole)


@pytest.mark.parametrize("period", [0.0, -1.0, math.nan])
def test_a_period_must_be_positive(period: float) -> None:
    with pytest.raises(FieldError, match="period"):
        _loop().discretize(period)


# --- what the loop around the motor costs, and its limits ---------------------------------------------------


def test_partial_fractions_of_the_pid() -> None:
    """Cm1 = a2 + (a0/c)/s + ρ1/(s + c) and Cm2 = b1 + ρ2/(s + c), at any s."""
    loop, d, s = _loop(), _loop().discretize(0.004), 3.0 + 40.0j
    c = loop.filter_pole
    first = d.direct + d.integral_gain / s + d.filter_gain / (s + c)
    assert first == pytest.approx(
        (loop.a2 * s**2 + loop.a1 * s + loop.a0) / (s * (s + c)), rel=1e-12
    )
    assert d.angle_direct + d.angle_filter_gain / (s + c) == pytest.approx(
        (loop.b1 * s + loop.b0) / (s + c), rel=1e-12
    )
    # after a long time, without the integral: a2 + ρ1/c
    assert d.stiffness == pytest.approx(loop.a2 + d.filter_gain / c, rel=1e-12)


def test_a_held_motor_is_the_integral_of_its_speed() -> None:
    """θ(T) = A (T − w)/B and θ̇(T) = A w of a unit voltage, w = (1 − e^(−BT))/B;
    without friction A T²/2.
    """
    motor = SimpleNamespace(gain=3000.0, decay=15.0)
    m1, m2, e = held_motor(motor, 0.004)  # type: ignore[arg-type]
    w = (1 - math.exp(-0.06)) / 15.0
    assert (m1, e) == pytest.approx(
        (3000.0 * (0.004 - w) / 15.0, math.exp(-0.06)), rel=1e-12
    )
    # x (m1 + m2 x)/((1 − x)(1 − e x)) for a step: θ(2T) = m1 + m1 (1 + e) + m2
    after_two = 3000.0 * (0.008 - (1 - math.exp(-0.12)) / 15.0) / 15.0
    assert m1 * (2 + e) + m2 == pytest.approx(after_two, rel=1e-9)
    free = held_motor(SimpleNamespace(gain=3000.0, decay=0.0), 0.004)  # type: ignore[arg-type]
    assert free == pytest.approx((0.024, 0.024, 1.0))
    nearly = held_motor(SimpleNamespace(gain=3000.0, decay=1e-4), 0.004)  # type: ignore[arg-type]
    assert nearly == pytest.approx(free, rel=1e-6)


def test_closed_poles_are_the_roots_of_the_loop_written_in_z() -> None:
    """1 + (Cm1 + Cm2) z^(−d) P = 0 is checked for every eigenvalue of the state matrix."""
    rig = fl.Rig.named("paper-2023")
    for motor in (rig.motor, SimpleNamespace(gain=3000.0, decay=0.0)):
        for delay in (0, 1, 3):
            loop = fl.MotorLoop(80.0, delay).sampled(motor, 0.004)  # type: ignore[arg-type]
            poles = loop.poles()
            assert poles.size == 4 + delay and np.all(np.diff(np.abs(poles)) <= 1e-12)
            x = 1 / poles[np.abs(poles) > 1e-3]
            first, second = loop.controllers(x)
            assert np.abs(1 + (first + second) * x**delay * loop.plant(x)).max() < 1e-6
