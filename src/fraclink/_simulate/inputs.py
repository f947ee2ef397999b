"""What comes from outside in every period of a run: reference, gauge error, faults, the told payload."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.reference import Reference
from fraclink._law.estimator import PayloadEstimator
from fraclink._simulate.arm import Twin
from fraclink._simulate.sensors import FAULTS, Event, Obstacle, SensorFault, TipPulse
from fraclink.errors import FieldError

__all__ = ["fault_rows", "given_payload", "healthy_inputs", "segments"]

Real = NDArray[np.float64]

# Columns of the twin's inputs (csrc/kernels/twin.h); the model reads those of a fault.
REFERENCE, VELOCITY, ACCELERATION, GAUGE_ERROR, TIP_FORCE, FAULT_BITS = range(6)
ENCODER_GAIN, ENCODER_ERROR, ENCODER_VALUE, GAUGE_GAIN, GAUGE_VALUE, PAYLOAD = range(6, 12)


def healthy_inputs(
    twin: Twin, reference: Reference, period: float, count: int, generator: np.random.Generator
) -> Real:
    """Return the kernel's inputs of a run without events or faults, shape (count, 12)."""
    time = period * np.arange(count)
    inputs = fault_rows((), period, count)
    inputs[:, REFERENCE] = reference.angle(time)
    inputs[:, VELOCITY] = reference.velocity(time)
    inputs[:, ACCELERATION] = reference.acceleration(time)
    sensors = twin.sensors
    inputs[:, GAUGE_ERROR] = sensors.gauge_offset + sensors.gauge_drift * time
    # Drawn even where the noise is 0, so that a seed gives the same noise whatever its size.
    inputs[:, GAUGE_ERROR] += sensors.gauge_noise * generator.standard_normal(count)
    return inputs


def fault_rows(faults: tuple[SensorFault, ...], period: float, count: int) -> Real:
    """Return the kernels' inputs of faults alone, shape (count, 12)."""
    inputs = np.zeros((count, _kernels.TWIN_INPUTS))
    inputs[:, ENCODER_GAIN] = inputs[:, GAUGE_GAIN] = 1.0
    segments(faults, period, inputs)
    return inputs


def segments(
    events: Sequence[Event], period: float, inputs: Real
) -> list[tuple[int, int, list[Event | None]]]:
    """Cut the run where something changes; pulses go straight into the inputs."""
    count = len(inputs)
    changes: dict[int, list[Event | None]] = {0: []}
    for event in sorted(events, key=lambda e: e.time):
        at = round(event.time / period)
        if isinstance(event, TipPulse):
            inputs[at : at + max(1, round(event.duration / period)), TIP_FORCE] += event.force
            continue
        if isinstance(event, SensorFault):
            _inject(event, inputs[at : max(at + 1, round(event.until / period))])
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


_FAULT_COLUMNS = {
    "ENCODER_GAIN": ENCODER_GAIN,
    "ENCODER_ERROR": ENCODER_ERROR,
    "ENCODER_VALUE": ENCODER_VALUE,
    "GAUGE_GAIN": GAUGE_GAIN,
    "GAUGE_ERROR": GAUGE_ERROR,
    "GAUGE_VALUE": GAUGE_VALUE,
}


def _inject(fault: SensorFault, rows: Real) -> None:
    """Write a sensor's fault into the kernel's inputs."""
    bit, name = FAULTS[fault.kind]
    rows[:, FAULT_BITS] = rows[:, FAULT_BITS].astype(int) | bit
    if name is None or fault.value is None:
        return
    column = _FAULT_COLUMNS[name]
    if name in ("ENCODER_ERROR", "GAUGE_ERROR"):
        rows[:, column] += fault.value
    else:
        rows[:, column] = fault.value


def given_payload(told: bool | float | str | PayloadEstimator, payload: float | None) -> float:
    """What the law is given [kg], 0 for nothing, or for what is estimated."""
    if isinstance(told, str | PayloadEstimator):
        return 0.0
    if told is not True:
        return float(told)
    if payload is None:
        remedy = "give payload=, or a model that knows its own"
        raise FieldError("told", True, "without a payload to tell", allowed="a payload in kg", remedy=remedy)
    return payload
