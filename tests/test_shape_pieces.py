"""The pieces of a shaped move: splines, programme, bounds, candidates and findings,
each by itself.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink._simulate import Sensors, Twin
from fraclink._simulate.shape_programme import (
    SIGNALS,
    MoveBounds,
    MoveSolution,
    Programme,
    Responses,
    ShapedArm,
    noise_of,
    responses_of,
    spline_path,
    without_friction,
)
from fraclink._simulate.shaped_move import (
    Measured,
    MoveSetting,
    ShapedMove,
    settling,
)
from fraclink.errors import FieldError
from law_bench import law

RIG = fl.Rig.named("paper-2023-geared")
PERIOD = 0.004
MODEL = RIG.model
assert MODEL is not None

FREE = MoveBounds({"voltage": 100.0}, velocity=100.0, acceleration=1000.0)


def direct(
    count: int = 200, payloads: int = 1, gains: tuple[float, ...] = (1.0,)
) -> Responses:
    """Loops whose tip is the reference times a gain, whose voltage is its acceleration,
    and no more.
    """
    impulses = np.zeros((payloads, 2, len(SIGNALS), count))
    for p in range(payloads):
        impulses[p, 0, SIGNALS.index("tip"), 0] = gains[p % len(gains)]
        impulses[p, 1, SIGNALS.index("voltage"), 0] = 1.0
    return Responses(tuple(0.01 * (k + 1) for k in range(payloads)), PERIOD, impulses)


def programme(bounds: MoveBounds = FREE, knot: int = 5, **own: Any) -> Programme:
    return Programme(direct(**own), knot, bounds)


# ── the linear loop
# ─────────────────────────────────────────────────────────────────────────────────────────


def test_responses_are_summed_along_a_reference() -> None:
    """Angle and acceleration of each period, times their impulse responses, by a plain
    convolution.
    """
    rng = np.random.default_rng(2)
    impulses = rng.standard_normal((2, 2, len(SIGNALS), 60))
    loops = Responses((0.02, 0.04), PERIOD, impulses)
    assert loops.length == 60
    move = fl.smooth_step(0.5, 0.1, 0.02)
    time = PERIOD * np.arange(60)
    inputs = move.angle(time), move.acceleration(time)
    found = loops.to(move, ("torque", "tip"))
    assert found.shape == (2, 2, 60)
    for p in range(2):
        for k, name in enumerate(("torque", "tip")):
            row = SIGNALS.index(name)
            wanted = sum(
                np.convolve(inputs[i], impulses[p, i, row])[:60] for i in (0, 1)
            )
            assert found[p, k] == pytest.approx(wanted, abs=1e-9)


def test_a_spline_is_the_sum_of_its_smooth_steps() -> None:
    """One step of 1 rad: 1/6, 5/6 and 1 at its knots, by the quadratic spline of its
    velocity.
    """
    one = spline_path(np.array([1.0]), 0.1)
    assert one.duration == pytest.approx(0.3)
    assert one.angle([0.0, 0.1, 0.2, 0.3, 1.0]) == pytest.approx(
        [0, 1 / 6, 5 / 6, 1, 1]
    )
    assert one.velocity([0.0, 0.1, 0.15, 0.2, 0.3]) == pytest.approx(
        [0, 5.0, 7.5, 5.0, 0], abs=1e-9
    )
    assert one.acceleration([0.05, 0.15, 0.25]) == pytest.approx(
        [50.0, 0.0, -50.0], abs=1e-9
    )
    both = spline_path(np.array([0.3, -0.2]), 0.1)
    later = np.array([0.05, 0.17, 0.31, 0.6])
    assert both.duration == pytest.approx(0.4)
    assert both.angle(later) == pytest.approx(
        0.3 * one.angle(later) - 0.2 * one.angle(later - 0.1), abs=1e-12
    )


@pytest.mark.parametrize(
    ("time", "count"), [(0.0, 3), (0.02, 3), (0.0201, 4), (0.04, 4), (0.1, 7)]
)
def test_a_reference_goes_on_for_two_knots(time: float, count: int) -> None:
    assert programme().count_for(time) == count


def test_the_programme_keeps_to_the_target_and_to_every_bound() -> None:
    made = programme(MoveBounds({"voltage": 30.0}, velocity=4.0, acceleration=35.0))
    count = 30  # 32 knots of 20 ms
    target = np.ones(200)
    found = made.solve(count, target, 120, 200)
    assert found is not None
    path = made.path(found)
    time = np.linspace(0.0, 0.8, 4001)
    assert (
        float(path.angle(10.0))
        == pytest.approx(1.0, abs=1e-9)
        == found.coefficients.sum()
    )
    assert np.abs(path.velocity(time)).max() <= 4.0 * (1 + 1e-3)
    assert np.abs(path.acceleration(time)).max() <= 30.0 * (
        1 + 1e-3
    )  # the voltage is the smaller bound
    tip = path.angle(PERIOD * np.arange(200))
    assert found.distance == pytest.approx(np.abs(tip[120:] - 1.0).max(), abs=2e-3)
    # Bang-bang: 1 rad with ±30 rad/s² and at most 4 rad/s takes 2·√(1/30) = 0.365 s;
    # not half of that.
    assert made.solve(made.count_for(0.16), target, 40, 200) is None


def test_limits_are_kept_until_a_tenth_of_a_second_behind_the_reference() -> None:
    """Two rows for each period and signal; the tip's where it is asked for, the
    reference's at its knots.
    """
    made = programme(MoveBounds({"voltage": 1.0, "torque": 2.0}, 3.0, 4.0), payloads=2)
    rows, sides = made._kept(10, np.ones(200), 60, 90)
    watched = 10 * 5 + 25
    assert len(rows) == len(sides) == 2 * 2 * (30 + 2 * watched) + 2 * 10 + 2 * 11
    assert (
        np.count_nonzero(rows[:, -1] == -1.0) == 2 * 2 * 30
    )  # the distance, in the tip's rows alone
    assert sorted(set(sides.tolist())) == [-1.0, 1.0, 2.0, 3.0, 4.0]
    short = programme(MoveBounds({"voltage": 1.0}, 3.0, 4.0))._kept(
        36, np.ones(200), 60, 90
    )[0]
    assert len(short) == 2 * (30 + 200) + 2 * 36 + 2 * 37  # no more than is known


def test_the_farthest_of_all_payloads_counts() -> None:
    made = programme(payloads=2, gains=(0.8, 1.2))
    found = made.solve(10, np.ones(200), 100, 200)
    assert found is not None and found.distance == pytest.approx(0.2, abs=1e-3)
    gentle = made.solve(10, np.ones(200), 100, 200, within=0.25)
    assert gentle is not None and gentle.distance <= 0.25 + 1e-3
    assert made.solve(10, np.ones(200), 100, 200, within=0.1) is None


def test_differences_of_the_acceleration_are_counted_from_rest_to_rest() -> None:
    made = programme()
    jerk = made._jerk(3)
    step = 5 * PERIOD
    coefficients = np.array([0.2, 0.5, 0.3])
    acceleration = np.diff(np.r_[0.0, coefficients, 0.0]) / step**2
    wanted = np.diff(np.r_[0.0, acceleration, 0.0]) / 1000.0
    assert jerk.shape == (5, 4) and jerk[:, :3] @ coefficients == pytest.approx(wanted)
    assert np.all(jerk[:, 3] == 0.0)  # the distance has no jerk


# ── the arm that it is shaped for
# ───────────────────────────────────────────────────────────────────────────


def test_an_arm_without_friction_has_no_limit_either() -> None:
    twin = Twin.from_rig(RIG, link_mass=0.0)
    for arm in (ShapedArm(RIG, MODEL, None), ShapedArm(RIG, MODEL, twin)):
        free, plain = without_friction(law("single"), arm)
        assert free.drive is not None and free.precision == "double"
        assert (free.drive.coulomb_voltage, free.drive.voltage_limit) == (0.0, 1e4)
        assert plain.voltage_limit == 1e4 and plain.rig.motor.coulomb_torque == 0.0
        assert plain.twin is None or (plain.twin.coulomb, plain.twin.breakaway) == (
            0.0,
            0.0,
        )
        assert arm.voltage_limit == 10.0 and arm.gauge_limit == 4.0
        exact = arm.with_exact_sensors()
        assert (
            exact.gauge_limit == math.inf
            and exact.rig.encoder.counts_per_revolution is None
        )
        assert (
            exact.rig.gauge.noise,
            exact.rig.gauge.quantum,
            exact.rig.gauge.offset,
        ) == (0.0, 0.0, 0.0)
        if exact.twin is not None:
            assert exact.twin.sensors == Sensors()
    late = replace(
        twin,
        sensors=replace(
            twin.sensors, gauge_delay=0.003, gauge_drift=0.1, gauge_gain=1.1
        ),
    )
    kept = ShapedArm(RIG, MODEL, late).with_exact_sensors().twin
    assert kept is not None and kept.sensors == Sensors(
        gauge_delay=0.003, gauge_gain=1.1
    )
    with pytest.raises(FieldError, match="law: without a voltage"):
        without_friction(replace(law(), drive=None), ShapedArm(RIG, MODEL, None))


def test_signals_of_the_model_have_a_speed_by_differences() -> None:
    arm = ShapedArm(RIG, MODEL, None).with_exact_sensors()
    free, plain = without_friction(law(), arm)
    loops = responses_of(law(), arm, (0.03,), 0.4, told=False)
    assert (
        loops.payloads == (0.03,)
        and loops.period == PERIOD
        and loops.impulses.shape == (1, 2, 5, 101)
    )
    move = fl.smooth_step(0.1, 0.2)
    run = plain.run(free, move, 0.03, 0.3, told=False)
    found = dict(zip(SIGNALS, loops.to(move)[0], strict=True))
    speed = np.diff(run.motor_angle, prepend=0.0) / PERIOD
    assert found["motor_speed"][:76] == pytest.approx(speed, abs=1e-6)
    assert found["motor_step"][:76] == pytest.approx(
        np.diff(run.motor_reference, prepend=0.0), abs=1e-8
    )


def test_noise_is_a_standard_deviation_at_rest_and_none_without_a_gauges() -> None:
    loud, still = (
        ShapedArm(RIG, MODEL, None),
        ShapedArm(RIG, MODEL, None).with_exact_sensors(),
    )
    assert noise_of(law(), still, 0.03, told=False) == pytest.approx(
        dict.fromkeys(SIGNALS, 0.0), abs=1e-12
    )
    found = noise_of(law(), loud, 0.03, told=False)
    assert list(found) == list(SIGNALS) and 0.01 < found["voltage"] < 1.0
    offset = replace(RIG, gauge=replace(RIG.gauge, offset=0.5))  # an offset is no noise
    assert noise_of(
        law(), ShapedArm(offset, MODEL, None), 0.03, told=False
    ) == pytest.approx(found)


@pytest.mark.parametrize(
    ("payloads", "steps", "between"),
    [
        ((0.02, 0.04), 4, (0.02, 0.02 * math.sqrt(2), 0.04)),  # ln 2 / 0.2 = 3.5
        ((0.03, 0.03), 2, (0.03,)),
        ((0.02, 0.021), 2, (0.02, math.sqrt(0.02 * 0.021), 0.021)),
        ((0.008, 0.08), 12, (0.008, math.sqrt(0.00064), 0.08)),
    ],
)
def test_payloads_stand_so_near_that_the_frequency_changes_by_a_tenth(
    payloads: tuple[float, float], steps: int, between: tuple[float, ...]
) -> None:
    made = MoveSetting(law(), ShapedArm(RIG, MODEL, None), MODEL, payloads, False, None)
    assert made.steps == steps and made.between(2) == pytest.approx(between)
    assert made.vibration == pytest.approx(2 * math.pi / abs(MODEL.pole.imag))


# ── its rivals
# ──────────────────────────────────────────────────────────────────────────────────────────────


def test_settled_is_the_period_after_the_last_outside_of_any_payload() -> None:
    tip = np.ones((2, 100))
    tip[0, 40], tip[1, 60] = 1.021, 0.979
    assert settling(tip, 1.0, 0.02, PERIOD) == pytest.approx(61 * PERIOD)
    assert settling(tip, 1.0, 0.0211, PERIOD) == 0.0
    tip[1, 99] = 0.9
    assert settling(tip, 1.0, 0.02, PERIOD) == math.inf


# ── the search and what is said of it
# ───────────────────────────────────────────────────────────────────────


def measured(**own: Any) -> Measured:
    return replace(Measured("shaped", 0.5, 0.6, 0.6, math.nan, 0.0, 7.9, 0.0), **own)


def moved(
    best: Measured, *, target: Any = None, voltage: float = 8.0, kept_back: float = 1.0
) -> ShapedMove:
    path = spline_path(np.array([1.0]), 0.1)
    nothing = np.zeros((1, 200))
    return ShapedMove(
        path, PERIOD, target, (0.03, 0.03), False, voltage, kept_back, 0.25, (best,), 1, np.array([0.03]),
        nothing, nothing, "0",
    )  # fmt: skip


def test_a_move_is_saved_with_all_but_the_time_that_it_took(tmp_path: Path) -> None:
    made = replace(
        moved(measured(computing_time=3.0)), target=spline_path(np.array([0.5]), 0.1)
    )
    made.save(tmp_path / "move.json")
    back = ShapedMove.load(tmp_path / "move.json")
    assert back == made and math.isnan(back.shaped.computing_time)
    assert back.target is not None and float(back.target.angle(1.0)) == pytest.approx(
        0.5
    )
    made.save(tmp_path / "move.json")  # over itself


@pytest.mark.slow
def test_a_move_knows_its_amplitude_and_its_first() -> None:
    made = moved(measured())
    assert made.amplitude == pytest.approx(1.0) and made.shaped is made.measured[0]
    assert made.settling_time == 0.6
    with pytest.raises(ValueError, match="read-only"):
        made.tip_angle[0, 0] = 1.0
    assert MoveSolution(np.ones(2), 0.1).distance == 0.1
