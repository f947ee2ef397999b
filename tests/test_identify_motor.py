"""The motor from voltage and angle."""

from __future__ import annotations

import numpy as np
import pytest

from fraclink import identify_motor
from fraclink.errors import FieldError, LogError
from identify_cases import PERIOD
from made_logs import example_motor_log

GAIN, DECAY, INERTIA = 3056.77, 15.153, 6.87e-5


@pytest.mark.slow
@pytest.mark.parametrize(
    "truth",
    [
        {},
        {"delay": 0.004},
        {"dead_zone": 0.03},
        {"dead_zone": 0.03, "delay": 0.006, "coulomb_voltage": 0.05},
        {"coulomb_voltage": 0.0},
    ],
)
def test_motor_is_found(truth: dict[str, float]) -> None:
    voltage, angle = example_motor_log(**truth)  # type: ignore[arg-type]
    fit = identify_motor(voltage, angle, period=PERIOD, inertia=INERTIA)
    assert fit.gain == pytest.approx(GAIN, rel=0.01)
    assert fit.decay == pytest.approx(DECAY, rel=0.01)
    wanted = truth.get("coulomb_voltage", 0.02)
    assert fit.coulomb_voltage == pytest.approx(wanted, abs=1e-3)
    assert fit.coulomb_torque == pytest.approx(wanted * GAIN * INERTIA, abs=3e-4)
    assert fit.dead_zone == pytest.approx(truth.get("dead_zone", 0.0), abs=1e-3)
    assert fit.delay == pytest.approx(truth.get("delay", 0.0), abs=3e-4)
    assert fit.nmse < 1e-3


@pytest.mark.slow
def test_known_delay_is_kept_and_errors_cover() -> None:
    voltage, angle = example_motor_log()
    fit = identify_motor(voltage, angle, period=PERIOD, delay=0.0, dead_zone=0.0)
    assert (fit.delay, fit.dead_zone) == (0.0, 0.0)
    assert fit.coulomb_torque is None
    for name, truth in (("gain", GAIN), ("decay", DECAY), ("coulomb_voltage", 0.02)):
        assert abs(getattr(fit, name) - truth) < 5 * fit.standard_errors[name]


def test_a_cable_that_pulls_is_told_from_the_motor() -> None:
    gain, decay, friction, spring, period = 11.0, 15.0, 0.4, 60.0, 0.004
    voltage = np.repeat(np.random.default_rng(2).uniform(-5.0, 5.0, 80), 50)
    angle = speed = 0.0
    angles = []
    for value in voltage:
        angles.append(angle)
        for _ in range(40):
            force = gain * (value - friction * np.tanh(speed / 1e-3))
            speed += period / 40 * (force - decay * speed - spring * (angle - 0.1))
            angle += period / 40 * speed
    fit = identify_motor(voltage, np.array(angles), period=period, spring=True)
    assert fit.spring == pytest.approx(spring, rel=0.02)
    assert fit.gain == pytest.approx(gain, rel=0.02)
    assert fit.standard_errors["spring"] < 0.05 * spring
    # Without it, the effect of the spring is attributed to the voltage.
    with pytest.raises(LogError, match="K/J of an impossible sign"):
        identify_motor(voltage, np.array(angles), period=period)


@pytest.mark.slow
def test_the_links_torque_gives_the_inertia() -> None:
    # The torque of the link divided by J acts like a voltage: treat the load as a known
    # second drive.
    voltage, angle = example_motor_log(samples=4000)
    generator = np.random.default_rng(3)
    torque = np.repeat(generator.uniform(-0.01, 0.01, 100), 40)
    # the voltage that produces the same motion against the load
    driven = voltage + torque / (GAIN * INERTIA)
    fit = identify_motor(
        driven, angle, period=PERIOD, torque=torque, delay=0.0, dead_zone=0.0
    )
    assert fit.inertia == pytest.approx(INERTIA, rel=0.02)
    assert fit.gain == pytest.approx(GAIN, rel=0.02)


def test_no_bump_lies_across_the_start_of_another_recording() -> None:
    """Two recordings one after the other, with a jump between them: if the start of the
    second is given, the fit is that of a motor; otherwise the jump is taken for a
    motion.
    """
    voltage, angle = example_motor_log(samples=2000)
    both = np.concatenate([angle[:1200], angle[:1200] + 3.0])
    volts = np.concatenate([voltage[:1200], voltage[:1200]])
    fit = identify_motor(volts, both, period=PERIOD, starts=[1200])
    assert fit.gain == pytest.approx(GAIN, rel=0.02)
    with pytest.raises(LogError):
        identify_motor(volts, both, period=PERIOD)


def test_bad_motor_logs() -> None:
    voltage, angle = example_motor_log(samples=1000)
    with pytest.raises(LogError, match="voltage"):
        identify_motor(voltage[:50], angle[:50], period=PERIOD)
    with pytest.raises(LogError, match="constant"):
        identify_motor(voltage, np.zeros(1000), period=PERIOD)
    with pytest.raises(LogError, match="finite"):
        identify_motor(
            np.where(np.arange(1000) == 3, np.nan, voltage), angle, period=PERIOD
        )
    with pytest.raises(LogError, match="motion in one direction"):
        identify_motor(voltage, np.sin(np.arange(1000) * 1.5), period=PERIOD)
    with pytest.raises(FieldError, match="period"):
        identify_motor(voltage, angle, period=0.0)
    with pytest.raises(FieldError, match="inertia"):
        identify_motor(voltage, angle, period=PERIOD, inertia=-1.0)


# --- the pieces against closed forms ------------------------------------------------------------------------


def test_it_does_not_matter_where_an_encoder_counts_from() -> None:
    """An angle of many turns is the same motion, because its second derivative is moved
    to the weighting function under the integral.
    """
    voltage, angle = example_motor_log(samples=1500)
    here, away = (
        identify_motor(voltage, angle + start, period=PERIOD, delay=0.0, dead_zone=0.0)
        for start in (0.0, 900.0)
    )
    for name in ("gain", "decay", "coulomb_voltage", "nmse"):
        assert getattr(away, name) == pytest.approx(getattr(here, name), rel=1e-6)
