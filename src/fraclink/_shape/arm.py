"""What a reference is shaped for and measured on: the twin of a rig, or the model that was identified."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from fraclink._arm.link import LinkModel
from fraclink._arm.reference import Reference
from fraclink._arm.rig import Rig
from fraclink._law import Law
from fraclink._simulate import Run, Twin, simulate
from fraclink._simulate.simulate import with_motor_loop

__all__ = ["UNLIMITED", "ShapedArm"]

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
