"""Welch's method: averages over the transforms of half-overlapping segments."""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fracsys.checks import Complex, Real

# Half-overlapping segments in an average: at a coherence of a half the response has a
# standard error of a quarter, and only one in ten coherences of unrelated signals
# exceeds 0.3.
_SEGMENTS = 8
# Least share of the largest power of the input: the leakage of the Hann window is
# smaller, and a frequency with less motion says nothing about the link.
EXCITED = 1e-4


def segments(signal: Real, period: float) -> tuple[Real, Complex]:
    """Frequencies above zero [rad/s], shape (K,), and the transforms (segments, K) of
    half-overlapping segments of a signal, each without its mean, in a Hann window.
    """
    size = max(2 * (signal.size // (_SEGMENTS + 1)), 4)
    rows = sliding_window_view(signal, size)[:: size // 2]
    rows = (rows - rows.mean(axis=1, keepdims=True)) * np.hanning(size)
    frequency = math.tau * np.fft.rfftfreq(size, period)[1:]
    return np.asarray(frequency), np.fft.rfft(rows)[:, 1:]


# An output without power has no coherence.
@np.errstate(invalid="ignore")
def averaged_response(
    source: Real, output: Real, period: float
) -> tuple[Real, Complex, Real]:
    """Frequency [rad/s], response of the output to the source, and coherence, shape
    (K,), where the source has at least a hundredth of its largest amplitude.

        H = P_yu / P_uu,    γ² = |P_yu|² / (P_uu P_yy)

    >>> import numpy as np
    >>> noise = np.random.default_rng(1).normal(size=4000)
    >>> frequency, response, coherence = averaged_response(noise, 2 * noise, 0.01)
    >>> bool(np.allclose(response, 2)), bool(np.allclose(coherence, 1))
    (True, True)
    """
    frequency, u = segments(source, period)
    y = segments(output, period)[1]
    power, response_power = (np.mean(np.abs(x) ** 2, axis=0) for x in (u, y))
    cross = np.mean(y * u.conj(), axis=0)
    excited = power > EXCITED * power.max()
    frequency, power, cross = frequency[excited], power[excited], cross[excited]
    coherence = np.abs(cross) ** 2 / (power * response_power[excited])
    return frequency, cross / power, np.minimum(coherence, 1.0)
