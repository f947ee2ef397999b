"""The least-squares problem of a link, evaluated by the compiled kernel for many shapes
at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import compress

import numpy as np

from fraclink._arm.link import STRUCTURES
from fraclink._identify.problem import Problem, Quadratic
from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import (
    ALPHA_LIMITS,
    COORDINATE,
    NAMES,
    columns_of,
    largest_ratio,
    link_parameters,
    mask_of,
)
from fraclink._kernels import FitProblem
from fracsys._precision import RESOLUTION
from fracsys.checks import Real


def quadratic_of(
    kernel: FitProblem, shapes: Real, chain: Real, gain: float, offset: float
) -> Quadratic:
    """The quadratic model of shapes (M, 5) with the derivatives `chain` (M, 5, p) with
    respect to the coordinates; gain and offset are free if NaN.
    """
    moving = np.flatnonzero(chain.any(axis=(0, 2))).tolist()
    part = chain[:, moving]
    # Products of [measured, response, constant, derivatives of the response].
    gram = kernel.grams(np.ascontiguousarray(shapes), mask_of(moving))
    if math.isnan(offset):
        # All signals relative to their means.
        mean = gram[:, 2] / gram[:, 2, 2:3]
        gram = gram - mean[:, :, None] * gram[:, 2][:, None, :]
    level = np.nan_to_num(offset)
    products = gram[:, 0] - level * gram[:, 2]  # products with measured − offset
    across, normal = gram[:, 3:, 1], gram[:, 3:, 3:]
    best = np.full(len(gram), gain)
    if math.isnan(gain):
        power = np.maximum(gram[:, 1, 1], 1e-300)
        best = np.nan_to_num(products[:, 1] / power)
        projection = across[:, :, None] * across[:, None, :]
        normal = normal - projection / power[:, None, None]
    rest = products - best[:, None] * gram[:, 1]
    cost = rest[:, 0] - level * rest[:, 2] - best * rest[:, 1]
    return Quadratic(
        np.where(np.isfinite(cost), np.maximum(cost, 0.0), np.inf),
        np.einsum("mkp,mk->mp", part, best[:, None] * rest[:, 3:]),
        part.transpose(0, 2, 1) @ (best[:, None, None] ** 2 * normal) @ part,
    )


def _stiffening(order: float) -> float:
    """r/ζ, with r the damping's share of the stiffness at the resonance."""
    return 2 / math.tan(order * math.pi / 2)


@dataclass(frozen=True, eq=False)
class LinkProblem(Problem):
    """A search's problem around a solution: the `free` coordinates of a shape, with all
    others held.

    If ζ and α are both free, r = 2ζ cot(απ/2) replaces α: the fractional damping is
    Ω^λ (r + 2iζ) at the resonance and ω₀² = Ω^λ (1 − r), so that the edge ω₀ = 0 is the
    limit r = 1, and the valley of equal ζ is straight.
    """

    search: Search
    solution: Solution
    free: tuple[int, ...]
    turned: bool

    @classmethod
    def of(cls, search: Search, solution: Solution, *, inside: bool) -> LinkProblem:
        """With all coordinates that are free in the structure, or only those `inside`
        their limits, one of which is the edge ω₀ = 0.
        """
        stuck = set(solution.at_bound) if inside else set()
        turned = {2, 3} <= set(solution.free) - stuck
        # Off the edge the coordinate is α itself: with a coloured residual the
        # covariance is widened per coordinate (see `_sandwich` of uncertainty.py).
        turned = turned and (not inside or solution.on_edge)
        if inside and turned:
            stuck.add(3)
        free = [i for i in solution.free if i not in stuck]
        return cls(search, solution, tuple(free), turned)

    @cached_property
    def _start(self) -> Real:
        """The shape of the solution, with r in place of α if the problem uses it."""
        start = self.solution.shape.copy()
        if self.turned:
            start[3] = min(start[2] * _stiffening(start[3]), 1.0)
        return start

    @property
    def place(self) -> Real:
        """The solution's coordinates."""
        return self._start[list(self.free)]

    @cached_property
    def box(self) -> tuple[Real, Real]:
        """See `Problem`."""
        low, high = self.solution.lower.copy(), self.solution.upper.copy()
        if self.turned:
            # Without damping α has no meaning, and any value will do.
            low[3] = (self.solution.shape[2] or 1.0) * _stiffening(ALPHA_LIMITS[1])
            high[3] = 1.0
        elif self.solution.shape[3] < 1:
            # Beyond the largest damping ratio ω₀² would be negative.
            high[2] = min(high[2], largest_ratio(float(self.solution.shape[3])))
        return low[list(self.free)], high[list(self.free)]

    @property
    def measured(self) -> Real:
        """See `Problem`."""
        return self.search.window.output

    @property
    def names(self) -> tuple[str, ...]:
        """The link's parameters, including the delay, that depend on these coordinates."""
        own = (*STRUCTURES[self.solution.structure].free, "delay")
        edge = self.turned and 3 not in self.free
        return tuple(
            name
            for name in own
            if (COORDINATE[name] in self.free or (edge and name == "damping_order"))
            # At ω₀ = 0 it is not a parameter: the link is the undamped one with λ = 2 −
            # α.
            and not (edge and name == "natural_frequency")
        )

    def expanded(self, places: Real) -> tuple[Real, Real]:
        """Shapes (M, 5) and their derivatives with respect to the coordinates (M, 5,
        p).
        """
        shapes, chain = np.empty((len(places), 5)), np.empty((len(places), 5, 5))
        shapes[:], chain[:] = self._start, np.eye(5)
        shapes[:, list(self.free)] = places
        if self.turned:
            share = shapes[:, 3].copy()
            # Below this ζ, α has no meaning.
            double = 2 * np.maximum(shapes[:, 2], RESOLUTION)
            square = math.pi / 2 * (double**2 + share**2)
            shapes[:, 3] = 2 / math.pi * np.arctan2(double, share)
            chain[:, 3, 2], chain[:, 3, 3] = 2 * share / square, -double / square
        return shapes, chain[:, :, list(self.free)]

    def clip(self, places: Real) -> Real:
        """See `Problem`: the range of r follows from that of α at each damping
        ratio."""
        places = super().clip(places)
        if self.turned and 3 in self.free:
            ratio, column = places[:, self.free.index(2)], self.free.index(3)
            most, least = (ratio * _stiffening(order) for order in ALPHA_LIMITS)
            places[:, column] = np.clip(places[:, column], least, most)
        return places

    def quadratic(self, places: Real) -> Quadratic:
        """See `Problem`."""
        own = self.search
        return quadratic_of(own.kernel, *self.expanded(places), *own.known)

    def parameters(
        self, places: Real, names: tuple[str, ...], *, squared: bool = False
    ) -> tuple[Real, Real]:
        """Values (M, q) of parameters, with ω₀² for ω₀ if `squared`, and their
        derivatives with respect to the coordinates, shape (M, q, p).
        """
        shapes, chain = self.expanded(places)
        values, slopes = link_parameters(shapes)
        # ω₀ is the square root of a quantity of the shape; at zero its slope is
        # infinite.
        if not squared:
            values[:, 0] = np.sqrt(values[:, 0])
            slopes[:, 0] /= 2 * np.maximum(values[:, :1], 1e-6)
        rows = [NAMES.index(name) for name in names]
        return values[:, rows], slopes[:, rows] @ chain

    @cached_property
    def _weights(self) -> Real:
        """Matrix (q, 2 + k) that forms ∂(output)/∂(coordinates, then gain and offset if
        free) from the response, a constant and the derivatives along the structure's
        coordinates.
        """
        chain = self.expanded(self.place[None, :])[1][0, list(self.solution.free)]
        weights = np.zeros((len(self.free) + 2, 2 + len(chain)))
        weights[:-2, 2:] = self.solution.gain * chain.T
        weights[-2:, :2] = np.eye(2)
        return weights[[True] * len(self.free) + [*np.isnan(self.search.known)]]

    @property
    def normal(self) -> Real:
        """The normal matrix (q, q) of the coordinates, then gain and offset if free."""
        return self._weights @ self.solution.gram[1:, 1:] @ self._weights.T

    def linearised(self) -> tuple[Real, Real]:
        """∂(output)/∂(coordinates, then gain and offset if free), shape (q, n), and the
        residual (n,).
        """
        own, at = self.search, self.solution
        raw = columns_of(own.kernel, at.shape, mask_of(at.free))
        residual = own.window.output - at.gain * raw[0] - at.offset
        return self._weights @ np.insert(raw, 1, 1.0, axis=0), residual

    @property
    def linear(self) -> tuple[str, ...]:
        """Linear parameters that are free."""
        return tuple(compress(("gain", "offset"), np.isnan(self.search.known)))
