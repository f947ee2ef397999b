"""The motor from voltage and angle, and the design of experiments."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._identify import (
    design_experiment,
    identify,
    identify_motor,
    simulated_torque,
)
from fraclink._identify.motor import _Bumps
from fraclink.errors import FieldError, InfeasibleError, LogError
from identify_cases import PERIOD
from made_logs import example_motor_log

GAIN, DECAY, INERTIA = 3056.77, 15.153, 6.87e-5
LINK = LinkModel(1.56, 10.0, order=1.92)


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


@pytest.mark.slow
def test_the_links_torque_gives_the_inertia() -> None:
    # Dividing the link's torque by J is the same as a voltage: make the load a known
    # second drive.
    voltage, angle = example_motor_log(samples=4000)
    generator = np.random.default_rng(3)
    torque = np.repeat(generator.uniform(-0.01, 0.01, 100), 40)
    driven = voltage + torque / (
        GAIN * INERTIA
    )  # the voltage that makes the same motion against the load
    fit = identify_motor(
        driven, angle, period=PERIOD, torque=torque, delay=0.0, dead_zone=0.0
    )
    assert fit.inertia == pytest.approx(INERTIA, rel=0.02)
    assert fit.gain == pytest.approx(GAIN, rel=0.02)


def test_no_bump_lies_across_the_start_of_another_recording() -> None:
    """Two recordings one behind the other, with a jump between: told where, the fit is
    that of a motor; not told, the jump is taken for a motion.
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
    with pytest.raises(LogError, match="too short"):
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


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["prbs", "multisine"])
def test_designed_experiment_reaches_its_standard_error(kind: str) -> None:
    plan = design_experiment(
        LINK, standard_error=0.001, noise=0.05, period=PERIOD, kind=kind
    )  # type: ignore[arg-type]
    torque = simulated_torque(LINK, plan.motor_angle, PERIOD)
    orders = []
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(0, 0.05, torque.size)
        log = Experiment(
            period=PERIOD, motor_angle=plan.motor_angle, output=torque + noise
        )
        orders.append(identify(log, "UD-FOM", heldout=0, details=False).model.order)
    # The deviation of 40 values is known to 11 %; three times that.
    assert np.std(orders) == pytest.approx(0.001, rel=0.35)
    assert plan.peak_deflection > 0


def test_limits_bind_and_the_nearest_request_is_feasible() -> None:
    motor = Rig.named("paper-2023").motor
    with pytest.raises(InfeasibleError) as caught:
        design_experiment(
            LINK,
            standard_error=1e-5,
            noise=0.05,
            period=PERIOD,
            motor=motor,
            deflection_limit=0.2,
        )
    nearest = caught.value.nearest
    plan = design_experiment(
        LINK,
        standard_error=nearest["standard_error"],
        noise=0.05,
        period=PERIOD,
        motor=motor,
        deflection_limit=0.2,
    )
    assert plan.peak_deflection <= 0.2 * (1 + 1e-9)
    assert plan.peak_voltage is not None
    assert plan.peak_voltage <= motor.voltage_limit


@pytest.mark.parametrize("field", ["standard_error", "noise", "period", "duration"])
def test_bad_design_requests(field: str) -> None:
    options = {
        "standard_error": 0.001,
        "noise": 0.05,
        "period": PERIOD,
        "duration": 10.0,
    } | {field: -1.0}
    with pytest.raises(FieldError) as caught:
        design_experiment(LINK, **options)
    assert caught.value.field == field
    with pytest.raises(FieldError, match="kind"):
        design_experiment(
            LINK, standard_error=0.001, noise=0.05, period=PERIOD, kind="chirp"
        )  # type: ignore[arg-type]


# --- the pieces against closed forms ------------------------------------------------------------------------

ANGLE = 0.02 * np.cumsum(np.random.default_rng(0).uniform(0.5, 1.0, 1200))
MOVING = _Bumps(ANGLE, None, PERIOD, 15)


def bump(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """(1 − x²)⁵ inside ± 1."""
    return np.where(np.abs(x) < 1, np.maximum(1 - x**2, 0.0) ** 5, 0.0)


@pytest.mark.parametrize("delay", [0.0, 0.0013, 0.004, 0.0111, 0.03])
def test_a_held_voltage_is_integrated_exactly(delay: float) -> None:
    """∫ φ((t − t_k)/w) u(t − τ) dt of a staircase, on a grid 400 times finer than its
    samples.
    """
    u = np.random.default_rng(1).normal(size=1200)
    width = 15 * PERIOD
    found = MOVING.driven(u, delay)
    for k in (0, len(found) // 2, len(found) - 1):
        centre = MOVING.centres[k] * PERIOD
        fine = centre + np.linspace(-width, width, 12_001)[:-1] + width / 12_000
        held = u[np.clip(np.floor((fine - delay) / PERIOD + 1e-9).astype(int), 0, 1199)]
        wanted = (
            float(np.sum(bump((fine - centre) / width) * held)) * 2 * width / 12_000
        )
        assert found[k] == pytest.approx(wanted, abs=2e-3 * width)


def test_it_does_not_matter_where_an_encoder_counts_from() -> None:
    """An angle of many turns is the same motion: its second derivative is taken under
    the integral.
    """
    voltage, angle = example_motor_log(samples=1500)
    here, away = (
        identify_motor(voltage, angle + start, period=PERIOD, delay=0.0, dead_zone=0.0)
        for start in (0.0, 900.0)
    )
    for name in ("gain", "decay", "coulomb_voltage", "nmse"):
        assert getattr(away, name) == pytest.approx(getattr(here, name), rel=1e-6)


def test_errors_of_quotients_follow_from_the_covariance() -> None:
    """Over 25 noises the scatter of Γc/K and of J is what one fit says that it is."""
    voltage, angle = example_motor_log(samples=2000)
    torque = np.repeat(np.random.default_rng(3).uniform(-0.01, 0.01, 50), 40)
    driven = voltage + torque / (GAIN * INERTIA)
    fits = []
    for seed in range(25):
        shaken = angle + np.random.default_rng(seed).normal(0, 0.02, angle.size)
        fits.append(
            identify_motor(
                driven, shaken, period=PERIOD, torque=torque, delay=0.0, dead_zone=0.0
            )
        )
    for name in ("gain", "decay", "coulomb_voltage", "inertia"):
        scatter = float(np.std([getattr(fit, name) for fit in fits]))
        said = float(np.median([fit.standard_errors[name] for fit in fits]))
        assert 0.7 < said / scatter < 1.7, name  # the scatter of 25 is known to 14 %
    fit = fits[0]
    assert fit.inertia is not None and fit.coulomb_torque is not None
    assert fit.coulomb_torque == pytest.approx(
        fit.coulomb_voltage * fit.gain * fit.inertia
    )
    assert fit.windows > 100


@pytest.mark.parametrize(
    ("option", "value", "allowed"),
    [
        ("delay", -1e-9, "0 to 4 s"),
        ("delay", 4.1, "0 to 4 s"),
        ("dead_zone", -0.1, "0 to "),
        ("window", 0.0, "> 0 and <= 4 s"),
        ("window", 4.1, "> 0 and <= 4 s"),
    ],
)
def test_options_of_a_motor_in_the_logs_own_range(
    option: str, value: float, allowed: str
) -> None:
    voltage, angle = example_motor_log(samples=1000)
    with pytest.raises(FieldError) as caught:
        identify_motor(voltage, angle, period=PERIOD, **{option: value})  # type: ignore[arg-type]
    assert caught.value.field == option
    assert caught.value.allowed.startswith(allowed)


def test_the_window_sets_the_length_of_a_stretch() -> None:
    voltage, angle = example_motor_log(samples=1000)
    with pytest.raises(LogError) as caught:
        identify_motor(
            voltage, np.sin(np.arange(1000) * 1.5), period=PERIOD, window=0.2
        )
    assert caught.value.allowed == ">= 20 stretches of 0.2 s"
    with pytest.raises(LogError) as caught:
        identify_motor(voltage, np.sin(np.arange(1000) * 1.5), period=PERIOD)
    assert (
        caught.value.allowed == ">= 20 stretches of 0.12 s"
    )  # 30 samples, above 80 ms
    with pytest.raises(LogError) as caught:
        identify_motor(voltage[:199], angle[:199], period=PERIOD)
    assert (caught.value.value, caught.value.allowed) == (
        199,
        ">= 200 samples, all alike",
    )
    with pytest.raises(LogError, match="another length") as caught:
        identify_motor(voltage, angle, period=PERIOD, torque=angle[:-1])
    assert (caught.value.field, caught.value.value) == ("torque", 999)


# --- the design of experiments ------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["prbs", "multisine"])
def test_what_a_design_says_of_its_motion(kind: str) -> None:
    motor = Rig.named("paper-2023").motor
    plan = design_experiment(
        LINK,
        standard_error=0.002,
        noise=0.05,
        period=PERIOD,
        duration=10.0,
        kind=kind,
        motor=motor,  # type: ignore[arg-type]
    )
    assert plan.kind == kind
    assert plan.limit == "none"
    assert plan.standard_error == pytest.approx(0.002)
    assert plan.duration == pytest.approx(10.0)
    assert plan.time == pytest.approx(PERIOD * np.arange(2501))
    assert np.abs(plan.motor_angle).max() == pytest.approx(plan.amplitude, rel=0.15)
    low, high = plan.band
    if kind == "prbs":
        assert plan.bit is not None
        assert (low, high) == (
            pytest.approx(2 * np.pi / 10.0),
            pytest.approx(0.44 * 2 * np.pi / plan.bit),
        )
        assert plan.bit / PERIOD == pytest.approx(round(plan.bit / PERIOD))
    else:
        assert plan.bit is None
        assert high / low == pytest.approx(4.0)
        assert round(2 * low / abs(LINK.pole), 6) in (
            0.25,
            0.35,
            0.5,
            0.7,
            1.0,
            1.4,
            2.0,
        )
    # The deflection and the voltage of eq. (1), from the motion itself.
    torque = simulated_torque(LINK, plan.motor_angle, PERIOD, hold="first")
    assert plan.peak_deflection == pytest.approx(
        float(np.abs(torque).max()) / 1.56, rel=1e-6
    )
    speed = np.gradient(plan.motor_angle, PERIOD)
    voltage = (np.gradient(speed, PERIOD) + motor.decay * speed) / motor.gain
    voltage += torque / (motor.gear_ratio * motor.torque_constant)
    assert plan.peak_voltage == pytest.approx(float(np.abs(voltage).max()), rel=1e-6)


def test_the_error_falls_with_amplitude_and_grows_with_noise() -> None:
    plans = [
        design_experiment(
            LINK, standard_error=error, noise=noise, period=PERIOD, duration=5.0
        )
        for error, noise in ((0.002, 0.05), (0.001, 0.05), (0.002, 0.1))
    ]
    assert plans[1].amplitude == pytest.approx(2 * plans[0].amplitude)
    assert plans[2].amplitude == pytest.approx(2 * plans[0].amplitude)


def test_a_limit_says_what_it_leaves_and_how_long_a_log_would_do() -> None:
    with pytest.raises(InfeasibleError) as caught:
        design_experiment(
            LINK,
            standard_error=5e-4,
            noise=0.05,
            period=PERIOD,
            duration=5.0,
            deflection_limit=0.1,
        )
    error = caught.value
    assert "deflection limit" in str(error)
    reached = error.nearest["standard_error"]
    assert (
        f"a log of {math.ceil(5.0 * (reached / (1 + 1e-6) / 5e-4) ** 2)} s may do"
        in str(error)
    )
    with pytest.raises(
        InfeasibleError
    ) as caught:  # beyond a million samples no length is offered
        design_experiment(
            LINK,
            standard_error=1e-7,
            noise=0.05,
            period=PERIOD,
            duration=5.0,
            deflection_limit=0.1,
        )
    assert "may do" not in str(caught.value)


def test_a_log_has_two_hundred_samples() -> None:
    for duration, fits in ((0.8, True), (0.79, False)):
        arguments = {
            "standard_error": 0.5,
            "noise": 0.05,
            "period": PERIOD,
            "duration": duration,
        }
        if fits:
            assert design_experiment(LINK, **arguments).time.size == 201
            continue
        with pytest.raises(FieldError) as caught:
            design_experiment(LINK, **arguments)
        assert (caught.value.field, caught.value.allowed) == (
            "duration",
            "0.8 to 4000 s",
        )
