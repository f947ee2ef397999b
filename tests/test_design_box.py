"""A design over a box: every requirement holds for arms drawn by the test itself, and
what is refused.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

import fraclink as fl
from fraclink import Design, ParameterBox, design
from fraclink.errors import FieldError
from fraclink.extend import Loop

RIG = fl.Rig.named("paper-2023")
WANTED = {
    "payloads": (0.020, 0.040),
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
}


def corner_loops(made: Design, box: ParameterBox) -> Iterator[Loop]:
    """The loops at the corners of a box: link, gauge, and a faster or slower motor."""
    names = ("order", "damping", "gauge_gain", "gauge_delay")
    controller, settings = made.controller, made.motor_loop
    intervals = [getattr(box, name) for name in names]
    for *values, ratio in itertools.product(*intervals, box.motor_ratio):
        link = replace(made.model, **dict(zip(names, values, strict=True)))
        motor = settings.correction(RIG.motor, RIG.period, ratio=ratio)
        yield replace(Loop.of(controller, link, RIG), correction=motor)


@pytest.mark.slow
def test_modulus_of_the_moderate_box_is_proved() -> None:
    made = design(
        RIG.model,
        RIG,
        payloads=(0.02, 0.04),
        gain_crossover=11.0,
        max_sensitivity=1 / 0.57,
        box=True,
    )
    assert made.passed and made.box == ParameterBox.of(RIG.model, RIG)
    found = fl.certify(made)
    assert found.passed and found.statement.modulus >= 0.55
    assert found.statement.gauge_gain_high == made.box.gauge_gain[1]


@pytest.mark.slow
def test_finding_says_what_each_interval_costs() -> None:
    asked = WANTED | {"phase_margin": fl.deg(45)}
    made = design(RIG.model, RIG, **asked, box=True, law=False)
    (cost,) = (finding for finding in made.findings if finding.code == "W407")
    assert cost.evidence["nominal_rad"] > cost.evidence["worst_rad"] > fl.deg(44)
    # Without the interval of the delay, the margin of the design is larger by what the
    # finding promised.
    known = replace(made.box, gauge_delay=(0.0, 0.0))
    worst = min(
        float(loop.margins(w0 * ratio)[1][0])
        for loop in corner_loops(made, known)
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


@pytest.mark.parametrize(("box", "procedure"), [("all", "solver"), (True, "published")])
def test_bad_boxes_are_refused(box: object, procedure: str) -> None:
    with pytest.raises(FieldError) as caught:
        design(RIG.model, RIG, **WANTED, box=box, procedure=procedure, law=False)
    assert caught.value.field == "box"


@pytest.mark.slow
def test_the_cost_of_a_box_names_the_dearest_parameter() -> None:
    box = replace(
        ParameterBox.at(RIG.model), gauge_delay=(0.0, 0.004), gauge_gain=(0.99, 1.01)
    )
    made = design(RIG.model, RIG, **WANTED, box=box, law=False)
    (found,) = (one for one in made.findings if one.code == "W407")
    cost = found.evidence
    assert set(cost) == {
        "nominal_rad",
        "worst_rad",
        "gauge_delay_rad",
        "gauge_gain_rad",
    }
    assert cost["worst_rad"] == pytest.approx(fl.deg(50), abs=1e-3)
    assert cost["gauge_delay_rad"] > cost["gauge_gain_rad"] > 0.0
    lost = math.degrees(cost["nominal_rad"] - cost["worst_rad"])
    back = math.degrees(cost["gauge_delay_rad"])
    assert found.message.startswith(
        f"the box costs {lost:.1f}° of phase margin, most of it the gauge's delay from 0 to 0.004: known "
        f"exactly, it would give back {back:.1f}°"
    )
    assert (
        found.remedy
        == "measuring the delay that the controller sees narrows the interval"
    )
    # The contribution of the delay alone, with the other parameters at their worst
    # values.
    late = [
        Loop.of(
            made.controller,
            replace(RIG.model, gauge_delay=delay, gauge_gain=gain),
            RIG,
        )
        for delay in (0.004, 0.0)
        for gain in (0.99, 1.01)
    ]
    ends = made.natural_frequencies
    worst = [min(float(loop.margins(w0)[1][0]) for w0 in ends) for loop in late]
    assert min(worst) == pytest.approx(cost["worst_rad"], abs=2e-3)


def test_a_box_of_one_arm_costs_nothing() -> None:
    point = ParameterBox.at(RIG.model)
    made = design(RIG.model, RIG, **WANTED, box=point, law=False)
    (cost,) = made.findings
    assert cost.code == "W407" and "costs nothing" in cost.message
