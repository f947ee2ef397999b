"""The kernel's side of a run on the twin: its buffers, its columns, and how a payload is exchanged."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.beam import matrices
from fraclink._simulate.twin.arm import Twin
from fraclink._simulate.twin.logs import substeps
from fraclink._simulate.twin.plant import Plant, StepMatrices
from fraclink.errors import FieldError

__all__ = ["Vessel"]

Vector = NDArray[np.float64]

# Columns of the kernel's inputs (csrc/kernels/twin.h).
REFERENCE, VELOCITY, ACCELERATION, GAUGE_ERROR, TIP_FORCE, FAULTS = range(6)
ENCODER_GAIN, ENCODER_ERROR, ENCODER_VALUE, GAUGE_GAIN, GAUGE_VALUE = range(6, 11)


class Vessel:
    """The kernel's buffers of one run: link, gauge ring, voltage queue, sensors, law. Internal, mutable."""

    def __init__(self, twin: Twin, period: float, law_state: bytes, *, start_angle: float = 0.0) -> None:
        self.count = substeps(period, twin.step)
        self.fine = period / self.count
        delay = round(twin.sensors.gauge_delay / self.fine)
        if abs(delay * self.fine - twin.sensors.gauge_delay) > 1e-9:
            raise FieldError(
                "gauge_delay",
                twin.sensors.gauge_delay,
                "between two steps",
                allowed=f"multiples of {self.fine:g} s",
                remedy="choose a step that divides the delay",
            )
        self.plant, self.step = _discretised(twin, self.fine)
        self.state = self.step.rest()
        self.state[0] = start_angle
        self.state += _straight(self.plant, start_angle, self.state.size)
        self.gauge = np.zeros(delay + 1)
        self.voltage = np.zeros(twin.voltage_delay + 1)
        self.sensed = np.array([start_angle, 0.0])
        self.counters = np.array([1, 1], dtype=np.uint32)  # stuck, first tick
        self.law = np.frombuffer(bytearray(law_state), dtype=np.uint8)
        self.rig = np.array(
            [
                self.count,
                twin.voltage_delay,
                delay,
                twin.motor.gear_ratio * twin.motor.torque_constant,
                twin.motor.voltage_limit,
                twin.coulomb,
                twin.breakaway,
                twin.sensors.angle_quantum,
                twin.sensors.gauge_quantum,
                math.inf if twin.sensors.gauge_limit is None else twin.sensors.gauge_limit,
            ]
        )
        self.obstacle = np.array([0.0, 0.0, 0.0, twin.beam.length, 1.0])
        self.twin = twin

    def run(self, block: bytes, inputs: NDArray[np.float64], *, single: bool = False) -> NDArray[np.float64]:
        """Advance by the rows of `inputs` under a law's block; returns the kernel's record."""
        return np.asarray(
            _kernels.twin_run(
                *self.step.arrays,
                self.rig,
                self.obstacle,
                block,
                single,
                np.ascontiguousarray(inputs),
                self.law,
                self.state,
                self.gauge,
                self.voltage,
                self.sensed,
                self.counters,
            )
        )

    def sense(self, inputs: Vector) -> tuple[float, float]:
        """Return what encoder and gauge read now."""
        angle, torque = _kernels.twin_sense(
            self.rig,
            np.ascontiguousarray(inputs),
            self.state,
            self.gauge,
            self.voltage,
            self.sensed,
            self.counters,
        )
        return float(angle), float(torque)

    def change_payload(self, payload: float) -> None:
        """Go on with another payload: shape, speed and the material's memory stay, the modes are new."""
        twin = self.twin.with_payload(payload)
        plant, step = _discretised(twin, self.fine)
        self.state = _transfer(self.plant, plant, self.state, step)
        self.twin, self.plant, self.step = twin, plant, step


@lru_cache(maxsize=64)
def _discretised(twin: Twin, step: float) -> tuple[Plant, StepMatrices]:
    # Modes and matrix exponential cost more than a run; a campaign asks for the same few arms over and over.
    plant = twin.plant(step)
    return plant, plant.discretise(step)


def _straight(plant: Plant, angle: float, size: int) -> Vector:
    """The absolute modal coordinates Γi θm of a straight link whose hub stands at `angle`."""
    state = np.zeros(size)
    for i in range(plant.modes.count):
        state[plant.mode_slice(i).start] = plant.modes.participation[i] * angle
    return state


def _transfer(old: Plant, new: Plant, state: Vector, step: StepMatrices) -> Vector:
    """Project link, velocity and every Maxwell element of the old modes on the new ones."""
    mass, _ = matrices(new.beam)
    projection = new.modes.shapes.T @ mass @ old.modes.shapes
    result = step.rest()
    result[:2] = state[:2]
    blocks = np.array([state[old.mode_slice(i)] for i in range(old.modes.count)])
    blocks[:, 0] -= old.modes.participation * state[0]
    blocks[:, 1] -= old.modes.participation * state[1]
    moved = projection @ blocks
    moved[:, 0] += new.modes.participation * state[0]
    moved[:, 1] += new.modes.participation * state[1]
    for i in range(new.modes.count):
        result[new.mode_slice(i)] = moved[i]
    return result
