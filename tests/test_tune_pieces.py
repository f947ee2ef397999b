"""The pieces of a tuning by themselves, each against what was put into its record."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink import _kernels
from fraclink.errors import FieldError
from fraclink.lab._connections import Callback
from fraclink.lab._line import open_line
from fraclink.lab._tune_build import (
    _about,
    _mass_ratio,
    _with_link,
    late_free,
    link_twins,
)
from fraclink.lab._tune_doublets import motor_of_doublets
from fraclink.lab._tune_guard import Guard, Record
from fraclink.lab._tune_link import _ringing, _torque_of, shortfall
from fraclink.lab._tune_motion import burst, random_moves, random_steps
from fraclink.lab._tune_moves import FirstMove, _judged
from fraclink.lab._tune_wiring import (
    _PAUSE,
    _PULSE,
    Wiring,
    WiringFault,
    _concluded,
    _kept,
    _scales,
    _smoothed,
    _step,
    _train,
)
from tuned_arms import PERIOD, RIG

if not _kernels.REALTIME:
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

Real = NDArray[np.float64]


# --- the wiring ------------------------------------------------------------------------------------------


FINE, LOSS = 100, 10.0  # steps of integration in a period, ν/J [1/s]
HALF = round(_PULSE / PERIOD)


def doublet(gain: float, friction: float) -> Real:
    """Angle under 2 V and then −2 V from rest: θ'' = gain (V − friction · sign θ') −
    ν/J θ'.
    """
    step, angle, speed, path = PERIOD / FINE, 0.0, 0.0, [0.0]
    for k in range(2 * HALF * FINE):
        voltage = 2.0 if k < HALF * FINE else -2.0
        against = math.copysign(friction, speed or voltage)
        faster = speed + step * (gain * (voltage - against) - LOSS * speed)
        faster = 0.0 if faster * speed < 0 else faster
        angle, speed = angle + 0.5 * step * (speed + faster), faster
        path.append(angle)
    return np.array(path)


def doublets(gain: float, friction: float, delay: float, noise: float = 0.0) -> Record:
    """Doublets of ±2 V, each from rest, that act `delay` later."""
    pause, parts = round(_PAUSE / PERIOD), [np.zeros(25)]
    for k in range(8):
        sign = 1.0 if k % 2 == 0 else -1.0
        parts += [
            np.full(HALF, 2.0 * sign),
            np.full(HALF, -2.0 * sign),
            np.zeros(pause + 5 * (k % 4)),
        ]
    voltage = np.concatenate(parts)
    way, time = (
        np.sign(gain) * doublet(abs(gain), friction),
        PERIOD * np.arange(voltage.size),
    )
    angle = np.zeros(voltage.size)
    for begin in np.flatnonzero((voltage[1:] != 0) & (voltage[:-1] == 0)) + 1:
        since = time - time[begin] - delay
        angle += np.sign(voltage[begin]) * np.interp(
            since, PERIOD / FINE * np.arange(way.size), way
        )
    measured = angle + noise * np.random.default_rng(3).normal(size=voltage.size)
    return Record(PERIOD, voltage, measured, np.zeros(voltage.size))


@pytest.mark.parametrize(
    ("gain", "friction", "delay"),
    [(150.0, 0.0, 0.0), (60.0, 0.3, 0.008), (-80.0, 0.2, 0.004), (60.0, 0.9, 0.006)],
)
def test_the_motor_is_found_from_its_doublets(
    gain: float, friction: float, delay: float
) -> None:
    """With the friction of a motor that stops within the doublet, too, and with its
    wires reversed.
    """
    found, error, lost, late = motor_of_doublets(doublets(gain, friction, delay), HALF)
    assert found == pytest.approx(gain, rel=0.02)
    assert lost == pytest.approx(friction, abs=0.03)
    assert late == pytest.approx(delay, abs=0.01 * PERIOD)
    assert error < 0.01 * abs(gain)


def test_the_motors_error_is_that_of_its_gain() -> None:
    quiet, loud = (
        motor_of_doublets(doublets(150.0, 0.3, 0.004, noise), HALF)
        for noise in (1e-3, 1e-2)
    )
    assert loud[1] == pytest.approx(10.0 * quiet[1], rel=0.5)
    assert abs(loud[0] - 150.0) < 4.0 * loud[1]


def test_a_record_without_a_doublet_shows_no_sign() -> None:
    still = Record(PERIOD, np.full(200, 1.0), np.zeros(200), np.zeros(200))
    gain, error, _, _ = motor_of_doublets(still, HALF)
    assert gain == 0.0 and error == math.inf


def test_what_a_doublet_moves_stays_and_what_it_bends_comes_back() -> None:
    record = doublets(150.0, 0.0, 0.0)
    begins = np.flatnonzero((record.voltage[1:] != 0) & (record.voltage[:-1] == 0)) + 1
    stairs, rings = np.zeros(record.angle.size), np.zeros(record.angle.size)
    for begin in begins:
        sign = np.sign(record.voltage[begin])
        stairs[begin + round(_PULSE / PERIOD) :] += 0.02 * sign
        t = PERIOD * np.arange(record.angle.size - begin)
        rings[begin:] += sign * np.exp(-5.0 * t) * np.sin(60.0 * t)
    assert _kept(record, stairs + 0.3) == pytest.approx(1.0)
    assert _kept(record, rings) < 0.1
    assert 0.3 < _kept(record, stairs + 0.01 * rings) < 1.0
    assert _kept(record, np.full(record.angle.size, 0.7)) < 1e-9


def test_the_smallest_step_is_the_encoders_count() -> None:
    count = 2 * math.pi / 4096
    angle = count * np.round(0.1 * np.sin(np.arange(200) / 9.0) / count)
    assert _step(angle) == pytest.approx(count)
    assert _step(np.full(10, 0.3)) == 0.0
    np.testing.assert_allclose(_smoothed(np.arange(9.0)), np.arange(2.0, 7.0))


@pytest.mark.parametrize(
    ("times", "bend", "fault"),
    [
        (1.0, 1.0, ""),
        (1.58, 1.0, ""),
        (1.62, 1.0, "encoder scale wrong"),
        (0.41, 1.0, ""),
        (0.39, 1.0, "encoder scale wrong"),
        (1.0, 2.45, ""),
        (1.0, 2.55, "gauge scale wrong: it shows 2.5"),
        (1.0, 0.41, ""),
        (1.0, 0.39, "gauge scale wrong: it shows 0.39"),
    ],
)
def test_scales_are_wrong_beyond_what_friction_and_payload_explain(
    times: float, bend: float, fault: str
) -> None:
    gain, stiffness = times * RIG.motor.gain, bend / times * RIG.link.stiffness
    said, found = _scales(gain, stiffness, RIG)
    assert found.startswith(fault) and bool(found) == bool(fault)
    assert (
        f"K/J is {times:.2g} of" in said[0]
        and f"{bend / times:.2g} of the rig's" in said[1]
    )


@pytest.fixture(scope="module")
def train() -> Record:
    made = fl.lab.SimulatedArm(fl.Twin.from_rig(RIG), PERIOD, seed=2)
    limits = fl.MotionLimits(angle=0.6, speed=4.0, torque=2.0, voltage=10.0)
    guard = Guard(partial(open_line, made.callback, PERIOD, clock="none"), limits)
    record = _train(guard, 0.8)
    guard.release()
    return record


def test_doublets_are_rest_to_rest_and_of_both_signs(train: Record) -> None:
    assert train.voltage[0] == train.voltage[-1] == 0.0
    begins = np.flatnonzero((train.voltage[1:] != 0) & (train.voltage[:-1] == 0)) + 1
    assert len(begins) == 12
    assert train.voltage[begins].tolist() == [0.8, -0.8] * 6
    half = round(_PULSE / PERIOD)
    assert all(train.voltage[b + half - 1] == -train.voltage[b + half] for b in begins)
    gaps = np.diff(begins) * PERIOD
    assert (
        len(np.unique(np.round(gaps, 6))) >= 4
    )  # pauses differ, so that no vibration builds up
    assert abs(train.voltage.sum()) < 1e-9


@pytest.mark.parametrize(("counts", "dead"), [(2, True), (3, False), (40, False)])
def test_an_encoder_that_shows_fewer_than_three_counts_is_dead(
    train: Record, counts: int, dead: bool
) -> None:
    shown = np.round(counts * (train.angle - train.angle.min()) / np.ptp(train.angle))
    found = _concluded(replace(train, angle=1e-3 * shown), 1e-5, 1e-3, 0.8, None)
    assert (
        isinstance(found, WiringFault) and str(found).startswith("encoder dead")
    ) == dead
    if dead:
        assert "(0.8 V)" in str(found)


def test_what_is_concluded_of_a_right_arm(train: Record) -> None:
    found = _concluded(train, 1e-5, 2e-3, 0.8, RIG)
    assert isinstance(found, Wiring)
    assert found.stiffness == pytest.approx(RIG.link.stiffness, rel=0.15)
    assert found.natural_frequency == pytest.approx(
        RIG.model.natural_frequency, rel=0.2
    )
    assert (found.encoder_noise, found.gauge_noise, found.pulse) == (1e-5, 2e-3, 0.8)
    assert found.motion == pytest.approx(np.abs(train.angle).max())
    assert found.encoder_step == _step(train.angle)


def test_a_silent_arm_is_waited_for_as_long_as_was_said() -> None:
    """Behind a clock of its own: a period is over when it was asked for."""
    reads = []

    def read() -> None:
        reads.append(1)

    with (
        pytest.raises(FieldError, match=r"silent: no sample in 0\.5 s"),
        open_line(Callback(read, lambda _: None), 0.01, patience=0.5, clock="none"),
    ):
        pass
    assert 50 <= len(reads) <= 5000


# --- motions ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 5])
def test_random_moves_keep_reach_and_speed_and_end_at_rest(seed: int) -> None:
    path = random_moves(0.4, 2.0, 6.0, 0.002, seed=seed)
    angle, acceleration = path
    assert np.abs(angle).max() <= 0.4 + 1e-12
    speed = np.diff(angle) / 0.002
    assert 0.9 < np.abs(speed).max() <= 2.0 + 1e-9
    assert (
        angle[0] == angle[-1] == 0.0
        and not angle[-150:].any()
        and not acceleration[-150:].any()
    )
    assert angle.min() < -0.12 and angle.max() > 0.12  # both sides
    second = np.diff(angle, 2) / 0.002**2
    inside = np.abs(second - acceleration[1:-1]) < 0.05 * np.abs(acceleration).max()
    assert np.mean(inside) > 0.95  # but where one move follows another
    assert 6.0 < angle.size * 0.002 < 9.0
    assert np.array_equal(path, random_moves(0.4, 2.0, 6.0, 0.002, seed=seed))
    assert not np.array_equal(path, random_moves(0.4, 2.0, 6.0, 0.002, seed=seed + 1))


def test_random_steps_hold_two_levels_behind_smooth_edges() -> None:
    angle, acceleration = random_steps(0.3, 0.2, 0.05, 16, 0.002)
    assert (
        not angle[:100].any()
        and not angle[-150:].any()
        and not acceleration[-150:].any()
    )
    held = angle[100:-150].reshape(-1, 100)
    assert (
        len(held) == 17
        and set(np.round(held[:-1, -1], 9)) == {0.3, -0.3}
        and held[-1, -1] == pytest.approx(0, abs=1e-9)
    )
    assert np.ptp(held[:, 26:], axis=1).max() < 1e-9  # the edge takes 50 ms
    assert np.abs(np.diff(angle)).max() <= 1.875 * 0.6 / 0.05 * 0.002 * 1.001
    edge = 1 + int(np.flatnonzero(np.diff(held[:-1, -1]))[0])
    second = np.diff(held[edge], 2)[:20] / 0.002**2
    np.testing.assert_allclose(
        second, acceleration[100:-150].reshape(-1, 100)[edge, 1:21], rtol=0.1, atol=30.0
    )


def test_a_burst_changes_sign_at_random_and_ends_with_a_rest() -> None:
    made = burst(1.5, 0.02, 4.0, 0.004)
    assert set(np.unique(made[:-50])) == {-1.5, 1.5} and not made[-50:].any()
    assert made.size == 1000 + 50
    runs = made[:-50].reshape(-1, 5)
    assert np.ptp(runs, axis=1).max() == 0.0  # held for five periods
    signs = np.sign(runs[:, 0])
    assert abs(signs.mean()) < 0.2 and 0.3 < np.mean(signs[1:] != signs[:-1]) < 0.7


def test_a_moves_settling_and_ringing_are_those_of_its_tip() -> None:
    """A tip that is the motor's angle less a bend of known size and decay."""
    design = SimpleNamespace(
        model=RIG.model, rig=replace(RIG, gauge=replace(RIG.gauge, noise=0.0))
    )
    w, rate, size = abs(RIG.model.pole), 1.5, 0.05
    time = PERIOD * np.arange(round(6.0 / PERIOD))
    angle = fl.smooth_step(1.0, 0.5).angle(time)
    bend = np.where(
        time > 0.5, size * np.exp(-rate * (time - 0.5)) * np.sin(w * (time - 0.5)), 0.0
    )
    settled, ringing = _judged(angle, RIG.model.stiffness * bend, 1.0, 0.5, design)  # type: ignore[arg-type]
    # A mean over a quarter of a vibration keeps 2√2/π of it; below 2 % of the move it
    # is settled.
    seen = size * 2 * math.sqrt(2) / math.pi
    assert settled == pytest.approx(0.5 + math.log(seen / 0.02) / rate, abs=0.4)
    first, second = (seen * math.exp(-rate * (k + 0.5) * math.pi / w) for k in (0, 1))
    assert ringing == pytest.approx(0.5 * (first + second), rel=0.25)
    still, none = _judged(angle, np.zeros(time.size), 1.0, 0.5, design)  # type: ignore[arg-type]
    assert none < 0.01 and 0.3 < still < 0.6


def test_a_move_says_how_far_in_what_time_and_with_what() -> None:
    move = FirstMove(math.radians(20), 0.5, 0.61, 0.7234, 0, 0, 0, 0, 0, 0, 0, 0.03)
    assert str(move) == "20° in 0.5 s with 30 g: promised 0.61 s, measured 0.72 s"
    assert " with " not in str(replace(move, payload=0.0))


# --- the link --------------------------------------------------------------------------------------------


def test_a_second_modes_torque_is_that_of_a_resonator() -> None:
    """c₂ s²/(s² + 2ζω s + ω²) on a sine: gain and phase of the response."""
    mode = fl.SecondMode(frequency=60.0, damping_ratio=0.02, gain=0.3)
    time = 0.001 * np.arange(8000)
    log = fl.Experiment(
        period=0.001, motor_angle=np.sin(40.0 * time), output=np.zeros(8000)
    )
    torque = _torque_of(mode, replace(RIG.model, gauge_delay=0.0), log)
    z = 40j
    h = 0.3 * RIG.model.stiffness * z**2 / (z**2 + 2 * 0.02 * 60.0 * z + 60.0**2)
    expected = np.imag(h * np.exp(z * time))
    np.testing.assert_allclose(torque[-1000:], expected[-1000:], atol=0.01 * abs(h))


def test_free_ringing_is_taken_out_whole() -> None:
    pole = RIG.model.pole
    time = 0.004 * np.arange(600)
    fit = SimpleNamespace(period=0.004, model=RIG.model, predicted=np.cos(3 * time))
    rings = 0.2 * np.exp(pole.real * time) * np.cos(pole.imag * time + 0.4)
    found = _ringing(fit, np.cos(3 * time) + rings)  # type: ignore[arg-type]
    assert np.abs(found - rings).max() < 0.15 * 0.2
    assert np.abs(_ringing(fit, np.cos(3 * time))).max() < 1e-12  # type: ignore[arg-type]


def test_the_shortfall_is_the_worst_error_over_what_suffices() -> None:
    fit = SimpleNamespace(
        model=replace(RIG.model, natural_frequency=10.0),
        gain=-2.0,
        standard_errors={
            "order": 0.0,
            "delay": 0.0,
            "natural_frequency": 0.5,
            "gain": 0.0,
        },
    )
    only = shortfall(fit)  # type: ignore[arg-type]
    fit.standard_errors = {"natural_frequency": 1.0}
    assert shortfall(fit) == pytest.approx(2.0 * only)  # type: ignore[arg-type]
    fit.model = replace(fit.model, natural_frequency=20.0)
    assert shortfall(fit) == pytest.approx(only)  # type: ignore[arg-type]
    fit.standard_errors = {}
    assert shortfall(fit) == math.inf  # type: ignore[arg-type]


@pytest.mark.slow
def test_the_links_mass_gives_the_second_mode_that_was_measured() -> None:
    model = replace(RIG.model, order=1.95, payload=0.03)
    made = SimpleNamespace(model=model, rig=RIG, payloads=(0.02, 0.04))
    true = _with_link(made, 0.25)  # type: ignore[arg-type]
    assert true.beam.link_mass == pytest.approx(0.25 * 0.03)
    bare = true.beam.modes(2).frequencies[1]
    missing = 2.0 - model.order
    seen = bare
    for _ in range(60):  # ω √(Re (jω)^(2 − λ)) = the frequency that is seen
        seen = bare * math.sqrt(seen**missing * math.cos(0.5 * math.pi * missing))
    assert _mass_ratio(made, seen) == pytest.approx(0.25, rel=1e-3)  # type: ignore[arg-type]
    light, heavy = link_twins(made)[:2]  # type: ignore[arg-type]
    assert light.beam.link_mass <= heavy.beam.link_mass
    # The first mode is the measured one, whatever the link weighs.
    for ratio in (0.05, 0.25, 0.5):
        arm = _with_link(made, ratio)  # type: ignore[arg-type]
        first = arm.beam.modes(1).frequencies[0]
        assert first == pytest.approx(true.beam.modes(1).frequencies[0], rel=0.02)


@pytest.mark.slow
def test_a_delay_below_zero_is_none() -> None:
    assert late_free(replace(RIG.model, gauge_delay=-0.002)).gauge_delay == 0.0
    assert late_free(replace(RIG.model, gauge_delay=0.002)).gauge_delay == 0.002
    assert _about(2.0, 0.1) == pytest.approx((1.8, 2.2))
