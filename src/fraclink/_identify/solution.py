"""The least-squares point of one structure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._identify.shape import Shape

__all__ = ["Solution"]


@dataclass(frozen=True, eq=False)
class Solution:
    """The least-squares point of one structure: coordinates, linear parameters, Gram matrix there."""

    structure: str
    free: tuple[int, ...]
    shape: Shape
    gain: float
    offset: float
    cost: float
    gram: NDArray[np.float64]
    lower: Shape
    upper: Shape
    status: int
    evaluations: int

    @property
    def on_edge(self) -> bool:
        """Whether a D-FOM ended on ω₀ = 0, where it is the UD-FOM with λ = 2 − α."""
        other = float(self.shape[3])
        return (
            3 in self.free and other < 1 and self.shape[2] >= (1 - 1e-7) * math.tan(other * math.pi / 2) / 2
        )

    @property
    def at_bound(self) -> tuple[int, ...]:
        """Free coordinates that ended on a limit."""
        near = 1e-7 * (self.upper - self.lower)
        return tuple(
            i
            for i in self.free
            if self.shape[i] <= self.lower[i] + near[i] or self.shape[i] >= self.upper[i] - near[i]
        )
