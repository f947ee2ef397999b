"""References for tip or motor, with exact velocity and acceleration.

A reference is a piecewise polynomial of time, or a table of samples that includes the
acceleration: the feed-forward of the law then needs no differences of samples.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike

from fraclink.errors import FieldError, SizeError
from fracsys.checks import Array, Between, Period, Real, checked
from fracsys.checks.equality import compared

__all__ = [
    "SETTLE",
    "Path",
    "Reference",
    "SampledReference",
    "hold",
    "prbs",
    "pulse",
    "sampled",
    "smooth_step",
    "spline",
]


# Samples of one reference: 2 h at 4 ms; angle, velocity and acceleration take 48 MB, and
# twice as much while they are computed.
LONGEST = 2_000_000
# [s] for which an arm is observed after its reference has come to rest: eight periods of
# the paper's slowest link
SETTLE = 5.0
# A quintic divides by the fifth power of its duration; beyond these limits the
# quotients overflow.
_SHORTEST, _LARGEST = 1e-9, 1e9
Angle = Annotated[float, Between(-_LARGEST, _LARGEST, "rad")]
Length = Annotated[float, Between(_SHORTEST, _LARGEST, "s")]
Start = Annotated[float, Between(0.0, _LARGEST, "s")]
# quintic from rest to rest with continuous velocity and acceleration
_QUINTIC = (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)
# A shift register with feedback from its last stage and from this one runs through all
# states but zero, because x^n + x^k + 1 is primitive. There is no such trinomial of
# degree 8.
_TAPS = {3: 2, 4: 3, 5: 3, 6: 5, 7: 6, 9: 5, 10: 7, 11: 9}


class Reference(ABC):
    """An angle over time with two known derivatives; `duration` [s] is when its last
    change ends.
    """

    __made_by__ = (
        "smooth_step, pulse, prbs, hold, SampledReference, two arrays (time, angle), or "
        "spline(time, f(time)) for a function"
    )

    duration: float

    @staticmethod
    def __made_of__(value: object) -> Reference | None:
        """A pair of arrays, times [s] and angles [rad], becomes the spline through
        them, from rest to rest.
        """
        if not isinstance(value, tuple) or len(value) != 2:
            return None
        if any(np.ndim(part) != 1 for part in value):
            return None
        return spline(*value)

    @abstractmethod
    def derivative(self, time: ArrayLike, order: int) -> Real:
        """Return the derivative of `order` 0, 1 or 2 [rad/s^order] at `time` [s], shape
        kept.
        """

    def angle(self, time: ArrayLike) -> Real:
        """Return the angle [rad] at `time` [s], shape kept."""
        return self.derivative(time, 0)

    def velocity(self, time: ArrayLike) -> Real:
        """Return the velocity [rad/s] at `time` [s], shape kept."""
        return self.derivative(time, 1)

    def acceleration(self, time: ArrayLike) -> Real:
        """Return the acceleration [rad/s²] at `time` [s], shape kept."""
        return self.derivative(time, 2)


@checked
@compared
@dataclass(frozen=True, eq=False)
class Path(Reference):
    """A piecewise polynomial: piece i holds from breaks[i] on, in powers of time −
    breaks[i].

    Before the first break, the constant of the first piece applies. A jump of the angle
    does not appear in the velocity: velocity and acceleration are those of the pieces.

    Parameters
    ----------
    kind
        what plots call it.
    breaks
        shape (n,) [s], rising.
    coefficients
        shape (n, m) [rad/s^j], lowest power first.
    duration
        when the last change ends [s].
    """

    kind: str
    breaks: Annotated[Real, Array(1, min_size=1)]
    coefficients: Annotated[Real, Array(2)]
    duration: float

    def derivative(self, time: ArrayLike, order: int) -> Real:
        """Return the derivative of `order` [rad/s^order] at `time` [s]."""
        t = np.asarray(time, float)
        # Continuous from the right: at a break the later piece applies, so a step at t
        # = 0 is complete at t = 0.
        piece = np.clip(np.searchsorted(self.breaks, t, side="right") - 1, 0, None)
        local = np.maximum(t - self.breaks[piece], 0.0)
        value = np.zeros_like(local)
        for power in range(self.coefficients.shape[1] - 1, order - 1, -1):
            # Horner's rule on the coefficients of the derivative, j!/(j − k)! a_j, is
            # exact; differences of the angle would lose half of the digits at each
            # order.
            value = (
                value * local
                + math.perm(power, order) * self.coefficients[piece, power]
            )
        return value

    def then(self, later: Path) -> Path:
        """Return this path followed by `later`, whose angles add to the last angle of
        this one.
        """
        end = float(self.angle(self.duration))
        width = max(self.coefficients.shape[1], later.coefficients.shape[1])
        first, second = (
            np.pad(p.coefficients, ((0, 0), (0, width - p.coefficients.shape[1])))
            for p in (self, later)
        )
        # The last piece of this path, at rest, is kept until the second path starts, and
        # dropped if that starts at 0.
        keep = (
            self.breaks <= self.duration
            if later.breaks[0] > 0
            else self.breaks < self.duration
        )
        return Path(
            f"{self.kind}, {later.kind}",
            np.concatenate([self.breaks[keep], self.duration + later.breaks]),
            # Angles add up: only the constant of each later piece changes.
            np.concatenate([first[keep], second + np.eye(1, width) * end]),
            self.duration + later.duration,
        )


@checked
@compared
@dataclass(frozen=True, eq=False)
class SampledReference(Reference):
    """A table: angle, velocity and acceleration at 0, period, 2 period …, interpolated
    linearly between the rows.

    At the period of a law, nothing is interpolated and the law gets the table's own
    numbers. Before and after the table its first and last angle hold.

    Parameters
    ----------
    period
        between two rows [s], > 0.
    values
        shape (3, N): angle [rad], velocity [rad/s], acceleration [rad/s²]; N >= 2.
    duration
        of the table, (N − 1) period [s].

    Raises
    ------
    FieldError
        a value out of its range, or not three rows.

    Examples
    --------
    >>> import fraclink as fl
    >>> table = fl.extend.SampledReference(0.004, [[0.0, 0.1, 0.2], [25.0, 25.0, 25.0], [0.0, 0.0, 0.0]])
    >>> float(table.angle(0.006)), float(table.angle(1.0)), float(table.velocity(1.0)), table.duration
    (0.15000000000000002, 0.2, 0.0, 0.008)
    """

    period: Period
    values: Annotated[Real, Array(2)]
    duration: float = field(init=False)

    def __post_init__(self) -> None:
        shape = self.values.shape
        if shape[0] != 3 or not 2 <= shape[1] <= LONGEST:
            raise FieldError(
                "values",
                shape,
                "not a table",
                f"(3, 2 … {LONGEST})",
                "give rows of angle, velocity, acceleration",
            )
        object.__setattr__(self, "duration", self.period * (shape[1] - 1))

    def derivative(self, time: ArrayLike, order: int) -> Real:
        """Return the derivative of `order` [rad/s^order] at `time` [s]."""
        place, last = (
            np.asarray(time, float) / self.period,
            self.values.shape[1] - 1,
        )
        # k periods divided by the period is not always k; values on both sides of a
        # jump of the acceleration must not be mixed
        nearest = np.rint(place)
        place = np.where(np.isclose(place, nearest, rtol=0.0), nearest, place)
        value = np.interp(place, np.arange(last + 1), self.values[order])
        return (
            value if order == 0 else np.where((place < 0) | (place > last), 0.0, value)
        )


@checked
def spline(
    time: Annotated[Real, Array(1, min_size=2)],
    angle: Annotated[Real, Array(1, min_size=2)],
) -> Path:
    """Return the cubic spline through via points or samples, from rest at the first to
    rest at the last.

    Velocity and acceleration are continuous between the ends; of all paths through
    these points with both ends at rest, it has the least ∫θ̈².

    Parameters
    ----------
    time
        shape (N,) [s], rising, from 0 on or later.
    angle
        shape (N,) [rad].

    Raises
    ------
    FieldError
        two shapes, or times that do not rise.

    Examples
    --------
    >>> path = spline([0.0, 0.4, 1.0], [0.0, 0.7, 0.5])
    >>> float(path.angle(0.4)), float(path.velocity(1.0)), path.duration
    (0.7, 0.0, 1.0)
    """
    # imported late: parsers of logs then start in 0.2 s instead of 0.5 s
    from scipy.interpolate import (
        CubicSpline,
    )

    if time.shape != angle.shape:
        raise FieldError(
            "angle",
            angle.shape,
            "not one for each time",
            f"{time.shape}",
            "pair them",
        )
    if not (time[0] >= 0.0 and np.all(np.diff(time) >= _SHORTEST)):
        raise FieldError(
            "time",
            time[:3].tolist(),
            "not rising",
            "rising from 0 s on",
            "sort them, and leave repeated ones out",
        )
    # Clamped: at rest at both ends. SciPy stores the highest power first, a `Path` the
    # lowest.
    pieces = CubicSpline(time, angle, bc_type="clamped").c[::-1].T
    start, end = ([[value, 0.0, 0.0, 0.0]] for value in (angle[0], angle[-1]))
    # A spline that begins late is preceded by a piece at rest; otherwise the
    # acceleration at its first break would hold from t = 0 on.
    before = ([0.0], start) if time[0] > 0.0 else ([], np.empty((0, 4)))
    return Path(
        "spline",
        np.concatenate([before[0], time]),
        np.vstack([before[1], pieces, end]),
        float(time[-1]),
    )


@checked
def smooth_step(amplitude: Angle, duration: Length, start: Start = 0.0) -> Path:
    """Return a rest-to-rest move by the quintic θ = a(10x³ − 15x⁴ + 6x⁵), x = (t −
    start)/duration.

    Velocity and acceleration are continuous; their peaks are 1.875 a/T and 5.774 a/T².

    Parameters
    ----------
    amplitude
        a [rad].
    duration
        T > 0 [s].
    start
        ≥ 0 [s].

    Raises
    ------
    FieldError
        a value out of its range.

    Examples
    --------
    >>> move = smooth_step(1.0, 0.5)
    >>> float(move.angle(0.25)), float(move.velocity(0.25)), move.duration
    (0.5, 3.75, 0.5)
    """
    row = [amplitude * c / duration**power for power, c in enumerate(_QUINTIC)]
    rest = [amplitude] + [0.0] * 5
    return Path(
        "smooth step",
        np.array([start, start + duration]),
        np.array([row, rest]),
        start + duration,
    )


@checked
def pulse(amplitude: Angle, width: Length, start: Start = 0.0) -> Path:
    """Return a pulse of `amplitude` [rad] and `width` [s] > 0 with a jump at either
    end. One with smooth edges is two moves: ``smooth_step(…).then(smooth_step(…))``.

    >>> bool(pulse(1.0, 7.0).angle(3.0) == 1.0), float(pulse(1.0, 7.0).angle(7.5))
    (True, 0.0)
    """
    end = start + width
    return _steps("pulse", [0.0, start, end], [0.0, amplitude, 0.0], end)


@checked
def hold(angle: Angle, duration: Start = 0.0) -> Path:
    """Return a constant `angle` [rad] for `duration` [s] ≥ 0, and thereafter.

    >>> float(hold(0.3).angle(5.0))
    0.3
    """
    return _steps("hold", [0.0], [angle], duration)


@checked
def prbs(
    amplitude: Angle,
    bit: Length,
    *,
    bits: Annotated[int, Between(1, LONGEST)] = 127,
    register: Literal[3, 4, 5, 6, 7, 9, 10, 11] = 7,
    start: Start = 0.0,
) -> Path:
    """Return a pseudo-random binary sequence ±`amplitude` [rad] of `bits` bits of `bit`
    [s] each.

    A maximum-length shift register of `register` stages; its sequence repeats after
    2^register − 1 bits and has a flat spectrum up to about 0.44/bit [Hz]. The angle is
    0 before `start` [s] and after the end.

    >>> path = prbs(0.1, 0.2)
    >>> len(path.breaks), round(path.duration, 1)
    (128, 25.4)
    """
    # Any start except all zeros, which the register would never leave.
    stages, levels = [1] * register, []
    for _ in range(bits):
        levels.append(amplitude if stages[-1] else -amplitude)
        stages = [stages[-1] ^ stages[_TAPS[register] - 1], *stages[:-1]]
    times = [*(start + bit * np.arange(bits + 1))]
    before = ([0.0], [0.0]) if start > 0 else ([], [])
    return _steps(
        "prbs", before[0] + times, [*before[1], *levels, 0.0], start + bit * bits
    )


def sampled(reference: Reference, period: float, length: float | None = None) -> Real:
    """Return angle, velocity and acceleration at 0, period, 2 period ... up to `length`
    [s], shape (3, N); by default until 5 s after the reference's end.

    Raises SizeError above 2 000 000 samples, before memory is taken, and FieldError for
    a reference that is not finite.
    """
    length = reference.duration + SETTLE if length is None else length
    # The last instant counts even if the quotient is slightly too small by rounding:
    # 4.9 ms are 48.99999999999999 periods of 0.1 ms.
    count = math.floor(length / period * (1 + 1e-12)) + 1
    if count > LONGEST:
        raise SizeError(
            "duration",
            f"{count} samples ({48e-6 * count:.0f} MB)",
            "too long",
            f"<= {LONGEST} samples",
            "simulate a shorter time or a longer period",
        )
    time = period * np.arange(count)
    path = np.array([reference.derivative(time, order) for order in range(3)])
    if not np.all(np.isfinite(path)):
        raise FieldError(
            "reference",
            "NaN",
            "not finite",
            "finite",
            "check the reference",
        )
    return path


def _steps(kind: str, times: list[float], levels: list[float], duration: float) -> Path:
    return Path(kind, np.array(times), np.array(levels)[:, None], duration)
