"""A shaped move: the reference, what was promised of it, and what the arm made of it beside its rivals."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.reference import Path
from fraclink._display import displayed
from fraclink._files import document, load, save
from fraclink.findings import Finding

__all__ = ["Measured", "ShapedMove"]

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """What the arm made of one reference: the worst of all payloads and seeds.

    Parameters
    ----------
    name
        how the reference was made.
    duration
        when it comes to rest [s].
    predicted
        what the linear loop says: when the tip stays within 2 % of the move [s]; along a path its largest
        distance to the path [rad].
    settling_time
        from which the tip stays within 2 % of the move [s], counted from the start of the move.
    largest_error
        between the tip and where it shall be [rad]; along a path, else NaN.
    residual_vibration
        half the peak-to-peak tip angle after the reference has come to rest [rad].
    peak_voltage
        largest |voltage| [V].
    limited
        part of the runs in which a guard of the law acted on the reference, the motor or the voltage [1].
    computing_time
        in which the reference was found [s]; not saved.
    """

    name: str
    duration: float
    predicted: float
    settling_time: float
    largest_error: float
    residual_vibration: float
    peak_voltage: float
    limited: float
    computing_time: float = field(default=math.nan, compare=False, metadata={"stored": False})


@displayed
@document(
    "shaped-move",
    version=1,
    period=lambda move: move.period,
    sources=lambda move: {"law": move.law_sha256},
    summary=lambda move: {"passed": move.passed},
)
@dataclass(frozen=True, eq=False)
class ShapedMove:
    """A reference for the loop that runs, with what was promised of it and what was measured.

    Parameters
    ----------
    reference
        of the tip: a piecewise cubic with its knots on the law's periods.
    period
        of the law [s].
    target
        where the tip shall be: None for a move from rest to rest, else the path that is followed.
    payloads
        lightest and heaviest payload [kg] that it was made for.
    told
        whether the law is given the payload.
    voltage
        that is kept [V], noise and friction included.
    kept_back
        part of `voltage` that was left to noise and friction [V].
    reserve
        part of the band that the linear loop leaves free [1].
    measured
        the shaped reference first, then its rivals.
    seeds
        noises of each payload that were run.
    shown
        payloads [kg] of the runs that are kept to be drawn, shape (P,): lightest, middle, heaviest.
    tip_angle, motor_voltage
        of these runs with the shaped reference, one value a period, shape (P, N) [rad], [V].
    law_sha256
        digest of the law that it was made for.
    findings
        what a reader should know.

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023-geared")
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0,
    ...                    phase_margin=fl.deg(50), filter_time=0.02)
    >>> move = fl.shape(design, 1.0, payloads=(0.030, 0.030), told=True, seeds=1, rivals=False)
    >>> move.settling_time < 0.4, float(move.reference.angle(1.0).round(9))
    (True, 1.0)
    """

    reference: Path
    period: float
    target: Path | None
    payloads: tuple[float, float]
    told: bool
    voltage: float
    kept_back: float
    reserve: float
    measured: tuple[Measured, ...]
    seeds: int
    shown: Real
    tip_angle: Real
    motor_voltage: Real
    law_sha256: str
    findings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        for values in (self.shown, self.tip_angle, self.motor_voltage):
            values.flags.writeable = False

    @property
    def amplitude(self) -> float:
        """The move from the reference's first angle to its last [rad]."""
        return float(self.reference.angle(self.reference.duration) - self.reference.angle(0.0))

    @property
    def shaped(self) -> Measured:
        """What was measured of the shaped reference."""
        return self.measured[0]

    @property
    def settling_time(self) -> float:
        """Longest measured settling time of the shaped reference [s]."""
        return self.shaped.settling_time

    @property
    def passed(self) -> bool:
        """Whether the arm did what the linear loop promised, within the limits."""
        return not any(finding.severity != "info" for finding in self.findings)

    def save(self, path: FilePath | str) -> None:
        """Write the move to one JSON file, complete or not at all."""
        save(self, path, force=True)

    @staticmethod
    def load(path: FilePath | str) -> ShapedMove:
        """Read back what `save` wrote; FileFormatError for anything else."""
        return load(path, ShapedMove)
