"""Exact held responses of c·s^(-a): the response of s^(-a) to a step is t^a/Γ(1+a)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["convolve", "jump_response", "power_response", "power_weights"]

Reals = NDArray[np.float64]
Powers = Sequence[tuple[float, float]]


def power_response(powers: Powers, times: Reals, degree: int) -> Reals:
    """Sum of c t^(a+n-1)/Γ(a+n), n = `degree`: impulse (0), step (1) or ramp (2) response at times ≥ 0."""
    total = np.zeros(len(times))
    for factor, order in powers:
        exponent = order + degree - 1
        with np.errstate(divide="ignore"):
            total += factor * np.exp(exponent * np.log(times) - math.lgamma(exponent + 1.0))
    return total


def power_weights(powers: Powers, period: float, ahead: float, count: int, hold: str) -> Reals:
    """Weights of the held response at lags 0 … count-1, sampled `ahead` [s] after the input's samples.

    Differences of t^b are taken without cancellation: by expm1 (step) or by the binomial series (ramp).
    """
    total = np.zeros(count)
    steps = np.arange(count, dtype=np.float64) + ahead / period  # time in periods
    for factor, order in powers:
        scale = factor * math.exp(order * math.log(period) - math.lgamma(order + 1.0))
        if hold == "zero":
            total += scale * _first_difference(steps, order)
        else:
            total += scale / (order + 1.0) * _second_difference(steps, order + 1.0)
    return total


def jump_response(powers: Powers, period: float, times: Reals) -> Reals:
    """Response to a unit jump at 0 minus that to a straight rise from -T to 0, at `times` ≥ 0."""
    rise = power_response(powers, times + period, 2) - power_response(powers, times, 2)
    return power_response(powers, times, 1) - rise / period


def convolve(weights: Reals, u: Reals) -> Reals:
    """First len(u) samples of the convolution, by FFT."""
    size = 1 << max(2 * len(u) - 1, 1).bit_length()
    spectrum = np.fft.rfft(weights, size) * np.fft.rfft(u, size)
    result: Reals = np.fft.irfft(spectrum, size)[: len(u)]
    return result


def _first_difference(t: Reals, power: float) -> Reals:
    """t^b - (t-1)^b for t ≥ 1, t^b before."""
    result = t**power
    later = t > 1.0
    result[later] *= -np.expm1(power * np.log1p(-1.0 / t[later]))
    return result


def _second_difference(t: Reals, power: float) -> Reals:
    """(t+1)^b - 2 t^b + (t-1)^b, the last term only for t ≥ 1."""
    result = (t + 1.0) ** power - 2.0 * t**power + np.where(t > 1.0, np.abs(t - 1.0) ** power, 0.0)
    far = t > 20.0  # 10 terms of 1/400^k: 1e-26
    inverse = 1.0 / t[far] ** 2
    term, total = np.ones(inverse.shape), np.zeros(inverse.shape)
    for k in range(1, 11):
        term = term * inverse * (power - 2 * k + 2) * (power - 2 * k + 1) / ((2 * k - 1) * (2 * k))
        total += 2.0 * term
    result[far] = t[far] ** power * total
    return result
