"""What a run on the twin leaves: signals, metrics, verdict, and what produced it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fraclink._npz import read_npz, write_npz
from fraclink._simulate.metrics import Metrics, Verdict, judge, measure
from fraclink._simulate.twin.arm import Twin
from fraclink._simulate.twin.damping import PowerLaw
from fraclink.errors import FileFormatError

__all__ = ["TwinRun", "collect", "vibration_period"]

Vector = NDArray[np.float64]

KIND, FORMAT = "twin-run", 1
SATURATED = 64  # LAW_FLAG_SATURATED of law.h
_SIGNALS = (
    "time",
    "reference",
    "tip_angle",
    "motor_angle",
    "motor_reference",
    "torque",
    "motor_angle_measured",
    "torque_measured",
    "voltage",
    "motor_velocity",
    "contact_force",
    "mode",
    "reason",
    "flags",
    "payload",
)


@dataclass(frozen=True, eq=False)
class TwinRun:
    """A move of the twin, one value per control period, each at the period's beginning.

    time [s]; reference, tip_angle, motor_angle, motor_reference [rad]; torque: the true −EI w''(0) [N·m];
    motor_angle_measured [rad] and torque_measured [N·m]: what the sensors gave; voltage: what acted [V];
    motor_velocity [rad/s]; contact_force: the largest of the period [N]; mode, reason and flags of the law
    (see law.h); payload [kg]. `finished` is False where the twin left every bound and the run was cut.
    `metrics` and `verdict` judge it as they judge `fraclink._simulate`; `about` says what was run.
    """

    time: Vector
    reference: Vector
    tip_angle: Vector
    motor_angle: Vector
    motor_reference: Vector
    torque: Vector
    motor_angle_measured: Vector
    torque_measured: Vector
    voltage: Vector
    motor_velocity: Vector
    contact_force: Vector
    mode: NDArray[np.uint32]
    reason: NDArray[np.uint32]
    flags: NDArray[np.uint32]
    payload: Vector
    finished: bool
    metrics: Metrics
    verdict: Verdict
    about: Mapping[str, str] = field(default_factory=dict)

    @property
    def period(self) -> float:
        """Control period [s]."""
        return float(self.time[1] - self.time[0])

    @property
    def error(self) -> Vector:
        """Reference minus tip angle [rad]."""
        return np.asarray(self.reference - self.tip_angle)

    def save(self, path: Path | str) -> None:
        """Write signals, metrics and what was run to one NPZ file, complete or not at all."""
        about = {
            "finished": self.finished,
            "metrics": {k: v if math.isfinite(v) else str(v) for k, v in asdict(self.metrics).items()},
            "verdict": asdict(self.verdict),
            "about": dict(self.about),
        }
        write_npz(path, KIND, FORMAT, about, {name: getattr(self, name) for name in _SIGNALS})

    @classmethod
    def load(cls, path: Path | str) -> TwinRun:
        """Read back what `save` wrote; FileFormatError for anything else."""
        about, signals = read_npz(path, KIND, (FORMAT,))
        try:
            return cls(
                **{name: signals[name] for name in _SIGNALS},
                finished=bool(about["finished"]),
                metrics=Metrics(**{k: float(v) for k, v in about["metrics"].items()}),
                verdict=Verdict(**about["verdict"]),
                about={str(k): str(v) for k, v in about["about"].items()},
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise FileFormatError(
                "run",
                str(path),
                "not a run of the twin",
                allowed="an NPZ of TwinRun.save",
                remedy="run it again",
            ) from error


def vibration_period(twin: Twin) -> float:
    """Return the period of the first mode with its damping [s]."""
    modes = twin.beam.modes(1)
    # With a power law ω is not in rad/s: the mode is at ω^(2/λ), where |s²| = ω² |D(s)|.
    frequency = float(modes.frequencies[0])
    if isinstance(twin.damping, PowerLaw):
        frequency = frequency ** (2.0 / twin.damping.order)
    return 2.0 * math.pi / frequency


def collect(
    record: NDArray[np.float64],
    payload: Vector,
    period: float,
    *,
    finished: bool,
    ended: float,
    vibration_period: float,
    about: Mapping[str, str] | None = None,
) -> TwinRun:
    """Name the columns of the kernel's record and judge the run."""
    columns = [np.ascontiguousarray(column) for column in record.T]
    time: Vector = np.linspace(0.0, period * (len(record) - 1), len(record))
    for column in (*columns, payload, time):
        column.flags.writeable = False
    reference, motor, tip, torque, encoder, gauge, command, voltage = columns[:8]
    speed, contact = columns[12:]
    mode, reason, flags = (column.astype(np.uint32) for column in columns[9:12])
    metrics = measure(
        time,
        reference,
        tip,
        command,
        voltage,
        (flags & SATURATED) != 0,
        ended=ended,
        vibration_period=vibration_period,
    )
    verdict = judge(
        metrics, time, reference, tip, mode, reason, ended=ended, vibration_period=vibration_period
    )
    return TwinRun(
        time=time,
        reference=reference,
        tip_angle=tip,
        motor_angle=motor,
        motor_reference=command,
        torque=torque,
        motor_angle_measured=encoder,
        torque_measured=gauge,
        voltage=voltage,
        motor_velocity=speed,
        contact_force=contact,
        mode=mode,
        reason=reason,
        flags=flags,
        payload=payload,
        finished=finished,
        metrics=metrics,
        verdict=verdict,
        about=dict(about or {}),
    )
