"""Logs for the tests of identification: known links, known noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._identify import simulated_torque

PERIOD = 0.004
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
    """A log simulated on a ten times finer base, so that the motor is not linear between two samples."""
    fine = smooth_pulse(PERIOD / 10 * np.arange(10 * samples))
    torque = simulated_torque(model, fine, PERIOD / 10, delay=delay, hold="first")[::10]
    output = gain * torque + offset + np.random.default_rng(seed).normal(0, noise, samples) * (noise > 0)
    return Experiment(period=PERIOD, motor_angle=fine[::10], output=output, payload=payload)
