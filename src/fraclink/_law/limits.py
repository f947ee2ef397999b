"""The law's guards: every threshold from the largest move, the design and the sensors,
none guessed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypedDict

if TYPE_CHECKING:
    from fraclink._arm.link import LinkModel
    from fraclink._arm.rig_parts import Moves
    from fraclink._law.tracking import Following

__all__ = ["Limits", "derive_limits"]

# times the nominal payload: more is a wrong unit, and beyond what bounds the torque
LARGEST_SCALE = 4.0
# [s] in which the scale of the feed-forward changes by 1: within a move, without a jump
SCALE_TIME = 0.1
# of 1/ω_resonance: the time constant with which a jump of the reference is followed
JUMP = 3.0
# [s]: the correction leaves slowly enough not to ring the link, fast enough to be gone
# in a move
FADE_TIME = 0.2
# periods with one reading of a gauge without delay that is not stuck: a stuck one is
# found in 15 of an ordinary move, in which the model passes its torque in five
STILL = 10
# of a converter, where nobody states the gauge's quantum
CONVERTER_BITS = 12
# of a gauge's range: an amplifier at its rail reads its limit, which is not credible
CREDIBLE_SHARE = 0.975
# of the largest credible torque: a trip must lie below it to be seen
TRIP_SHARE = 0.9
# [rad]: a twentieth of a radian, 3°: whoever stands beside the arm sees it swing
SWING = 0.05


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
    # 20 ms at 4 ms: three lost samples in a row are ridden through, a dead wire is not
    bad_limit: int = 5
    missed_limit: int = 5
    residual_limit: int = 10
    stuck_limit: int = STILL
    frozen_limit: int = (
        8  # lost samples do not come in such rows, and a motor is not far by then
    )
    block_limit: int = 100  # derived from the resonance
    stop_ringing: bool = False


class _Stuck(TypedDict):
    stuck_torque: float
    stuck_limit: int


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
) -> Limits:
    """Return the thresholds for moves up to `moves` at `period` [s].

    `sticking` [rad]: how far friction may keep the motor behind its reference, infinite where it is unknown.
    `kick`: Ĉ's gain at the highest frequency, the direct part of its filter. Largest torque of a move: c a
    |s^(λ-2)/(μ s^α + ω₀²)| at the resonance, doubled for payloads beyond the nominal one. `loop` is the motor loop
    as it was placed, its delay included. Reasons stand beside each number in the source.
    """
    # 1/G − 1 is what the motor must lead the tip by, and s² of it belongs to the
    # acceleration.
    resonance = abs(link.pole)
    flexible = (
        abs(1 / link.tip()(1j * resonance) - 1) / resonance**2 * moves.acceleration
    )
    # Twice: payloads beyond the nominal one bend the link more, and no limit may trip
    # on them.
    torque = 2 * link.stiffness * flexible
    # The law's own range is symmetric to the encoder's zero.
    reach = moves.angle + abs(moves.centre)
    lag = loop.lag * period
    # Reference, feed-forward and correction may each ask for the full speed at once.
    motor_step = 3 * moves.velocity * period
    torque_limit = min(4 * torque, CREDIBLE_SHARE * gauge_limit)
    error = lag * moves.velocity
    # A link that vibrates swings back in half a period; what it is bent by for longer
    # is an acceleration that the reference's speed, from one end to the other, leaves
    # room for.
    held = 1.5 * math.pi / resonance
    slow = abs(1 / link.tip()(1j * math.pi / held) - 1) * (held / math.pi) ** 2
    block = (
        2 * link.stiffness * slow * min(moves.acceleration, 2 * moves.velocity / held)
    )
    # at the full speed and acceleration of the command: a period that was missed, and
    # what the model leaves out of the loop
    residual = (
        (1 + loop.slow) * motor_step
        + 3 * loop.quick * moves.acceleration * period**2
        + 0.02
    )
    # the motor can bend the link by its own step; a sample's noise is below 8
    # deviations for centuries
    torque_step = 2 * link.stiffness * motor_step + 8 * gauge_noise + 2 * gauge_quantum
    return Limits(
        # what an offset that appears may ask for at once, on top of the feed-forward
        sum_limit=4 * flexible
        + kick * (torque_step / link.stiffness + 1.05 * moves.velocity * period),
        correction_limit=1.5
        * (
            error + 0.15
        ),  # 0.15 rad: residual vibration and gauge offset on top of the lag
        forward_limit=3
        * moves.velocity
        / period,  # the states sum the acceleration, which sums to the speed
        # The motor leads the tip by the flexion at both ends of a move.
        angle_limit=reach + 2 * flexible,
        angle_step=2 * motor_step + 2 * encoder_resolution,
        torque_limit=torque_limit,
        torque_step=torque_step,
        torque_trip=min(1.5 * torque, TRIP_SHARE * torque_limit, moves.torque),
        torque_block=min(block, TRIP_SHARE * torque_limit, moves.torque),
        reference_step=1.05 * moves.velocity * period,
        reference_rate=-math.expm1(-resonance * period / JUMP),
        acceleration_limit=1.2 * moves.acceleration,
        payload_limit=LARGEST_SCALE
        * (link.payload or 0.0),  # 0: a law that knows no payload takes none
        scale_step=min(1.0, period / SCALE_TIME),
        motor_limit=reach,
        motor_step=motor_step,
        fade_step=min(1.0, period / FADE_TIME),
        residual_angle=residual,
        # a move that has begun in the model but, for three periods of delay, not in the
        # motor
        frozen_angle=min(
            residual,
            2 * encoder_resolution
            + max(sticking, 4.5 * moves.acceleration * period**2),
        ),
        **_stuck(link, period, torque_limit, gauge_quantum),
        # eight deviations of the tip's reading are no vibration
        swing_angle=max(
            SWING if moves.vibration is None else moves.vibration,
            8 * gauge_noise / link.stiffness,
        ),
        stop_ringing=moves.vibration is not None,
        block_limit=max(5, round(held / period)),
        # sum of squared motor steps whose torque stands 6 deviations above the noise of
        # a torque step, and at least that of 0.1 rad in 25 periods
        wiring_energy=max(
            (6 * math.sqrt(2) * gauge_noise / link.stiffness) ** 2, 0.1**2 / 25
        ),
    )


def _stuck(link: LinkModel, period: float, largest: float, quantum: float) -> _Stuck:
    """From which motion of the model on, and for how many periods in which the motor
    turns, a gauge that stands still is stuck.

    A good one reads the same for its delay, and while the motor turns by less than a
    quantum's worth, q/c. With the jerk j of the reference that takes (6q/cj)^(1/3),
    when the model has c j/ω² of it in torque: for no j is that more than n periods after
    the model passed 8q/(9n²ω²T²). Noise only moves the reading.
    """
    step = max(quantum, 2 * largest / 2**CONVERTER_BITS)
    slow = 8 / (9 * (STILL * abs(link.pole) * period) ** 2)
    return {
        "stuck_torque": max(8.0, slow) * step,
        "stuck_limit": STILL + math.ceil(max(link.gauge_delay, 0.0) / period),
    }
