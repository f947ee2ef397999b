"""The search behind `tune_pid` on loops whose margins and errors are known in closed
form; what it says.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

import fraclink as fl
from fraclink._design import pid_search
from fraclink._design.pid import _of_law, _problem
from fraclink._design.pid_search import Candidates, PidProblem, itae
from fraclink.errors import FieldError, InfeasibleError
from fracsys._fractional import FractionalTransferFunction, s

LAG = (1 / (0.4 * s**1.5 + 1)).delayed(0.05)
SCAN = np.geomspace(1e-3, 1e3, 480)


def problem(
    plant: FractionalTransferFunction, form: Any = "PID", **changes: Any
) -> PidProblem:
    asked: dict[str, Any] = {
        "phase_margin": fl.deg(60),
        "gain_crossover": 2.0,
        "flat_phase": True,
    }
    asked |= dict.fromkeys(
        (
            "gain_margin",
            "max_sensitivity",
            "integral_order",
            "derivative_order",
            "filter_time",
        )
    )
    return _problem(plant, form, **(asked | changes))


def curve(loop: FractionalTransferFunction) -> np.ndarray:
    return np.asarray(loop(1j * SCAN))[None, :]


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


@pytest.mark.parametrize(
    ("loop", "origin", "stable"),
    [
        (2 / (s + 1), 0.0, True),
        (0.5 / (s * (s + 1)), 1.0, True),
        (7.9 / (s + 1) ** 3, 0.0, True),
        (8.1 / (s + 1) ** 3, 0.0, False),
        ((s + 0.1) / s**2 / (0.1 * s + 1), 2.0, True),
        ((s + 11.0) / s**2 / (0.1 * s + 1), 2.0, False),
        (1 / s**0.5, 0.5, True),
    ],
)
def test_turns_of_the_curve_tell_stability(
    loop: FractionalTransferFunction, origin: float, stable: bool
) -> None:
    assert bool(pid_search._stable(curve(loop), np.array([origin]))[0]) is stable


def test_margins_between_the_points_of_the_scan() -> None:
    """a/s crosses at a with 90°; a/(s + 1)³ reaches −180° at √3, where it is a/8."""
    assert pid_search._least_margin(curve(1.7 / s))[0] == pytest.approx(
        0.5 * math.pi, abs=1e-6
    )
    assert (
        pid_search._least_margin(curve(0.5 / (s + 1)))[0] == math.pi
    )  # never reaches one
    assert pid_search._least_gain_margin(curve(2 / (s + 1) ** 3))[0] == pytest.approx(
        4.0, rel=1e-3
    )
    assert pid_search._least_gain_margin(curve(16 / (s + 1) ** 3))[0] == pytest.approx(
        2.0, rel=1e-3
    )
    assert pid_search._least_gain_margin(curve(1 / (s + 1)))[0] == pytest.approx(
        math.exp(300.0)
    )
    # −180° to +180° on the side away from −1 is no passage: 1/(s+1)⁵ with its phase
    # from 0° to −450°
    both = pid_search._least_gain_margin(curve(1 / (s + 1) ** 5))[0]
    assert both == pytest.approx((1 + math.tan(math.pi / 5) ** 2) ** 2.5, rel=1e-3)


def test_itae_of_an_exponential() -> None:
    """P = 1/s with C = k: e = exp(−kt), ∫ t e dt = (1 − (1 + kT) exp(−kT))/k²."""
    for gain, horizon in ((1.0, 20.0), (3.0, 5.0)):
        found = itae(problem(1 / s), one(gain, crossover=gain), horizon)[0]
        exact = (1 - (1 + gain * horizon) * math.exp(-gain * horizon)) / gain**2
        assert found == pytest.approx(exact, rel=2e-4)
    # and with an error that changes its sign: P = 1/(s(s + 1)), C = 4
    root = math.sqrt(3.75)

    def error(t: float) -> float:
        return math.exp(-t / 2) * (math.cos(root * t) + 0.5 / root * math.sin(root * t))

    exact = sum(
        quad(lambda t: t * abs(error(t)), a, b, limit=200)[0]
        for a, b in ((0, 5), (5, 10), (10, 20))
    )
    found = itae(problem(1 / (s * (s + 1))), one(4.0, crossover=2.0), 20.0)[0]
    assert found == pytest.approx(exact, rel=2e-3)


# --- candidates ---------------------------------------------------------------------------------------------


def test_gains_solve_the_equations_of_crossover_margin_and_slope() -> None:
    asked = problem(LAG)
    found = asked.solved(
        np.array([0.9]), np.array([0.6]), np.array([-0.1]), np.array([3.0])
    )
    assert found.count == 1
    c = found.controller(0)
    assert c.filter_time == pytest.approx(1 / (20.0 * 3.0))
    assert (c.integral_order, c.derivative_order) == (0.9, 0.6)

    def loop(w: float) -> complex:
        return complex(c.response(w) * LAG(1j * w))

    assert abs(loop(3.0)) == pytest.approx(1.0, rel=1e-12)
    assert np.angle(-loop(3.0)) == pytest.approx(fl.deg(60), abs=1e-12)
    step = 1e-4
    turn = np.angle(loop(3.0 * math.exp(step)) / loop(3.0 * math.exp(-step))) / (
        2 * step
    )
    assert turn == pytest.approx(-0.1, abs=1e-6) == found.slope[0]
    # at complex points of the right half plane it is the same function
    point = np.array([0.3 + 2.0j])
    assert found.response(point)[0, 0] == pytest.approx(
        complex(c.transfer()(point[0])), rel=1e-12
    )


def test_candidates_with_a_negative_gain_or_without_a_solution_are_left_out() -> None:
    asked = problem(LAG)
    lam, mu = np.array([1.0, 0.9]), np.array([0.6, 0.6])
    slope, crossover = np.array([50.0, -0.1]), np.array([3.0, 3.0])
    assert asked.solved(lam, mu, slope, crossover).integral_order.tolist() == [0.9]
    pi = problem(LAG, "PI", flat_phase=False)
    kept = pi.solved(np.array([1.0]), np.ones(1), np.zeros(1), np.array([1.5]))
    assert kept.count == 1 and kept.gains[0, 2] == 0.0
    pd = problem(1 / (s * (s + 1)), "PD", flat_phase=False)
    assert (
        pd.solved(np.ones(1), np.ones(1), np.zeros(1), np.array([2.0])).gains[0, 1]
        == 0.0
    )


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


def test_admitted_are_those_that_keep_every_bound() -> None:
    """P = 1/(s + 1)³ and C = k: unstable from 8, gain margin 8/k."""
    plant = 1 / (s + 1) ** 3
    gains = np.array([[k, 0.0, 0.0] for k in (1.5, 3.0, 9.0)])
    ones = np.ones(3)
    found = Candidates(gains, ones, ones, 0 * ones, ones, 0 * ones)
    kept = replace(problem(plant), phase_margin=fl.deg(20))
    assert kept.admitted(found).gains[:, 0].tolist() == [1.5, 3.0]
    assert replace(kept, gain_margin=3.0).admitted(found).gains[:, 0].tolist() == [1.5]
    assert replace(kept, phase_margin=fl.deg(70)).admitted(found).gains[
        :, 0
    ].tolist() == [1.5]
    # Ms of k = 1.5 is 1.56, of k = 3 it is 2.6
    w = np.linspace(0.01, 5, 5001)
    peaks = [float(np.max(1 / np.abs(1 + k * plant(1j * w)))) for k in (1.5, 3.0)]
    assert replace(kept, max_sensitivity=0.5 * sum(peaks)).admitted(found).gains[
        :, 0
    ].tolist() == [1.5]
    assert replace(kept, max_sensitivity=1.1 * peaks[1]).admitted(found).count == 2
    assert kept.admitted(found[np.zeros(3, dtype=bool)]).count == 0


def test_the_scan_is_dense_about_the_plants_own_modes() -> None:
    plain, sharp = problem(1 / (s + 1)), problem(1 / (s**2 + 0.02 * s + 25))
    assert plain.scan.size == 480 and sharp.scan.size == 480 + 32
    assert (plain.scan[0], plain.scan[-1]) == (pytest.approx(2e-3), pytest.approx(2e3))
    near = sharp.scan[np.abs(sharp.scan / 5.0 - 1.0) < 2e-4]
    assert near.size >= 2
    inner = (0.5 / (s + 1)).delayed(0.1)
    assert (
        problem(inner / (1 + inner)).scan.size == 480
    )  # a delay in the denominator: no list of poles


def test_the_origin_has_the_orders_of_plant_and_integral() -> None:
    both = Candidates(
        np.array([[1.0, 2.0, 0.0], [1.0, 0.0, 0.0]]),
        *(np.full(2, 0.7) for _ in range(5)),
    )
    assert problem(1 / (s * (s + 1)))._origin(both).tolist() == [1.7, 1.0]
    assert problem(s / (s + 1) ** 2)._origin(both).tolist() == [
        0.0,
        0.0,
    ]  # a zero at the origin is no pole
    assert problem(1 / (s + 1))._origin(both).tolist() == [0.7, 0.0]


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


def test_a_crossover_is_looked_for_below_where_the_delay_alone_turns_half_round() -> (
    None
):
    asked = problem(LAG, gain_crossover=None)
    assert asked.crossovers == (
        pytest.approx(1e-3 * math.pi / 0.05),
        pytest.approx(math.pi / 0.05),
    )
    grid = pid_search.crossover_grid(asked)
    assert grid.size == 24 and (grid[0], grid[-1]) == pytest.approx(asked.crossovers)
    with pytest.raises(
        FieldError, match="gain_crossover: left out for a plant without a delay"
    ):
        problem(1 / (s + 1), gain_crossover=None)


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


@pytest.mark.slow
def test_what_the_shipped_law_keeps_is_told_by_how_much(
    made: fl.extend.PidTuning,
) -> None:
    """The same law on plants that are louder than the one it was tuned for."""
    kept = abs(
        made.sampled_margins(
            made.law(output_limit=1.0, measurement_limit=1.0)
        ).phase_margin
    )
    assert math.degrees(kept) == pytest.approx(60.0, abs=1.0) and not made.findings
    (loud,) = _of_law(replace(made, plant=20.0 * made.plant))
    assert (loud.code, loud.severity) == ("W422", "error")
    assert loud.message == "the loop of the shipped law is not stable"
    more = replace(made, phase_margin=kept + fl.deg(1.1))
    (less,) = _of_law(more)
    assert (less.code, less.severity) == ("W422", "warning")
    assert less.evidence == pytest.approx(
        {"asked, °": math.degrees(kept) + 1.1, "kept, °": math.degrees(kept)}, abs=1e-9
    )
    assert not _of_law(replace(made, phase_margin=kept + fl.deg(0.9)))
    (half,) = _of_law(replace(made, phase_margin=2.01 * kept))
    assert (
        half.severity == "error"
        and _of_law(replace(made, phase_margin=1.99 * kept))[0].severity == "warning"
    )
