"""Profile-likelihood intervals: how far a parameter can go while all others are fitted anew."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, TypeVar

__all__ = ["QUANTILE", "Interval", "Profile", "interval_end"]

Near = TypeVar("Near")

QUANTILE = 1.959963984540054  # of the normal distribution at 97.5 %


@dataclass(frozen=True)
class Interval:
    """A 95 % interval; an open end is a limit of the parameter's range that the log does not exclude.

    >>> Interval(1.91, 1.93, False, False).contains(1.92)
    True
    """

    low: float
    high: float
    low_open: bool
    high_open: bool

    def contains(self, value: float) -> bool:
        """Whether `value` lies in the interval."""
        return self.low <= value <= self.high


class Profile(Protocol[Near]):
    """The best cost at given values of one parameter; `Near` is where the search at the next value begins."""

    @property
    def samples(self) -> int:
        """Number of samples."""
        ...

    @property
    def least(self) -> float:
        """Cost of the fit."""
        ...

    @property
    def begin(self) -> Near:
        """Where the fit stands."""
        ...

    def cost(self, value: float, near: Near) -> tuple[float, Near]:
        """The best cost at a value, and where it is reached."""
        ...


def interval_end(
    profile: Profile[Near], centre: float, step: float, limit: float, inflation: float
) -> tuple[float, bool]:
    """One end of an interval and whether it is open; `step` is where it is expected, from the centre.

    The root of the log-likelihood is nearly straight (exactly so for a linear model), so that secants
    through it meet the quantile in two or three fits where bisection would take twenty.
    """
    samples, least, shape = profile.samples, profile.least, profile.begin
    inside, inside_root, outside, outside_root = centre, 0.0, math.nan, math.inf
    value = centre + step
    for _ in range(25):
        beyond = (limit - value) * step <= 0
        value = limit if beyond else value
        cost, near = profile.cost(value, shape)
        height = math.inf
        if math.isfinite(cost):
            height = math.sqrt(max(samples * math.log(max(cost / least, 1.0)) / inflation, 0.0))
        if abs(height - QUANTILE) < 2e-3:  # a thousandth of the quantile: 0.01 % of the coverage
            return value, False
        if height < QUANTILE:
            if beyond:
                return limit, True
            inside, inside_root, shape = value, height, near
        else:
            outside, outside_root = value, height
        if math.isnan(outside):
            ratio = QUANTILE / inside_root if inside_root > 0 else 4.0
            value = centre + (inside - centre) * min(max(ratio, 1.05), 4.0)
        elif math.isfinite(outside_root):
            part = (QUANTILE - inside_root) / (outside_root - inside_root)
            value = inside + (outside - inside) * min(max(part, 0.05), 0.95)
        else:  # no fit there at all: the secant has nothing to go by
            value = (inside + outside) / 2
        if abs(outside - inside) < 1e-9 * abs(centre):
            return outside, False
    return value, math.isnan(outside)
