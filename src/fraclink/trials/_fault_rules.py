"""The catalogue: each fault of faults.toml with its injection and the measurement of
its requirement.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from typing import Literal

from fraclink._arm.reference import Reference
from fraclink._files.codec import Storage, codec_of
from fraclink.errors import FieldError
from fraclink.trials import _fault_arm as arm
from fraclink.trials import _fault_sensors as sensors
from fraclink.trials._fault_checks import (
    SAFE,
    Requirement,
    bounded,
    final,
    flagged,
    limit_cycle,
    only,
    peak,
    peak_over_best,
    peak_ratio,
    reacts,
    settled,
)
from fraclink.trials._fault_trial import (
    BAD_CRC,
    BAD_ENCODER,
    BAD_GAUGE,
    BAD_SIZE,
    BAD_VERSION,
    DEGRADED,
    ENCODER,
    EVER,
    FROZEN_ENCODER,
    FROZEN_GAUGE,
    GAUGE,
    HOLD,
    IDLE,
    MISSED,
    MOVE,
    OFF,
    REFERENCE,
    REPEATED,
    RESIDUAL,
    RUN,
    STARTED,
    Trial,
)
from fracsys.checks import checked

__all__ = ["CATALOGUE", "RULES", "Fault", "FaultRule", "fault_named"]


@dataclass(frozen=True)
class FaultRule:
    """What is done to a trial, and what is measured on its run.

    reference: of the run, where it is not the campaign's move. prepare: done to the
    faulty and the clean run alike. best: done to the faulty trial, too, to show what a
    law would do that knows of the fault at once.
    """

    inject: Callable[[Trial], None]
    require: tuple[Requirement, ...]
    reference: Reference = MOVE
    prepare: Callable[[Trial], None] | None = None
    best: Callable[[Trial], None] | None = None


RIDES = (only(RUN), peak_ratio(1.1))
# 20 periods are 80 ms: at the 1.6 rad/s of the catalogue's move, 0.13 rad until the
# drive is off. The encoder's own guard and the motor model's residual see the same
# fault; which is first depends on the phase.
OFF_BY_ENCODER = (reacts(OFF, 20, BAD_ENCODER, RESIDUAL), only(RUN, OFF))
# The fifth bad sample in a row is the law's own limit (`bad_limit`): three are ridden
# out.
GIVES_UP_GAUGE = (reacts(DEGRADED, 5, BAD_GAUGE), final(0.02), only(RUN, DEGRADED))

RULES = {
    "F01": FaultRule(
        sensors.one_bad("encoder", math.nan), (flagged(ENCODER, "encoder"), *RIDES)
    ),
    "F02": FaultRule(
        sensors.one_bad("gauge", math.nan), (flagged(GAUGE, "gauge"), *RIDES)
    ),
    "F03": FaultRule(sensors.three, (flagged(ENCODER, "encoder"), *RIDES)),
    "F04": FaultRule(
        sensors.both, (reacts(OFF, 5, BAD_ENCODER), sensors.held, only(RUN, OFF))
    ),
    "F05": FaultRule(
        sensors.one_bad("gauge", math.inf, -math.inf), (flagged(GAUGE, "gauge"), *RIDES)
    ),
    "F06": FaultRule(sensors.dropped, (*RIDES, sensors.settling)),
    "F07": FaultRule(
        sensors.stuck(FROZEN_ENCODER, 0.25, 0.5, EVER),
        (
            reacts(OFF, 20, BAD_ENCODER, RESIDUAL),
            peak(0.4, phases=("mid",)),
            only(RUN, OFF),
        ),
    ),
    "F08": FaultRule(sensors.stuck(FROZEN_ENCODER, 0.5, 2.0, 3.5), RIDES),
    "F09": FaultRule(sensors.rail, GIVES_UP_GAUGE),
    "F10": FaultRule(sensors.saturated, GIVES_UP_GAUGE),
    "F11": FaultRule(
        sensors.stuck(FROZEN_GAUGE, 0.25, 0.5, 1.0),
        (only(RUN, DEGRADED), peak_over_best(1.1)),
        best=sensors.without_gauge,
    ),
    # An offset of the gauge, which Ĉ(1) = 0 must reject exactly whenever it comes.
    "F12": FaultRule(sensors.offset, (only(RUN), final(1e-3))),
    "F13": FaultRule(sensors.offset, (only(RUN), final(1e-3))),
    "F14": FaultRule(sensors.drift, (only(RUN), final(5e-3))),
    "F15": FaultRule(sensors.gain, RIDES),
    "F16": FaultRule(
        arm.reversed,
        (arm.wiring_answer, arm.wiring_clean),
        arm.SELF_TEST,
        arm.self_test,
    ),
    "F17": FaultRule(sensors.noise, (only(RUN), sensors.noise_bound)),
    "F18": FaultRule(
        sensors.spikes, (flagged(GAUGE, "gauge"), only(RUN), peak_ratio(1.05))
    ),
    "F19": FaultRule(sensors.coarse, (only(RUN), sensors.one_count)),
    "F20": FaultRule(sensors.jitter, (only(RUN), sensors.jitter_peak)),
    "F21": FaultRule(
        sensors.few_missed, (flagged(MISSED, "missed"), only(RUN), sensors.gap_peak)
    ),
    "F22": FaultRule(
        sensors.dead, (flagged(MISSED, "missed"), sensors.off_at_once, only(RUN, OFF))
    ),
    "F23": FaultRule(sensors.repeated, (flagged(REPEATED, "repeated"), *RIDES)),
    "F24": FaultRule(sensors.delay, (only(RUN), peak_ratio(1.05))),
    "F25": FaultRule(
        sensors.jump, (flagged(REFERENCE, "reference"), only(RUN), sensors.overshoot)
    ),
    "F26": FaultRule(
        sensors.bad_reference, (flagged(REFERENCE, "reference"), only(RUN), final(0.02))
    ),
    "F27": FaultRule(
        sensors.limited,
        (only(RUN), sensors.recovery),
        sensors.THERE_AND_BACK,
        best=sensors.asked_for_less,
    ),
    "F28": FaultRule(
        sensors.slow, (only(RUN), limit_cycle(2e-3)), prepare=sensors.calm_end
    ),
    # A flipped bit may cost a jump of the tip, but neither the drive nor more than the
    # second in which the correction's slowest mode forgets.
    "F29": FaultRule(arm.flip, (only(RUN), peak(SAFE), settled(1.0))),
    "F30": FaultRule(arm.wipe, RIDES),
    "F31": FaultRule(
        arm.mismatch, (arm.refused(BAD_VERSION, BAD_SIZE, BAD_CRC), arm.silent)
    ),
    "F32": FaultRule(
        arm.restarts,
        (flagged(STARTED, "started"), arm.bumpless, only(RUN), final(0.02)),
    ),
    "F33": FaultRule(arm.far, (only(RUN), final(0.02))),
    "F34": FaultRule(
        arm.blind_start,
        (flagged(ENCODER, "encoder"), arm.idle, arm.silent, only(IDLE, RUN)),
    ),
    "F35": FaultRule(arm.degrees, OFF_BY_ENCODER),
    "F36": FaultRule(arm.wrapped, OFF_BY_ENCODER),
    "F37": FaultRule(arm.swapped, (arm.swap_reaction, only(RUN, OFF))),
    # Judged without noise: 1.2 times the peak of another run of noise is not what a
    # payload does.
    "F38": FaultRule(
        arm.other_payload,
        (only(RUN), arm.payload_peak, final(0.02)),
        prepare=sensors.without_noise,
    ),
    "F39": FaultRule(arm.payload_changes, (only(RUN), bounded(0.1), final(0.02))),
    "F40": FaultRule(arm.hit, (arm.hit_reaction, only(RUN, HOLD))),
    "F41": FaultRule(arm.sticky, (only(RUN), arm.hunting)),
    # 0.2 rad is that the loop is stable at all, far above what the final error shows;
    # the catalogue asks for no more of a motor loop at half its pole.
    "F42": FaultRule(arm.slow_motor, (only(RUN), bounded(0.2), final(0.02))),
    "F43": FaultRule(
        arm.nothing,
        (only(RUN), arm.denormals, arm.quiet_trips),
        prepare=sensors.calm_end,
    ),
    "F44": FaultRule(arm.damaged, (arm.refused(BAD_CRC, BAD_CRC, BAD_CRC), arm.silent)),
}


@dataclass(frozen=True)
class Fault:
    """A row of the catalogue, as faults.toml explains it.

    reaction: A ride through, B degrade, C hold, D off, "-" for another requirement.
    duration of the run [s]. cause: why the shipped law misses the requirement on the
    paper's arm. note: what the campaign cannot show.
    """

    number: str
    title: str
    injection: str
    severities: tuple[str, str, str]
    required: str
    reaction: Literal["A", "B", "C", "D", "-"]
    phases: tuple[str, ...] = ("start", "mid", "rest")
    duration: float = 7.0
    nominal: bool = False
    skips: tuple[tuple[int, str], ...] = ()
    cause: str = ""
    note: str = ""

    @property
    def rule(self) -> FaultRule:
        """What is done and measured."""
        return RULES[self.number]


def _catalogue() -> tuple[Fault, ...]:
    # Read at import, as every command names the faults; the table is data that a user
    # may read, without code.
    rows = tomllib.loads(
        files("fraclink").joinpath("trials/faults.toml").read_text("utf-8")
    )
    decode = codec_of(Fault).decode
    return tuple(
        decode({"number": number, **row}, number, Storage())
        for number, row in sorted(rows.items())
    )


CATALOGUE = _catalogue()


@checked
def fault_named(number: str) -> Fault:
    """Return a fault by its number; FieldError where there is none.

    >>> fault_named("F07").title
    'encoder stuck in a move'
    """
    # A number typed by hand may be in small letters.
    found = next((fault for fault in CATALOGUE if fault.number == number.upper()), None)
    if found is None:
        allowed, remedy = (
            f"{CATALOGUE[0].number} … {CATALOGUE[-1].number}",
            "choose one of these",
        )
        raise FieldError(
            "only", number, "not in the catalogue", allowed=allowed, remedy=remedy
        )
    return found
