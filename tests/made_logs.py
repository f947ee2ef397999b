"""Logs made for tests: one mode with viscous damping, its faults put in on purpose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment

Array = NDArray[np.float64]


def made_motion(count: int = 2000, period: float = 0.004) -> tuple[Array, Array]:
    """Time and a motor angle: rest, then smooth moves between levels drawn from a fixed seed."""
    time = period * np.arange(count)
    levels = np.random.default_rng(4).uniform(-0.5, 0.5, 1 + count // 125)
    levels[0] = 0.0
    angle = np.repeat(levels, 125)[:count]
    motor, state = np.zeros(count), np.zeros(2)
    for k in range(count):  # two poles at 60 rad/s: a servo that follows the levels
        motor[k] = state[1]
        state = state + period * 60 * np.array([angle[k] - state[0], state[0] - state[1]])
    return time, motor


def made_output(
    motor: Array,
    period: float = 0.004,
    *,
    stiffness: float = 1.5,
    frequency: float = 10.0,
    damping: float = 0.05,
) -> Array:
    """Base torque c s²/(s² + 2ζωs + ω²) of a held motor angle, exactly at the samples."""
    from scipy.linalg import expm

    block = np.zeros((3, 3))
    block[0, 1], block[1] = 1.0, (-(frequency**2), -2 * damping * frequency, 1.0)
    step = expm(block * period)
    state, output = np.zeros(2), np.zeros(motor.size)
    for k, angle in enumerate(motor):
        output[k] = stiffness * (angle - frequency**2 * state[0] - 2 * damping * frequency * state[1])
        state = step[:2, :2] @ state + step[:2, 2] * angle
    return output


def made_experiment(count: int = 2000, period: float = 0.004, *, noise: float = 0.005) -> Experiment:
    """A good log as an Experiment."""
    _, motor = made_motion(count, period)
    output = made_output(motor, period) + np.random.default_rng(5).normal(0, noise, count)
    return Experiment(period=period, motor_angle=motor, output=output, payload=0.03)


def made_rows(count: int = 400) -> list[list[str]]:
    """Rows of a good log as text cells: time_s, motor_angle_rad, torque_Nm."""
    time, motor = made_motion(count)
    output = made_output(motor)
    return [[f"{t:.3f}", f"{m:.6g}", f"{o:.6g}"] for t, m, o in zip(time, motor, output, strict=True)]


HEADER = ["time_s", "motor_angle_rad", "torque_Nm"]


def write_log(
    path: Path,
    rows: list[list[str]],
    *,
    header: list[str] | None = HEADER,
    separator: str = ",",
    before: str = "",
) -> Path:
    """Write a text log."""
    lines = [separator.join(cells) for cells in ([header] if header else []) + rows]
    path.write_bytes((before + "\n".join(lines) + "\n").encode())
    return path
