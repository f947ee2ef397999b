"""A structure's free parameters as coordinates, and its least-squares problem."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._identify.expression import Expression
from fraclink._identify.problem import Quadratic, reduced
from fraclink._identify.structure_data import Samples

__all__ = [
    "COEFFICIENT_LIMITS",
    "GENERAL_POINTS",
    "ORDER_LIMITS",
    "StructureCoordinates",
    "StructureProblem",
]

Reals = NDArray[np.float64]
Limits = tuple[float, float]

# Below 0.02 a term is a constant over any band that can be measured; above 4 no
# fractional model of a machine is known, and `bounds` admits one. Coefficients of
# either sign in any unit: 24 decades, as a range in the logarithm costs nothing.
ORDER_LIMITS = (0.02, 4.0)
COEFFICIENT_LIMITS = (-1e12, 1e12)
_LEAST = 1e-12  # size of a coefficient of either sign
# Three points s in general position: two functions of one form that agree there agree
# everywhere.
GENERAL_POINTS = np.exp(1j * np.array([0.3, 0.9, 1.4])) * np.array([0.5, 1.1, 2.3])


@dataclass(frozen=True, eq=False)
class StructureCoordinates:
    """The free parameters as coordinates: of a coefficient of one sign the logarithm of
    its size, else the value itself.

    `signs` are those of the coefficients whose range has both; the gain, a coefficient
    that multiplies the whole, is no coordinate where it is `projected` out.
    """

    structure: Expression
    limits: Mapping[str, Limits]
    fixed: Mapping[str, float]
    signs: Mapping[str, float] = field(default_factory=dict)
    projected: bool = True

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All free parameters."""
        return tuple(name for name in self.structure.names if name not in self.fixed)

    @cached_property
    def gain(self) -> str | None:
        """The free coefficient that multiplies the whole; None where there is none."""
        values = self.middle()
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
        """Free parameters that are coordinates."""
        return tuple(
            name for name in self.names if not (self.projected and name == self.gain)
        )

    def has_both_signs(self, name: str) -> bool:
        """Whether a coefficient's sign is open: no range was given for it."""
        return (
            self.structure.roles[name] == "coefficient"
            and self.limits[name] == COEFFICIENT_LIMITS
        )

    def is_logarithmic(self, name: str) -> bool:
        """Whether the coordinate is a logarithm."""
        return self.structure.roles[name] == "coefficient" and (
            self.limits[name][0] > 0.0 or self.has_both_signs(name)
        )

    def place(self, name: str, value: Any) -> Any:
        """The coordinate of a value."""
        return (
            np.log(np.maximum(np.abs(value), 1e-300))
            if self.is_logarithmic(name)
            else value
        )

    def value(self, name: str, place: Any) -> Any:
        """The value at a coordinate."""
        return (
            self.signs.get(name, 1.0) * np.exp(place)
            if self.is_logarithmic(name)
            else place
        )

    def middle(self) -> dict[str, Any]:
        """Values inside the limits, so unlike each other that nothing cancels."""
        found: dict[str, Any] = {n: np.array([[v]]) for n, v in self.fixed.items()}
        for k, name in enumerate(self.names):
            low, high = self.box_of(name)
            # 0.6, 0.77, 0.94 …: no two alike and no sum of two of them another.
            place = float(np.clip(0.6 + 0.17 * k, low, high))
            # Positive, whatever the signs: a negative base has no real powers.
            value = math.exp(place) if self.is_logarithmic(name) else place
            found[name] = np.array([[value]])
        return found

    def box_of(self, name: str) -> Limits:
        """Lower and upper limit of a coordinate."""
        low, high = self.limits[name]
        if self.has_both_signs(name):
            low = _LEAST
        return float(self.place(name, low)), float(self.place(name, high))

    def values(self, places: Reals) -> dict[str, Any]:
        """Parameters (M, 1) at places (M, p); a projected gain is 1."""
        found: dict[str, Any] = {n: np.array([[v]]) for n, v in self.fixed.items()}
        if self.projected and self.gain is not None:
            found[self.gain] = np.ones((len(places), 1))
        for k, name in enumerate(self.moving):
            found[name] = self.value(name, places[:, k : k + 1])
        return found


# --- the problem ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class StructureProblem:
    """The least-squares problem of a structure; `offset` is None where it is free."""

    own: StructureCoordinates
    data: Samples
    offset: float | None

    @cached_property
    def low(self) -> Reals:
        """As of `Problem`."""
        return np.array([self.own.box_of(name)[0] for name in self.own.moving])

    @cached_property
    def high(self) -> Reals:
        """As of `Problem`."""
        return np.array([self.own.box_of(name)[1] for name in self.own.moving])

    @cached_property
    def reach(self) -> Reals:
        """As of `Problem`."""
        own = self.own
        return np.array(
            [1.0 if own.is_logarithmic(n) else math.inf for n in own.moving]
        )

    def clip(self, places: Reals) -> Reals:
        """As of `Problem`."""
        return np.clip(places, self.low, self.high)

    def costs(self, places: Reals) -> Reals:
        """As of `Problem`."""
        return self._projected(places, ())[0].cost

    def quadratic(self, places: Reals) -> Quadratic:
        """As of `Problem`."""
        found, columns, residual = self._projected(places, self.own.moving)
        # From the residual itself: through a Gram matrix a perfect fit would lose half
        # of its digits.
        slope = np.einsum("mpr,mr->mp", columns[:, 1:], residual)
        return replace(found, slope=found.gain[:, None] * np.nan_to_num(slope))

    def linearised(self, place: Reals) -> tuple[Reals, Reals]:
        """∂(measured)/∂(coordinates, then the offset where it is free), shape (q, R),
        and the residual (R,), where the gain is a coordinate.
        """
        _, columns, residual = self._projected(place[None, :], self.own.moving)
        rows = columns[0, 1:]
        if self.data.constant is not None and self.offset is None:
            rows = np.concatenate([rows, self.data.constant[None, :]])
        return rows, residual[0]

    def _projected(
        self, places: Reals, names: tuple[str, ...]
    ) -> tuple[Quadratic, Reals, Reals]:
        """The quadratic model, the columns by the coordinates, the residuals."""
        own, data = self.own, self.data
        values = own.values(places)
        columns = data.columns(own.structure, values, names)
        for k, name in enumerate(names):
            if own.is_logarithmic(name):
                columns[:, 1 + k] *= values[name]
        measured = data.measured
        constant = np.zeros(measured.size) if data.constant is None else data.constant
        offset = 0.0 if data.constant is None else self.offset
        shape = (len(columns), measured.size)
        rows = np.concatenate(
            [
                np.broadcast_to(measured, shape)[:, None],
                columns[:, :1],
                np.broadcast_to(constant, shape)[:, None],
                columns[:, 1:],
            ],
            axis=1,
        )
        with np.errstate(all="ignore"):
            gram = rows @ rows.transpose(0, 2, 1)
        known = own.gain is None or not own.projected
        limits = (1.0, 1.0) if known or own.gain is None else own.limits[own.gain]
        found = reduced(gram, limits, math.nan if offset is None else offset)
        with np.errstate(all="ignore"):
            residual = (
                measured
                - found.gain[:, None] * columns[:, 0]
                - found.offset[:, None] * constant
            )
            cost = np.einsum("mr,mr->m", residual, residual)
        cost = np.where(np.isfinite(cost), cost, np.inf)
        return replace(found, cost=cost), columns, residual
