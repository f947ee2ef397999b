"""Random logs with known truth for bench_gates: links, excitations, delays and noise of
every colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from fraclink import Experiment, LinkModel, prbs
from fraclink.extend import simulated_torque
from identify_logs import smooth_pulse

PERIOD = 0.004
SAMPLES = 5001
FINE = 5  # inner steps per sample: the angle is no straight line between samples
COLOURS = (0.0, 0.9, 0.98)  # ρ of the noise's autoregression; 0 is white


@dataclass(frozen=True)
class RandomLog:
    """A log with the truth that made it."""

    log: Experiment
    model: LinkModel
    delay: float
    colour: float
    noise: float


def coloured(
    random: np.random.Generator, correlation: float, size: int
) -> NDArray[np.float64]:
    """Noise of unit variance, e_k = ρ e_(k−1) + w_k, from its stationary distribution."""
    white = random.normal(0, (1 - correlation**2) ** 0.5, size)
    white[0] = random.normal()
    return np.asarray(lfilter([1.0], [1.0, -correlation], white))


def motion(random: np.random.Generator, samples: int = SAMPLES) -> NDArray[np.float64]:
    """A pulse, a PRBS or a row of steps after the motor loop, on the fine time base."""
    time = PERIOD / FINE * np.arange(samples * FINE)
    kind = random.integers(3)
    if kind == 0:
        return smooth_pulse(time, rise=random.uniform(0.15, 0.4))
    if kind == 1:
        bit = random.uniform(0.15, 0.4)
        path = prbs(0.3, bit, bits=int(time[-1] / bit), register=9, start=0.5).angle(
            time
        )
    else:
        moves = random.uniform(-0.5, 0.5, int(time[-1] / 2.5))
        path = sum(move * (time > 0.5 + 2.5 * k) for k, move in enumerate(moves))
    fade = np.exp(-80.0 * PERIOD / FINE)  # the double pole of the motor loop
    return np.asarray(lfilter([(1 - fade) ** 2], [1, -2 * fade, fade**2], path))


def random_link(random: np.random.Generator, structure: str) -> LinkModel:
    """A visibly damped link of a structure: ζ from 2 to 11 %."""
    frequency = random.uniform(6.0, 22.0)
    if structure == "UD-FOM":
        order = random.uniform(1.86, 1.97)
        return LinkModel(1.56, frequency ** (order / 2), order)
    ratio = random.uniform(0.02, 0.11)
    if structure == "D-IOM":
        return LinkModel(1.56, frequency, damping=2 * ratio * frequency)
    other = random.uniform(0.4, 0.7)
    damping = 2 * ratio * frequency ** (2 - other) / np.sin(other * np.pi / 2)
    square = frequency**2 * (1 - 2 * ratio / np.tan(other * np.pi / 2))
    return LinkModel(1.56, square**0.5, damping=damping, damping_order=other)


def random_log(
    seed: int,
    structure: str,
    *,
    colour: float | None = None,
    noise: float | None = None,
    samples: int = SAMPLES,
) -> RandomLog:
    """A log of a random link; noise as a share of the output's standard deviation, 1 to
    30 % by default.
    """
    random = np.random.default_rng([seed, 14])
    model = random_link(random, structure)
    fine = motion(random, samples)
    delay = random.uniform(0.0, 0.012)
    torque = simulated_torque(model, fine, PERIOD / FINE, delay=delay, hold="first")[
        ::FINE
    ]
    correlation = COLOURS[seed % len(COLOURS)] if colour is None else colour
    share = 0.01 * 30.0 ** random.uniform() if noise is None else noise
    output = torque + share * torque.std() * coloured(random, correlation, samples)
    log = Experiment(period=PERIOD, motor_angle=fine[::FINE], output=output)
    return RandomLog(log, model, delay, correlation, share)


def cut_log(seed: int) -> RandomLog:
    """The last 0.8 to 2 s of 16 to 40 s of moves: a lightly damped link still swings
    from motion long before, and the log holds some four vibrations. Ratios from 0.3 to
    5 %, noise from 1 to 5 %.
    """
    random = np.random.default_rng([seed, 37])
    frequency, ratio = random.uniform(6.0, 22.0), 0.003 * 17.0 ** random.uniform()
    if seed % 2:
        model = LinkModel(1.56, frequency, damping=2 * ratio * frequency)
    else:
        order = np.pi / np.arccos(-ratio)
        model = LinkModel(1.56, frequency ** (order / 2), order)
    samples = round(random.uniform(16.0, 40.0) / PERIOD)
    late = samples - round(random.uniform(0.8, 2.0) / PERIOD)
    levels = np.repeat(random.uniform(-0.5, 0.5, samples // 100 + 1), 100)[:samples]
    levels[:100] = 0.0
    fade = np.exp(-PERIOD / 0.012)  # the double pole of a servo, 12 ms
    angle = np.asarray(lfilter([(1 - fade) ** 2], [1, -2 * fade, fade**2], levels))
    delay, share = random.uniform(0.0, 0.012), 0.01 * 5.0 ** random.uniform()
    torque = simulated_torque(model, angle, PERIOD, delay=delay, hold="first")
    output = torque + share * torque[late:].std() * random.normal(size=samples)
    log = Experiment(
        PERIOD, angle[late:], output[late:], earlier_angle=np.asarray(angle[:late])
    )
    return RandomLog(log, model, delay, 0.0, share)
