"""What a run in real time leaves: every period's signals and times, statistics, and how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._law import MODES, REASONS, Law
from fraclink._npz import read_npz, write_npz
from fraclink.errors import FieldError, FileFormatError, LogError

__all__ = ["STOPS", "RealtimeRun", "Spread"]

Real = NDArray[np.float64]
Count = NDArray[np.uint32]

KIND, FORMAT = "realtime-run", 1
# How a run ends, in the order of the kernel's codes; "no sample" and "other period" are raised as errors.
STOPS = ("finished", "signal", "law off", "no sample", "connection failed", "other period")
SIGNALS = (
    "time",
    "latency",
    "work",
    "reference",
    "reference_acceleration",
    "motor_angle",
    "torque",
    "motor_reference",
    "voltage",
    "compensation",
    "tip_estimate",
    "error",
)
MARKS = ("tick", "mode", "reason", "flags")
_LOST_SHARE = 0.01  # what a reader may fill in too
_ABOUT = (
    "period",
    "law_sha256",
    "connection",
    "stopped",
    "lost_commands",
    "scheduling",
    "memory",
    "origin",
    "first_difference",
    "allowed_overruns",
)


class Spread(NamedTuple):
    """Smallest value, mean, 99.9 % quantile and largest value."""

    least: float
    mean: float
    high: float
    most: float

    @staticmethod
    def of(values: Real) -> Spread:
        """Return the spread of (N,) values; NaN where there are none."""
        if not values.size:
            return Spread(*[float("nan")] * 4)
        # "higher": a quantile that was measured, not one between two
        high = np.quantile(values, 0.999, method="higher")
        return Spread(float(values.min()), float(values.mean()), float(high), float(values.max()))


@dataclass(frozen=True, eq=False)
class RealtimeRun:
    """The law in real time, one value for each period that ran; every signal has shape (N,).

    time of the period's deadline after the first one [s]; latency from the deadline that was slept for to
    being awake [s]; work from there to the command being written [s]; the law's inputs: reference θt* [rad],
    reference_acceleration [rad/s²], motor_angle θm [rad] and torque Γ [N·m], NaN where no sample came; its
    outputs: motor_reference θm* [rad], voltage [V], compensation [V], tip_estimate θm − Γ/c [rad], error
    [rad]; tick, 1 in the first period and more than one further where periods were missed; the law's mode,
    reason and flags (see law.h).

    `period` [s]; `law_sha256`, the law's digest; `connection`; `stopped`, one of "finished", "signal", "law
    off" and "connection failed"; `lost_commands`, which the way to the arm did not take; `scheduling` and
    `memory`, what the machine granted; `origin`, added to the reference [rad]; `first_difference`, the first
    row whose outputs the recorded inputs do not give again, None where all agree to the last bit;
    `allowed_overruns`, up to which the run holds.
    """

    time: Real
    latency: Real
    work: Real
    reference: Real
    reference_acceleration: Real
    motor_angle: Real
    torque: Real
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

    def __post_init__(self) -> None:
        for name in (*SIGNALS, *MARKS):
            getattr(self, name).flags.writeable = False

    @property
    def missed(self) -> int:
        """Periods up to the last one that ran in which the law did not run."""
        return int(self.tick[-1]) - len(self.tick) if len(self.tick) else 0

    @property
    def overruns(self) -> int:
        """Periods whose command came after the next deadline."""
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

    @property
    def passed(self) -> bool:
        """Whether the run went to its end, in time and in mode "run", with the outputs that the law gives."""
        return not self.problem

    @property
    def problem(self) -> str:
        """Why the run does not hold; empty where it does."""
        if self.stopped == "law off":
            return f"safe stop: the law switched off ({REASONS[int(self.reason[-1])]})"
        if self.stopped != "finished":
            return f"safe stop: {self.stopped}"
        if not len(self.mode) or MODES[int(self.mode[-1])] != "run":
            left = (
                f"{MODES[int(self.mode[-1])]} ({REASONS[int(self.reason[-1])]})" if len(self.mode) else "idle"
            )
            return f"the law ended in mode {left}"
        if self.overruns > self.allowed_overruns:
            return f"{self.overruns} overruns, allowed {self.allowed_overruns}"
        if self.first_difference is not None:
            return f"row {self.first_difference} is not what the law gives for its inputs"
        return ""

    def difference(self, law: Law) -> int | None:
        """Run `law` over the recorded inputs; return the first row with another output, None without one.

        Every output is compared by its bits. Raises FieldError for another law than the one that ran.
        """
        if law.digest != self.law_sha256:
            raise FieldError(
                "law",
                law.digest[:16],
                "another than the one that ran",
                allowed=self.law_sha256[:16],
                remedy="give the design of the run",
            )
        return first_difference(law, {name: getattr(self, name) for name in (*SIGNALS, *MARKS)})

    def experiment(self, *, payload: float | None = None) -> Experiment:
        """Return the motion as a log, for `identify`; `payload` at the tip [kg], where it is known.

        The law closes its loop around the link, which does not matter to an identification from the motor
        angle to the torque. Samples that were lost are interpolated, up to 1 % of them; LogError beyond.
        """
        came = np.isfinite(self.motor_angle) & np.isfinite(self.torque)
        count = int(self.tick[-1]) if len(self.tick) else 0
        lost = count - int(np.count_nonzero(came))
        if count == 0 or lost > _LOST_SHARE * count:
            raise LogError(
                "run",
                f"{lost} of {count} samples",
                "lost",
                allowed=f"{100 * _LOST_SHARE:g} %",
                remedy="run it again on a machine that keeps the period",
            )
        grid = np.arange(1, count + 1)
        motor, torque, voltage = (
            np.interp(grid, self.tick[came], x[came]) for x in (self.motor_angle, self.torque, self.voltage)
        )
        return Experiment(
            period=self.period,
            motor_angle=motor,
            output=torque,
            payload=payload,
            source=f"run in real time by {self.connection}",
            voltage=voltage if voltage.any() else None,
            notes=(("law_sha256", self.law_sha256), ("interpolated_samples", str(lost))),
        )

    def save(self, path: Path | str) -> None:
        """Write signals, times and how it ended to one NPZ file, complete or not at all."""
        about = {name: getattr(self, name) for name in _ABOUT}
        write_npz(path, KIND, FORMAT, about, {name: getattr(self, name) for name in (*SIGNALS, *MARKS)})

    @classmethod
    def load(cls, path: Path | str) -> RealtimeRun:
        """Read back what `save` wrote; FileFormatError for anything else."""
        about, arrays = read_npz(path, KIND, (FORMAT,))
        try:
            columns: dict[str, Any] = {name: arrays[name] for name in (*SIGNALS, *MARKS)}
            return cls(**columns, **{name: about[name] for name in _ABOUT})
        except (KeyError, TypeError, ValueError) as error:
            raise FileFormatError(
                "run",
                str(path),
                "not a run in real time",
                allowed="an NPZ of RealtimeRun.save",
                remedy="run it again",
            ) from error


def first_difference(law: Law, columns: Mapping[str, NDArray[Any]]) -> int | None:
    """Return the first row whose outputs `law` does not give for its inputs, compared by their bits."""
    tick = columns["tick"]
    if not len(tick):
        return None
    inputs = (columns[name] for name in ("reference", "reference_acceleration", "motor_angle", "torque"))
    _, again = law.run(law.initial_state(), *inputs, ticks=tick)
    differs = np.zeros(len(tick), dtype=bool)
    for name in ("motor_reference", "voltage", "compensation", "tip_estimate", "error"):
        # by bits, so that -0 is not 0
        differs |= getattr(again, name).view(np.uint64) != columns[name].view(np.uint64)
    for name in ("mode", "reason", "flags"):
        differs |= getattr(again, name) != columns[name]
    return int(np.argmax(differs)) if differs.any() else None
