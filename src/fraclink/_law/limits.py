"""The guards of the law: every threshold is derived from the largest move, the design
and the sensors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fraclink._arm.link import LinkModel
    from fraclink._arm.rig_parts import Moves
    from fraclink._law.tracking import Following

__all__ = ["Limits", "derive_limits"]

# Largest payload relative to the nominal one, and with it the flexion and the torque of
# a move: a larger value is taken for a wrong unit.
LARGEST_SCALE = 4.0
# [s] in which the scale of the feed-forward changes by 1: within a move, but without a
# jump
SCALE_TIME = 0.1
# Time constant with which the law follows a jump of the reference, in units of
# 1/ω_resonance.
JUMP = 3.0
# [s]: the correction fades slowly enough not to excite the link, and fast enough to be
# gone within a move
FADE_TIME = 0.2
# Periods for which the reading of a sound gauge without delay may stay the same. In an
# ordinary move the model passes the threshold torque within five periods, and a stuck
# gauge is found in 15.
STILL = 10
# resolution of a converter, where the quantum of the gauge is not stated
CONVERTER_BITS = 12
# Share of the range of a gauge: a saturated amplifier reads its limit, which is not
# credible.
CREDIBLE_SHARE = 0.975
# Share of the largest credible torque: a trip must lie below it to be detected.
TRIP_SHARE = 0.9
# [rad]: about 3°, a swing that a person next to the arm can see
SWING = 0.05
# Far above every angle, torque, speed and voltage of an arm, but not infinite: a block
# holds finite numbers only, and may be in single precision.
UNBOUNDED = 1e6


@dataclass(frozen=True)
class Limits:
    """Thresholds of the guards in law.c; the names are those of its parameter block."""

    sum_limit: float
    correction_limit: float
    forward_limit: float
    angle_limit: float
    angle_step: float
    torque_limit: float
    torque_step: float
    torque_trip: float
    torque_block: float
    reference_step: float
    reference_rate: float
    acceleration_limit: float
    payload_limit: float
    scale_step: float
    motor_limit: float
    motor_step: float
    fade_step: float
    residual_angle: float
    frozen_angle: float
    stuck_torque: float
    wiring_energy: float
    swing_angle: float
    # 20 ms at 4 ms: three lost samples in a row are bridged, a broken wire is not
    bad_limit: int = 5
    missed_limit: int = 5
    residual_limit: int = 10
    stuck_limit: int = STILL
    # samples are not lost in runs as long as this, and the motor does not move far
    # within one
    frozen_limit: int = 8
    block_limit: int = 100  # derived from the resonance
    stop_ringing: bool = False

    def without(self, *thresholds: str) -> Limits:
        """Return the limits in which the named thresholds never act."""
        wide: dict[str, Any] = dict.fromkeys(thresholds, UNBOUNDED)
        return replace(self, **wide)


def derive_limits(
    link: LinkModel,
    period: float,
    moves: Moves,
    *,
    loop: Following,
    gauge_limit: float = math.inf,
    gauge_noise: float = 0.0,
    gauge_quantum: float = 0.0,
    encoder_resolution: float = 0.0,
    sticking: float = math.inf,
    kick: float = 3.0,
    heaviest: float = 2.0,
) -> Limits:
    """Return the thresholds for moves up to `moves` at `period` [s].

    `sticking` [rad]: how far friction may keep the motor behind its reference, infinite where it is unknown.
    `kick`: Ĉ's gain at the highest frequency, the direct part of its filter. `heaviest`: ratio of the heaviest
    payload to the link's, by which a lasting deflection grows. Largest torque of a move: c a
    |s^(λ-2)/(μ s^α + ω₀²)| at the resonance, doubled for payloads beyond the nominal one. `loop`: how the placed
    motor loop, with its delay, follows its reference, and the error of its model. The
    reason for each number is given beside it in the source.
    """
    resonance = link.resonance
    flexible = float(abs(link.lead(resonance))) * moves.acceleration
    # Doubled: no limit may trip on a payload beyond the nominal one.
    torque = 2 * link.stiffness * flexible
    # The law's own range is symmetric about the encoder's zero.
    reach = moves.angle + abs(moves.centre)
    # Reference, feed-forward and correction may each require the full speed at the same
    # time.
    motor_step = 3 * moves.velocity * period
    # Like that of the motor angle, the range of the torque is symmetric about zero.
    resting = abs(moves.rest_torque)
    torque_limit = min(LARGEST_SCALE * torque + resting, CREDIBLE_SHARE * gauge_limit)
    # A vibrating link swings back within half a period. A deflection that lasts longer
    # is due to an acceleration, which is limited by the change of the reference's speed
    # from one extreme to the other.
    hold = 1.5 * math.pi / resonance
    lasting = float(abs(link.lead(math.pi / hold))) * min(
        moves.acceleration, 2 * moves.velocity / hold
    )
    # at the full speed and acceleration of the command: one missed period, and the part
    # of the loop that the model leaves out
    residual = (
        (1 + loop.slow) * motor_step
        + 3 * loop.quick * moves.acceleration * period**2
        + 0.02
    )
    # the link bends by at most the motor's own step; a sample of noise stays below 8
    # standard deviations for centuries
    torque_step = 2 * link.stiffness * motor_step + 8 * gauge_noise + 2 * gauge_quantum
    return Limits(
        # the correction's jump at the largest torque and reference steps, and the feed-forward
        sum_limit=LARGEST_SCALE * flexible
        + kick * (torque_step / link.stiffness + 1.05 * moves.velocity * period),
        # 0.15 rad: residual vibration and gauge offset in addition to the lag
        correction_limit=1.5 * (loop.lag * period * moves.velocity + 0.15),
        # the states sum the acceleration with weights that decay (poles from 0 to 1),
        # so they stay below its largest sum, 2 v/T for a reversal at full speed; half
        # as much again is in reserve, as for the correction
        forward_limit=3 * moves.velocity / period,
        # The motor leads the tip by the flexion, at both ends of a move.
        angle_limit=reach + 2 * flexible,
        angle_step=2 * motor_step + 2 * encoder_resolution,
        torque_limit=torque_limit,
        torque_step=torque_step,
        torque_trip=min(
            1.5 * torque + resting, TRIP_SHARE * torque_limit, moves.torque
        ),
        torque_block=min(
            heaviest * link.stiffness * lasting + resting,
            TRIP_SHARE * torque_limit,
            moves.torque,
        ),
        reference_step=1.05 * moves.velocity * period,
        reference_rate=-math.expm1(-resonance * period / JUMP),
        acceleration_limit=1.2 * moves.acceleration,
        payload_limit=LARGEST_SCALE
        * (link.payload or 0.0),  # 0: a law without a payload accepts none
        scale_step=min(1.0, period / SCALE_TIME),
        motor_limit=reach,
        motor_step=motor_step,
        fade_step=min(1.0, period / FADE_TIME),
        residual_angle=residual,
        # a move that has begun in the model but, because of three periods of delay, not yet
        # in the motor
        frozen_angle=min(
            residual,
            2 * encoder_resolution
            + max(sticking, 4.5 * moves.acceleration * period**2),
        ),
        stuck_torque=_stuck_torque(link, period, torque_limit, gauge_quantum),
        # a sound gauge also reads the same throughout its delay
        stuck_limit=STILL + math.ceil(link.gauge_lag / period),
        # eight standard deviations of the tip's reading are not yet vibration
        swing_angle=max(
            SWING if moves.vibration is None else moves.vibration,
            8 * gauge_noise / link.stiffness,
        ),
        stop_ringing=moves.vibration is not None,
        block_limit=max(5, round(hold / period)),
        # sum of squared motor steps whose torque is 6 standard deviations of the noise of
        # a torque step, at least the sum for 0.1 rad in 25 periods
        wiring_energy=max(
            (6 * math.sqrt(2) * gauge_noise / link.stiffness) ** 2, 0.1**2 / 25
        ),
    )


def _stuck_torque(
    link: LinkModel, period: float, largest: float, quantum: float
) -> float:
    """The torque of the model above which a constant reading means a stuck gauge.

    The reading of a sound gauge stays constant while the motor turns by less than one
    quantum, q/c. With the jerk j of the reference this takes (6q/cj)^(1/3); the torque
    of the model is then c j/ω² times that time. Whatever j is, the reading then changes
    at most n = `STILL` periods after the torque of the model passed 8q/(9n²ω²T²), and
    with noise even sooner.
    """
    step = max(quantum, 2 * largest / 2**CONVERTER_BITS)
    slow = 8 / (9 * (STILL * link.resonance * period) ** 2)
    return float(max(8.0, slow) * step)
