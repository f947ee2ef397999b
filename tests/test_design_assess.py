"""Bounds, maps, budgets, tolerances, rivals and the sampled motor loop, each compared
with an independent computation.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import fraclink as fl
from fraclink import Controller, Design, MotorLoop, Rig
from fraclink.errors import FieldError
from fraclink.extend import (
    equip,
    feasibility_map,
    phase_budget,
)

RIG = Rig.named("paper-2023")
WANTED = {
    "payloads": (0.020, 0.040),
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
}


IDEAL = {"motor_loop": "ideal", "placement": "tustin"}


@pytest.fixture(scope="module")
def design() -> Design:
    return fl.design(RIG.model, RIG, **WANTED, filter_time=0.0, **IDEAL, law=False)


def test_settling_time_sets_the_crossover():
    found = fl.design(
        RIG.model,
        RIG,
        payloads=(0.020, 0.040),
        settling_time=0.5,
        phase_margin=fl.deg(45),
        law=False,
    )
    assert found.gain_crossover == pytest.approx(2 * math.pi / 0.5)
    names = {r.name for r in found.requirements}
    assert names >= {"phase margin", "settling time"} and "gain crossover" not in names


@pytest.mark.slow
def test_noise_gain_and_peak_against_a_fine_grid(design: Design):
    pi = np.array(design.natural_frequencies)
    w = np.linspace(0.005, math.pi / RIG.period, 400_001)
    for k, value in enumerate(pi):
        distance = np.abs(1 + design.loop(w, value))
        power = (np.abs(design.controller.response(w)) / distance) ** 2
        assert design.loop.noise_gain(pi, RIG.period)[k] == pytest.approx(
            math.sqrt(np.mean(power)), rel=1e-4
        )
        assert design.loop.margins_at(value).modulus_margin == pytest.approx(
            np.min(distance), rel=1e-6
        )


@pytest.mark.parametrize("late", [0.0, 0.01])
@pytest.mark.parametrize("motor_loop", ["ideal", "sampled"])
def test_phase_budget_adds_up_to_the_margin(motor_loop: str, late: float):
    made = fl.design(
        replace(RIG.model, gauge_delay=late),
        RIG,
        **WANTED,
        motor_loop=motor_loop,
        law=False,
    )
    for payload in (0.020, 0.033):
        total = sum(share.phase for share in phase_budget(made, payload)) + math.pi
        assert total == pytest.approx(made.at(payload).phase_margin, abs=1e-9)


@pytest.mark.parametrize("delay", [0, 1, 2])
@pytest.mark.parametrize("pole", [40.0, 60.0])
def test_direct_placement_puts_three_poles_where_it_says(pole: float, delay: int):
    try:
        motor_loop = MotorLoop(pole, delay, "sampled", "direct").sampled(
            RIG.motor, RIG.period
        )
    except FieldError:
        pytest.fail("40 and 60 rad/s can be placed with up to two samples")
    poles, wanted = motor_loop.poles(), math.exp(-pole * RIG.period)
    assert np.all(np.abs(poles) < 1.0)
    # a triple root is accurate to the cube root of the rounding error
    assert np.sort(np.abs(poles - wanted))[2] < 2e-4


@pytest.mark.slow
def test_design_on_the_sampled_motor_loop_keeps_its_margin_exactly():
    for placement in ("tustin", "direct"):
        made = fl.design(
            RIG.model,
            RIG,
            **WANTED,
            motor_loop="sampled",
            placement=placement,
            law=False,
        )
        for payload in (0.020, 0.040):
            gap = (
                made.at(payload).phase_margin
                - made.sampled_at(
                    payload, correction=made.controller.response
                ).phase_margin
            )
            assert abs(math.degrees(gap)) < 1e-6
        assert made.sampled_at(0.020).stable


def test_law_of_a_direct_plan_carries_the_placed_motor_loop():
    made = fl.design(
        RIG.model, RIG, **WANTED, motor_loop="sampled", placement="direct", law=False
    )
    motor_loop = made.law().motor_loop
    assert motor_loop is not None
    placed = fl.MotorLoop(80.0, 1, "sampled", "direct").sampled(RIG.motor, RIG.period)
    assert motor_loop.pid == placed.pid


def test_plan_certifies_the_very_law_that_is_exported(design: Design):
    exported = equip(
        fl.discretize(design.controller, RIG.period), design.rig, design.model
    )
    assert design.law().digest == exported.digest


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ({"derivative_gain": 0.0}, "derivative_gain"),
        ({"derivative_gain": math.nan}, "derivative_gain"),
        ({"derivative_gain": True}, "derivative_gain"),
        ({"derivative_gain": "0.1"}, "derivative_gain"),
        ({"derivative_order": 0.0}, "derivative_order"),
        ({"derivative_order": 2.0}, "derivative_order"),
        ({"filter_time": -1e-3}, "filter_time"),
        ({"filter_order": 3}, "filter_order"),
        ({"period": 0.0}, "period"),
        ({"derivative_gain": 10**400}, "derivative_gain"),
    ],
)
def test_controllers_out_of_range_are_refused(values: dict[str, object], field: str):
    with pytest.raises(FieldError) as caught:
        Controller(**({"derivative_gain": 0.1, "derivative_order": 0.6} | values))
    assert caught.value.field == field


# --- what else could be asked for ---------------------------------------------------------------------------


@pytest.mark.slow
def test_a_map_is_what_design_answers_cell_by_cell() -> None:
    axes = {"gain_crossovers": [8.0, 12.0, 15.0, 30.0], "phase_margins": [0.6, 1.2]}
    found = feasibility_map(RIG.model, RIG, **axes, payloads=(0.02, 0.04))
    assert found.feasible.tolist() == [[True, True, True, False]] * 2
    for row, margin in enumerate(axes["phase_margins"]):
        for column, crossover in enumerate(axes["gain_crossovers"][:3]):
            single = fl.design(
                RIG.model,
                RIG,
                payloads=(0.02, 0.04),
                gain_crossover=crossover,
                phase_margin=margin,
                law=False,
            )
            ends = single.natural_frequencies
            noise = single.full_loop.noise_gain(ends, RIG.period).max()
            assert found.noise_gain[row, column] == pytest.approx(noise, rel=0.1)
    least = feasibility_map(RIG.model, RIG, **axes, noise_gain=1.0)
    assert not least.feasible[:, 2].any() and least.feasible[0, 1]


@pytest.mark.parametrize(
    ("field", "values", "unit"),
    [("gain_crossovers", [-1.0], "rad/s"), ("phase_margins", [3.2], "rad")],
)
def test_an_axis_of_a_map_is_refused_in_its_own_unit(
    field: str, values: list[float], unit: str
) -> None:
    axes = {"gain_crossovers": [12.0], "phase_margins": [0.8]} | {field: values}
    with pytest.raises(FieldError) as caught:
        feasibility_map(RIG.model, RIG, **axes)
    assert (
        caught.value.field == field
        and unit in str(caught.value)
        and "kg" not in str(caught.value)
    )
    with pytest.raises(FieldError, match=f"{field}: .* N >= 1"):
        feasibility_map(RIG.model, RIG, **(axes | {field: []}))
