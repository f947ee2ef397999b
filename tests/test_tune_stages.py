"""The stages of a tuning one by one: wiring, motor and link, each against its own
expected result.
"""

from __future__ import annotations

import math
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import Callback, MotorLoop, identify_motor
from fraclink.errors import FieldError, FraclinkError
from fraclink.extend import Motor, simulated_torque
from fraclink.lab import SimulatedArm
from fraclink.lab._tune_link import motor_again
from fraclink.lab._tune_motion import (
    Follower,
    calm,
    fastest_loop,
    follow,
    motor_law,
)
from fraclink.lab._tune_wiring import check_wiring
from tuned_arms import (
    LIMITS,
    PERIOD,
    RIG,
    Stages,
    arm,
    guarded,
    outside_arm,
    staged,
)

if sys.platform != "linux":
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)


def until_design(sentence: str) -> None:
    """Stop a tuning as soon as the arm is measured, as Ctrl-C does."""
    if sentence.startswith("design"):
        raise KeyboardInterrupt


def turning(gain: float, decay: float) -> Motor:
    """A motor of K/J = `gain` and ν/J = `decay`."""
    return Motor(inertia=1.0, viscous_friction=decay, torque_constant=gain)


MOTOR = turning(60.0, 10.0)


@pytest.fixture(scope="module")
def stages() -> Stages:
    return staged()


@pytest.mark.slow
def test_the_stages_find_what_the_arm_is_made_of(stages: Stages) -> None:
    made, guard, wiring, motor, link = stages
    assert wiring.gain == pytest.approx(RIG.motor.gain, rel=0.12)
    assert wiring.encoder_noise < 1e-3 and wiring.gauge_noise == pytest.approx(
        RIG.gauge.noise, rel=0.2
    )
    # The moves of the motor stage identify it as accurately as the loop needs, those of
    # the link stage more accurately.
    assert motor.fit.gain == pytest.approx(RIG.motor.gain, rel=0.15)
    assert link.motor.fit.gain == pytest.approx(RIG.motor.gain, rel=0.03)
    assert link.motor.fit.decay == pytest.approx(RIG.motor.decay, rel=0.1)
    assert (motor.gain.gain, motor.gain.decay) == (motor.fit.gain, motor.fit.decay)
    assert motor.friction == motor.fit.coulomb_voltage + motor.fit.dead_zone
    assert link.motor.loop.pole == 60.0
    assert link.fit.model.order == pytest.approx(1.92, abs=0.003)
    assert link.fit.passed
    # In the units of the gauge: it measures curvature, and the moment of the twin on
    # the hub is D = (jω)^(2−λ) times that.
    stiffened = 11.9 ** (2 - 1.92)  # at the vibration of 11.9 rad/s
    hub = RIG.motor.inertia * RIG.motor.gear_ratio**2
    assert abs(link.fit.model.pole) == pytest.approx(11.9, rel=0.01)
    # Between D at the vibration frequency and D at the 50 rad/s of the doublets and the
    # burst.
    found = link.motor.fit.inertia
    assert found is not None and hub / 50 ** (2 - 1.92) < found < 1.03 * hub / stiffened
    ((reach, duration, error),) = link.rounds
    assert 0.02 < reach <= 0.12 and error == link.fit.standard_errors["order"]
    # Four seconds, with a rest before and after.
    assert duration == pytest.approx(4.5, abs=0.5)
    record = made.record
    for column, most in (
        (1, LIMITS.angle),
        (2, LIMITS.speed),
        (3, LIMITS.torque),
        (4, LIMITS.voltage),
    ):
        assert np.abs(record[:, column]).max() <= 0.8 * most
    assert guard.count * PERIOD < 25.0


@pytest.mark.slow
def test_the_hubs_inertia_is_its_own_under_the_moment_that_loads_the_hub(
    stages: Stages,
) -> None:
    """With D(s) times the gauge reading as load, as in the equations of the twin, the
    fit of the motor gives n²J.
    """
    _, guard, _, _, link = stages
    # The moves of the link stage, followed by the burst of 2 s.
    record = guard.record(guard.count - round((link.rounds[0][1] + 2.0) / PERIOD))
    # the model of a link with mass, whose ω₀ is below the lumped one of the rig
    model = link.fit.model
    reading = simulated_torque(model, record.angle, PERIOD, hold="first")
    # the memory of the material decays: what wraps around is below a thousandth
    size = 4 * reading.size
    w = 2 * np.pi * np.fft.rfftfreq(size, PERIOD)
    moment = np.fft.irfft(
        (1j * w) ** (2 - model.order) * np.fft.rfft(reading, size), size
    )[: reading.size]
    hub = RIG.motor.inertia * RIG.motor.gear_ratio**2
    found = identify_motor(record.voltage, record.angle, period=PERIOD, torque=moment)
    assert found.inertia == pytest.approx(hub, rel=0.005)
    # The gauge reading is not proportional to that moment at all frequencies: its
    # residual is a hundred times larger.
    assert (
        found.nmse
        < 0.02
        * identify_motor(
            record.voltage, record.angle, period=PERIOD, torque=reading
        ).nmse
    )


# --- the motor's loop and what follows it ----------------------------------------------------------------


def distance(loop: MotorLoop, ratio: float) -> float:
    """Distance of −1 from the loop gain, on a separate grid, for a motor with `ratio`
    times the gain.
    """
    true = replace(
        loop.sampled(MOTOR, PERIOD), motor=turning(ratio * MOTOR.gain, MOTOR.decay)
    )
    assert np.abs(true.poles()).max() < 1.0
    w = np.linspace(0.05, math.pi / PERIOD, 4000)
    return float(np.abs(1.0 + true.loop_gain(w)).min())


@pytest.mark.parametrize(
    ("delay", "samples"), [(0.0, 1), (0.0055, 1), (0.0065, 2), (0.012, 3), (0.030, 8)]
)
def test_the_fastest_loop_keeps_its_distance_and_the_next_one_does_not(
    delay: float, samples: int
) -> None:
    ratios = (0.85, 1.0, 1.15)
    loop = fastest_loop(MOTOR, delay, PERIOD, ratios=ratios, margin=0.45, most=80.0)
    assert (loop.delay_samples, loop.kind, loop.placement) == (
        samples,
        "sampled",
        "direct",
    )
    assert min(distance(loop, ratio) for ratio in ratios) >= 0.449
    if loop.pole < 80.0:
        faster = 1.12 * loop.pole
        try:
            next_loop = replace(loop, pole=faster)
            near = min(distance(next_loop, ratio) for ratio in ratios)
            slowest = np.abs(next_loop.sampled(MOTOR, PERIOD).poles()).max()
        except FieldError:  # no poles can be placed with that delay
            near, slowest = 0.0, 1.0
        # If the distance is sufficient, there is an additional pole slower than those
        # placed.
        assert near < 0.45 or slowest > 1.001 * math.exp(-faster * PERIOD)
    slow = fastest_loop(MOTOR, delay, PERIOD, ratios=ratios, margin=0.45, most=12.0)
    assert slow.pole == 12.0


@pytest.mark.parametrize("samples", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("period", [0.002, 0.004, 0.01])
def test_the_fastest_loop_follows_a_step_as_fast_as_its_pole(
    period: float, samples: int
) -> None:
    motor = turning(12.0, 15.0)
    loop = fastest_loop(
        motor, samples * period, period, ratios=(1.0,), margin=0.45, most=80.0
    )
    # Three equal poles settle to 2 % in 7.5 of their time constants; an additional pole
    # due to the delay would take many times that.
    time = 7.6 / loop.pole + (samples + 1) * period
    step = stepped(motor, loop, period, round(1.5 * time / period) + 200)
    assert abs(step[round(time / period) :] - 1.0).max() < 0.05


def stepped(
    motor: Motor, loop: MotorLoop, period: float, count: int
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """The response of the angle to a reference of 1 rad, from the difference equations
    of loop and motor.
    """
    pid = loop.pid(motor, period)
    slow = math.exp(-motor.decay * period)
    angle = speed = integral = filtered = 0.0
    last = [0.0, 0.0]
    late, angles = [0.0] * loop.delay_samples, []
    for _ in range(count):
        error = 1.0 - angle
        whole = pid.filter_gain * error - pid.angle_filter_gain * angle
        integral += pid.integral_now * error + pid.integral_before * last[0]
        filtered = (
            pid.filter_decay * filtered
            + pid.filter_now * whole
            + pid.filter_before * last[1]
        )
        last = [error, whole]
        late.append(
            pid.direct * error
            - pid.angle_direct * angle
            + pid.integral_gain * integral
            + filtered
        )
        voltage = late.pop(0)
        rest = motor.gain * voltage / motor.decay
        angle += rest * period + (speed - rest) * (1.0 - slow) / motor.decay
        speed = rest + (speed - rest) * slow
        angles.append(angle)
    return np.array(angles)


def test_a_delay_that_no_loop_bears_is_named() -> None:
    with pytest.raises(
        FraclinkError,
        match=r"a distance of 0\.99 from -1 with a delay of 12 ms .* 4 ms",
    ):
        fastest_loop(MOTOR, 0.012, PERIOD, ratios=(1.0,), margin=0.99, most=80.0)


def test_the_motors_law_has_its_loop_and_nothing_else() -> None:
    law = motor_law(
        MOTOR,
        MotorLoop(40.0, 1, "sampled", "direct"),
        guarded(arm(seed=1).callback),
        friction=0.2,
    )
    assert law.motor_loop is not None
    assert (
        law.motor_loop.voltage_limit,
        law.motor_loop.coulomb_voltage,
        law.motor_loop.torque_voltage,
    ) == (10.0, 0.2, 0.0)
    assert law.motor_loop.pid == MotorLoop(40.0, 1, "sampled", "direct").pid(
        MOTOR, PERIOD
    )
    assert (law.period, law.precision, law.motor_loop_pole) == (PERIOD, "single", 40.0)
    # The reading of the gauge has no effect: the guard enforces the user's own limits.
    voltages = []
    for torque in (0.0, 1e5):
        runs = Follower(law)
        voltages.append(
            [runs.step(0.05, 0.0, 0.0, torque * (-1) ** k) for k in range(60)]
        )
    assert voltages[0] == voltages[1] and max(voltages[0]) > 0.3
    # The reference is monitored: the planned speed passes, three times that does not.
    step = 3.9 * PERIOD
    runs = Follower(law)
    for k in range(20):
        runs.step(step * k, 0.0, step * k, 0.0)
    with pytest.raises(
        FraclinkError, match=r"the law went to mode \w+: .*; the drive is off"
    ):
        for k in range(20):
            runs.step(3 * step * k + 1.0, 0.0, 3 * step * k + 1.0, 0.0)


def test_an_encoder_that_jumps_ends_the_law_and_a_period_that_was_missed_does_not() -> (
    None
):
    law = motor_law(
        MOTOR, MotorLoop(40.0, 1, "sampled", "direct"), guarded(arm(seed=1).callback)
    )
    runs = Follower(law)
    for periods in (1, 1, 3, 1, 1, 1, 1):
        assert abs(runs.step(0.0, 0.0, 0.0, 0.0, periods)) < 1e-9
    with pytest.raises(FraclinkError, match="missed periods"):
        runs.step(0.0, 0.0, 0.0, 0.0, 7)
    runs = Follower(law)
    runs.step(0.0, 0.0, 0.0, 0.0)
    with pytest.raises(FraclinkError, match="encoder"):
        for k in range(40):
            runs.step(0.0, 0.0, 3.0 * (-1) ** k, 0.0)


def test_a_reference_is_followed_from_where_the_arm_stands_or_from_an_origin() -> None:
    made = arm(seed=1)
    guard = guarded(made.callback)
    loop = fastest_loop(
        turning(RIG.motor.gain, RIG.motor.decay),
        0.004,
        PERIOD,
        ratios=(1.0,),
        margin=0.45,
        most=60.0,
    )
    law = motor_law(
        turning(RIG.motor.gain, RIG.motor.decay), loop, guard, friction=0.08
    )
    move = fl.smooth_step(0.2, 0.5)
    grid = PERIOD * np.arange(300)
    path = np.array([move.angle(grid), move.acceleration(grid)])
    record = follow(guard, law, path)
    assert record.angle.size == 300
    assert made.record[-1, 1] == pytest.approx(0.2, abs=0.01)
    follow(guard, law, path)  # the ticks are counted from there
    assert made.record[-1, 1] == pytest.approx(0.4, abs=0.015)
    back = np.zeros((2, 400))
    back[0] = np.maximum(0.4 - 0.002 * np.arange(400), 0.1)
    follow(guard, law, back, origin=guard.origin)
    assert made.record[-1, 1] == pytest.approx(0.1, abs=0.015)
    before = len(made.record)
    shaken = np.where(np.arange(50) % 2, 1.5, -1.5)
    follow(guard, law, np.zeros((2, 50)), shaken=shaken)
    added = np.diff(made.record[before:, 4])
    # the voltage of the law hardly changes
    assert np.median(np.abs(added)) == pytest.approx(3.0, abs=0.6)


def ringing(calmed: bool) -> tuple[float, float]:
    """Largest torque in the last half second for a link that was struck, and the time
    taken in seconds.
    """
    made = arm(seed=1)
    guard = guarded(made.callback)
    gain = turning(RIG.motor.gain, RIG.motor.decay)
    law = motor_law(
        gain,
        fastest_loop(gain, 0.004, PERIOD, ratios=(1.0,), margin=0.45, most=60.0),
        guard,
    )
    grid = PERIOD * np.arange(40)
    move = fl.smooth_step(0.15, 0.12)
    follow(guard, law, np.array([move.angle(grid), move.acceleration(grid)]))
    start = guard.count
    if calmed:
        w = abs(RIG.model.pole)  # type: ignore[union-attr]
        calm(
            guard,
            law,
            stiffness=RIG.link.stiffness,
            resonance=w,
            noise=RIG.gauge.noise,
        )
    else:
        follow(guard, law, np.zeros((2, round(1.2 / PERIOD))))
    torque = made.record[-round(0.4 / PERIOD) :, 3]
    return float(np.ptp(torque)), (guard.count - start) * PERIOD


def test_a_link_that_rings_is_calmed_by_its_motor() -> None:
    left, time = ringing(True)
    free, _ = ringing(False)
    assert 0.5 < time < 1.8 and left < 0.05 and free > 4.0 * left


def test_a_gauge_whose_zero_has_drifted_does_not_turn_the_motor() -> None:
    made = arm(seed=1)
    drifted = 0.0

    def read() -> tuple[float, float] | None:
        reading = made.callback.read()
        return None if reading is None else (reading[0], reading[1] + drifted)

    guard = guarded(Callback(read, made.callback.write))
    guard.rest(0.2)
    drifted = 0.1
    guard.rest(0.8)
    law = motor_law(MOTOR, MotorLoop(40.0, 1, "sampled", "direct"), guard)
    calm(guard, law, stiffness=1.5, resonance=12.0, noise=1e-9)
    # It would be 0.8 · 12 · 0.1/1.5 = 0.64 rad if the drift were taken for a bent link.
    assert float(np.abs(guard.record().angle).max()) < 0.03


def test_calming_ends_after_three_vibrations() -> None:
    guard = guarded(arm(seed=1).callback)
    law = motor_law(MOTOR, MotorLoop(40.0, 1, "sampled", "direct"), guard)
    calm(guard, law, stiffness=1.5, resonance=12.0, noise=1e-9)
    assert guard.count * PERIOD == pytest.approx(6 * math.pi / 12, abs=25 * PERIOD)
    before = guard.count
    # the link is at rest from the beginning
    calm(guard, law, stiffness=1.5, resonance=12.0, noise=1.0)
    assert (guard.count - before) * PERIOD == pytest.approx(0.5, abs=25 * PERIOD)


# --- the link --------------------------------------------------------------------------------------------


# --- the wiring's doubts ---------------------------------------------------------------------------------


def test_an_arm_that_turns_by_itself_is_no_arm_at_rest() -> None:
    made = arm(seed=1)
    at = [0.0]

    def read() -> tuple[float, float]:
        at[0] += 0.1 * PERIOD
        angle, torque = made.read()
        return angle + at[0], torque

    guard = guarded(Callback(read, made.write))
    with pytest.raises(FraclinkError, match=r"the motor turns by 2\.2° at 0 V"):
        check_wiring(guard, None)
    # An arm that was just released has five seconds to come to rest.
    assert 5.0 <= guard.count * PERIOD < 5.5 and not made.record[:, 4].any()


@pytest.mark.slow
def test_the_motor_behind_a_late_gauge_is_that_behind_a_prompt_one() -> None:
    """The first fit of a motor as light as its link attributes some of the delay of the
    gauge to the motor.
    """
    names = ("inertia", "viscous_friction", "torque_constant", "coulomb_torque")
    light = {name: getattr(RIG.motor, name) / 9 for name in names}
    twin = fl.Twin.from_rig(replace(RIG, motor=replace(RIG.motor, **light)))
    motors = []
    for delay in (0.0, 0.030):
        own = SimulatedArm(replace(twin, gauge_delay=delay), PERIOD, seed=3)
        _, _, _, first, link = staged(own)
        assert link.fit.passed
        assert link.fit.model.gauge_delay == pytest.approx(delay, abs=0.001)
        motors.append(link.motor)
    prompt, late = motors
    assert late.fit.gain == pytest.approx(prompt.fit.gain, rel=0.03)
    assert late.fit.delay == pytest.approx(prompt.fit.delay, abs=0.001)
    assert late.loop == prompt.loop
    assert first.loop.delay_samples > late.loop.delay_samples


def test_a_motor_of_which_nothing_more_was_recorded_stays_as_it_was(
    stages: Stages,
) -> None:
    _, _, wiring, motor, link = stages
    still = guarded(arm(seed=1).callback)
    still.rest(0.5)
    assert motor_again(motor, still, wiring, link.fit) is motor


@pytest.mark.slow
@pytest.mark.parametrize(("times", "ends"), [(2, False), (3, True)])
def test_what_reaches_a_limit_is_repeated_smaller_twice(
    times: int, ends: bool, tmp_path: Path
) -> None:
    """The gauge reads a torque near its limit once in each excitation of the link."""
    own, said, voltages = arm(seed=2), list[str](), [0.0]
    spikes = 0

    def begin(sentence: str) -> None:
        said.append(sentence)
        until_design(sentence)

    def write(command: Any) -> None:
        voltages.append(command.voltage)
        own.callback.write(command)

    def read() -> tuple[float, float] | None:
        nonlocal spikes
        angle, torque = own.callback.read() or (0.0, 0.0)
        # In the middle of a motion, once per attempt.
        moving = min(map(abs, voltages[-50:])) > 0.0
        tries = sum("once more" in line for line in said)
        if "link" in said and moving and spikes == tries < times:
            spikes += 1
            return angle, torque + 0.9 * LIMITS.torque
        return angle, torque

    plan = fl.TuningPlan(LIMITS, payload=0.030, period=PERIOD)
    tuned = fl.tune(
        Callback(read, write),
        plan,
        out=tmp_path / "tuned",
        begin=begin,
        clock="none",
    )
    assert sum("once more, half as large" in line for line in said) == 2
    assert ("torque" in tuned.stopped) is ends
    assert (tuned.link is None) is ends
    if tuned.link is not None:
        assert tuned.link.fit.passed and tuned.link.rounds[0][0] < 0.05


@pytest.mark.slow
def test_a_stiff_link_at_a_short_period_is_excited(tmp_path: Path) -> None:
    # Its burst has a thousand bits of one period each.
    stiffness, payload, length, period = 8.0, 0.05, 0.30, 0.002
    rig = replace(
        RIG,
        period=period,
        motor=Motor(
            inertia=0.03,
            viscous_friction=0.5,
            torque_constant=0.5,
            coulomb_torque=0.15,
            voltage_limit=10.0,
        ),
        link=replace(
            RIG.link,
            length=length,
            mass=0.012,
            stiffness=stiffness,
            flexural_rigidity=stiffness * length / 3,
        ),
        payloads=replace(RIG.payloads, low=0.04, high=0.066, nominal=payload),
        gauge=replace(RIG.gauge, noise=0.008),
    )
    frequency = math.sqrt(stiffness / (payload * length**2))
    model = fl.LinkModel(stiffness, frequency, order=1.98, payload=payload)
    twin = replace(fl.Twin.from_rig(rig, model=model), gauge_delay=0.001)
    tuned = fl.tune(
        SimulatedArm(twin, period, seed=1).callback,
        fl.TuningPlan(replace(LIMITS, torque=4.0), payload=payload, period=period),
        out=tmp_path / "tuned",
        begin=until_design,
        clock="none",
    )
    assert tuned.link is not None, tuned
    assert abs(tuned.link.fit.model.pole) == pytest.approx(42.6, rel=0.02)


def tuned_outside(
    own: Any, place: Path, *, limits: dict[str, float] | None = None, **options: Any
) -> fl.lab.Tuning:
    given = {"angle": 0.698, "speed": 4.0, "torque": 1.5, "voltage": 10.0}
    given |= limits or {}
    plan = fl.TuningPlan(
        fl.MotionLimits(**given), payload=own.p["payload"], period=own.p["T"]
    )
    board = Callback(own.read, own.write)
    return fl.tune(board, plan, out=place, clock="none", **options)


@pytest.mark.slow
def test_a_slow_link_is_excited_at_its_first_mode(tmp_path: Path) -> None:
    # Its wiring check shows little but the second mode, 15 times as high: a model of
    # that one fits these doublets better, and does not predict the moves behind them.
    slow = outside_arm(
        L=0.68,
        c=0.286,
        link=0.0104,
        payload=0.0248,
        J=0.0312,
        K=0.279,
        visc=0.26,
        Fc=0.13,
        Fs=0.167,
        T=0.002,
        seed=10,
        zeta=0.0185,
        zeta2=0.0038,
        gdelay=0.0054,
        vdelay=0.0012,
        taue=0.0028,
        gnoise=0.00057,
        goffset=0.0076,
        counts=8192,
    )
    limits = {"torque": 1.0}
    tuned = tuned_outside(slow, tmp_path / "tuned", begin=until_design, limits=limits)
    assert tuned.link is not None and tuned.link.fit.passed, tuned
    assert abs(tuned.link.fit.model.pole) == pytest.approx(4.76, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1, -1])
def test_a_late_gauge_on_a_heavy_link_has_the_sign_that_it_has(sign: int) -> None:
    # The second mode, which the doublets excite most, turns by 2.4 rad until the gauge
    # shows it: nearly the opposite sign of a gauge that leads.
    late = outside_arm(
        L=0.459,
        c=0.641,
        link=0.0491,
        payload=0.0858,
        J=0.0226,
        K=0.117,
        visc=0.188,
        Fc=0.0423,
        Fs=0.0471,
        zeta=0.0926,
        zeta2=0.0488,
        gdelay=0.0338,
        gnoise=0.00133,
        counts=5290,
        sg=sign,
    )
    guard = guarded(Callback(late.read, late.write))
    if sign < 0:
        with pytest.raises(FraclinkError, match="gauge reversed"):
            check_wiring(guard, None)
    else:
        assert check_wiring(guard, None).stiffness > 0.0


@pytest.mark.slow
def test_a_link_that_still_swings_does_not_hide_the_motors_sign(tmp_path: Path) -> None:
    # Stiff, hardly damped, half as heavy as the hub: what is left of a doublet turns the
    # motor as far as the next one does.
    swinging = outside_arm(
        L=0.638,
        c=35.6,
        link=0.0141,
        payload=0.0626,
        J=0.0456,
        K=0.836,
        visc=0.479,
        Fc=0.387,
        Fs=0.503,
        zeta=0.0039,
        zeta2=0.0028,
        gdelay=0.015,
        gnoise=0.0179,
    )
    limits = {"angle": 0.475, "speed": 4.1, "torque": 5.95}
    place = tmp_path / "tuned"
    tuned = tuned_outside(swinging, place, begin=until_design, limits=limits)
    assert tuned.wiring is not None, tuned
    assert tuned.wiring.gain > 0.0 and tuned.link is not None


@pytest.mark.slow
def test_a_weak_motor_gets_moves_that_its_voltage_can_make(tmp_path: Path) -> None:
    weak = {"K": 0.06, "visc": 0.08, "Fc": 0.03, "Fs": 0.04}
    tuned = tuned_outside(outside_arm(**weak), tmp_path / "tuned")
    assert tuned.passed, tuned
    move = tuned.moves[-1]
    design = fl.load(tmp_path / "tuned" / "design.json")
    reference = fl.smooth_step(abs(move.amplitude), move.duration)
    for payload in design.payloads:
        run = fl.simulate(design, reference, payload=payload, told=True)
        # no vibration is left that the motor had no voltage for
        assert run.metrics.settling_time < 1.2 * move.duration


@pytest.mark.slow
def test_an_arm_that_loses_samples_is_measured_on_its_own_time(tmp_path: Path) -> None:
    own, chance = arm(seed=1), np.random.default_rng(1)
    last: list[Any] = []

    def write(command: Any) -> None:
        last[:] = [command]
        own.callback.write(command)

    def read() -> tuple[float, float] | None:
        sample = own.callback.read()
        if last and chance.random() < 0.02:
            own.callback.write(last[0])  # the arm goes on with the voltage it has
            return None
        return sample

    tuned = fl.tune(
        Callback(read, write),
        fl.TuningPlan(LIMITS, payload=0.030, period=PERIOD),
        out=tmp_path / "tuned",
        clock="none",
    )
    assert tuned.link is not None
    assert tuned.link.fit.model.order == pytest.approx(1.92, abs=0.005)
    for move in tuned.moves:
        assert move.measured_settling == pytest.approx(
            move.promised_settling, rel=0.1, abs=0.05
        )
    assert tuned.passed, tuned


@pytest.mark.slow
def test_the_link_is_found_below_a_second_mode_with_more_energy() -> None:
    heavy = replace(RIG, link=replace(RIG.link, mass=0.064))
    beam = fl.extend.Beam.from_rig(heavy, payload=0.026)
    first, second = beam.modes(2).frequencies.tolist()
    twin = fl.Twin.from_rig(
        heavy,
        payload=0.026,
        damping=fl.extend.KelvinVoigt(2 * 0.0014 / first, 2 * 0.0016 / second),
    )
    late = replace(twin, gauge_delay=0.008, voltage_delay=2)
    *_, link = staged(SimulatedArm(late, PERIOD, seed=20))
    model = link.fit.model
    assert link.fit.passed
    assert abs(model.pole) == pytest.approx(first, rel=0.01)
    assert model.second_mode is not None
    assert model.second_mode.frequency == pytest.approx(second, rel=0.01)
    assert 0.0005 <= model.second_mode.damping_ratio < 0.004
    # the phase of an error of 0.018 in λ, which suffices
    phase = 0.018 * math.pi / 2
    assert model.gauge_delay == pytest.approx(0.008, abs=phase / first)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({}, r"as if with (69|70|71) % of the mass"),
        ({"play": math.radians(1.0), "kg": 1500.0}, "play in the gear"),
    ],
    ids=["slipped payload", "play"],
)
def test_moves_of_an_arm_that_has_changed_name_the_change(
    changes: dict[str, float], cause: str, tmp_path: Path
) -> None:
    own = outside_arm(**changes)

    def begin(sentence: str) -> None:
        if not changes and sentence.startswith("first moves"):
            # 20 g of 30 g, and a link of 10 g whose share at the tip is a quarter
            own.events.append((own.t + 5.0, lambda arm: arm.swap(payload=0.020)))

    tuned = tuned_outside(own, tmp_path / "tuned", begin=begin)
    assert not tuned.has_law
    assert re.search(cause, "; ".join(tuned.reasons))


@pytest.fixture(scope="module")
def with_law(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a tuning that has a law and has not moved yet."""
    place = tmp_path_factory.mktemp("tuned") / "tuned"
    plan = fl.TuningPlan(LIMITS, payload=0.030, period=PERIOD)
    board = arm(seed=1).callback
    assert fl.tune(board, plan, out=place, moves=False, clock="none").has_law
    return place


@pytest.mark.slow
@pytest.mark.parametrize("samples", [1, 40])
def test_first_moves_that_reach_a_limit_at_once_withhold_the_law(
    samples: int, with_law: Path, tmp_path: Path
) -> None:
    own, left = arm(seed=1), [-1]

    def begin(sentence: str) -> None:
        if sentence.startswith("first moves"):
            left[0] = samples

    def read() -> tuple[float, float] | None:
        angle, torque = own.callback.read() or (0.0, 0.0)
        left[0] -= left[0] > 0
        return angle, torque + (10.0 * LIMITS.torque if left[0] == 0 else 0.0)

    tuned = fl.tune(
        Callback(read, own.callback.write),
        fl.TuningPlan(LIMITS, payload=0.030, period=PERIOD),
        out=shutil.copytree(with_law, tmp_path / "tuned"),
        resume=True,
        begin=begin,
        clock="none",
    )
    assert "torque" in tuned.stopped
    assert not tuned.has_law and not (tmp_path / "tuned" / "design.json").exists()
    assert "the arm's own moves fail" in tuned.reasons[0]
