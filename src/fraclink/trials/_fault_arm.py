"""Faults of memory, start, wiring, arm and motor: each injection, and what only it
measures.
"""

from __future__ import annotations

import functools
import math
import struct
from dataclasses import replace

import numpy as np

from fraclink._arm.motor import place_pid
from fraclink._arm.reference import Reference, smooth_step
from fraclink._law import Modes
from fraclink._simulate import sensors as columns
from fraclink._simulate.kernel import ArmState
from fraclink.trials._fault_checks import (
    ANY,
    SAFE,
    Check,
    Evidence,
    Requirement,
    bounded,
    limit_cycle,
    peak_ratio,
    reacts,
    settled,
)
from fraclink.trials._fault_trial import (
    BAD_ENCODER,
    EVER,
    HOLD,
    IDLE,
    MOVE_BEGINS,
    OFF,
    OVERLOAD,
    REALS,
    RESIDUAL,
    RUN,
    SWAPPED,
    TICK_MISSED,
    Real,
    Trial,
    members,
)

HEADER, COUNTS = 16, 40  # bytes of law_params before its reals
# The paper's gauge, with a noise of 0.01 N·m, asks for 0.24 rad in this time
# (`Law.wiring_angle`).
SELF_TEST: Reference = smooth_step(0.35, duration=0.12, start=0.1)


# ---- memory, parameters, start -----------------------------------------------------------------------


def flip(trial: Trial) -> None:
    modes = len(trial.law.correction.poles)
    # A law with nothing but pairs keeps them behind the sixteen real modes. A mode that
    # the law does not have is not in its memory's path: flipping it would test nothing.
    name = f"modes[{int(trial.chance.integers(modes))}]" if modes else "modes[16]"
    if trial.case.severity == 3:
        live = [real for real in REALS if not real.startswith("modes")] + [name]
        name = live[int(trial.chance.integers(len(live)))]
    trial.flip(name, 0 if trial.case.severity == 1 else 1)


def wipe(trial: Trial) -> None:
    def action(arm: ArmState) -> None:
        if trial.case.severity == 3:
            # Reals alone: with the words gone, too, it is the case of severity 2.
            members(arm.law, trial.width)[:] = math.nan
        else:
            arm.law[:] = (0x00, 0xFF)[trial.case.severity - 1]

    trial.at(trial.row, action)


def mismatch(trial: Trial) -> None:
    version, size, _, crc = struct.unpack_from("<IIII", trial.block)
    # Words 0, 1 and 3 of the header. The law must name which: its reasons are what a
    # user of a board reads.
    trial.corrupt(
        *((0, version + 1), (4, size - 4), (12, crc ^ 1))[trial.case.severity - 1]
    )


def damaged(trial: Trial) -> None:
    # The third real: Ĉ's direct gain, which a law that did not look would multiply into
    # every command.
    direct = HEADER + COUNTS + 2 * trial.width
    inside = HEADER + int(trial.chance.integers(len(trial.block) - HEADER))
    trial.corrupt(int(trial.pick(direct, len(trial.block) - 1, inside)))


def refused(*reasons: int) -> Requirement:
    def check(e: Evidence) -> Check:
        # In every period and for that reason: a law that starts after some calls, or
        # refuses for another cause, has not understood its block.
        reason = int(e.pick(*reasons))
        wrong = (e.faulty.mode != IDLE) | (e.faulty.reason != reason)
        return Check.at_most(
            f"periods not refused for reason {reason}", int(np.count_nonzero(wrong)), 0
        )

    return check


def silent(e: Evidence) -> Check:
    """Voltage and motor reference of a law that must not have started."""
    rows = e.marked if e.marks.any() else slice(None)
    out = np.abs(np.vstack((e.faulty.command[rows], e.faulty.asked[rows])))
    return Check.at_most("output of a law that is not started", out.max(), 0.0)


def restarts(trial: Trial) -> None:
    if trial.case.severity == 2:
        # The processor that restarts the law was away for as long: the arm went on with
        # its last voltage.
        trial.set_bits(slice(trial.row, trial.row + 3), TICK_MISSED)
    trial.restart(trial.row + int(trial.pick(0, 3, 0)))
    if trial.case.severity == 3:
        trial.restart(trial.row + 25)


def bumpless(e: Evidence) -> Check:
    apart = np.abs(e.faulty.command - e.faulty.encoder)[e.marked]
    return Check.at_most(
        "first command from the motor angle [rad]", apart.max(), e.law.limits.motor_step
    )


def far(trial: Trial) -> None:
    # The arm, and not the reference, so that the move to come is that of all other
    # faults.
    trial.start_angle += trial.pick(1.0, 2.0, 3.0)


def blind_start(trial: Trial) -> None:
    trial.replace_reading(
        "encoder", math.nan, slice(0, int(trial.pick(1, 25, trial.count)))
    )


def idle(e: Evidence) -> Check:
    wrong = e.marked & (e.faulty.mode != IDLE)
    return Check.at_most(
        "blind periods in another mode than idle", int(np.count_nonzero(wrong)), 0
    )


# ---- wiring, units, the arm, its surroundings and its motor ------------------------------------------


def self_test(trial: Trial) -> None:
    """The commissioning move: motor loop alone, without correction and compensation by
    the gauge.
    """
    drive = trial.law.drive
    assert drive is not None  # a bench gives every law a motor loop  # noqa: S101
    # A gauge that is wired backwards would turn compensation and correction into
    # positive feedback: the test of its sign must not depend on it.
    alone = replace(drive, torque_voltage=0.0)
    trial.use(
        replace(trial.law, correction=Modes(0.0), feedforward=Modes(0.0), drive=alone)
    )


def reversed(trial: Trial) -> None:
    trial.inputs[:, columns.GAUGE_GAIN] = trial.pick(-1.0, -1.0, -0.5)
    trial.inputs[:, columns.GAUGE_ERROR] += trial.pick(0.0, 0.1, 0.1)


def wiring_answer(e: Evidence) -> Check:
    answer = e.law.check_wiring(e.faulty.encoder, e.faulty.gauge)
    return Check.at_most(
        f"wiring test failed to refuse (it says: {answer})",
        answer != "gauge reversed",
        0,
    )


def wiring_clean(e: Evidence) -> Check:
    answer = e.law.check_wiring(e.clean.encoder, e.clean.gauge)
    return Check.at_most(
        f"wiring test refused a good gauge (it says: {answer})", answer != "none", 0
    )


def degrees(trial: Trial) -> None:
    """Count from when the reading of the motor differs from its angle by more than a
    good one may.

    At zero angle the fault does not show: `residual_angle` is what a motor may be away
    from its model. The motor is where its reference was a lag of 2/p + 1.5 T ago, the
    one that the guards count on, too.
    """
    factor = trial.pick(10.0, 180 / math.pi, 1800 / math.pi)
    trial.inputs[trial.row :, columns.ENCODER_GAIN] = factor
    lag = round((2 / trial.law.inner_pole + 1.5 * trial.period) / trial.period)
    motor = np.concatenate((np.full(lag, trial.wanted[0]), trial.wanted))[
        trial.row : trial.count
    ]
    trial.row += int(
        np.argmax((factor - 1) * np.abs(motor) > trial.law.limits.residual_angle)
    )


def wrapped(trial: Trial) -> None:
    turn = 2 * math.pi
    # A counter of 16 bits that overflows at the rig's 100 000 counts a turn: 4.1 rad,
    # which is no whole turn that a modulo would take out.
    trial.inputs[trial.row :, columns.ENCODER_ERROR] += trial.pick(
        turn, -turn, 2**16 * turn / 1e5
    )


def swapped(trial: Trial) -> None:
    whole = trial.case.phase == "whole"
    rows = slice(trial.row, None) if whole else trial.rows(trial.pick(0.25, 0.5, EVER))
    trial.set_bits(rows, SWAPPED)
    trial.detail = (
        "for a while" if trial.case.severity < 3 and not whole else "for ever"
    )
    if whole:
        trial.row = round(
            MOVE_BEGINS / trial.period
        )  # before it both readings are zero


def swap_reaction(e: Evidence) -> Check:
    """Off; or no harm, where the exchange is over before its readings were incredible
    for a guard's time.

    A torque that lies within `residual_angle` of the motor's model is, to every guard,
    the angle of a good encoder: in the first quarter of a second of a move no law can
    tell. What is left is the harm, for which the limit is that of a flipped bit.
    """
    off = reacts(OFF, ANY, BAD_ENCODER, RESIDUAL)(e)
    if off.passed or e.detail == "for ever":
        return off
    return Check.at_most(
        "peak tip error while either reading is credible [rad]", e.peak, SAFE
    )


def other_payload(trial: Trial) -> None:
    trial.twin = trial.bench.twin.with_payload(
        trial.case.payload * trial.pick(1.0, 0.8, 0.4)
    )


def payload_peak(e: Evidence) -> Check:
    payload = e.case.payload * e.pick(1.0, 0.8, 0.4)
    low, _, high = e.bench.payloads
    # The lightest payload times its factor of 1 is the design's own bound but for
    # rounding.
    if low <= payload * (1 + 1e-9) and payload <= high:
        return peak_ratio(1.2)(e)
    return bounded(0.1)(
        e
    )  # outside the design: bounded, with the limit of a lost payload


def payload_changes(trial: Trial) -> None:
    payload = trial.case.payload
    # Severity 3 begins light and picks its payload up: the feed-forward, and the loop's
    # gain, then change the other way.
    after = trial.pick(0.5 * payload, 0.2 * payload, payload)
    if trial.case.severity == 3:
        trial.twin = trial.bench.twin.with_payload(0.2 * payload)
    trial.at(trial.row, lambda arm: arm.change_payload(after))


def hit(trial: Trial) -> None:
    if trial.case.severity < 3:
        trial.inputs[trial.rows(0.02), columns.TIP_FORCE] += trial.pick(0.1, 0.25, 0.0)
        return
    # 0.05 rad ahead of where the move is: near enough to be hit at speed, far enough
    # not to touch at once.
    angle = float(trial.wanted[trial.row]) + 0.05

    def wall(arm: ArmState) -> None:
        arm.obstacle[:] = (angle, 500.0, 2.0, arm.twin.beam.length, 1.0)

    trial.at(trial.row, wall)


def hit_reaction(e: Evidence) -> Check:
    if e.case.severity < 3:
        return settled(1.0)(e)
    check = reacts(HOLD, ANY, OVERLOAD)(e)
    felt, limit = float(np.abs(e.faulty.torque).max()), e.law.limits.torque_trip
    return replace(
        check, name=f"{check.name}; torque reached {felt:.3g} of {limit:.3g} N·m"
    )


def sticky(trial: Trial) -> None:
    def action(arm: ArmState) -> None:
        # Sliding friction and stiction of twin_rig alike: the law compensates what its
        # rig states.
        arm.rig[5:7] *= trial.pick(1.5, 2.0, 3.0)

    trial.at(0, action)


def hunting(e: Evidence) -> Check:
    """Half the peak-to-peak at rest: 2 mrad, or what friction that is not compensated
    holds the motor by.

    Within (x - 1) times the compensated voltage over the motor loop's stiffness, the
    proportional action does not move the motor; only the integral does, and hunts
    through that band.
    """
    drive = e.law.drive
    assert drive is not None  # a bench gives every law a motor loop  # noqa: S101
    band = (e.pick(1.5, 2.0, 3.0) - 1.0) * drive.coulomb_voltage / drive.loop.stiffness
    return limit_cycle(max(2e-3, band))(e)


def slow_motor(trial: Trial) -> None:
    pole = trial.law.inner_pole * trial.pick(0.8, 0.65, 0.5)
    # The law's own motor loop is made slower, not the motor: the correction then counts
    # on a pole that is not there, as with a motor that was identified wrongly.
    rig = trial.bench.rig
    pid = place_pid(rig.motor, pole).discretize(trial.law.period)
    assert trial.law.drive is not None  # noqa: S101
    trial.use(replace(trial.law, drive=replace(trial.law.drive, loop=pid)))


def nothing(trial: Trial) -> None:
    """The quiet begins where the run ends: see `quiet`."""


@functools.lru_cache(maxsize=1)  # two measurements of the same hour
def quiet(e: Evidence) -> tuple[Real, bytes]:
    """Let the law go on with constant inputs; return its modes and its memory.

    They must be those of an arm that is really at rest. One sample of the gauge's
    noise, held for an hour, is a torque that the law answers with a voltage, and the
    correction goes on with what noise left in its modes: an encoder that then does not
    move is a fault, for which the law trips rightly. So `calm_end` lets the arm come to
    rest first; each input is the mean of the last second, the reference what the tip
    then is.
    """
    count = round(e.pick(60.0, 600.0, 3600.0) / e.law.period)
    last = slice(-round(1.0 / e.law.period), None)
    angle, torque = (
        float(np.mean(e.faulty.encoder[last])),
        float(np.mean(e.faulty.gauge[last])),
    )
    # The reference is the tip estimate θm − Γ/c of that rest, so that the error is zero
    # and stays so.
    inputs = (angle - torque / e.law.stiffness, 0.0, angle, torque)
    state, outputs = e.law.run(
        e.faulty.law_state,
        *(np.full(count, value) for value in inputs),
        first_tick=len(e.faulty.time) + 1,
    )
    return outputs.mode, state


def denormals(e: Evidence) -> Check:
    """Denormal numbers in the law's memory after long quiet; they would make every
    period slower.
    """
    size = 4 if e.law.precision == "single" else 8
    reals = members(np.frombuffer(quiet(e)[1], dtype=np.uint8), size)
    # Many processors take a hundred times as long for a denormal number: a state that
    # decays into them would miss its period after an hour of silence.
    tiny = np.finfo(reals.dtype).tiny
    count = np.count_nonzero((reals != 0) & (np.abs(reals) < tiny))
    return Check.at_most("denormal numbers left in the state", int(count), 0)


def quiet_trips(e: Evidence) -> Check:
    others = np.count_nonzero(quiet(e)[0] != RUN)
    return Check.at_most("quiet periods in another mode than run", int(others), 0)
