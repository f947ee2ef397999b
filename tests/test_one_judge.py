"""What is shipped is what was tested: the guards of the law assume the motor loop as
placed, and a certificate covers all of the law.
"""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import Law, ParameterBox, certify, extend
from fraclink.errors import FieldError
from fraclink.extend import SensorFault
from fraclink.lab._rehearsal import rehearse

RIG = fl.Rig.named("paper-2023-geared")
RUN, DEGRADED, OFF = 1, 2, 4  # modes of the law


@pytest.fixture(scope="module")
def design() -> fl.Design:
    return fl.design(
        RIG.model,
        RIG,
        payloads=(0.02, 0.04),
        gain_crossover=11.7,
        phase_margin=fl.deg(45),
    )


class Changed(Law):
    """A law whose block was modified after it was made."""

    change: Callable[[dict[str, Any]], None]

    @property
    def values(self) -> dict[str, Any]:
        values = dict(super().values)
        self.__dict__["change"](values)
        return values


def changed(law: Law, name: str, factor: float) -> Law:
    def change(values: dict[str, Any]) -> None:
        old = values[name]
        values[name] = (
            [factor * x for x in old]
            if isinstance(old, list)
            else type(old)(factor * old)
        )

    fields = {item.name: getattr(law, item.name) for item in dataclasses.fields(Law)}
    made = Changed(**fields)
    made.__dict__["change"] = change
    return made


def test_single_precision_is_what_is_simulated_proved_and_exported(
    design: fl.Design,
) -> None:
    assert design.law().precision == "single"
    assert fl.discretize(design.controller, RIG.period).precision == "single"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("inner_direct", -1.0),
        ("inner_angle", 30.0),
        ("forward_direct", 10.0),
        ("forward", 1.5),
        ("torque_voltage", -1.0),
        ("coulomb_voltage", 30.0),
        ("motor_next", 0.1),
        ("residual_angle", 1e-3),
        ("torque_step", 1e-3),
        ("angle_step", 1e-3),
        ("sum_limit", 1e-3),
        ("reference_step", 1e-3),
        ("stuck_limit", 0.1),
        ("voltage_limit", 0.1),
        ("payload_scale", 30.0),
    ],
)
def test_a_law_of_which_any_part_is_wrong_is_not_certified(
    name: str, factor: float, design: fl.Design
) -> None:
    law = changed(design.law(), name, factor)
    try:
        assert not certify(design, law=law, modulus_margin=0.25).passed
    except FieldError as error:
        assert "law" in error.field


@pytest.mark.slow
def test_a_narrower_box_proves_no_less(design: fl.Design) -> None:
    point = ParameterBox.at(design.model)
    wide = certify(design).statement.modulus
    for law in (design.law(), design.law().in_precision("double")):
        assert certify(design, law=law, box=point).statement.modulus >= wide
        fixed = certify(design, law=law, box=point, delay=(0.004, 0.004))
        assert fixed.passed and fixed.statement.modulus >= wide


@pytest.mark.slow
def test_a_loop_that_comes_too_close_does_not_pass(design: fl.Design) -> None:
    own = design.controller
    near = dataclasses.replace(
        design,
        controller=dataclasses.replace(own, derivative_gain=2.5 * own.derivative_gain),
    )
    proof = certify(near, box=ParameterBox.of(near.model, RIG))
    assert not proof.passed and "0.25" in proof.verdict


@pytest.mark.parametrize(
    ("pole", "samples", "duration"), [(60.0, 2, 1.0), (60.0, 2, 1.3), (45.0, 3, 1.3)]
)
def test_a_loop_placed_with_its_delay_makes_ordinary_moves(
    pole: float, samples: int, duration: float
) -> None:
    """Its lag is several times that of M(s), which the model of the guard must take
    into account.
    """
    loop = fl.MotorLoop(pole, samples, "sampled", "direct")
    controller = fl.Controller(
        derivative_gain=0.02, derivative_order=0.6, link=RIG.model, motor_loop=loop
    )
    law = extend.equip(
        fl.discretize(controller, RIG.period), RIG, RIG.model, motor_loop=loop
    )
    run = fl.simulate(
        law,
        fl.smooth_step(1.0, duration=duration),
        rig=RIG,
        model=RIG.model,
        payload=0.03,
        delay_samples=samples,
    )
    assert run.mode.max() == RUN


def _stepped(law: Law, called: Callable[[int], bool], periods: int = 1500) -> int:
    """Return the mode of a law at rest that is called only in some of the periods."""
    state, mode = law.initial_state(), 0
    for tick in range(1, periods):
        if called(tick):
            state, out = law.step(
                state, extend.LawInputs(0.0, 0.0, 0.0, 0.0), tick=tick
            )
            mode = int(out.mode)
    return mode


def test_missed_periods_count_although_good_ones_lie_between(design: fl.Design) -> None:
    law = design.law()
    assert _stepped(law, lambda tick: tick % 3 == 0) == OFF
    assert _stepped(law, lambda tick: tick % 2 == 0) == OFF
    assert _stepped(law, lambda tick: tick % 50 > 4) == RUN
    assert _stepped(law, lambda tick: tick % 3 != 0) == RUN


@pytest.mark.parametrize("field", ["error", "scale"])
def test_a_flipped_bit_of_what_the_command_is_made_of_begins_anew(
    field: str, design: fl.Design
) -> None:
    law, place = design.law(), {"error": 34, "scale": 46}[field]
    state, _ = law.run(law.initial_state(), np.linspace(0, 0.1, 50), *np.zeros((3, 50)))
    for bit in (22, 24, 28, 31):
        damaged = bytearray(state)
        damaged[4 * place + bit // 8] ^= 1 << (bit % 8)
        _, out = law.step(bytes(damaged), extend.LawInputs(0.1, 0.0, 0.0, 0.0), tick=51)
        assert int(out.flags) & 128  # LAW_FLAG_STARTED


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.057])
def test_a_late_gauge_is_not_a_stuck_one(delay: float) -> None:
    assert RIG.model is not None
    late = dataclasses.replace(RIG.model, gauge_delay=delay)
    quiet = dataclasses.replace(
        RIG, gauge=dataclasses.replace(RIG.gauge, noise=0.0, quantum=0.0)
    )
    controller = fl.Controller(derivative_gain=1e-6, derivative_order=0.6, link=late)
    law = extend.equip(fl.discretize(controller, RIG.period), quiet, late)
    move = fl.smooth_step(1.0, duration=0.5)
    run = fl.simulate(law, move, rig=quiet, model=late, payload=0.03, noise=0.0)
    assert run.mode.max() == RUN
    dead = SensorFault(0.1, 2.0, "gauge frozen")
    run = fl.simulate(
        law, move, rig=quiet, model=late, payload=0.03, noise=0.0, events=(dead,)
    )
    stuck = np.flatnonzero(run.mode == DEGRADED)
    assert stuck.size and run.time[stuck[0]] < 0.1 + delay + 0.2


def test_the_limits_of_a_person_are_those_of_the_law(design: fl.Design) -> None:
    limits = extend.Moves(angle=0.7, velocity=4.0, acceleration=40.0, torque=1.5)
    rig = dataclasses.replace(RIG, moves=limits)
    law = dataclasses.replace(design, rig=rig).law()
    assert law.limits.motor_limit == 0.7 and law.limits.torque_trip <= 1.5
    assert fl.Rig.from_tables(tomllib.loads(rig.to_toml())) == rig
    with pytest.raises(FieldError, match="beyond the limits"):
        rehearse(design, law, fl.smooth_step(1.0, duration=1.0))


def test_a_move_that_the_model_trips_is_refused(design: fl.Design) -> None:
    rehearse(design, design.law(), fl.smooth_step(1.0, duration=0.5), payload=0.03)
    narrow = changed(design.law(), "residual_angle", 1e-5)
    with pytest.raises(FieldError, match="has not moved"):
        rehearse(design, narrow, fl.smooth_step(1.0, duration=0.5))


def test_the_range_is_about_what_the_encoder_reads_in_its_middle(
    design: fl.Design,
) -> None:
    limits = extend.Moves(angle=0.7, velocity=6.0, acceleration=60.0, centre=0.3)
    shifted = dataclasses.replace(design, rig=dataclasses.replace(RIG, moves=limits))
    law = shifted.law()
    # 0.3 next to its zero, and 0.7 to either side of that.
    assert law.limits.motor_limit == 1.0
    assert fl.Rig.from_tables(tomllib.loads(shifted.rig.to_toml())) == shifted.rig
    rehearse(shifted, law, fl.smooth_step(0.6, duration=0.8))
    with pytest.raises(FieldError, match="beyond the limits"):
        rehearse(shifted, law, fl.smooth_step(0.8, duration=0.8))
