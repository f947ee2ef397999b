"""The numbers between a rig and the compiled arm: sensors, inputs of a run, the twin,
the page's engine.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink import _kernels
from fraclink._arm.link import LinkModel, SecondMode
from fraclink._law import MODES
from fraclink._law.estimator import Estimates
from fraclink._simulate import (
    FractionalKelvinVoigt,
    KelvinVoigt,
    Obstacle,
    PayloadChange,
    PowerLaw,
    Restart,
    SensorFault,
    Sensors,
    TipPulse,
    Twin,
    damping_of,
    geared,
)
from fraclink._simulate import sensors as columns
from fraclink._simulate.engine import (
    engine_link,
    engine_noise,
    engine_rig,
    engine_twin,
    twin_noise,
)
from fraclink._simulate.estimates import (
    estimate_findings,
    estimate_signals,
    estimated_over,
    estimator_for,
    joined,
)
from fraclink._simulate.kernel import ArmState, apply, drive_of, twin_numbers
from fraclink._simulate.links import link_weights, second_mode_weights
from fraclink._simulate.on_twin import with_motor_loop
from fraclink._simulate.plant import resolved, substeps
from fraclink._simulate.run import payload_rejected
from fraclink._simulate.sensors import (
    delay_line,
    fault_rows,
    given_payload,
    healthy_inputs,
    segments,
)
from fraclink._simulate.simulate import link_at
from fraclink.errors import FieldError
from law_bench import law

PERIOD = 0.004
RIG = fl.Rig.named("paper-2023")
GEARED = geared(RIG)
MODEL = RIG.model
assert MODEL is not None


# ── sensors
# ─────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("delay", [0.25, 0.5, 0.99, 1.0 + 2e-6, 1.5, 2.75, 17.3, 99.5])
def test_a_delay_between_two_steps_is_the_cubic_through_four(delay: float) -> None:
    """Exact for every cubic; the delay lies between the two middle entries where the
    queue is long enough.
    """
    oldest, weights = delay_line(delay)
    ages = oldest - np.arange(4.0)  # the oldest first
    for power in range(4):
        assert weights @ ages**power == pytest.approx(delay**power, rel=1e-9, abs=1e-9)
    assert oldest == max(math.floor(delay) + 2, 3)


@pytest.mark.parametrize(
    ("delay", "whole"), [(0.0, 0), (5e-7, 0), (1.0, 1), (7.0 - 9e-7, 7), (100.0, 100)]
)
def test_a_whole_delay_is_one_entry(delay: float, whole: int) -> None:
    oldest, weights = delay_line(delay)
    assert (oldest, weights.tolist()) == (whole, [1.0, 0.0, 0.0, 0.0])


def test_a_late_gauge_begins_with_the_first_torque() -> None:
    torque = np.array([2.0, 3.0, 5.0, 8.0])
    assert Sensors(gauge_delay=0.008).delayed(torque, PERIOD).tolist() == [
        2.0,
        2.0,
        2.0,
        3.0,
    ]
    line = 1.0 + 0.5 * np.arange(8.0)
    late = Sensors(gauge_delay=0.006).delayed(line, PERIOD)
    assert late[4:] == pytest.approx(line[4:] - 0.75) and late.size == 8


def test_an_encoder_counts_to_the_nearest_and_a_continuous_one_does_not() -> None:
    sensors = Sensors(counts_per_revolution=8)
    quantum = math.pi / 4
    assert (
        sensors.angle_quantum == pytest.approx(quantum)
        and Sensors().angle_quantum == 0.0
    )
    angle = quantum * np.array([-0.51, -0.49, 0.49, 0.51, 1.49, 7.6])
    assert sensors.encoder(angle) / quantum == pytest.approx([-1, 0, 0, 1, 1, 8])
    assert Sensors().encoder(angle).tolist() == angle.tolist()


def test_a_gauge_has_gain_offset_drift_then_noise_its_range_and_its_converter() -> None:
    sensors = Sensors(gauge_gain=-2.0, gauge_offset=0.1, gauge_drift=0.5)
    torque = np.array([0.0, 1.0, -0.3])
    exact = sensors.gauge(torque, period=0.01, start=2.0)
    assert exact == pytest.approx([1.1, -0.895, 1.71])
    assert replace(sensors, gauge_limit=1.0).gauge(
        torque, period=0.01, start=2.0
    ) == pytest.approx([1.0, -0.895, 1.0])
    # The converter rounds what the amplifier has clipped: the last step may lie beyond
    # the limit.
    coarse = replace(sensors, gauge_limit=1.0, gauge_quantum=0.3)
    assert coarse.gauge(torque, period=0.01, start=2.0) == pytest.approx(
        [0.9, -0.9, 0.9]
    )
    noisy = replace(sensors, gauge_noise=0.05)
    drawn = noisy.gauge(
        torque, period=0.01, start=2.0, generator=np.random.default_rng(4)
    )
    assert drawn - exact == pytest.approx(
        0.05 * np.random.default_rng(4).standard_normal(3)
    )
    with pytest.raises(FieldError, match=r"generator: missing|generator is required"):
        noisy.gauge(torque, period=0.01)


# ── what comes from outside
# ─────────────────────────────────────────────────────────────────────────────────


def test_a_healthy_run_has_the_reference_and_the_gauges_error() -> None:
    sensors = Sensors(gauge_offset=0.2, gauge_drift=0.3, gauge_noise=0.01)
    move = fl.smooth_step(1.0, 0.5, 0.1)
    found = healthy_inputs(sensors, move, PERIOD, 200, np.random.default_rng(6))
    time = PERIOD * np.arange(200)
    wanted = np.zeros((200, _kernels.TWIN_INPUTS))
    wanted[:, 0], wanted[:, 1], wanted[:, 2] = (
        move.angle(time),
        move.velocity(time),
        move.acceleration(time),
    )
    wanted[:, 3] = (
        0.2 + 0.3 * time + 0.01 * np.random.default_rng(6).standard_normal(200)
    )
    wanted[:, columns.ENCODER_GAIN] = wanted[:, columns.GAUGE_GAIN] = 1.0
    assert np.allclose(found, wanted, rtol=1e-12, atol=1e-15)
    assert twin_noise(6, 200) == pytest.approx(
        np.random.default_rng(6).standard_normal(200)
    )


def test_a_run_is_cut_where_the_arm_changes_and_pulses_and_faults_are_written() -> None:
    change, stop, pulse = (
        PayloadChange(0.1, 0.02),
        Obstacle(0.1, 0.2, 0.3),
        TipPulse(0.041, 0.5, 0.02),
    )
    again = Restart(0.05)
    inputs = np.zeros((100, _kernels.TWIN_INPUTS))
    cut = segments([change, stop, pulse, again], PERIOD, inputs)
    assert cut == [
        (0, 12, []),
        (12, 25, [again]),
        (25, 50, [change, stop]),
        (50, 100, [None]),
    ]
    force = inputs[:, columns.TIP_FORCE]
    assert np.flatnonzero(force).tolist() == list(range(10, 15)) and force[10] == 0.5
    # A pulse shorter than half a period still acts for one; two at once add.
    inputs[:] = 0.0
    segments([TipPulse(0.2, 0.5, 1e-4), TipPulse(0.2, 0.25, 0.008)], PERIOD, inputs)
    assert inputs[49:53, columns.TIP_FORCE].tolist() == [0.0, 0.75, 0.25, 0.0]


def test_what_comes_at_the_end_or_behind_it_changes_nothing() -> None:
    inputs = np.zeros((100, _kernels.TWIN_INPUTS))
    late = [PayloadChange(0.4, 0.02), PayloadChange(9.0, 0.03), Obstacle(0.3, 9.0, 0.3)]
    assert [part[:2] for part in segments(late, PERIOD, inputs)] == [(0, 75), (75, 100)]
    assert segments([PayloadChange(0.396, 0.02)], PERIOD, inputs)[-1][:2] == (99, 100)
    first = PayloadChange(0.0, 0.02)
    assert segments([first], PERIOD, inputs) == [(0, 100, [first])]


def test_faults_add_their_bits_and_errors_and_set_their_gains() -> None:
    rows = fault_rows(
        (
            SensorFault(0.04, 0.08, "encoder frozen"),
            SensorFault(0.06, 0.1, "gauge value", math.nan),
            SensorFault(0.06, 0.1, "gauge offset", 0.25),
            SensorFault(0.06, 0.06 + 1e-9, "gauge offset", 0.5),
            SensorFault(0.04, 0.08, "gauge gain", -2.0),
            SensorFault(0.06, 0.1, "gauge gain", 3.0),
        ),
        PERIOD,
        30,
    )
    assert (
        rows[:, columns.FAULT_BITS].tolist()
        == [0.0] * 10 + [4.0] * 5 + [6.0] * 5 + [2.0] * 5 + [0.0] * 5
    )
    assert (
        rows[:, columns.GAUGE_ERROR].tolist()
        == [0.0] * 15 + [0.75] + [0.25] * 9 + [0.0] * 5
    )
    assert (
        rows[:, columns.GAUGE_GAIN].tolist()
        == [1.0] * 10 + [-2.0] * 5 + [3.0] * 10 + [1.0] * 5
    )
    assert np.flatnonzero(np.isnan(rows[:, columns.GAUGE_VALUE])).tolist() == list(
        range(15, 25)
    )
    assert np.all(rows[:, columns.ENCODER_GAIN] == 1.0)


@pytest.mark.parametrize(
    ("kind", "bit", "column"),
    [
        ("encoder value", 1, "ENCODER_VALUE"),
        ("gauge value", 2, "GAUGE_VALUE"),
        ("channels swapped", 16, None),
        ("tick missed", 32, None),
        ("tick repeated", 64, None),
        ("gauge frozen", 8, None),
        ("encoder gain", 0, "ENCODER_GAIN"),
        ("encoder offset", 0, "ENCODER_ERROR"),
    ],
)
def test_every_kind_of_fault_has_its_bit_and_its_column(
    kind: str, bit: int, column: str | None
) -> None:
    (row,) = fault_rows(
        (SensorFault(0.0, 1.0, kind, 0.5 if column else None),), PERIOD, 1
    )
    plain = fault_rows((), PERIOD, 1)[0]
    changed = {columns.FAULT_BITS} if bit else set()
    if column:
        changed.add(getattr(columns, column))
        assert row[getattr(columns, column)] == 0.5
    assert (
        row[columns.FAULT_BITS] == bit
        and set(np.flatnonzero(row != plain).tolist()) == changed
    )


def test_what_the_law_is_told_of_the_payload() -> None:
    assert given_payload(True, 0.03) == 0.03 and given_payload(False, 0.03) == 0.0
    assert given_payload(0.02, 0.03) == 0.02 and given_payload("estimated", 0.03) == 0.0
    with pytest.raises(FieldError, match="told: without a payload"):
        given_payload(True, None)


def test_a_link_is_taken_to_another_payload_by_its_own_or_by_the_rig() -> None:
    assert link_at(MODEL, RIG, MODEL.payload or 0.0) is MODEL
    light = link_at(MODEL, RIG, 0.0075)  # a quarter of 30 g: twice the frequency
    assert (
        light.natural_frequency == pytest.approx(2 * MODEL.natural_frequency)
        and light.payload == 0.0075
    )
    unknown = link_at(replace(MODEL, payload=None, natural_frequency=9.0), RIG, 0.02)
    assert unknown.natural_frequency == pytest.approx(
        math.sqrt(1.56 / (0.02 * 0.65**2))
    )
    assert unknown.payload == 0.02


# ── the twin's own numbers
# ──────────────────────────────────────────────────────────────────────────────────


def test_the_kernel_gets_motor_amplifier_and_sensors_at_the_gears_output() -> None:
    sensors = Sensors(2000, gauge_quantum=0.01, gauge_gain=1.1, gauge_delay=0.0025)
    twin = replace(Twin.from_rig(GEARED), sensors=sensors, voltage_delay=3)
    found = twin_numbers(twin, PERIOD)
    oldest, weights = delay_line(2.5)  # of four steps of 1 ms in a period
    wanted = [
        4,
        3,
        oldest,
        50 * 0.21,
        10.0,
        50 * 0.02,
        1.2 * 50 * 0.02,
        2 * math.pi / 2000,
        0.01,
        math.inf,
        1.1,
    ]
    assert found == pytest.approx([*wanted, *weights]) and found.shape == (15,)
    assert (
        twin_numbers(replace(twin, sensors=replace(sensors, gauge_limit=4.0)), PERIOD)[
            9
        ]
        == 4.0
    )
    assert twin_numbers(replace(twin, stiction=0.05), PERIOD)[6] == pytest.approx(
        50 * 0.05
    )
    assert twin_numbers(replace(twin, stiction=0.02), PERIOD)[6] == pytest.approx(
        50 * 0.02
    )  # at its least


@pytest.mark.parametrize(
    ("period", "step", "count"),
    [
        (0.004, 0.001, 4),
        (0.001, 0.001, 1),
        (0.0005, 0.001, 1),
        (0.0041, 0.001, 5),
        (0.003 * (1 + 1e-12), 0.001, 3),
    ],
)
def test_a_period_is_filled_by_equal_steps(
    period: float, step: float, count: int
) -> None:
    assert substeps(period, step) == count


def test_a_light_hub_is_a_finding_with_its_numbers() -> None:
    """A tenth of the arm's own inertia is where the compensation of the coupling torque
    begins to feed it.
    """
    arm = 0.030 * 0.65**2
    for share, codes in ((0.0999, ["W601"]), (0.1001, [])):
        rig = replace(RIG, motor=replace(RIG.motor, inertia=share * arm))
        assert [f.code for f in Twin.from_rig(rig, link_mass=0.0).findings] == codes
    (finding,) = Twin.from_rig(RIG, link_mass=0.0).findings
    assert (
        finding.severity == "warning"
        and "is 0.54 % of the arm's 0.0127 kg·m²" in finding.message
    )
    assert finding.evidence == {
        "hub_inertia": pytest.approx(6.87e-5),
        "arm_inertia": pytest.approx(arm),
    }
    twin = Twin.from_rig(GEARED, link_mass=0.0)
    assert twin.findings == () and twin.hub_inertia == pytest.approx(2500 * 6.87e-5)
    assert twin.coulomb == pytest.approx(1.0) and twin.breakaway == pytest.approx(1.2)
    assert (
        GEARED.motor.gear_ratio == 50.0 and geared(RIG, 100.0).motor.gear_ratio == 100.0
    )


def test_the_vibration_of_a_power_law_is_not_at_its_natural_frequency() -> None:
    """ω is in s^(−λ/2); |s^λ| = ω² puts the mode at ω^(2/λ) rad/s."""
    twin = Twin.from_rig(RIG, link_mass=0.0)
    frequency = math.sqrt(1.56 / (0.030 * 0.65**2))
    assert isinstance(twin.damping, PowerLaw)
    assert twin.vibration_period == pytest.approx(
        2 * math.pi / frequency ** (2 / 1.92), rel=1e-6
    )
    viscous = replace(twin, damping=KelvinVoigt(0.01))
    assert viscous.vibration_period == pytest.approx(2 * math.pi / frequency, rel=1e-6)


def test_a_model_is_the_material_of_its_massless_link() -> None:
    square = 11.0**2
    assert damping_of(LinkModel(1.56, 11.0)) == KelvinVoigt(0.0)
    assert damping_of(LinkModel(1.56, 11.0, damping=0.5)) == KelvinVoigt(0.5 / square)
    fractional = LinkModel(1.56, 11.0, damping=0.5, damping_order=0.6)
    assert damping_of(fractional) == FractionalKelvinVoigt(0.5 / square, 0.6)
    assert damping_of(replace(fractional, damping=0.0)) == KelvinVoigt(0.0)
    assert damping_of(LinkModel(1.56, 11.0, order=1.9)) == PowerLaw(1.9)
    assert KelvinVoigt.from_ratio(0.1, frequency=8.0).time == pytest.approx(0.025)
    labels = [
        damping_of(fractional).label,
        KelvinVoigt(0.0125).label,
        PowerLaw(1.92).label,
    ]
    assert labels == [
        f"fractional, D = 1 + {0.5 / square:g} s^0.6",
        "viscous, D = 1 + 0.0125 s",
        "power law, D = s^0.08 (lambda = 1.92)",
    ]


@pytest.mark.parametrize(
    ("factor", "refused"), [(0.81, False), (1.19, False), (0.79, True), (1.21, True)]
)
def test_a_model_that_is_another_arm_is_refused_beyond_a_fifth(
    factor: float, refused: bool
) -> None:
    other = replace(
        MODEL, natural_frequency=factor * RIG.natural_frequency(0.030), payload=0.030
    )
    if refused:
        with pytest.raises(
            FieldError, match=r"model\.natural_frequency: contradicting .* within 20 %"
        ):
            Twin.from_rig(RIG, model=other)
    else:
        assert Twin.from_rig(RIG, model=other).damping == PowerLaw(1.92)
    Twin.from_rig(
        RIG, model=other, damping=KelvinVoigt(0.0)
    )  # a stated material is not asked
    assert Twin.from_rig(RIG, model=replace(other, payload=None)).beam.payload == 0.030


def test_a_twin_takes_the_gauge_of_rig_and_model() -> None:
    found = replace(MODEL, gauge_delay=0.012, gauge_gain=1.1)
    limited = replace(RIG, gauge=replace(RIG.gauge, offset=0.2, limit=3.0))
    sensors = Twin.from_rig(limited, model=found).sensors
    assert sensors == Sensors(
        100_000,
        gauge_noise=0.01,
        gauge_offset=0.2,
        gauge_quantum=0.001953125,
        gauge_limit=3.0,
        gauge_delay=0.012,
        gauge_gain=1.1,
    )
    endless = replace(RIG, gauge=replace(RIG.gauge, limit=math.inf))
    assert Twin.from_rig(endless).sensors.gauge_limit is None
    # A gauge that leads its link says that the motor angle is late: no arm runs ahead.
    assert (
        Twin.from_rig(RIG, model=replace(MODEL, gauge_delay=-0.01)).sensors.gauge_delay
        == 0.0
    )
    own = Twin.from_rig(RIG, model=found, gauge_delay=0.0, gauge_gain=0.5).sensors
    assert (own.gauge_delay, own.gauge_gain) == (0.0, 0.5)


def test_modes_that_a_step_does_not_resolve_are_left_out_or_refused() -> None:
    """A quarter of a mode's period is the longest step that follows it."""
    beam = Twin.from_rig(RIG, link_mass=0.00735).beam
    third = float(beam.modes(3).frequencies[2])
    edge = 0.5 * math.pi / third
    assert (
        resolved(beam, None, edge * 0.999).count == 3
        and resolved(beam, None, edge * 1.001).count == 2
    )
    assert (
        resolved(beam, 3, edge * 0.999).count == 3
        and resolved(beam, 1, edge).count == 1
    )
    with pytest.raises(
        FieldError, match=f"mode 3 is at {third:.4g} rad/s.* here 2 modes"
    ):
        resolved(beam, 3, edge * 1.001)


def test_a_drive_for_a_law_without_one_is_that_of_the_twins_motor() -> None:
    twin = Twin.from_rig(GEARED)
    drive = drive_of(twin, law())
    assert drive.voltage_limit == 10.0 and drive.torque_voltage == pytest.approx(
        1 / (0.21 * 50)
    )
    assert (
        drive.coulomb_voltage == pytest.approx(0.02 / 0.21)
        and drive.loop.period == PERIOD
    )
    wide = replace(twin, motor=replace(twin.motor, voltage_limit=1e9))
    assert drive_of(wide, law()).voltage_limit == 1e4  # a block holds finite numbers
    bare = replace(law(), drive=None)
    equipped, findings = with_motor_loop(bare, twin=twin)
    assert equipped.drive == drive_of(twin, bare) and [f.code for f in findings] == [
        "W602"
    ]
    assert with_motor_loop(law(), twin=twin) == (law(), ())
    other = replace(law(), drive=replace(drive, loop=replace(drive.loop, period=0.002)))
    with pytest.raises(FieldError, match="period: not the motor loop's"):
        with_motor_loop(other)


def test_an_arm_begins_at_rest_where_it_stands_and_events_change_it() -> None:
    twin = Twin.from_rig(GEARED, link_mass=0.00735)
    state = ArmState(twin, PERIOD, law().initial_state(), start_angle=0.4)
    seen = state.plant.outputs @ state.state[: state.plant.order]
    assert seen[[0, 2]] == pytest.approx([0.4, 0.4], abs=1e-5) and seen[
        [1, 3, 4, 5]
    ] == pytest.approx([0] * 4, abs=1e-3)
    assert (state.counters.tolist(), state.sensed.tolist()) == ([1, 1], [0.4, 0.0])
    assert state.obstacle[1] == 0.0 and state.voltage.size == 2
    apply(
        state, law(), [Obstacle(0.0, 1.0, 0.3, side=-1, stiffness=800.0, damping=3.0)]
    )
    assert state.obstacle.tolist() == [0.3, 800.0, 3.0, 0.65, -1.0]
    apply(state, law(), [None, PayloadChange(0.1, 0.008)])
    assert state.obstacle[1] == 0.0 and state.twin.beam.payload == 0.008
    state.law[:] = 7
    state.estimate = np.ones(3, dtype=np.uint8)
    apply(state, law(), [Restart(0.1)])
    assert state.law.tobytes() == law().initial_state() and state.estimate.size == 0


# ── the model's link
# ────────────────────────────────────────────────────────────────────────────────────────


def test_a_link_too_fast_for_its_period_is_refused_with_the_longest_that_is_not() -> (
    None
):
    fast = LinkModel(1.56, 499.9)
    assert link_weights(fast, PERIOD, 1.0).first.shape == (1, 6)
    with pytest.raises(
        FieldError, match=r"period: too long for this link .* < 0.00399 s: 3.1 samples"
    ):
        link_weights(LinkModel(1.56, 501.0), PERIOD, 1.0)


def test_a_second_mode_answers_powers_of_time_as_its_equation_says() -> None:
    """The state after a period in which the motor moved as (t/T)^j, against quadrature
    of its equation.
    """
    mode = SecondMode(frequency=150.0, gain=0.2, damping_ratio=0.1)
    (row,) = second_mode_weights(mode, PERIOD)
    pole = 150.0 * complex(-0.1, math.sqrt(0.99))
    size = 0.2 * complex(1.0, 0.1 / math.sqrt(0.99))
    assert row[0] == 0.2 and complex(row[1], row[2]) == pytest.approx(
        np.exp(pole * PERIOD)
    )
    x, w = np.polynomial.legendre.leggauss(20)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    for j in range(6):
        # z' = p z + g p θ with θ = x^j, over the period
        answer = (
            size * pole * PERIOD * np.sum(w * x**j * np.exp(pole * PERIOD * (1.0 - x)))
        )
        assert complex(row[3 + j], row[9 + j]) == pytest.approx(answer, rel=1e-12)
    assert second_mode_weights(None, PERIOD).shape == (0, 15)


# ── the page's engine
# ───────────────────────────────────────────────────────────────────────────────────────


def test_the_engine_gets_the_rigs_numbers() -> None:
    rig = replace(GEARED, gauge=replace(GEARED.gauge, offset=0.03))
    model = replace(MODEL, gauge_delay=0.01, gauge_gain=1.2)
    found = engine_rig(rig, law(), model).tolist()
    motor = rig.motor
    wanted = [
        1,
        10,
        1,
        PERIOD,
        80,
        motor.gain,
        motor.decay,
        0.02 / (6.87e-5 * 50),
        0,
        2 * math.pi / 1e5,
    ]
    assert found[:18] == pytest.approx(
        [*wanted, 0.03, 0.01, 4.0, 0.001953125, 2.5, 1.2, 0, 0]
    )
    assert found[18:] == pytest.approx(_kernels.loop_weights(motor.decay, PERIOD, 10))
    assert engine_rig(rig, law(), replace(MODEL, gauge_delay=-0.01))[14] == 0.0


def test_the_engine_gets_a_links_numbers_behind_one_another() -> None:
    model = replace(MODEL, second_mode=SecondMode(frequency=150.0, gain=0.2))
    weights = link_weights(model, PERIOD, 4.0)
    found = engine_link(model, PERIOD, 4.0)
    assert (found.reals, found.pairs, found.second) == (weights.decay.shape[1], 1, True)
    assert found.numbers[0] == model.stiffness and found.numbers[1:7] == pytest.approx(
        weights.first[0]
    )
    assert found.numbers[7:22] == pytest.approx(weights.second[0])
    assert found.numbers[22 : 22 + found.reals] == pytest.approx(weights.decay[0])
    rest = found.numbers[22 + 7 * found.reals :]
    assert (
        rest[:2] == pytest.approx([weights.pair[0, 0].real, weights.pair[0, 0].imag])
        and rest.size == 14
    )
    assert rest[2:8] == pytest.approx(weights.pair_weight[0, :, 0].real)
    assert rest[8:] == pytest.approx(weights.pair_weight[0, :, 0].imag)
    plain = engine_link(MODEL, PERIOD, 4.0)
    assert not plain.second and np.all(plain.numbers[7:22] == 0.0)
    assert (
        engine_link(MODEL, PERIOD, 1e-9).numbers.size > 22
    )  # a span of two periods at least
    assert engine_noise(5, 4).tolist() == [_kernels.loop_normal(5, k) for k in range(4)]


def test_the_engine_gets_twins_that_it_has_room_for() -> None:
    rig = replace(GEARED, gauge=replace(GEARED.gauge, offset=0.03))
    found = engine_twin(rig, MODEL, [0.020, 0.040], 0.00735)
    assert found is not None
    twin = Twin.from_rig(rig, payload=0.020, link_mass=0.00735, modes=2)
    chain = twin.plant(0.001).chain
    assert found.rig.tolist() == twin_numbers(twin, PERIOD).tolist()
    head = [0.001, 0.65, chain.spring, chain.dashpot, 50**2 * 1.041e-3]
    assert found.material == pytest.approx([*head, *chain.weights, *chain.rates])
    heavy = twin.beam.with_payload(0.040).modes(2)
    assert found.arms[1, 1:] == pytest.approx(
        np.ravel(
            np.column_stack([heavy.frequencies**2, heavy.participation, heavy.tip])
        )
    )
    assert found.arms[0, 0] == pytest.approx(twin.plant(0.001).inertia)
    # 256 ms are 1024 steps of 0.25 ms, one more than the engine's queue holds.
    late = replace(MODEL, gauge_delay=1.03)
    assert engine_twin(rig, late, [0.020], 0.00735) is None
    assert (
        engine_twin(rig, replace(MODEL, gauge_delay=1.0), [0.020], 0.00735) is not None
    )


# ── what is said of a run
# ───────────────────────────────────────────────────────────────────────────────────


def estimates(flags: list[int]) -> Estimates:
    count = len(flags)
    own = (
        np.arange(count) * 1e-3,
        np.full(count, 0.05),
        np.full(count, 0.044),
        np.full(count, 0.0567),
    )
    return Estimates(*own, np.array(flags, dtype=np.uint32))


def test_an_estimate_outside_the_design_and_a_contact_are_findings() -> None:
    bank: Any = SimpleNamespace(certified=(0.020, 0.040))
    outside, touched = _kernels.PAYLOAD_OUTSIDE, _kernels.PAYLOAD_CONTACT
    assert estimate_findings(bank, estimates([0, 0, 0]), PERIOD) == ()
    first, second = estimate_findings(
        bank, estimates([0, outside, outside | touched, touched, 0]), PERIOD
    )
    assert (first.code, second.code) == ("W604", "W605")
    assert "(44 to 56.7 g at the end) left the 20 to 40 g" in first.message
    assert first.message.endswith("in 2 of 5 periods") and first.evidence == {
        "low": 0.044,
        "high": 0.0567,
    }
    assert "a torque at 0.008 s that no payload explains" in second.message
    assert second.evidence == {"time": 0.008}


def test_estimates_of_parts_are_those_of_the_whole_and_are_named() -> None:
    whole = joined([estimates([1, 2]), estimates([3])])
    signals = estimate_signals(whole)
    assert list(signals) == [
        "payload_given",
        "payload_estimate",
        "payload_low",
        "payload_high",
        "payload_flags",
    ]
    assert signals["payload_flags"].tolist() == [1.0, 2.0, 3.0] and signals[
        "payload_given"
    ].tolist() == [
        0,
        1e-3,
        0,
    ]


def test_an_estimate_stands_while_the_control_is_missed() -> None:
    class Bank:
        def run(
            self,
            state: bytes,
            angle: NDArray[np.float64],
            torque: NDArray[np.float64],
            *,
            ticks: Any,
        ) -> tuple[bytes, Estimates]:
            seen = np.column_stack([angle, torque, ticks]).tolist()
            assert seen == [[1.0, 10.0, 5.0], [3.0, 30.0, 7.0]]
            given, estimate, low, high = (np.array([k, k + 0.5]) for k in range(4))
            return b"after", Estimates(
                given, estimate, low, high, np.array([8, 9], np.uint32)
            )

    bank: Any = Bank()
    angle, torque = np.arange(5.0), 10 * np.arange(5.0)
    called = np.array([False, True, False, True, False])
    state, found = estimated_over(
        bank, b"before", angle, torque, 4 + np.arange(5), called
    )
    assert (
        state == b"after"
        and found.flags.tolist() == [8, 8, 8, 9, 9]
        and found.low.tolist() == [2, 2, 2, 2.5, 2.5]
    )


@pytest.mark.slow
def test_who_estimates_the_payload() -> None:
    design = fl.design(
        MODEL, RIG, payloads=(0.02, 0.04), gain_crossover=12.0, phase_margin=fl.deg(50)
    )
    bank = estimator_for(design, "estimated")
    assert bank is not None and bank.values == design.estimator().values
    assert bank.certified == pytest.approx((0.02, 0.04))
    of_law = estimator_for(law("single"), "estimated", RIG)
    assert of_law is not None and of_law.precision == "single"
    assert of_law.certified == pytest.approx((RIG.payloads.low, RIG.payloads.high))
    assert (
        estimator_for(design, True)
        is estimator_for(law(), 0.03)
        is estimator_for(law(), False)
        is None
    )
    own = estimator_for(law("single"), bank)
    assert own is not None and own.precision == "single" and own.models == bank.models
    with pytest.raises(FieldError, match=r"told\.period"):
        estimator_for(replace(law(), period=0.005), bank)
    for options in ((), (replace(RIG, model=None),)):
        with pytest.raises(FieldError, match="told: without a model of the link"):
            estimator_for(law(), "estimated", *options)


@pytest.mark.slow
def test_a_run_with_an_estimator_keeps_what_it_said() -> None:
    twin = Twin.from_rig(GEARED, link_mass=0.00735, payload=0.06)
    design = fl.design(
        MODEL,
        GEARED,
        payloads=(0.02, 0.04),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
    )
    run = fl.simulate(
        design, fl.smooth_step(1.0, 0.5), arm=twin, told="estimated", duration=1.5
    )
    assert run.about["payload_given"] == "estimated" and "W604" in [
        finding.code for finding in run.findings
    ]
    assert run.extras["payload_estimate"][-1] == pytest.approx(0.06, rel=0.1)
    assert (
        run.extras["payload_low"][-1]
        < run.extras["payload_estimate"][-1]
        < run.extras["payload_high"][-1]
    )


def test_a_payload_that_the_law_rejects_is_counted() -> None:
    flags = np.array(
        [0, _kernels.LAW_FLAG_PAYLOAD, _kernels.LAW_FLAG_PAYLOAD | 1, 1],
        dtype=np.uint32,
    )
    (finding,) = payload_rejected(flags)
    assert (
        finding.code == "W603"
        and "in 2 of 4 periods" in finding.message
        and finding.evidence == {"periods": 2}
    )
    assert payload_rejected(flags[[0, 3]]) == ()


def test_a_run_knows_its_period_its_error_and_its_about() -> None:
    move = fl.smooth_step(0.5, 0.3)
    run = fl.simulate(
        law(), move, rig=RIG, model=MODEL, duration=0.6, seed=3, told=True, payload=0.02
    )
    assert (
        run.period == pytest.approx(PERIOD)
        and run.time[-1] == pytest.approx(0.6)
        and len(run.time) == 151
    )
    assert np.array_equal(run.error, run.reference - run.tip_angle)
    assert (
        run.about["payload_given"] == 0.02
        and run.about["seed"] == 3
        and run.about["substeps"] == 10
    )
    assert (
        run.about["delay_samples"] == 1
        and run.about["arm"] == "model"
        and "events" not in run.about
    )
    assert MODES[run.mode[0]] == "run" and run.finished and run.findings == ()
    broken = SensorFault(0.1, 0.2, "gauge offset", 0.1)
    shaken = fl.simulate(
        law(),
        move,
        rig=RIG,
        model=MODEL,
        duration=0.6,
        events=[broken],
        gauge_offset=0.01,
    )
    assert (
        shaken.about["events"] == repr(broken) and shaken.about["gauge_offset"] == 0.01
    )
    whole = fl.simulate(law(), move, rig=RIG, model=MODEL)
    assert whole.time[-1] == pytest.approx(5.3) and whole.about["payload_given"] == 0.0


@pytest.mark.slow
def test_a_run_of_the_twin_says_what_it_was_told() -> None:
    twin = Twin.from_rig(GEARED, link_mass=0.00735, payload=0.025)
    own = fl.simulate(
        law(), fl.smooth_step(0.2, 0.3), arm=twin, duration=0.4, told=True
    )
    assert (
        own.about["payload_given"] == "the arm's own"
        and own.about["link_mass"] == 0.00735
    )
    assert own.payload == own.about["payload"] == 0.025 and np.all(
        own.extras["payload"] == 0.025
    )
    lie = fl.simulate(
        law(), fl.smooth_step(0.2, 0.3), arm=twin, payload=0.03, duration=0.4, told=0.02, delay_samples=2,
        gauge_offset=0.05, noise=0.0, gauge_gain=0.9, gauge_delay=0.002, events=[Restart(0.3)],
    )  # fmt: skip
    assert (
        lie.about["payload_given"] == 0.02
        and lie.payload == 0.03
        and lie.about["events"] == repr(Restart(0.3))
    )
    assert lie.torque_measured[1] == pytest.approx(0.05, abs=2e-3)
