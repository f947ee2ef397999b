"""One vibration mode found in a log without a guess: what the sign, delay and excitation checks stand on.

The output of the link is the motor angle through a high-pass of second order,

    Γ/θm = c s²/(s² + 2ζω s + ω²)·e^(−τs).

For a grid of ω and ζ the cross-correlation of the output with that response is taken at all lags at once
by FFT; its largest value gives gain, sign and delay together, and its share of the output's energy says
how well one mode explains the log. It is a diagnosis, not an identification: a percent of ω is enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_LONGEST = 8_192  # samples looked at: 8 s at 1 kHz, half a minute at 250 Hz
_DAMPINGS = (0.01, 0.04, 0.15)
_ROUNDS = 16  # of the search around the best point of the grid, which ends within 0.3 % of ω
_MOST_DAMPED = 0.5
_TINY = 1e-60
_GRID = 72  # frequencies: 8 % apart over two and a half decades; the widest ζ covers the gaps
_LATEST = 0.15  # of the mode's period: a later answer could as well be one of the other sign


@dataclass(frozen=True)
class Mode:
    """The mode that explains the output best.

    Parameters
    ----------
    frequency, damping_ratio
        ω [rad/s] and ζ [1].
    gain
        c, in units of the output for one radian; negative where the output follows with the wrong sign.
    delay
        τ of the output [s], >= 0.
    share
        of the output's energy that this mode explains, 0 to 1.
    residual
        standard deviation of what is left, in units of the output.
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
    if not all(_TINY < np.abs(values).max() < 1 / _TINY for values in (angle, output)):
        return None  # their squares underflow or overflow: no angle and no torque
    spectra = _Spectra.of(angle, output, period)
    grid = [(w, z) for w in np.geomspace(lowest, highest, _GRID).tolist() for z in _DAMPINGS]
    grid.sort(key=lambda point: -spectra.rough_share(*point))
    best = max((spectra.fit(w, z) for w, z in grid[:3]), key=lambda mode: mode.share)
    step, factor = (highest / lowest) ** (1 / (_GRID - 1)), 2.0
    for _ in range(_ROUNDS):
        w, z = best.frequency, best.damping_ratio
        near = ((w * step, z), (w / step, z), (w, min(z * factor, _MOST_DAMPED)), (w, z / factor))
        closer = max((spectra.fit(*point) for point in near), key=lambda mode: mode.share)
        if closer.share > best.share:
            best = closer
        else:
            step, factor = math.sqrt(step), math.sqrt(factor)
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

    def _response(self, frequency: float, damping: float) -> NDArray[np.complex128]:
        """Spectrum of the output that a mode with c = 1 and no delay would give."""
        square = self.frequencies**2
        below = frequency**2 - square + 2j * damping * frequency * self.frequencies
        return np.asarray(self.angle * (-square / below), dtype=np.complex128)

    def _lags(self, frequency: float) -> int:
        return 1 + min(self.count // 4, int(_LATEST * 2 * math.pi / (frequency * self.period)))

    def rough_share(self, frequency: float, damping: float) -> float:
        """Share of the output explained, where the ringing after the log's end still counts: one FFT."""
        spectrum = self._response(frequency, damping)
        correlation = np.fft.irfft(np.conj(spectrum) * self.output)[: self._lags(frequency)]
        size = 2 * (spectrum.size - 1)
        power = 2 * float((spectrum.real**2 + spectrum.imag**2).sum()) / size
        return float(np.abs(correlation).max()) ** 2 / (power * self.energy) if power else 0.0

    def fit(self, frequency: float, damping: float) -> Mode:
        """Gain and delay of the mode of `frequency` and `damping` that explain most of the output."""
        size = 2 * (self.frequencies.size - 1)
        response = np.fft.irfft(self._response(frequency, damping), size)[: self.count]
        response -= response.mean()
        spectrum = np.fft.rfft(response, size)
        correlation = np.fft.irfft(np.conj(spectrum) * self.output)[: self._lags(frequency)]
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
