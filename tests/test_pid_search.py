"""The search behind `tune_pid` on loops whose margins and errors are known in closed
form; what it says.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink._design.pid_search import Candidates
from fraclink.errors import FieldError, InfeasibleError
from fracsys._fractional import s

LAG = (1 / (0.4 * s**1.5 + 1)).delayed(0.05)


def one(kp: float, ki: float = 0.0, kd: float = 0.0, **changes: float) -> Candidates:
    given = {
        "lam": 1.0,
        "mu": 1.0,
        "slope": 0.0,
        "crossover": 1.0,
        "lag": 0.0,
    } | changes
    columns = [np.array([value]) for value in given.values()]
    return Candidates(np.array([[kp, ki, kd]]), *columns)


# --- one loop on the scan -----------------------------------------------------------------------------------


# --- candidates ---------------------------------------------------------------------------------------------


def test_a_part_without_gain_has_the_order_one_and_no_filter() -> None:
    made = one(2.0, ki=0.0, kd=0.0, lam=0.7, mu=0.8, lag=0.1).controller(0)
    assert (made.integral_order, made.derivative_order, made.filter_time) == (
        1.0,
        1.0,
        0.0,
    )
    full = one(2.0, ki=1.0, kd=0.5, lam=0.7, mu=0.8, lag=0.1).controller(0)
    assert (full.integral_order, full.derivative_order, full.filter_time) == (
        0.7,
        0.8,
        0.1,
    )


# --- what is refused, in words ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("plant", "given", "words"),
    [
        (0 * s, {}, "plant: zero"),
        (
            1 / (s - 1),
            {},
            "plant: unstable: it has a pole with Re s >= 0 beside the origin",
        ),
        (-1 / (s + 1), {}, "plant: of negative gain at rest"),
        ((s + 2) / (s + 1), {}, r"plant: not strictly proper"),
        (
            LAG,
            {"form": "PI", "derivative_order": 0.5},
            "derivative_order: given for a PI",
        ),
        (LAG, {"form": "PD", "integral_order": 0.5}, "integral_order: given for a PD"),
        (
            LAG,
            {"form": "PI", "integral_order": 0.5},
            "asked of a PI whose order is given",
        ),
        (
            LAG,
            {"form": "PD", "derivative_order": 0.5},
            "asked of a PD whose order is given",
        ),
    ],
)
def test_bad_plants_and_requests_say_what_is_wrong(
    plant: Any, given: dict[str, Any], words: str
) -> None:
    with pytest.raises(FieldError, match=words):
        fl.tune_pid(plant, gain_crossover=2.0, **given)


def test_an_integrator_is_no_instability_and_needs_no_integral() -> None:
    made = fl.tune_pid(
        1 / (s * (0.4 * s + 1)), gain_crossover=2.3, phase_margin=fl.deg(65), form="PD"
    )
    assert not made.findings  # a lasting error is removed by the plant's own integrator


def test_what_a_pd_leaves_of_a_step() -> None:
    """k_p P(0) = K leaves 100/(1 + K) %."""
    plant = 4 / (0.8 * s**2.2 + 0.5 * s**0.9 + 2)
    asked: dict[str, Any] = {"gain_crossover": 3.0, "form": "PD", "flat_phase": False}
    (finding,) = fl.tune_pid(plant, **asked).findings
    made = fl.tune_pid(plant, **asked).controller
    assert finding.evidence["lasting error, %"] == pytest.approx(
        100 / (1 + 2.0 * made.proportional)
    )
    gone = fl.tune_pid(s * plant, **asked, phase_margin=fl.deg(77.5)).findings
    assert gone[0].evidence["lasting error, %"] == 100.0  # nothing gets through at rest


@pytest.mark.slow
def test_infeasible_requests_are_named_by_their_form() -> None:
    with pytest.raises(
        InfeasibleError, match="no PI controller with a flat phase with gains >= 0"
    ) as caught:
        fl.tune_pid(LAG, gain_crossover=3.0, form="PI", phase_margin=fl.deg(60))
    assert caught.value.condition == "phase_margin"
    nearest = caught.value.nearest["phase_margin"]
    assert math.degrees(nearest) % 2.5 == pytest.approx(0.0, abs=1e-9) or math.degrees(
        nearest
    ) % 2.5 == pytest.approx(2.5, abs=1e-9)
    with pytest.raises(
        InfeasibleError, match="no PID controller with gains >= 0 crosses there"
    ) as caught:
        fl.tune_pid(LAG, gain_crossover=3.0, flat_phase=False, gain_margin=900.0)
    assert caught.value.condition == "gain_crossover" and not caught.value.nearest


# --- the result ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made() -> fl.extend.PidTuning:
    return fl.tune_pid(
        LAG,
        gain_crossover=3.0,
        gain_margin=1.5,
        max_sensitivity=3.0,
        period=0.01,
        output_limit=50.0,
        measurement_limit=5.0,
    )


@pytest.mark.slow
def test_a_tuning_lists_what_was_asked_and_what_was_achieved(
    made: fl.extend.PidTuning,
) -> None:
    assert made.delay == pytest.approx(0.015)
    assert made.horizon == pytest.approx(40.0 / 3.0)
    assert made.open_loop.delay == pytest.approx(0.065)
    names = [name for name, *_ in made.kept]
    assert names == [
        "phase margin [rad]",
        "gain crossover [rad/s]",
        "gain margin",
        "sensitivity peak",
        "slope of the phase [rad]",
    ]
    text = str(made).splitlines()
    assert text[0] == made.controller.formula
    assert text[1] == "phase margin [rad]: asked 1.0472, achieved 1.0472"
    assert text[2] == "gain crossover [rad/s]: asked 3, achieved 3"
    assert text[6].startswith("ITAE ") and text[6].endswith(" s² over 13.33 s")
    worse = replace(
        made,
        gain_crossover=3.1,
        gain_margin=1e3,
        max_sensitivity=1.01,
        phase_margin=2.0,
    )
    assert [kept for *_, kept in worse.kept] == [False, False, False, False, True]
    assert not worse.passed and str(worse).count(", FAILED") == 4
    plain = fl.tune_pid(
        LAG,
        gain_crossover=3.0,
        flat_phase=False,
        integral_order=1.0,
        derivative_order=1.0,
    )
    assert [name for name, *_ in plain.kept] == [
        "phase margin [rad]",
        "gain crossover [rad/s]",
    ]
    assert plain.delay == 0.0


@pytest.mark.slow
def test_a_law_takes_what_the_tuning_was_given(made: fl.extend.PidTuning) -> None:
    law = made.law()
    assert (law.period, law.drive.voltage_limit, law.limits.angle_limit) == (
        0.01,
        50.0,
        5.0,
    )  # type: ignore[union-attr]
    drive, block = law.drive, law.coefficients
    assert drive is not None and (drive.torque_voltage, drive.coulomb_voltage) == (
        0.0,
        0.0,
    )
    assert (
        block["torque_voltage"],
        block["coulomb_voltage"],
        block["coulomb_slope"],
    ) == (0.0, 0.0, 0.0)
    assert (law.inner_pole, law.feedforward_error, law.has_gauge) == (
        0.0,
        (0.0, 0.0),
        False,
    )
    w = made.margins.gain_crossover
    assert law.band == pytest.approx((w / 200.0, min(50.0 * w, 0.5 * math.pi / 0.01)))
    other = made.law(
        period=0.02,
        output_limit=7.0,
        measurement_limit=2.0,
        order=3,
        precision="single",
    )
    assert (other.period, other.drive.voltage_limit, other.limits.angle_limit) == (
        0.02,
        7.0,
        2.0,
    )  # type: ignore[union-attr]
    assert (other.order, other.precision) == (3, "single")
    slow = made.law(
        period=0.2
    )  # the crossover is in the last fifth of what this period can follow
    assert slow.band == pytest.approx((0.5 * math.pi / 0.2 * 1e-4, 0.5 * math.pi / 0.2))
    bare = replace(made, period=None, output_limit=None, measurement_limit=None)
    with pytest.raises(
        FieldError, match=r"period is required.*tune_pid \(--period-ms\)"
    ):
        bare.law()
    with pytest.raises(
        FieldError, match=r"output_limit is required.*tune_pid \(--output-limit\)"
    ):
        bare.law(period=0.01)
    with pytest.raises(FieldError, match=r"measurement_limit is required"):
        bare.law(period=0.01, output_limit=1.0)


def test_a_step_is_the_closed_loops(made: fl.extend.PidTuning) -> None:
    """The plant's own delay is inverted numerically; here one without: C = k on 1/(s +
    1).
    """
    bare = replace(made, period=None, gain_crossover=None, horizon=2.0)
    plain = replace(bare, plant=1 / (s + 1), controller=fl.extend.FractionalPid(3.0))
    step = plain.step(size=2.0)
    assert step.time[-1] == 2.0 and step.time.size == 1001
    answer = 2.0 * 0.75 * (1 - np.exp(-4.0 * step.time))
    assert np.allclose(step.measurement, answer, atol=1e-9)
    assert np.allclose(step.output, 3.0 * (2.0 - answer), atol=1e-8)
    assert plain.step(duration=1.0).time[-1] == 1.0
    law = fl.extend.discretize_pid(
        fl.extend.FractionalPid(3.0), 0.01, output_limit=50.0, measurement_limit=5.0
    )
    held = plain.step(law=law, duration=0.5)
    assert held.time.size == 51 and held.time[-1] == pytest.approx(0.5)
    # u of a sample acts one period later: y(k + 1) = a y(k) + (1 − a) 3 (1 − y(k − 1))
    a, y = math.exp(-0.01), [0.0, 0.0]
    for _ in range(49):
        y.append(a * y[-1] + (1 - a) * 3.0 * (1 - y[-2]))
    assert np.allclose(held.measurement, y, atol=1e-6)
    assert held.output[0] == pytest.approx(3.0) and held.output[-1] == held.output[-2]


def test_limits_of_a_pids_law_are_those_of_its_measurement() -> None:
    """Errors within 2Y: a mode's state stays within (1 + |1 − p|/(1 − |p|)) of them."""
    law = fl.extend.discretize_pid(
        fl.extend.FractionalPid(2.0, integral=3.0, integral_order=0.8),
        0.01,
        output_limit=9.0,
        measurement_limit=5.0,
    )
    modes, error, bound = law.correction, 2.0 * 5.0 * 1.01, law.limits
    poles, gains = np.array(modes.poles), np.abs(modes.gains)
    assert not modes.pair_poles and np.all(np.abs(poles) < 1)
    norms = 1 + np.abs(1 - poles) / (1 - np.abs(poles))
    command = (2 * abs(modes.direct) + float(norms @ gains)) * error
    wanted = {
        "sum_limit": command,
        "correction_limit": 2 * max(float(norms.max()), 1.0) * error,
        "angle_limit": 5.0,
        "angle_step": 2 * error,
        "reference_step": 2 * error,
        "motor_limit": 5.0 + command,
        "motor_step": 2 * (5.0 + command),
        "residual_angle": 2 * (5.0 + command),
        "frozen_angle": 2 * (5.0 + command),
        "torque_limit": 0.0,
        "payload_limit": 0.0,
        "acceleration_limit": 0.0,
        "reference_rate": 1.0,
        "scale_step": 1.0,
    }
    assert {name: getattr(bound, name) for name in wanted} == pytest.approx(
        wanted, rel=1e-12
    )
    plain = fl.extend.discretize_pid(
        fl.extend.FractionalPid(3.0), 0.01, output_limit=9.0, measurement_limit=5.0
    )
    assert (plain.order, plain.correction_error, plain.limits.sum_limit) == (
        0,
        (0.0, 0.0),
        0.0,
    )
    assert fl.extend.pid_response(plain, [1.0, 100.0]) == pytest.approx([3.0, 3.0])


def test_the_margins_of_the_shipped_law_count_a_period_of_computation(
    made: fl.extend.PidTuning,
) -> None:
    law = fl.extend.discretize_pid(
        fl.extend.FractionalPid(3.0), 0.1, output_limit=50.0, measurement_limit=5.0
    )
    plain = replace(
        made,
        plant=1 / (s + 1),
        controller=fl.extend.FractionalPid(3.0),
        period=0.1,
        horizon=2.0,
    )
    found = plain.sampled_margins(law)
    a = math.exp(-0.1)

    def loop(w: float) -> complex:
        z = np.exp(0.1j * w)
        return complex(3.0 * (1 - a) / (z - a) / z)

    assert abs(loop(found.gain_crossover)) == pytest.approx(1.0, rel=1e-6)
    assert found.phase_margin == pytest.approx(
        float(np.angle(-loop(found.gain_crossover))), abs=1e-6
    )
