"""A shaped move, what the arm made of it, and what it is shaped for."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.link import LinkModel
from fraclink._arm.reference import Path, Reference
from fraclink._display import displayed
from fraclink._files import document, load, save
from fraclink._law import Law
from fraclink._law.design import Design
from fraclink._simulate.arm import Twin
from fraclink._simulate.run import Run
from fraclink._simulate.shape_programme import (
    SIGNALS,
    UNITS,
    MoveBounds,
    Programme,
    ShapedArm,
    noise_of,
    responses_of,
)
from fraclink.errors import FieldError
from fraclink.findings import Finding
from fracsys.checks.equality import compared

__all__ = [
    "Candidate",
    "Measured",
    "MoveSetting",
    "ShapedMove",
    "settling",
]

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
        what the linear loop says: when the tip stays within 2 % of the move [s]; along
        a path its largest distance to the path [rad].
    settling_time
        from which the tip stays within 2 % of the move [s], counted from the start of
        the move.
    largest_error
        between the tip and where it shall be [rad]; along a path, else NaN.
    residual_vibration
        half the peak-to-peak tip angle after the reference has come to rest [rad].
    peak_voltage
        largest |voltage| [V].
    limited
        part of the runs in which a guard of the law acted on the reference, the motor
        or the voltage [1].
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
    computing_time: float = field(
        default=math.nan, compare=False, metadata={"stored": False}
    )


@displayed
@document(
    "shaped-move",
    version=1,
    period=lambda move: move.period,
    sources=lambda move: {"law": move.law_sha256},
    summary=lambda move: {"passed": move.passed},
)
@compared
@dataclass(frozen=True, eq=False)
class ShapedMove:
    """A reference for the loop that runs, with what was promised of it and what was
    measured.

    Parameters
    ----------
    reference
        of the tip: a piecewise cubic with its knots on the law's periods.
    period
        of the law [s].
    target
        where the tip shall be: None for a move from rest to rest, else the path that is
        followed.
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
        the shaped reference first, then, of a path, the path as the reference.
    seeds
        noises of each payload that were run.
    shown
        payloads [kg] of the runs that are kept to be drawn, shape (P,): lightest,
        middle, heaviest.
    tip_angle, motor_voltage
        of these runs with the shaped reference, one value a period, shape (P, N) [rad],
        [V].
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
    >>> move = fl.shape(design, 1.0, payloads=(0.030, 0.030), told=True, seeds=1)
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
        return float(
            self.reference.angle(self.reference.duration) - self.reference.angle(0.0)
        )

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


@dataclass(frozen=True)
class Candidate:
    """A reference, how it was made, what the linear loop promises, and the time that it
    took to find [s].

    Promised is when the tip of the worst payload has settled [s], along a path its
    largest distance [rad].
    """

    name: str
    reference: Reference
    predicted: float
    computing_time: float = math.nan


def settling(tip: Real, move: float, band: float, period: float) -> float:
    """Return when every row of `tip`, (payloads, N), stays within `band` of `move`
    [rad]; inf for never.
    """
    # Of any payload: one reference has to serve them all.
    outside = np.any(np.abs(tip - move) > band, axis=0)
    if outside[-1]:
        return math.inf
    return (
        period * (len(outside) - int(np.argmax(outside[::-1])))
        if outside.any()
        else 0.0
    )


# Between two payloads of the programme: ω₀ changes by a tenth. The arm is measured in
# between, too; with five payloads from 8 to 80 g it settles there after 1.05 s where
# 0.88 s were promised.
_PAYLOAD_STEP = 0.2
_KNOTS = 30  # in a vibration period: more do not settle sooner, and cost the square
_GUARDED = 0.95  # of the law's guards: where they begin to act, the loop is not linear
# standard deviations that are left to noise: of 180 runs with another noise each none
# goes beyond
_NOISES = 4.5
_KNOWN = 8.0  # vibration periods of every response that are known at first
_REST = 4.0  # vibration periods that the arm is measured for after the reference's end


@dataclass(frozen=True)
class MoveSetting:
    """The law, the arm, and the payloads: what a move is shaped for."""

    law: Law
    arm: ShapedArm
    link: LinkModel
    payloads: tuple[float, float]
    told: bool
    gauge_offset: float | None

    @staticmethod
    def of(
        design: Design,
        payloads: tuple[float, float] | None,
        told: bool,
        twin: Twin | None,
        gauge_offset: float | None,
    ) -> MoveSetting:
        low, high = payloads or design.payloads
        if low <= 0.0:
            raise FieldError(
                "payloads",
                low,
                "no payload",
                allowed="> 0 kg",
                remedy="give kg: 0.030 is 30 g",
            )
        own = ShapedArm(design.rig, design.model, twin)
        # Geometric, as ω₀ goes with the root of the payload: the middle of the
        # frequencies.
        middle = math.sqrt(low * high)
        link = (
            design.model.at_payload(middle)
            if design.model.payload is not None
            else design.model
        )
        return MoveSetting(
            own.equipped(design.law()), own, link, (low, high), told, gauge_offset
        )

    @property
    def vibration(self) -> float:
        """Vibration period of the link with the middle payload [s]."""
        return 2 * math.pi / abs(self.link.pole.imag)

    @property
    def steps(self) -> int:
        """Number of payloads that the programme keeps, less one."""
        low, high = self.payloads
        return max(2, math.ceil(math.log(high / low) / _PAYLOAD_STEP))

    def between(self, steps: int) -> tuple[float, ...]:
        """Payloads of the range [kg], this many steps from the lightest to the
        heaviest.
        """
        low, high = self.payloads
        return (
            (low,)
            if low == high
            else tuple(np.geomspace(low, high, steps + 1).tolist())
        )

    def programme(
        self, voltage: float, speed: float | None, torque: float | None
    ) -> tuple[Programme, float]:
        """Return the programme within the limits, and the voltage that is left to noise
        and friction [V].
        """
        law, limits, drive = self.law, self.law.limits, self.law.drive
        loops = responses_of(
            law,
            self.arm,
            self.between(self.steps),
            _KNOWN * self.vibration,
            told=self.told,
        )
        noise = noise_of(law, self.arm, self.payloads[1], told=self.told)
        left = {name: _NOISES * noise[name] for name in noise}
        # The compensation of friction is added to what the linear loop asks for, with
        # the sign of the speed.
        left["voltage"] += drive.coulomb_voltage if drive else 0.0
        torques = (torque, self.arm.gauge_limit, _GUARDED * limits.torque_limit)
        most = {
            "voltage": voltage,
            "motor_speed": math.inf if speed is None else speed,
            "torque": min(each for each in torques if each is not None),
            "motor_step": _GUARDED * limits.motor_step,
        }
        for name, value in most.items():
            # Nothing is left for the move: the programme would be infeasible, and say
            # nothing of why.
            if left[name] >= value:
                field, unit = name.removeprefix("motor_"), UNITS[SIGNALS.index(name)]
                problem, allowed = (
                    "less than noise and friction take",
                    f"> {left[name]:.3g} {unit}",
                )
                remedy = "allow more, or design with a longer filter"
                raise FieldError(field, value, problem, allowed=allowed, remedy=remedy)
        bounds = MoveBounds(
            {
                name: value - left[name]
                for name, value in most.items()
                if math.isfinite(value)
            },
            velocity=_GUARDED * limits.reference_step / law.period,
            acceleration=_GUARDED * limits.acceleration_limit,
        )
        knot = max(1, round(self.vibration / (_KNOTS * law.period)))
        return Programme(loops, knot, bounds), left["voltage"]

    def longer(self, programme: Programme, factor: int) -> Programme:
        """Return the same programme with responses that are known for longer."""
        duration = factor * _KNOWN * self.vibration
        loops = responses_of(
            self.law, self.arm, self.between(self.steps), duration, told=self.told
        )
        return replace(programme, loops=loops)

    def run(self, reference: Reference, payload: float, seed: int) -> Run:
        """Run a reference on the arm as it is."""
        length = reference.duration + _REST * self.vibration
        noisy: dict[str, Any] = {"gauge_offset": self.gauge_offset, "seed": seed}
        return self.arm.run(
            self.law, reference, payload, length, told=self.told, **noisy
        )

    def measured(self, tried: Candidate, target: Path | None, seeds: int) -> Measured:
        """Run a reference on the arm with every payload and noise, and return the
        worst.
        """
        runs = [
            self.run(tried.reference, payload, seed)
            # Twice as dense as the programme's payloads: those in between were promised
            # nothing, and are asked.
            for payload in self.between(2 * self.steps)
            for seed in range(seeds)
        ]
        return Measured(
            name=tried.name,
            duration=tried.reference.duration,
            predicted=tried.predicted,
            settling_time=max(run.metrics.settling_time for run in runs),
            largest_error=math.nan
            if target is None
            else max(_error(run, target) for run in runs),
            residual_vibration=max(run.metrics.residual_vibration for run in runs),
            peak_voltage=max(run.metrics.peak_voltage for run in runs),
            limited=sum(map(_limited, runs)) / len(runs),
            computing_time=tried.computing_time,
        )


def _limited(run: Run) -> bool:
    return (
        bool(np.any(run.flags & ~np.uint32(_kernels.LAW_FLAG_STARTED)))
        or not run.finished
    )


def _error(run: Run, target: Path) -> float:
    return float(np.abs(run.tip_angle - target.angle(run.time)).max())
