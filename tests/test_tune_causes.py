"""What a record shows against a law: each cause is named if it is present, and only
then.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink.lab import Wiring
from fraclink.lab._tune_causes import causes, unexplained
from fraclink.lab._tune_guard import Record
from fraclink.lab._tune_motor import breakaway_voltage, closed_motor

PERIOD, NOISE = 0.004, 0.004
WIRING = Wiring(11.0, 0.0015, 1.7, 12.0, 0.002, NOISE, 0.0, 3.8e-4, ())


def record(torque: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Record:
    still = np.zeros(torque.size)
    return Record(PERIOD, still, still, torque)


def vibration(quantum: float = 0.0) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """The reading of a gauge on a link that vibrates by ±0.5 N·m, with noise, in steps
    of `quantum`.
    """
    time = PERIOD * np.arange(5000)
    noise = NOISE * np.random.default_rng(1).standard_normal(time.size)
    torque = 0.5 * np.exp(-0.05 * time) * np.sin(12.0 * time) + noise
    return np.round(torque / quantum) * quantum if quantum else torque


def motor(delay: float, wiring: Wiring = WIRING) -> Any:
    """A motor with K/J = 11 and ν/J = 15, identified with a delay [s], and its loop."""
    rng = np.random.default_rng(0)
    voltage = np.repeat(rng.choice([-4.0, 4.0], 120), 25)
    speed, angle, angles = 0.0, 0.0, []
    late = max(round(delay / PERIOD), 0)
    sent = np.concatenate([np.zeros(late), voltage])[: voltage.size]
    for value in sent:
        angles.append(angle)
        for _ in range(8):
            speed += PERIOD / 8 * (11.0 * value - 15.0 * speed)
            angle += PERIOD / 8 * speed
    found = fl.identify_motor(
        voltage,
        np.array(angles),
        period=PERIOD,
        torque=0.01 * rng.standard_normal(voltage.size),
    )
    limits = fl.MotionLimits(angle=0.7, speed=4.0, torque=1.5, voltage=10.0)
    guard: Any = SimpleNamespace(period=PERIOD, limits=limits)
    return closed_motor(found, guard, wiring)


def said(
    torque: np.ndarray[tuple[int], np.dtype[np.float64]], **changes: object
) -> str:
    given = {"wiring": WIRING, "motor": None, "link": None, "voltage": 10.0} | changes
    return "; ".join(causes(record(torque), **given))  # type: ignore[arg-type]


def fit(model: fl.LinkModel | None, left: float = NOISE) -> Any:
    return SimpleNamespace(model=model, passed=True, mse=left**2)


@pytest.mark.parametrize("quantum", [0.0, 0.001, 0.01])
def test_a_gauge_that_does_not_clip_is_not_said_to(quantum: float) -> None:
    assert said(vibration(quantum)) == ""


@pytest.mark.parametrize("rail", [(-0.3, 0.3), (-9.0, 0.25), (-0.25, 9.0)])
def test_a_gauge_at_its_rail_clips(rail: tuple[float, float]) -> None:
    assert "clips" in said(np.clip(vibration(), *rail))


def test_a_late_gauge_is_named_with_its_phase() -> None:
    link = fl.Rig.named("paper-2023").model
    assert link is not None
    prompt, late = (replace(link, gauge_delay=delay) for delay in (0.005, 0.030))
    assert said(vibration(), link=fit(prompt)) == ""
    assert "30 ms late" in said(vibration(), link=fit(late))


@pytest.mark.parametrize("quantum", [0.0, 0.01])
@pytest.mark.parametrize("damping", [0.02, 2.0])
def test_a_bend_that_no_linear_link_explains_is_named(
    quantum: float, damping: float
) -> None:
    link = fl.LinkModel(1.5, 12.0, 2.0, damping=damping)
    wiring = replace(WIRING, encoder_step=0.004)
    moved = record(vibration(quantum))
    # What the encoder's rounding does to the torque, by playing it.
    rng = np.random.default_rng(4)
    rounding = (rng.random((20, moved.torque.size)) - 0.5) * wiring.encoder_step
    played = [
        fl.extend.simulated_torque(link, angle, PERIOD, hold="first")
        for angle in rounding
    ]
    noise = float(np.sqrt(NOISE**2 + quantum**2 / 12.0 + np.mean(np.square(played))))
    # 8 mrad, as a torque: 12 mN·m.
    for left, named in ((0.0, False), (0.009, False), (0.015, True)):
        words = unexplained(
            np.full(9, np.hypot(noise, left)), link, moved, wiring, 0.008
        )
        assert bool(words) is named, (left, words)
    silent = replace(wiring, gauge_noise=0.0)
    assert not unexplained(np.full(9, 0.05), link, moved, silent, 0.008)


def test_hum_before_the_first_voltage_is_not_the_links() -> None:
    link, time = fl.LinkModel(1.5, 12.0, 2.0, damping=0.2), PERIOD * np.arange(5000)
    hum = 0.05 * np.sin(2 * np.pi * 50.0 * time)
    voltage = np.where(time > 1.0, 1.0, 0.0)
    moved = replace(record(vibration() + hum), voltage=voltage)
    quiet = replace(moved, torque=np.where(time > 1.0, moved.torque, hum))
    assert not unexplained(np.full(9, 0.036), link, quiet, WIRING, 0.008)
    assert unexplained(np.full(9, 0.036), link, record(vibration()), WIRING, 0.008)


@pytest.mark.slow
def test_what_slows_the_motor_loop_is_named() -> None:
    assert said(vibration(), motor=motor(0.0)) == ""
    coarse = 2 * np.pi / 500
    # A noisy encoder shakes the motor as much as a coarse one does.
    for changes in ({"encoder_step": coarse}, {"encoder_noise": coarse / 12**0.5}):
        wiring = replace(WIRING, **changes)
        named = said(vibration(), motor=motor(0.0, wiring), wiring=wiring)
        assert "encoder is coarse" in named and "late" not in named
    assert "the voltage acts" in said(vibration(), motor=motor(4 * PERIOD))


@pytest.mark.parametrize(
    ("gain", "slides", "breaks", "jump"),
    [(11.0, 0.5, 0.9, 0.0), (11.0, 0.45, 0.55, 3.0), (67.0, 0.17, 0.2, 1.2)],
)
def test_the_voltage_that_a_motor_at_rest_withstands_is_measured(
    gain: float, slides: float, breaks: float, jump: float
) -> None:
    """Under a voltage that rises and falls: with noise beyond the one that breaks away,
    or nearly to it and then with a jump back and forth, which moves the motor a few
    periods later.
    """
    rng, step = np.random.default_rng(3), PERIOD / 8
    time = PERIOD * np.arange(3000)
    wave = np.sin(3.0 * time)
    if jump:
        crests = np.flatnonzero((wave[1:-1] > wave[:-2]) & (wave[1:-1] > wave[2:]))
        voltage = 0.95 * breaks * wave
        for k in crests:
            voltage[k : k + 6] = np.repeat([jump, -jump], 3)
    else:
        voltage = breaks * (1.33 * wave + 0.1 * rng.standard_normal(time.size))
    speed, angle, angles = 0.0, 0.0, []
    for value in voltage:
        angles.append(angle)
        for _ in range(8):
            driven = speed + step * (gain * value - 15.0 * speed)
            held = gain * step * (breaks if speed == 0.0 else slides)
            if abs(driven) <= held or driven * speed < 0.0:
                speed = 0.0
            else:
                speed = driven - np.sign(driven) * gain * step * slides
            angle += step * speed
    found = motor(0.0)
    fit = replace(
        found.fit, gain=gain, coulomb_voltage=slides, dead_zone=0.0, inertia=0.02
    )
    count = 2.0 * np.pi / 16384.0
    reading = count * np.floor(np.array(angles) / count)
    record = Record(PERIOD, voltage, reading, np.zeros(time.size))
    shown = breakaway_voltage(record, replace(found, fit=fit), count, 0.0)
    assert shown == pytest.approx(breaks, rel=0.1)


@pytest.mark.slow
def test_what_holds_a_motor_that_hunts_is_named() -> None:
    found = motor(0.0)
    for friction, zone, named in (
        (0.5, 0.1, "the motor sticks"),
        (0.3, 0.8, "the amplifier has a dead zone"),
    ):
        fit = replace(found.fit, coulomb_voltage=friction, dead_zone=zone)
        given = {"motor": replace(found, fit=fit)}
        assert named in said(vibration(), hunts=True, **given)
        assert said(vibration(), **given) == ""


def test_a_second_mode_with_hardly_any_damping_is_seen() -> None:
    model = fl.LinkModel(1.5, 10.0, 1.98)
    mode = fl.LinkModel(1.5, 90.0, 2.0, damping=2.0 * 2e-4 * 90.0)
    steps = np.random.default_rng(1).choice([-0.1, 0.1], 75)
    angle = np.convolve(np.repeat(steps, 20), np.full(10, 0.1), "same")
    noise = 0.01 * np.random.default_rng(2).standard_normal(angle.size)
    torque = noise + fl.extend.simulated_torque(model, angle, PERIOD)
    torque += fl.extend.simulated_torque(mode, angle, PERIOD)
    log = fl.Experiment(period=PERIOD, motor_angle=angle, output=torque)
    seen = fl.identify(log, "UD-FOM", heldout=0.0).model.second_mode
    assert seen is not None
    assert seen.frequency == pytest.approx(90.0, rel=0.01)
