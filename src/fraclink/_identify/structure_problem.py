"""A structure's free parameters as coordinates, and its least-squares problem."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fraclink._identify.expression import Expression
from fraclink._identify.problem import Problem, Quadratic, reduced
from fraclink._identify.structure_data import Samples
from fracsys.checks import Real

__all__ = [
    "COEFFICIENT_LIMITS",
    "GENERAL_POINTS",
    "ORDER_LIMITS",
    "POSITIVE_LIMITS",
    "StructureProblem",
]

Limits = tuple[float, float]
Values = Mapping[str, float]

# Below 0.02 a term is constant over any band that can be measured; above 4 no
# fractional model of a machine is known (`bounds` allows more). Coefficients of either
# sign in any unit: 24 decades, since a wide range of the logarithm costs nothing.
ORDER_LIMITS = (0.02, 4.0)
POSITIVE_LIMITS = _LEAST, _MOST = (1e-12, 1e12)
COEFFICIENT_LIMITS = (-_MOST, _MOST)
STEP = 1e-6  # step of differences: exact responses are accurate to 1e-12 of their peak
# Three points s in general position: two functions of the same form that agree there
# agree everywhere.
GENERAL_POINTS = np.exp(1j * np.array([0.3, 0.9, 1.4])) * np.array([0.5, 1.1, 2.3])


@dataclass(frozen=True, eq=False)
class StructureProblem(Problem):
    """The least-squares problem of a structure in its free parameters.

    A place has the coordinates of `moving`: for a coefficient of known sign the
    logarithm of its magnitude, else the value itself; followed by the fixed signs of
    the coefficients whose range includes both. The gain, a coefficient that multiplies
    everything, is not a coordinate if it is `projected` out; `offset` is NaN if it is
    free.
    """

    structure: Expression
    data: Samples
    limits: Mapping[str, Limits]
    fixed: Values
    offset: float
    projected: bool = True

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All free parameters."""
        return tuple(name for name in self.structure.names if name not in self.fixed)

    @cached_property
    def gain(self) -> str | None:
        """The free coefficient that multiplies everything, or None."""
        values = self.middle()
        once = self.structure.response(values, GENERAL_POINTS)
        for name in self.structure.of_role("coefficient"):
            if name in self.names:
                # Tested numerically instead of on the tree: k/(k·s + k) does not depend
                # on k, whatever the form of its text.
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

    @cached_property
    def signed(self) -> tuple[str, ...]:
        """Coordinates with a separate sign."""
        return tuple(name for name in self.moving if self._has_both_signs(name))

    def _has_both_signs(self, name: str) -> bool:
        """Whether a coefficient's sign is open: no range was given for it."""
        return (
            self.structure.roles[name] == "coefficient"
            and self.limits[name] == COEFFICIENT_LIMITS
        )

    def is_logarithmic(self, name: str) -> bool:
        """Whether the coordinate is a logarithm."""
        return self.structure.roles[name] == "coefficient" and (
            self.limits[name][0] > 0.0 or self._has_both_signs(name)
        )

    def coordinate(self, name: str, value: Any) -> Any:
        """The coordinate of a value."""
        return (
            np.log(np.maximum(np.abs(value), 1e-300))
            if self.is_logarithmic(name)
            else value
        )

    def value(self, name: str, coordinate: Any, sign: Any = 1.0) -> Any:
        """The value at a coordinate."""
        return sign * np.exp(coordinate) if self.is_logarithmic(name) else coordinate

    def box_of(self, name: str) -> Limits:
        """Lower and upper limit of a coordinate."""
        low, high = self.limits[name]
        if self._has_both_signs(name):
            low = _LEAST
        return float(self.coordinate(name, low)), float(self.coordinate(name, high))

    def middle(self) -> dict[str, Any]:
        """Values inside the limits, different enough that nothing cancels."""
        values: dict[str, Any] = {n: np.array([[v]]) for n, v in self.fixed.items()}
        for k, name in enumerate(self.names):
            low, high = self.box_of(name)
            # 0.6, 0.77, 0.94 …: no two are equal, and no sum of two equals another.
            # Positive in any case, since a negative base has no real powers.
            place = float(np.clip(0.6 + 0.17 * k, low, high))
            values[name] = np.array([[self.value(name, place)]])
        return values

    def places_of(self, values: Mapping[str, Any]) -> Real:
        """Places (M, p) of parameters (M,)."""
        count = np.size(values[self.names[0]])
        rows = [self.coordinate(name, values[name]) for name in self.moving]
        rows += [np.copysign(1.0, values[name]) for name in self.signed]
        places = np.zeros((count, len(rows)))
        for k, row in enumerate(rows):
            places[:, k] = row
        return places

    def values(self, places: Real) -> dict[str, Any]:
        """Parameters (M, 1) at places (M, p); a projected gain is 1."""
        signs = dict(zip(self.signed, places.T[len(self.moving) :], strict=True))
        values: dict[str, Any] = {n: np.array([[v]]) for n, v in self.fixed.items()}
        if self.projected and self.gain is not None:
            values[self.gain] = np.ones((len(places), 1))
        for name, column in zip(self.moving, places.T, strict=False):
            values[name] = self.value(name, column, signs.get(name, 1.0))[:, None]
        return values

    # --- as of `Problem`

    @cached_property
    def low(self) -> Real:
        """See `Problem`."""
        rows = [self.box_of(name)[0] for name in self.moving]
        return np.array([*rows, *(-1.0 for _ in self.signed)])

    @cached_property
    def high(self) -> Real:
        """See `Problem`."""
        rows = [self.box_of(name)[1] for name in self.moving]
        return np.array([*rows, *(1.0 for _ in self.signed)])

    @cached_property
    def reach(self) -> Real:
        """See `Problem`."""
        return np.array(
            [1.0 if self.is_logarithmic(n) else math.inf for n in self.moving]
            + [math.inf for _ in self.signed]
        )

    @property
    def samples(self) -> int:
        """See `Problem`."""
        return self.data.measured.size

    @cached_property
    def power(self) -> float:
        """See `Problem`."""
        return float(self.data.measured @ self.data.measured)

    @property
    def precision(self) -> float:
        """See `Problem`: a thousandth of the cost of one sample, a thirtieth of a
        standard error, the accuracy of slopes by differences.
        """
        return 1e-3 / self.samples

    def costs(self, places: Real) -> Real:
        """See `Problem`."""
        return self.fitted(places).cost

    def fitted(self, places: Real) -> Quadratic:
        """Costs, gains and offsets at places, without slopes."""
        columns = self.data.response(self.structure, self.values(places))[:, None]
        return self._projected(columns)[0]

    def quadratic(self, places: Real) -> Quadratic:
        """See `Problem`."""
        columns = self._columns(places)
        quadratic, residual = self._projected(columns)
        # From the residual itself: with a Gram matrix a perfect fit would lose half of
        # its digits.
        slope = np.einsum("mpr,mr->mp", columns[:, 1:], residual)
        return replace(quadratic, slope=quadratic.gain[:, None] * np.nan_to_num(slope))

    def linearised(self, place: Real) -> tuple[Real, Real]:
        """∂(measured)/∂(coordinates, then the offset if free), shape (q, R), and the
        residual (R,), with the gain as a coordinate.
        """
        columns = self._columns(place[None, :])
        rows = columns[0, 1 : 1 + len(self.moving)]
        if math.isnan(self.offset):
            rows = np.concatenate([rows, self.data.constant[None, :]])
        return rows, self._projected(columns)[1][0]

    def _columns(self, places: Real) -> Real:
        """Responses and their slopes along the coordinates, shape (M, 1 + p, R)."""
        values, tangent = self.values(places), self.data.tangent
        here = base = self.data.response(self.structure, values)
        if not self.moving:
            return here[:, None]
        if tangent is not self.data:
            base = tangent.response(self.structure, values)
        steps = [self._step(name, values[name]) for name in self.moving]
        slopes = self._differences(values, steps, base)
        # In the other direction where the domain ends.
        if gaps := [k for k, each in enumerate(slopes) if not np.isfinite(each).all()]:
            back = self._differences(values, [-step for step in steps], base)
            slopes[gaps] = np.where(np.isfinite(slopes), slopes, back)[gaps]
        for k, name in enumerate(self.moving):
            if self.is_logarithmic(name):
                slopes[k] *= values[name]
        columns = np.zeros((len(here), 1 + places.shape[1], here.shape[1]))
        columns[:, 0] = here
        columns[:, 1 : 1 + len(slopes)] = np.nan_to_num(slopes).transpose(1, 0, 2)
        return columns

    def _step(self, name: str, value: Real) -> Real:
        """Step of a difference.

        A held input jumps at a sample: the response is smooth up to a delay that ends
        there, and another piece begins beyond it. Delays are therefore decreased.
        """
        role = self.structure.roles[name]
        if role == "coefficient":
            return np.where(value == 0.0, STEP, STEP * value)
        size = -self.data.tangent.shortest if role == "delay" else 1.0
        return np.full_like(value, size * STEP)

    def _differences(
        self, values: Mapping[str, Any], steps: Sequence[Real], here: Real
    ) -> Real:
        """One-sided differences of responses (M, R), shape (p, M, R)."""
        count = len(here)
        rows = {
            name: np.tile(np.broadcast_to(value, (count, 1)), (len(steps), 1))
            for name, value in values.items()
        }
        for k, (name, step) in enumerate(zip(self.moving, steps, strict=True)):
            rows[name][k * count : (k + 1) * count] += step
        there = self.data.tangent.response(self.structure, rows)
        with np.errstate(all="ignore"):
            change = there.reshape(len(steps), count, -1) - here
            return np.asarray(change / np.array(steps))

    def _projected(self, columns: Real) -> tuple[Quadratic, Real]:
        """The quadratic model of columns (M, 1 + p, R), and the residuals (M, R)."""
        measured, constant = self.data.measured, self.data.constant
        shape = (len(columns), 1, measured.size)
        rows = np.concatenate(
            [
                np.broadcast_to(measured, shape),
                columns[:, :1],
                np.broadcast_to(constant, shape),
                columns[:, 1:],
            ],
            axis=1,
        )
        limits = (1.0, 1.0)
        if self.gain is not None and self.projected:
            limits = self.limits[self.gain]
        with np.errstate(all="ignore"):
            gram = rows @ rows.transpose(0, 2, 1)
            quadratic = reduced(gram, limits, self.offset)
            residual = (
                measured
                - quadratic.gain[:, None] * columns[:, 0]
                - quadratic.offset[:, None] * constant
            )
            cost = np.einsum("mr,mr->m", residual, residual)
        cost = np.where(np.isfinite(cost), cost, np.inf)
        return replace(quadratic, cost=cost), residual
