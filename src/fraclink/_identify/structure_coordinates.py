"""The free parameters of a structure as coordinates of a search."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._identify.expression import Expression

__all__ = ["COEFFICIENT_LIMITS", "ORDER_LIMITS", "StructureCoordinates"]

Reals = NDArray[np.float64]
Limits = tuple[float, float]

ORDER_LIMITS = (0.02, 4.0)
COEFFICIENT_LIMITS = (1e-12, 1e12)


@dataclass(frozen=True, eq=False)
class StructureCoordinates:
    """The free parameters as coordinates: logarithms where the range is positive, else the value itself."""

    structure: Expression
    limits: Mapping[str, Limits]
    fixed: Mapping[str, float]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All free parameters."""
        return tuple(name for name in self.structure.names if name not in self.fixed)

    @cached_property
    def gain(self) -> str | None:
        """The free coefficient that multiplies the whole, projected out; None where there is none."""
        points = np.exp(1j * np.array([0.3, 0.9, 1.4])) * np.array([0.5, 1.1, 2.3])
        values = self.values(self.middle()[None, :], projected=False)
        once = self.structure.response(values, points)
        for name in self.structure.of_role("coefficient"):
            if name in self.names:
                twice = self.structure.response({**values, name: 2.0 * values[name]}, points)
                if np.allclose(twice, 2.0 * once, rtol=1e-12, atol=0.0):
                    return name
        return None

    @cached_property
    def moving(self) -> tuple[str, ...]:
        """Free parameters that are coordinates of the search: all but the gain."""
        return tuple(name for name in self.names if name != self.gain)

    def is_logarithmic(self, name: str) -> bool:
        """Whether the coordinate is the logarithm."""
        return self.structure.roles[name] == "coefficient" and self.limits[name][0] > 0.0

    def place(self, name: str, value: Any) -> Any:
        """The coordinate of a value."""
        return np.log(value) if self.is_logarithmic(name) else value

    def value(self, name: str, place: Any) -> Any:
        """The value at a coordinate."""
        return np.exp(place) if self.is_logarithmic(name) else place

    def middle(self) -> Reals:
        """Some place inside the limits of all free parameters, unlike each other, so that nothing cancels."""
        found = []
        for k, name in enumerate(self.names):
            low, high = (self.place(name, x) for x in self.limits[name])
            found.append(float(np.clip(0.6 + 0.17 * k, low, high)))
        return np.array(found)

    def box(self, names: tuple[str, ...]) -> tuple[Reals, Reals]:
        """Lower and upper limits of coordinates."""
        rows = [[float(self.place(name, x)) for x in self.limits[name]] for name in names]
        ends = np.array(rows).reshape(-1, 2)
        return ends[:, 0], ends[:, 1]

    def shear(self, scale: float) -> Reals:
        """Coordinates in which coefficients count at the frequency `scale` [rad/s], shape (p, p).

        In c·s^n a higher order far from 1 rad/s is a smaller coefficient: c and n trade along a long narrow
        valley that is nothing but the unit of time. ln c + n ln ω lies across it. The pairs are those with
        ∂G/∂n = ± ln s · ∂G/∂ln c, whatever the expression.
        """
        result = np.eye(len(self.moving))
        points = np.exp(1j * np.array([0.3, 0.9, 1.4])) * np.array([0.5, 1.1, 2.3])
        values = self.values(self.middle()[None, :], projected=False)
        slopes = {name: self._slope(name, values, points) for name in self.moving}
        for row, one in enumerate(self.moving):
            for column, other in enumerate(self.moving):
                if self.is_logarithmic(one) and self.structure.roles[other] == "order":
                    ratio = slopes[other] / (slopes[one] * np.log(points))
                    if np.allclose(ratio, np.round(ratio[0].real), atol=1e-5) and round(ratio[0].real):
                        result[row, column] = round(ratio[0].real) * math.log(scale)
        return result

    def _slope(self, name: str, values: Mapping[str, Reals], points: NDArray[np.complex128]) -> Any:
        """∂G/∂ln c of a coefficient, ∂G/∂n of an order."""
        step = 1e-5 * (values[name] if self.is_logarithmic(name) else 1.0)
        ends = (
            self.structure.response({**values, name: values[name] + sign * step}, points) for sign in (1, -1)
        )
        above, below = ends
        return np.ravel((above - below) / 2e-5) + 1e-300

    def values(self, places: Reals, *, projected: bool = True) -> dict[str, Reals]:
        """Parameters (M, 1) at places (M, p); the projected gain is 1."""
        names = self.moving if projected else self.names
        found: dict[str, Reals] = {name: np.array([[value]]) for name, value in self.fixed.items()}
        if projected and self.gain is not None:
            found[self.gain] = np.ones((1, 1))
        for k, name in enumerate(names):
            found[name] = self.value(name, places[:, k : k + 1])
        return found
