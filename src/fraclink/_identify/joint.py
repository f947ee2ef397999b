"""Coordinates of a joint fit: what is common to all payloads, what each has for itself.

The vector θ holds the common parameters first, then for every log its own ones. A shape (see `shape`)
follows from (ln Ω, λ, ln μ, α, delay) of a log:

    ζ = μ sin(απ/2) Ω^(α−λ) / 2                       (a common μ is not a common damping ratio)
    Ω^λ = κ/m + μ Ω^α cos(απ/2), κ = c/L²              (ω₀ tied to the payload m by eq. (5))
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._identify.shape import Shape

__all__ = ["Coordinates"]

Vector = NDArray[np.float64]
_DELAY = 4


@dataclass(frozen=True)
class Coordinates:
    """Where each parameter of each log sits in θ.

    `names` are the parameters of one log ("frequency", "order", "damping", "damping_order", "delay"),
    `common` those that all logs share; `payloads` [kg] is given where "frequency" is κ, common to all.
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
        rates = np.zeros((5, self.size))
        if "order" in at:
            rates[0, at["order"]] = 1.0
        if "damping_order" in at:
            rates[3, at["damping_order"]] = 1.0
        log_resonance, by = self._resonance(theta, log, at, order, damping, other)
        for name, value in by.items():
            rates[1, at[name]] += value
        delay = self.fixed_delay if "delay" not in at else float(theta[at["delay"]])
        if "delay" in at:
            rates[_DELAY, at["delay"]] = 1.0
        ratio = 0.0
        if damping > 0:
            sine, cosine = math.sin(other * math.pi / 2), math.cos(other * math.pi / 2)
            ratio = damping * sine * math.exp((other - order) * log_resonance) / 2
            rates[2] = ratio * (other - order) * rates[1]
            rates[2, at["damping"]] += ratio
            if "damping_order" in at:
                rates[2, at["damping_order"]] += ratio * (math.pi / 2 * cosine / sine + log_resonance)
        return np.array([order, log_resonance, ratio, other, delay or 0.0]), rates

    def _resonance(
        self, theta: Vector, log: int, at: dict[str, int], order: float, damping: float, other: float
    ) -> tuple[float, dict[str, float]]:
        """ln Ω and its derivatives by the log's parameters."""
        value = float(theta[at["frequency"]])
        if self.payloads is None:
            return value, {"frequency": 1.0}
        square = math.exp(value) / self.payloads[log]
        cosine, sine = math.cos(other * math.pi / 2), math.sin(other * math.pi / 2)
        log_resonance = math.log(square) / order
        for _ in range(40):  # Newton on Ω^λ − κ/m − μ Ω^α cos(απ/2), in ln Ω
            moving, friction = math.exp(order * log_resonance), damping * math.exp(other * log_resonance)
            slope = order * moving - other * friction * cosine
            step = (moving - square - friction * cosine) / slope
            log_resonance -= min(max(step, -0.5), 0.5)
            if abs(step) < 1e-14:
                break
        by = {"frequency": square / slope}
        if "order" in at:
            by["order"] = -log_resonance * moving / slope
        if "damping" in at:
            by["damping"] = friction * cosine / slope
        if "damping_order" in at:
            by["damping_order"] = friction * (log_resonance * cosine - math.pi / 2 * sine) / slope
        return log_resonance, by
