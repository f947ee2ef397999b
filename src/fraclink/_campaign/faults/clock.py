"""F20–F28: the clock, the reference and the limits of the actuator."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fraclink._arm.reference import hold, smooth_step
from fraclink._campaign.faults import evidence as need
from fraclink._campaign.faults.evidence import OFF, RUN, Evidence
from fraclink._campaign.faults.inject import TICK_REPEATED, add_fault, miss
from fraclink._campaign.faults.nouns import Check, Fault
from fraclink._campaign.faults.trial import MOVE, Trial
from fraclink._simulate.kernel import ACCELERATION, REFERENCE, ArmState

__all__ = ["CLOCK"]

MISSED_PERIODS = 9  # reason of law.h
WATCHDOG = 5  # periods after which a board's watchdog switches the drive off
# A second move after ten seconds of the first: what a wound-up loop would spoil.
BACK_AT = 12.2
THERE_AND_BACK = MOVE.then(hold(0.0, 10.0)).then(smooth_step(-0.75, duration=1.2))


def _jitter(trial: Trial) -> None:
    """Move the sampling instants by up to one step of 1 ms; their mean stays."""
    count = trial.count
    if trial.severity == 3:
        shifts = np.resize([1, -1], count)
    else:
        shifts = trial.chance.integers(-1, 2, count)
        if trial.severity == 1:
            shifts[trial.chance.random(count) > 0.1] = 0
    shifts[0] = shifts[-1] = 0
    trial.shifts = shifts
    # The reference is a table over the task's periods; it is the instant that is late.
    trial.wanted = np.asarray(trial.reference.angle(trial.period * np.arange(count) + 1e-3 * shifts))


def _missed(trial: Trial) -> None:
    miss(trial, int(trial.pick(1, 3, 5)))


def _dead(trial: Trial) -> None:
    count = int(trial.pick(8, 12, 25))
    miss(trial, count)

    def watchdog(arm: ArmState) -> None:
        arm.voltage[:] = 0.0

    trial.at(trial.row + WATCHDOG, watchdog)


def _off_at_once(e: Evidence) -> Check:
    count = (8, 12, 25)[e.case.severity - 1]
    late = e.reacted - count if e.reacted > 0 else math.inf
    good = e.reacted > 0 and e.faulty.mode[e.row + e.reacted - 1] == OFF
    good = good and e.faulty.reason[e.row + e.reacted - 1] == MISSED_PERIODS
    return Check.at_most("calls of the law until off", late if good else math.inf, 1)


def _repeated(trial: Trial) -> None:
    if trial.severity == 3:

        def back(arm: ArmState) -> None:
            arm.counters[1] -= 3

        trial.at(trial.row, back)
        rows = slice(trial.row, trial.row + 3)
    else:
        rows = slice(trial.row, trial.row + (1, 25)[trial.severity - 1])
        add_fault(trial, rows, TICK_REPEATED)
    trial.marks[rows] = True


def _delay(trial: Trial) -> None:
    more = trial.severity

    def later(arm: ArmState) -> None:
        arm.voltage = np.zeros(arm.voltage.size + more)
        arm.rig[1] += more

    trial.at(0, later)


def _jump(trial: Trial) -> None:
    trial.inputs[trial.row :, REFERENCE] += trial.pick(0.25, 0.5, 1.0)
    trial.wanted = trial.inputs[:, REFERENCE].copy()
    trial.marks[trial.row] = True


def _overshoot(e: Evidence) -> Check:
    jump = (0.25, 0.5, 1.0)[e.case.severity - 1]
    last = float(e.faulty.wanted[-1])
    return Check.at_most("overshoot over the jump", max(0.0, float(e.faulty.tip.max()) - last) / jump, 0.2)


def _bad_reference(trial: Trial) -> None:
    rows = trial.rows(trial.pick(trial.period, 0.1, 0.1))
    trial.inputs[rows, REFERENCE] = trial.pick(math.nan, math.nan, 1e3)
    trial.inputs[rows, ACCELERATION] = trial.pick(math.nan, math.nan, 1e6)
    trial.marks[rows] = True


def _limited(trial: Trial) -> None:
    limits = replace(trial.law.limits, motor_limit=trial.pick(0.9, 0.7, 0.5))
    trial.use(replace(trial.law, limits=limits))


def _recovery(e: Evidence) -> Check:
    def time(error: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
        outside = np.flatnonzero(np.abs(error) > 0.015)  # 2 % of the move back
        return float(outside[-1] + 1) * e.law.period - BACK_AT

    return Check.at_most(
        "settling time of the move back over clean", time(e.faulty.error) / time(e.clean.error), 1.2
    )


def _slow(trial: Trial) -> None:
    limits = trial.law.limits
    trial.use(replace(trial.law, limits=replace(limits, motor_step=limits.motor_step / trial.pick(3, 5, 10))))


CLOCK: tuple[Fault, ...] = (
    Fault(
        "F20",
        "sample jitter",
        "sampling instants early and late by 1 ms",
        "A: peak <= 1.02 x clean",
        ("one in 10", "all, at random", "all, alternating"),
        "A",
        _jitter,
        (need.only(RUN), need.peak_ratio(1.02)),
        phases=("whole",),
    ),
    Fault(
        "F21",
        "missed ticks, few",
        "task not run for 1, 3, 5 periods",
        "A: flag in the next one, peak <= 1.1 x clean",
        ("1 period", "3 periods", "5 periods"),
        "A",
        _missed,
        (need.flagged(need.MISSED, "missed"), need.only(RUN), need.peak_ratio(1.1)),
        note="while the task does not run, the motor keeps its last voltage; no law changes that",
    ),
    Fault(
        "F22",
        "missed ticks, many",
        "task not run for 8, 12, 25 periods",
        "D: the watchdog stops the drive after 5, the law is off at its first call",
        ("8 periods", "12 periods", "25 periods"),
        "D",
        _dead,
        (need.flagged(need.MISSED, "missed"), _off_at_once, need.only(RUN, OFF)),
        note="the watchdog is the board's; the campaign models it",
    ),
    Fault(
        "F23",
        "called twice, or time runs backwards",
        "second call in a period; timer set back by 3 periods",
        "A: ignored and flagged, peak <= 1.1 x clean",
        ("once", "25 times", "3 periods back"),
        "A",
        _repeated,
        (need.flagged(need.REPEATED, "repeated"), need.only(RUN), need.peak_ratio(1.1)),
    ),
    Fault(
        "F24",
        "more delay",
        "voltage 1, 2, 3 periods later",
        "peak <= 1.05 x clean",
        ("+1 period", "+2 periods", "+3 periods"),
        "A",
        _delay,
        (need.only(RUN), need.peak_ratio(1.05)),
        phases=("whole",),
        note="the motor loop alone does not bear two periods more; a slower one, or a shorter period, does",
    ),
    Fault(
        "F25",
        "reference jumps",
        "step of 0.25, 0.5, 1 rad on the reference",
        "slew limited, overshoot <= 20 %, no trip",
        ("0.25 rad", "0.5 rad", "1 rad"),
        "A",
        _jump,
        (need.flagged(need.REFERENCE, "reference"), need.only(RUN), _overshoot),
    ),
    Fault(
        "F26",
        "reference not a number or out of range",
        "NaN once, NaN for 100 ms, 1000 rad for 100 ms",
        "reference held and flagged; no trip, final <= 0.02 rad",
        ("NaN once", "NaN, 100 ms", "1000 rad, 100 ms"),
        "A",
        _bad_reference,
        (need.flagged(need.REFERENCE, "reference"), need.only(RUN), need.final(0.02)),
    ),
    Fault(
        "F27",
        "actuator saturated for 10 s",
        "motor reference limited to 0.9, 0.7, 0.5 rad in a move to 1 rad and back to 0.25 rad",
        "no wind-up: settling of the move back <= 1.2 x linear",
        ("0.9 rad", "0.7 rad", "0.5 rad"),
        "A",
        _limited,
        (need.only(RUN), _recovery),
        phases=("whole",),
        duration=17.0,
        reference=THERE_AND_BACK,
    ),
    Fault(
        "F28",
        "rate limit active for long",
        "largest motor step / 3, / 5, / 10",
        "no limit cycle (> 2e-3 rad), no trip",
        ("/ 3", "/ 5", "/ 10"),
        "A",
        _slow,
        (need.only(RUN), need.limit_cycle(2e-3)),
        phases=("whole",),
        note="what is left moving is the gauge's noise, not a limit cycle: without noise it stays below",
    ),
)
