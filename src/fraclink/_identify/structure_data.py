"""The data of a structure's fit: the samples of a recording, blocks of samples, or the
lines of a frequency response.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from fraclink._arm.recording import Recording
from fraclink._identify.expression import Expression
from fraclink._identify.shape import Hold, Window, chosen_hold
from fraclink._identify.welch import EXCITED
from fraclink.errors import FieldError, NotConvergedError
from fracsys._response import time_response
from fracsys.checks import Complex, Real

Limits = tuple[float, float]


def _stacked(values: Complex) -> Real:
    return np.concatenate([values.real, values.imag], axis=-1)


def _of_many(
    structure: Expression, values: Mapping[str, Any], points: Complex
) -> Complex:
    """G at points (K,) for parameters (M, 1), shape (M, K)."""
    count = max(np.shape(value)[0] for value in values.values())
    return np.broadcast_to(structure.response(values, points), (count, points.size))


@dataclass(frozen=True, eq=False)
class Lines:
    """A frequency response: points s, the response there, and the weight of each
    point's error.
    """

    points: Complex
    output: Complex
    weight: Real

    @property
    def band(self) -> Limits:
        """Lowest and highest frequency [rad/s] of the data."""
        return float(self.points[0].imag), float(self.points[-1].imag)

    @cached_property
    def measured(self) -> Real:
        """All measured values, weighted, shape (R,)."""
        return _stacked(self.weight * self.output)

    @cached_property
    def constant(self) -> Real:
        """Zero: a frequency response has no offset."""
        return np.zeros(self.measured.size)

    def response(self, structure: Expression, values: Mapping[str, Any]) -> Real:
        """Responses of M candidates with parameters (M, 1), shape (M, R); not finite
        where there is no response.
        """
        return _stacked(self.weight * _of_many(structure, values, self.points))


# σ·span of the inverse transform: with less, a slow end wraps around; with more, the
# response is lost in the truncation beyond the lines
_BACK = 4.0


@dataclass(frozen=True, eq=False)
class Signals(Window):
    """The first samples of a recording, and the response of a candidate to them."""

    @classmethod
    def of(cls, record: Recording, hold: Hold, count: int, whole: Real) -> Signals:
        """The first `count` samples; the input is relative to its rest at the beginning
        of the `whole` input, which may begin before the recording.
        """
        earlier = whole.size - record.input.size
        # The first value of `whole`, even if it was cut from a longer history: from an
        # earlier rest the input would jump, as no motor does. The output then differs
        # at most by a constant, which `offset` contains.
        rest = float(whole[0]) if earlier else record.input_at_rest
        # A constant input is a step at the first sample, which the next samples do not
        # distinguish from a straight line.
        steps = hold == "auto" and np.ptp(whole) == 0
        return cls(
            whole[: earlier + count] - rest,
            record.output[:count],
            record.period,
            "zero" if steps else chosen_hold(whole, hold),
        )

    @property
    def measured(self) -> Real:
        """See `Lines`."""
        return self.output

    @cached_property
    def constant(self) -> Real:
        """The effect of an offset of one on `measured`, shape (R,)."""
        return np.ones(self.measured.size)

    def response(self, structure: Expression, values: Mapping[str, Any]) -> Real:
        """See `Lines`; each is the exact response to the held input."""
        names, columns = [*values], np.broadcast_arrays(*values.values())
        rows = []
        for row in np.concatenate(columns, axis=1).tolist():
            try:
                function = structure.function(dict(zip(names, row, strict=True)))
                exact = time_response(
                    function, self.input, self.period, hold=self.hold
                ).output
            # Improper, a negative delay, or a response beyond the range of doubles.
            except (FieldError, NotConvergedError):
                exact = np.full(self.input.size, np.nan)
            rows.append(exact[-self.samples :])
        return np.array(rows)

    @cached_property
    def band(self) -> Limits:
        """Lowest and highest frequency [rad/s] at which the input has power."""
        # Of the differences: a step excites all frequencies equally, but would appear
        # to excite only the lowest.
        signal = self.input
        power = np.abs(np.fft.rfft(np.diff(signal, prepend=0.0)))[1:] ** 2
        frequency = (
            math.tau * np.arange(1, power.size + 1) / (signal.size * self.period)
        )
        excited = frequency[power > EXCITED * power.max()]
        return float(excited[0]), float(excited[-1])


@dataclass(frozen=True, eq=False)
class Blocks:
    """A recording as sums over blocks of `width` samples, with the response of a
    candidate by the inverse transform from the line Re s = σ.
    """

    data: Signals
    width: int

    @cached_property
    def measured(self) -> Real:
        """Sums of the blocks, scaled so that white noise keeps its variance."""
        output, width = self.data.measured, self.width
        sums = output[: output.size // width * width].reshape(-1, width).sum(axis=1)
        return sums / math.sqrt(width)

    @cached_property
    def constant(self) -> Real:
        """The effect of an offset of one on `measured`, shape (R,)."""
        return np.full(self.measured.size, math.sqrt(self.width))

    @property
    def band(self) -> Limits:
        """See `Lines`."""
        return self.data.band

    @cached_property
    def _lines(self) -> tuple[Complex, Complex, int]:
        """Points s, the transform of the held input there, referred to the middle of
        the first block, and the size of the inverse transform.
        """
        own, signal = self.data, self.data.input
        span, period = signal.size, own.period
        # Twice the samples, so that the response beyond the end does not wrap around to
        # the beginning.
        blocks = int(next_fast_len(-(-2 * span // self.width), real=True))
        size = self.width * blocks
        lines = np.arange(blocks // 2)
        points = np.asarray(
            _BACK / (span * period) + 2j * math.pi / (size * period) * lines
        )
        damped = rfft(signal * np.exp(-_BACK / span * np.arange(span)), size)
        x = np.asarray(points * period, np.complex128)
        into = _held(damped[lines], x, own.hold, float(signal[0]))
        return points, into * np.exp(2j * math.pi * self._middle / size * lines), blocks

    @property
    def _middle(self) -> float:
        """The middle of the first block, in samples, to which its mean belongs."""
        return self.data.input.size - self.data.samples + 0.5 * (self.width - 1)

    def response(self, structure: Expression, values: Mapping[str, Any]) -> Real:
        """See `Lines`."""
        points, into, blocks = self._lines
        output = irfft(_of_many(structure, values, points) * into, blocks, axis=-1)
        # Undo the damping that made the transform converge.
        times = self._middle + self.width * np.arange(self.measured.size)
        growth = np.exp(_BACK / self.data.input.size * times)
        return output[:, : self.measured.size] * (growth / math.sqrt(self.width))


def _held(samples: Complex, x: Complex, hold: str, first: float) -> Complex:
    """Transform of a held signal at x = s Ts, divided by Ts, from Σ x_k e^(−kx): steps,
    or straight lines.
    """
    if hold == "zero":
        # expm1: at the lowest lines x is 1e-5, where 1 − e^(−x) would lose five digits.
        return samples * -np.expm1(-x) / x
    # The triangle around the first sample is cut in half, because nothing precedes it.
    before = first * (np.expm1(x) - x) / x**2
    return samples * (np.sinh(x / 2) / (x / 2)) ** 2 - before


Samples = Signals | Blocks | Lines
