"""A structure's free parameters as coordinates, and its least-squares problem."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fraclink._identify.expression import Expression
from fraclink._identify.problem import Problem, Quadratic
from fraclink._identify.structure_data import Limits, Samples
from fracsys._precision import RESOLUTION
from fracsys.checks import Real

Values = Mapping[str, float]

# Below 0.02 a term is constant over any band that can be measured; above 4 no
# fractional model of a machine is known (`bounds` allows more). Coefficients may have
# either sign and any unit: 24 decades, which cost nothing on a logarithmic scale.
ORDER_LIMITS = (0.02, 4.0)
POSITIVE_LIMITS = _LEAST, _MOST = (1e-12, 1e12)
COEFFICIENT_LIMITS = (-_MOST, _MOST)
# Step of one-sided differences: the responses are accurate to its square.
_STEP = math.sqrt(RESOLUTION)


@dataclass(frozen=True, eq=False)
class StructureProblem(Problem):
    """The least-squares problem of a structure in its free parameters.

    A place has the coordinates of `names`: for a coefficient c the inverse hyperbolic
    sine of c/1e-12, a logarithm with either sign; else the value itself. A free
    `offset`, which is NaN, is projected out.
    """

    structure: Expression
    data: Samples
    limits: Mapping[str, Limits]
    fixed: Values
    offset: float

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All free parameters."""
        return tuple(name for name in self.structure.names if name not in self.fixed)

    @cached_property
    def _scaling(self) -> Real:
        """Exponents (p,) such that coefficients · κ^exponents make the response κ times
        as large; zero if there are none.
        """
        # No two values are equal, and no sum of two equals another; all are positive
        # where the limits allow it, since a negative base has no real powers. The
        # points lie in general position, and outnumber the parameters.
        values: dict[str, Any] = {
            name: np.clip(0.6 + 0.17 * k, *self.limits[name])
            for k, name in enumerate(self.names)
        }
        values |= self.fixed
        points = np.linspace(0.5, 2.3, 16) * np.exp(1j * np.linspace(0.3, 1.4, 16))
        # Where the bounds leave no response, no parameter has an effect.
        responses = [
            self.structure.response(
                {**values, name: values[name] * (1 + _STEP)}, points
            )
            for name in self.names
        ]
        ratios = responses / self.structure.response(values, points)
        rates = np.log(np.nan_to_num(ratios, nan=1.0, posinf=1.0, neginf=1.0)) / _STEP
        rates[[not self.is_coefficient(name) for name in self.names]] = 0.0
        rows = np.concatenate([rates.real, rates.imag], axis=1).T
        wanted = np.repeat([1.0, 0.0], len(points))
        exponents = np.linalg.lstsq(rows, wanted, rcond=None)[0]
        return exponents * np.allclose(rows @ exponents, wanted, atol=1e-4)

    def sized(self, places: Real) -> Real:
        """Places whose coefficients are scaled such that the response has the size and
        the sign of what was measured.
        """
        responses = self._centred(
            self.data.response(self.structure, self.values(places))
        )
        power = np.einsum("mr,mr->m", responses, responses)
        gain = np.nan_to_num(responses @ self._centred(self._aim) / power)[:, None]
        # A coordinate is a logarithm with a sign; an odd exponent reverses the sign.
        shift = np.log(np.where(gain == 0, 1.0, np.abs(gain))) * self._scaling
        turned = (gain < 0) & (np.round(self._scaling) % 2 == 1)
        scaled = places + np.sign(places) * shift
        return self.clip(np.where(turned, -scaled, scaled))

    def is_coefficient(self, name: str) -> bool:
        """Whether a parameter is a coefficient, with a logarithmic coordinate."""
        return self.structure.roles[name] == "coefficient"

    def coordinate(self, name: str, value: Any) -> Any:
        """The coordinate of a value."""
        return np.arcsinh(value / _LEAST) if self.is_coefficient(name) else value

    def value(self, name: str, coordinate: Any) -> Any:
        """The value at a coordinate."""
        coefficient = self.is_coefficient(name)
        return _LEAST * np.sinh(coordinate) if coefficient else coordinate

    def slope(self, name: str, value: Any) -> Any:
        """The derivative of a value with respect to its coordinate."""
        return np.hypot(value, _LEAST) if self.is_coefficient(name) else 1.0

    def places_of(self, values: Mapping[str, Any]) -> Real:
        """Places (M, p) of parameters (M,)."""
        columns = [self.coordinate(name, np.ravel(values[name])) for name in self.names]
        return np.stack(columns, axis=1)

    def place_of(self, values: Mapping[str, float]) -> Real:
        """The place (p,) of single values."""
        return self.places_of(values)[0]

    def values(self, places: Real) -> dict[str, Any]:
        """Parameters (M, 1) at places (M, p), in the order of the text."""
        columns = dict(zip(self.names, places.T[:, :, None], strict=True))
        return {
            name: self.value(name, columns[name])
            if name in columns
            else np.array([[self.fixed[name]]])
            for name in self.structure.names
        }

    def output(self, values: Values) -> Real:
        """The response (R,) with single values of all parameters."""
        single = {name: np.array([[value]]) for name, value in values.items()}
        return self.data.response(self.structure, single)[0]

    def best_offset(self, values: Values) -> float:
        """The offset with which single values fit best, or the one that is known."""
        if not math.isnan(self.offset):
            return self.offset
        constant = self.data.constant
        rest = self.measured - self.output(values)
        return float(rest @ constant / (constant @ constant))

    # --- the members of `Problem`

    @cached_property
    def box(self) -> tuple[Real, Real]:
        """See `Problem`."""
        low, high = self.places_of({n: np.array(x) for n, x in self.limits.items()})
        return low, high

    @cached_property
    def reach(self) -> Real:
        """See `Problem`."""
        return np.array(
            [1.0 if self.is_coefficient(n) else math.inf for n in self.names]
        )

    @property
    def measured(self) -> Real:
        """See `Problem`."""
        return self.data.measured

    @property
    def precision(self) -> float:
        """See `Problem`: a thousandth of the cost of one sample is a thirtieth of a
        standard error, the accuracy of slopes by differences.
        """
        return 1e-3 / self.samples

    @cached_property
    def _aim(self) -> Real:
        """What was measured, without the known offset, if any."""
        return self.measured - np.nan_to_num(self.offset) * self.data.constant

    def _centred(self, rows: Real) -> Real:
        """Rows (..., R) with a free offset projected out."""
        if not math.isnan(self.offset):
            return rows
        unit = self.data.constant / np.linalg.norm(self.data.constant)
        return rows - (rows @ unit)[..., None] * unit

    def _left(self, responses: Real) -> tuple[Real, Real]:
        """What responses (M, R) leave of the measurement, and the costs (M,)."""
        residual = self._centred(self._aim - responses)
        cost = np.einsum("mr,mr->m", residual, residual)
        return residual, np.where(np.isfinite(cost), cost, np.inf)

    def costs(self, places: Real) -> Real:
        """Costs (M,) at places, without slopes."""
        return self._left(self.data.response(self.structure, self.values(places)))[1]

    def quadratic(self, places: Real) -> Quadratic:
        """See `Problem`."""
        columns = self._columns(places)
        # From the residual itself: with a Gram matrix a perfect fit would lose half of
        # its digits.
        residual, cost = self._left(columns[:, 0])
        slopes = self._centred(columns[:, 1:])
        slope = np.nan_to_num(np.einsum("mpr,mr->mp", slopes, residual))
        return Quadratic(cost, slope, slopes @ slopes.transpose(0, 2, 1))

    def linearised(self, place: Real) -> tuple[Real, Real]:
        """∂(measured)/∂(coordinates, then the offset if free), shape (q, R), and the
        residual (R,).
        """
        columns = self._columns(place[None, :])[0]
        rows = columns[1:]
        if math.isnan(self.offset):
            rows = np.vstack([rows, self.data.constant])
        return rows, self._left(columns[:1])[0][0]

    def _columns(self, places: Real) -> Real:
        """Responses and their slopes along the coordinates, shape (M, 1 + p, R)."""
        steps = self._steps(places).T[:, :, None]
        ahead = places + steps * np.eye(len(steps))[:, None, :]
        rows = np.concatenate([places, *ahead])
        columns = self.data.response(self.structure, self.values(rows)).reshape(
            1 + len(steps), len(places), -1
        )
        columns[1:] = np.nan_to_num((columns[1:] - columns[0]) / steps)
        return columns.transpose(1, 0, 2)

    def _steps(self, places: Real) -> Real:
        """Steps (M, p) of differences along the coordinates.

        A held input jumps at a sample: the response is smooth up to a delay that ends
        there, and another piece begins beyond it. Delays are therefore decreased,
        except at zero.
        """
        delays = np.array(
            [self.structure.roles[n] == "delay" for n in self.names], bool
        )
        size = np.where(delays, _STEP / self.data.band[1], _STEP)
        return np.where(delays & (places >= size), -size, size)
