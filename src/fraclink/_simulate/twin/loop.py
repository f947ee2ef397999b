"""Close the loop on the twin with the law that is shipped."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.reference import Reference, checked_reference
from fraclink._law import Law
from fraclink._simulate.twin import vessel
from fraclink._simulate.twin.arm import Twin
from fraclink._simulate.twin.events import (
    FAULTS,
    Event,
    Obstacle,
    PayloadChange,
    Restart,
    SensorFault,
    TipPulse,
)
from fraclink._simulate.twin.logs import MOST_SAMPLES
from fraclink._simulate.twin.run import TwinRun, collect, vibration_period
from fraclink._simulate.twin.vessel import (
    ACCELERATION,
    ENCODER_GAIN,
    GAUGE_ERROR,
    GAUGE_GAIN,
    REFERENCE,
    TIP_FORCE,
    VELOCITY,
    Vessel,
)
from fraclink._validate import checked_between, checked_noun, checked_whole
from fraclink.errors import FieldError, SizeError

__all__ = ["driven", "healthy_inputs", "run_twin"]

Vector = NDArray[np.float64]


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
    law
        single or double precision; where it has no inner loop it gets that of the twin's motor
    reference
        of the tip, with velocity and acceleration; `.then()` makes several moves in a row
    duration
        of the run [s]; default the reference's and 3 s more
    events
        changes of payload, pulses, obstacles, restarts
    seed
        of the gauge's noise

    Raises
    ------
    FieldError
        the law has another period than its inner loop; the duration is out of range.

    >>> import fraclink as fl
    >>> from fraclink._arm.reference import smooth_step
    >>> from fraclink._simulate.twin import Twin, geared, run_twin
    >>> rig = geared(fl.Rig.named("paper-2023"))
    >>> design = fl.design(
    ...     rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0, phase_margin=fl.deg(50)
    ... )
    >>> law = design.controller.discretize(rig.period)
    >>> run = run_twin(Twin.from_rig(rig, link_mass=0.00735), law, smooth_step(1.0, duration=1.0))
    >>> bool(abs(run.error[-1]) < 0.02)
    True
    """
    checked_noun("twin", twin, Twin, remedy="Twin.from_rig makes one")
    law = driven(twin, checked_noun("law", law, Law, remedy="controller.discretize(rig.period) makes one"))
    checked_reference(reference)
    checked_whole("seed", seed, 0, 2**64 - 1)
    length = reference.duration + 3.0 if duration is None else duration
    checked_between("duration", length, 2 * law.period, 1e300, "s", open_low=True)
    if length > MOST_SAMPLES * law.period:
        raise SizeError("duration", length, "too long", allowed=f"{MOST_SAMPLES} periods", remedy="split it")
    count = round(length / law.period) + 1
    inputs = healthy_inputs(twin, reference, law.period, count, np.random.default_rng(seed))
    arm = Vessel(twin, law.period, law.initial_state(), start_angle=float(inputs[0, REFERENCE]))
    records, payloads = [], []
    happening = _checked(events)
    for first, last, changes in _segments(happening, law.period, inputs):
        _apply(arm, law, changes)
        part = arm.run(law.block, inputs[first:last], single=law.precision == "single")
        records.append(part)
        payloads.append(np.full(len(part), arm.twin.beam.payload))
        if len(part) < last - first:
            break
    return collect(
        np.vstack(records),
        np.concatenate(payloads),
        law.period,
        finished=sum(map(len, records)) == count,
        ended=reference.duration,
        vibration_period=vibration_period(twin),
        about={
            "law_sha256": law.digest,
            "seed": str(seed),
            "damping": twin.damping.label,
            "link_mass_kg": repr(twin.beam.link_mass),
            "payload_kg": repr(twin.beam.payload),
            "events": "; ".join(map(repr, happening)),
        },
    )


def _checked(events: Iterable[Event]) -> tuple[Event, ...]:
    """The events as a tuple; FieldError for anything that is none."""
    given = tuple(events) if isinstance(events, Iterable) else (events,)
    for event in given:
        if not isinstance(event, Event):
            raise FieldError(
                "events",
                repr(event),
                "no event",
                allowed="PayloadChange, TipPulse, Obstacle, Restart, SensorFault",
                remedy="give a list of these",
            )
    return given


def driven(twin: Twin, law: Law) -> Law:
    """Return the law with the inner loop of the twin's motor, if it has none; refuse what cannot run."""
    from fraclink._arm.motor_loop import place_pid
    from fraclink._law import Drive
    from fraclink._law.discretize import COULOMB_SPEED

    if law.drive is None:
        motor = twin.motor
        drive = Drive(
            loop=place_pid(motor, law.inner_pole).discretize(law.period),
            voltage_limit=min(motor.voltage_limit, 1e4),  # a block holds finite numbers
            torque_voltage=1.0 / (motor.torque_constant * motor.gear_ratio),
            coulomb_voltage=motor.coulomb_torque / motor.torque_constant,
            coulomb_speed=COULOMB_SPEED,
        )
        return replace(law, drive=drive)
    if not math.isclose(law.drive.loop.period, law.period, rel_tol=1e-9):
        raise FieldError(
            "period",
            law.period,
            "not the inner loop's",
            allowed=f"{law.drive.loop.period} s",
            remedy="discretise controller and inner loop at one period",
        )
    return law


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


def _inject(fault: SensorFault, rows: NDArray[np.float64]) -> None:
    """Write a sensor's fault into the kernel's inputs."""
    bit, name = FAULTS[fault.kind]
    rows[:, vessel.FAULTS] = rows[:, vessel.FAULTS].astype(int) | bit
    if name is None or fault.value is None:
        return
    column = getattr(vessel, name)
    if name in ("ENCODER_ERROR", "GAUGE_ERROR"):
        rows[:, column] += fault.value
    else:
        rows[:, column] = fault.value


def _apply(arm: Vessel, law: Law, changes: list[Event | None]) -> None:
    for event in changes:
        if event is None:
            arm.obstacle[1] = 0.0
        elif isinstance(event, Obstacle):
            arm.obstacle[:] = (
                event.angle,
                event.stiffness,
                event.damping,
                arm.twin.beam.length,
                event.side,
            )
        elif isinstance(event, PayloadChange):
            arm.change_payload(event.payload)
        elif isinstance(event, Restart):
            arm.law = np.frombuffer(bytearray(law.initial_state()), dtype=np.uint8)
