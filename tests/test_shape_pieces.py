"""The pieces of a shaped move: splines, programme, bounds, candidates and findings,
each by itself.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink import _kernels
from fraclink._arm.shapers import shaper_impulses
from fraclink._simulate import Sensors, Twin
from fraclink._simulate import shape as shape_module
from fraclink._simulate import shaped_move as move_module
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
    Candidate,
    Measured,
    MoveSetting,
    ShapedMove,
    candidates,
    settling,
)
from fraclink.errors import FieldError
from law_bench import law

RIG = fl.Rig.named("paper-2023-geared")
PERIOD = 0.004
MODEL = RIG.model
assert MODEL is not None

Real = NDArray[np.float64]
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


def setting(**own: Any) -> MoveSetting:
    made = MoveSetting(
        law(), ShapedArm(RIG, MODEL, None), MODEL, (0.02, 0.04), False, None
    )
    return replace(made, **own)


def test_bounds_leave_room_for_noise_friction_and_guards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = []
    noise = dict(zip(SIGNALS, (1e-3, 0.1, 1e-3, 0.02, 0.01), strict=True))

    def responses(
        law: Any, arm: Any, payloads: Any, duration: float, *, told: bool
    ) -> Responses:
        asked.append((payloads, duration, told))
        return direct()

    monkeypatch.setattr(move_module, "responses_of", responses)
    monkeypatch.setattr(move_module, "noise_of", lambda *_, told: noise)
    made = setting()
    limits, drive = made.law.limits, made.law.drive
    assert drive is not None
    found, left = made.programme(8.0, 3.0, 0.5)
    assert asked == [(made.between(4), pytest.approx(8 * made.vibration), False)]
    assert left == pytest.approx(4.5 * 0.1 + drive.coulomb_voltage)
    assert found.bounds.signals == pytest.approx(
        {
            "voltage": 8.0 - left,
            "motor_speed": 3.0 - 4.5 * 0.02,
            "torque": 0.5 - 4.5 * 0.01,
            "motor_step": 0.95 * limits.motor_step - 4.5e-3,
        }
    )
    assert found.bounds.velocity == pytest.approx(0.95 * limits.reference_step / PERIOD)
    assert found.bounds.acceleration == pytest.approx(0.95 * limits.acceleration_limit)
    assert found.knot == max(1, round(made.vibration / 0.12))
    wide, _ = made.programme(8.0, None, None)
    assert "motor_speed" not in wide.bounds.signals
    torque = min(4.0, 0.95 * limits.torque_limit) - 0.045
    assert wide.bounds.signals["torque"] == pytest.approx(torque)
    made.longer(found, 4)
    assert asked[-1] == (made.between(4), pytest.approx(32 * made.vibration), False)
    for options, field in (
        ((left, None, None), "voltage"),
        ((8.0, 0.09, None), "speed"),
        ((8.0, None, 0.045), "torque"),
    ):
        with pytest.raises(
            FieldError, match=f"{field}: less than noise and friction take"
        ):
            made.programme(*options)


def test_a_setting_takes_the_middle_payload_and_refuses_none() -> None:
    design: Any = SimpleNamespace(rig=RIG, model=MODEL, payloads=(0.02, 0.04), law=law)
    made = MoveSetting.of(design, None, True, None, 0.05)
    assert made.payloads == (0.02, 0.04) and made.told and made.gauge_offset == 0.05
    assert (
        made.link.payload == pytest.approx(math.sqrt(0.0008))
        and made.law.drive == law().drive
    )
    assert MoveSetting.of(
        design, (0.01, 0.09), False, None, None
    ).link.payload == pytest.approx(0.03)
    unknown: Any = SimpleNamespace(
        rig=RIG, model=replace(MODEL, payload=None), payloads=(0.02, 0.04), law=law
    )
    assert MoveSetting.of(unknown, None, False, None, None).link is unknown.model
    with pytest.raises(FieldError, match="payloads: no payload"):
        MoveSetting.of(design, (0.0, 0.04), False, None, None)


def test_the_worst_of_all_payloads_and_noises_is_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[float, int]] = []

    def run(self: MoveSetting, reference: Any, payload: float, seed: int) -> Any:
        asked.append((payload, seed))
        k = len(asked)
        metrics = SimpleNamespace(
            settling_time=1.0 + (k == 3),
            residual_vibration=0.1 * (k == 2),
            peak_voltage=5.0 + k,
        )
        flags = np.array([_kernels.LAW_FLAG_STARTED, 64 * (k == 4)], dtype=np.uint32)
        time = PERIOD * np.arange(2)
        return SimpleNamespace(
            metrics=metrics,
            flags=flags,
            finished=k != 6,
            tip_angle=0.01 * k + 0 * time,
            time=time,
        )

    monkeypatch.setattr(MoveSetting, "run", run)
    made = setting(payloads=(0.03, 0.03))
    tried = Candidate("quintic", fl.smooth_step(1.0, 0.5), 0.7, 0.01)
    found = made.measured(tried, None, 6)
    assert asked == [(0.03, seed) for seed in range(6)]
    assert found == Measured(
        "quintic",
        0.5,
        0.7,
        2.0,
        pytest.approx(math.nan, nan_ok=True),
        0.1,
        11.0,
        pytest.approx(2 / 6),
    )
    assert found.computing_time == 0.01
    asked.clear()
    along = made.measured(tried, spline_path(np.array([0.0]), 0.1), 4)
    assert along.largest_error == pytest.approx(0.04)
    asked.clear()
    setting().measured(tried, None, 1)
    assert [payload for payload, _ in asked] == pytest.approx(
        np.geomspace(0.02, 0.04, 9)
    )


# ── its rivals
# ──────────────────────────────────────────────────────────────────────────────────────────────


def test_settled_is_the_period_after_the_last_outside_of_any_payload() -> None:
    tip = np.ones((2, 100))
    tip[0, 40], tip[1, 60] = 1.021, 0.979
    assert settling(tip, 1.0, 0.02, PERIOD) == pytest.approx(61 * PERIOD)
    assert settling(tip, 1.0, 0.0211, PERIOD) == 0.0
    tip[1, 99] = 0.9
    assert settling(tip, 1.0, 0.02, PERIOD) == math.inf


VIBRATION = 2 * math.pi / abs(MODEL.pole.imag)


def test_quintics_and_shapers_are_tried_at_every_duration_and_frequency() -> None:
    durations = np.geomspace(0.15, 4.0, 40) * VIBRATION
    quintics = list(move_module._tried(None, 1.0, MODEL))
    assert [each.duration for _, each in quintics] == pytest.approx(durations)
    assert [name for name, _ in quintics] == [
        f"quintic of {duration:.2f} s" for duration in durations
    ]
    shaped = list(move_module._tried("ZVD", 1.0, MODEL))
    assert len(shaped) == 400
    frequency, ratio = abs(MODEL.pole), -MODEL.pole.real / abs(MODEL.pole)
    for k, factor in enumerate(np.linspace(0.7, 1.6, 10)):
        times, _ = shaper_impulses("ZVD", factor * frequency, ratio)
        name, each = shaped[30 + k]
        assert each.duration == pytest.approx(durations[3] + times[-1])
        assert (
            name
            == f"ZVD at {factor * frequency:.1f} rad/s on a quintic of {durations[3]:.2f} s"
        )
        assert float(each.angle(9.0)) == pytest.approx(1.0)


def test_the_first_to_settle_within_the_bounds_is_the_candidate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a loop that follows its reference, the shortest quintic that keeps velocity
    and acceleration.
    """
    monkeypatch.setattr(move_module, "_DURATIONS", np.array([0.5, 1.0, 1.5, 2.0]))
    monkeypatch.setattr(move_module, "_FREQUENCIES", np.array([1.0, 1.2]))

    def best(**bounds: float) -> dict[str, Candidate]:
        whole = {"voltage": 1e6, "velocity": 1e6, "acceleration": 1e6} | bounds
        made = MoveBounds({"voltage": whole.pop("voltage")}, **whole)
        return {
            each.name.split()[0]: each
            for each in candidates(direct(500), 1.0, 0.02, made, MODEL)
        }

    durations = np.array([0.5, 1.0, 1.5, 2.0]) * VIBRATION
    found = best(velocity=4.0)
    assert list(found) == ["quintic", "ZV", "ZVD", "EI"]
    # A quintic's largest speed is 15/8 of its mean, its largest acceleration 10/√3 over
    # the time squared.
    assert found["quintic"].reference.duration == pytest.approx(
        durations[1.875 / durations <= 4.0].min()
    )
    first, *_ = shaper_impulses(
        "ZV", 1.2 * abs(MODEL.pole), -MODEL.pole.real / abs(MODEL.pole)
    )
    assert best()["ZV"].reference.duration == pytest.approx(durations[0] + first[-1])
    quickest = durations[10 / math.sqrt(3) / durations**2 <= 12.0].min()
    assert best(acceleration=12.0)["quintic"].reference.duration == pytest.approx(
        quickest
    )
    assert best(voltage=12.0)["quintic"].reference.duration == pytest.approx(quickest)
    assert quickest == durations[2] and best()[
        "quintic"
    ].reference.duration == pytest.approx(durations[0])
    assert best(voltage=1e-6) == {}


# ── the search and what is said of it
# ───────────────────────────────────────────────────────────────────────


def test_a_longer_reference_gets_fewer_knots() -> None:
    plain = programme()
    assert shape_module._coarse(plain, 0.5) is plain
    long = shape_module._coarse(programme(), 58 * 0.02 + 1e-3)  # 61 coefficients
    assert long.knot == 10 and shape_module._coarse(programme(), 58 * 0.02).knot == 5
    assert shape_module._coarse(programme(), 4.0).knot == 20  # 202


def test_the_shortest_settling_is_found_by_bisection() -> None:
    """A loop that follows its reference settles as soon as that may come within the
    band.
    """
    bounds = MoveBounds({}, velocity=5.0, acceleration=1e4)
    own: Any = SimpleNamespace(vibration=0.1, longer=None)
    found, made = shape_module._fastest(
        own, Programme(direct(200), 2, bounds), 1.0, 0.25
    )
    path = made.path(found)
    time = PERIOD * np.arange(200)
    late = (
        np.flatnonzero(np.abs(path.angle(time) - 1.0) > 0.75 * 0.02 * (1 + 1e-3))[-1]
        + 1
    )
    # 0.985 rad at 5 rad/s are 0.197 s, and a knot's length to get there.
    assert 50 <= late <= 55
    assert np.abs(path.velocity(np.linspace(0, 1, 2001))).max() <= 5.0 * (1 + 1e-3)


@pytest.mark.slow
def test_a_move_that_no_length_allows_is_refused() -> None:
    bounds = MoveBounds({}, velocity=1e-3, acceleration=1e4)
    asked: list[int] = []

    def longer(made: Programme, factor: int) -> Programme:
        asked.append(factor)
        return replace(made, loops=direct(200 * factor))

    own: Any = SimpleNamespace(vibration=0.4, longer=longer)
    with pytest.raises(FieldError, match=r"move: not reached .* settles within 12.8 s"):
        shape_module._fastest(own, Programme(direct(200), 5, bounds), 1.0, 0.25)
    assert asked == [2, 4, 8, 16]


def test_a_path_is_followed_from_rest_at_0_and_within_what_is_known() -> None:
    wanted = spline_path(np.array([0.2, 0.3]), 0.1)
    found = shape_module._following(programme(), wanted)
    assert shape_module._distance(
        direct(), programme().path(found), wanted
    ) == pytest.approx(found.distance, abs=1e-3)
    assert found.distance < 5e-3
    with pytest.raises(FieldError, match=r"move: too long a path .* <= 0.78 s"):
        shape_module._following(programme(), spline_path(np.array([0.1] * 6), 0.1))
    begun = replace(wanted, coefficients=wanted.coefficients + 0.1 * np.eye(1, 4))
    with pytest.raises(FieldError, match="move: not at 0 at first"):
        shape_module._following(programme(), begun)
    with pytest.raises(FieldError, match="not to be followed"):
        shape_module._following(programme(MoveBounds({}, 1e-3, 1e-3)), wanted)


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


@pytest.mark.parametrize(
    ("best", "codes"),
    [
        (measured(), []),
        (measured(settling_time=0.6 + 1.49 * PERIOD), []),
        (measured(settling_time=0.6 + 1.51 * PERIOD), ["W501"]),
        (measured(peak_voltage=8.0), []),
        (measured(peak_voltage=8.01, limited=0.2), ["W502", "W503"]),
    ],
)
def test_what_a_move_did_not_keep_is_a_finding(
    best: Measured, codes: list[str]
) -> None:
    found = shape_module._findings(moved(best))
    assert [finding.code for finding in found] == codes
    assert replace(moved(best), findings=found).passed == (not codes)
    evidence = {finding.code: dict(finding.evidence) for finding in found}
    assert evidence.get("W502", {"measured": 8.01, "limit": 8.0, "left_to_them": 1.0}) == {
        "measured": 8.01, "limit": 8.0, "left_to_them": 1.0,
    }  # fmt: skip
    assert evidence.get("W503", {"part_of_the_runs": 0.2}) == {"part_of_the_runs": 0.2}


@pytest.mark.parametrize(
    ("error", "predicted", "codes"),
    [
        (0.0149, 0.01, []),  # a quarter of 2 % of the path's span of 1 rad more
        (0.0151, 0.01, ["W501"]),
        (0.1, 0.1, []),
        (0.1001, 0.1001, ["W504"]),
    ],
)
def test_a_path_that_is_not_followed_is_a_finding(
    error: float, predicted: float, codes: list[str]
) -> None:
    best = measured(largest_error=error, predicted=predicted, settling_time=math.inf)
    found = shape_module._findings(
        moved(best, target=spline_path(np.array([1.0]), 0.1))
    )
    assert [finding.code for finding in found] == codes


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
