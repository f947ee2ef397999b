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
from numpy.typing import NDArray

from fraclink._identify.link_problem import quadratic_of
from fraclink._identify.problem import Quadratic, descend
from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import (
    ALPHA_LIMITS,
    ORDER_LIMITS,
    Shape,
    Vector,
    damping_and_square,
    largest_ratio,
)
from fraclink._identify.uncertainty import uncertainty
from fraclink.errors import NotConvergedError


@dataclass(frozen=True)
class Coordinates:
    """Where each parameter of each log sits in θ.

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
        """Parameters that each log has for itself."""
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

    def shape(self, theta: Vector, log: int) -> tuple[Shape, NDArray[np.float64]]:
        """The shape of a log and its derivative by θ, shapes (5,) and (5, size)."""
        at = {name: self.index(name, log) for name in self.names}
        order = float(theta[at["order"]]) if "order" in at else 2.0
        other = float(theta[at["damping_order"]]) if "damping_order" in at else 1.0
        damping = math.exp(theta[at["damping"]]) if "damping" in at else 0.0
        delay = float(theta[at["delay"]]) if "delay" in at else self.fixed_delay or 0.0
        rates = np.zeros((5, self.size))
        for i, name in ((0, "order"), (3, "damping_order"), (4, "delay")):
            if name in at:
                rates[i, at[name]] = 1.0
        log_resonance, by = self._resonance(theta, log, at, order, damping, other)
        for name, value in by.items():
            rates[1, at[name]] += value
        ratio = 0.0
        if damping > 0:
            sine, cosine = math.sin(other * math.pi / 2), math.cos(other * math.pi / 2)
            ratio = damping * sine * math.exp((other - order) * log_resonance) / 2
            rates[2] = ratio * (other - order) * rates[1]
            rates[2, at["damping"]] += ratio
            if "damping_order" in at:
                rates[2, at["damping_order"]] += ratio * (
                    math.pi / 2 * cosine / sine + log_resonance
                )
        return np.array([order, log_resonance, ratio, other, delay]), rates

    def _resonance(
        self,
        theta: Vector,
        log: int,
        at: dict[str, int],
        order: float,
        damping: float,
        other: float,
    ) -> tuple[float, dict[str, float]]:
        """ln Ω and its derivatives by the log's parameters."""
        value = float(theta[at["frequency"]])
        if self.payloads is None:
            return value, {"frequency": 1.0}
        square = math.exp(value) / self.payloads[log]
        cosine, sine = math.cos(other * math.pi / 2), math.sin(other * math.pi / 2)
        # The undamped link's Ω: within some percent of the root, as the damping of an
        # arm is weak.
        log_resonance = math.log(square) / order
        for _ in range(40):  # Newton on Ω^λ − κ/m − μ Ω^α cos(απ/2), in ln Ω
            moving, friction = (
                math.exp(order * log_resonance),
                damping * math.exp(other * log_resonance),
            )
            slope = order * moving - other * friction * cosine
            step = (moving - square - friction * cosine) / slope
            # On a sum of exponentials a step from the left overshoots: half an e-fold
            # keeps it in reach.
            log_resonance -= min(max(step, -0.5), 0.5)
            if abs(step) < 1e-14:
                break
        # The implicit function theorem on the equation just solved: ∂ ln Ω/∂x =
        # −(∂f/∂x)/(∂f/∂ ln Ω), the latter being `slope`.
        by = {
            "frequency": square / slope,
            "order": -log_resonance * moving / slope,
            "damping": friction * cosine / slope,
            "damping_order": friction
            * (log_resonance * cosine - math.pi / 2 * sine)
            / slope,
        }
        return log_resonance, {name: rate for name, rate in by.items() if name in at}


def start_of(coordinates: Coordinates, alone: Sequence[Solution]) -> Vector:
    """Every parameter where its log alone has it; common ones in the mean."""
    theta, count = np.zeros(coordinates.size), np.zeros(coordinates.size)
    for i, solution in enumerate(alone):
        shape = solution.shape.copy()
        if solution.on_edge:
            shape[3] = (
                # ω₀ = 0 holds for one μ only; from mid-valley a common μ finds its
                # place
                1.0
            )
        damping, square = damping_and_square(shape)
        frequency = float(shape[1])
        if coordinates.payloads is not None:
            # ω₀² m = c/L² by eq. (5): each log's own estimate of what is to be common.
            frequency = math.log(max(square, 1e-12) * coordinates.payloads[i])
        values = {
            "frequency": frequency,
            "order": float(shape[0]),
            # A logarithm needs a start above zero; an undamped fit begins where damping
            # no longer shows.
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
    """1/(σ² k): a coloured residual counts as fewer samples, k times fewer."""
    errors = uncertainty(search, solution, coloured=True)
    variance = solution.cost / search.window.samples
    own = [
        i
        for i, name in enumerate(errors.names)
        if name in ("order", "natural_frequency", "damping")
    ]
    if not variance > 0:
        return 1.0
    if errors.coloured is None or not own:
        return 1 / variance  # all at a limit: every sample counts
    # The median over the link's own parameters: one that hardly matters may have any
    # ratio.
    tiny = np.finfo(np.float64).tiny
    ratios = np.diag(errors.coloured)[own] / np.maximum(
        np.diag(errors.white)[own], tiny
    )
    return 1 / (variance * max(1.0, float(np.median(ratios))))


@dataclass(frozen=True, eq=False)
class JointProblem:
    """The least-squares problem of all logs; a `Problem` in θ."""

    coordinates: Coordinates
    searches: Sequence[Search]
    weights: Sequence[float]

    @cached_property
    def low(self) -> Vector:
        """As of `Problem`."""
        return self._limits(0)

    @cached_property
    def high(self) -> Vector:
        """As of `Problem`."""
        return self._limits(1)

    def _limits(self, end: int) -> Vector:
        result = np.full(self.coordinates.size, (-math.inf, math.inf)[end])
        for name, limits in (("order", ORDER_LIMITS), ("damping_order", ALPHA_LIMITS)):
            if name in self.coordinates.names:
                rows = range(self.coordinates.logs)
                result[[self.coordinates.index(name, i) for i in rows]] = limits[end]
        return result

    @cached_property
    def reach(self) -> Vector:
        """As of `Problem`; Ω is known well before."""
        own = self.coordinates
        result = np.full(own.size, math.inf)
        if "damping" in own.names:
            result[[own.index("damping", i) for i in range(own.logs)]] = 1.0
        return result

    def clip(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """As of `Problem`."""
        return np.clip(places, self.low, self.high)

    def costs(self, places: NDArray[np.float64]) -> Vector:
        """As of `Problem`."""
        return self.quadratic(places).cost

    def quadratic(self, places: NDArray[np.float64]) -> Quadratic:
        """As of `Problem`, of all logs weighted; the cost is infinite outside of what a
        link can be.
        """
        parts = []
        for i, (search, weight) in enumerate(
            zip(self.searches, self.weights, strict=True)
        ):
            rows = [self.coordinates.shape(theta, i) for theta in places]
            shapes, chain = (np.array(column) for column in zip(*rows, strict=True))
            possible = [row[2] <= largest_ratio(float(row[3])) for row in shapes]
            # The chain rule takes each log's own Gram matrix to θ: no log's data are
            # touched twice.
            at = quadratic_of(search.kernel, shapes, chain, search.gain, search.offset)
            cost = np.where(possible, weight * at.cost, math.inf)
            parts.append(
                (cost, weight * at.slope, weight * at.normal, at.gain, at.offset)
            )
        sums = [sum(column) for column in zip(*parts, strict=True)]
        return Quadratic(*map(np.asarray, sums))

    def minimise(self, theta: Vector) -> tuple[Vector, NDArray[np.float64]]:
        """The best θ and the normal matrix there."""
        found = descend(self, theta[None, :])
        if not math.isfinite(found.costs[0]):
            remedy = "fit each log alone first, they may not belong together"
            raise NotConvergedError(
                "the joint fit", reached=math.inf, wanted=0.0, remedy=remedy
            )
        return found.places[0], self.quadratic(found.places).normal[0]
