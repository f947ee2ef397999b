"""Profile-likelihood intervals: how far a parameter can go while all others are fitted anew."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import (
    COORDINATE,
    NAMES,
    Shape,
    damping_and_square,
    largest_ratio,
    mask_of,
    model_gradients,
)

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_QUANTILE = 1.959963984540054  # of the normal distribution at 97.5 %
_DIRECT = {name: COORDINATE[name] for name in ("order", "damping_order", "delay")}


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


@dataclass(eq=False)
class _Profile:
    """Best cost at given values of one parameter; every point starts from the one before."""

    search: Search
    solution: Solution
    name: str

    def value(self, shape: Shape) -> float:
        if self.name in _DIRECT:
            return float(shape[_DIRECT[self.name]])
        damping, square = damping_and_square(shape)
        return damping if self.name == "damping" else math.sqrt(square)

    def limits(self) -> tuple[float, float]:
        if self.name in _DIRECT:
            i = _DIRECT[self.name]
            return float(self.solution.lower[i]), float(self.solution.upper[i])
        if self._frequency_is_resonance:
            return math.exp(self.solution.lower[1]), math.exp(self.solution.upper[1])
        return 0.0, math.inf

    def cost(self, value: float, near: Shape) -> tuple[float, Shape]:
        direct = _DIRECT.get(self.name, 1 if self._frequency_is_resonance else None)
        if direct is None:
            return self._constrained(value, near)
        start = near.copy()
        start[direct] = math.log(value) if direct == 1 else value
        others = [i for i in self.solution.free if i != direct]
        s = self.search
        result = s.kernel.solve(
            start[None, :], mask_of(others), self.solution.lower, self.solution.upper, s.gain, s.offset, 60
        )
        return (math.inf, near) if result[0] == 3 else (float(result[4]), result[1])

    @property
    def _frequency_is_resonance(self) -> bool:
        """Whether ω₀ is the coordinate Ω itself, which viscous damping does not move."""
        classical = self.solution.shape[0] == 2 and self.solution.shape[3] == 1
        return self.name == "natural_frequency" and classical and not {0, 3} & set(self.solution.free)

    def _constrained(self, value: float, near: Shape) -> tuple[float, Shape]:
        """Gauss–Newton steps on the surface where the parameter has this value."""
        free = [i for i in self.solution.free if i not in self.solution.at_bound]
        shape = near.copy()
        best = (math.inf, near)
        for _ in range(8):
            gram = self.search.kernel.gram(shape, mask_of(free))
            if gram is None:
                return best
            normal, slope, cost = reduced(gram, self.search)
            miss = value - self.value(shape)
            if abs(miss) < 1e-9 * max(abs(value), 1e-3) and cost >= best[0] * (1 - 1e-9):
                return best
            if abs(miss) < 1e-6 * max(abs(value), 1e-3):
                best = (cost, shape.copy())
            row = model_gradients(shape)[NAMES.index(self.name)]
            along = np.array([row[i] if i < 4 else 0.0 for i in free])
            shape[free] += _on_surface(normal, slope, along, miss)
            shape = np.clip(shape, self.solution.lower, self.solution.upper)
            if shape[3] < 1:  # beyond, ω₀² would be negative
                shape[2] = min(shape[2], largest_ratio(float(shape[3])))
        return best


def reduced(gram: Matrix, search: Search) -> tuple[Matrix, Vector, float]:
    """Normal matrix, slope and cost of the shape with gain and offset at their best."""
    linear = [c for c, v in ((1, search.gain), (2, search.offset)) if math.isnan(v)]
    fixed = np.array([1.0, -np.nan_to_num(search.gain), -np.nan_to_num(search.offset)])
    rest = gram[:, :3] @ fixed  # products of every column with what is left of the measurement
    best = np.linalg.solve(gram[np.ix_(linear, linear)], rest[linear]) if linear else np.zeros(0)
    gain = float(best[linear.index(1)]) if 1 in linear else search.gain
    residual = rest - gram[:, linear] @ best
    offset = float(best[linear.index(2)]) if 2 in linear else search.offset
    cost = float(
        residual[0] - gain * residual[1] * (1 not in linear) - offset * residual[2] * (2 not in linear)
    )
    inner = gram[3:, 3:]
    if linear:
        across = gram[np.ix_(range(3, gram.shape[0]), linear)]
        inner = inner - across @ np.linalg.solve(gram[np.ix_(linear, linear)], across.T)
    return gain**2 * inner, gain * residual[3:], cost


def _on_surface(normal: Matrix, slope: Vector, along: Vector, miss: float) -> Vector:
    """The Gauss–Newton step that moves the parameter by `miss`: a Lagrange multiplier borders the matrix."""
    size = normal.shape[0]
    system = np.zeros((size + 1, size + 1))
    system[:size, :size] = normal + 1e-10 * np.diag(np.diag(normal))
    system[:size, size] = system[size, :size] = along
    return np.asarray(np.linalg.lstsq(system, np.append(slope, miss), rcond=None)[0][:size])


def profile_interval(
    search: Search, solution: Solution, name: str, error: float, inflation: float
) -> Interval:
    """The 95 % interval of one parameter: n ln(cost/least cost) ≤ 1.96² × `inflation`.

    `error` is its standard error (where the search for the ends begins) and `inflation` the factor by
    which the residual's colour widens its variance.
    """
    profile = _Profile(search, solution, name)
    centre = profile.value(solution.shape)
    if solution.cost <= 1e-12 * solution.gram[0, 0]:  # a perfect fit: its likelihood is rounding noise
        return Interval(centre - _QUANTILE * error, centre + _QUANTILE * error, False, False)
    low, high = profile.limits()
    below, low_open = _end(profile, centre, -_QUANTILE * error, low, inflation)
    above, high_open = _end(profile, centre, _QUANTILE * error, high, inflation)
    return Interval(below, above, low_open, high_open)


def _end(profile: _Profile, centre: float, step: float, limit: float, inflation: float) -> tuple[float, bool]:
    """One end of an interval and whether it is open.

    The root of the log-likelihood is nearly straight (exactly so for a linear model), so that secants
    through it meet the quantile in two or three fits where bisection would take twenty.
    """
    samples, least = profile.search.window.samples, profile.solution.cost
    shape = profile.solution.shape
    inside, inside_root, outside, outside_root = centre, 0.0, math.nan, math.inf
    value = centre + step
    for _ in range(25):
        beyond = (limit - value) * step <= 0
        value = limit if beyond else value
        cost, near = profile.cost(value, shape)
        height = math.inf
        if math.isfinite(cost):
            height = math.sqrt(max(samples * math.log(max(cost / least, 1.0)) / inflation, 0.0))
        if abs(height - _QUANTILE) < 2e-3:  # a thousandth of the quantile: 0.01 % of the coverage
            return value, False
        if height < _QUANTILE:
            if beyond:
                return limit, True
            inside, inside_root, shape = value, height, near
        else:
            outside, outside_root = value, height
        if math.isnan(outside):
            ratio = _QUANTILE / inside_root if inside_root > 0 else 4.0
            value = centre + (inside - centre) * min(max(ratio, 1.05), 4.0)
        elif math.isfinite(outside_root):
            part = (_QUANTILE - inside_root) / (outside_root - inside_root)
            value = inside + (outside - inside) * min(max(part, 0.05), 0.95)
        else:  # no fit there at all: the secant has nothing to go by
            value = (inside + outside) / 2
        if abs(outside - inside) < 1e-9 * abs(centre):
            return outside, False
    return value, math.isnan(outside)
