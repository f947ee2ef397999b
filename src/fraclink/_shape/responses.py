"""The arm that a reference is shaped for, and its closed loop as a linear system of the reference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel
from fraclink._arm.reference import Reference, SampledReference, hold, sampled
from fraclink._arm.rig import Rig
from fraclink._law import Law
from fraclink._simulate import Run, Twin, simulate
from fraclink._simulate.simulate import with_motor_loop
from fraclink.errors import FieldError

__all__ = [
    "SIGNALS",
    "UNITS",
    "UNLIMITED",
    "Responses",
    "ShapedArm",
    "noise_of",
    "responses_of",
    "without_friction",
]

UNLIMITED = 1e4  # [V]: a law's block holds finite numbers


@dataclass(frozen=True)
class ShapedArm:
    """A twin; or, without one, the model of the link behind the rig's motor, gauge and encoder."""

    rig: Rig
    model: LinkModel
    twin: Twin | None

    def run(
        self,
        law: Law,
        reference: Reference,
        payload: float,
        duration: float,
        *,
        told: bool,
        gauge_offset: float | None = None,
        seed: int = 0,
    ) -> Run:
        """Run a law on the arm with a payload [kg] for `duration` [s]."""
        if self.twin is not None:
            own: dict[str, Any] = {"arm": self.twin.with_payload(payload)}
        else:
            own = {"rig": self.rig, "model": self.model, "payload": payload}
        return simulate(
            law, reference, **own, duration=duration, told=told, gauge_offset=gauge_offset, seed=seed
        )

    def equipped(self, law: Law) -> Law:
        """Return the law with a motor loop for this arm."""
        if self.twin is not None:
            return with_motor_loop(law, twin=self.twin)[0]
        return with_motor_loop(law, rig=self.rig, link=self.model)[0]

    @property
    def voltage_limit(self) -> float:
        """Of the amplifier [V]."""
        return self.rig.motor.voltage_limit if self.twin is None else self.twin.motor.voltage_limit

    @property
    def gauge_limit(self) -> float:
        """Largest torque that the gauge shows [N·m]."""
        if self.twin is None:
            return self.rig.gauge.limit
        limit = self.twin.sensors.gauge_limit
        return math.inf if limit is None else limit

    def without_friction(self) -> ShapedArm:
        """Return the arm without friction and with an amplifier that has no limit."""
        rig = replace(self.rig, motor=replace(self.rig.motor, coulomb_torque=0.0, voltage_limit=UNLIMITED))
        if self.twin is None:
            return ShapedArm(rig, self.model, None)
        motor = replace(self.twin.motor, coulomb_torque=0.0, voltage_limit=UNLIMITED)
        return ShapedArm(rig, self.model, replace(self.twin, motor=motor, stiction=0.0))

    def with_exact_sensors(self) -> ShapedArm:
        """Return the arm with sensors that neither round, limit nor add anything; a late gauge stays late."""
        gauge = replace(self.rig.gauge, noise=0.0, offset=0.0, quantum=0.0, limit=math.inf)
        encoder = replace(self.rig.encoder, counts_per_revolution=None)
        rig = replace(self.rig, gauge=gauge, encoder=encoder)
        if self.twin is None:
            return ShapedArm(rig, self.model, None)
        exact = replace(self.twin.sensors, counts_per_revolution=None, gauge_noise=0.0, gauge_offset=0.0)
        exact = replace(exact, gauge_quantum=0.0, gauge_limit=None, gauge_drift=0.0)
        return ShapedArm(rig, self.model, replace(self.twin, sensors=exact))


Real = NDArray[np.float64]

# Tip angle, voltage, step of the motor reference in a period, motor speed, torque.
SIGNALS = ("tip", "voltage", "motor_step", "motor_speed", "torque")
UNITS = ("rad", "V", "rad", "rad/s", "N·m")
# Far below every guard of the law, and so far above the rounding of its doubles that nothing is lost.
_ANGLE, _ACCELERATION = 1e-4, 1e-2
_NOISE_TIME = 8.0  # [s]: a standard deviation from 2000 samples is known to 2 %
_DIVERGED = 1e3  # of a response that a stable loop lets die away


@dataclass(frozen=True, eq=False)
class Responses:
    """The loops around arms with P payloads [kg]: impulse responses in the rows of SIGNALS, (P, 2, 5, N).

    The first of the two is the response to an angle of 1 rad in one period, the second to an acceleration of
    1 rad/s² in one period; `period` [s].
    """

    payloads: tuple[float, ...]
    period: float
    impulses: Real

    @property
    def length(self) -> int:
        """N, the samples that are known."""
        return int(self.impulses.shape[3])

    @cached_property
    def _spectra(self) -> NDArray[np.complex128]:
        return np.asarray(np.fft.rfft(self.impulses, 2 * self.length))

    def to(self, reference: Reference, names: Sequence[str] = SIGNALS) -> Real:
        """Return the signals of these names along a reference, shape (P, names, N)."""
        inputs = sampled(reference, self.period, self.length)[[0, 2]]
        found = self._spectra[:, :, [SIGNALS.index(name) for name in names]]
        spectrum = np.einsum("if,pisf->psf", np.fft.rfft(inputs, 2 * self.length), found)
        return np.asarray(np.fft.irfft(spectrum, 2 * self.length)[..., : self.length])


def without_friction(law: Law, arm: ShapedArm) -> tuple[Law, ShapedArm]:
    """Return the law without its compensation of friction, the arm without friction, neither with a limit."""
    drive = law.drive
    if drive is None:
        allowed, remedy = "a law with a motor loop", "shape moves for design.law()"
        raise FieldError("law", "no motor loop", "without a voltage", allowed=allowed, remedy=remedy)
    free = replace(law, drive=replace(drive, coulomb_voltage=0.0, voltage_limit=UNLIMITED))
    return free.in_precision("double"), arm.without_friction()


def responses_of(
    law: Law, arm: ShapedArm, payloads: Sequence[float], duration: float, *, told: bool
) -> Responses:
    """Return the responses of the loop for each payload [kg], over `duration` [s].

    FieldError where one does not die away: the loop is not stable on this arm.
    """
    free, plain = without_friction(law, arm.with_exact_sensors())
    found = []
    for payload in payloads:
        found.append(np.stack([_impulse(free, plain, row, payload, duration, told) for row in (0, 2)]))
        if found[-1].shape != found[0].shape or not np.all(np.abs(found[-1][0, 0]) < _DIVERGED):
            problem, allowed = "one with which the loop is not stable", "a payload that the law holds"
            remedy = "narrow the range, or design for it"
            raise FieldError("payloads", payload, problem, allowed=allowed, remedy=remedy)
    return Responses(tuple(payloads), law.period, np.stack(found))


def _impulse(law: Law, arm: ShapedArm, row: int, payload: float, duration: float, told: bool) -> Real:
    size = _ACCELERATION if row else _ANGLE
    values = np.zeros((3, 4))
    values[row, 1] = size  # in the second period: the first one starts the law
    reference = SampledReference(law.period, values)
    run = arm.run(law, reference, payload, duration + law.period, told=told)
    return np.asarray(_signals(run)[:, 1:] / size)


def _signals(run: Run) -> Real:
    steps = np.diff(run.motor_reference, prepend=0.0)
    speed = run.extras.get("motor_velocity")
    if speed is None:  # the model's is not recorded
        speed = np.diff(run.motor_angle, prepend=0.0) / run.period
    return np.array([run.tip_angle, run.voltage, steps, speed, run.torque])


def noise_of(law: Law, arm: ShapedArm, payload: float, *, told: bool) -> dict[str, float]:
    """Return what the sensors' noise makes of each signal where nothing moves, as a standard deviation."""
    free, quiet = without_friction(law, arm)
    run = quiet.run(free, hold(0.0), payload, _NOISE_TIME, told=told, gauge_offset=0.0)
    return dict(zip(SIGNALS, np.std(_signals(run), axis=1).tolist(), strict=True))
