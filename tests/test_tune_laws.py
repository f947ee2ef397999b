"""From the measurements of a tuning to a law, and its first moves."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from typing import Any

import pytest

import fraclink as fl
from fraclink.lab._tune_build import measured_rig
from tuned_arms import LIMITS, PERIOD, RIG, Stages, staged

if sys.platform != "linux":
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)


@pytest.fixture(scope="module")
def stages() -> Stages:
    return staged()


# --- from the measurements to a law ----------------------------------------------------------------------


def rig_of(stages: Stages, **changes: Any) -> fl.Rig:
    _, _, wiring, _, link = stages
    given = {"centre": 0.0, "stated": None, "name": "mine"} | changes
    wiring = given.pop("wiring", wiring)
    return measured_rig(wiring, link, LIMITS, (0.02, 0.04), 0.030, PERIOD, **given)


@pytest.mark.slow
def test_the_rig_is_what_was_measured(stages: Stages) -> None:
    _, _, wiring, _, link = stages
    rig = rig_of(stages)
    model, fit = link.fit.model, link.motor.fit
    # ω₀² = c/(mL²), c = 3EI/L: equations (5) and (4), where m includes the share of the
    # link
    mass = 0.030 + rig.link.tip_mass
    assert model.natural_frequency**2 == pytest.approx(
        rig.link.stiffness / (mass * rig.link.length**2)
    )
    assert (
        rig.link.stiffness
        == pytest.approx(3 * rig.link.flexural_rigidity / rig.link.length)
        == model.stiffness
    )
    assert rig.motor.gain == pytest.approx(
        fit.gain
    ) and rig.motor.decay == pytest.approx(fit.decay)
    assert rig.motor.inertia == fit.inertia and rig.motor.voltage_limit == 10.0
    friction = (fit.coulomb_voltage + fit.dead_zone) * fit.gain * fit.inertia
    # A law that compensates more friction than there is anywhere would drive the motor.
    assert 0.7 * friction < rig.motor.coulomb_torque < 0.9 * friction
    assert (rig.payloads.low, rig.payloads.high, rig.payloads.nominal) == (
        0.02,
        0.04,
        0.03,
    )
    assert (rig.period, rig.gauge.noise, rig.name) == (
        PERIOD,
        wiring.gauge_noise,
        "mine",
    )
    assert rig.motor_loop == link.motor.loop
    assert rig.encoder.counts_per_revolution == round(2 * math.pi / wiring.encoder_step)
    for step, counts in ((0.0, None), (0.02, 314), (1e-3, 6283)):
        made = rig_of(stages, wiring=replace(wiring, encoder_step=step))
        assert made.encoder.counts_per_revolution == counts
    stated = replace(RIG, name="theirs", gauge=replace(RIG.gauge, noise=9.0))
    known = rig_of(stages, stated=stated)
    assert (
        known.name == "theirs"
        and known.design == RIG.design
        and known.gauge.noise == wiring.gauge_noise
    )
    assert known.motor == rig.motor and known.link == rig.link


@pytest.mark.slow
@pytest.mark.parametrize("decay", [0.0, 20.0, 200.0])
def test_the_moves_of_a_law_are_those_that_the_motor_can_make(
    stages: Stages, decay: float
) -> None:
    *rest, link = stages
    fit = replace(link.motor.fit, decay=decay)
    changed = replace(link, motor=replace(link.motor, fit=fit))
    rig = rig_of((*rest, changed))
    moves = rig.moves
    assert moves.velocity <= LIMITS.speed
    assert (moves.velocity == LIMITS.speed) is (decay < 200.0)
    # full speed and full acceleration at once, against friction
    voltage = (moves.acceleration + decay * moves.velocity) / rig.motor.gain
    assert voltage + fit.coulomb_voltage <= LIMITS.voltage


# --- the first moves -------------------------------------------------------------------------------------
