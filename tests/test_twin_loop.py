"""The shipped law on the twin: it is stable, and the motion of the arm obeys physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fraclink as fl
from fraclink import Run, Twin, smooth_step
from fraclink._simulate.events import healthy_inputs
from fraclink._simulate.kernel import ArmState
from fraclink.errors import FieldError, FileFormatError
from fraclink.extend import (
    Encoder,
    Gauge,
    KelvinVoigt,
    Obstacle,
    PayloadChange,
    PowerLaw,
    Restart,
    TipPulse,
    equip,
    geared,
    hold,
)
from state_space import energy_matrix

RIG = geared(fl.Rig.named("paper-2023"))
LINK_MASS = 0.00735


@pytest.fixture(scope="module")
def law():
    design = fl.design(
        RIG.model,
        RIG,
        payloads=(0.020, 0.040),
        gain_crossover=11.0,
        phase_margin=fl.deg(50),
        filter_time=0.0,
    )
    law = fl.discretize(design.controller, RIG.period, precision="double")
    return equip(law, RIG, RIG.model)


def quiet(payload=0.030, link_mass=LINK_MASS, **changes):
    """A twin without noise, quantisation and friction, which makes it linear."""
    twin = Twin.from_rig(RIG, payload=payload, link_mass=link_mass, **changes)
    motor = replace(twin.motor, coulomb_torque=0.0)
    return replace(twin, encoder=Encoder(), gauge=Gauge(), motor=motor)


def smooth(law):
    """The law for a motor without Coulomb friction."""
    return replace(law, motor_loop=replace(law.motor_loop, coulomb_voltage=0.0))


def kicked(law, twin, pulse):
    """Two seconds of a twin that is pushed at its tip, its motor without voltage."""
    off = replace(law, motor_loop=replace(law.motor_loop, voltage_limit=1e-9))
    at_rest = hold(0.0, duration=1.0)
    return fl.simulate(off, at_rest, arm=twin, duration=2.0, events=[pulse])


def energy(vessel, matrix):
    """Energy of hub and link of a running twin [J]."""
    own = vessel.state[: len(matrix)]
    return own @ matrix @ own


MOVE = smooth_step(1.0, duration=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("payload", [0.008, 0.016, 0.020, 0.030, 0.040])
def test_the_design_holds_on_the_twin(law, payload):
    run = fl.simulate(
        law,
        MOVE,
        arm=Twin.from_rig(RIG, payload=payload, link_mass=LINK_MASS),
        duration=6.0,
    )
    assert run.finished and set(run.mode.tolist()) == {1}
    late = run.time > 2.5
    assert np.abs(run.error[late]).max() < 0.02  # 2 % of the move
    assert run.tip_angle.max() < 1.04


@pytest.mark.slow
def test_noise_free_error_vanishes(law):
    run = fl.simulate(smooth(law), MOVE, arm=quiet(), duration=10.0)
    assert abs(run.error[-1]) < 1e-3
    # The strain of the gauge and the deflection of the link give the same tip angle
    # except for the higher modes: θt = θm − Γ/c.
    estimate = run.motor_angle - run.torque / RIG.link.stiffness
    assert np.abs(estimate - run.tip_angle).max() < 0.03 * np.abs(run.torque).max()


@pytest.mark.slow
def test_gauge_offset_does_not_stay_in_the_tip(law):
    twin = replace(quiet(), gauge=Gauge(offset=0.05))
    run = fl.simulate(smooth(law), MOVE, arm=twin, duration=12.0)
    assert abs(run.torque_measured[-1] - 0.05) < 2e-3
    assert abs(run.error[-1]) < 1e-3  # 0.05 N·m corresponds to a deflection of 32 mrad


@pytest.mark.slow
def test_coulomb_friction_holds_the_hub_and_never_pushes(law):
    """At rest the hub sticks as long as the link's torque is below stiction: its speed
    is exactly zero.
    """
    twin = Twin.from_rig(RIG, link_mass=LINK_MASS)
    run = kicked(law, twin, TipPulse(0.1, 0.2, 0.02))
    assert np.abs(run.tip_angle).max() > 1e-3
    assert np.all(run.extras["motor_velocity"] == 0.0)
    # within a step, held friction allows minute motion
    assert np.abs(run.motor_angle).max() < 1e-5
    assert np.abs(run.torque).max() < twin.breakaway


@pytest.mark.slow
def test_stiction_breaks_above_its_level(law):
    twin = Twin.from_rig(RIG, link_mass=LINK_MASS)
    twin = replace(twin, motor=replace(twin.motor, coulomb_torque=1e-4))
    run = kicked(law, twin, TipPulse(0.1, 0.5, 0.05))
    assert np.abs(run.extras["motor_velocity"]).max() > 0.0


@pytest.mark.slow
def test_free_swing_loses_energy_with_friction(law):
    """A kick, then no voltage: hub and link come to rest, and the energy falls in every
    period.
    """
    twin = Twin.from_rig(RIG, link_mass=LINK_MASS)
    off = replace(law, motor_loop=replace(law.motor_loop, voltage_limit=1e-9))
    vessel = ArmState(twin, law.period, off.initial_state())
    vessel.state[1], vessel.counters[0] = 3.0, 0
    matrix = energy_matrix(vessel.plant, twin.hub_inertia)
    energies = [energy(vessel, matrix)]
    for _ in range(1500):
        vessel.run(
            off.block,
            healthy_inputs(
                twin.gauge, hold(0.0), law.period, 0.0, np.random.default_rng(0)
            ),
        )
        energies.append(energy(vessel, matrix))
    assert np.all(np.diff(energies) <= 1e-9 * energies[0])
    assert energies[-1] < 0.05 * energies[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "damping", [KelvinVoigt(0.0118), PowerLaw(1.92)], ids=["viscous", "power law"]
)
def test_payload_exchange_conserves_shape_and_speed(law, damping):
    twin = quiet(payload=0.040, damping=damping)
    vessel = ArmState(twin, law.period, law.initial_state())
    vessel.run(
        smooth(law).block,
        healthy_inputs(twin.gauge, MOVE, law.period, 0.596, np.random.default_rng(0)),
    )  # mid-move
    before = vessel.plant.outputs @ vessel.state[: vessel.plant.order]
    held = energy(vessel, energy_matrix(vessel.plant, twin.hub_inertia))
    vessel.change_payload(0.008)
    after = vessel.plant.outputs @ vessel.state[: vessel.plant.order]
    assert after[:3] == pytest.approx(
        before[:3], abs=1e-4
    )  # hub angle, hub velocity, tip angle
    assert after[4] == pytest.approx(before[4], rel=0.02)  # tip velocity
    # the remaining curvature is in the truncated modes
    assert after[3] == pytest.approx(before[3], abs=0.05)
    lost = 0.5 * 0.032 * (before[4] * 0.65) ** 2
    left = energy(vessel, energy_matrix(vessel.plant, twin.hub_inertia))
    assert left == pytest.approx(held - lost, rel=0.02)


@pytest.mark.slow
def test_payload_lost_mid_move(law):
    twin = Twin.from_rig(RIG, payload=0.040, link_mass=LINK_MASS)
    run = fl.simulate(
        law, MOVE, arm=twin, duration=6.0, events=[PayloadChange(0.5, 0.008)]
    )
    assert run.finished and set(run.mode.tolist()) == {1}
    assert run.payload == 0.040 and run.extras["payload"][-1] == 0.008
    assert np.abs(run.error).max() < 0.25 and abs(run.error[-1]) < 0.02


def test_a_law_without_a_motor_loop_is_refused(law):
    twin = Twin.from_rig(RIG, link_mass=LINK_MASS)
    bare = replace(law, motor_loop=None)
    with pytest.raises(FieldError, match=r"law.motor_loop: missing"):
        fl.simulate(bare, MOVE, arm=twin, duration=4.0)
    equipped = fl.extend.equip(bare, RIG, RIG.model)
    assert fl.simulate(equipped, MOVE, arm=twin, duration=4.0).verdict.passed


def test_obstacle_stops_the_tip_and_pushes_one_way(law):
    twin = Twin.from_rig(RIG, link_mass=LINK_MASS)
    wall = Obstacle(time=0.0, until=0.9, angle=0.5)
    run = fl.simulate(law, MOVE, arm=twin, duration=6.0, events=[wall])
    inside = run.time < 0.9
    force = run.extras["contact_force"][inside].max()
    assert force > 0.1
    # A spring of 500 N/m at 0.65 m: not deeper than the force permits.
    assert run.tip_angle[inside].max() - 0.5 < force / 500.0 / 0.65 + 1e-3
    assert np.all(run.extras["contact_force"][run.time > 0.91] == 0.0)
    # it arrives, or the law has tripped and reports this
    assert abs(run.error[-1]) < 0.02 or run.mode[-1] != 1


def test_a_stop_without_loss_pushes_as_its_spring(law):
    twin = Twin.from_rig(RIG, link_mass=LINK_MASS)
    for side in (1, -1):
        wall = Obstacle(0.0, 0.9, side * 0.5, side=side, stiffness=300.0, damping=0.0)
        move = fl.smooth_step(side * 1.0, duration=0.5)
        run = fl.simulate(law, move, arm=twin, duration=0.9, events=[wall])
        depth = 0.65 * (np.abs(run.tip_angle).max() - 0.5)
        force = run.extras["contact_force"]
        assert force.max() == pytest.approx(300.0 * depth, rel=0.05)
        assert force.min() == 0.0


def test_restart_mid_motion_has_no_bump(law):
    twin = Twin.from_rig(RIG, link_mass=LINK_MASS)
    run = fl.simulate(law, MOVE, arm=twin, duration=6.0, events=[Restart(0.5)])
    at = round(0.5 / law.period)
    assert run.flags[at] & 128  # started in this period
    assert (
        abs(run.motor_reference[at] - run.motor_angle_measured[at])
        < 1.5 * law.limits.motor_step
    )
    assert abs(run.error[-1]) < 0.02


@pytest.mark.slow
def test_several_moves_in_a_row(law):
    moves = (
        MOVE.then(hold(0.0, duration=1.0))
        .then(smooth_step(-1.5, duration=1.2))
        .then(hold(0.0, duration=1.0))
    )
    run = fl.simulate(law, moves, arm=Twin.from_rig(RIG, link_mass=LINK_MASS))
    assert run.reference[-1] == pytest.approx(-0.5)
    assert abs(run.error[-1]) < 0.02


@pytest.mark.slow
def test_the_printed_motor_is_unstable_and_the_twin_says_so(law):
    """Table 1's J at the gear's output is 0.5 % of the arm: W601, and the loop indeed
    diverges.
    """
    rig = fl.Rig.named("paper-2023")
    twin = Twin.from_rig(rig, link_mass=LINK_MASS)
    assert [f.code for f in twin.findings] == ["W601"]
    assert Twin.from_rig(RIG, link_mass=LINK_MASS).findings == ()
    printed = equip(law, rig, rig.model)
    run = fl.simulate(printed, MOVE, arm=twin, duration=4.0)
    assert run.mode[-1] == 4 or np.abs(run.error).max() > 0.5


def test_a_run_ends_with_the_last_sample_within_every_bound(law):
    strong = replace(law, motor_loop=replace(law.motor_loop, voltage_limit=1e4))
    twin = quiet()
    motor = replace(twin.motor, voltage_limit=1e9, torque_constant=1e8)
    wild = replace(twin, motor=motor)
    ended = fl.simulate(strong, MOVE, arm=wild, duration=2.0).time.size
    assert 1 < ended < round(2.0 / law.period)
    # a run that is asked for less than one more sample has them all, and no other
    for samples in (ended - 1, ended, ended + 1):
        run = fl.simulate(strong, MOVE, arm=wild, duration=(samples - 1) * law.period)
        assert run.time.size == min(samples, ended)


def test_same_seed_same_run_and_seeds_differ(law):
    twin = Twin.from_rig(RIG, link_mass=LINK_MASS)
    one, two, other = (
        fl.simulate(law, MOVE, arm=twin, duration=1.0, seed=s) for s in (3, 3, 4)
    )
    assert np.array_equal(one.tip_angle, two.tip_angle)
    assert not np.array_equal(one.torque_measured, other.torque_measured)


def test_encoder_counts_and_gauge_steps(law):
    twin = Twin.from_rig(RIG, link_mass=LINK_MASS)
    run = fl.simulate(law, MOVE, arm=twin, duration=1.0)
    counts = run.motor_angle_measured / (2 * np.pi / 100000)
    assert counts == pytest.approx(np.round(counts), abs=1e-6)
    assert np.abs(
        run.motor_angle_measured - run.motor_angle
    ).max() <= np.pi / 100000 * (1 + 1e-9)
    steps = run.torque_measured / RIG.gauge.quantum
    assert steps == pytest.approx(np.round(steps), abs=1e-9)


@pytest.mark.slow
def test_gauge_delay_is_a_delay(law):
    prompt = quiet()
    for lag in (0.0, 1.5, 3.0):
        twin = replace(prompt, gauge_delay=lag * 1e-3)
        run = fl.simulate(smooth(law), MOVE, arm=twin, duration=1.5)
        fine = np.interp(run.time - lag * 1e-3, run.time, run.torque)
        assert run.torque_measured[5:] == pytest.approx(fine[5:], abs=2e-3)


@pytest.mark.slow
def test_voltage_saturates(law):
    twin = Twin.from_rig(RIG, link_mass=LINK_MASS)
    weak = replace(twin, motor=replace(twin.motor, voltage_limit=1.0))
    run = fl.simulate(law, MOVE, arm=weak, duration=2.0)
    assert np.abs(run.voltage).max() == 1.0


def test_a_run_saves_and_loads_equal(law, tmp_path):
    run = fl.simulate(
        smooth(law), MOVE, arm=quiet(), duration=1.0, events=[Restart(0.5)], seed=2
    )
    run.save(tmp_path / "run.npz")
    back = Run.load(tmp_path / "run.npz")
    assert (
        np.array_equal(back.tip_angle, run.tip_angle)
        and back.mode.dtype == run.mode.dtype
    )
    assert (
        back.metrics == run.metrics
        and back.verdict == run.verdict
        and back.about == run.about
    )
    assert (
        back.about["law_sha256"] == smooth(law).digest
        and "Restart" in back.about["events"]
    )
    (tmp_path / "other.npz").write_bytes(b"PK\x03\x04nothing")
    with pytest.raises(FileFormatError):
        Run.load(tmp_path / "other.npz")


def test_a_rig_that_contradicts_its_model_is_refused():
    from fraclink import LinkModel

    other = LinkModel(stiffness=1.56, natural_frequency=20.0, order=1.92, payload=0.030)
    with pytest.raises(FieldError, match="contradicting"):
        Twin.from_rig(replace(RIG, model=other))


def test_the_twins_gauge_reads_what_it_read_in_the_log(law):
    """A torque log of a gauge that reads 20 % too much is fitted with as much more
    stiffness; the twin of the fit is the arm that was recorded.
    """
    fitted = replace(RIG.model, stiffness=1.2 * RIG.link.stiffness)
    arm = replace(Twin.from_rig(RIG), gauge_gain=1.2)
    twin = Twin.from_rig(RIG, model=fitted)
    runs = [
        fl.simulate(smooth(law), MOVE, arm=each, duration=1.0) for each in (arm, twin)
    ]
    assert np.allclose(runs[0].torque_measured, runs[1].torque_measured, atol=1e-9)
    assert np.allclose(runs[0].tip_angle, runs[1].tip_angle, atol=1e-9)


@pytest.mark.slow
def test_single_precision_is_the_law_of_the_board(law):
    """The law in single precision is computed in floats: not bitwise equal to the
    double law, but the same move to the accuracy of floats.
    """
    one = fl.simulate(smooth(law), MOVE, arm=quiet(), duration=2.0)
    two = fl.simulate(
        smooth(law).in_precision("single"), MOVE, arm=quiet(), duration=2.0
    )
    apart = np.abs(one.tip_angle - two.tip_angle).max()
    assert 1e-9 < apart < 1e-4
    assert np.all(two.motor_reference == two.motor_reference.astype(np.float32))


def test_refusals(law):
    twin = Twin.from_rig(RIG, link_mass=LINK_MASS)
    with pytest.raises(FieldError, match="period"):
        fl.simulate(replace(law, period=0.002), MOVE, arm=twin)
    with pytest.raises(FieldError, match="duration"):
        fl.simulate(law, MOVE, arm=twin, duration=0.0)
    with pytest.raises(FieldError, match="duration"):
        fl.simulate(law, MOVE, arm=twin, duration=1e9)
    with pytest.raises(FieldError, match="events"):
        fl.simulate(law, MOVE, rig=RIG, events=[TipPulse(1.0, 0.5)])
    with pytest.raises(FieldError, match="motor_loop"):
        fl.simulate(replace(law, motor_loop=None), MOVE, arm=twin)
    with pytest.raises(FieldError, match="rig is required"):
        fl.simulate(law, MOVE)
    with pytest.raises(FieldError, match="voltage_delay"):
        replace(twin, voltage_delay=-1)
    with pytest.raises(FieldError, match="damping"):
        Twin.from_rig(replace(RIG, model=None))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: PayloadChange(-1.0, 0.02), "time"),
        (lambda: PayloadChange(1.0, -0.02), "payload"),
        (lambda: TipPulse(0.0, float("nan")), "force"),
        (lambda: TipPulse(0.0, 1.0, 0.0), "duration"),
        (lambda: Obstacle(1.0, 0.5, 0.1), "until"),
        (lambda: Obstacle(0.0, 0.5, 0.1, side=0), "side"),
        (lambda: Obstacle(0.0, 0.5, 0.1, stiffness=0.0), "stiffness"),
        (lambda: Obstacle(0.0, 0.5, 0.1, damping=-1.0), "damping"),
        (lambda: Obstacle(0.0, 0.5, float("inf")), "angle"),
        (lambda: Restart(float("nan")), "time"),
    ],
)
def test_bad_events(make, field):
    with pytest.raises(FieldError) as caught:
        make()
    assert caught.value.field == field
