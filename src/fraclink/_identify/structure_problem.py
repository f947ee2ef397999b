"""What a structure is fitted to, samples or lines, and its free parameters as
coordinates of a search.

Both are a vector of measured numbers and, for a candidate, what it would have been. A
recording has besides a Laplace transform at some points of a vertical line, on which a
candidate costs microseconds: there the search begins.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.recording import Recording
from fraclink._identify.expression import Expression
from fraclink._identify.shape import Hold, chosen_hold, last_of
from fraclink.errors import FieldError, NotConvergedError
from fracsys._response import time_response

__all__ = [
    "COEFFICIENT_LIMITS",
    "GENERAL_POINTS",
    "ORDER_LIMITS",
    "Lines",
    "RecordStart",
    "Samples",
    "Spectrum",
    "StructureCoordinates",
    "held_transform",
]

Reals = NDArray[np.float64]
Limits = tuple[float, float]

# Below 0.02 a term is a constant over any band that can be measured; above 4 no
# fractional model of a machine is known, and `bounds` admits one. Coefficients in any
# unit: 24 decades, as a range in the logarithm costs nothing.
ORDER_LIMITS = (0.02, 4.0)
COEFFICIENT_LIMITS = (1e-12, 1e12)
# As `shape.HISTORY`, and shorter: every candidate is a response to all of it, and a
# search behind 50 000 samples takes half a second.
_HISTORY = 50_000
# Three points s in general position: two functions of one form that agree there agree
# everywhere.
GENERAL_POINTS = np.exp(1j * np.array([0.3, 0.9, 1.4])) * np.array([0.5, 1.1, 2.3])


@dataclass(frozen=True, eq=False)
class StructureCoordinates:
    """The free parameters as coordinates: logarithms where the range is positive, else
    the value itself.
    """

    structure: Expression
    limits: Mapping[str, Limits]
    fixed: Mapping[str, float]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All free parameters."""
        return tuple(name for name in self.structure.names if name not in self.fixed)

    @cached_property
    def gain(self) -> str | None:
        """The free coefficient that multiplies the whole, projected out; None where
        there is none.
        """
        values = self.values(self.middle()[None, :], projected=False)
        once = self.structure.response(values, GENERAL_POINTS)
        for name in self.structure.of_role("coefficient"):
            if name in self.names:
                # Tried in numbers and not read off the tree: k/(k·s + k) has none,
                # however its text looks.
                twice = self.structure.response(
                    {**values, name: 2.0 * values[name]}, GENERAL_POINTS
                )
                if np.allclose(twice, 2.0 * once, rtol=1e-12, atol=0.0):
                    return name
        return None

    @cached_property
    def moving(self) -> tuple[str, ...]:
        """Free parameters that are coordinates of the search: all but the gain."""
        return tuple(name for name in self.names if name != self.gain)

    def is_logarithmic(self, name: str) -> bool:
        """Whether the coordinate is the logarithm."""
        return (
            self.structure.roles[name] == "coefficient" and self.limits[name][0] > 0.0
        )

    def place(self, name: str, value: Any) -> Any:
        """The coordinate of a value."""
        return np.log(value) if self.is_logarithmic(name) else value

    def value(self, name: str, place: Any) -> Any:
        """The value at a coordinate."""
        return np.exp(place) if self.is_logarithmic(name) else place

    def middle(self) -> Reals:
        """Some place inside the limits of all free parameters, unlike each other, so
        that nothing cancels.
        """
        found = []
        for k, name in enumerate(self.names):
            low, high = (self.place(name, x) for x in self.limits[name])
            # 0.6, 0.77, 0.94 …: no two alike and no sum of two of them another, so that
            # no difference of parameters vanishes by chance.
            found.append(float(np.clip(0.6 + 0.17 * k, low, high)))
        return np.array(found)

    def box(self, names: tuple[str, ...]) -> tuple[Reals, Reals]:
        """Lower and upper limits of coordinates."""
        rows = [
            [float(self.place(name, x)) for x in self.limits[name]] for name in names
        ]
        ends = np.array(rows).reshape(-1, 2)
        return ends[:, 0], ends[:, 1]

    def shear(self, scale: float) -> Reals:
        """Coordinates in which coefficients count at the frequency `scale` [rad/s],
        shape (p, p).

        In c·s^n a higher order far from 1 rad/s is a smaller coefficient: c and n trade
        along a long narrow valley that is nothing but the unit of time. ln c + n ln ω
        lies across it. The pairs are those with ∂G/∂n = ± ln s · ∂G/∂ln c, whatever the
        expression.
        """
        result = np.eye(len(self.moving))
        values = self.values(self.middle()[None, :], projected=False)
        slopes = {
            name: self._slope(name, values, GENERAL_POINTS) for name in self.moving
        }
        for row, one in enumerate(self.moving):
            for column, other in enumerate(self.moving):
                # 1e-5: the differences below are right to 1e-9, and another ratio of
                # two slopes misses a whole number by more.
                if self.is_logarithmic(one) and self.structure.roles[other] == "order":
                    ratio = slopes[other] / (slopes[one] * np.log(GENERAL_POINTS))
                    if np.allclose(ratio, np.round(ratio[0].real), atol=1e-5) and round(
                        ratio[0].real
                    ):
                        result[row, column] = round(ratio[0].real) * math.log(scale)
        return result

    def _slope(
        self, name: str, values: Mapping[str, Reals], points: NDArray[np.complex128]
    ) -> Any:
        """∂G/∂ln c of a coefficient, ∂G/∂n of an order."""
        # The third root of the rounding: where the error of a central difference is
        # least.
        step = 1e-5 * (values[name] if self.is_logarithmic(name) else 1.0)
        ends = (
            self.structure.response(
                {**values, name: values[name] + sign * step}, points
            )
            for sign in (1, -1)
        )
        above, below = ends
        return np.ravel((above - below) / 2e-5) + 1e-300

    def values(self, places: Reals, *, projected: bool = True) -> dict[str, Reals]:
        """Parameters (M, 1) at places (M, p); the projected gain is 1."""
        names = self.moving if projected else self.names
        found: dict[str, Reals] = {
            name: np.array([[value]]) for name, value in self.fixed.items()
        }
        if projected and self.gain is not None:
            found[self.gain] = np.ones((1, 1))
        for k, name in enumerate(names):
            found[name] = self.value(name, places[:, k : k + 1])
        return found


Complexes = NDArray[np.complex128]

# of the transform: a resonance of ζ = 0.05 is met by three of them in a band of three
# decades
_POINTS = 160
_DECAYS = 5.0  # e^-5 of what a record does not show is left in its transform
_HIGHEST = 1.0  # |s| Ts: up to there the line between two samples is the signal to 8 %
_KEPT = 4  # responses
_EXCITED = 1e-3  # of the largest line: below, the input does not excite


class Samples(Protocol):
    """What a search asks of the data."""

    @property
    def measured(self) -> Reals:
        """All that was measured, weighted, shape (R,)."""
        ...

    @property
    def offset(self) -> Reals | None:
        """What a constant output adds to `measured`, shape (R,); None where there is no
        such thing.
        """
        ...

    @property
    def band(self) -> tuple[float, float]:
        """Lowest and highest frequency [rad/s] that the data tell of."""
        ...

    def simulated(
        self, structure: Expression, values: Mapping[str, Reals], count: int
    ) -> Reals:
        """What `count` candidates would have measured, shape (M, R); not finite where
        nothing responds.
        """
        ...


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

    @cached_property
    def measured(self) -> Reals:
        """As of `Samples`."""
        return _stacked(self.weight * self.output)

    @cached_property
    def offset(self) -> Reals | None:
        """As of `Samples`."""
        return (
            None
            if self.of_constant is None
            else _stacked(self.weight * self.of_constant)
        )

    @property
    def band(self) -> tuple[float, float]:
        """As of `Samples`."""
        size = np.abs(self.points)
        return float(size.min()), float(size.max())

    def simulated(
        self, structure: Expression, values: Mapping[str, Reals], count: int
    ) -> Reals:
        """As of `Samples`."""
        found = self.weight * self.input * structure.response(values, self.points)
        return _stacked(np.broadcast_to(found, (count, self.points.size)))


def _stacked(values: Complexes) -> Reals:
    return np.concatenate([values.real, values.imag], axis=-1)


@dataclass(frozen=True, eq=False)
class Lines(Spectrum):
    """A frequency response: the input is 1 at every line."""

    @classmethod
    def of(cls, frequency: Reals, response: Complexes, weight: Reals) -> Lines:
        """Lines in ascending order of ω [rad/s]."""
        return cls(
            np.asarray(1j * frequency, dtype=np.complex128),
            np.ones(frequency.size, dtype=np.complex128),
            response,
            weight,
        )


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
        chosen = _hold(np.concatenate([kept, own]), hold)
        return cls(
            own[:count] - rest,
            np.asarray(record.output)[:count],
            record.period,
            chosen,
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
    def offset(self) -> Reals | None:
        """As of `Samples`."""
        return np.ones(self.output.size)

    def simulated(
        self, structure: Expression, values: Mapping[str, Any], count: int
    ) -> Reals:
        """As of `Samples`; every candidate by its exact response to the held input."""
        # Not finite where nothing responds: the search takes such a candidate for
        # infinitely bad and goes on.
        result = np.full((count, self.output.size), np.nan)
        rows = {
            name: np.broadcast_to(np.ravel(value), (count,))
            for name, value in values.items()
        }
        for k in range(count):
            result[k] = self._response(
                structure, {name: float(row[k]) for name, row in rows.items()}
            )
        return result

    def _response(self, structure: Expression, values: Mapping[str, float]) -> Reals:
        """The response of one candidate; the last few are kept, as each is asked for
        again.
        """
        key: tuple[str | float, ...] = (
            structure.text,
            *(values[name] for name in structure.names),
        )
        if key not in self._latest:
            # Four: a descent asks for a place, its trial and the two ends of a
            # difference again, and each is a million bytes in a long record.
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
        knows: G is evaluated at σ + jω. The samples between which a line is drawn have
        the transform of that line.

        Of a cut log it knows nothing of what was before: starts are drawn from it, and
        not ranked by it.
        """
        count, period = self.output.size, self.period
        damping = _DECAYS / (count * period)
        damped = np.exp(-damping * period * np.arange(count))
        highest = min(int(_HIGHEST * count / (2 * math.pi)), count // 2)
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
        # Each point stands for the lines around it: evenly in ln ω, yet counted as the
        # whole record would count.
        weight = np.sqrt(width) / math.sqrt(
            float(np.sum(width * np.abs(out) ** 2)) or 1.0
        )
        state = np.stack([np.ones_like(points), points]) if self.earlier.size else None
        return Spectrum(points, into, out, weight, 1.0 / points, state)

    @property
    def band(self) -> tuple[float, float]:
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


def _hold(values: Reals, hold: Hold) -> Literal["zero", "first"]:
    """What the input does between samples; one that only steps is held.

    A constant input is a step at the first sample, which no neighbour tells from a
    straight line.
    """
    return (
        "zero" if hold == "auto" and np.ptp(values) == 0 else chosen_hold(values, hold)
    )
