"""The least-squares problem of several payloads.

The parameters of a log are (ln Ω, λ, ln μ, α, τ), or with ln c/L² = ln(ω₀² m) in place
of ln Ω, which eq. (5) makes common. The vector θ holds the common ones first, then for
every log its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fraclink._identify.link_problem import quadratic_of
from fraclink._identify.problem import RESOLUTION, Problem, Quadratic
from fraclink._identify.residual import autoregression
from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import (
    ALPHA_LIMITS,
    NAMES,
    ORDER_LIMITS,
    columns_of,
    largest_ratio,
    link_parameters,
    shapes_at,
    shapes_of,
)
from fracsys.checks import Real

# The columns of which θ holds the logarithm.
_LOGARITHMS = [NAMES.index(name) for name in ("natural_frequency", "damping")]
_LIMITS = {
    **dict.fromkeys(NAMES, (-math.inf, math.inf)),
    "order": ORDER_LIMITS,
    "damping_order": ALPHA_LIMITS,
}


def weight_of(search: Search, solution: Solution) -> float:
    """1/(σ² k): a coloured residual counts as k times fewer samples.

    A log determines a link by its resonance: the scores of the parameters have that
    frequency, and k is the noise there relative to its mean over all frequencies. For a
    fit closer than 16 bits resolve, the noise is their rounding, which is white.
    """
    raw = columns_of(search.kernel, solution.shape)[0]
    residual = search.window.output - solution.gain * raw - solution.offset
    variance = solution.cost / search.window.samples
    least = RESOLUTION * float(np.var(search.window.output))
    if variance <= least:
        return 1 / least
    coefficients, innovation = autoregression(residual)
    turn = np.exp(1j * solution.resonance * search.window.period)
    power = innovation / float(np.abs(np.polyval(coefficients, turn))) ** 2
    # With less noise at the resonance than on average, every sample counts in full.
    return 1 / max(variance, power)


@dataclass(frozen=True, eq=False)
class JointProblem(Problem):
    """The least-squares problem of all logs, in θ.

    `names` are the free parameters of a log, `common` those that all logs share;
    `masses` (one for each log) [kg] are given where they tie ω₀.
    """

    searches: Sequence[Search]
    weights: Sequence[float]
    names: tuple[str, ...]
    common: tuple[str, ...]
    delay: float
    masses: Real | None

    @cached_property
    def index(self) -> NDArray[np.int_]:
        """Places in θ of the free parameters of every log, (logs, names)."""
        own = [name for name in self.names if name not in self.common]
        return np.array(
            [
                [
                    self.common.index(name)
                    if name in self.common
                    else len(self.common) + log * len(own) + own.index(name)
                    for name in self.names
                ]
                for log in range(len(self.searches))
            ]
        )

    @property
    def columns(self) -> list[int]:
        """Columns of the free parameters among all five."""
        return [NAMES.index(name) for name in self.names]

    def rows(self, places: Real, log: int) -> Real:
        """Parameters (M, 5) of a log: (Ω or c/L², λ, μ, α, τ)."""
        rows = np.tile([0.0, 2.0, -math.inf, 1.0, self.delay], (len(places), 1))
        rows[:, self.columns] = places[:, self.index[log]]
        rows[:, _LOGARITHMS] = np.exp(rows[:, _LOGARITHMS])
        return rows

    def shapes(self, places: Real, log: int) -> tuple[Real, Real]:
        """Shapes (M, 5) of a log, and their derivatives with respect to its free
        parameters (M, 5, p).
        """
        rows = self.rows(places, log)
        if self.masses is None:
            shapes = shapes_at(np.log(rows[:, 0]), rows)
            slopes = link_parameters(shapes)[1]
            slopes[:, 0] = np.eye(5)[1]
        else:
            rows[:, 0] /= self.masses[log]
            shapes = shapes_of(rows)
            slopes = link_parameters(shapes)[1]
            slopes[:, 0] /= rows[:, :1]
        # Without damping the column of μ is not among the free ones.
        slopes[:, 2] /= np.where(rows[:, 2:3] > 0, rows[:, 2:3], 1.0)
        return shapes, np.asarray(np.linalg.inv(slopes)[:, :, self.columns])

    def start(self, alone: Sequence[Solution]) -> Real:
        """Every parameter from the separate fit of its log; the mean for common ones."""
        shapes = np.array([solution.shape for solution in alone])
        # ω₀ = 0 admits a single μ; from the middle of the valley, at α = 1, a common μ
        # converges.
        shapes[[solution.on_edge for solution in alone], 3] = 1.0
        rows = link_parameters(shapes)[0]
        if self.masses is None:
            rows[:, 0] = np.exp(shapes[:, 1])
        else:
            rows[:, 0] *= self.masses
        # An undamped fit starts where damping is no longer visible.
        rows[:, _LOGARITHMS] = np.log(np.maximum(rows[:, _LOGARITHMS], 1e-6))
        place, values = self.index.ravel(), rows[:, self.columns].ravel()
        return np.bincount(place, values) / np.bincount(place)

    def _of_each(self, values: Sequence[float]) -> Real:
        """A value for every parameter of θ, from one for every name."""
        result = np.empty(self.index.max() + 1)
        result[self.index] = values
        return result

    @cached_property
    def box(self) -> tuple[Real, Real]:
        """See `Problem`."""
        low, high = zip(*(_LIMITS[name] for name in self.names), strict=True)
        return self._of_each(low), self._of_each(high)

    @cached_property
    def reach(self) -> Real:
        """See `Problem`: only ln μ is limited, as Ω is already well known."""
        return self._of_each(
            [1.0 if column == 2 else math.inf for column in self.columns]
        )

    @cached_property
    def measured(self) -> Real:
        """See `Problem`."""
        return np.concatenate(
            [
                math.sqrt(weight) * search.window.output
                for weight, search in zip(self.weights, self.searches, strict=True)
            ]
        )

    def quadratic(self, places: Real) -> Quadratic:
        """See `Problem`: the weighted sum over all logs; the cost is infinite for
        impossible links.
        """
        count, size = places.shape
        cost, slope = np.zeros(count), np.zeros((count, size))
        normal = np.zeros((count, size, size))
        for log, (search, weight) in enumerate(
            zip(self.searches, self.weights, strict=True)
        ):
            shapes, chain = self.shapes(places, log)
            at = quadratic_of(search.kernel, shapes, chain, *search.known)
            possible = [row[2] <= largest_ratio(float(row[3])) for row in shapes]
            own = self.index[log]
            cost += np.where(possible, weight * at.cost, math.inf)
            slope[:, own] += weight * at.slope
            normal[:, own[:, None], own] += weight * at.normal
        return Quadratic(cost, slope, normal)
