"""The least-squares problem of a link: the compiled kernel's, for many shapes at once."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import structure
from fraclink._identify.problem import Quadratic, reduced
from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import (
    COORDINATE,
    NAMES,
    columns_of,
    link_parameters,
    mask_of,
)
from fraclink._kernels import FitProblem

__all__ = ["LinkProblem", "quadratic_of"]

Reals = NDArray[np.float64]


def quadratic_of(
    kernel: FitProblem, shapes: Reals, chain: Reals, gain: float, offset: float
) -> Quadratic:
    """The quadratic model of shapes (M, 5) that coordinates move by `chain` (M, 5, p);
    gain and offset are free where they are not numbers.
    """
    moving = [k for k in range(5) if np.any(chain[:, k])]
    grams = kernel.grams(np.ascontiguousarray(shapes), mask_of(moving))
    limits = (-math.inf, math.inf) if math.isnan(gain) else (gain, gain)
    found, part = reduced(grams, limits, offset), chain[:, moving]
    return replace(
        found,
        slope=np.einsum("mkp,mk->mp", part, found.slope),
        normal=part.transpose(0, 2, 1) @ found.normal @ part,
    )


@dataclass(frozen=True, eq=False)
class LinkProblem:
    """A search's problem around a solution: the `free` coordinates of a shape, all
    others as they are there.

    On the edge ω₀ = 0 of fractional damping the damping ratio follows α where the
    others are inside their limits; an interval may leave that edge.
    """

    search: Search
    solution: Solution
    free: tuple[int, ...]
    edge: bool

    @classmethod
    def of(
        cls,
        search: Search,
        solution: Solution,
        *,
        inside: bool,
        along: bool | None = None,
    ) -> LinkProblem:
        """With all coordinates that are free in the structure, or those `inside` their
        limits only; `along` the edge or off it, by default along it where inside.
        """
        stuck = solution.at_bound if inside else ()
        along = inside if along is None else along
        edge = along and solution.on_edge and not {2, 3} & set(stuck)
        free = [i for i in solution.free if i not in stuck and not (edge and i == 2)]
        return cls(search, solution, tuple(free), edge)

    @property
    def place(self) -> Reals:
        """The solution's coordinates."""
        return self.solution.shape[list(self.free)]

    @cached_property
    def low(self) -> Reals:
        """As of `Problem`."""
        return self.solution.lower[list(self.free)]

    @cached_property
    def high(self) -> Reals:
        """As of `Problem`."""
        return self.solution.upper[list(self.free)]

    @property
    def reach(self) -> Reals:
        """As of `Problem`."""
        return np.full(len(self.free), math.inf)

    @property
    def names(self) -> tuple[str, ...]:
        """The link's parameters, and the delay, that these coordinates move."""
        own = (*structure(self.solution.structure).free, "delay")
        return tuple(
            name
            for name in own
            if (COORDINATE[name] in self.free or (self.edge and name == "damping"))
            # At ω₀ = 0 it is no parameter: the link is the undamped one with λ = 2 − α.
            and not (self.edge and name == "natural_frequency")
        )

    def expanded(self, places: Reals) -> tuple[Reals, Reals]:
        """Shapes (M, 5) and their derivatives by the coordinates (M, 5, p)."""
        shapes = np.repeat(self.solution.shape[None, :], len(places), axis=0)
        shapes[:, list(self.free)] = places
        chain = np.zeros((len(places), 5, len(self.free)))
        chain[:, list(self.free), range(len(self.free))] = 1.0
        if self.edge:
            turn = shapes[:, 3] * math.pi / 2
            shapes[:, 2] = np.tan(turn) / 2
            chain[:, 2, self.free.index(3)] = math.pi / 4 / np.cos(turn) ** 2
        return shapes, chain

    def clip(self, places: Reals) -> Reals:
        """As of `Problem`; beyond the largest damping ratio ω₀² would be negative."""
        places = np.clip(places, self.low, self.high)
        if 2 in self.free:
            shapes = self.expanded(places)[0]
            column, below = self.free.index(2), shapes[:, 3] < 1
            most = np.where(
                below, np.tan(np.minimum(shapes[:, 3], 1) * math.pi / 2) / 2, np.inf
            )
            places[:, column] = np.minimum(places[:, column], most)
        return places

    def costs(self, places: Reals) -> Reals:
        """As of `Problem`."""
        own = self.search
        return own.kernel.costs(self.expanded(places)[0], own.gain, own.offset)

    def quadratic(self, places: Reals) -> Quadratic:
        """As of `Problem`."""
        own = self.search
        return quadratic_of(own.kernel, *self.expanded(places), own.gain, own.offset)

    def parameters(self, places: Reals, names: tuple[str, ...]) -> tuple[Reals, Reals]:
        """Values (M, q) of parameters and their derivatives by the coordinates, shape
        (M, q, p).
        """
        shapes, chain = self.expanded(places)
        values, slopes = link_parameters(shapes)
        # ω₀ is the root of what the shape has; at zero its slope is infinite.
        values[:, 0] = np.sqrt(values[:, 0])
        slopes[:, 0] /= 2 * np.maximum(values[:, :1], 1e-6)
        rows = [NAMES.index(name) for name in names]
        return values[:, rows], slopes[:, rows] @ chain

    def linearised(self) -> tuple[Reals, Reals]:
        """∂(output)/∂(coordinates, then gain and offset where they are free), shape (q,
        n), and the residual (n,).
        """
        own, at = self.search, self.solution
        chain = self.expanded(self.place[None, :])[1][0]
        moving = [k for k in range(5) if np.any(chain[k])]
        raw = columns_of(own.kernel, at.shape, mask_of(moving))
        residual = own.window.output - at.gain * raw[0] - at.offset
        rows = [*(at.gain * chain[moving].T @ raw[1:])]
        linear = {"gain": raw[0], "offset": np.ones(residual.size)}
        return np.array([*rows, *(linear[n] for n in self.linear)]), residual

    @property
    def linear(self) -> tuple[str, ...]:
        """Linear parameters that are free."""
        free = {"gain": self.search.gain, "offset": self.search.offset}
        return tuple(name for name, value in free.items() if math.isnan(value))
