"""A frequency response from whole periods of a periodic excitation."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from fraclink._arm.recording import FrequencyResponse
from fraclink.errors import LogError
from fracsys.checks import Array, Between, Fraction, Real, checked

__all__ = ["frequency_response"]

Signal = Annotated[Real, Array(1)]


@checked
def frequency_response(
    signal: Signal,
    output: Signal,
    *,
    period: Annotated[float, Between(0.0, 1e6, "s", low_open=True)] = 1.0,
    threshold: Fraction = 0.05,
) -> FrequencyResponse:
    """Frequency response from whole periods of a periodic excitation.

    Parameters
    ----------
    signal, output
        shape (N,), one or more whole periods.
    period
        sampling period [s]; 1 where it is unknown: frequencies are then in radians per
        sample.
    threshold
        lines whose input is below this share of the largest are left out [1]: their ratio is mostly noise.

    Raises
    ------
    LogError
        lengths that differ.

    Examples
    --------
    >>> wave = np.cos(2 * np.pi * np.arange(64) / 16)
    >>> found = frequency_response(wave, 2 * wave)
    >>> found.response.real.round(6).tolist(), (found.frequency / 2 / np.pi).tolist()
    ([2.0], [0.0625])
    """
    u, y = np.asarray(signal), np.asarray(output)
    # Sixteen samples give eight lines, of which one mode needs six.
    if u.shape != y.shape or u.size < 16:
        raise LogError(
            "output",
            str(y.shape),
            f"not as long as the input {u.shape}",
            allowed=">= 16 samples of each",
            remedy="cut both to the same whole periods",
        )
    # Without the constant: an offset of the gauge is not a response.
    into, out = np.fft.rfft(u)[1:], np.fft.rfft(y)[1:]
    lines = np.abs(into) >= threshold * np.max(np.abs(into))
    frequency = 2 * np.pi * np.arange(1, into.size + 1) / (u.size * period)
    return FrequencyResponse(
        frequency[lines], out[lines] / into[lines], np.abs(into[lines])
    )
