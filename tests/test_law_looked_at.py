"""What is said of a law in the sampled loop, on margins made by hand; a payload's
feed-forward; a refit.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

import fraclink as fl
from fraclink._arm.link import LinkModel
from fraclink._arm.motor_loop import MotorLoop
from fraclink._law.block import Modes, Tracking
from fraclink._law.refit import refitted
from fraclink._law.requirement import (
    LAW_MARGIN,
    Looked,
    Requirement,
    kept_by_law,
    law_findings,
    no_law,
)
from fraclink._law.tracking import following, forward_fit, masses_of, tracking_for
from fraclink.errors import FieldError
from fraclink.findings import Finding
from fracsys._margins import GainCrossing, Margins

RIG = fl.Rig.named("paper-2023")
MODEL = RIG.model
assert MODEL is not None
ASKED = {
    "payloads": (0.02, 0.04),
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
    "law": False,
}


@pytest.fixture(scope="module")
def design() -> fl.Design:
    return fl.design(MODEL, RIG, **ASKED)


def looked(
    margin_deg: float | None,
    *,
    distance: float = 0.6,
    stable: bool = True,
    payload: float = 0.02,
    kind: str = "ideal",
) -> Looked:
    crossings = (
        () if margin_deg is None else (GainCrossing(12.0, fl.deg(margin_deg), 0.05),)
    )
    return Looked(Margins(crossings, (), distance, 40.0, stable), payload, kind)


# --- requirements -------------------------------------------------------------------------------------------


def test_a_requirement_says_what_was_wanted_and_where() -> None:
    angle = Requirement.at_least("phase margin", fl.deg(50), fl.deg(45), "rad", 0.02)
    assert str(angle) == "phase margin: wanted 50°, achieved 45° at 20 g, FAILED"
    assert angle.slack == pytest.approx(fl.deg(-5)) and not angle.passed
    noise = Requirement.at_most("noise gain", 1.5, 1.25, "", 0.0305)
    assert str(noise) == "noise gain: wanted 1.5, achieved 1.25 at 30.5 g, passed"
    assert noise.slack == 0.25
    time = Requirement.at_most("settling time", 0.5, 0.75, "s", 0.04)
    assert str(time) == "settling time: wanted 0.5 s, achieved 0.75 s at 40 g, FAILED"
    # met with equality is met, to rounding; and rounding is relative above one
    assert Requirement.at_least("x", 1.0, 1.0 - 0.9e-9, "", 0.0).passed
    assert not Requirement.at_least("x", 1.0, 1.0 - 1.1e-9, "", 0.0).passed
    assert Requirement.at_most("x", 1000.0, 1000.0 + 0.9e-6, "", 0.0).passed
    assert not Requirement.at_most("x", 1e-3, 1e-3 + 1.1e-9, "", 0.0).passed


def test_a_margin_is_signed_by_stability_and_at_most_half_a_turn() -> None:
    assert looked(-40.0).phase_margin == pytest.approx(fl.deg(40))
    assert looked(40.0, stable=False).phase_margin == pytest.approx(fl.deg(-40))
    assert looked(None).phase_margin == math.pi
    assert looked(None, stable=False).phase_margin == -math.pi


def test_the_requirement_on_the_law_is_the_least_margin_less_its_tolerance(
    design: fl.Design,
) -> None:
    found, _ = kept_by_law(
        design, [looked(60.0), looked(49.6, payload=0.031), looked(52.0)]
    )
    assert (found.name, found.unit, found.at_payload) == (LAW_MARGIN, "rad", 0.031)
    assert found.wanted == pytest.approx(
        fl.deg(49.5)
    ) and found.achieved == pytest.approx(fl.deg(49.6))
    assert found.passed and not kept_by_law(design, [looked(49.4)])[0].passed


Severity = Literal["info", "warning", "error"]


@pytest.mark.parametrize(
    ("margin", "severity"),
    [(49.9, "info"), (49.4, "warning"), (25.1, "warning"), (24.9, "error")],
)
def test_less_margin_than_requested_is_told_by_how_much(
    design: fl.Design, margin: float, severity: Severity
) -> None:
    (finding,) = [f for f in law_findings(design, [looked(margin)]) if f.code == "W404"]
    assert finding.severity == severity
    assert (
        finding.message
        == "the shipped law in the sampled loop keeps less phase margin than requested"
    )
    assert finding.evidence == pytest.approx(
        {
            "phase_margin_rad": fl.deg(margin),
            "wanted_rad": fl.deg(50),
            "payload_kg": 0.02,
        }
    )
    assert finding.remedy == "request that much more margin, for the whole loop"


def test_as_much_margin_as_requested_is_no_finding(design: fl.Design) -> None:
    assert not [f for f in law_findings(design, [looked(50.0001)]) if f.code == "W404"]


def test_an_unstable_law_is_an_error_whatever_was_asked(design: fl.Design) -> None:
    (finding,) = law_findings(design, [looked(80.0, stable=False, distance=0.01)])
    assert (finding.code, finding.severity) == (
        "W404",
        "error",
    )  # and nothing more about its distance
    ideal = replace(design, margins_kind="ideal")
    (finding,) = law_findings(
        ideal, [looked(5.0)]
    )  # the paper's reading asked for no margin of this loop
    assert finding.severity == "warning"
    assert law_findings(ideal, [looked(5.0, stable=False)])[0].severity == "error"


def test_what_the_loop_has_that_the_designs_has_not_is_said(design: fl.Design) -> None:
    heavy = replace(design, rig=replace(RIG, link=replace(RIG.link, mass=0.007)))
    pid, modes = (
        "with the motor's PID at the control period",
        "with the link's modes 2 and 3",
    )
    (finding,) = law_findings(design, [looked(40.0, kind="sampled")])
    assert f"sampled loop, {pid}, keeps" in finding.message
    assert (
        finding.remedy
        == "design with inner='sampled' (--inner sampled), or with a longer filter"
    )
    assert (
        f"sampled loop, {modes}, keeps"
        in law_findings(heavy, [looked(40.0)])[0].message
    )
    both = law_findings(heavy, [looked(40.0, kind="sampled")])[0].message
    assert (
        "with the link's modes 2 and 3 and the motor's PID at the control period,"
        in both
    )


def test_a_law_that_comes_near_minus_one_is_named(design: fl.Design) -> None:
    """The design's own |1 + L| at 20 g, and half of it: there the finding begins; below
    0.1 an error.
    """
    own = design.full_loop.margins_at(design.natural_frequency(0.02)).modulus_margin
    for share, severity in (
        (0.501, None),
        (0.499, "warning"),
        (0.101 / own, "warning"),
        (0.099 / own, "error"),
    ):
        found = law_findings(
            design, [looked(55.0, distance=own), looked(60.0, distance=share * own)]
        )
        near = [f for f in found if f.code == "W408"]
        assert [f.severity for f in near] == ([] if severity is None else [severity])
    assert near[0].evidence == pytest.approx(
        {"modulus_margin": 0.099, "designed": own, "payload_kg": 0.02}
    )
    assert (
        f"comes to |1 + L| = 0.099 at 40 rad/s, where the loop of the design keeps {own:.2g}"
        in near[0].message
    )
    assert near[0].remedy.startswith("leave filter_time out")
    by_pid = law_findings(design, [looked(55.0, distance=0.05, kind="sampled")])
    assert by_pid[0].remedy.startswith("design with inner='sampled'")


def test_an_earlier_look_is_replaced_and_other_findings_stay(design: fl.Design) -> None:
    old = [
        Finding(code, "error", "old", {}, "x")
        for code in ("W404", "W408", "W410", "W402")
    ]
    found = law_findings(replace(design, findings=tuple(old)), [looked(49.0)])
    assert [f.code for f in found] == ["W402", "W404"] and found[1].message != "old"
    error = FieldError(
        "order",
        "9 real modes",
        "more than law.c holds",
        allowed="8 real modes",
        remedy="less",
    )
    told = no_law(error)
    assert (told.code, told.severity) == ("W410", "error")
    assert (
        told.message
        == "no law follows this controller: it takes 9 real modes, and law.c holds 8 real modes"
    )


# --- a payload that is given --------------------------------------------------------------------------------


def test_masses_count_the_links_own_once() -> None:
    """33/140 of a uniform cantilever's mass moves with its tip (Rayleigh)."""
    heavy = replace(RIG, link=replace(RIG.link, mass=0.014))
    known = replace(MODEL, payload=0.03)
    own = 33 / 140 * 0.014
    computed = replace(known, natural_frequency=heavy.natural_frequency(0.03) * 1.0005)
    assert masses_of(computed, heavy) == pytest.approx(
        (0.03, own)
    )  # eq. (5) knows no mass of the link
    measured = replace(known, natural_frequency=heavy.natural_frequency(0.03) * 0.95)
    assert masses_of(measured, heavy) == pytest.approx((0.03 + own, own))
    assert masses_of(known, None) == (0.03, 0.0)
    assert masses_of(replace(known, payload=None), heavy) == (0.0, 0.0)


def test_the_feed_forward_is_what_the_reference_lacks() -> None:
    """(1/G − 1)/s² = s^(λ − 2)/ω₀² to 0.3 dB and 1.5° from a fifth of the resonance on."""
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
    # M(s) = 1/(1 + s/80)² behind a hold and one period of computation: lag and size up
    # to twice the resonance
    s = 1j * w
    motor = np.exp(-1.5 * 0.004 * s) / (1 + s / 80.0) ** 2
    assert np.abs(model / motor - 1).max() < 0.02
    assert (
        abs(found.now + found.next / (1 - found.keep)) > 0
    )  # at rest H/(z − 1 + H) is one by its form
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
        gain=1.1 * design.controller.gain,
        order=design.controller.order + 0.03,
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
