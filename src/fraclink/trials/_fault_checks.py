"""What the run of a fault must have shown: one requirement, one measurement, one limit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._law import MODES, REASONS, Law
from fraclink.trials._fault_trial import (
    LAST,
    PHASES,
    RUN,
    STARTED,
    Bench,
    Case,
    TrialSignals,
)

__all__ = [
    "Check",
    "Evidence",
    "Requirement",
    "bounded",
    "final",
    "flagged",
    "limit_cycle",
    "only",
    "peak",
    "peak_over_best",
    "peak_ratio",
    "reacts",
    "settled",
    "shared_checks",
]


@dataclass(frozen=True)
class Check:
    """One requirement on one run: what was measured, the limit it must not exceed, and
    whether it is met.

    >>> Check.at_most("peak [rad]", 0.5, 0.4).passed
    False
    """

    name: str
    measured: float
    limit: float
    passed: bool

    @staticmethod
    def at_most(name: str, measured: float, limit: float) -> Check:
        """A check that passes where ``measured <= limit``; NaN never does."""
        return Check(name, float(measured), float(limit), bool(measured <= limit))

    def __str__(self) -> str:
        return f"{self.name}: {self.measured:.5g} (limit {self.limit:.5g})"


@dataclass(frozen=True, eq=False)
class Evidence:
    """A faulty run, the clean run of the same payload, noise and move, and when the
    fault came.
    """

    bench: Bench
    case: Case
    law: Law
    row: int
    marks: NDArray[np.bool_]
    faulty: TrialSignals
    clean: TrialSignals
    detail: str = ""
    best: TrialSignals | None = (
        None  # of a law that knows of the fault at once, see `FaultRule.best`
    )

    @property
    def peak(self) -> float:
        """Largest |tip error| [rad]."""
        return float(np.abs(self.faulty.error).max())

    @property
    def clean_peak(self) -> float:
        """The same of the clean run [rad]."""
        return float(np.abs(self.clean.error).max())

    @property
    def final(self) -> float:
        """|mean tip error| of the last second [rad]."""
        # A mean and not the last sample: the gauge's noise alone moves the tip by 5
        # mrad.
        return abs(float(self.faulty.error[-round(LAST / self.law.period) :].mean()))

    @property
    def marked(self) -> NDArray[np.bool_]:
        """The bad periods of those that were run: a run that leaves every bound is cut."""
        return self.marks[: len(self.faulty.flags)]

    @property
    def reacted(self) -> int:
        """Periods from the fault to the first mode above RUN, the fault's own counted
        as 1; -1: none.
        """
        # Above RUN: IDLE, before the law has started, is no reaction to a fault.
        other = np.flatnonzero(self.faulty.mode[self.row :] > RUN)
        return int(other[0]) + 1 if other.size else -1

    @property
    def end(self) -> tuple[str, str]:
        """Last mode and reason in words."""
        return MODES[self.faulty.mode[-1]], REASONS[self.faulty.reason[-1]]

    def pick(self, *values: float) -> float:
        """Return the value of the case's severity."""
        return values[self.case.severity - 1]


# [rad] between tip and reference: an arm that is farther away with its drive closed is
# a danger, whatever the requirement that it misses. Set for a flipped bit (F29), and
# the limit wherever no law can do better.
SAFE = 0.3
OTHER_MODE = "periods in another mode than allowed"
ANY = 10**6  # periods: the catalogue states no number

Requirement = Callable[[Evidence], Check]


def only(*modes: int) -> Requirement:
    """No other mode than `modes` after the law started: no other trip."""

    def check(e: Evidence) -> Check:
        # A law is idle until it has read both sensors once, whatever the fault.
        begun = int(np.argmax((e.faulty.flags & STARTED) != 0))
        others = int(np.count_nonzero(~np.isin(e.faulty.mode[begun:], modes)))
        return Check.at_most(OTHER_MODE, others, 0)

    return check


def flagged(bit: int, name: str) -> Requirement:
    """Every marked period carries a flag, in that very period."""

    def check(e: Evidence) -> Check:
        missing = int(np.count_nonzero(e.marked & ((e.faulty.flags & bit) == 0)))
        # A fault that was never injected must not pass.
        return Check.at_most(
            f"bad periods without the {name} flag", missing if e.marked.any() else 1, 0
        )

    return check


def reacts(mode: int, within: int, *reasons: int) -> Requirement:
    """The first other mode is `mode`, for one of `reasons`, within that many periods,
    and it stays.
    """

    def check(e: Evidence) -> Check:
        first = e.row + e.reacted - 1
        missed = ""
        if e.reacted < 0:
            missed = " (never)"
        elif e.faulty.mode[first] != mode:
            missed = f" (went {MODES[e.faulty.mode[first]]})"
        elif reasons and e.faulty.reason[first] not in reasons:
            missed = f" (for {REASONS[e.faulty.reason[first]]})"
        # A higher mode may follow (degraded, then off); to come back is not for a law
        # to decide, since a fault that pauses is not gone.
        elif np.any(e.faulty.mode[first:] < mode):
            missed = " (did not latch)"
        return Check.at_most(
            f"periods until {MODES[mode]}{missed}",
            np.inf if missed else e.reacted,
            within,
        )

    return check


def peak_ratio(limit: float) -> Requirement:
    """Largest tip error over that of the clean run."""
    return lambda e: Check.at_most(
        "peak tip error over clean", e.peak / e.clean_peak, limit
    )


def peak_over_best(ratio: float) -> Requirement:
    """Largest tip error over that of the clean run, or of a law that knows of the fault
    at once.

    The larger of the two: no law can do better than to know at once, and a smaller
    bound asks for more.
    """

    def check(e: Evidence) -> Check:
        best = 0.0 if e.best is None else float(np.abs(e.best.error).max())
        return Check.at_most(
            "peak tip error [rad]", e.peak, ratio * max(e.clean_peak, best)
        )

    return check


def peak(limit: float, *, phases: tuple[str, ...] = PHASES) -> Requirement:
    """Largest tip error [rad]; in other phases, how far the tip ran after the fault.

    A drive that is switched off at the beginning of a move leaves the whole move
    undone, which is no harm.
    """

    def check(e: Evidence) -> Check:
        if e.case.phase in phases:
            return Check.at_most("peak tip error [rad]", e.peak, limit)
        # From where the tip was when it happened: what had been moved before is no
        # doing of the fault.
        after = e.faulty.tip[e.row :]
        return Check.at_most(
            "tip travel after the fault [rad]", np.abs(after - after[0]).max(), limit
        )

    return check


def final(limit: float) -> Requirement:
    """Mean tip error of the last second [rad]."""
    return lambda e: Check.at_most("final tip error [rad]", e.final, limit)


def bounded(limit: float) -> Requirement:
    """The run reached its end and the tip stayed within `limit` [rad] of the reference."""
    return lambda e: Check.at_most(
        "peak tip error [rad]", e.peak if e.faulty.finished else np.inf, limit
    )


def settled(after: float, band: float = 0.02) -> Requirement:
    """The tip is within `band` [rad] of reference or clean run from `after` [s] behind
    the fault on.
    """

    def check(e: Evidence) -> Check:
        # The clean run, too, as the move itself has an error of its own.
        apart = np.minimum(
            np.abs(e.faulty.error),
            np.abs(e.faulty.tip - e.clean.tip[: len(e.faulty.tip)]),
        )
        outside = np.flatnonzero(apart[e.row :] > band)
        time = (int(outside[-1]) + 1) * e.law.period if outside.size else 0.0
        return Check.at_most(
            "recovery [s]", time if e.faulty.finished else np.inf, after
        )

    return check


def limit_cycle(limit: float) -> Requirement:
    """Half the peak-to-peak tip angle in the last two seconds [rad]."""

    def check(e: Evidence) -> Check:
        last = e.faulty.tip[-round(2.0 / e.law.period) :]
        return Check.at_most("limit cycle [rad]", 0.5 * np.ptp(last), limit)

    return check


def shared_checks(e: Evidence) -> tuple[Check, ...]:
    """Return the global criteria G1–G3 of the faulty run: finite, in limits, slew."""
    signals, limits, drive = e.faulty, e.law.limits, e.law.drive
    # The limits themselves round to the block's precision, by 6e-8 of their value in 24
    # bits.
    slack = 1e-6 if e.law.precision == "single" else 1e-12
    # What leaves the law, and what the motor gets of it: each by itself may hide what
    # the other shows.
    outputs = np.vstack((signals.command, signals.asked, signals.voltage))
    infinite = int(np.count_nonzero(~np.isfinite(outputs)))
    step = np.abs(np.diff(signals.command))
    # A law that starts anew does not know what the one before asked for: it begins at
    # the motor.
    known = (signals.flags[1:] & STARTED) == 0
    # A step from or to what is no number has no size: it counts as the largest.
    worst = float(step[known].max(initial=0.0)) if np.isfinite(step).all() else np.inf
    volts = np.inf if drive is None else drive.voltage_limit
    command, asked = np.abs(signals.command).max(), np.abs(signals.asked).max()
    return (
        Check.at_most("G1: outputs that are not finite", infinite, 0),
        Check.at_most(
            "G2: |motor reference| [rad]", command, limits.motor_limit * (1 + slack)
        ),
        Check.at_most("G2: |voltage| [V]", asked, volts * (1 + slack)),
        Check.at_most(
            "G3: motor reference step [rad]",
            worst,
            limits.motor_step * (1 + slack) + slack,
        ),
    )
