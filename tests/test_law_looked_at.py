"""Requirements, the feed-forward of a payload, and a refit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fraclink as fl
from fraclink import LinkModel, MotorLoop, Requirement
from fraclink._law.refit import refitted
from fraclink._law.tracking import following
from fraclink.errors import FieldError
from fraclink.extend import equip

RIG = fl.Rig.named("paper-2023")
MODEL = RIG.model
assert MODEL is not None


@pytest.fixture(scope="module")
def design() -> fl.Design:
    asked = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "law": False}
    return fl.design(MODEL, RIG, payloads=(0.02, 0.04), **asked)


# --- requirements -------------------------------------------------------------------------------------------


def test_a_requirement_says_what_was_wanted_and_where() -> None:
    angle = Requirement("phase margin", fl.deg(50), fl.deg(45), "rad", 0.02, "at least")
    assert str(angle) == "phase margin: 45.0° at 20 g, required ≥ 50.0°: failed"
    assert angle.slack == pytest.approx(fl.deg(-5)) and not angle.passed
    noise = Requirement("noise gain", 1.5, 1.25, "", 0.0305, "at most")
    assert str(noise) == "noise gain: 1.25 at 30.5 g, required ≤ 1.5: passed"
    assert noise.slack == 0.25
    time = Requirement("settling time", 0.5, 0.75, "s", 0.04, "at most")
    assert str(time) == "settling time: 0.75 s at 40 g, required ≤ 0.5 s: failed"
    # equality counts as met, up to rounding; above one the rounding is relative
    assert Requirement("x", 1.0, 1.0 - 0.9e-9, "", 0.0, "at least").passed
    assert not Requirement("x", 1.0, 1.0 - 1.1e-9, "", 0.0, "at least").passed
    assert Requirement("x", 1000.0, 1000.0 + 0.9e-6, "", 0.0, "at most").passed
    assert not Requirement("x", 1e-3, 1e-3 + 1.1e-9, "", 0.0, "at most").passed


def test_a_controller_that_no_law_follows_keeps_none_of_the_laws_rows(
    design: fl.Design, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(design: fl.Design) -> None:
        raise FieldError(
            "order", "9 modes", "more than law.c holds", allowed="8 modes", remedy="-"
        )

    monkeypatch.setattr("fraclink._law.design.law_rows", none)
    made = design.with_law()
    assert [one.code for one in made.doubts] == ["W410"]
    assert not made.has_law and not made.passed
    said = "no law follows this controller: it takes 9 modes"
    assert made.doubts[0].message.startswith(said)
    assert [row.passed for row in made.requirements[-2:]] == [False, False]


# --- a payload that is given --------------------------------------------------------------------------------


def test_masses_count_the_links_own_once() -> None:
    """33/140 of the mass of a uniform cantilever counts at its tip (Rayleigh)."""
    heavy = replace(RIG, link=replace(RIG.link, mass=0.014))
    known = replace(MODEL, payload=0.03)
    own = 33 / 140 * 0.014

    def masses(link: LinkModel, rig: fl.Rig) -> tuple[float, float]:
        controller = fl.Controller(0.07, 0.61, link=link)
        found = equip(fl.discretize(controller, rig.period), rig, link).tracking
        return (0.0, 0.0) if found is None else (found.nominal, found.link)

    # eq. (5) does not contain the mass of the link
    computed = replace(known, natural_frequency=heavy.natural_frequency(0.03) * 1.0005)
    assert masses(computed, heavy) == pytest.approx((0.03, own), rel=0.03)
    measured = replace(known, natural_frequency=heavy.natural_frequency(0.03) * 0.95)
    assert masses(measured, heavy) == pytest.approx((0.03 + own, own), rel=0.03)
    assert masses(replace(known, payload=None), heavy) == (0.0, 0.0)


def test_the_motor_model_is_the_drive_behind_a_hold_and_one_period() -> None:
    found = following(11.0, 0.004, 80.0, 1, None, None).model
    w = np.linspace(1.0, 22.0, 40)
    z = np.exp(1j * w * 0.004)
    h = found.now + found.next / (z - found.keep)
    model = h / (z - 1 + h)
    # M(s) = 1/(1 + s/80)² with a hold and one period of computation: phase and gain up
    # to twice the resonance
    s = 1j * w
    motor = np.exp(-1.5 * 0.004 * s) / (1 + s / 80.0) ** 2
    assert np.abs(model / motor - 1).max() < 0.02
    # at rest H/(z − 1 + H) is identically one
    assert abs(found.now + found.next / (1 - found.keep)) > 0
    for value in (found.now, found.next, found.keep):
        assert value == float(np.float32(value))


def test_the_motor_model_is_the_closed_loop_of_the_pid_that_runs() -> None:
    for placement in ("tustin", "direct"):
        loop = MotorLoop(80.0, 1, "sampled", placement).sampled(RIG.motor, 0.004)
        found = following(abs(MODEL.pole), 0.004, 80.0, 1, RIG.motor, loop.pid).model
        w = np.linspace(1.0, 20.0, 40)
        z = np.exp(1j * w * 0.004)
        h = found.now + found.next / (z - found.keep)
        wanted = loop.voltage(w) * loop.plant(1 / z)
        assert np.abs(h / (z - 1 + h) / wanted - 1).max() < 0.03


# --- a preview ----------------------------------------------------------------------------------------------


def test_a_refit_keeps_the_poles_and_states_its_true_error(design: fl.Design) -> None:
    law = design.law()
    near = replace(
        design.controller,
        derivative_gain=1.1 * design.controller.derivative_gain,
        derivative_order=design.controller.derivative_order + 0.03,
    )
    quick, error = refitted(law, near)
    w = np.geomspace(*law.band, 2000)
    wanted = near.response(w)
    relative = np.abs(wanted - quick.frequency_response(w)) / np.abs(1 + wanted)
    assert relative.max() == pytest.approx(error, rel=0.05)
    assert error < 0.05
    assert quick.correction.poles == law.correction.poles
    assert quick.limits == law.limits and quick.tracking == law.tracking
    same, rest = refitted(law, design.controller)
    assert rest < 0.03 and same.correction.direct == pytest.approx(
        law.correction.direct, rel=0.05
    )
