"""The interface to the compiled arm: the inputs of the kernels and the two calls into
them.

The model, whose link is massless and lumped, runs through `run_lumped`, one arm or
many; the twin through `ArmState`, which can be stopped, tampered with and continued.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.beam import mass_matrix
from fraclink._arm.rig import Rig
from fraclink._law import Law
from fraclink._law.estimator import Estimates, PayloadEstimator
from fraclink._simulate.arm import Twin
from fraclink._simulate.estimates import estimated_over
from fraclink._simulate.links import LinkWeights
from fraclink._simulate.plant import Plant, StepMatrices, substeps
from fracsys.checks import Real

__all__ = [
    "ArmState",
    "LumpedArms",
    "delay_line",
    "run_lumped",
    "shared_rig",
    "twin_numbers",
]


SUBSTEPS = 10  # friction steps per period: a stop is located to 0.4 ms at 4 ms

# Columns of the twin's record (csrc/kernels/twin.h).
RECORD = (
    "reference",
    "motor_angle",
    "tip_angle",
    "torque",
    "motor_angle_measured",
    "torque_measured",
    "motor_reference",
    "voltage",
    "voltage_asked",
    "mode",
    "reason",
    "flags",
    "motor_velocity",
    "contact_force",
    "tip_estimate",
)

_SEEN = ("motor_angle_measured", "torque_measured", "tip_estimate")

# Signals that `run_lumped` returns for each arm, in the order of loop.h.
SIGNALS = (
    "tip_angle",
    "motor_reference",
    "voltage",
    "motor_angle",
    "torque",
    "torque_measured",
    "tip_estimate",
    "motor_angle_measured",
)
MARKS = ("flags", "mode", "reason")


# --- the model ------------------------------------------------------------------------


# Columns of the numbers of a run, in the order of loop.cpp.
NUMBERS = (
    "stiffness",  # [N·m/rad]
    "motor_gain",  # A [rad/(s²·V)]
    "motor_decay",  # B [1/s]
    "friction",  # [rad/s²]
    "gauge_offset",  # [N·m]
    "noise",  # [N·m]
    "delay_samples",  # [periods]
    "amplitude",  # amplitude of the reference [rad]
    "gauge_delay",  # [periods]
    "gauge_gain",  # [1]
    "payload_given",  # payload given to the law [kg], 0: none
)


@dataclass(frozen=True)
class LumpedArms:
    """R arms: their links, one row of `NUMBERS` for each, shape (R, 11), and the seeds of
    their noise, shape (R,).
    """

    links: LinkWeights
    numbers: Real
    seed: NDArray[np.uint64]

    @staticmethod
    def of(
        rig: Rig, links: LinkWeights, seed: NDArray[np.uint64], **values: Real
    ) -> LumpedArms:
        """Return arms of one rig, with `values` of shape (R,) each; motor_gain,
        viscous_friction and coulomb_torque are factors of the rig's own.
        """
        motor = rig.motor
        # As a deceleration at the gear's output: nΓc over n²J.
        braking = motor.coulomb_torque / (motor.inertia * motor.gear_ratio)
        own = values | {
            "motor_gain": motor.gain * values["motor_gain"],
            "motor_decay": motor.decay * values["viscous_friction"],
            "friction": braking * values["coulomb_torque"],
        }
        return LumpedArms(links, np.stack([own[n] for n in NUMBERS], axis=1), seed)

    def column(self, name: str) -> Real:
        """Return one of `NUMBERS` of every arm, shape (R,)."""
        return self.numbers[:, NUMBERS.index(name)]

    def rows(self, rows: NDArray[np.intp]) -> LumpedArms:
        """Return the arms at the given indices."""
        return LumpedArms(self.links.rows(rows), self.numbers[rows], self.seed[rows])


def shared_rig(rig: Rig, law: Law, *, start: float = 0.0) -> Real:
    """Return the numbers common to all arms of a call, in the order of loop.cpp; start:
    the angle at rest before the run [rad].
    """
    return np.array(
        [
            law.motor_loop is not None,
            SUBSTEPS,
            law.period,
            law.motor_loop_pole,
            rig.encoder.resolution,
            rig.gauge.limit,
            rig.gauge.quantum,
            start,
        ],
        np.float64,
    )


def run_lumped(
    law: Law,
    shared: Real,
    arms: LumpedArms,
    path: Real,
    chosen: NDArray[np.int32],
    *,
    faults: Real | None = None,
    estimator: PayloadEstimator | None = None,
) -> dict[str, NDArray[Any]]:
    """Run R arms under one law and return their signals and marks by name, shape (R, N)
    each.

    Parameters
    ----------
    shared
        what all arms have in common.
    path
        unit references: angle [rad] and acceleration [rad/s²], shape (K, 2, N).
    chosen
        which reference each arm follows, shape (R,).
    faults
        of all arms, rows of the twin's inputs, shape (N, 12); None: healthy.
    estimator
        of the law's precision, whose payload each law is given; None: the payload in `arms`.
    """
    runs, length = len(arms.seed), path.shape[2]
    signals = np.empty((len(SIGNALS), runs, length))
    marks = np.empty((len(MARKS), runs, length), np.uint32)
    _kernels.loop_run(
        law.block,
        law.single,
        b"" if estimator is None else estimator.block,
        shared,
        arms.links,
        arms.numbers,
        arms.seed,
        chosen,
        path,
        np.zeros((0, _kernels.TWIN_INPUTS)) if faults is None else faults,
        signals,
        marks,
    )
    return dict(zip(SIGNALS, signals, strict=True)) | dict(
        zip(MARKS, marks, strict=True)
    )


# --- the twin -------------------------------------------------------------------------


def delay_line(delay: float) -> tuple[int, Real]:
    """Return the queue of a delayed signal: age of its oldest entry [steps], weights of
    its four oldest.

    A delay of whole steps is one entry; otherwise it is the cubic through the four
    entries around it, as in the kernels.

    delay: steps, >= 0

    >>> delay_line(2.0), delay_line(0.5)[0]
    ((2, array([1., 0., 0., 0.])), 3)
    """
    whole = round(delay)
    # A millionth of a step is the rounding of a delay in seconds over a period;
    # interpolating it would take four entries instead of one.
    if abs(delay - whole) < 1e-6:
        return whole, np.array([1.0, 0.0, 0.0, 0.0])
    # The error of the cubic is smallest in the middle of its four points; for a delay
    # below one step there is no newer entry, and they lie on one side.
    youngest = max(math.floor(delay) - 1, 0)
    at, nodes = delay - youngest, range(4)
    lagrange = [math.prod((at - j) / (i - j) for j in nodes if j != i) for i in nodes]
    return youngest + 3, np.array(lagrange[::-1])


def twin_numbers(twin: Twin, period: float) -> Real:
    """Return twin_rig of twin.h, shape (15,): motor, amplifier and sensors at a control
    period [s].
    """
    count = substeps(period, twin.step)
    # In steps of the arm instead of periods, because the queue of true torques is
    # written at every step.
    oldest, weights = delay_line(twin.gauge_delay / (period / count))
    return np.array(
        [
            count,
            twin.voltage_delay,
            oldest,
            twin.motor.gear_ratio * twin.motor.torque_constant,
            twin.motor.voltage_limit,
            twin.coulomb,
            twin.breakaway,
            twin.encoder.resolution,
            twin.gauge.quantum,
            twin.gauge.limit,
            twin.gauge_gain,
            *weights,
        ]
    )


class ArmState:
    """The state of a running twin: link, gauge queue, voltage queue, sensors, law.
    Internal, mutable; the kernel takes it by the names of its arrays
    (csrc/bindings/twin_arm.h).
    """

    def __init__(
        self, twin: Twin, period: float, law_state: bytes, *, start_angle: float = 0.0
    ) -> None:
        self.count = substeps(period, twin.step)
        self.fine = period / self.count
        self.rig = twin_numbers(twin, period)
        self.plant, self.step = _discretised(twin, self.fine)
        self.state = np.zeros_like(self.step.hub)
        # A straight link at rest: the hub at its angle, and the absolute coordinate of
        # each mode at Γi θm.
        self.state[0] = start_angle
        self.plant.modal(self.state)[:, 0] = (
            self.plant.modes.participation * start_angle
        )
        # The queues hold zeros: the link is straight, and no voltage was commanded.
        self.gauge = np.zeros(int(self.rig[2]) + 1)
        self.voltage = np.zeros(twin.voltage_delay + 1)
        self.sensed = np.array([start_angle, 0.0])
        self.counters = np.array([1, 1], np.uint32)  # stuck; first tick
        self.fresh, self.estimate = law_state, np.zeros(0, np.uint8)
        self.restart()
        self.obstacle = np.array([0.0, 0.0, 0.0, twin.beam.length, 1.0])
        self.twin = twin

    def run(
        self,
        block: bytes,
        inputs: Real,
        *,
        single: bool = False,
        estimator: PayloadEstimator | None = None,
    ) -> Real:
        """Advance by the rows of `inputs` under a law's block; returns the kernel's
        record.

        With an `estimator` in the law's precision, the law gets the estimated payload
        instead of the one in the rows.
        """
        if estimator is not None and self.estimate.size == 0:
            self.estimate = np.frombuffer(
                bytearray(estimator.initial_state()), np.uint8
            )
        return _kernels.twin_run(
            self, block, single, inputs, b"" if estimator is None else estimator.block
        )

    def estimating(
        self, law: Law, inputs: Real, estimator: PayloadEstimator | None, first: int
    ) -> tuple[Real, list[Estimates]]:
        """Return the record of `run` for the periods from `first` on, and the estimates
        for them.
        """
        # Memory of the estimator before the run, from which its output is recomputed
        # bit for bit: the kernel records sensors and law, not the estimates.
        before = self.estimate.tobytes()
        record = self.run(law.block, inputs, single=law.single, estimator=estimator)
        if estimator is None:
            return record, []
        angle, torque, tip = (record[:, RECORD.index(name)] for name in _SEEN)
        ticks = first + 1 + np.arange(len(record))
        estimates = estimated_over(
            estimator,
            before or estimator.initial_state(),
            angle,
            torque,
            ticks,
            # a period without a tip estimate is one that the law missed
            np.isfinite(tip),
        )
        return record, [estimates]

    def sense(self, inputs: Real) -> tuple[float, float]:
        """Return the present readings of encoder and gauge."""
        return _kernels.twin_sense(self, inputs)

    def restart(self) -> None:
        """Restart the law and its estimator; arm, queues and clock go on, as after a
        restart of the processor.
        """
        self.law = np.frombuffer(bytearray(self.fresh), np.uint8)
        self.estimate = np.zeros(0, np.uint8)

    def free(self) -> None:
        """Remove the obstacle."""
        self.obstacle[1] = 0.0

    def change_payload(self, payload: float) -> None:
        """Continue with another payload: shape, speed and the memory of the material
        are kept, with new modes.
        """
        twin = self.twin.with_payload(payload)
        plant, step = _discretised(twin, self.fine)
        self.state = _transfer(self.plant, plant, self.state, step)
        self.twin, self.plant, self.step = twin, plant, step


@lru_cache(maxsize=64)
def _discretised(twin: Twin, step: float) -> tuple[Plant, StepMatrices]:
    # Modes and the matrix exponential take longer than a run, and a fault campaign uses
    # the same few arms repeatedly.
    plant = twin.plant(step)
    return plant, plant.discretise(step)


def _transfer(old: Plant, new: Plant, state: Real, step: StepMatrices) -> Real:
    """Project link, velocity and every Maxwell element from the old modes onto the new
    ones.
    """
    # Least squares in the norm of the kinetic energy, in which the new modes are
    # orthogonal.
    mass = mass_matrix(new.beam)
    projection = new.modes.shapes.T @ mass @ old.modes.shapes
    result = np.zeros_like(step.hub)
    result[:2] = state[:2]
    bending, moved = old.modal(state).copy(), new.modal(result)
    # From absolute to bending coordinates and back, because the rigid rotation Γi θm
    # depends on the Γi of the payload.
    bending[:, :2] -= np.outer(old.modes.participation, state[:2])
    moved[:] = projection @ bending
    moved[:, :2] += np.outer(new.modes.participation, state[:2])
    return result
