"""Logs for the tests of identification: known links, known noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fraclink import Experiment, LinkModel
from fraclink.extend import simulated_torque
from fracsys import s, time_response

PERIOD = 0.004
LATE = 7500  # sample at which `late_cut` begins
TRUTH = LinkModel(stiffness=1.56, natural_frequency=10.02, order=1.92)


def smooth_pulse(time: NDArray[np.float64], rise: float = 0.3) -> NDArray[np.float64]:
    def step(x: NDArray[np.float64]) -> NDArray[np.float64]:
        x = np.clip(x, 0, 1)
        return x**3 * (10 - 15 * x + 6 * x**2)

    return np.asarray(step((time - 1) / rise) - step((time - 8) / rise))


def made_log(
    model: LinkModel = TRUTH,
    *,
    noise: float = 0.0,
    delay: float = 0.0,
    offset: float = 0.0,
    gain: float = 1.0,
    seed: int = 0,
    samples: int = 5001,
    payload: float | None = None,
) -> Experiment:
    """A log simulated with a ten times finer step, so that the motor is not linear
    between two samples.
    """
    fine = smooth_pulse(PERIOD / 10 * np.arange(10 * samples))
    torque = simulated_torque(model, fine, PERIOD / 10, delay=delay, hold="first")[::10]
    output = (
        gain * torque
        + offset
        + np.random.default_rng(seed).normal(0, noise, samples) * (noise > 0)
    )
    return Experiment(
        period=PERIOD, motor_angle=fine[::10], output=output, payload=payload
    )


def late_cut(seed: int) -> Experiment:
    """The last 2 s of 32 s of random moves of a link with ω₀ = 10 rad/s and ζ = 0.02,
    with 1 % of noise.
    """
    levels = np.random.default_rng(seed).uniform(-0.5, 0.5, 81)
    levels[0] = 0.0
    # A servo with 12 ms: smooth enough for linear interpolation between the samples.
    angle = time_response(
        1 / (0.012 * s + 1) ** 2, np.repeat(levels, 100)[: LATE + 500], PERIOD
    ).output
    torque = simulated_torque(
        LinkModel(1.56, 10.0, damping=0.4), angle, PERIOD, hold="first"
    )
    noise = 0.01 * torque.std() * np.random.default_rng(9).standard_normal(torque.size)
    return Experiment(
        PERIOD, angle[LATE:], (torque + noise)[LATE:], earlier_angle=angle[:LATE]
    )
