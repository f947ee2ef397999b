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
from fraclink._arm.motor import held_motor
from fraclink._arm.motor_loop import direct_placement
from fraclink._arm.sampled import SampledPlant
from fraclink.errors import FieldError, SizeError
from fraclink.extend import (
    VibrationMode,
    enclose_phase_margin,
    equip,
    feasibility_map,
    motor_loop_costs,
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


def test_map_refuses_what_is_too_large():
    with pytest.raises(SizeError):
        feasibility_map(
            RIG.model, RIG, gain_crossovers=np.ones(2000), phase_margins=np.ones(2000)
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


def test_tustin_is_nearly_unstable_and_direct_placement_is_not():
    tustin, direct = motor_loop_costs(RIG, frequency=18.0)
    assert tustin.radius == pytest.approx(0.951, abs=5e-4)
    assert tustin.modulus_margin < 0.15 < 0.5 < direct.modulus_margin
    assert direct.radius < 0.85


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


def test_discrete_motor_loop_in_time_follows_its_reference():
    """A difference-equation simulation, coefficient by coefficient, against the closed
    form in z.
    """
    for placement in ("tustin", "direct"):
        inner = MotorLoop(60.0, 1, "sampled", placement).sampled(RIG.motor, RIG.period)
        m1, m2, e = held_motor(RIG.motor, RIG.period)
        k, n = inner.pid, 600
        angle, voltage = np.zeros(n), np.zeros(n)
        integral = filtered = 0.0
        for t in range(n):
            past = [
                voltage[t - 2] if t >= 2 else 0.0,
                voltage[t - 3] if t >= 3 else 0.0,
            ]
            before = [angle[t - 1] if t >= 1 else 0.0, angle[t - 2] if t >= 2 else 0.0]
            angle[t] = (1 + e) * before[0] - e * before[1] + m1 * past[0] + m2 * past[1]
            error = 1.0 - angle[t]
            slow = k.filter_gain * error - k.angle_filter_gain * angle[t]
            now_i = integral + k.integral_now * k.integral_gain * error
            now_f = filtered + k.filter_now * slow
            voltage[t] = k.direct * error - k.angle_direct * angle[t] + now_i + now_f
            integral = now_i + k.integral_before * k.integral_gain * error
            filtered = k.filter_decay * now_f + k.filter_before * slow
        assert abs(angle[-1] - 1.0) < 1e-6, placement
        w = np.array([20.0])
        x = np.exp(-1j * w * RIG.period)
        spectrum = np.sum(np.diff(angle, prepend=0.0) * x ** np.arange(n))
        assert spectrum == pytest.approx(
            complex((inner.voltage(w) * inner.plant(x))[0]), abs=1e-6
        )


def test_placement_too_fast_for_its_delay_is_refused():
    with pytest.raises(FieldError) as caught:
        direct_placement(RIG.motor, 200.0, RIG.period, 3)
    assert caught.value.field == "inner.pole"


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


def test_alias_sum_is_exact_where_the_answer_is_known():
    """1/(s+a) under a hold is (1-e^{-aT})/a / (z - e^{-aT}), with any whole delay."""
    a, period = 7.0, 0.02
    plant = SampledPlant(
        lambda s: 1.0 / (s + a), period, period, decay=2.0, leading=1.0
    )
    w = np.array([0.5, 10.0, 100.0, 150.0])
    z = np.exp(1j * w * period)
    exact = -np.expm1(-a * period) / a / (z - math.exp(-a * period)) / z
    assert np.allclose(plant(w), exact, rtol=2e-5)


@pytest.mark.slow
def test_phase_margin_is_enclosed_to_a_hundredth_of_a_degree(design: Design):
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


@pytest.mark.parametrize(
    "values",
    [{"pole": 0.0}, {"delay_samples": 1.5}, {"delay_samples": 101}, {"kind": "real"}],
)
def test_inner_settings_out_of_range_are_refused(values: dict[str, object]):
    with pytest.raises(FieldError):
        MotorLoop(**values)


def test_transfer_is_one_plus_the_correction():
    controller = Controller(gain=0.148, order=0.65, filter_time=0.16, filter_order=2)
    w = np.array([0.3, 12.0, 90.0])
    assert np.allclose(
        controller.correction()(1j * w), controller.response(w), rtol=1e-13
    )
    assert np.allclose(
        controller.transfer()(1j * w), 1 + controller.response(w), rtol=1e-13
    )
    assert (
        controller.is_strictly_proper
        and not controller.without_filter().is_strictly_proper
    )
    assert controller.formula == "C(s) = 1 + 0.148 s^0.65 / (1 + 0.16 s)^2"
    assert (
        replace(controller, filter_order=1).formula
        == "C(s) = 1 + 0.148 s^0.65 / (1 + 0.16 s)"
    )
    assert controller.without_filter().formula == "C(s) = 1 + 0.148 s^0.65"
    assert not replace(controller, filter_order=1, order=1.0).is_strictly_proper


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
