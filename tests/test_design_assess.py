"""Bounds, maps, budgets, tolerances, rivals, the sampled motor loop, each against
another computation.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import fraclink as fl
from fraclink import Controller, Design, MotorLoop, ParameterBox, Rig, certify
from fraclink._arm.motor_loop import direct_placement
from fraclink.errors import FieldError
from fraclink.extend import (
    VibrationMode,
    enclose_phase_margin,
    equip,
    feasibility_map,
    phase_budget,
    spillover,
)

RIG = Rig.named("paper-2023")
WANTED = {
    "payloads": (0.020, 0.040),
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
}


@pytest.fixture(scope="module")
def design() -> Design:
    return fl.design(
        RIG.model, RIG, **WANTED, filter_time=0.0, procedure="published", law=False
    )


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
    assert (
        names >= {"phase margin", "settling time"} and "sensitivity peak" not in names
    )


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
        assert design.loop.sensitivity_peak(pi)[k] == pytest.approx(
            1 / np.min(distance), rel=1e-6
        )


@pytest.mark.parametrize("inner", ["ideal", "sampled"])
def test_phase_budget_adds_up_to_the_margin(inner: str):
    made = fl.design(
        RIG.model, RIG, **WANTED, inner=inner, procedure="published", law=False
    )
    for payload in (0.020, 0.033):
        total = sum(share.phase for share in phase_budget(made, payload)) + math.pi
        assert total == pytest.approx(made.at(payload).phase_margin, abs=1e-9)


def test_spillover_is_the_peak_of_a_mode_times_the_controller(design: Design):
    mode = VibrationMode(frequency=177.5, damping_ratio=0.02, share=0.05)
    (found,) = spillover(design, [mode], limit=0.5)
    outer = abs(design.controller.response(177.5)) / abs(1 + 177.5j / 80) ** 2
    assert found.achieved == pytest.approx(outer * 0.05 / 0.04, rel=1e-9)
    assert found.passed
    assert not spillover(design, [replace(mode, share=1.0)])[0].passed
    with pytest.raises(FieldError):
        spillover(design, [replace(mode, damping_ratio=0.0)])


@pytest.mark.parametrize("delay", [0, 1, 2])
@pytest.mark.parametrize("pole", [40.0, 60.0])
def test_direct_placement_puts_three_poles_where_it_says(pole: float, delay: int):
    try:
        inner = MotorLoop(pole, delay, "sampled", "direct").sampled(
            RIG.motor, RIG.period
        )
    except FieldError:
        pytest.fail("40 and 60 rad/s can be placed with up to two samples")
    poles, wanted = inner.poles(), math.exp(-pole * RIG.period)
    assert np.all(np.abs(poles) < 1.0)
    assert (
        np.sort(np.abs(poles - wanted))[2] < 2e-4
    )  # a triple root is known to the cube root of rounding


@pytest.mark.slow
def test_design_on_the_sampled_motor_loop_keeps_its_margin_exactly():
    for placement in ("tustin", "direct"):
        made = fl.design(
            RIG.model, RIG, **WANTED, inner="sampled", placement=placement, law=False
        )
        for payload in (0.020, 0.040):
            gap = (
                made.at(payload).phase_margin
                - made.sampled_at(payload, realisation="exact").phase_margin
            )
            assert abs(math.degrees(gap)) < 1e-6
        assert made.sampled_at(0.020).stable


def test_law_of_a_direct_plan_carries_the_placed_motor_loop():
    made = fl.design(
        RIG.model, RIG, **WANTED, inner="sampled", placement="direct", law=False
    )
    drive = made.law().drive
    assert drive is not None
    placed = direct_placement(RIG.motor, 80.0, RIG.period, 1)
    assert drive.loop.filter_decay == placed.filter_decay


def test_plan_certifies_the_very_law_that_is_exported(design: Design):
    exported = equip(
        fl.discretize(design.controller, RIG.period), design.rig, design.model
    )
    assert design.law().digest == exported.digest


@pytest.mark.slow
def test_phase_margin_is_enclosed_to_a_hundredth_of_a_degree():
    design = fl.design(
        RIG.model,
        RIG,
        **WANTED,
        filter_time=0.0,
        procedure="published",
        inner="sampled",
        law=False,
    )
    proper = design.law()
    point = ParameterBox.at(design.model)
    claim = certify(
        design, law=proper, delay=(0.004, 0.004), modulus_margin=0.999, box=point
    ).statement
    found = enclose_phase_margin(claim, proper)
    true = design.sampled_at(0.020).phase_margin
    assert found.low <= true <= found.high + 1e-6
    assert math.degrees(found.high - found.low) <= 0.01 + 1e-9
    assert found.payload == pytest.approx(0.020)


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ({"gain": 0.0}, "gain"),
        ({"gain": math.nan}, "gain"),
        ({"gain": True}, "gain"),
        ({"gain": "0.1"}, "gain"),
        ({"order": 0.0}, "order"),
        ({"order": 2.0}, "order"),
        ({"filter_time": -1e-3}, "filter_time"),
        ({"filter_order": 3}, "filter_order"),
        ({"period": 0.0}, "period"),
        ({"gain": 10**400}, "gain"),
    ],
)
def test_controllers_out_of_range_are_refused(values: dict[str, object], field: str):
    with pytest.raises(FieldError) as caught:
        Controller(**({"gain": 0.1, "order": 0.6} | values))
    assert caught.value.field == field


# --- what a design says of itself, number by number ---------------------------------------------------------


def test_a_small_map_agrees_with_single_designs() -> None:
    axes = {"gain_crossovers": [8.0, 12.0, 14.0], "phase_margins": fl.deg(50)}
    for filter_time, kind in ((None, "loop"), (0.002, "loop"), (0.0, "ideal")):
        options = {
            "payloads": (0.02, 0.04),
            "filter_time": filter_time,
            "margins": kind,
            "filter_order": 1,
        }
        found = feasibility_map(RIG.model, RIG, **axes, **options)
        assert found.order.shape == (1, 3)
        assert found.feasible[0].tolist() == [False, True, True]
        assert all(
            math.isnan(column[0, 0])
            for column in (found.gain, found.upper, found.noise_gain)
        )
        for column in (1, 2):
            crossover = float(found.gain_crossover[column])
            single = fl.design(
                RIG.model,
                RIG,
                gain_crossover=crossover,
                phase_margin=fl.deg(50),
                **options,
                procedure="published",
                law=False,
            )
            c = single.controller
            got = [
                x[0, column]
                for x in (found.gain, found.order, found.upper, found.settling_time)
            ]
            wanted = [
                c.gain,
                c.order,
                single.gain_crossover_upper,
                2 * math.pi / crossover,
            ]
            assert got == pytest.approx(wanted, rel=1e-8)
            if kind == "loop":
                light = single.loop.noise_gain(
                    single.natural_frequencies[1], RIG.period
                )[0]
                assert found.noise_gain[0, column] == pytest.approx(light, rel=1e-6)
                assert found.filter_time[0, column] == pytest.approx(
                    c.filter_time, abs=1e-12
                )
    wide = feasibility_map(
        RIG.model,
        RIG,
        natural_frequencies=(9.6, 13.6),
        gain_crossovers=12.0,
        phase_margins=[2.9],
        filter_order=2,
    )
    assert not wide.feasible.any()


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
    with pytest.raises(FieldError, match="without values"):
        feasibility_map(RIG.model, RIG, **(axes | {field: []}))
