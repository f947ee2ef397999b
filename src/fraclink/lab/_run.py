"""The record of a run in real time: signals and times of every period, statistics, and
its file.
"""

from __future__ import annotations

import contextlib
import math
import secrets
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._display import (
    Overview,
    Row,
    Table,
    displayed,
    quantity,
    rows_of,
    state_of,
)
from fraclink._files import document, save
from fraclink._law import MODES, REASONS, Law
from fraclink._law.estimator import Estimates, PayloadEstimator
from fraclink._law.limits import Limits
from fraclink._simulate.estimates import estimate_findings
from fraclink._simulate.run import payload_rejected
from fraclink.errors import FieldError, LogError
from fraclink.extend import LOST_SHARE
from fraclink.findings import Finding
from fraclink.lab._machine import Spread
from fracsys.checks import Real
from fracsys.checks.equality import compared

__all__ = ["STOPS", "RealtimeRun", "first_difference", "saved"]

Count = NDArray[np.uint32]

# Ways in which a run ends, in the order of the kernel's codes; "no sample" and "other
# period" are raised as errors.
STOPS = (
    "finished",
    "signal",
    "law off",
    "no sample",
    "connection failed",
    "other period",
)
INPUTS = ("reference", "reference_acceleration", "motor_angle", "torque", "payload")
OUTPUTS = ("motor_reference", "voltage", "compensation", "tip_estimate", "error")
SIGNALS = ("time", "latency", "work", *INPUTS, *OUTPUTS)
MARKS = ("tick", "mode", "reason", "flags")


@displayed
@document(
    "realtime-run",
    version=4,
    container="npz",
    sources=lambda run: {"law": run.law_sha256},
    summary=lambda run: {"passed": run.passed, "problem": run.problem},
)
@compared
@dataclass(frozen=True, eq=False)
class RealtimeRun:
    """The law in real time, one value for each period that ran; every signal has shape
    (N,).

    Parameters
    ----------
    time
        of the period's deadline, counted from the first one [s].
    latency
        from the deadline to the wake-up [s].
    work
        from the wake-up until the command is written [s].
    reference, reference_acceleration, motor_angle, torque, payload
        the law's inputs: θt* [rad], its acceleration [rad/s²], θm [rad], Γ [N·m],
        payload [kg] (0: not given); NaN where no sample came.
    motor_reference, voltage, compensation, tip_estimate, error
        its outputs: θm* [rad], voltage and compensation [V], θm − Γ/c [rad], error
        [rad].
    tick
        number of the period, from 1; missed periods leave gaps.
    mode, reason, flags
        of the law, see law.h.
    period
        [s].
    law_sha256
        the law's digest.
    connection
        how the arm was reached.
    stopped
        "finished", "signal", "law off" or "connection failed".
    lost_commands
        how many commands the connection did not accept.
    scheduling, memory
        what the machine granted.
    origin
        added to the reference [rad].
    first_difference
        the first row whose outputs a replay of the recorded inputs does not reproduce;
        None where all agree bit for bit.
    allowed_overruns
        largest number of overruns with which the run passes.
    planned
        planned number of periods.
    estimator
        that gave the law its payload; None where there was none.
    saved
        file that the record was written to; empty where none was asked for.
    """

    time: Real
    latency: Real
    work: Real
    reference: Real
    reference_acceleration: Real
    motor_angle: Real
    torque: Real
    payload: Real
    motor_reference: Real
    voltage: Real
    compensation: Real
    tip_estimate: Real
    error: Real
    tick: Count
    mode: Count
    reason: Count
    flags: Count
    period: float
    law_sha256: str
    connection: str
    stopped: str
    lost_commands: int
    scheduling: str
    memory: str
    origin: float
    first_difference: int | None
    allowed_overruns: int
    planned: int
    estimator: PayloadEstimator | None = None
    saved: str = field(default="", metadata={"stored": False})

    def __post_init__(self) -> None:
        for name in (*SIGNALS, *MARKS):
            getattr(self, name).flags.writeable = False

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What a reader should know about the run: W603 where the law rejected the
        payload, W604 and W605 where an estimated one left the design's range, or a
        contact was seen.
        """
        estimates = self.estimates
        if self.estimator is None or estimates is None:
            return payload_rejected(self.flags)
        return payload_rejected(self.flags) + estimate_findings(
            self.estimator, estimates, self.period
        )

    @property
    def estimates(self) -> Estimates | None:
        """What the payload estimator said in each period, from the recorded sensors;
        None without one.
        """
        # Recomputed from the sensors instead of recorded: the estimator is C code and
        # gives the same result to the bit.
        if self.estimator is None or not len(self.tick):
            return None
        state = self.estimator.initial_state()
        return self.estimator.run(
            state, self.motor_angle, self.torque, ticks=self.tick
        )[1]

    @property
    def missed(self) -> int:
        """Periods in which the law did not run: among all planned ones if the run
        finished, otherwise among those before the last one that ran.
        """
        return self.unfinished + self._last - len(self.tick)

    @property
    def unfinished(self) -> int:
        """Planned periods after the last one that ran; 0 if the run was stopped."""
        return self.planned - self._last if self.stopped == "finished" else 0

    @property
    def _last(self) -> int:
        return int(self.tick[-1]) if len(self.tick) else 0

    @property
    def overruns(self) -> int:
        """Periods whose command came after the next deadline."""
        # Not the missed periods: a late command still took effect, one period later
        # than the margins assume.
        return int(np.count_nonzero(self.latency + self.work > self.period))

    @property
    def lost_samples(self) -> int:
        """Periods in which no new sample had come."""
        return int(np.count_nonzero(np.isnan(self.motor_angle)))

    @property
    def latencies(self) -> Spread:
        """Spread of `latency` [s]: the jitter of the loop."""
        return Spread.of(self.latency)

    @property
    def works(self) -> Spread:
        """Spread of `work` [s]: reading, the law, writing."""
        return Spread.of(self.work)

    def overview(self) -> Overview:
        """How many periods ran, how late, and whether the record replays."""
        spreads = (
            ("latency_s", "wake-up latency", self.latencies),
            ("work_s", "computing time", self.works),
        )
        times = (
            (
                Row("", "time", name),
                *(
                    Row("", words, float(value), "µs")
                    for words, value in zip(
                        ("least", "mean", "99.9 %", "most"), spread, strict=True
                    )
                ),
            )
            for _, name, spread in spreads
        )
        rows = rows_of(
            self,
            *("problem", "stopped", "missed", "overruns"),
            *("lost_samples", "lost_commands", "scheduling", "memory"),
            Row("periods", "", len(self.tick)),
            Row("last_mode", "", int(self.mode[-1]) if len(self.mode) else None),
            Row("replays", "", self.first_difference is None),
            *(
                Row(key, "", None if math.isnan(spread.mean) else spread._asdict())
                for key, _, spread in spreads
            ),
        )
        notes = [f"scheduling {self.scheduling}, memory {self.memory}"]
        if self.first_difference is None:
            notes.append("the record replays through the law to the last bit")
        if not self.passed:
            notes.append(f"stopped: {self.problem}")
        return Overview(
            f"{len(self.tick)} periods of {quantity(self.period, 'ms')}, {self.missed} missed, "
            f"{self.overruns} overruns, {self.lost_samples} lost samples",
            state_of(self.passed),
            rows,
            (Table.of("", times),),
            self.findings,
            tuple(notes),
        )

    @property
    def passed(self) -> bool:
        """Whether the run went to its end, in time and in mode "run", with the outputs
        that the law gives.
        """
        return not self.problem

    @property
    def problem(self) -> str:
        """Why the run failed; empty where it passed."""
        mode = MODES[int(self.mode[-1])] if len(self.mode) else "idle"
        reason = REASONS[int(self.reason[-1])] if len(self.mode) else "none"
        # In the order in which the user must solve them: the reason for the stop, then
        # the mode, the timing, and the replay.
        if self.stopped == "law off":
            return f"safe stop: the law switched off ({reason})"
        if self.stopped != "finished":
            return f"safe stop: {self.stopped}"
        # so many missed periods trip the law at its next call, which never came here
        if self.unfinished > Limits.missed_limit:
            return f"the last {self.unfinished} of {self.planned} periods did not run"
        if mode != "run":
            return f"the law ended in mode {mode} ({reason})"
        if self.overruns > self.allowed_overruns:
            return f"{self.overruns} overruns, allowed {self.allowed_overruns}"
        if self.first_difference is not None:
            return (
                f"row {self.first_difference} is not what the law gives for its inputs"
            )
        return ""

    def experiment(self, *, payload: float | None = None) -> Experiment:
        """Return the motion as a log, for `identify`; `payload` at the tip [kg], where
        it is known.

        The law closes its loop around the link, which does not matter to an
        identification from the motor angle to the torque. Lost samples are
        interpolated, up to 1 % of all; LogError if there are more.
        """
        # A sample is lost as a whole: if one channel is missing, the time of the other
        # is unknown.
        came = np.isfinite(self.motor_angle) & np.isfinite(self.torque)
        count = self._last
        missing = count - int(np.count_nonzero(came))
        if count == 0 or missing > LOST_SHARE * count:
            raise LogError(
                "run",
                f"{missing} of {count} samples",
                "lost",
                f"{100 * LOST_SHARE:g} %",
                "run it again on a machine that keeps the period",
            )
        # By ticks instead of rows: a missed period has no row, and without its place
        # all later samples would be too early.
        grid = np.arange(1, count + 1)
        motor, torque, voltage = (
            np.interp(grid, self.tick[came], x[came])
            for x in (self.motor_angle, self.torque, self.voltage)
        )
        return Experiment(
            period=self.period,
            motor_angle=motor,
            output=torque,
            payload=payload,
            source=f"run in real time by {self.connection}",
            # A robot with its own servo takes references; the voltages of its law are
            # all 0 and not a measurement.
            voltage=voltage if voltage.any() else None,
            notes=(
                ("law_sha256", self.law_sha256),
                ("interpolated_samples", str(missing)),
            ),
        )


def first_difference(law: Law, columns: Mapping[str, NDArray[Any]]) -> int | None:
    """Return the first row whose outputs differ from those of `law` for its inputs,
    compared by their bits.
    """
    # The ticks as well: missed periods are part of the law's input.
    tick = columns["tick"]
    if not len(tick):
        return None
    _, again = law.run(
        law.initial_state(), *(columns[name] for name in INPUTS), ticks=tick
    )
    differs = np.zeros(len(tick), bool)
    for name in OUTPUTS:
        # compared by bits, so that -0 differs from 0
        differs |= getattr(again, name).view(np.uint64) != columns[name].view(np.uint64)
    for name in ("mode", "reason", "flags"):
        differs |= getattr(again, name) != columns[name]
    return int(np.argmax(differs)) if differs.any() else None


# ---- where the record goes ---------------------------------------------------------------------------


def saved(value: object, place: Path) -> Path:
    """Write a record to `place`, or if that fails, to the folder for temporary files or
    the home directory.

    Returns the file that was written; raises the first error if all places failed.
    """
    try:
        return save(value, place, force=True)
    except (
        OSError,
        FieldError,
    ):  # FieldError: a folder that has become a file, or lost its permission
        # never overwrites another record, and never makes a name too long
        name = f"{place.stem[:50]}-{secrets.token_hex(4)}{place.suffix}"
        for folder in (Path(tempfile.gettempdir()), Path.home()):
            with contextlib.suppress(OSError, FieldError):
                return save(value, folder / name)
        raise
