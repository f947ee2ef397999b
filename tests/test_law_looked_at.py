"""Requirements, the feed-forward of a payload, and a refit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fraclink as fl
from fraclink import LinkModel, MotorLoop, Requirement
from fraclink._law.block import Modes, Tracking
from fraclink._law.refit import refitted
from fraclink._law.tracking import following, forward_fit, masses_of, tracking_for
from fraclink.errors import FieldError

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
    computed = replace(known, natural_frequency=heavy.natural_frequency(0.03) * 1.0005)
    # eq. (5) does not contain the mass of the link
    assert masses_of(computed, heavy) == pytest.approx((0.03, own))
    measured = replace(known, natural_frequency=heavy.natural_frequency(0.03) * 0.95)
    assert masses_of(measured, heavy) == pytest.approx((0.03 + own, own))
    assert masses_of(known, None) == (0.03, 0.0)
    assert masses_of(replace(known, payload=None), heavy) == (0.0, 0.0)


def test_the_feed_forward_is_what_the_reference_lacks() -> None:
    """(1/G − 1)/s² = s^(λ − 2)/ω₀² to within 0.3 dB and 1.5° from a fifth of the
    resonance on.
    """
    link = replace(MODEL, payload=0.03)
    fit = forward_fit(link, 0.004)
    w = np.geomspace(0.2 * abs(link.pole), 200.0, 200)
    s = 1j * w
    wanted = s**-0.08 / link.natural_frequency**2
    ratio = fit(w) / wanted
    assert np.abs(20 * np.log10(np.abs(ratio))).max() < 0.3
    assert np.abs(np.degrees(np.angle(ratio))).max() < 1.5


def track(link: LinkModel) -> Tracking | None:
    forward = Modes(1.0 / link.natural_frequency**2)  # exact for λ = 2
    return tracking_for(link, forward, 0.004, rig=None)


def test_tracking_follows_the_motor_loop_and_scales_by_the_mass() -> None:
    link = LinkModel(1.56, 11.0, payload=0.03, gauge_delay=0.01, gauge_gain=1.1)
    scale = track(link)
    assert scale is not None
    assert (scale.nominal, scale.link) == (pytest.approx(0.03), 0.0)
    assert (scale.gauge_delay, scale.gauge_gain) == (0.01, 1.1)
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
    assert track(replace(link, payload=None)) is None
    leading = track(replace(link, gauge_delay=-0.01))
    assert leading is not None and leading.gauge_delay == 0.0


def test_a_feed_forward_that_is_too_small_belongs_to_a_lighter_payload() -> None:
    link = LinkModel(1.56, 11.0, payload=0.03)
    small = Modes(0.98 / 121.0)
    found = tracking_for(link, small, 0.004, rig=None)
    assert found is not None and found.nominal == pytest.approx(0.98 * 0.03)
    mode = Modes(
        0.0, (0.5,), (0.5 / 121.0,)
    )  # g/(z − p) is g/(1 − p) far below the sampling rate
    slow = tracking_for(link, mode, 0.004, rig=None)
    assert slow is not None and slow.nominal == pytest.approx(0.03, rel=5e-3)


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


def test_a_refit_of_pairs_is_a_least_squares_solution(design: fl.Design) -> None:
    law = design.law()
    paired = replace(
        law,
        correction=law.correction._replace(
            pair_poles=(0.6 + 0.3j,), pair_gains=(0.01 + 0.02j,)
        ),
    )
    quick, error = refitted(paired, design.controller)
    assert quick.correction.pair_poles == (0.6 + 0.3j,)
    w = np.geomspace(*law.band, 2000)
    wanted = design.controller.response(w)
    relative = np.abs(wanted - quick.frequency_response(w)) / np.abs(1 + wanted)
    assert relative.max() == pytest.approx(error, rel=0.05)
