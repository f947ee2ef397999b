"""What a log says of its model over frequency: the response with its error, the residual's spectrum."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from fraclink._arm.experiment import Experiment
from fraclink._identify import Fit

__all__ = ["Estimate", "residual_density", "response_estimate"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_PARTS = 8  # parts of a log that Welch's mean is taken over: a third of the noise, and lines near enough
_LEAST = 64  # samples of a part: fewer lines show no resonance
_EXCITED = 1e-4  # of the largest line of the input's density: below, the ratio is noise
_FEW = 4  # lines that make no curve


@dataclass(frozen=True)
class Estimate:
    """Responses from motor angle to output at `frequency` [rad/s], of the log and of its model.

    error: relative to the model's, what noise of the residual's size stays below with 95 %; explained: share
    of the output's power that the model explains.
    """

    frequency: Real
    measured: Complex
    model: Complex
    error: Real
    explained: Real


def _parts(samples: int) -> int:
    """Length of a part: a power of two, half overlapped, `_PARTS` of them or some more."""
    length = 2 * samples // (_PARTS + 1)
    return 0 if length < _LEAST else 1 << (length.bit_length() - 1)


def _spectra(length: int, *signals: Real) -> list[Complex]:
    """Lines of the half overlapped parts of signals under a Hann window, shape (parts, lines)."""
    window = np.hanning(length + 1)[:-1]
    starts = range(0, len(signals[0]) - length + 1, length // 2)
    lines = []
    for signal in signals:
        parts = np.stack([signal[k : k + length] for k in starts])
        lines.append(np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window)[:, 1:-1])
    return lines


def response_estimate(log: Experiment, fit: Fit) -> Estimate | None:
    """Estimate the responses of log and model by Welch's means; None where the log is too short for them.

    Both are seen through the same windows, which flatten a sharp resonance alike. Their difference is that
    of the residual, S_ur/S_uu, whose noise is complex normal of variance S_rr/(n S_uu): with 95 % it is below
    sqrt(−ln 0.05) of its root.
    """
    length = _parts(len(log.time))
    if not length:
        return None
    u, y, rest = _spectra(length, log.motor_angle, log.output, fit.residual)
    uu, yy, rr = (np.mean(np.abs(lines) ** 2, axis=0) for lines in (u, y, rest))
    good = uu > _EXCITED * uu.max()
    frequency = 2 * math.pi * np.arange(1, u.shape[1] + 1) / (length * log.period)
    with np.errstate(divide="ignore", invalid="ignore"):
        measured = np.mean(np.conj(u) * y, axis=0) / uu
        model = measured - np.mean(np.conj(u) * rest, axis=0) / uu
        error = math.sqrt(-math.log(0.05)) * np.sqrt(rr / (_independent(u) * uu)) / np.abs(model)
        good &= error < 1.0
        explained = np.clip(1 - rr / yy, 0.0, 1.0)
    if np.count_nonzero(good) < _FEW:
        return None
    return Estimate(frequency[good], measured[good], model[good], error[good], explained[good])


def _independent(lines: Complex) -> float:
    """How many independent parts half overlapped ones under a Hann window count for: some 60 %."""
    return max(1.0, 0.6 * float(lines.shape[0]))


def residual_density(fit: Fit) -> tuple[Real, Real, float, float] | None:
    """Frequency [rad/s], the residual's density over that of white noise, and its 99 % band.

    A Welch mean of n independent parts is χ² with 2 n degrees of freedom; the band holds every single line
    of white noise with 99 %. None where the log is too short.
    """
    residual = np.asarray(fit.residual[: fit.fitted_samples])
    length = _parts(residual.size)
    if not length or not float(np.ptp(residual)) > 0.0:
        return None
    (lines,) = _spectra(length, residual)
    density = np.mean(np.abs(lines) ** 2, axis=0)
    white = float(np.var(residual)) * float(np.sum(np.hanning(length + 1) ** 2))
    freedom = 2 * _independent(lines)
    frequency = 2 * math.pi * np.arange(1, lines.shape[1] + 1) / (length * fit.period)
    low, high = (float(gammaincinv(0.5 * freedom, p) / (0.5 * freedom)) for p in (0.005, 0.995))
    return frequency, density / white, low, high
