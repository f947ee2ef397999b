"""Logs made for tests: one mode with viscous damping, with faults inserted on purpose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fraclink import Experiment

Array = NDArray[np.float64]


def made_motion(count: int = 2000, period: float = 0.004) -> tuple[Array, Array]:
    """Time and a motor angle: rest, then smooth moves between levels drawn from a fixed
    seed.
    """
    time: NDArray[np.float64] = period * np.arange(count, dtype=np.float64)
    levels = np.random.default_rng(4).uniform(-0.5, 0.5, 1 + count // 125)
    levels[0] = 0.0
    angle = np.repeat(levels, 125)[:count]
    motor: NDArray[np.float64] = np.zeros(count)
    state = np.zeros(2)
    for k in range(count):  # two poles at 60 rad/s: a servo that follows the levels
        motor[k] = state[1]
        state = state + period * 60 * np.array(
            [angle[k] - state[0], state[0] - state[1]]
        )
    return time, motor


def made_output(
    motor: Array,
    period: float = 0.004,
    *,
    stiffness: float = 1.5,
    frequency: float = 10.0,
    damping: float = 0.05,
) -> Array:
    """Base torque c s²/(s² + 2ζωs + ω²) for a held motor angle, exact at the samples."""
    from scipy.linalg import expm

    block = np.zeros((3, 3))
    block[0, 1], block[1] = 1.0, (-(frequency**2), -2 * damping * frequency, 1.0)
    step = expm(block * period)
    state, output = np.zeros(2), np.zeros(motor.size)
    for k, angle in enumerate(motor):
        output[k] = stiffness * (
            angle - frequency**2 * state[0] - 2 * damping * frequency * state[1]
        )
        state = step[:2, :2] @ state + step[:2, 2] * angle
    return output


def made_experiment(
    count: int = 2000, period: float = 0.004, *, noise: float = 0.005
) -> Experiment:
    """A good log as an Experiment."""
    _, motor = made_motion(count, period)
    output = made_output(motor, period) + np.random.default_rng(5).normal(
        0, noise, count
    )
    return Experiment(period=period, motor_angle=motor, output=output, payload=0.03)


def made_rows(count: int = 400) -> list[list[str]]:
    """Rows of a good log as text cells: time_s, motor_angle_rad, torque_Nm."""
    time, motor = made_motion(count)
    output = made_output(motor)
    return [
        [f"{t:.3f}", f"{m:.6g}", f"{o:.6g}"]
        for t, m, o in zip(time, motor, output, strict=True)
    ]


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


def example_motor_log(
    *,
    gain: float = 3056.77,
    decay: float = 15.153,
    coulomb_voltage: float = 0.02,
    dead_zone: float = 0.0,
    delay: float = 0.0,
    period: float = 0.004,
    samples: int = 4000,
    counts: int = 20000,
    seed: int = 1,
) -> tuple[Array, Array]:
    """Voltage [V] and encoder angle [rad] of θ'' = A z(V) − B θ' − C sign θ'.

    Between two changes of the voltage and of the velocity's sign the equation is linear
    with constant inputs, so that each piece is solved exactly; a piece ends where the
    velocity crosses zero.

    >>> voltage, angle = example_motor_log(samples=500)
    >>> voltage.shape, bool(np.ptp(angle) > 0.1)
    ((500,), True)
    """
    generator = np.random.default_rng(seed)
    levels = generator.uniform(-0.3, 0.3, samples // 50 + 2)
    voltage = np.repeat(levels, 50)[:samples]
    fine = 40
    inner = period / fine
    late = round(delay / inner)
    angle, speed = 0.0, 0.0
    recorded = np.empty(samples)
    fade = np.exp(-decay * inner)
    for k in range(samples * fine):
        if k % fine == 0:
            recorded[k // fine] = angle
        asked = voltage[max(k - late, 0) // fine]
        push = gain * float(np.sign(asked)) * max(abs(asked) - dead_zone, 0.0)
        direction = np.sign(speed) if speed else np.sign(push)
        friction = gain * coulomb_voltage * float(direction)
        final = (push - friction) / decay if speed or abs(push) > abs(friction) else 0.0
        moved = final + (speed - final) * fade
        # it stops within the step: friction changes sign in the next one
        if speed * moved < 0:
            angle += 0.5 * inner * speed
            speed = 0.0
            continue
        angle += final * inner + (speed - final) * (1 - fade) / decay
        speed = moved
    step = 2 * np.pi / counts
    return voltage, np.round(recorded / step) * step
