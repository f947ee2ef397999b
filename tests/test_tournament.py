"""The table of a tournament: who wins which figure and by how much, in words; what each
rival costs.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink._law import Modes
from fraclink._simulate import Twin, geared
from fraclink.errors import NotConvergedError
from fraclink.trials import _tournament as module
from fraclink.trials._rival_runs import (
    _plant,
    linear_growth,
    mode_gain,
    run_rival,
)
from fraclink.trials._rivals import (
    FRACLINK,
    Rival,
    collocated,
    servo_law,
)
from fraclink.trials._setting import (
    Filter,
    NominalLoop,
    Setting,
    prepare,
    tune,
)
from fraclink.trials._tournament import Standing, Tournament

RIG = geared(fl.Rig.named("paper-2023"))
PERIOD = 0.004


def standing(name: str = FRACLINK, **own: Any) -> Standing:
    made = Standing(
        name,
        "a rule",
        "k 1",
        True,
        "settled in 1 s",
        1.0,
        0.02,
        0.004,
        0.003,
        0.002,
        0.0,
        0.04,
        1.5,
        0.25,
        0.0,
        1.6,
        5,
        12,
    )
    return replace(made, **own)


def tournament(
    *standings: Standing, notes: tuple[str, ...] = ("a note",)
) -> Tournament:
    return Tournament(standings, notes, {})


@pytest.fixture(scope="module")
def setting() -> Setting:
    return prepare(
        RIG, None, 0.0, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=None
    )[0]


# ── who wins
# ────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    ("figure", "floor"),
    [
        ("settling_time", 0.01), ("overshoot", 0.001), ("residual_vibration", 1e-4), ("offset_error", 1e-4),
        ("motor_reference_noise", 1e-4), ("saturated", 0.001), ("worst_settling", 0.01), ("mode_gain", 1e-3),
        ("states", 0.0), ("multiplications", 0.0),
    ],
)  # fmt: skip
def test_equal_is_who_differs_by_two_percent_and_a_floor(
    figure: str, floor: float
) -> None:
    best = 100 if floor == 0.0 else 0.5
    edge = best * 1.02 + floor
    rivals = [
        standing(f"r{k}", **{figure: value})
        for k, value in enumerate((best, edge * 0.9999, edge * 1.0001))
    ]
    assert tournament(*rivals).winners()[figure] == ("r0", "r1")


def test_only_the_sound_win_and_all_share_what_none_reaches() -> None:
    quick, growing, failed = (
        standing("a", settling_time=2.0),
        standing("b", growth=0.1),
        standing("c", passed=False),
    )
    assert quick.sound and not growing.sound and not failed.sound
    found = tournament(quick, growing, failed).winners()
    assert list(found) == list(module._FIGURES) and set(found.values()) == {("a",)}
    endless = tournament(
        standing("a", settling_time=math.inf), standing("b", settling_time=math.inf)
    )
    assert endless.winners()["settling_time"] == ("a", "b")
    assert tournament(growing, failed).winners() == {}


def test_a_rival_is_run_with_a_jump_of_the_gauges_offset(setting: Setting) -> None:
    """Without feedback of the gauge the run is the same; the reading is not, from 0.2 s
    on.
    """
    bare = replace(
        servo_law(setting.law), correction=Modes(0.0), feedforward=Modes(0.0)
    )
    assert bare.drive is not None
    bare = replace(bare, drive=replace(bare.drive, torque_voltage=0.0))
    twin = Twin.from_rig(RIG, link_mass=0.0)
    rival = Rival("bare", "", "", 1.0, 0, 0, bare)
    move = fl.smooth_step(0.2, 0.3)
    plain, jumped = (
        run_rival(twin, rival, move, setting.law, duration=0.6, offset=offset, seed=3)
        for offset in (0.0, 0.25)
    )
    difference = jumped.torque_measured - plain.torque_measured
    assert np.all(difference[:50] == 0.0) and difference[50:] == pytest.approx(
        0.25, abs=2e-3
    )
    assert (
        plain.about["rival"] == "bare"
        and plain.about["seed"] == 3
        and len(plain.time) == 151
    )
    assert plain.reference == pytest.approx(move.angle(plain.time))
    shaped = Rival("ZV", "", "", 1.0, 0, 0, bare, impulses=((0.0, 0.25), (0.5, 0.5)))
    run = run_rival(twin, shaped, move, setting.law, duration=0.6)
    assert run.reference == pytest.approx(
        move.angle(run.time)
    )  # judged by what was asked
    assert (
        np.abs(run.motor_reference[:25] - 0.5 * plain.motor_reference[:25]).max() < 1e-3
    )


# ── what a rival is
# ─────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.slow
def test_the_collocated_pd_places_the_hubs_double_pole(setting: Setting) -> None:
    """Without the link: J s² + (ν + K k_d) s + K k_p has the double pole −p; the motor
    is behind its gear.
    """
    rival = collocated(setting, servo_law(setting.law))
    assert rival.law.drive is not None
    pd = rival.law.drive.loop
    pole = float(rival.knob.split()[2])
    motor = setting.rig.motor
    derivative = 2 * pole - motor.decay
    assert motor.gain * pd.direct == pytest.approx(pole**2, rel=1e-3)
    assert motor.gain * pd.angle_direct / 300.0 == pytest.approx(derivative, rel=1e-3)
    assert pd.angle_filter_gain == pytest.approx(-300.0 * pd.angle_direct)
    half = 0.5 * PERIOD
    assert pd.filter_now == pd.filter_before == pytest.approx(half / (1 + 300 * half))
    assert (
        pd.filter_decay == pytest.approx((1 - 300 * half) / (1 + 300 * half))
        and pd.integral_gain == 0.0
    )
    assert (rival.states, rival.multiplications) == (
        1,
        4,
    ) and rival.law.drive.torque_voltage == 0.0
    assert rival.peak == pytest.approx(setting.target, rel=1e-3)


# ── the loop that they are tuned on
# ─────────────────────────────────────────────────────────────────────────


def scalar(pole: float, gain: float) -> NominalLoop:
    """A plant with one pole, gain/(z − pole), as a loop to be tuned on."""
    return NominalLoop(
        Filter(np.array([[pole]]), np.ones(1), np.array([gain]), 0.0), PERIOD, 1.0
    )


def constant(k: float) -> Filter:
    return Filter(np.zeros((0, 0)), np.zeros(0), np.zeros(0), k)


def test_radius_and_peak_of_a_loop_with_one_pole() -> None:
    """1 + k/(z − a): the pole is a − k, and |S| is largest at one end of the band."""
    loop = scalar(0.5, 1.0)
    assert loop.radius(constant(0.3)) == pytest.approx(0.2)
    z = -np.exp(
        -1j * 0.001 * math.pi
    )  # the last frequency looked at, a thousandth below Nyquist
    assert loop.peak(constant(1.2)) == pytest.approx(
        abs(1 / (1 + 1.2 / (z - 0.5))), rel=1e-9
    )
    assert (
        loop.peak(constant(1.6)) == math.inf and loop.peak(constant(1.4999)) < math.inf
    )
    assert loop.frequencies[[0, -1]] == pytest.approx([0.1, 0.999 * math.pi / PERIOD])
    ratio = loop.frequencies[1:] / loop.frequencies[:-1]
    assert ratio.max() == pytest.approx(1.02, abs=0.001)


def test_a_knob_is_turned_up_to_the_target_and_not_past_a_worse_range() -> None:
    seen: list[float] = []

    def loop(shape: Any) -> Any:
        return SimpleNamespace(peak=lambda made: (seen.append(made), shape(made))[1])  # type: ignore[func-returns-value]

    value, made, reached = tune(loop(lambda k: 1.0 + k), lambda k: k, (0.1, 10.0), 3.0)  # type: ignore[arg-type,return-value]
    assert reached and value == made == pytest.approx(2.0, rel=1e-5)
    value, _, reached = tune(loop(lambda k: 1.0), lambda k: k, (0.1, 10.0), 3.0)  # type: ignore[arg-type,return-value]
    assert reached and value == pytest.approx(10.0)  # good to the end: the end
    seen.clear()
    valley = loop(lambda k: 2.0 if 0.5 < k < 1.0 or k > 5.0 else math.inf)
    value, _, reached = tune(valley, lambda k: k, (0.1, 10.0), 3.0)  # type: ignore[arg-type,return-value]
    assert reached and value == pytest.approx(1.0, rel=1e-4) and max(seen) < 1.2
    value, _, reached = tune(
        loop(lambda k: 4.0 + math.log(k / 2.0) ** 2),
        lambda k: k,  # type: ignore[return-value]
        (0.1, 10.0),
        3.0,
    )
    assert not reached and value == pytest.approx(2.0, rel=1e-4)
    with pytest.raises(NotConvergedError, match="tuning"):
        tune(loop(lambda k: math.inf), lambda k: k, (0.1, 10.0), 3.0)  # type: ignore[arg-type,return-value]


def test_growth_is_the_logarithm_of_the_radius_in_a_second(setting: Setting) -> None:
    twin = Twin.from_rig(RIG, link_mass=0.0, payload=0.030)
    strong = Filter(np.zeros((0, 0)), np.zeros(0), np.zeros(0), 30.0)
    rival = Rival(
        "wild",
        "",
        "",
        1.0,
        0,
        0,
        setting.law,
        correction=strong,
    )
    _, seen = _plant(setting, twin)
    closed = seen.a - 30.0 * np.outer(seen.b, seen.c)
    radius = np.abs(np.linalg.eigvals(closed)).max()
    assert radius > 1 and linear_growth(setting, twin, rival) == pytest.approx(
        math.log(radius) / PERIOD
    )


@pytest.mark.slow
def test_the_gain_at_the_second_mode_is_the_largest_around_it(setting: Setting) -> None:
    twin = Twin.from_rig(RIG, link_mass=0.00735, payload=0.030)
    plant, seen = _plant(setting, twin)
    mode = float(plant.modes.frequencies[1])
    w = np.linspace(0.8 * mode, 1.25 * mode ** (2 / 1.92), 20_000)
    largest = np.abs(seen.response(np.exp(1j * w * PERIOD))).max()
    for gain in (1.0, 0.25):
        rival = Rival("flat", "", "", 1.0, 0, 0, setting.law, correction=constant(gain))
        assert mode_gain(setting, twin, rival) == pytest.approx(
            gain * largest, rel=2e-3
        )
