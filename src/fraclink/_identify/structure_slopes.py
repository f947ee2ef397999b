"""How a recording's output moves with every parameter, from one Fourier transform each.

On the line Re s = σ the derivatives of G come with G itself, and their transform back
is a row of the Jacobian at every sample: no candidate has to be simulated for it. What
is lost (lines beyond the band, aliases, what wraps around) is a small part of a row,
and moves the end of a descent by as small a part of a standard error; the residual
itself is always that of the exact response.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from fraclink._identify.expression import Expression, Leaves, walk
from fraclink._identify.least_squares import blocks_of
from fraclink._identify.structure_problem import (
    RecordStart,
    StructureCoordinates,
    held_transform,
)

__all__ = ["Coarse", "Rows"]

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_DECAYS = (
    1.0,
    4.0,
)  # σ·span: less lets a slow end wrap around, more drowns it in what is lost
_SPREAD = 240  # lines that tell where the others may end
_LEFT_OUT = 3e-6  # of a row's power lies beyond the lines that are taken for a Jacobian
_CRUDE = 1e-3  # … and for the way to a place where steps with the exact response begin
# of it above half of the Nyquist frequency: there the samples' transform is another
_ALIASED = 1e-3
# … so little that a descent may end on such rows: what is left to gain is as small a
# part
_SHARP = 1e-5
# samples of a row for each that its lines would need: its blocks are then nearly
# constant
_FINER = 4
_COARSEST = 16
_FEWEST = 1000  # blocks: a residual's colour is found in so many
# lines at most for a candidate of a search: a millisecond, and 20 rad/s of eight
# minutes
_SCREENED = 3000
_WRONG = 2e-2  # of the output: a transform back that misses it by more is not used
_CLOSE = 4e-3  # … and one on which a descent may end misses it by less


# --- derivatives of an expression -----------------------------------------------------------------------


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
    structure: Expression, values: Mapping[str, float], points: Complexes
) -> tuple[Complexes, dict[str, Complexes]]:
    """G at `points` [rad/s] and ∂G/∂p for every parameter p of `values`."""
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

    duals = {name: _Dual(value, {name: 1.0}) for name, value in values.items()}
    with np.errstate(all="ignore"):
        found = _Dual.of(
            walk(structure.tree, Leaves(_Dual(points, {}), power, exponential, duals))
        )
    shape = points.shape
    slopes = {
        name: np.broadcast_to(slope, shape) for name, slope in found.slopes.items()
    }
    return np.broadcast_to(found.value, shape), slopes


# --- rows of a Jacobian ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Slopes:
    """The transform of a recording's input on the line Re s = `decay`/span, for any
    number of candidates.
    """

    data: RecordStart
    decay: float

    @cached_property
    def _size(self) -> int:
        """Twice the samples: what comes behind the end does not wrap around to the
        beginning.
        """
        # A multiple of the coarsest block, so that every width divides it, and of small
        # primes, or the transform is ten times slower.
        return _COARSEST * int(
            next_fast_len(-(-2 * self.data.whole_input.size // _COARSEST), real=True)
        )

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
        samples = rfft(damped, self._size)
        held = held_transform(
            samples, self._points, own.period, own.hold, float(moved[0])
        )
        return np.asarray(held / own.period)

    @property
    def highest(self) -> int:
        """Lines up to |s| Ts = 1, where the line between two samples is no longer the
        signal.
        """
        return max(int(self._size / (2 * math.pi)), 1)

    @cached_property
    def _spread(self) -> NDArray[np.int64]:
        """Some of the lines, evenly in ln ω."""
        last = self._points.size - 1
        return np.unique(np.geomspace(1.0, last, _SPREAD).round().astype(np.int64))

    def _lines(
        self, own: StructureCoordinates, values: Mapping[str, float], at: Any
    ) -> Complexes:
        """The output's transform and its derivatives at some of the lines, shape (1 +
        q, K).
        """
        response, slopes = derivatives(own.structure, values, self._points[at])
        return np.asarray(
            self._input[at]
            * np.array([response, *(slopes[name] for name in own.names)])
        )

    def _enough(
        self, own: StructureCoordinates, values: Mapping[str, float], left_out: float
    ) -> tuple[int, float]:
        """How many lines hold all but a part of every row's power, and the part where
        aliases are.
        """
        found = self._lines(own, values, self._spread)
        # What lies above each line, from the highest line down: each of the spread
        # stands for those around it.
        power = np.cumsum(
            (np.abs(found) ** 2 * np.gradient(self._spread))[:, ::-1], axis=1
        )[:, ::-1]
        power /= power[:, :1]
        needed = np.flatnonzero(np.any(power > left_out, axis=0))
        above = self._spread > self._points.size // 2
        aliased = float(np.max(power[:, above], initial=0.0))
        last = int(self._spread[needed[-1]]) + 1 if needed.size else self._points.size
        return min(last, self._points.size // 2), aliased

    def width(self, count: int, samples: int) -> int:
        """Samples of a block, for so many lines."""
        width = _COARSEST
        # Halved until the lines fit below the coarse grid's Nyquist frequency with
        # room, and blocks enough are left to see a residual's colour in.
        while width > 1 and (
            self._size // width < 2 * _FINER * count or samples // width < _FEWEST
        ):
            width //= 2
        return width

    def back(self, lines: Complexes, width: int) -> Reals:
        """The signals (…, N/width) of transforms at the first lines, one value for each
        block of samples.
        """
        count, size, span = (
            lines.shape[-1],
            self.data.output.size,
            self.data.whole_input.size,
        )
        # To the middle of each block: its mean is there, and not at its first sample.
        # The first block begins with the first output, behind all that moved it before.
        middle = span - size + 0.5 * (width - 1)
        turned = lines * np.exp(2j * math.pi * middle / self._size * np.arange(count))
        found = irfft(turned, self._size // width, axis=-1)[..., : size // width]
        # The transform counts the samples of the coarse grid only, each for a block of
        # `width`. The damping that made the transform converge is taken off again: at
        # the end by e^1 or e^4.
        growth = np.exp(self.decay / span * (middle + width * np.arange(size // width)))
        return np.asarray(found * (growth / math.sqrt(width)))

    def output(
        self, structure: Expression, values: Mapping[str, Any], count: int, width: int
    ) -> Reals:
        """What candidates respond, from the first `count` lines."""
        response = structure.response(values, self._points[:count])
        return self.back(response * self._input[:count], width)

    def rows(
        self,
        own: StructureCoordinates,
        values: Mapping[str, float],
        count: int,
        width: int,
    ) -> Reals:
        """The output and its derivatives by the coordinates, shape (1 + q, N/width)."""
        units = [
            1.0,
            *(values[name] if own.is_logarithmic(name) else 1.0 for name in own.names),
        ]
        lines = self._lines(own, values, slice(count)) * np.array(units)[:, None]
        return self.back(lines, width)

    def coarse(
        self,
        own: StructureCoordinates,
        values: Mapping[str, float],
        simulated: Reals,
        left_out: float,
    ) -> Coarse | None:
        """The recording in blocks, small enough for these values, whose exact response
        is `simulated`.

        None where the transform back is another: an unstable function, one that jumps
        with its input.
        """
        with np.errstate(all="ignore"):
            count, aliased = self._enough(own, values, left_out)
            if not aliased <= _ALIASED:
                return None
            width = self.width(count, simulated.size)
            each = {name: np.array([[value]]) for name, value in values.items()}
            missed = self.output(own.structure, each, count, width)[0] - blocks_of(
                simulated, width
            )
            # Against the exact response, once for each place: no error bound of the
            # transform would know of a pole to the right of the line.
            wrong = math.sqrt(missed @ missed / (simulated @ simulated))
        sharp = aliased <= _SHARP and wrong <= _CLOSE
        return (
            Coarse(self, count, width, sharp)
            if wrong <= _WRONG + math.sqrt(left_out)
            else None
        )


@dataclass(frozen=True, eq=False)
class Coarse:
    """A recording in blocks of samples, with what a transform back says that a
    candidate responds.
    """

    slopes: _Slopes
    count: int
    width: int
    sharp: bool

    @cached_property
    def measured(self) -> Reals:
        """As of `Samples`."""
        return blocks_of(np.asarray(self.slopes.data.measured), self.width)

    @cached_property
    def offset(self) -> Reals:
        """As of `Samples`."""
        return np.full(self.measured.size, math.sqrt(self.width))

    @property
    def band(self) -> tuple[float, float]:
        """As of `Samples`."""
        return self.slopes.data.band

    def simulated(
        self, structure: Expression, values: Mapping[str, Reals], count: int
    ) -> Reals:
        """As of `Samples`."""
        with np.errstate(all="ignore"):
            found = self.slopes.output(structure, values, self.count, self.width)
        return np.broadcast_to(found, (count, self.measured.size))

    def rows(
        self, own: StructureCoordinates, values: Mapping[str, float]
    ) -> Reals | None:
        """∂(measured)/∂(coordinates of all free parameters); None where they are not
        finite.
        """
        with np.errstate(all="ignore"):
            found = self.slopes.rows(own, values, self.count, self.width)[1:]
        return found if np.isfinite(found).all() else None


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of a Jacobian for a recording, where a transform back knows them."""

    data: RecordStart

    @cached_property
    def _of_decays(self) -> tuple[_Slopes, ...]:
        return tuple(_Slopes(self.data, decay) for decay in _DECAYS)

    def screen(self) -> Coarse:
        """The recording for many candidates, none of which is known to be near: as far
        up as lines are cheap.

        Of a cut log: its transform alone lacks what the output still does by the motion
        before the cut.
        """
        # The more damped line: candidates that hardly decay must not wrap around.
        slopes = self._of_decays[-1]
        count = min(_SCREENED, slopes.highest)
        return Coarse(
            slopes, count, slopes.width(count, self.data.output.size), sharp=False
        )

    def coarse(
        self,
        own: StructureCoordinates,
        values: Mapping[str, float],
        *,
        crude: bool = False,
    ) -> Coarse | None:
        """The recording in blocks, on the first line that knows the output there; None
        where none does.

        An input that jumps and a free delay are such a case: the output is not smooth
        in it. A `crude` one shows the way to a place, and is too coarse for a Jacobian.
        """
        if self.data.hold == "zero" and any(
            own.structure.roles[name] == "delay" for name in own.names
        ):
            return None
        simulated = self.data.simulated(
            own.structure, {n: np.array([[v]]) for n, v in values.items()}, 1
        )[0]
        left_out = _CRUDE if crude else _LEFT_OUT
        found = (
            slopes.coarse(own, values, simulated, left_out)
            for slopes in self._of_decays
        )
        # The weakly damped line first: it loses least, where the response has died away
        # before the record ends.
        return next((coarse for coarse in found if coarse is not None), None)
