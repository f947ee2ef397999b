"""Faults of the sensors and of the control task, injected between the twin and the
shipped law.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

import fraclink as fl
from fraclink import Twin, smooth_step
from fraclink.errors import FieldError
from fraclink.extend import SensorFault, equip, geared
from law_bench import documented_design

RIG = geared(fl.Rig.named("paper-2023"))
MOVE = smooth_step(1.0, duration=1.0)
AT = 0.5
ROW = round(AT / RIG.period)


@pytest.fixture(scope="module")
def law():
    design = documented_design(RIG)
    return equip(fl.discretize(design.controller, RIG.period), RIG, RIG.model)


@pytest.fixture(scope="module")
def clean(law):
    return fl.simulate(
        law, MOVE, arm=Twin.from_rig(RIG, link_mass=0.00735), duration=4.0
    )


def _run(law, kind, until=AT + RIG.period, value=None):
    fault = SensorFault(AT, until, kind, value)
    return fl.simulate(
        law,
        MOVE,
        arm=Twin.from_rig(RIG, link_mass=0.00735),
        duration=4.0,
        events=[fault],
    )


@pytest.mark.slow
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 4.1])
def test_one_bad_gauge_sample_is_ridden_through(law, clean, value):
    run = _run(law, "gauge value", value=value)
    assert run.flags[ROW] & 2  # gauge sample rejected, in this period
    assert set(run.mode.tolist()) == {1}
    assert np.abs(run.error).max() <= 1.1 * np.abs(clean.error).max()


@pytest.mark.slow
def test_one_nan_encoder_sample_is_ridden_through(law, clean):
    run = _run(law, "encoder value", value=math.nan)
    assert run.flags[ROW] & 1 and set(run.mode.tolist()) == {1}
    assert np.abs(run.error).max() <= 1.1 * np.abs(clean.error).max()


@pytest.mark.slow
def test_frozen_encoder_in_motion_switches_off(law):
    run = _run(law, "encoder frozen", until=AT + 0.5)
    off = np.flatnonzero(run.mode == 4)
    # the motor deviates from its model, or the samples do not change
    assert off.size and off[0] - ROW <= 60
    assert np.all(
        run.motor_angle_measured[ROW : off[0]] == run.motor_angle_measured[ROW]
    )
    assert np.all(run.voltage[off[0] + 2 :] == 0.0)


@pytest.mark.slow
def test_gauge_lost_for_good_degrades_and_arrives(law):
    run = _run(law, "gauge value", until=10.0, value=math.nan)
    assert run.mode.max() == 2 and abs(run.error[-1]) < 0.02


@pytest.mark.slow
def test_gains_and_offsets_reach_the_reading(law):
    run = _run(law, "gauge gain", until=10.0, value=1.1)
    late = run.time > AT
    apart = run.torque_measured[late] - 1.1 * run.torque[late]
    assert np.std(apart) == pytest.approx(RIG.gauge.noise, rel=0.1)
    run = _run(law, "gauge offset", until=10.0, value=0.05)
    assert np.mean(run.torque_measured[late] - run.torque[late]) == pytest.approx(
        0.05, abs=2e-3
    )
    run = _run(law, "encoder gain", until=10.0, value=57.3)
    assert run.mode[-1] == 4  # degrees instead of radians: switched off


@pytest.mark.slow
def test_swapped_channels(law):
    run = _run(law, "channels swapped", until=10.0)
    assert run.motor_angle_measured[ROW] != pytest.approx(
        run.motor_angle[ROW], abs=0.01
    )
    assert run.mode[-1] == 4


@pytest.mark.slow
def test_missed_and_repeated_ticks(law, clean):
    missed = _run(law, "tick missed", until=AT + 5 * RIG.period)
    assert np.all(missed.flags[ROW : ROW + 5] == 0)
    assert missed.flags[ROW + 5] & 8  # periods were missed
    held = missed.voltage[ROW + 1 : ROW + 6]
    assert np.all(held == held[0])  # the timer keeps the last voltage
    assert np.abs(missed.error).max() < 0.1 and missed.mode[-1] == 1
    twice = _run(law, "tick repeated", until=AT + 5 * RIG.period)
    assert np.all(
        twice.flags[ROW : ROW + 5] & 16
    )  # the second call of a period does nothing
    assert np.abs(twice.error).max() <= 1.1 * np.abs(clean.error).max()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ((0.5, 0.4, "encoder frozen"), "until"),
        ((-1.0, 0.4, "encoder frozen"), "time"),
        ((0.5, 0.6, "encoder gone"), "kind"),
        ((0.5, 0.6, "gauge value"), "value"),
        ((0.5, 0.6, "gauge frozen", 1.0), "value"),
    ],
)
def test_bad_faults(arguments, field):
    with pytest.raises(FieldError) as caught:
        SensorFault(*arguments)
    assert caught.value.field == field
