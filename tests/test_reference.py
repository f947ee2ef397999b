"""References: their derivatives against finite differences, their shapes against the
definition.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fraclink as fl
from fraclink import Reference
from fraclink.errors import FieldError
from fracsys.checks import rule

SMOOTH: dict[str, Reference] = {
    "step": fl.smooth_step(1.0, 0.5, 0.3),
    "two moves": fl.smooth_step(1.0, 0.5).then(fl.smooth_step(-0.4, 0.8, 0.2)),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_velocity_and_acceleration_are_the_derivatives(name: str) -> None:
    reference, h = SMOOTH[name], 1e-5
    t = np.linspace(0.011, 4.9, 401)
    velocity = (reference.angle(t + h) - reference.angle(t - h)) / (2 * h)
    acceleration = (reference.velocity(t + h) - reference.velocity(t - h)) / (2 * h)
    np.testing.assert_allclose(reference.velocity(t), velocity, atol=2e-7)
    np.testing.assert_allclose(reference.acceleration(t), acceleration, atol=5e-6)


@settings(deadline=None, max_examples=60)
@given(
    st.floats(-7, 7),
    st.floats(0.05, 10),
    st.floats(0, 10),
)
def test_smooth_step_goes_from_rest_to_rest(
    amplitude: float, duration: float, start: float
) -> None:
    path = fl.smooth_step(amplitude, duration, start)
    ends = np.array([0.0, start, path.duration, path.duration + 3.0])
    np.testing.assert_allclose(
        path.angle(ends), [0, 0, amplitude, amplitude], atol=1e-12 * abs(amplitude)
    )
    np.testing.assert_allclose(
        path.velocity(ends), 0, atol=1e-9 * (1 + abs(amplitude) / duration)
    )
    t = np.linspace(start, start + duration, 2001)
    assert np.abs(path.velocity(t)).max() == pytest.approx(
        1.875 * abs(amplitude) / duration, rel=1e-5
    )
    assert np.abs(path.acceleration(t)).max() == pytest.approx(
        10 / math.sqrt(3) * abs(amplitude) / duration**2, rel=1e-4
    )


def test_pulse_and_hold_jump_where_they_say() -> None:
    path = fl.extend.pulse(1.0, 7.0, 1.0)
    assert path.angle([0.999, 1.0, 7.999, 8.0]).tolist() == [0, 1, 1, 0]
    assert path.velocity([1.0, 5.0]).tolist() == [0, 0]
    assert fl.extend.hold(0.3, 2.0).angle([-1.0, 0.0, 9.0]).tolist() == [0.3, 0.3, 0.3]


@pytest.mark.parametrize("register", [3, 4, 5, 6, 7, 9, 10, 11])
def test_prbs_has_maximum_length_and_a_flat_correlation(register: int) -> None:
    length = 2**register - 1
    path = fl.prbs(1.0, 0.1, bits=2 * length, register=register)
    bits = path.angle(0.1 * (np.arange(2 * length) + 0.5))
    assert set(bits.tolist()) == {-1.0, 1.0}
    np.testing.assert_array_equal(bits[:length], bits[length:])
    correlation = np.fft.ifft(np.abs(np.fft.fft(bits[:length])) ** 2).real
    np.testing.assert_allclose(
        correlation, [length] + [-1] * (length - 1), atol=1e-8 * length
    )


def test_prbs_starts_late_and_ends_at_rest() -> None:
    path = fl.prbs(0.1, 0.2, bits=5, start=1.0)
    assert path.angle([0.5, 1.1, 2.1]).tolist() == [0.0, 0.1, 0.0]
    assert path.duration == pytest.approx(2.0)


def test_paths_are_read_only_and_remember_nothing() -> None:
    path = fl.smooth_step(1.0, 0.5)
    with pytest.raises(ValueError, match="read-only"):
        path.breaks[0] = 1.0


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: fl.smooth_step(math.nan, 0.5), "amplitude"),
        (lambda: fl.smooth_step(1.0, 0.0), "duration"),
        (lambda: fl.smooth_step(1.0, 0.5, -1.0), "start"),
        (lambda: fl.smooth_step(True, 0.5), "amplitude"),
        (lambda: fl.extend.pulse(1.0, -1.0), "width"),
        (lambda: fl.extend.hold(math.inf), "angle"),
        (lambda: fl.prbs(0.1, 0.2, register=8), "register"),
        (lambda: fl.prbs(0.1, 0.2, bits=0), "bits"),
        (lambda: fl.prbs(0.1, 0.0), "bit"),
    ],
)
def test_bad_values_are_named(make: object, field: str) -> None:
    with pytest.raises(FieldError) as caught:
        make()  # type: ignore[operator]
    assert caught.value.field == field


def test_two_moves_are_a_pulse_that_rests_between_its_edges() -> None:
    soft = fl.smooth_step(1.0, 0.3, 1.0).then(fl.smooth_step(-1.0, 0.3, 6.7))
    time = np.array([0.5, 1.15, 1.3, 2.0, 7.5, 8.0, 8.15, 8.3, 20.0])
    assert soft.angle(time) == pytest.approx([0, 0.5, 1, 1, 1, 1, 0.5, 0, 0], abs=1e-12)
    assert np.ptp(soft.angle(np.linspace(0, 10, 5001))) == pytest.approx(1.0)


def test_two_arrays_are_a_path() -> None:
    time, angle = np.linspace(0.0, 0.5, 40), 0.2 * np.sin(np.linspace(0.0, 0.5, 40))
    given: Any = (time, angle)
    taken = rule(Reference).check("reference", given)
    np.testing.assert_array_equal(taken.angle(time), fl.spline(time, angle).angle(time))
    bad: Any
    for bad in ((time, angle, angle), (time, 3.0), np.sin, [1.0, 2.0]):
        with pytest.raises(FieldError, match="spline"):
            rule(Reference).check("reference", bad)
    with pytest.raises(FieldError):
        rule(Reference).check("reference", (time[::-1], angle))
