"""Logs for bench_identify: simulated ones with known truth, and the recorded ones next
to the repository.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fraclink import Experiment, LinkModel
from fraclink.extend import simulated_torque

PERIOD = 0.004
SAMPLES = 5000
NOISE = 0.0052**0.5  # the paper's MSE, all of it as white noise
TRUTH = LinkModel(stiffness=1.56, natural_frequency=10.02, order=1.92)
FINE = 10  # inner steps: the motor angle is not a straight line between two samples


def smooth_pulse(time: NDArray[np.float64], rise: float = 0.3) -> NDArray[np.float64]:
    """The paper's pulse, 1 rad for 7 s, with minimum-jerk flanks of `rise` seconds."""

    def step(x: NDArray[np.float64]) -> NDArray[np.float64]:
        x = np.clip(x, 0, 1)
        return x**3 * (10 - 15 * x + 6 * x**2)

    return np.asarray(step((time - 1) / rise) - step((time - 8) / rise))


def clean_log(
    model: LinkModel = TRUTH,
    *,
    delay: float = 0.0,
    samples: int = SAMPLES,
    rise: float = 0.3,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Motor angle and torque without noise, simulated on a ten times finer base."""
    fine = smooth_pulse(PERIOD / FINE * np.arange(samples * FINE), rise)
    torque = simulated_torque(model, fine, PERIOD / FINE, delay=delay, hold="first")
    return fine[::FINE], torque[::FINE]


def noisy_log(seed: int, noise: float = NOISE, **options: object) -> Experiment:
    """An experiment from `clean_log` with white noise on the torque."""
    angle, torque = clean_log(**options)  # type: ignore[arg-type]
    noisy = torque + np.random.default_rng(seed).normal(0, noise, torque.size)
    return Experiment(period=PERIOD, motor_angle=angle, output=noisy)


def recorded(*parts: str) -> Path | None:
    """A recorded file; None if it does not exist."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    path = Path(os.environ.get("FRACLINK_SHARED", str(default))).joinpath(*parts)
    return path if path.exists() else None


def merced() -> Experiment | None:
    """UC Merced's rotary link; the deflection's column is θt − θm."""
    path = recorded("quanser_rfl_merced", "merced_rfl.csv")
    if path is None:
        return None
    data = np.genfromtxt(path, delimiter=",", names=True)
    return Experiment(
        period=0.002,
        motor_angle=np.deg2rad(data["theta_deg"]),
        output=-np.deg2rad(data["alpha_deg"]),
        output_kind="deflection",
        source=path.name,
    )


def ist(name: str) -> Experiment | None:
    """IST Lisbon's bar, calibrated as its README says; the deflection is its α with
    the sign reversed.
    """
    path = recorded("ist_flexbar", f"2_lab_{name}.csv")
    if path is None:
        return None
    data = np.genfromtxt(path, delimiter=",", names=True)
    return Experiment(
        period=0.001,
        motor_angle=np.deg2rad(36.79 * data["pot_V"]),
        output=np.deg2rad(1.301 * data["strain_V"]),
        output_kind="deflection",
        source=path.name,
    )
