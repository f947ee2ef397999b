"""A design over a box: every requirement kept at arms that the test draws itself, and
what is refused.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from fraclink import Design, MotorLoop, ParameterBox, SecondMode, design
from fraclink._arm.box import Arm, arms_of
from fraclink._design.box_cost import _shrunk, cost_of_box
from fraclink.errors import FieldError
from fraclink.extend import Loop

RIG = fl.Rig.named("paper-2023")
WANTED = {
    "payloads": (0.020, 0.040),
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
}
MODE = SecondMode(180.0, 0.02, 0.02)


def drawn(made: Design, count: int) -> list[tuple[float, float]]:
    """(crossover, phase margin) of the loop at random arms and corners of the design's
    box.
    """
    box, rng, found = made.box, np.random.default_rng(2), []
    assert box is not None
    for number in range(count):

        def pick(pair: tuple[float, float], corner: bool = number % 2 == 0) -> float:
            share = float(rng.integers(2)) if corner else float(rng.random())
            return pair[0] + share * (pair[1] - pair[0])

        second = made.model.second_mode
        if second is not None:
            second = replace(
                second, frequency=pick(box.mode_frequency), gain=pick(box.mode_gain)
            )
        link = replace(
            made.model,
            natural_frequency=pick(box.natural_frequency),
            order=pick(box.order),
            gauge_gain=pick(box.gauge_gain),
            gauge_delay=pick(box.gauge_delay),
            second_mode=second,
            intervals=(),
        ).at_payload(pick(made.payloads))
        pole = RIG.motor_loop.pole * pick(box.motor_ratio)
        true = replace(
            made.controller, inner=MotorLoop(pole, RIG.motor_loop.delay_samples)
        )
        crossover, margin = Loop.of(true, link, RIG).margins(link.natural_frequency)
        found.append((float(crossover[0]), float(margin[0])))
    return found


@pytest.mark.slow
def test_modulus_of_the_moderate_box_is_proved() -> None:
    made = design(
        RIG.model,
        RIG,
        payloads=(0.02, 0.04),
        gain_crossover=11.5,
        max_sensitivity=1 / 0.57,
        box=True,
    )
    assert made.passed and made.box == ParameterBox.of(RIG.model, RIG)
    found = fl.certify(made)
    assert found.passed and found.statement.modulus >= 0.56
    assert found.statement.gauge_gain_high == made.box.gauge_gain[1]


@pytest.mark.slow
def test_finding_says_what_each_interval_costs() -> None:
    asked = WANTED | {"phase_margin": fl.deg(45)}
    made = design(RIG.model, RIG, **asked, box=True, law=False)
    (cost,) = (finding for finding in made.findings if finding.code == "W407")
    assert cost.evidence["nominal_rad"] > cost.evidence["worst_rad"] > fl.deg(44)
    # Without the delay's interval the design has as much more margin as the finding
    # promised.
    known = replace(made.box, gauge_delay=(0.0, 0.0))
    worst = min(
        float(arm.loop(made.controller, RIG).margins(w0 * ratio)[1][0])
        for arm in arms_of(known, made.model)
        for w0 in made.natural_frequencies
        for ratio in (0.985, 1.015)
    )
    assert worst - cost.evidence["worst_rad"] == pytest.approx(
        cost.evidence["gauge_delay_rad"], abs=2e-3
    )


def test_box_of_one_arm_is_the_plain_design_and_files_keep_the_box(
    tmp_path: Path,
) -> None:
    plain = design(RIG.model, RIG, **WANTED, law=False)
    point = design(RIG.model, RIG, **WANTED, box=ParameterBox.at(RIG.model), law=False)
    assert point.controller == plain.controller and plain.box is None
    point.save(tmp_path / "design.json")
    assert Design.load(tmp_path / "design.json") == point


@pytest.mark.parametrize(("box", "margins"), [("all", "loop"), (True, "ideal")])
def test_bad_boxes_are_refused(box: object, margins: str) -> None:
    with pytest.raises(FieldError) as caught:
        design(RIG.model, RIG, **WANTED, box=box, margins=margins, law=False)
    assert caught.value.field == "box"


# --- one parameter after the other ------------------------------------------------------------------------


def test_each_interval_is_closed_towards_the_model_alone() -> None:
    link = replace(RIG.model, damping=0.4, second_mode=MODE)
    box = replace(ParameterBox.at(link), natural_frequency=(10.0, 13.0))
    far = {"order": 1.9, "damping": 0.5, "gauge_gain": 1.05, "gauge_delay": 0.002}
    arm = Arm(replace(link, **far, second_mode=replace(MODE, frequency=190.0)), 1.1)

    def moved(name: str, point: float, share: float) -> tuple[ParameterBox, Arm]:
        return _shrunk(box, arm, name, point, share)

    for name, point, half in (
        ("order", 1.92, 1.91),
        ("damping", 0.4, 0.45),
        ("gauge_gain", 1.0, 1.025),
        ("gauge_delay", 0.0, 0.001),
    ):
        same, there = moved(name, point, 0.5)
        assert getattr(there.model, name) == pytest.approx(half)
        assert same == box and replace(there.model, **{name: far[name]}) == arm.model
        assert getattr(moved(name, point, 0.0)[1].model, name) == pytest.approx(point)
    assert moved("motor_ratio", 1.0, 0.5)[1].motor_ratio == pytest.approx(1.05)
    assert moved("motor_ratio", 1.0, 0.5)[1].model == arm.model
    second = moved("mode_frequency", 180.0, 0.5)[1].model.second_mode
    assert second is not None and (second.frequency, second.gain) == (
        pytest.approx(185.0),
        MODE.gain,
    )
    narrow, unmoved = moved("natural_frequency", 11.0, 0.5)
    assert narrow.natural_frequency == pytest.approx((10.5, 12.0)) and unmoved == arm
    assert narrow.order == box.order


def test_the_cost_of_a_box_names_the_dearest_parameter_and_a_single_arm_costs_nothing() -> (
    None
):
    made = design(RIG.model, RIG, **WANTED, procedure="published", law=False)
    box = replace(
        ParameterBox.at(RIG.model), gauge_delay=(0.0, 0.004), gauge_gain=(0.99, 1.01)
    )
    ends = made.natural_frequencies
    found = cost_of_box(RIG.model, RIG, made.controller, ends, box)
    assert set(found.evidence) == {
        "nominal_rad",
        "worst_rad",
        "gauge_delay_rad",
        "gauge_gain_rad",
    }
    assert found.evidence["nominal_rad"] == pytest.approx(fl.deg(50), abs=1e-6)
    assert found.evidence["gauge_delay_rad"] > found.evidence["gauge_gain_rad"] > 0.0
    lost = math.degrees(found.evidence["nominal_rad"] - found.evidence["worst_rad"])
    back = math.degrees(found.evidence["gauge_delay_rad"])
    assert found.message.startswith(
        f"the box costs {lost:.1f}° of phase margin, most of it the gauge's delay from 0 to 0.004: exactly "
        f"known it would give back {back:.1f}°, half as wide"
    )
    assert (
        found.remedy
        == "measuring the delay that the controller sees narrows the interval"
    )
    # The delay's own part, on a loop with the other parameters where they are worst.
    late = [
        Arm(replace(RIG.model, gauge_delay=delay, gauge_gain=gain)).loop(
            made.controller, RIG
        )
        for delay in (0.004, 0.0)
        for gain in (0.99, 1.01)
    ]
    worst = [min(float(loop.margins(w0)[1][0]) for w0 in ends) for loop in late]
    assert min(worst) == pytest.approx(found.evidence["worst_rad"], abs=2e-3)
    point = ParameterBox.at(RIG.model)
    single = cost_of_box(RIG.model, RIG, made.controller, ends, point)
    assert single.message == "the box is a single arm and costs nothing"
    assert single.remedy == "give box=True for what fit and rig leave open"
