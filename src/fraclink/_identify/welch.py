"""Welch's method: transforms of half-overlapping segments, applied to a log and its
fit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fraclink._arm.experiment import Experiment
from fraclink._identify.fit import Fit
from fracsys.checks import Complex, Real

# The average over this many lengths of half-overlapping segments has a standard error
# of a quarter: enough to see at which frequencies a model is wrong, and a coherence of
# 0.3 is not accidental.
_SEGMENTS = 8
# Fraction of the largest power of the motion: the leakage of the Hann window is smaller,
# and a frequency with less motion says nothing about the link.
EXCITED = 1e-4


def segments(signals: Sequence[Real], period: float) -> tuple[Real, list[Complex]]:
    """Frequencies above zero [rad/s], and the transforms of every segment of each
    signal: half-overlapping, without mean, with a Hann window.
    """
    size = max(2 * (signals[0].size // (_SEGMENTS + 1)), 4)
    transforms = []
    for signal in signals:
        rows = sliding_window_view(signal, size)[:: size // 2]
        rows = (rows - rows.mean(axis=1, keepdims=True)) * np.hanning(size)
        transforms.append(np.fft.rfft(rows)[:, 1:])
    frequency = math.tau * np.fft.rfftfreq(size, period)[1:]
    return np.asarray(frequency), transforms


def mean_power(transforms: Complex) -> Real:
    """Mean power of the segments at each frequency."""
    return np.mean(np.abs(transforms) ** 2, axis=0)


# Frequencies without motion are left out.
@np.errstate(divide="ignore", invalid="ignore")
def welch_response(log: Experiment, fit: Fit) -> tuple[Real, Complex, Complex, Real]:
    """Frequency [rad/s], the averaged responses (Welch) of measurement and prediction to
    the motor's angle, and the coherence; shape (N,).

        H = P_yu / P_uu,    γ² = |P_yu|² / (P_uu P_yy)

    Both use the same windows, which affect a sharp resonance in the same way.
    Frequencies at which the motor moved less than a hundredth of the largest amplitude
    are left out.

    >>> from fraclink._identify import identify
    >>> from fraclink._reading.reading import bundled_log, read_log
    >>> log = read_log(bundled_log("prbs_30g"))
    >>> frequency, measured, _, coherence = welch_response(log, identify(log, details=False))
    >>> told = coherence > 0.9  # elsewhere the noise has the peaks
    >>> round(float(frequency[told][np.argmax(np.abs(measured[told]))]))
    16
    """
    frequency, (u, y, model) = segments(
        (log.motor_angle, log.output, fit.predicted), log.period
    )
    power = mean_power(u)
    usable = power > EXCITED * power.max()
    cross, other = (np.mean(x * u.conj(), axis=0) for x in (y, model))
    product = np.maximum(power * mean_power(y), 1e-300)
    return (
        frequency[usable],
        (cross / power)[usable],
        (other / power)[usable],
        np.minimum(np.abs(cross) ** 2 / product, 1.0)[usable],
    )
