"""The first moves under the new law, at a tenth of the speed and at full speed, with
promised and measured figures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fraclink._arm.reference import sampled, smooth_step
from fraclink._design import Design
from fraclink._display import Row, rows_of
from fraclink._law import Law
from fraclink._simulate.simulate import simulate
from fraclink.lab._tune_build import agree, twins_of
from fraclink.lab._tune_guard import Guard, Record, largest
from fraclink.lab._tune_judged import judged, settling_band
from fraclink.lab._tune_motion import Follower, calm, follow, motor_law
from fraclink.lab._tune_motor import MotorResult

__all__ = ["FirstMove", "first_moves"]

# [s] observed after a reference has come to rest: half a second in which the motor stops,
# and two in which it would slip
AFTER = 2.5
# the first move: a tenth of the speed, two fifths of the distance
_SLOW, _PART = 10.0, 0.4
_FIRST = 5  # periods in which a bump at the hand-over would show
_HUNTS = ": hunts, the motor goes back and forth and does not come to rest"


@dataclass(frozen=True)
class FirstMove:
    """One move: what the model promised and what the arm did, by the same estimate of
    the tip.

    Parameters
    ----------
    amplitude, duration
        of the reference [rad], [s].
    promised_settling, measured_settling
        time from which the tip stays within `band` [s].
    promised_unrest, measured_unrest
        half the peak-to-peak motor angle in the last two seconds [rad].
    band
        around its last angle in which the tip has settled [rad]: 2 % of the full move,
        or the noise where that is more.
    jump
        of the motor angle when the law took over [rad].
    peak_voltage
        [V].
    payload
        that the arm carried [kg].
    """

    amplitude: float
    duration: float
    promised_settling: float
    measured_settling: float
    promised_unrest: float
    measured_unrest: float
    band: float
    jump: float
    peak_voltage: float
    payload: float

    @property
    def rows(self) -> tuple[Row, ...]:
        """The promised and the measured figures."""
        return rows_of(
            self,
            ("payload", "payload", "g"),
            ("amplitude", "move", "rad"),
            ("duration", "in", "s", 3),
            Row.time("promised_settling", "settles, promised", self.promised_settling),
            Row.time("measured_settling", "measured", self.measured_settling),
            ("jump", "hand-over", "mrad"),
            ("peak_voltage", "peak", "V", 3),
        )

    @property
    def error(self) -> float:
        """Difference of the settling time from the promise [s]."""
        return abs(self.measured_settling - self.promised_settling)

    @property
    def kept(self) -> bool:
        """Whether the settling time was what was promised, within 10 % or 50 ms, and the
        motor came to rest.
        """
        return not self.hunts and agree(self.measured_settling, self.promised_settling)

    @property
    def hunts(self) -> bool:
        """Whether the motor goes on slipping where it should rest, by half a band more
        than the noise moves it: each slip swings the tip by its size to both sides, and
        two may add up.
        """
        return 2.0 * (self.measured_unrest - self.promised_unrest) > 0.5 * self.band

    def __str__(self) -> str:
        return (
            f"{math.degrees(self.amplitude):.3g}° in {self.duration:.3g} s with "
            f"{1e3 * self.payload:.3g} g: promised "
            f"{self.promised_settling:.2f} s, measured {self.measured_settling:.2f} s"
            + ("" if self.kept else _HUNTS if self.hunts else ": not kept")
        )


def first_moves(
    guard: Guard,
    design: Design,
    law: Law,
    motor: MotorResult,
    payload: float,
    move: tuple[float, float],
) -> tuple[FirstMove, ...]:
    """Transfer control from the motor loop to the law, move at a tenth of the speed,
    then back and forth at full speed: `move` is its amplitude [rad] and duration [s].
    Of the two full moves, the one that hunts counts, or else the one that differs more
    from the promise.
    """
    period, model = guard.period, design.model
    amplitude, duration = move
    # The band of the full move is also used for the slow one: with a smaller band,
    # friction and noise would determine the settling time.
    band = settling_band(amplitude, design)
    # The slow move first: it shows a wrong law at a tenth of the speed.
    moves = ((_PART * amplitude, _SLOW * _PART * duration), move, move)
    twin, promises = twins_of(design, motor)[0], []
    for size, length in moves:
        path, ends = smooth_step(size, length), length + AFTER
        run = simulate(law, path, arm=twin, payload=payload, told=True, duration=ends)
        read = run.motor_angle_measured, run.torque_measured
        promises.append(judged(*read, band, length, design))
    # The motor loop holds the arm before the law takes over, so that a bump is due to
    # the law and not to sagging. It also damps the link to half of the band (√2 times
    # the standard deviation), since vibration left by the previous stage would be taken
    # for that of the move.
    ringing = 0.5 / math.sqrt(2.0) * band * model.stiffness
    calm(
        guard,
        motor_law(motor.gain, motor.loop, guard, friction=motor.compensation),
        stiffness=model.stiffness,
        resonance=model.resonance,
        noise=math.hypot(design.rig.gauge.noise, ringing),
    )
    before = at = guard.angle
    runs, count = Follower(law, payload), round(0.2 / period)
    waited = follow(guard, law, np.zeros((2, count)), follower=runs)
    # Only the first periods count as a bump; later the law responds to the vibration of
    # the link.
    jump = largest(waited.angle[:_FIRST] - before)
    records = list[tuple[float, Record]]()
    # All moves in one run under the law, which damps the vibration left for the next
    # one, each towards the first position of the arm.
    for size, length in moves:
        far = math.copysign(size, -at)
        rows = sampled(smooth_step(far, length), period, length + AFTER)[[0, 2]]
        # The reference starts where the last one ended, not where friction has left the
        # arm.
        record = follow(guard, law, rows, follower=runs, origin=guard.origin + at)
        at += far
        records.append((far, record))
    # Judged with the drive off, since nothing controls the arm meanwhile.
    guard.release()
    first = []
    for (far, record), (_, length), promise in zip(
        records, moves, promises, strict=True
    ):
        turned = record.angle - record.angle[0]
        measured = judged(turned, record.torque, band, length, design)
        first.append(
            FirstMove(
                amplitude=far,
                duration=length,
                promised_settling=promise[0],
                measured_settling=measured[0],
                promised_unrest=promise[1],
                measured_unrest=measured[1],
                band=band,
                jump=jump,
                peak_voltage=largest(record.voltage),
                payload=payload,
            )
        )
    slow, *full = first
    return slow, max(full, key=lambda each: (each.hunts, each.error))
