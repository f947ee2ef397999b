"""The closed loop: its plant against independent solutions, its verdicts against known
properties of the design.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import lsim

import fraclink as fl
from fraclink import LinkModel, Rig, SecondMode, extend, simulate
from fraclink.errors import FieldError, FileFormatError, SizeError
from fraclink.extend import Encoder, Gauge
from law_bench import PERIOD, law

RIG = Rig.named("paper-2023")
MODEL = RIG.model
assert MODEL is not None
EXACT = replace(
    RIG, encoder=Encoder(), gauge=Gauge(), motor=replace(RIG.motor, coulomb_torque=0.0)
)
STEP = fl.smooth_step(1.0, 0.3)
OFF = 4  # mode of law.h


def outer() -> fl.Law:
    """The law without its motor loop: the motor follows M(s)."""
    return replace(law(), motor_loop=None)


def _held(
    transfer: Callable[[Any], Any], held: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Response to `held` at the samples, from step responses by numerical Laplace
    inversion: 64 points on the contour of Trefethen, Weideman and Schmelzer (BIT 46,
    2006), which agree with Talbot's with 40 digits.
    """
    count, time = 64, PERIOD * np.arange(1, len(held))
    angle = math.pi * ((2 * np.arange(count) + 1) / count - 1)
    cot = 1 / np.tan(0.6407 * angle)
    point = count * (0.5017 * angle * cot - 0.6122 + 0.2645j * angle)
    slope = count * (0.5017 * (cot - 0.6407 * angle * (1 + cot**2)) + 0.2645j)
    images = transfer(point / time[:, None]) / point
    step = ((images * np.exp(point)) @ slope / (1j * count)).real
    mpmath.mp.dps = 40
    for k in (0, len(time) // 3, len(time) - 1):
        exact = mpmath.invertlaplace(
            lambda s: transfer(s) / s, time[k], method="talbot", degree=48
        )
        assert step[k] == pytest.approx(float(exact), rel=1e-11, abs=1e-11)
    return np.convolve(np.diff(held, prepend=0.0), [0.0, *step])[: len(held)]


def _tip_transfer(model: LinkModel) -> Callable[[Any], Any]:
    order, square = model.order, model.natural_frequency**2
    mu, alpha = model.damping, model.damping_order
    return lambda s: (mu * s**alpha + square) / (s**order + mu * s**alpha + square)


@pytest.mark.slow
@pytest.mark.parametrize(
    "model",
    [
        MODEL,
        LinkModel(1.56, 11.0),
        LinkModel(1.56, 11.0, damping=0.5),
        LinkModel(1.56, 11.0, damping=0.8, damping_order=0.6),
        LinkModel(1.56, 11.0, damping=16.5),
        LinkModel(1.56, 11.0, damping=33.0),
        LinkModel(1.56, 11.0, damping=40.0, damping_order=0.8),
    ],
    ids=lambda m: f"{m.structure}, μ = {m.damping:g}",
)
def test_the_tip_follows_an_independent_solution_behind_m_of_s(
    model: LinkModel,
) -> None:
    run = simulate(outer(), STEP, rig=EXACT, model=model, duration=0.6)
    delayed = np.concatenate([[0.0], run.motor_reference[:-1]])
    link = _tip_transfer(model)
    expected = _held(lambda s: link(s) / (1 + s / 80) ** 2, delayed)
    assert np.abs(run.tip_angle - expected).max() < 1e-8
    # M(s) alone has its step response in closed form
    x = 80 * PERIOD * np.arange(len(delayed))
    moved = np.convolve(np.diff(delayed, prepend=0.0), 1 - (1 + x) * np.exp(-x))
    assert np.abs(run.motor_angle - moved[: len(delayed)]).max() < 1e-10
    # and so have its speed and acceleration, which ask for this voltage
    steps = np.diff(delayed, prepend=0.0)
    speed = np.convolve(steps, 80 * x * np.exp(-x))[: len(delayed)]
    acceleration = np.convolve(steps, 80**2 * (1 - x) * np.exp(-x))[: len(delayed)]
    voltage = (acceleration + RIG.motor.decay * speed) / RIG.motor.gain
    np.testing.assert_allclose(run.voltage, voltage, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_the_tip_follows_an_independent_solution_behind_the_motor() -> None:
    run = simulate(law(), STEP, rig=EXACT, model=MODEL, duration=0.6)
    # the voltage of the law includes its compensation of the coupling torque, which is
    # assumed to be exact
    voltage = run.voltage - law().coefficients["torque_voltage"] * run.torque_measured
    delayed = np.concatenate([[0.0], voltage[:-1]])
    link, gain, decay = _tip_transfer(MODEL), RIG.motor.gain, RIG.motor.decay
    expected = _held(lambda s: link(s) * gain / (s * (s + decay)), delayed)
    assert np.abs(run.tip_angle - expected).max() < 1e-8


def test_friction_stops_the_motor_where_the_equation_says() -> None:
    """With the voltage off, a motor coasts against Coulomb friction by v/B − (f/B²)
    ln(1 + B v/f), and stays there.
    """
    rig = replace(EXACT, motor=replace(EXACT.motor, coulomb_torque=0.006))
    decay, gain = rig.motor.decay, rig.motor.gain
    friction = gain * rig.motor.coulomb_torque / rig.motor.torque_constant

    rest, fall = math.exp(-decay * PERIOD), friction / decay
    made = extend.equip(law(), rig, MODEL)
    dead = extend.SensorFault(0.2, 1.0, "encoder value", float("nan"))
    run = simulate(
        made,
        fl.smooth_step(1.0, 0.5),
        rig=rig,
        model=MODEL,
        duration=1.0,
        events=(dead,),
    )
    # two periods after the trip the voltage of the last command has acted
    first = int(np.flatnonzero(run.mode == OFF)[0]) + 2
    angle = run.motor_angle[first:]
    first_step = angle[1] - angle[0]
    speed = (first_step + fall * PERIOD) * decay / (1 - rest) - fall
    coasted = speed / decay - fall / decay * np.log(1 + speed / fall)
    assert angle[-1] == angle[-2]
    assert angle[-1] - angle[0] == pytest.approx(coasted, rel=2e-3)


@pytest.mark.parametrize("payload", [0.008, 0.016, 0.020, 0.030, 0.040])
def test_the_default_design_holds_for_every_payload(payload: float) -> None:
    options = {"rig": EXACT, "model": MODEL, "payload": payload}
    for made in (outer(), law()):
        run = simulate(made, fl.smooth_step(1.0, 0.5), **options)
        assert run.verdict.passed, run.verdict.reason
        assert abs(run.metrics.steady_state_error) < 1e-3
        assert run.payload == payload


@pytest.mark.slow
@pytest.mark.parametrize("payload", [0.030, 0.040])
def test_the_printed_controller_visibly_diverges(payload: float) -> None:
    printed = fl.Controller(
        derivative_gain=0.148,
        derivative_order=0.65,
        filter_time=0.16,
        filter_order=2,
        link=MODEL,
    )
    run = simulate(
        replace(fl.discretize(printed, PERIOD), motor_loop=None),
        STEP,
        rig=EXACT,
        model=MODEL,
        payload=payload,
        duration=12.0,
    )
    assert not run.verdict
    assert "unstable" in run.verdict.reason
    early, late = run.tip_angle[500:1000], run.tip_angle[-500:]
    assert np.ptp(late) > 1.5 * np.ptp(early) or np.ptp(late) > 0.4


def test_a_gauge_offset_leaves_the_tip() -> None:
    run = simulate(
        outer(),
        fl.extend.hold(0.0),
        rig=EXACT,
        model=MODEL,
        duration=12.0,
        gauge_offset=0.05 * MODEL.stiffness,
    )
    error = np.abs(run.tip_angle)
    assert error.max() > 5e-3  # the disturbance acts first
    levels = [error[round(t / PERIOD) :].max() for t in (4.0, 6.0, 8.0, 10.0)]
    assert levels[0] < 1e-3
    assert levels[0] > levels[1] > levels[2] > levels[3]


@pytest.mark.slow
@pytest.mark.parametrize("payload", [0.02, 0.04])
def test_friction_is_compensated(payload: float) -> None:
    """Without a filter, because with one the 20 g arm keeps 0.11 of the vibration."""
    rough = replace(EXACT, motor=RIG.motor)
    design = fl.design(
        MODEL,
        rough,
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
        filter_time=0.0,
    )
    made, move = design.law(), fl.smooth_step(1.0, 0.5)
    assert made.motor_loop is not None
    run = simulate(made, move, rig=rough, model=MODEL, payload=payload)
    assert run.verdict.passed, run.verdict.reason
    bare = replace(made, motor_loop=replace(made.motor_loop, coulomb_voltage=0.0))
    worse = simulate(bare, move, rig=rough, model=MODEL, payload=payload)
    assert np.ptp(run.tip_angle[-250:]) < 0.1 * np.ptp(worse.tip_angle[-250:])


def test_saturation_is_reported() -> None:
    weak = replace(EXACT, motor=replace(RIG.motor, voltage_limit=0.02))
    bounded = replace(law(), motor_loop=replace(law().motor_loop, voltage_limit=0.02))  # type: ignore[type-var]
    run = simulate(bounded, fl.smooth_step(1.0, 0.5), rig=weak, model=MODEL)
    assert np.abs(run.voltage).max() <= 0.02
    assert run.metrics.saturated > 0.01
    assert not run.verdict


def test_sensors_quantise_clip_and_lie() -> None:
    coarse = replace(
        EXACT,
        encoder=Encoder(counts_per_revolution=2000),
        gauge=Gauge(noise=0.02, limit=0.15, quantum=0.01, offset=0.01),
    )
    run = simulate(outer(), STEP, rig=coarse, model=MODEL, seed=5)
    counts = run.torque_measured / 0.01
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.abs(run.torque_measured).max() == 0.15
    quiet = np.abs(run.torque) < 0.05
    assert np.mean((run.torque_measured - run.torque)[1:][quiet[1:]]) == pytest.approx(
        0.01, abs=2e-3
    )
    assert np.std((run.torque_measured - run.torque)[quiet]) == pytest.approx(
        0.02, rel=0.1
    )


def test_a_run_names_its_events() -> None:
    fault = extend.SensorFault(0.1, 0.2, "gauge value", math.nan)
    options = {"rig": RIG, "model": MODEL, "duration": 0.4}
    broken = simulate(law(), STEP, events=[fault], **options)
    assert broken.about["events"] == repr(fault)
    assert "events" not in simulate(law(), STEP, **options).about


def test_seeds_repeat_and_differ() -> None:
    runs = [
        simulate(
            outer(),
            STEP,
            rig=RIG,
            model=MODEL,
            seed=seed,
            duration=1.0,
        )
        for seed in (7, 7, 8)
    ]
    np.testing.assert_array_equal(runs[0].torque_measured, runs[1].torque_measured)
    assert np.any(runs[0].torque_measured != runs[2].torque_measured)


def test_noise_is_standard_normal() -> None:
    noisy = replace(EXACT, gauge=Gauge(noise=0.01))
    options = {"rig": noisy, "model": MODEL}
    run = simulate(outer(), STEP, duration=400.0, seed=11, **options)
    drawn = (run.torque_measured - run.torque) / 0.01
    assert abs(drawn.mean()) < 0.01
    for quantile, wanted in (
        (0.001, -3.0902),
        (0.1587, -1.0),
        (0.5, 0.0),
        (0.9772, 2.0),
        (0.9999, 3.719),
    ):
        assert np.quantile(drawn, quantile) == pytest.approx(
            wanted, abs=0.06 if quantile < 0.999 else 0.4
        )
    for lag in (1, 2, 10):
        assert abs(np.mean(drawn[lag:] * drawn[:-lag])) < 0.01


def test_the_delay_acts() -> None:
    runs = {
        d: simulate(
            outer(),
            STEP,
            rig=EXACT,
            model=MODEL,
            duration=0.5,
            delay_samples=d,
        )
        for d in (0, 1, 5)
    }
    for delay, run in runs.items():
        moved = int(np.argmax(run.motor_angle != 0))
        commanded = int(np.argmax(run.motor_reference != 0))
        assert moved == commanded + delay + 1
    late = simulate(
        outer(),
        STEP,
        rig=EXACT,
        model=MODEL,
        duration=6.0,
        delay_samples=20,
    )
    assert not late.verdict


def test_a_start_away_from_zero_is_a_shifted_run() -> None:
    shifted = fl.extend.hold(0.5, 0.0).then(STEP)
    runs = (
        simulate(outer(), STEP, rig=EXACT, model=MODEL),
        simulate(outer(), shifted, rig=EXACT, model=MODEL),
    )
    np.testing.assert_allclose(runs[1].tip_angle - 0.5, runs[0].tip_angle, atol=1e-12)


def test_a_run_survives_its_file(tmp_path: Path) -> None:
    run = simulate(
        outer(),
        STEP,
        rig=RIG,
        model=MODEL,
        payload=0.02,
        duration=1.0,
        seed=3,
    )
    run.save(tmp_path / "run.npz")
    back = fl.Run.load(tmp_path / "run.npz")
    assert back.metrics == run.metrics
    assert back.verdict == run.verdict
    assert (back.about, back.payload, back.findings) == (
        run.about,
        run.payload,
        run.findings,
    )
    np.testing.assert_array_equal(back.tip_angle, run.tip_angle)
    with pytest.raises(ValueError, match="read-only"):
        back.tip_angle[0] = 1.0
    for content in (b"", b"PK\x03\x04", b"not a run"):
        (tmp_path / "bad.npz").write_bytes(content)
        with pytest.raises(FileFormatError):
            fl.Run.load(tmp_path / "bad.npz")
    np.savez(tmp_path / "other.npz", about=np.array("[1]"))
    with pytest.raises(FileFormatError):
        fl.Run.load(tmp_path / "other.npz")


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"payload": -0.03}, "payload"),
        ({"payload": 0.0}, "payload"),
        ({"payload": float("nan")}, "payload"),
        ({"payload": "20 g"}, "payload"),
        ({"duration": 0.0}, "duration"),
        ({"noise": -1.0}, "noise"),
        ({"gauge_offset": float("inf")}, "gauge_offset"),
        ({"seed": 1.5}, "seed"),
        ({"seed": -1}, "seed"),
        ({"delay_samples": 101}, "delay_samples"),
        ({"delay_samples": True}, "delay_samples"),
    ],
)
def test_bad_options_are_named(options: dict[str, object], field: str) -> None:
    with pytest.raises(FieldError) as caught:
        simulate(law(), STEP, rig=RIG, model=MODEL, **options)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_a_reference_that_is_no_number_is_refused() -> None:
    class Lost(fl.Reference):
        duration = 0.3
        kind = "lost"

        def derivative(self, time: Any, order: int) -> NDArray[np.float64]:
            return np.where(np.asarray(time) > 0.1, np.nan, 0.0)

    with pytest.raises(FieldError, match="reference: not finite"):
        simulate(outer(), Lost(), rig=RIG, model=MODEL, duration=0.5)


def test_sizes_and_periods_are_checked_first() -> None:
    with pytest.raises(SizeError):
        simulate(outer(), STEP, rig=RIG, model=MODEL, duration=1e9)
    with pytest.raises(FieldError, match="period"):
        simulate(outer(), STEP, rig=replace(RIG, period=0.002), model=MODEL)


# --- what identification found is in the simulation -----------------------------------


def test_the_printed_controller_fails_within_four_seconds() -> None:
    """With controller (58) at 30 g the vibration grows by 0.14 a second, even while it
    is still small.
    """
    printed = fl.Controller(
        derivative_gain=0.148,
        derivative_order=0.65,
        filter_time=0.16,
        filter_order=2,
        link=MODEL,
    )
    made = fl.discretize(printed, PERIOD)
    for amplitude in (1.0, 0.2, 0.1):
        move = fl.smooth_step(amplitude, 0.5)
        run = simulate(
            made, move, rig=RIG, model=MODEL, payload=0.030, duration=4.0, noise=0.0
        )
        assert run.verdict.reason.startswith("unstable: the vibration grows"), (
            run.verdict.reason
        )
        assert run.metrics.growth == pytest.approx(0.14, abs=0.01)
    gentle = simulate(
        made, fl.smooth_step(1.0, 1.0), rig=RIG, model=MODEL, payload=0.030, noise=0.0
    )
    # judged by its size alone it would have passed
    assert gentle.metrics.settling_time < 2.0
    assert gentle.verdict.reason.startswith("unstable: the vibration grows"), (
        gentle.verdict.reason
    )


@pytest.mark.parametrize("delay", [0.004, 0.057, 0.0013, 0.006, 0.0578])
def test_the_gauge_shows_the_torque_of_its_delay(delay: float) -> None:
    slow = fl.smooth_step(0.5, 1.0)
    run = simulate(
        law(),
        slow,
        rig=EXACT,
        model=replace(MODEL, gauge_delay=delay, gauge_gain=-0.7),
        duration=3.0,
    )
    # A spline through all samples differs from the cubic through four samples in the
    # kernel.
    before = np.arange(-50, 0) * PERIOD
    spline = CubicSpline(
        np.concatenate([before, run.time]), np.concatenate([0 * before, run.torque])
    )
    tolerance = 1e-12 if delay == 0.004 else 4e-3 * np.abs(run.torque).max()
    np.testing.assert_allclose(
        run.torque_measured, -0.7 * spline(run.time - delay), atol=tolerance
    )
    assert run.about["gauge_delay"] == delay


def test_a_delay_between_samples_is_a_delay_to_fourth_order() -> None:
    """The phase of a sustained vibration, between the true torque and the reading of
    the gauge.
    """
    undamped = LinkModel(1.56, 11.0, gauge_delay=0.0103)
    idle = replace(
        law(), limits=replace(law().limits, torque_trip=1e6, residual_angle=1e6)
    )
    run = simulate(
        replace(idle, motor_loop=None),
        fl.extend.pulse(0.4, 0.1, 0.2),
        rig=EXACT,
        model=undamped,
        duration=0.6,
    )
    inner = slice(20, 140)
    at = run.time[inner] - 0.0103
    wanted = CubicSpline(run.time, run.torque)(at)
    assert (
        np.abs(run.torque_measured[inner] - wanted).max()
        < 5e-4 * np.abs(run.torque).max()
    )


def test_the_model_brings_its_gauge_and_its_second_mode() -> None:
    found = replace(
        MODEL,
        gauge_delay=0.012,
        gauge_gain=1.1,
        second_mode=SecondMode(frequency=200.0, gain=0.05),
    )
    told = simulate(law(), STEP, rig=EXACT, model=found, duration=1.0)
    # the reading is what the torque was three periods ago, times the gain
    np.testing.assert_allclose(
        told.torque_measured[3:], 1.1 * told.torque[:-3], atol=1e-12
    )
    assert (told.about["gauge_delay"], told.about["gauge_gain"]) == (0.012, 1.1)
    late = simulate(
        law(), STEP, rig=EXACT, model=replace(MODEL, gauge_delay=0.057), payload=0.02
    )
    assert not late.verdict  # a delay that was measured but is not part of the design
    twin = fl.Twin.from_rig(EXACT, model=found)
    assert (twin.gauge_delay, twin.gauge_gain) == (0.012, 1.1)


def test_the_second_mode_is_its_transfer_function() -> None:
    mode = SecondMode(frequency=150.0, gain=0.2, damping_ratio=0.1)
    made = replace(law(), motor_loop=None)
    options = {"rig": EXACT, "duration": 0.4}
    run = simulate(made, STEP, model=replace(MODEL, second_mode=mode), **options)
    extra = run.torque - MODEL.stiffness * (run.motor_angle - run.tip_angle)
    # Alternative: the state space of the mode, driven by the smooth motor angle with 40
    # steps per period.
    fine = np.linspace(0.0, run.time[-1], 40 * (len(run.time) - 1) + 1)
    w, z = mode.frequency, mode.damping_ratio
    system = ([mode.gain, 0.0, 0.0], [1.0, 2 * z * w, w**2])
    _, answer, _ = lsim(system, CubicSpline(run.time, run.motor_angle)(fine), fine)
    assert (
        np.abs(extra - MODEL.stiffness * answer[::40]).max()
        < 2e-3 * np.abs(extra).max()
    )


def test_a_law_without_a_motor_loop_drives_no_motor() -> None:
    options = {"rig": EXACT, "model": MODEL, "duration": 1.0}
    bare = simulate(outer(), STEP, **options)
    assert bare.findings == () and bare.about["motor_loop"] == "ideal"
    with pytest.raises(FieldError, match=r"law.motor_loop: missing"):
        simulate(outer(), STEP, arm=fl.Twin.from_rig(RIG))
    equipped = simulate(fl.extend.equip(outer(), EXACT, MODEL), STEP, **options)
    assert equipped.verdict.passed and equipped.about["motor_loop"] == "sampled"


@pytest.mark.slow
def test_a_design_brings_rig_model_and_law() -> None:
    design = fl.design(
        MODEL, RIG, payloads=(0.02, 0.04), gain_crossover=12.0, phase_margin=fl.deg(50)
    )
    told = simulate(design, STEP, payload=0.02, duration=1.0)
    asked = simulate(
        design.law(), STEP, rig=RIG, model=MODEL, payload=0.02, duration=1.0
    )
    np.testing.assert_array_equal(told.tip_angle, asked.tip_angle)
    assert told.about["law_sha256"] == design.law().digest
