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

import numpy as np
from numpy.typing import NDArray

from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import (
    ALPHA_LIMITS,
    ORDER_LIMITS,
    Shape,
    Vector,
    damping_and_square,
    largest_ratio,
    mask_of,
)
from fraclink._identify.uncertainty import reduced, uncertainty
from fraclink.errors import NotConvergedError

_ITERATIONS = 60


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


# --- minimisation: Levenberg–Marquardt on the Gram matrices of all logs -----------------------------------


def weight_of(search: Search, solution: Solution) -> float:
    """1/(σ² k): a coloured residual counts as fewer samples."""
    errors = uncertainty(search, solution, coloured=True)
    variance = solution.cost / search.window.samples
    own = [
        i
        for i, name in enumerate(errors.names)
        if name in ("order", "natural_frequency", "damping")
    ]
    if errors.coloured is None or not own:
        # No estimate of the colour (a perfect fit, all at a limit): every sample
        # counts.
        return 1 / variance
    # The median over the link's own parameters: one that hardly matters may have any
    # ratio.
    ratios = np.diag(errors.coloured)[own] / np.maximum(
        np.diag(errors.white)[own], 1e-300
    )
    return 1 / (variance * max(1.0, float(np.median(ratios)))) if variance > 0 else 1.0


@dataclass(frozen=True, eq=False)
class JointProblem:
    """The least-squares problem of all logs."""

    coordinates: Coordinates
    searches: Sequence[Search]
    weights: Sequence[float]

    def evaluate(self, theta: Vector) -> tuple[float, NDArray[np.float64], Vector]:
        """Weighted cost, normal matrix and slope in θ; the cost is infinite outside of
        what a link can be.
        """
        size = self.coordinates.size
        normal, slope, total = np.zeros((size, size)), np.zeros(size), 0.0
        for i, (search, weight) in enumerate(
            zip(self.searches, self.weights, strict=True)
        ):
            shape, rates = self.coordinates.shape(theta, i)
            inside = all(
                low <= x <= high
                for x, (low, high) in (
                    (shape[0], ORDER_LIMITS),
                    (shape[3], ALPHA_LIMITS),
                )
            )
            moving = [k for k in range(5) if np.any(rates[k])]
            possible = inside and shape[2] <= largest_ratio(float(shape[3]))
            gram = search.kernel.gram(shape, mask_of(moving)) if possible else None
            if gram is None:
                return math.inf, normal, slope
            # Gain and offset of each log are projected out: θ holds what is curved in
            # the prediction.
            inner, own_slope, cost = reduced(gram, search)
            # The chain rule takes each log's own Gram matrix to θ: no log's data are
            # touched twice.
            part = rates[moving]
            normal += weight * part.T @ inner @ part
            slope += weight * part.T @ own_slope
            total += weight * cost
        return total, normal, slope

    def minimise(self, theta: Vector) -> tuple[Vector, NDArray[np.float64]]:
        """The best θ and the normal matrix there."""
        logs = range(self.coordinates.logs) if "order" in self.coordinates.names else ()
        orders = [self.coordinates.index("order", i) for i in logs]
        # Orders are the only coordinates with a limit that fits run into: λ = 2 is an
        # integer link.
        theta[orders] = np.clip(theta[orders], *ORDER_LIMITS)
        cost, normal, slope = self.evaluate(theta)
        if not math.isfinite(cost):
            remedy = "fit each log alone first, they may not belong together"
            raise NotConvergedError(
                "the joint fit", reached=math.inf, wanted=0.0, remedy=remedy
            )
        # A Gauss–Newton step to begin with, hardly damped: the logs' own fits are
        # close.
        damping = 1e-3
        for _ in range(_ITERATIONS):
            size = np.maximum(np.diag(normal), 1e-300)
            step = np.linalg.solve(normal + damping * np.diag(size), slope)
            # All coordinates are logarithms or of order one: beyond 0.4 the linear
            # model means nothing.
            step *= min(1.0, 0.4 / max(float(np.max(np.abs(step))), 1e-300))
            trial = theta + step
            trial[orders] = np.clip(trial[orders], *ORDER_LIMITS)
            next_cost, next_normal, next_slope = self.evaluate(trial)
            if next_cost < cost:
                gained = cost - next_cost
                theta, cost, normal, slope = trial, next_cost, next_normal, next_slope
                damping *= 0.1
                if gained < 1e-10 * cost:
                    break
            else:
                damping *= 10
                # The step is as small as rounding, or what it promises is: the cost
                # does not fall any more.
                if damping > 1e8 or float(step @ slope) < 1e-10 * cost:
                    break
        return theta, normal
