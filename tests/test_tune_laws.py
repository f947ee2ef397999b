"""From the measurements of a tuning to a law, and its first moves."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from typing import Any

import pytest

import fraclink as fl
from fraclink.lab._tune_build import (
    built_laws,
    measured_rig,
    planned_move,
    twins_of,
)
from tuned_arms import LIMITS, PERIOD, RIG, Stages, staged

if sys.platform != "linux":
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)


@pytest.fixture(scope="module")
def stages() -> Stages:
    return staged()


# --- from the measurements to a law ----------------------------------------------------------------------


def rig_of(stages: Stages, **changes: Any) -> fl.Rig:
    _, _, wiring, _, link = stages
    given: dict[str, Any] = {"centre": 0.2, "rest_torque": 0.3, "stated": None}
    given |= {"name": "mine", **changes}
    wiring = given.pop("wiring", wiring)
    return measured_rig(wiring, link, LIMITS, (0.02, 0.04), 0.030, PERIOD, **given)


@pytest.mark.slow
def test_a_motor_whose_load_does_not_show_is_refused_with_a_remedy(
    stages: Stages,
) -> None:
    session, guard, wiring, motor, link = stages
    motor = replace(link.motor, fit=replace(link.motor.fit, inertia=None))
    with pytest.raises(fl.errors.FraclinkError, match="shorter period"):
        rig_of((session, guard, wiring, motor, replace(link, motor=motor)))


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


# --- a link whose second mode no record shows --------------------------------------------------------------


@pytest.mark.slow
def test_a_mode_that_was_not_seen_is_left_room(stages: Stages) -> None:
    *_, link = stages
    model = fl.LinkModel(
        stiffness=1.195,
        natural_frequency=4.7345,
        order=1.976,
        payload=0.060,
        unseen_up_to=85.6,
    )
    long_link = replace(link, fit=replace(link.fit, model=model))
    rig = rig_of(stages)
    rig = replace(
        rig,
        motor=replace(
            rig.motor,
            inertia=0.0524,
            viscous_friction=0.642,
            torque_constant=0.422,
            coulomb_torque=0.093,
        ),
        link=replace(rig.link, length=0.9426, flexural_rigidity=0.37547, mass=0.0),
        payloads=replace(rig.payloads, low=0.045, high=0.080, nominal=0.060),
        encoder=replace(rig.encoder, counts_per_revolution=16384),
        gauge=replace(rig.gauge, noise=0.0037),
        motor_loop=replace(rig.motor_loop, pole=60.0),
    )
    limits = replace(LIMITS, speed=3.0, torque=1.2)
    made = next(built_laws(rig, long_link, limits))
    assert made.passed, made.reasons
    # the beam whose mode lies where the record ends
    beam = fl.extend.Beam.from_rig(made.rig, payload=0.060)
    assert beam.modes(2).frequencies[1] == pytest.approx(85.6, rel=0.02)
    assert any("second mode" in words for words in made.rig.assumptions)
    for mass in (0.0, made.rig.link.mass):
        arm = fl.Twin.from_rig(
            replace(made.rig, link=replace(made.rig.link, mass=mass)), model=model
        )
        run = fl.simulate(
            made.law, fl.smooth_step(0.3, 1.0), arm=arm, payload=0.060, told=True
        )
        assert run.verdict.passed, run.verdict.reason


@pytest.mark.slow
@pytest.mark.parametrize("spoilt", ["the link as measured", "a heavier link"])
def test_a_move_that_only_an_unseen_mode_spoils_names_it(
    stages: Stages, monkeypatch: pytest.MonkeyPatch, spoilt: str
) -> None:
    rig = replace(RIG, link=replace(RIG.link, mass=0.0))
    made = fl.design(rig.model, rig, payloads=(0.02, 0.04), gain_crossover=11.0)
    light, heavy = twins_of(made, stages[-1].motor)
    bad = light if spoilt == "the link as measured" else heavy

    def simulated(law: Any, move: Any, *, arm: fl.Twin, **given: Any) -> fl.Run:
        late = 0.1 if arm.beam == bad.beam else arm.gauge_delay
        return fl.simulate(law, move, arm=replace(arm, gauge_delay=late), **given)

    monkeypatch.setattr("fraclink.lab._tune_build.simulate", simulated)
    move, reason = planned_move(made, made.law(), LIMITS, stages[-1].motor)
    assert move is None
    assert ("second mode would not have shown" in reason) is (bad is heavy)


# --- the first moves -------------------------------------------------------------------------------------
