"""One vibration mode found in a log without a guess: what the sign, delay and excitation checks stand on.

The output of the link is the motor angle through a high-pass of second order,

    Γ/θm = c s²/(s² + 2ζω s + ω²)·e^(−τs).

For a grid of ω and ζ the cross-correlation of the output with that response is taken at all lags at once
by FFT; its largest value gives gain, sign and delay together, and its share of the output's energy says
how well one mode explains the log. It is a diagnosis, not an identification: 2 % of ω is all it needs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Mode", "find_mode"]

_LONGEST = 16_384  # samples looked at: a quarter of a minute at 1 kHz, a minute at 250 Hz
_DAMPINGS = (0.01, 0.04, 0.15)
_GRID = 72  # frequencies: 8 % apart over two and a half decades; the widest ζ covers the gaps
_LATEST = 0.15  # of the mode's period: a later answer could as well be one of the other sign


@dataclass(frozen=True)
class Mode:
    """The mode that explains the output best.

    Arguments:
        frequency: ω [rad/s]; damping_ratio: ζ on a coarse grid.
        gain: c, in units of the output for one radian; negative where the output follows with the wrong sign.
        delay: τ of the output [s], >= 0.
        share: of the output's energy that this mode explains, 0 to 1.
        residual: standard deviation of what is left, in units of the output.
    """

    frequency: float
    damping_ratio: float
    gain: float
    delay: float
    share: float
    residual: float


def find_mode(angle: NDArray[np.float64], output: NDArray[np.float64], period: float) -> Mode | None:
    """The best mode from `angle` to `output`, both shape (N,); None where the log is too short for one."""
    angle, output = angle[:_LONGEST] - angle[0], output[:_LONGEST] - np.mean(output[:_LONGEST])
    count = angle.size
    lowest, highest = 2 * math.pi * 2 / (count * period), 0.6 * math.pi / period
    if lowest * 4 > highest or not np.ptp(angle) or not np.ptp(output):
        return None
    spectra = _Spectra.of(angle, output, period)
    best = max(
        (spectra.fit(w, z) for w in np.geomspace(lowest, highest, _GRID).tolist() for z in _DAMPINGS),
        key=lambda mode: mode.share,
    )
    step = (highest / lowest) ** (1 / (_GRID - 1))
    for _ in range(5):  # from 8 % to 0.3 % of ω
        step = math.sqrt(step)
        near = (best.frequency / step, best.frequency * step)
        trials = [spectra.fit(w, z) for w in near for z in {best.damping_ratio, best.damping_ratio / 2}]
        best = max([best, *trials], key=lambda mode: mode.share)
    return best


@dataclass(frozen=True)
class _Spectra:
    """The spectra of both signals, padded to twice their length so that correlations do not wrap around."""

    count: int
    period: float
    frequencies: NDArray[np.float64]
    angle: NDArray[np.complex128]
    output: NDArray[np.complex128]
    energy: float

    @staticmethod
    def of(angle: NDArray[np.float64], output: NDArray[np.float64], period: float) -> _Spectra:
        count = angle.size
        size = 1 << (2 * count - 1).bit_length()
        held = np.concatenate((angle, np.full(size - count, angle[-1])))
        # Beyond its end the angle returns to zero by a ramp: a jump would ring through the whole window.
        held[count:] *= np.linspace(1, 0, size - count)
        return _Spectra(
            count,
            period,
            np.asarray(2 * np.pi * np.fft.rfftfreq(size, period), dtype=np.float64),
            np.fft.rfft(held),
            np.fft.rfft(output, size),
            float(output @ output),
        )

    def fit(self, frequency: float, damping: float) -> Mode:
        """Gain and delay of the mode of `frequency` and `damping` that explain most of the output."""
        jw = 1j * self.frequencies
        response = np.fft.irfft(
            self.angle * (jw**2 / (jw**2 + 2 * damping * frequency * jw + frequency**2)), 2 * (jw.size - 1)
        )[: self.count]
        response -= response.mean()
        spectrum = np.fft.rfft(response, 2 * (jw.size - 1))
        lags = 1 + min(self.count // 4, int(_LATEST * 2 * np.pi / (frequency * self.period)))
        correlation = np.fft.irfft(np.conj(spectrum) * self.output)[:lags]
        lag = int(np.argmax(np.abs(correlation)))
        power = float(response @ response) or math.inf
        share = min(1.0, float(correlation[lag]) ** 2 / (power * self.energy))
        residual = math.sqrt(max(0.0, 1 - share) * self.energy / self.count)
        delay = (lag + _crest(correlation, lag)) * self.period
        return Mode(frequency, damping, float(correlation[lag]) / power, delay, share, residual)


def _crest(values: NDArray[np.float64], place: int) -> float:
    """Where between the samples the extreme value at `place` lies, by a parabola: −0.5 to 0.5."""
    if not 0 < place < values.size - 1:
        return 0.0
    before, here, after = values[place - 1 : place + 2].tolist()
    bend = before - 2 * here + after
    return 0.5 * (before - after) / bend if bend else 0.0
