"""The table of a tournament: who wins which figure and by how much, in words; what each
rival costs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fraclink as fl
from fraclink import Twin
from fraclink._law import Modes
from fraclink.extend import geared
from fraclink.trials import Rival, Standing, Tournament
from fraclink.trials._rival_runs import (
    run_rival,
)
from fraclink.trials._rivals import collocated, servo_law
from fraclink.trials._setting import (
    Setting,
    prepare,
)

RIG = geared(fl.Rig.named("paper-2023"))
PERIOD = 0.004


def tournament(
    *standings: Standing, notes: tuple[str, ...] = ("a note",)
) -> Tournament:
    return Tournament(standings, notes, {})


@pytest.fixture(scope="module")
def setting() -> Setting:
    return prepare(
        RIG, None, 0.0, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=None
    )[0]


# ────────────────────────────────────────────────────────────────────────────────────────────────


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
