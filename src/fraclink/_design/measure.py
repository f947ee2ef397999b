"""What a loop achieves over a range of payloads: crossover, margins, sensitivity peak, noise gain."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._design.loop import OpenLoop

__all__ = ["Measured", "measure", "noise_gain", "noise_points", "sensitivity_peak"]

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """One value for each ω₀: upper gain crossover [rad/s], phase margin [rad] (negative where the loop is
    unstable), sensitivity peak Ms = max 1/|1 + L|, and noise gain.
    """

    natural_frequency: Real
    gain_crossover: Real
    phase_margin: Real
    sensitivity_peak: Real
    noise_gain: Real


def measure(loop: OpenLoop, natural_frequency: Real, period: float, *, highest: float) -> Measured:
    """Return what `loop` achieves at each ω₀; noise is white up to the Nyquist frequency of `period` [s]."""
    pi = np.atleast_1d(np.asarray(natural_frequency, dtype=float))
    crossover, margin = sweep(loop, pi, highest)
    peak = sensitivity_peak(loop, pi, highest)
    return Measured(pi, crossover, margin, np.where(margin > 0, peak, math.inf), noise_gain(loop, pi, period))


def sweep(loop: OpenLoop, pi: Real, highest: float) -> tuple[Real, Real]:
    """(upper gain crossover, signed worst phase margin) for each ω₀; no crossing at all counts as π."""
    found = loop.crossings(pi, highest=highest)
    crossover, margin = np.zeros(pi.size), np.full(pi.size, math.pi)
    np.maximum.at(crossover, found.row, found.frequency)
    np.minimum.at(margin, found.row, np.abs(found.phase_margin))
    turns = np.floor((found.phase + math.pi) / (2.0 * math.pi))
    circled = np.zeros(pi.size)
    np.add.at(circled, found.row, np.where(found.slope > 0.0, turns, -turns))
    return crossover, np.where(circled == 0.0, margin, -margin)


def sensitivity_peak(loop: OpenLoop, pi: Real, highest: float) -> Real:
    """Ms = 1/min|1 + L| for each ω₀: a scan over two decades about the mode, closed in on twice."""
    mode = loop.peak(pi)[:, None]
    w = np.minimum(mode * np.geomspace(0.2, 30.0, 240), highest)
    for _ in range(3):
        distance = np.abs(1.0 + loop(w, pi[:, None]))
        best = np.argmin(distance, axis=1)
        rows = np.arange(pi.size)
        low, high = w[rows, np.maximum(best - 1, 0)], w[rows, np.minimum(best + 1, w.shape[1] - 1)]
        w = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, 33)
    return np.asarray(1.0 / np.min(distance, axis=1))


def noise_gain(loop: OpenLoop, pi: Real, period: float) -> Real:
    """RMS of the motor reference over that of white gauge noise, ``(∫₀^{ωN} |Ĉ/(1+L)|² dω / ωN)^½`` (30).

    Both as angles: the gauge's torque noise divided by the stiffness.
    """
    found = []
    for value in np.atleast_1d(pi):
        w, weights = noise_points(loop, float(value), period)
        outer = np.exp(loop.outer_log(w).real)
        found.append(np.sqrt(np.sum((outer / np.abs(1.0 + loop(w, value))) ** 2 * weights)))
    return np.asarray(found, dtype=float)


def noise_points(loop: OpenLoop, natural_frequency: float, period: float) -> tuple[Real, Real]:
    """Frequencies and weights of the mean over [0, π/Ts] in `noise_gain`.

    Six Gauss points on panels that shrink towards the mode, where |1 + L| changes fastest.
    """
    nyquist = math.pi / period
    mode = float(loop.peak(natural_frequency))
    inner = mode * np.geomspace(0.25, 8.0, 26)
    edges = np.concatenate([[0.0], inner[inner < nyquist], [nyquist]])
    points, weights = np.polynomial.legendre.leggauss(6)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (1.0 + points)).ravel(), (half * weights).ravel() / nyquist
