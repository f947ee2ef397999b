"""The vibration that a design leaves, against mpmath and against the move; and what
`design` says of it.
"""

from __future__ import annotations

from dataclasses import replace

import mpmath
import numpy as np
import pytest

import fraclink as fl
from fraclink._law.modes import Vibration, vibration
from fraclink.errors import FieldError

RIG = fl.Rig.named("paper-2023-geared")
LINK = RIG.model
assert LINK is not None


def made_for(
    model: fl.LinkModel, crossover: float, margin: float, rig: fl.Rig = RIG
) -> fl.Design:
    """A design for 20 to 40 g, with nothing said of its law."""
    asked = {
        "gain_crossover": crossover,
        "phase_margin": fl.deg(margin),
        "payloads": (0.02, 0.04),
    }
    return fl.design(model, rig, **asked, procedure="published", law=False)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 0.02])
@pytest.mark.parametrize("payload", [0.02, 0.04])
def test_vibration_is_a_root_of_the_characteristic_equation(
    delay: float, payload: float
) -> None:
    design = made_for(replace(LINK, gauge_delay=delay), 11.5, 45.0)
    found = vibration(design.full_loop, design.natural_frequency(payload))
    assert found is not None
    c, model, w0 = design.controller, design.model, design.natural_frequency(payload)

    def characteristic(s: mpmath.mpc) -> mpmath.mpc:
        correction = c.gain * s**c.order / (1 + c.filter_time * s) ** c.filter_order
        motor = (
            mpmath.exp(-1.5 * RIG.period * s) / (1 + s / design.motor_loop.pole) ** 2
        )
        torque = s**model.order / (s**model.order + w0**2)
        return 1 + correction * motor * (1 - mpmath.exp(-delay * s) * torque)

    start = found.frequency * mpmath.mpc(
        -found.damping_ratio, (1 - found.damping_ratio**2) ** 0.5
    )
    root = mpmath.findroot(characteristic, start * 1.01)
    assert found.frequency == pytest.approx(float(abs(root)), rel=1e-9)
    assert found.damping_ratio == pytest.approx(float(-root.real / abs(root)), rel=1e-7)


@pytest.mark.slow
def test_a_move_dies_as_fast_as_the_vibration_says() -> None:
    model = replace(
        LINK, order=1.97, payload=0.03, natural_frequency=RIG.natural_frequency(0.03)
    )
    design = made_for(model, 10.5, 35.0)
    found = vibration(design.full_loop, design.natural_frequency(0.04))
    assert found is not None
    rig = replace(
        RIG,
        gauge=replace(RIG.gauge, noise=0.0),
        motor=replace(RIG.motor, coulomb_torque=0.0),
    )
    quiet = replace(
        design,
        rig=replace(rig, encoder=replace(rig.encoder, counts_per_revolution=None)),
    )
    run = fl.simulate(quiet, fl.smooth_step(0.2, duration=0.5), payload=0.04)
    size, time = np.abs(run.tip_angle - 0.2), run.time
    early, late = (size[(time > t) & (time < t + 0.6)].max() for t in (0.8, 2.0))
    # The PID at its period stands for M(s): a few per cent of phase at this frequency.
    assert np.log(early / late) / 1.2 == pytest.approx(
        found.damping_ratio * found.frequency, rel=0.25
    )


def test_periods_and_time_are_those_of_an_exponential() -> None:
    one = Vibration(frequency=10.0, damping_ratio=0.05)
    assert np.exp(-one.damping_ratio * one.frequency * one.time) == pytest.approx(0.02)
    damped = one.frequency * (1 - one.damping_ratio**2) ** 0.5
    assert one.periods == pytest.approx(one.time * damped / (2 * np.pi))
    assert Vibration(10.0, -0.1).periods == Vibration(10.0, -0.1).time == float("inf")


def test_the_papers_reading_says_nothing_of_moves() -> None:
    asked = {
        "gain_crossover": 12.5,
        "phase_margin": fl.deg(65.0),
        "payloads": (0.02, 0.04),
    }
    design = fl.design(
        replace(LINK, order=1.85), RIG, **asked, margins="ideal", law=False
    )  # type: ignore[arg-type]
    assert "W409" not in {one.code for one in design.findings}


@pytest.mark.slow
def test_a_controller_that_no_law_follows_is_a_finding(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def none(design: fl.Design) -> None:
        raise FieldError(
            "order",
            "3 pairs",
            "more than law.c holds",
            allowed="2 pairs",
            remedy="lower it",
        )

    monkeypatch.setattr("fraclink._law.design.law_margins", none)
    for design in (
        made_for(LINK, 12.0, 45.0).warned_of_law(),
        made_for(LINK, 12.0, 45.0).with_law(),
    ):
        assert [
            one.severity for one in design.with_law().findings if one.code == "W410"
        ] == ["error"]
        assert not design.has_law and not design.passed
        assert "no law follows this controller: it takes 3 pairs" in str(design)
