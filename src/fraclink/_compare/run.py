"""One rival on the twin: the same arm, sensors, noise, inner loop and reference for all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.reference import Reference
from fraclink._compare.outer import Seen
from fraclink._compare.rivals import Rival
from fraclink._compare.shaping import Shaped
from fraclink._law import Law
from fraclink._simulate.arm import Twin
from fraclink._simulate.kernel import ACCELERATION, GAUGE_ERROR, REFERENCE, VELOCITY, ArmState, healthy_inputs
from fraclink._simulate.run import Run
from fraclink._simulate.simulate import twin_run

__all__ = ["run_rival"]

Real = NDArray[np.float64]


def feed_forward(law: Law, acceleration: Real) -> Real:
    """Return F θ̈t* as law.c computes it, shape (N,)."""
    modes = law.feedforward
    result = modes.direct * acceleration
    for pole, gain in zip(modes.poles, modes.gains, strict=True):
        state = 0.0
        for k, value in enumerate(acceleration.tolist()):
            result[k] += gain * state
            state = pole * state + value
    return np.asarray(result)


def run_rival(
    twin: Twin,
    rival: Rival,
    reference: Reference,
    forward: Law,
    *,
    duration: float,
    offset: float = 0.0,
    offset_time: float = 0.2,
    seed: int = 0,
) -> Run:
    """Run a rival; the gauge's offset jumps by `offset` [N·m] at `offset_time` [s].

    forward: the law whose feed-forward the rivals with tip feedback share
    """
    law = rival.law
    count = round(duration / law.period) + 1
    followed: Reference = Shaped(reference, *rival.impulses) if rival.impulses else reference
    inputs = healthy_inputs(twin, followed, law.period, count, np.random.default_rng(seed))
    inputs[round(offset_time / law.period) :, GAUGE_ERROR] += offset
    state = ArmState(twin, law.period, law.initial_state())
    if rival.outer is None:
        record = state.run(law.block, inputs)
    else:
        record = _tick_by_tick(state, rival, inputs, feed_forward(forward, inputs[:, ACCELERATION]))
    wanted = reference.angle(law.period * np.arange(len(record)))
    record[:, 0] = wanted  # judged by what was asked, not by the shaped reference
    return twin_run(
        record,
        np.full(len(record), twin.beam.payload),
        twin,
        law.period,
        finished=len(record) == count,
        ended=followed.duration,  # a shaper's own delay counts as settling, not as vibration
        about={"rival": rival.name, "seed": seed},
    )


def _tick_by_tick(state: ArmState, rival: Rival, inputs: Real, forward: Real) -> Real:
    assert rival.outer is not None  # noqa: S101  # the caller's case
    outer, block = rival.outer(), rival.law.block
    compliance = 1.0 / rival.law.stiffness
    record = np.empty((len(inputs), _kernels.TWIN_COLUMNS))
    wanted = inputs[:, REFERENCE].tolist()
    for k in range(len(inputs)):
        angle, torque = state.sense(inputs[k])
        bend = torque * compliance
        error = wanted[k] - (angle - bend)
        command = wanted[k] + forward[k] + outer(Seen(wanted[k], error, bend, forward[k]))
        inputs[k, REFERENCE] = min(max(command, -1e3), 1e3)
        inputs[k, VELOCITY], inputs[k, ACCELERATION] = inputs[k, VELOCITY], 0.0
        record[k] = state.run(block, inputs[k : k + 1])[0]
        if abs(record[k, 1]) > 1e2:
            return record[: k + 1]
    return record
