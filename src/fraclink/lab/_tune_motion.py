"""Motion of the arm in the motor loop: law.c without its correction, and references
within the limits.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np

from fraclink._arm.link import LinkModel
from fraclink._arm.motor_loop import MotorGain, MotorLoop
from fraclink._arm.reference import prbs, smooth_step
from fraclink._arm.rig_parts import Moves
from fraclink._law import MODES, REASONS, Law, LawInputs
from fraclink._law.block import DiscreteMotorLoop, Modes
from fraclink._law.limits import derive_limits
from fraclink._law.tracking import following
from fraclink.errors import FieldError, FraclinkError
from fraclink.lab._tune_guard import PLANNED, Guard, Record
from fracsys.checks import Real

__all__ = [
    "LawTripped",
    "burst",
    "fastest_loop",
    "follow",
    "motor_law",
    "random_moves",
    "random_steps",
]


# [rad/s], slowest loop; ratio of the speeds of two loops that are tried in turn
_SLOWEST, _STEP = 4.0, 0.9
_STRETCH = 70  # smallest number of samples of a move
# [s] for which the gauge must be quiet; periods between two checks
_CALM, _LOOK = 0.5, 25
# k and ζ of the filter that damps the link: for k = ζ/2, both pole pairs of s² + 1 in
# series with s² + 2ζs + 1 coincide, with damping ζ/2.
_FILTER = 0.6
# Triple poles are computed to the cube root of the precision of a double, 1e-5.
_SPLIT = 1.0 + 1e-3


class LawTripped(FraclinkError):
    """A guard of the control law tripped; the drive is off."""


class Follower:
    """law.c from one period to the next: a reference and a reading in, a voltage out."""

    def __init__(self, law: Law, payload: float = 0.0) -> None:
        self._law, self._state, self._payload = law, law.initial_state(), payload
        self._tick = 0

    def step(
        self,
        reference: float,
        acceleration: float,
        angle: float,
        torque: float,
        periods: int = 1,
    ) -> float:
        """Return the voltage [V]; `LawTripped` where the law switches off."""
        self._tick += periods
        inputs = LawInputs(reference, acceleration, angle, torque, self._payload)
        self._state, outputs = self._law.step(self._state, inputs, tick=self._tick)
        if outputs.mode >= MODES.index("degraded"):
            raise LawTripped(
                f"the law went to mode {MODES[outputs.mode]}: {REASONS[outputs.reason]}; the drive is off"
            )
        return outputs.voltage


def motor_law(
    motor: MotorGain, loop: MotorLoop, guard: Guard, *, friction: float = 0.0
) -> Law:
    """The law of the motor loop alone: no correction, no feed-forward, no use of the
    gauge.

    `friction` [V] is compensated.
    """
    limits, period, pole = guard.limits, guard.period, loop.pole
    # Room for everything that the guard allows: a move between the limits, and the
    # acceleration of a reference four times faster than the pole of the loop.
    moves = Moves(2 * limits.angle, limits.speed, max(4 * limits.speed * pole, 1.0))
    # Any link will do: its thresholds are raised, because the guard applies the limits
    # of the user.
    link, pid = LinkModel(1.0, 10.0, 1.9), loop.pid(motor, period)
    follows = following(link.resonance, period, pole, loop.delay_samples, motor, pid)
    derived = derive_limits(link, period, moves, loop=follows)
    # A threshold derived from an unknown stiffness could end the experiment that is to
    # measure it.
    free = derived.without(
        *("torque_limit", "torque_step", "torque_trip", "torque_block"),
        *("stuck_torque", "residual_angle", "frozen_angle", "swing_angle"),
    )
    return Law(
        period=period,
        precision="single",
        stiffness=1.0,
        # Without a correction law.c is just the motor loop: the controller that moves
        # the arm for identification is the one that ships, with its guards on encoder
        # and clock.
        correction=Modes(0.0),
        feedforward=Modes(0.0),
        motor_loop_pole=pole,
        motor_model=follows.model,
        limits=free,
        motor_loop=DiscreteMotorLoop(
            pid=pid,
            voltage_limit=limits.voltage,
            torque_voltage=0.0,
            coulomb_voltage=friction,
        ),
    )


def fastest_loop(
    motor: MotorGain,
    delay: float,
    period: float,
    *,
    ratios: tuple[float, ...],
    margin: float,
    most: float,
    kick: float = math.inf,
) -> MotorLoop:
    """The fastest motor loop that keeps its distance from −1 on motors with `ratios`
    times that gain, with a response of at most `kick` [V/rad] to a step of the angle.

    Its poles are placed in z with the delay in the equation, which leaves more distance
    than a discretised PID with the same pole: twice as much at 60 rad/s with a delay of
    one period of 4 ms.
    """
    # Up to half the sampling rate, where a delayed loop comes closest to −1.
    frequency = np.geomspace(1e-2, math.pi / period, 600)
    # At least one: a voltage takes effect when the next sample is taken.
    samples = max(1, round(delay / period))
    pole = most
    while pole > _SLOWEST:
        loop = MotorLoop(pole, samples, "sampled", "direct")
        if all(
            _keeps(loop, motor, ratio, period, frequency, margin, kick)
            for ratio in ratios
        ):
            return loop
        pole *= _STEP
    raise FraclinkError(
        f"no motor loop keeps a distance of {margin:g} from -1 with a delay of {1e3 * delay:.3g} ms at a "
        f"period of {1e3 * period:.3g} ms: shorten the delay or the period"
    )


def _keeps(
    loop: MotorLoop,
    motor: MotorGain,
    ratio: float,
    period: float,
    frequency: Real,
    margin: float,
    kick: float,
) -> bool:
    try:
        nominal = loop.sampled(motor, period)
    except FieldError:
        return False
    pid = nominal.pid
    at_once = (
        pid.direct
        + pid.angle_direct
        + pid.integral_gain * pid.integral_now
        + (pid.filter_gain + pid.angle_filter_gain) * pid.filter_now
    )
    if at_once > kick:
        return False
    true = replace(nominal, motor=MotorGain(motor.gain * ratio, motor.decay))
    # Poles first: the distance from −1 means nothing for an unstable loop. If the delay
    # adds a pole slower than those that were placed, the loop follows only at the speed
    # of that pole: with three samples of delay, a loop placed too fast has one at 0.1
    # rad/s.
    slowest = np.max(np.abs(true.poles()))
    if slowest >= 1.0 or (
        ratio == 1.0 and slowest > _SPLIT * math.exp(-loop.pole * period)
    ):
        return False
    return float(np.min(np.abs(1.0 + true.loop_gain(frequency)))) >= margin


def follow(
    guard: Guard,
    law: Law,
    path: Real,
    *,
    follower: Follower | None = None,
    origin: float | None = None,
    shaken: Real | None = None,
) -> Record:
    """Let the law follow a reference, rows angle [rad] and acceleration [rad/s²].

    The reference is relative to `origin`, or to the present position. `shaken` [V] is
    added to the law's voltage, one value per period.
    """
    here = guard.connect().angle
    start, origin = guard.count, here if origin is None else origin
    # A law that continues from the previous path keeps its integrator and its tick.
    runs = follower or Follower(law)
    more = np.zeros(path.shape[1]) if shaken is None else shaken
    rows = np.vstack([path, more]).T.tolist()
    # The reference goes on while samples are lost, as time does.
    while (row := guard.count - start) < len(rows):
        angle, acceleration, voltage = rows[row]
        reading = guard.reading
        # With the number of periods since the last sample, so that the law counts lost
        # samples as its own guards do.
        law_s = runs.step(
            origin + angle, acceleration, reading.angle, guard.torque, reading.periods
        )
        guard.step(law_s + voltage)
    return guard.record(start)


def random_moves(
    reach: float,
    speed: float,
    duration: float,
    period: float,
    *,
    seed: int,
    start: float = 0.0,
) -> Real:
    """Smooth moves between random angles within ± reach [rad], rest to rest, at most at
    `speed` [rad/s]; from `start` [rad] to 0.
    """
    random = np.random.default_rng(seed)
    at, parts, total = start, [], 0.0
    # The fit of the motor uses stretches of 30 samples or more in one direction.
    least = _STRETCH * period
    while total < max(duration, 4.0 * least):
        # To the other side each time: only reversals of the motor separate friction
        # from damping.
        to = float(random.uniform(0.3, 1.0) * reach) * (-1.0 if at > 0 else 1.0)
        # The last move ends at 0, so that the next stage has room on both sides.
        last = total > max(duration - 1.0, 3.0 * least)
        to = 0.0 if last else to
        # 15/8 is the ratio of peak to mean speed of the quintic.
        time = max(1.875 * abs(to - at) / (speed * random.uniform(0.5, 1.0)), least)
        parts.append(_move(at, to, time, math.ceil(time / period), period))
        at, total = to, total + time
        if last:
            break
    parts.append(_move(at, at, 0.3, round(0.3 / period), period))
    return np.concatenate(parts, axis=1)


def _move(at: float, to: float, duration: float, count: int, period: float) -> Real:
    """The first `count` samples of a smooth move from one angle to another [rad]."""
    move, grid = smooth_step(to - at, duration), period * np.arange(count)
    return np.array([at + move.angle(grid), move.acceleration(grid)])


def random_steps(
    reach: float,
    bit: float,
    rise: float,
    bits: int,
    period: float,
    *,
    start: float = 0.0,
) -> Real:
    """A pseudo-random binary sequence of ± reach [rad] whose edges are smooth moves of
    `rise` [s]; from `start` [rad] to 0.
    """
    levels = _random_levels(reach, bit, bits)
    # It starts at rest, because an identification takes the first samples as rest.
    parts = [_move(start, start, 0.2, round(0.2 / period), period)]
    if start:
        # An edge from 0 turns by `reach`; a larger distance is covered at the same
        # speed.
        slow = rise * max(1.0, abs(start) / reach)
        parts.append(_move(start, 0.0, slow, round(slow / period), period))
    count = max(round(bit / period), 2)
    edges = pairwise((0.0, *levels.tolist(), 0.0))
    parts += [_move(at, to, min(rise, bit), count, period) for at, to in edges]
    parts.append(_move(0.0, 0.0, 0.3, round(0.3 / period), period))
    return np.concatenate(parts, axis=1)


def _random_levels(size: float, bit: float, bits: int) -> Real:
    """A binary sequence of ± size that does not repeat within 2047 bits."""
    # The shortest register with enough bits: a sequence begins with as many equal bits
    # as the register has stages.
    stages: tuple[Literal[4, 5, 6, 7, 9, 10, 11], ...] = (4, 5, 6, 7, 9, 10, 11)
    register = next((count for count in stages if bits < 2**count), stages[-1])
    return prbs(size, bit, bits=bits, register=register).coefficients[:-1, 0]


def calm(
    guard: Guard,
    law: Law,
    *,
    stiffness: float,
    resonance: float,
    noise: float,
) -> None:
    """Damp a vibration of the link by the motor loop, until the gauge [N·m] only shows
    its `noise`, or for three vibration periods.

        θm = -k ω z/c,    z'' + 2ζω z' + ω² z = 2ζω Γ

    At ω, z is ∫Γ dt, which damps θt'' = ω² Γ/c; at a second mode it is ω/ω₂ times less,
    as ∫Γ dt itself would drive a lightly damped one. Of the damping ratio of 0.3, an
    error of a quarter in stiffness or resonance [rad/s] leaves 0.09 or more, and a
    gauge delay of 20 ms leaves 0.2.
    """
    runs, origin = Follower(law), guard.connect().angle
    last = guard.record(-round(math.tau / resonance / guard.period)).torque
    zero, swing = (float(np.mean(last)), float(np.ptp(last))) if last.size else (0, 0)
    # Within the limits, however much the link swings: k times its own deflection.
    reach = 0.5 * PLANNED * guard.limits.angle
    damping = min(0.5 * _FILTER, reach * stiffness / max(0.5 * swing, 1e-12))
    part, speed = 0.0, 0.0
    window, vibration = (
        math.ceil(span / guard.period) for span in (_CALM, math.tau / resonance)
    )
    # A damping ratio of 0.3 leaves 0.4 % after three periods; a longer motion is due to
    # friction.
    first, end = guard.count + window, guard.count + max(3 * vibration, window)
    while guard.count < end:
        if (
            guard.count >= first
            and np.std(guard.record(guard.count - window).torque) <= 1.2 * noise
        ):
            return
        # A tenth of a second (at 4 ms) between two checks: the standard deviation is that
        # of half a second anyway.
        for _ in range(_LOOK):
            reading = guard.reading
            push = 2.0 * _FILTER * resonance * (guard.torque - zero - speed)
            speed += guard.period * (push - resonance**2 * part)
            part += guard.period * speed
            reference = origin - damping * resonance * part / stiffness
            guard.step(
                runs.step(reference, 0.0, reading.angle, guard.torque, reading.periods)
            )


def burst(voltage: float, bit: float, seconds: float, period: float) -> Real:
    """Voltages of ± `voltage` [V] with random signs, changing every `bit` [s], followed
    by a rest in the motor loop.
    """
    count = max(round(bit / period), 1)
    levels = _random_levels(
        voltage, count * period, max(round(seconds / (count * period)), 2)
    )
    return np.concatenate([np.repeat(levels, count), np.zeros(round(0.2 / period))])
