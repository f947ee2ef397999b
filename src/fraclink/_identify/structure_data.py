"""What a structure is fitted to: the samples of a recording, blocks of them, or the
lines of a frequency response.

On the line Re s = σ the derivatives of G come with G itself, and their transform back
is a row of the Jacobian at every sample: no candidate has to be simulated for it. The
residual of samples is always that of the exact response.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from fraclink._arm.recording import Recording
from fraclink._identify.expression import Expression, Leaves, walk
from fraclink._identify.shape import Hold, chosen_hold, last_of
from fraclink.errors import FieldError, NotConvergedError
from fracsys._response import time_response

__all__ = ["Blocks", "Lines", "RecordStart", "Samples", "Spectrum"]

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Limits = tuple[float, float]

# As `shape.HISTORY`, and shorter: every candidate is a response to all of it, and a
# search behind 50 000 samples takes half a second.
_HISTORY = 50_000


# --- derivatives of an expression -------------------------------------------------------------------------


@dataclass(frozen=True)
class _Dual:
    """A number, or one at every point, with its derivatives by the parameters."""

    value: Any
    slopes: Mapping[str, Any]

    __array_ufunc__ = None  # numpy hands `array * dual` to the methods below

    @staticmethod
    def of(value: Any) -> _Dual:
        return value if isinstance(value, _Dual) else _Dual(value, {})

    def times(self, factor: Any, value: Any) -> _Dual:
        """A function of this: its value, and `factor`, its derivative by this."""
        return _Dual(
            value, {name: factor * slope for name, slope in self.slopes.items()}
        )

    def __add__(self, other: Any) -> _Dual:
        right = _Dual.of(other)
        slopes = {**self.slopes, **right.slopes}
        for name in self.slopes.keys() & right.slopes.keys():
            slopes[name] = self.slopes[name] + right.slopes[name]
        return _Dual(self.value + right.value, slopes)

    def __mul__(self, other: Any) -> _Dual:
        right = _Dual.of(other)
        product = self.value * right.value
        return self.times(right.value, product) + right.times(self.value, 0.0)

    def __truediv__(self, other: Any) -> _Dual:
        right = _Dual.of(other)
        inverse = 1.0 / right.value
        quotient = self.value * inverse
        return self.times(inverse, quotient) + right.times(-quotient * inverse, 0.0)

    def __pow__(self, exponent: Any) -> _Dual:
        power = _Dual.of(exponent)
        value = self.value**power.value
        # d(b^p) = p b^(p−1) db + ln b · b^p dp; the logarithm is asked for only where p
        # is a parameter, as it has none at b = 0.
        by_base = (
            self.times(power.value * value / self.value, value)
            if self.slopes
            else _Dual(value, {})
        )
        return (
            by_base + power.times(np.log(self.value) * value, 0.0)
            if power.slopes
            else by_base
        )

    def __neg__(self) -> _Dual:
        return self.times(-1.0, -self.value)

    def __sub__(self, other: Any) -> _Dual:
        return self + (-_Dual.of(other))

    __radd__ = __add__
    __rmul__ = __mul__

    def __rsub__(self, other: Any) -> _Dual:
        return _Dual.of(other) - self

    def __rtruediv__(self, other: Any) -> _Dual:
        return _Dual.of(other) / self

    def __rpow__(self, other: Any) -> _Dual:
        return _Dual.of(other) ** self


def derivatives(
    structure: Expression,
    values: Mapping[str, Any],
    points: Complexes,
    names: tuple[str, ...],
) -> Complexes:
    """G and ∂G/∂p for the parameters p of `names` at points [rad/s], shape (M, 1 + q,
    K), for values (M, 1).
    """
    # One logarithm for all powers of s, which is the derivative's factor besides:
    # ds^a/da = ln s · s^a.
    logarithm = np.log(points)

    def power(order: Any) -> _Dual:
        own = _Dual.of(order)
        value = np.exp(own.value * logarithm)
        return own.times(logarithm * value, value) if own.slopes else _Dual(value, {})

    def exponential(exponent: _Dual) -> _Dual:
        value = np.exp(exponent.value)
        return exponent.times(value, value)

    duals = {n: _Dual(v, {n: 1.0} if n in names else {}) for n, v in values.items()}
    with np.errstate(all="ignore"):
        found = _Dual.of(
            walk(structure.tree, Leaves(_Dual(points, {}), power, exponential, duals))
        )
    rows = (found.value, *(found.slopes[name] for name in names))
    count = max(np.shape(v)[0] for v in values.values())
    return np.stack([np.broadcast_to(r, (count, points.size)) for r in rows], axis=1)


# --- what is fitted to ------------------------------------------------------------------------------------


class Samples(Protocol):
    """What a structure's problem asks of the data."""

    @property
    def measured(self) -> Reals:
        """All that was measured, weighted, shape (R,)."""
        ...

    @property
    def constant(self) -> Reals | None:
        """What an offset of one adds to `measured`, shape (R,); None where there is no
        such thing.
        """
        ...

    def columns(
        self, structure: Expression, values: Mapping[str, Any], names: tuple[str, ...]
    ) -> Reals:
        """Responses of M candidates and their derivatives by the parameters `names`,
        shape (M, 1 + q, R); not finite where nothing responds.
        """
        ...


def _stacked(values: Complexes) -> Reals:
    return np.concatenate([values.real, values.imag], axis=-1)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Points s with the transform of input and output there, and the weight of each
    point's error.

    `of_constant` is the transform of an offset; of a record that was cut in mid-motion
    D Y − N U is no zero but the state at the cut, of integer orders a polynomial:
    `of_state` (2, K) is what its terms are made of.
    """

    points: Complexes
    input: Complexes
    output: Complexes
    weight: Reals
    of_constant: Complexes | None = None
    of_state: Complexes | None = None


@dataclass(frozen=True, eq=False)
class Lines(Spectrum):
    """A frequency response: the input is 1 at every line."""

    constant: None = None

    @classmethod
    def of(cls, frequency: Reals, response: Complexes, weight: Reals) -> Lines:
        """Lines in ascending order of ω [rad/s]."""
        one = np.ones(frequency.size, dtype=np.complex128)
        return cls(np.asarray(1j * frequency), one, response, weight)

    @property
    def spectrum(self) -> Spectrum:
        """Itself."""
        return self

    @property
    def screen(self) -> Lines:
        """Itself: a candidate costs microseconds."""
        return self

    @property
    def band(self) -> Limits:
        """Lowest and highest frequency [rad/s] that the data tell of."""
        return float(self.points[0].imag), float(self.points[-1].imag)

    @cached_property
    def measured(self) -> Reals:
        """As of `Samples`."""
        return _stacked(self.weight * self.output)

    def columns(
        self, structure: Expression, values: Mapping[str, Any], names: tuple[str, ...]
    ) -> Reals:
        """As of `Samples`."""
        return _stacked(
            self.weight * derivatives(structure, values, self.points, names)
        )


# of the transform: a resonance of ζ = 0.05 is met by three of them in a band of three
# decades
_POINTS = 160
_DECAY = 5.0  # e^-5 of what a record does not show is left in its transform
# σ·span of a transform back: less lets a slow end wrap around, more drowns it in what
# is lost beyond the lines
_BACK = (1.0, 4.0)
_WRONG = 1e-2  # of the output: a transform back that misses it by more is not used
_KEPT = 4  # responses
_EXCITED = 1e-3  # of the largest line: below, the input does not excite
_BLOCKS = 1000  # of a screen: orders, corners and delays show in its lowest 500 lines


@dataclass(frozen=True, eq=False)
class RecordStart:
    """The first samples of a recording, with the response that a candidate would have
    there.

    `earlier` (H,) is the input just before them, of a log that was cut: it moves the
    output, and nothing is compared with it.
    """

    input: Reals
    output: Reals
    period: float
    hold: Literal["zero", "first"]
    earlier: Reals = field(default_factory=lambda: np.zeros(0))
    # Slopes by differences of exact responses: no row is off by what a transform loses.
    exact: bool = False

    @classmethod
    def of(
        cls, record: Recording, hold: Hold, count: int, earlier: Reals | None = None
    ) -> RecordStart:
        """The first `count` samples; the input counts from rest: where the used part of
        `earlier` begins.
        """
        own = np.asarray(record.input, dtype=np.float64)
        before = (
            np.zeros(0) if earlier is None else np.asarray(earlier, dtype=np.float64)
        )
        kept = last_of(before, own.size, _HISTORY)
        # Not from where a longer history began: the input would jump from there to
        # here, as no motor did. The output from here on is another by a constant at
        # most, and `offset` is that of a rest here.
        rest = float(kept[0]) if kept.size else record.input_at_rest
        whole = np.concatenate([kept, own])
        # A constant input is a step at the first sample, which no neighbour tells from
        # a straight line.
        steps = hold == "auto" and np.ptp(whole) == 0
        return cls(
            own[:count] - rest,
            np.asarray(record.output)[:count],
            record.period,
            "zero" if steps else chosen_hold(whole, hold),
            kept - rest,
        )

    @cached_property
    def whole_input(self) -> Reals:
        """The input from before the cut on, shape (H + N,)."""
        return np.concatenate([self.earlier, self.input])

    @property
    def measured(self) -> Reals:
        """As of `Samples`."""
        return self.output

    @cached_property
    def constant(self) -> Reals:
        """As of `Samples`."""
        return np.ones(self.output.size)

    @property
    def screen(self) -> Blocks:
        """The recording in blocks, for many candidates at once."""
        return Blocks(_Transform(self, _BACK[-1], max(self.output.size // _BLOCKS, 1)))

    @cached_property
    def _transforms(self) -> tuple[_Transform, ...]:
        return tuple(_Transform(self, decay) for decay in _BACK)

    def columns(
        self, structure: Expression, values: Mapping[str, Any], names: tuple[str, ...]
    ) -> Reals:
        """As of `Samples`; every candidate by its exact response to the held input."""
        count = max(np.shape(value)[0] for value in values.values())
        rows = {n: np.broadcast_to(np.ravel(v), (count,)) for n, v in values.items()}
        return np.array(
            [
                self._columns(
                    structure, {n: float(r[k]) for n, r in rows.items()}, names
                )
                for k in range(count)
            ]
        )

    def _columns(
        self, structure: Expression, values: Mapping[str, float], names: tuple[str, ...]
    ) -> Reals:
        response = self.response(structure, values)
        if not names or not np.isfinite(response).all():
            return np.repeat(response[None, :], 1 + len(names), axis=0)
        # A held input jumps, and the output is not smooth in a delay.
        smooth = self.hold == "first" or not any(
            structure.roles[name] == "delay" for name in names
        )
        for transform in self._transforms if smooth and not self.exact else ():
            each = {name: np.array([[value]]) for name, value in values.items()}
            found = transform.rows(structure, each, names)[0]
            # Against the exact response: no error bound of the transform would know of
            # a pole to the right of the line, or of a response that jumps.
            missed = found[0] - response
            if missed @ missed <= _WRONG**2 * (response @ response):
                return np.concatenate([response[None, :], found[1:]])
        return np.array(
            [response, *(self._slope(structure, values, name) for name in names)]
        )

    def _slope(
        self, structure: Expression, values: Mapping[str, float], name: str
    ) -> Reals:
        """A derivative by a one-sided difference, as a second response would double the
        cost of a search; the other way where the domain ends.
        """
        value, here = values[name], self.response(structure, values)
        # Responses are known to 1e-12 of their peak, so that slopes are to 1e-6.
        step = 1e-6 * (abs(value) if structure.roles[name] == "coefficient" else 1.0)
        # A held input jumps at a sample: up to a delay that ends there the response is
        # smooth, behind it begins another piece.
        ahead = -step if structure.roles[name] == "delay" else step
        for moved in (value + ahead, value - ahead):
            there = self.response(structure, {**values, name: moved})
            if np.isfinite(there).all():
                return np.asarray((there - here) / (moved - value))
        return np.zeros(here.size)

    def response(self, structure: Expression, values: Mapping[str, float]) -> Reals:
        """The response of one candidate; the last few are kept, as each is asked for
        again.
        """
        key: tuple[str | float, ...] = (
            structure.text,
            *(values[name] for name in structure.names),
        )
        if key not in self._latest:
            if len(self._latest) >= _KEPT:
                del self._latest[next(iter(self._latest))]
            try:
                found = time_response(
                    structure.function(values),
                    self.whole_input,
                    self.period,
                    hold=self.hold,
                ).output[self.earlier.size :]
            except (
                FieldError,
                NotConvergedError,
            ):  # improper, a delay below zero, a response beyond doubles
                found = np.full(self.output.size, np.nan)
            self._latest[key] = found
        return self._latest[key]

    @cached_property
    def _latest(self) -> dict[tuple[str | float, ...], Reals]:
        return {}

    @cached_property
    def spectrum(self) -> Spectrum:
        """The transform on the line Re s = σ, at the real point and at points spread
        evenly in ln ω.

        A damped record has a transform though it ends, and of the damping the response
        knows: G is evaluated at σ + jω. Starts are drawn from it.
        """
        count, period = self.output.size, self.period
        damping = _DECAY / (count * period)
        damped = np.exp(-damping * period * np.arange(count))
        # Up to |s| Ts = 1 the line between two samples is the signal to 8 %.
        highest = min(int(count / (2 * math.pi)), count // 2)
        # Evenly in the logarithm, as orders and corners show there: a linear grid would
        # spend nine tenths of its lines on the last decade.
        spread = np.geomspace(1.0, max(highest, 2), _POINTS).round().astype(int)
        lines = np.unique(np.concatenate([[0], spread]))
        points = damping + 2j * math.pi * lines / (count * period)
        # From where the cut found it; one that rests behind the cut rings as from a
        # step there.
        cut = self.earlier.size > 0 and np.ptp(self.input) > 0
        moved = self.input - self.input[0] if cut else self.input
        transforms = [
            np.fft.rfft(damped * values)[lines] for values in (moved, self.output)
        ]
        width = np.gradient(lines.astype(np.float64)) if lines.size > 1 else np.ones(1)
        # The real point stands for half a line's width: its other half is the mirror
        # image at negative ω.
        width[0] = max(width[0] / 2, 0.5)
        into = held_transform(transforms[0], points, period, self.hold, float(moved[0]))
        out = held_transform(
            transforms[1], points, period, "first", float(self.output[0])
        )
        state = np.stack([np.ones_like(points), points]) if self.earlier.size else None
        # Each point stands for the lines around it: evenly in ln ω, yet counted as the
        # whole record would count.
        return Spectrum(points, into, out, np.sqrt(width), 1.0 / points, state)

    @property
    def band(self) -> Limits:
        """Lowest and highest frequency [rad/s] at which the input has power."""
        # Of the differences: a step excites all frequencies alike, and would seem to
        # excite the lowest alone.
        moved = self.whole_input
        power = np.abs(np.fft.rfft(np.diff(moved, prepend=0.0)))[1:]
        frequency = (
            2 * math.pi * np.arange(1, power.size + 1) / (moved.size * self.period)
        )
        excited = frequency[power > _EXCITED * power.max()]
        return float(excited[0]), float(excited[-1])


def held_transform(
    samples: Complexes, s: Complexes, period: float, hold: str, first: float
) -> Complexes:
    """Transform of the held signal of a transform Σ x_k e^(−skT): steps, or straight
    lines.
    """
    x = s * period
    if hold == "zero":
        # expm1: at the lowest lines x is 1e-5, where 1 − e^(−x) would lose five digits.
        return np.asarray(samples * -np.expm1(-x) / s)
    # The triangle around the first sample is cut in two: nothing comes before it.
    before = first * (np.expm1(x) - x) / (s * x)
    return np.asarray(samples * period * (np.sinh(x / 2) / (x / 2)) ** 2 - before)


@dataclass(frozen=True, eq=False)
class _Transform:
    """The transform of a recording's input on the line Re s = `decay`/span, and back in
    blocks of `width` samples.
    """

    data: RecordStart
    decay: float
    width: int = 1

    @cached_property
    def _size(self) -> int:
        """Twice the samples: what comes behind the end does not wrap around to the
        beginning.
        """
        blocks = -(-2 * self.data.whole_input.size // self.width)
        return self.width * int(next_fast_len(blocks, real=True))

    @cached_property
    def _points(self) -> Complexes:
        count, period = self.data.whole_input.size, self.data.period
        lines = np.arange(self._size // 2 + 1)
        return np.asarray(
            self.decay / (count * period) + 2j * math.pi / (self._size * period) * lines
        )

    @cached_property
    def _input(self) -> Complexes:
        """Transform of the held input, over the period: that of the output's samples,
        but for G.
        """
        own, moved = self.data, self.data.whole_input
        damped = moved * np.exp(-self.decay / moved.size * np.arange(moved.size))
        held = held_transform(
            rfft(damped, self._size),
            self._points,
            own.period,
            own.hold,
            float(moved[0]),
        )
        return np.asarray(held / own.period)

    def rows(
        self, structure: Expression, values: Mapping[str, Any], names: tuple[str, ...]
    ) -> Reals:
        """Outputs of candidates (M, 1) and their derivatives, one value for each block,
        shape (M, 1 + q, N/width).
        """
        own, span = self.data, self.data.whole_input.size
        count, blocks = self._size // self.width // 2, own.output.size // self.width
        lines = derivatives(structure, values, self._points[:count], names)
        # To the middle of each block: its mean is there, and not at its first sample.
        # The first block begins with the first output, behind all that moved it before.
        middle = span - own.output.size + 0.5 * (self.width - 1)
        turn = np.exp(2j * math.pi * middle / self._size * np.arange(count))
        with np.errstate(all="ignore"):
            found = irfft(
                lines * (turn * self._input[:count]), self._size // self.width, axis=-1
            )[..., :blocks]
        # The transform counts the samples of the coarse grid only, each for a block;
        # the damping that made it converge is taken off again.
        times = middle + self.width * np.arange(blocks)
        return np.asarray(
            found * (np.exp(self.decay / span * times) / math.sqrt(self.width))
        )


@dataclass(frozen=True, eq=False)
class Blocks:
    """A recording in blocks of samples, with what a transform back says that a
    candidate responds: sums over blocks are sums over samples.
    """

    transform: _Transform

    @cached_property
    def measured(self) -> Reals:
        """As of `Samples`; white noise keeps its variance."""
        output, width = self.transform.data.output, self.transform.width
        sums = output[: output.size // width * width].reshape(-1, width).sum(axis=1)
        return np.asarray(sums / math.sqrt(width))

    @cached_property
    def constant(self) -> Reals:
        """As of `Samples`."""
        return np.full(self.measured.size, math.sqrt(self.transform.width))

    def columns(
        self, structure: Expression, values: Mapping[str, Any], names: tuple[str, ...]
    ) -> Reals:
        """As of `Samples`."""
        return self.transform.rows(structure, values, names)
