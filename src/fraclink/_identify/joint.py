"""The least-squares problem of several payloads: its coordinates and its minimisation.

The vector θ holds the common parameters first, then for every log its own ones. A shape
(see `shape`) follows from (ln Ω, λ, ln μ, α, delay) of a log:

    ζ = μ sin(απ/2) Ω^(α−λ) / 2                       (a common μ is not a common damping ratio)
    Ω^λ = κ/m + μ Ω^α cos(απ/2), κ = c/L²              (ω₀ tied to the payload m by eq. (5))
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fraclink._identify.link_problem import quadratic_of
from fraclink._identify.problem import Problem, Quadratic, descend
from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import (
    ALPHA_LIMITS,
    ORDER_LIMITS,
    largest_ratio,
    link_parameters,
    log_resonance,
    ratio_of,
)
from fraclink._identify.uncertainty import link_covariance
from fraclink.errors import NotConvergedError
from fracsys.checks import Real

# The parameters of θ in the order of `link_parameters`.
_PLACES = ("frequency", "order", "damping", "damping_order", "delay")


@dataclass(frozen=True)
class Coordinates:
    """The place of each parameter of each log in θ.

    `names` are the parameters of one log ("frequency", "order", "damping",
    "damping_order", "delay"), `common` those that all logs share; `payloads` [kg] is
    given where "frequency" is κ, common to all.
    """

    names: tuple[str, ...]
    common: tuple[str, ...]
    logs: int
    fixed_delay: float | None
    payloads: tuple[float, ...] | None

    @property
    def own(self) -> tuple[str, ...]:
        """Parameters that are separate for each log."""
        return tuple(name for name in self.names if name not in self.common)

    @property
    def size(self) -> int:
        """Length of θ."""
        return len(self.common) + self.logs * len(self.own)

    def index(self, name: str, log: int) -> int:
        """Place of a parameter of a log in θ."""
        if name in self.common:
            return self.common.index(name)
        return len(self.common) + log * len(self.own) + self.own.index(name)

    def shape(self, theta: Real, log: int) -> tuple[Real, Real]:
        """The shape of a log and its derivative with respect to θ, shapes (5,) and (5,
        size).
        """
        at = {name: self.index(name, log) for name in self.names}
        own = {name: float(theta[k]) for name, k in at.items()}
        order, other = own.get("order", 2.0), own.get("damping_order", 1.0)
        damping = math.exp(own["damping"]) if "damping" in own else 0.0
        delay = own.get("delay", self.fixed_delay or 0.0)
        place = own["frequency"]
        if self.payloads is not None:
            square = math.exp(place) / self.payloads[log]
            place = log_resonance(square, order, damping, other)
        ratio = ratio_of(place, order, damping, other)
        shape = np.array([order, place, ratio, other, delay])
        values, slopes = (part[0] for part in link_parameters(shape[None]))
        # The derivatives of the parameters with respect to the shape, in logarithms
        # where θ uses them; their inverse is needed.
        slopes[2] /= damping or 1.0
        slopes[0] = slopes[0] / values[0] if self.payloads else np.eye(5)[1]
        columns = [_PLACES.index(name) for name in self.names]
        rates = np.zeros((5, self.size))
        rates[:, list(at.values())] = np.linalg.inv(slopes)[:, columns]
        return shape, rates


def start_of(coordinates: Coordinates, alone: Sequence[Solution]) -> Real:
    """Every parameter from the separate fit of its log; the mean for common ones."""
    theta, count = np.zeros(coordinates.size), np.zeros(coordinates.size)
    for i, solution in enumerate(alone):
        shape = solution.shape.copy()
        if solution.on_edge:
            shape[3] = (
                # ω₀ = 0 holds for one μ only; from the middle of the valley a common μ
                # converges
                1.0
            )
        square, _, damping, *_ = link_parameters(shape[None, :])[0][0].tolist()
        frequency = float(shape[1])
        if coordinates.payloads is not None:
            # ω₀² m = c/L² by eq. (5): each log's own estimate of the common value.
            frequency = math.log(max(square, 1e-12) * coordinates.payloads[i])
        values = {
            "frequency": frequency,
            "order": float(shape[0]),
            # A logarithm needs a start above zero; an undamped fit starts where damping
            # is no longer visible.
            "damping": math.log(max(damping, 1e-6)),
            "damping_order": float(shape[3]),
            "delay": float(shape[4]),
        }
        for name in coordinates.names:
            theta[coordinates.index(name, i)] += values[name]
            count[coordinates.index(name, i)] += 1
    return theta / count


# --- the problem: the Gram matrices of all logs -----------------------------------------------------------


def weight_of(search: Search, solution: Solution) -> float:
    """1/(σ² k): a coloured residual counts as k times fewer samples."""
    variance = solution.cost / search.window.samples
    if not variance > 0:
        return 1.0
    inflation = link_covariance(search, solution, coloured=True)[0].inflation
    # The median over the parameters of the link: one with little influence may have any
    # ratio.
    own = ("order", "natural_frequency", "damping")
    ratios = [inflation[name] for name in own if name in inflation]
    return 1 / (variance * float(np.median(ratios or [1.0])))


@dataclass(frozen=True, eq=False)
class JointProblem(Problem):
    """The least-squares problem of all logs, in θ."""

    coordinates: Coordinates
    searches: Sequence[Search]
    weights: Sequence[float]

    @cached_property
    def low(self) -> Real:
        """See `Problem`."""
        return self._limits(0)

    @cached_property
    def high(self) -> Real:
        """See `Problem`."""
        return self._limits(1)

    def _limits(self, end: int) -> Real:
        result = np.full(self.coordinates.size, (-math.inf, math.inf)[end])
        for name, limits in (("order", ORDER_LIMITS), ("damping_order", ALPHA_LIMITS)):
            if name in self.coordinates.names:
                rows = range(self.coordinates.logs)
                result[[self.coordinates.index(name, i) for i in rows]] = limits[end]
        return result

    @cached_property
    def reach(self) -> Real:
        """See `Problem`: Ω is already well known."""
        own = self.coordinates
        result = np.full(own.size, math.inf)
        if "damping" in own.names:
            result[[own.index("damping", i) for i in range(own.logs)]] = 1.0
        return result

    @property
    def samples(self) -> int:
        """See `Problem`."""
        return sum(search.window.samples for search in self.searches)

    @property
    def power(self) -> float:
        """See `Problem`."""
        outputs = (search.window.output for search in self.searches)
        pairs = zip(self.weights, outputs, strict=True)
        return float(sum(weight * (y @ y) for weight, y in pairs))

    def quadratic(self, places: Real) -> Quadratic:
        """See `Problem`: the weighted sum over all logs; the cost is infinite for
        impossible links.
        """
        parts = []
        for i, (search, weight) in enumerate(
            zip(self.searches, self.weights, strict=True)
        ):
            rows = [self.coordinates.shape(theta, i) for theta in places]
            shapes, chain = (np.array(column) for column in zip(*rows, strict=True))
            possible = [row[2] <= largest_ratio(float(row[3])) for row in shapes]
            # The chain rule maps each log's own Gram matrix to θ, so that the data of
            # each log are used once.
            at = quadratic_of(search.kernel, shapes, chain, search.gain, search.offset)
            cost = np.where(possible, weight * at.cost, math.inf)
            parts.append(
                (cost, weight * at.slope, weight * at.normal, at.gain, at.offset)
            )
        sums = [sum(column) for column in zip(*parts, strict=True)]
        return Quadratic(*map(np.asarray, sums))

    def minimise(self, theta: Real) -> tuple[Real, Real]:
        """The best θ and the normal matrix there."""
        descent = descend(self, theta[None, :])
        if not math.isfinite(descent.costs[0]):
            raise NotConvergedError(
                "the joint fit",
                reached=math.inf,
                wanted=0.0,
                remedy="fit each log alone first, they may not belong together",
            )
        return descent.places[0], self.quadratic(descent.places).normal[0]
