"""F29–F34 and F44: the law's memory, its parameters and its start."""

from __future__ import annotations

import math
import struct

import numpy as np

from fraclink._campaign.faults import evidence as need
from fraclink._campaign.faults.evidence import RUN, Evidence
from fraclink._campaign.faults.inject import (
    REALS,
    TICK_MISSED,
    add_fault,
    bad_samples,
    corrupt,
    flip,
    members,
    restart,
    width,
)
from fraclink._campaign.faults.nouns import Check, Fault
from fraclink._campaign.faults.trial import Trial
from fraclink._simulate.kernel import ArmState

__all__ = ["MEMORY"]

IDLE = 0
BAD_VERSION, BAD_SIZE, BAD_CRC = 1, 2, 3
HEADER, COUNTS = 16, 40  # bytes of law_params before its reals


def _flip(trial: Trial) -> None:
    modes = len(trial.law.correction.poles)
    mode = f"modes[{int(trial.chance.integers(modes))}]" if modes else "modes[16]"
    if trial.severity == 3:
        live = [name for name in REALS if not name.startswith("modes")] + [mode]
        mode = live[int(trial.chance.integers(len(live)))]
    flip(trial, mode, 0 if trial.severity == 1 else 1)


def _wipe(trial: Trial) -> None:
    def action(arm: ArmState) -> None:
        if trial.severity == 3:
            members(arm.law, width(trial))[:] = math.nan
        else:
            arm.law[:] = (0x00, 0xFF)[trial.severity - 1]

    trial.at(trial.row, action)


def _mismatch(trial: Trial) -> None:
    version, size, _, crc = struct.unpack_from("<IIII", trial.block)
    byte, value = ((0, version + 1), (4, size - 4), (12, crc ^ 1))[trial.severity - 1]
    corrupt(trial, byte, value)


def _damaged(trial: Trial) -> None:
    direct = HEADER + COUNTS + 2 * width(trial)
    inside = HEADER + int(trial.chance.integers(len(trial.block) - HEADER))
    corrupt(trial, (direct, len(trial.block) - 1, inside)[trial.severity - 1])


def _refused(*reasons: int) -> need.Required:
    def check(e: Evidence) -> Check:
        wanted = reasons[e.case.severity - 1]
        wrong = (e.faulty.mode != IDLE) | (e.faulty.reason != wanted)
        return Check.at_most(f"periods not refused for reason {wanted}", int(np.count_nonzero(wrong)), 0)

    return check


def _silent(e: Evidence) -> Check:
    """Voltage and motor reference of a law that must not have started."""
    rows = e.marks if e.marks.any() else slice(None)
    out = np.abs(np.vstack((e.faulty.command[rows], e.faulty.asked[rows])))
    return Check.at_most("output of a law that is not started", out.max(), 0.0)


def _restarts(trial: Trial) -> None:
    if trial.severity == 2:
        add_fault(trial, slice(trial.row, trial.row + 3), TICK_MISSED)
        restart(trial, trial.row + 3)
        return
    restart(trial, trial.row)
    if trial.severity == 3:
        restart(trial, trial.row + 25)


def _bumpless(e: Evidence) -> Check:
    apart = np.abs(e.faulty.command - e.faulty.encoder)[e.marks]
    return Check.at_most("first command from the motor angle [rad]", apart.max(), e.law.limits.motor_step)


def _far(trial: Trial) -> None:
    trial.start_angle += trial.pick(1.0, 2.0, 3.0)


def _blind_start(trial: Trial) -> None:
    bad_samples(trial, "encoder", math.nan, slice(0, (1, 25, trial.count)[trial.severity - 1]))


def _idle(e: Evidence) -> Check:
    wrong = e.marks[: len(e.faulty.mode)] & (e.faulty.mode != IDLE)
    return Check.at_most("blind periods in another mode than idle", int(np.count_nonzero(wrong)), 0)


MEMORY: tuple[Fault, ...] = (
    Fault(
        "F29",
        "bit flip in the state",
        "sign of a mode; highest exponent bit of a mode; highest exponent bit of any real",
        "peak <= 0.3 rad, recovered in 1 s",
        ("sign of a mode", "exponent of a mode", "exponent of any real"),
        "A",
        _flip,
        (need.only(RUN), need.peak(0.3), need.settled(1.0)),
    ),
    Fault(
        "F30",
        "whole state wiped",
        "every byte 0x00, every byte 0xFF, every real NaN",
        "finite at once, peak <= 1.1 x clean",
        ("0x00", "0xFF", "NaN"),
        "A",
        _wipe,
        (need.only(RUN), need.peak_ratio(1.1)),
    ),
    Fault(
        "F31",
        "parameter block of another version, size or CRC",
        "the word in the block's header is changed before the start",
        "refused with its reason; no output",
        ("version", "size", "CRC"),
        "-",
        _mismatch,
        (_refused(BAD_VERSION, BAD_SIZE, BAD_CRC), _silent),
        phases=("whole",),
        duration=2.0,
    ),
    Fault(
        "F32",
        "restart in a move",
        "law_init while the arm moves, once; after 3 missed periods; twice within 0.1 s",
        "first command at the motor angle, step in limits; no trip, final <= 0.02 rad",
        ("once", "after 3 missed periods", "twice"),
        "A",
        _restarts,
        (need.flagged(need.STARTED, "started"), _bumpless, need.only(RUN), need.final(0.02)),
    ),
    Fault(
        "F33",
        "start far from the reference",
        "the arm stands 1, 2, 3 rad from the reference",
        "ramp within the step limit, no trip, final <= 0.02 rad",
        ("1 rad", "2 rad", "3 rad"),
        "A",
        _far,
        (need.only(RUN), need.final(0.02)),
        phases=("whole",),
    ),
    Fault(
        "F34",
        "start with a dead encoder",
        "encoder NaN for 1 sample, 25 samples, ever",
        "idle, output 0 and flag while blind; then a bumpless start",
        ("1 sample", "25 samples", "for ever"),
        "-",
        _blind_start,
        (need.flagged(need.ENCODER, "encoder"), _idle, _silent, need.only(IDLE, RUN)),
        phases=("whole",),
    ),
    Fault(
        "F44",
        "parameter block corrupted",
        "one bit of a coefficient, of the last byte, of any byte, before the start",
        "refused for its CRC; no output",
        ("a coefficient", "the last byte", "any byte"),
        "-",
        _damaged,
        (_refused(BAD_CRC, BAD_CRC, BAD_CRC), _silent),
        phases=("whole",),
        duration=2.0,
        note="the law checks its block when it starts, not in every period",
    ),
)
