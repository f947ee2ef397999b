"""The motor: identified in a loop that is slow enough for the errors of the wiring
check, and then its final loop.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fraclink._arm.motor_loop import MotorGain, MotorLoop
from fraclink._design.rows import NOISE_SHARE
from fraclink._files import document
from fraclink._identify import MotorFit, identify_motor
from fraclink._law import Law
from fraclink.errors import FraclinkError, LogError
from fraclink.lab._tune_guard import PLANNED, Guard, Record, largest
from fraclink.lab._tune_motion import fastest_loop, follow, motor_law, random_moves
from fraclink.lab._tune_wiring import Wiring

__all__ = [
    "MotorResult",
    "closed_motor",
    "fitted_motor",
    "tune_motor",
    "unlimited_pole",
]

# The first guess of K/J is accurate to a quarter; at low frequencies the inertia of the
# arm is added to that of the motor.
_UNSURE, _ROBUST = (0.4, 0.7, 1.0, 1.5), 0.35
# A fit is accurate to a few per cent; the rest is the dependence of gear and amplifier
# on position.
_SURE, _MARGIN = (0.85, 1.0, 1.15), 0.45
# [rad/s] at most: a faster loop takes more voltage for the same noise
_SLOW, _FAST = (25.0, 60.0)
# Share of the identified friction: along a gear and after a rest it differs by a fifth,
# and an overcompensation would drive the motor by itself.
_COMPENSATED = 0.8
FIRST = 0.12  # [rad], 7°
# Largest number of excitations of the motor, and of the link: if three do not suffice,
# length is not the problem.
ROUNDS = 3
# [s] at most: the fit of the motor includes the torque, and the first fit of the link
# works better with an arm at rest.
_RINGING = 1.5


@document("tuned-motor")
@dataclass(frozen=True)
class MotorResult:
    """The identified motor and its motor loop.

    `breakaway` is the largest voltage, with the link's torque, at which the motor stood
    still [V].
    """

    fit: MotorFit
    loop: MotorLoop
    breakaway: float = 0.0

    @property
    def gain(self) -> MotorGain:
        """A and B of the motor."""
        return MotorGain(self.fit.gain, self.fit.decay)

    @property
    def friction(self) -> float:
        """Voltage of friction and dead zone [V]."""
        return self.fit.coulomb_voltage + self.fit.dead_zone

    @property
    def compensation(self) -> float:
        """The compensating voltage [V] for friction and dead zone that drives nothing
        by itself.
        """
        return _COMPENSATED * self.friction

    def __str__(self) -> str:
        fit = self.fit
        return (
            f"K/J {fit.gain:.4g} rad/(s²·V), ν/J {fit.decay:.3g} 1/s, friction {self.friction:.3g} V, "
            f"delay {1e3 * fit.delay:.3g} ms; loop at {self.loop.pole:g} rad/s"
        )


def tune_motor(
    guard: Guard, wiring: Wiring, tell: Callable[[str], None] = lambda line: None
) -> MotorResult:
    """Identify the motor with moves that grow until K/J is known, and place its loop.

    `tell` receives a message if a move reached a limit and is repeated with a smaller
    size.
    """
    period, limits = guard.period, guard.limits
    # Without damping the model loses more phase than the motor does, so the loop comes
    # out on the slow side.
    guess = MotorGain(wiring.gain, 0.0)
    loop = fastest_loop(
        guess, wiring.delay, period, ratios=_UNSURE, margin=_ROBUST, most=_SLOW
    )
    law = motor_law(guess, loop, guard)
    # A quarter of the planned share: until K/J is known, only the guard limits the
    # speed.
    reach, speed = min(FIRST, PLANNED * limits.angle), PLANNED * limits.speed / 4
    fit: MotorFit | None = None
    for number in range(1, ROUNDS + 1):
        motion = partial(_moved, guard, wiring, law, loop.pole, reach, speed, number)
        record, size = guard.sized(motion, wiring.gauge_noise, tell)
        reach, speed = size * reach, size * speed
        guard.release()
        # In every round, since each adds information.
        with contextlib.suppress(LogError):
            fit = fitted_motor(guard.record(), wiring.gauge_delay, guard.starts)
            # Smooth moves hardly show a delay, which the edges of the doublets do: the
            # longer one leads to the slower loop.
            fit = replace(fit, delay=max(fit.delay, wiring.delay))
        if fit is not None:
            # Three standard errors of K/J within the range for which the loop is placed;
            # the motor is identified again later with all motion of the link
            # experiments.
            range_left = (max(_SURE) - 1.0) * fit.gain
            if fit.passed and 3.0 * fit.standard_errors["gain"] < range_left:
                break
            guess = MotorGain(fit.gain, max(fit.decay, 0.0))
            loop = fastest_loop(
                guess, fit.delay, period, ratios=_UNSURE, margin=_ROBUST, most=2 * _SLOW
            )
            law = motor_law(
                guess,
                loop,
                guard,
                friction=_COMPENSATED * max(fit.coulomb_voltage, 0.0),
            )
        # Not to the limit at once: the torque of a move grows with its speed as well as
        # with its size.
        reach *= min(
            PLANNED * limits.angle / reach,
            PLANNED * limits.torque / max(largest(record.torque), 1e-12),
            1.8,
        )
        speed = min(PLANNED * limits.speed, 1.8 * speed)
    if fit is None:
        raise FraclinkError(
            "the motor could not be identified: no stretches of 30 samples in one "
            f"direction within the limits, which take {30 * period:.2g} s at a period of "
            f"{1e3 * period:.3g} ms; a shorter period or wider limits help"
        )
    if not fit.passed:
        raise FraclinkError(
            f"the motor could not be identified: {fit.findings[0].message}"
        )
    return closed_motor(fit, guard, wiring)


def _moved(
    guard: Guard,
    wiring: Wiring,
    law: Law,
    pole: float,
    reach: float,
    speed: float,
    seed: int,
    size: float,
) -> Record:
    """The record of random moves with `size` times their reach and speed."""
    # For the first fit of the link, which takes the beginning of the record as rest.
    guard.quiet(wiring.gauge_noise, _RINGING)
    # Uncompensated friction makes the arm lag: the moves are slow enough for the loop
    # to follow. From the position in which a swinging link has left the motor, back to
    # about its first position.
    path = random_moves(
        size * reach,
        size * min(speed, 0.35 * pole * reach),
        3.0,
        guard.period,
        seed=seed,
        start=guard.angle,
    )
    return follow(guard, law, path, origin=guard.origin)


def closed_motor(fit: MotorFit, guard: Guard, wiring: Wiring) -> MotorResult:
    """Return a motor with the fastest loop allowed by a fit accurate to a few per cent
    and by the encoder's resolution.
    """
    # Values may be negative within their errors; a loop designed for negative friction
    # would be too fast.
    fit = replace(
        fit, decay=max(fit.decay, 0.0), coulomb_voltage=max(fit.coulomb_voltage, 0.0)
    )
    loop = fastest_loop(
        MotorGain(fit.gain, fit.decay),
        fit.delay,
        guard.period,
        ratios=_SURE,
        margin=_MARGIN,
        most=_FAST,
        # The encoder's noise is 1/√12 of a count, and takes no more voltage than the
        # noise of the gauge may.
        kick=math.sqrt(12.0)
        * NOISE_SHARE
        * guard.limits.voltage
        / max(wiring.count, 1e-12),
    )
    return MotorResult(fit, loop)


def breakaway_voltage(
    record: Record, motor: MotorResult, count: float, gauge_delay: float
) -> float:
    """The largest voltage [V], including the torque of the link, at which the encoder of
    steps `count` [rad] did not move: the friction that a motor at rest has to overcome.

    Each is a median over the time t in which a tenth more than the sliding friction
    would have moved the motor by a count, ½ΔV·A·t²: a voltage that jumps in the last of
    its periods has moved nothing yet, however large it is.
    """
    fit, period = motor.fit, record.period
    excess = 0.1 * motor.friction * fit.gain
    if fit.inertia is None or excess <= 0.0:
        return motor.friction
    width = math.ceil(math.sqrt(2.0 * count / excess) / period) + 1
    time = np.arange(record.angle.size) * period
    torque = np.interp(time + gauge_delay, time, record.torque)
    voltage = np.interp(time - fit.delay, time, record.voltage)
    push = voltage - torque / (fit.gain * fit.inertia)
    turned = np.ptp(sliding_window_view(record.angle, width + 1), axis=1)
    held = np.abs(np.median(sliding_window_view(push, width), axis=1))
    return max(
        motor.friction,
        float(np.max(held[: turned.size], where=turned < count, initial=0.0)),
    )


def unlimited_pole(motor: MotorResult, period: float, delay: float) -> float | None:
    """The pole [rad/s] of the fastest loop on that motor with a `delay` [s] and an
    ideal encoder; None if no loop keeps its distance.
    """
    try:
        return fastest_loop(
            motor.gain, delay, period, ratios=_SURE, margin=_MARGIN, most=_FAST
        ).pole
    except FraclinkError:
        return None


def fitted_motor(
    record: Record, gauge_delay: float, starts: Sequence[int] = ()
) -> MotorFit:
    """Return the motor with the torque shifted by the gauge's delay; `starts` as in
    `identify_motor`.

    A load that is late biases the motor: with a gauge delay of 30 ms, K/J of the
    paper's geared twin comes out 4 % too small. The torque of each piece is taken
    relative to its mean, which is zero from rest to rest, so that a drift of the gauge
    does not count as a load.
    """
    time = np.arange(record.torque.size) * record.period
    pieces = np.split(record.torque, [start for start in starts if start > 0])
    torque = np.concatenate([piece - piece.mean() for piece in pieces if piece.size])
    return identify_motor(
        record.voltage,
        record.angle,
        period=record.period,
        torque=np.interp(time + gauge_delay, time, torque),
        starts=starts,
        spring=True,
    )
