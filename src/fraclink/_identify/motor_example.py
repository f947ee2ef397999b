"""A simulated motor log for examples and tests: the paper's motor with friction, no link on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["example_motor_log"]


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
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Voltage [V] and encoder angle [rad] of θ'' = A z(V) − B θ' − C sign θ'.

    Between two changes of the voltage and of the velocity's sign the equation is linear with constant
    inputs, so that each piece is solved exactly; a piece ends where the velocity crosses zero.

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
        if speed * moved < 0:  # it stops within the step: friction turns round at the next one
            angle += 0.5 * inner * speed
            speed = 0.0
            continue
        angle += final * inner + (speed - final) * (1 - fade) / decay
        speed = moved
    step = 2 * np.pi / counts
    return voltage, np.round(recorded / step) * step
