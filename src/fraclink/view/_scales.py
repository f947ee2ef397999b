"""Scales of drawings: positions of values along a side, customary ticks, thinned
records.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._display import number
from fracsys.checks import Real

__all__ = ["POINTS", "Scale", "envelope", "nice_ticks"]


POINTS = 1000  # a line gets twice this many points; the page shows about 800 dots


def envelope(
    time: NDArray[Any], values: NDArray[Any], points: int = POINTS
) -> tuple[Real, Real]:
    """Return a record thinned to its smallest and largest value in each of `points`
    stretches.

    No peak is lost, and 100 000 samples draw as fast as 2 000.

    >>> t, y = envelope(np.arange(10_000.0), np.sin(np.arange(10_000.0)), 50)
    >>> len(t), bool(y.max() > 0.999)
    (100, True)
    """
    count = len(values)
    if count <= 2 * points:
        return time, values
    # Stretches equal in length to within one sample, each of at least two:
    # reduceat of an empty one would repeat its first value.
    edges = np.linspace(0, count, points + 1).astype(int)[:-1]
    low, high = np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)
    # With the smallest value always first, a falling stretch would be drawn as a saw
    # tooth; the first value of a stretch determines the order.
    rising = values[edges] <= (low + high) / 2
    first, second = np.where(rising, low, high), np.where(rising, high, low)
    middle = np.append(edges[1:], count)
    half = (edges + middle) // 2
    return np.column_stack([time[edges], time[half]]).ravel(), np.column_stack(
        [first, second]
    ).ravel()


@dataclass(frozen=True)
class Scale:
    """Values from `low` to `high` along a side of a panel, on a logarithmic scale if
    `log`.

    ticks: positions with their labels; chosen automatically by default.
    """

    low: float
    high: float
    log: bool = False
    ticks: tuple[tuple[float, str], ...] | None = None

    def share(self, values: ArrayLike) -> Real:
        """The relative position of values between the ends: 0 to 1."""
        at, ends = np.asarray(values, float), np.array([self.low, self.high])
        # Outside the domain of a logarithmic scale the share is −∞ or NaN, which paths
        # leave out as a gap.
        if self.log:
            with np.errstate(divide="ignore", invalid="ignore"):
                at, ends = np.log(at), np.log(ends)
        return (at - ends[0]) / (ends[1] - ends[0])

    def marks(self, most: int) -> tuple[tuple[float, str], ...]:
        """Positions and labels of at most about `most` ticks."""
        if self.ticks is not None:
            return self.ticks
        return (
            _decades(self.low, self.high, most)
            if self.log
            else nice_ticks(self.low, self.high, most)
        )

    @classmethod
    def around(
        cls,
        *values: ArrayLike,
        least: float = 0.0,
        room: float = 0.06,
        log: bool = False,
    ) -> Scale:
        """A scale that shows all finite values with some margin, with a span of at
        least `least`.
        """
        every = np.concatenate([np.asarray(value, float).ravel() for value in values])
        every = every[np.isfinite(every)]
        low, high = (
            (float(every.min()), float(every.max())) if every.size else (0.0, 1.0)
        )
        # A constant signal would have its rounding stretched over the whole panel, with
        # ticks that all look alike: it gets a twentieth of its value on either side, or
        # 1 if the value is zero.
        still = 0.05 * abs(high) or 1.0 if high - low <= 1e-9 * abs(high) else 0.0
        spare = max(0.5 * (least - (high - low)), room * (high - low), still)
        return cls(low - spare, high + spare, log)


def nice_ticks(low: float, high: float, most: int) -> tuple[tuple[float, str], ...]:
    """Positions at multiples of 1, 2, 2.5 or 5 times a power of ten.

    >>> nice_ticks(0.0, 1.0, 5)
    ((0.0, '0'), (0.2, '0.2'), (0.4, '0.4'), (0.6, '0.6'), (0.8, '0.8'), (1.0, '1'))
    """
    # 20 covers a rough step that rounding puts just above 10 times its power; 0.999
    # allows exactly `most` steps.
    rough = (high - low) / max(most, 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(
        power * factor
        for factor in (1, 2, 2.5, 5, 10, 20)
        if power * factor >= 0.999 * rough
    )
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    # Twelve significant digits instead of twelve decimals, so that a residual of 1e-13
    # N·m also has ticks.
    values = [float(f"{k * step:.12g}") for k in range(first, last + 1)]
    return tuple((value, _text(value, step)) for value in values)


def _text(value: float, step: float) -> str:
    """The label of a tick, with the digits that distinguish it from its neighbours."""
    if not value:
        return "0"
    if 1e-4 <= step < 1e5:
        return f"{value:.6f}".rstrip("0").rstrip(".").replace("-", "−")
    # Two digits for the step (2.5), and one more for each decade of the value above it.
    return number(
        value, 2 + math.floor(math.log10(abs(value))) - math.floor(math.log10(step))
    )


def _decades(low: float, high: float, most: int) -> tuple[tuple[float, str], ...]:
    """Powers of ten, and 2 and 5 times them if there are few."""
    span = math.log10(high / low)
    # 2 and 5 are spaced about evenly between powers on a logarithmic scale; three ticks
    # per decade must still be about as few as requested.
    factors = (1, 2, 5) if 3 * span < 1.2 * most else (1,)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    values = [factor * 10.0**power for power in powers for factor in factors]
    inside = [v for v in values if low * (1 - 1e-9) <= v <= high * (1 + 1e-9)]
    # Over many decades every second or third power, since all of them would overlap.
    return tuple((v, _text(v, v)) for v in inside[:: 1 + len(inside) // (most + 3)])
