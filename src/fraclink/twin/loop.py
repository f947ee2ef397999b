"""Close the loop on the twin with the law that is shipped."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink.errors import FieldError, SizeError
from fraclink.twin.arm import Twin
from fraclink.twin.beam import matrices
from fraclink.twin.events import Event, Obstacle, PayloadChange, Restart, TipPulse
from fraclink.twin.logs import MOST_SAMPLES, substeps
from fraclink.twin.plant import Plant, StepMatrices

if TYPE_CHECKING:
    from fraclink.law import Law
    from fraclink.reference import Reference

__all__ = ["TwinRun", "Vessel", "run_twin"]

Vector = NDArray[np.float64]

# Columns of the kernel's inputs (csrc/kernels/twin.h).
REFERENCE, VELOCITY, ACCELERATION, GAUGE_ERROR, TIP_FORCE, FAULTS = range(6)
ENCODER_GAIN, ENCODER_ERROR, ENCODER_VALUE, GAUGE_GAIN, GAUGE_VALUE = range(6, 11)


@dataclass(frozen=True)
class TwinRun:
    """A move of the twin, one value per control period, each at the period's beginning.

    time [s]; reference, tip_angle, motor_angle, motor_reference [rad]; torque: the true −EI w''(0) [N·m];
    motor_angle_measured [rad] and torque_measured [N·m]: what the sensors gave; voltage: what acted [V];
    motor_velocity [rad/s]; contact_force: the largest of the period [N]; mode, reason and flags of the law
    (see law.h); payload [kg]. `finished` is False where the twin left every bound and the run was cut.
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
    mode: NDArray[np.int64]
    reason: NDArray[np.int64]
    flags: NDArray[np.int64]
    payload: Vector
    finished: bool

    @property
    def period(self) -> float:
        """Control period [s]."""
        return float(self.time[1] - self.time[0])

    @property
    def error(self) -> Vector:
        """Reference minus tip angle [rad]."""
        return np.asarray(self.reference - self.tip_angle)


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
        self.plant = twin.plant(self.fine)
        self.step = self.plant.discretise(self.fine)
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

    def run(self, block: bytes, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Advance by the rows of `inputs`; returns the kernel's record."""
        return np.asarray(
            _kernels.twin_run(
                *self.step.arrays,
                self.rig,
                self.obstacle,
                block,
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
        plant = twin.plant(self.fine)
        step = plant.discretise(self.fine)
        self.state = _transfer(self.plant, plant, self.state, step)
        self.twin, self.plant, self.step = twin, plant, step


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


def healthy_inputs(
    twin: Twin, reference: Reference, period: float, count: int, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Return the kernel's inputs of a run without events or faults, shape (count, 11)."""
    time = period * np.arange(count)
    inputs = np.zeros((count, _kernels.TWIN_INPUTS))
    inputs[:, REFERENCE] = reference.angle(time)
    inputs[:, VELOCITY] = reference.velocity(time)
    inputs[:, ACCELERATION] = reference.acceleration(time)
    sensors = twin.sensors
    inputs[:, GAUGE_ERROR] = sensors.gauge_offset + sensors.gauge_drift * time
    # Drawn even where the noise is 0, so that a seed gives the same noise whatever its size.
    inputs[:, GAUGE_ERROR] += sensors.gauge_noise * generator.standard_normal(count)
    inputs[:, ENCODER_GAIN] = inputs[:, GAUGE_GAIN] = 1.0
    return inputs


def run_twin(
    twin: Twin,
    law: Law,
    reference: Reference,
    *,
    duration: float | None = None,
    events: Iterable[Event] = (),
    seed: int = 0,
) -> TwinRun:
    """Run the shipped law on the twin.

    Parameters
    ----------
    law: with its inner loop (`plan.controller.discretize(..., rig=rig)`), in double precision
    reference: of the tip, with velocity and acceleration; `.then()` makes several moves in a row
    duration: of the run [s]; default the reference's and 3 s more
    events: changes of payload, pulses, obstacles, restarts
    seed: of the gauge's noise

    Raises
    ------
    FieldError: the law has no inner loop, another period than its drive, or is in single precision; the
        duration is out of range.

    >>> import fraclink as fl
    >>> from fraclink.twin import Twin, run_twin
    >>> rig = fl.Rig.named("paper-2023")
    >>> plan = fl.design(
    ...     rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=0.0
    ... )
    >>> law = plan.controller.discretize(rig.period, rig=rig)
    >>> run = run_twin(Twin.from_rig(rig, link_mass=0.00735), law, fl.smooth_step(1.0, duration=1.0))
    >>> bool(abs(run.error[-1]) < 0.02)
    True
    """
    _check_law(law)
    length = reference.duration + 3.0 if duration is None else duration
    if not (math.isfinite(length) and length > 2 * law.period):
        raise FieldError("duration", length, "too short", allowed="> 2 periods", remedy="give seconds")
    count = round(length / law.period) + 1
    if count > MOST_SAMPLES:
        raise SizeError("duration", length, "too long", allowed=f"{MOST_SAMPLES} periods", remedy="split it")
    inputs = healthy_inputs(twin, reference, law.period, count, np.random.default_rng(seed))
    vessel = Vessel(twin, law.period, law.initial_state(), start_angle=float(inputs[0, REFERENCE]))
    records, payloads = [], []
    for first, last, changes in _segments(tuple(events), law.period, inputs):
        _apply(vessel, law, changes)
        part = vessel.run(law.block, inputs[first:last])
        records.append(part)
        payloads.append(np.full(len(part), vessel.twin.beam.payload))
        if len(part) < last - first:
            break
    return collect(np.vstack(records), np.concatenate(payloads), law.period, count)


def _check_law(law: Law) -> None:
    if law.drive is None:
        raise FieldError(
            "law",
            "without an inner loop",
            "not enough to drive a motor",
            allowed="a law with a drive",
            remedy="discretise the controller with rig=",
        )
    if not math.isclose(law.drive.loop.period, law.period, rel_tol=1e-9):
        raise FieldError(
            "period",
            law.period,
            "not the inner loop's",
            allowed=f"{law.drive.loop.period} s",
            remedy="discretise controller and inner loop at one period",
        )
    if law.precision != "double":
        raise FieldError(
            "precision",
            law.precision,
            "not what the twin runs",
            allowed="double",
            remedy="use law.in_precision('double')",
        )


def _segments(
    events: tuple[Event, ...], period: float, inputs: NDArray[np.float64]
) -> list[tuple[int, int, list[Event | None]]]:
    """Cut the run where something changes; pulses go straight into the inputs."""
    count = len(inputs)
    changes: dict[int, list[Event | None]] = {0: []}
    for event in sorted(events, key=lambda e: e.time):
        at = round(event.time / period)
        if isinstance(event, TipPulse):
            inputs[at : at + max(1, round(event.duration / period)), TIP_FORCE] += event.force
            continue
        changes.setdefault(min(at, count), []).append(event)
        if isinstance(event, Obstacle):
            changes.setdefault(min(round(event.until / period), count), []).append(None)
    edges = sorted(changes)
    return [
        (first, last, changes[first])
        for first, last in zip(edges, [*edges[1:], count], strict=True)
        if first < last
    ]


def _apply(vessel: Vessel, law: Law, changes: list[Event | None]) -> None:
    for event in changes:
        if event is None:
            vessel.obstacle[1] = 0.0
        elif isinstance(event, Obstacle):
            vessel.obstacle[:] = (
                event.angle,
                event.stiffness,
                event.damping,
                vessel.twin.beam.length,
                event.side,
            )
        elif isinstance(event, PayloadChange):
            vessel.change_payload(event.payload)
        elif isinstance(event, Restart):
            vessel.law = np.frombuffer(bytearray(law.initial_state()), dtype=np.uint8)


def collect(record: NDArray[np.float64], payload: Vector, period: float, wanted: int) -> TwinRun:
    """Name the columns of the kernel's record."""
    columns = [np.ascontiguousarray(column) for column in record.T]
    for column in (*columns, payload):
        column.flags.writeable = False
    (reference, motor, tip, torque, encoder, gauge, command, voltage, _, mode, reason, flags, speed, contact) = (
        columns
    )
    time = period * np.arange(len(record))
    time.flags.writeable = False
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
        mode=mode.astype(np.int64),
        reason=reason.astype(np.int64),
        flags=flags.astype(np.int64),
        payload=payload,
        finished=len(record) == wanted,
    )
