"""The closed-form procedure against the recomputed numbers of the source paper and
against independent loops.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest

import fraclink as fl
from fraclink import Design, Rig
from fraclink.errors import FieldError
from reproduce import designs

RIG = Rig.named("paper-2023")
DEFAULT = {
    "payloads": (0.020, 0.040),
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
    "filter_time": 0.0,
}
PAPER = {
    "natural_frequencies": (9.42, 14.14),
    "gain_crossover": 16.0,
    "phase_margin": fl.deg(70),
}
PRINTED = {
    name: fl.Controller(
        derivative_gain=gain, derivative_order=0.65, filter_time=0.16, filter_order=2
    )
    for name, gain in (("(58)", 0.148), ("(59)", 0.241))
}


def paper_plan(**changes: object) -> Design:
    return fl.design(
        RIG.model, RIG, **(PAPER | changes), procedure="published", law=False
    )


def default_plan(**changes: object) -> Design:
    """Without a filter two parameters remain for crossover and margin: both
    requirements are met with equality, up to the reserve of the search.
    """
    ideal = {"motor_loop": "ideal", "placement": "tustin"}
    return fl.design(RIG.model, RIG, **(DEFAULT | ideal | changes), law=False)


def plain_loop(design: Design, w: float, pi: float, *, inside: bool) -> complex:
    """L written out again in scalar complex arithmetic, independent of Loop."""
    c, s, order = design.controller, 1j * w, design.model.order
    value = c.derivative_gain * s**c.derivative_order * pi**2 / (s**order + pi**2)
    if inside:
        value *= (
            cmath.exp(-1.5 * 0.004 * s)
            / (1 + s / 80) ** 2
            / (1 + c.filter_time * s) ** c.filter_order
        )
    return value


def test_ideal_reading_gives_the_recomputed_numbers_of_section_7():
    design = paper_plan()
    assert design.chi == pytest.approx(1.324873, abs=5e-7)
    assert design.controller.derivative_order == pytest.approx(0.655361, abs=5e-7)
    assert design.controller.derivative_gain == pytest.approx(0.215299, abs=5e-7)
    assert design.gain_crossover_upper == pytest.approx(27.346181, abs=5e-7)
    nominal = design.at_frequency(11.54)
    assert nominal.gain_crossover == pytest.approx(20.865280, abs=5e-7)
    assert math.degrees(nominal.phase_margin) == pytest.approx(70.741858, abs=5e-7)


def test_stiffness_156_gives_its_column():
    low, high = RIG.natural_frequency(0.040), RIG.natural_frequency(0.020)
    design = paper_plan(natural_frequencies=(low, high))
    got = (
        design.chi,
        design.controller.derivative_order,
        design.controller.derivative_gain,
        design.gain_crossover_upper,
    )
    assert got == pytest.approx((1.235891, 0.649593, 0.204076, 25.139026), abs=1e-6)
    nominal = design.at(0.030)
    assert (
        nominal.gain_crossover,
        math.degrees(nominal.phase_margin),
    ) == pytest.approx((19.26919, 70.81972), abs=1e-5)
    assert paper_plan(
        natural_frequencies=(low, high), filter_order=1
    ).controller.filter_time == pytest.approx(0.004929, abs=5e-7)


@pytest.mark.parametrize(("order", "time"), [(1, 0.004529), (2, 0.002246)])
def test_ten_per_cent_rule(order: int, time: float):
    design = paper_plan(filter_order=order)
    assert design.controller.filter_time == pytest.approx(time, abs=5e-7)
    filtered = replace(
        design.loop, filter_time=design.controller.filter_time, filter_order=order
    )
    found = filtered.crossings(14.14)
    assert math.degrees(float(np.min(np.abs(found.phase_margin)))) == pytest.approx(
        63.0, abs=1e-9
    )


def test_without_a_filter_the_solver_has_the_solution_of_the_two_equations():
    design = default_plan()
    assert design.controller.derivative_gain == pytest.approx(0.069876, rel=5e-3)
    assert design.controller.derivative_order == pytest.approx(0.612197, rel=2e-3)
    assert design.gain_crossover_upper == pytest.approx(17.7718, rel=1e-3)
    assert design.passed
    assert design.at(0.020).phase_margin == pytest.approx(fl.deg(50), rel=5e-4)
    assert design.at(0.040).gain_crossover == pytest.approx(12.0, rel=5e-4)


def test_grunwald_law_has_the_known_sampled_margins():
    design = default_plan()
    correction = design.controller.correction()

    # as in the paper: a backward difference for s
    def sums(w: np.ndarray) -> np.ndarray:
        return correction(-np.expm1(-1j * w * RIG.period) / RIG.period)

    for payload, margin in (
        (0.040, 63.9),
        (0.030, 57.9),
        (0.020, 48.8),
        (0.016, 43.3),
        (0.008, 23.9),
    ):
        found = design.sampled_at(payload, correction=sums)
        assert math.degrees(found.phase_margin) == pytest.approx(margin, abs=0.1)


def test_exact_law_keeps_the_promised_margin_when_sampled():
    # The continuous-time approximation of hold and delay, e^{-1.5 Ts s}, is accurate to
    # a hundredth of a degree here.
    design = default_plan()
    found = design.sampled_at(0.020, correction=design.controller.response)
    kept = math.degrees(design.at(0.020).phase_margin)
    assert math.degrees(found.phase_margin) == pytest.approx(kept, abs=0.01)


def test_requirements_name_the_payload_of_the_worst_value():
    rows = {item.name: item for item in default_plan().requirements}
    crossover, margin = rows["gain crossover"], rows["phase margin"]
    assert crossover.at_payload == pytest.approx(0.040)
    assert margin.at_payload == pytest.approx(0.020)
    assert 0.0 <= crossover.slack < 0.01 and 0.0 <= margin.slack < 1e-3


def test_margins_of_the_plan_are_those_of_the_loop_written_out():
    design = default_plan(filter_time=0.002)
    pi = design.natural_frequency(0.027)
    found = design.at(0.027)
    assert len(found.gain_crossings) == 2
    for crossing in found.gain_crossings:
        value = plain_loop(design, crossing.frequency, pi, inside=True)
        assert abs(value) == pytest.approx(1.0, abs=1e-9)
        assert cmath.phase(-value) == pytest.approx(crossing.phase_margin, abs=1e-9)


@pytest.mark.parametrize(
    ("changes", "field", "shown"),
    [
        ({"phase_margin": 50}, "phase_margin", "deg(50)"),
        ({"phase_margin": 0.0}, "phase_margin", "> 0"),
        ({"phase_margin": -0.5}, "phase_margin", "-0.5"),
        ({"phase_margin": math.nan}, "phase_margin", "nan"),
        ({"phase_margin": "50"}, "phase_margin", "50"),
        ({"phase_margin": True}, "phase_margin", "True"),
        ({"gain_crossover": 0}, "gain_crossover", "> 0"),
        ({"gain_crossover": math.inf}, "gain_crossover", "inf"),
        ({"gain_crossover": 10**400}, "gain_crossover", "not finite (got inf)"),
        ({"gain_crossover": 900.0}, "gain_crossover", "Nyquist"),
        ({"gain_crossover": 90.0}, "gain_crossover", "motor loop"),
        ({"payloads": (0.0, 0.04)}, "payloads[0]", "> 0"),
        ({"payloads": (-0.02, 0.04)}, "payloads[0]", "-0.02"),
        ({"payloads": (0.04, 0.02)}, "payloads", "in ascending order"),
        ({"payloads": (math.nan, 0.04)}, "payloads[0]", "nan"),
        ({"payloads": 0.03}, "payloads", "pair"),
        (
            {"payloads": None, "natural_frequencies": (14.0, 9.0)},
            "natural_frequencies",
            "ascending",
        ),
        ({"natural_frequencies": (9.0, 14.0)}, "natural_frequencies", "one of the two"),
        ({"filter_time": -0.1}, "filter_time", "-0.1"),
        ({"filter_order": 3}, "filter_order", "whole number 1 to 2"),
        ({"filter_order": True}, "filter_order", "whole number 1 to 2"),
        ({"motor_loop": "real"}, "motor_loop", "ideal or sampled"),
    ],
)
def test_bad_requests_name_the_field(
    changes: dict[str, object], field: str, shown: str
):
    with pytest.raises(FieldError) as caught:
        default_plan(**changes)
    assert caught.value.field == field
    assert shown in str(caught.value)


@pytest.mark.parametrize(
    ("name", "pi", "pole"),
    [
        ("(58)", 11.547, 0.106 + 12.89j),
        ("(58)", 10.0, 0.161 + 11.256j),
        ("(59)", 11.547, 0.602 + 13.03j),
    ],
)
def test_printed_controllers_are_unstable_on_the_printed_model(
    name: str, pi: float, pole: complex
):
    link = replace(RIG.model, natural_frequency=pi)
    found = designs.closed_loop_poles(PRINTED[name], link, motor_loop_pole=80.0)
    assert found[0].real == pytest.approx(pole.real, abs=6e-4)
    assert abs(found[0].imag) == pytest.approx(pole.imag, abs=6e-3)
    # The pole is a zero of 1 + L, evaluated here from the formula.
    s, c = complex(found[0]), PRINTED[name]
    loop = (
        c.derivative_gain
        * s**c.derivative_order
        / (1 + c.filter_time * s) ** 2
        / (1 + s / 80) ** 2
        * pi**2
        / (s**1.92 + pi**2)
    )
    assert abs(1 + loop) < 1e-10


def test_a_design_of_which_nothing_was_measured_has_not_passed():
    made = default_plan()
    assert made.passed
    assert not replace(made, requirements=()).passed


def test_an_unknown_option_is_refused_as_python_does():
    with pytest.raises(TypeError, match="unexpected keyword argument 'margins'"):
        default_plan(margins="ideal")


@pytest.mark.slow
def test_the_shipped_law_is_a_row_like_any_other():
    shipped = default_plan(motor_loop="sampled", placement="direct").with_law()
    kept = min(
        shipped.sampled_at(payload).phase_margin for payload in (0.020, 0.030, 0.040)
    )
    rows = {row.name: row for row in shipped.requirements}
    assert rows["phase margin, shipped law"].achieved == pytest.approx(kept)
    assert rows["phase margin, shipped law"].wanted == pytest.approx(fl.deg(49.5))
    assert shipped.with_law() == shipped
    assert shipped.passed == all(row.passed for row in shipped.requirements)


@pytest.mark.slow
def test_the_published_reading_asks_the_law_for_stability_alone():
    made = fl.design(RIG.model, RIG, **DEFAULT, procedure="published")
    margin, modulus = made.requirements[-2:]
    assert (margin.wanted, modulus.wanted) == (0.0, 0.0)
    assert made.passed == (margin.achieved >= 0.0)
