"""One rival on the twin: its run, its linear loop's gain at the second mode, and
whether that loop grows.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from fraclink import _kernels
from fraclink._arm.reference import Reference
from fraclink._law import Law
from fraclink._simulate.arm import Twin
from fraclink._simulate.damping import PowerLaw
from fraclink._simulate.kernel import ArmState
from fraclink._simulate.on_twin import twin_run
from fraclink._simulate.plant import GAUGE_TORQUE, HUB_ANGLE, Plant, assemble
from fraclink._simulate.run import Run
from fraclink._simulate.sensors import (
    ACCELERATION,
    GAUGE_ERROR,
    REFERENCE,
    healthy_inputs,
)
from fraclink.trials._rivals import Rival
from fraclink.trials._setting import (
    Filter,
    NominalLoop,
    Setting,
    fine_step,
    law_filter,
    sampled,
)
from fraclink.trials._shaper import Shaped

__all__ = ["linear_growth", "mode_gain", "run_rival"]

Real = NDArray[np.float64]


def feed_forward(law: Law, acceleration: Real) -> Real:
    """Return F θ̈t* as law.c computes it, shape (N,)."""
    modes = law.feedforward
    result = modes.direct * acceleration
    for pole, gain in zip(modes.poles, modes.gains, strict=True):
        result += lfilter([0.0, gain], [1.0, -pole], acceleration)
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
    # A shaper changes what the arm follows and nothing else: it runs through the law as
    # all the others do.
    followed: Reference = (
        Shaped(reference, *rival.impulses) if rival.impulses else reference
    )
    inputs = healthy_inputs(
        twin.sensors, followed, law.period, count, np.random.default_rng(seed)
    )
    # After the start: an offset that is there from the first sample is taken by the law
    # for the gauge's zero.
    inputs[round(offset_time / law.period) :, GAUGE_ERROR] += offset
    state = ArmState(twin, law.period, law.initial_state())
    if rival.correction is None:
        record = state.run(law.block, inputs, single=law.precision == "single")
    else:
        record = _tick_by_tick(
            state,
            law,
            rival.correction,
            inputs,
            feed_forward(forward, inputs[:, ACCELERATION]),
        )
    wanted = reference.angle(law.period * np.arange(len(record)))
    record[:, 0] = wanted  # judged by what was asked, not by the shaped reference
    return twin_run(
        record,
        np.full(len(record), twin.beam.payload),
        twin,
        law.period,
        finished=len(record) == count,
        # a shaper's own delay counts as settling, not as vibration
        ended=followed.duration,
        about={"rival": rival.name, "seed": seed},
    )


def _tick_by_tick(
    state: ArmState, law: Law, correction: Filter, inputs: Real, forward: Real
) -> Real:
    """Run the law's motor loop alone, with the correction of the tip error around it."""
    compliance = 1.0 / law.stiffness
    inner = np.zeros(correction.order)
    record = np.empty((len(inputs), _kernels.TWIN_COLUMNS))
    wanted = inputs[:, REFERENCE].tolist()
    for k in range(len(inputs)):
        angle, torque = state.sense(inputs[k])
        error = wanted[k] - (angle - torque * compliance)
        # Equation (22), corrected: reference, feed-forward, and the rival's answer to the
        # error.
        answer = float(correction.c @ inner) + correction.d * error
        inner = correction.a @ inner + correction.b * error
        command = wanted[k] + forward[k] + answer
        # A rival that diverges would hand the law infinity, which its guards answer;
        # what is compared is control.
        inputs[k, REFERENCE] = min(max(command, -1e3), 1e3)
        # The feed-forward is in the command already: the law must not add its own.
        inputs[k, ACCELERATION] = 0.0
        record[k] = state.run(
            law.block, inputs[k : k + 1], single=law.precision == "single"
        )[0]
        # A motor at 100 rad has turned sixteen times: it diverges, and each further
        # tick costs as much as a good one.
        if abs(record[k, 1]) > 1e2:
            return record[: k + 1]
    return record


def _correction(rival: Rival) -> Filter | None:
    """The rival's feedback of the tip estimate as a filter, None where it has none."""
    if rival.correction is None and rival.law.correction.direct != 0.0:
        return law_filter(rival.law)
    return rival.correction


def _plant(setting: Setting, twin: Twin) -> tuple[Plant, Filter]:
    """The twin behind the ideal motor servo, and its tip estimate θm − Γ/c as the
    controller sees it.
    """
    period = setting.rig.period
    plant = assemble(
        twin.beam,
        twin.damping,
        drive="servo",
        modes=twin.modes,
        step=fine_step(period),
        servo_pole=setting.law.inner_pole,
    )
    estimate = (
        plant.outputs[HUB_ANGLE] - plant.outputs[GAUGE_TORQUE] / setting.model.stiffness
    )
    return plant, sampled(plant, estimate, period, setting.rig.motor_loop.delay_samples)


def mode_gain(setting: Setting, twin: Twin, rival: Rival) -> float:
    """Return the largest |L| around the twin's second mode; 0 without feedback of the
    tip estimate.
    """
    correction, period = _correction(rival), setting.rig.period
    plant, seen = _plant(setting, twin)
    if correction is None or plant.modes.count < 2:
        return 0.0
    mode = float(plant.modes.frequencies[1])
    # With a power law the mode is at ω^(2/λ), 25 % above ω here.
    shifted = (
        mode ** (2.0 / twin.damping.order)
        if isinstance(twin.damping, PowerLaw)
        else mode
    )
    # From below the undamped frequency to above the shifted one: where in between the
    # peak is depends on the material.
    frequency = np.geomspace(
        0.8 * mode, min(1.25 * shifted, 0.999 * np.pi / period), 600
    )
    z = np.exp(1j * frequency * period)
    return float(np.max(np.abs(seen.response(z) * correction.response(z))))


def linear_growth(setting: Setting, twin: Twin, rival: Rival) -> float:
    """Return how fast the rival's linear loop on the twin grows [1/s]; 0 where it is
    stable.

    Friction and the voltage limit are not in it: friction can hide a slow growth, a
    limit can bound a fast one, and a run of some seconds then ends well.
    """
    correction, period = _correction(rival), setting.rig.period
    if correction is None:
        return 0.0
    _, seen = _plant(setting, twin)
    radius = NominalLoop(seen, period, setting.model.stiffness).radius(correction)
    # The power law's slowest relaxation lies within 1e-9 of one.
    return math.log(radius) / period if radius > 1.0 + 1e-9 else 0.0
