"""The smooth problem behind `optimise`: parameters of Ĉ, bounds on L, all gradients in
closed form.

The parameters are ln k_d, β and ln δ. ln Ĉ is linear in the first two, and with dĈ/Ĉ at
hand every figure follows: d ln|1 + L| = Re(L/(1 + L) dĈ/Ĉ), d ln|Ĉ/(1 + L)| =
Re(dĈ/Ĉ/(1 + L)). The distance from -1 is asked for on a grid; what lies between its
points is made up for afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from fraclink._arm.controller import Controller
from fraclink._arm.loop import Loop, noise_points
from fraclink._design.modes import HigherModes

__all__ = ["Bounds", "Goal", "Problem"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Goal = Literal["noise", "crossover"]

_PAYLOADS = 5
_FREQUENCIES = (
    90  # of the distance from -1, from a third of the mode to twenty times it
)
_STEPS = 120
_LONGEST, _SHORTEST = (
    math.log(1.0),
    math.log(2e-4),
)  # of δ [s]: ten periods of the slowest arm


@dataclass(frozen=True)
class Bounds:
    """What every trial must keep: Ms, the smallest crossover [rad/s], noise gain, gain
    at higher modes.

    The one that is the goal is the value to start from.
    """

    max_sensitivity: float
    gain_crossover: float
    noise_gain: float
    mode_gain: float | None = None


@dataclass(frozen=True, eq=False)
class Problem:
    """A loop without its Ĉ over a range of ω₀, the bounds, and which of them is to be
    improved.
    """

    loop: Loop  # with k = 1, β = 0 and no filter
    natural_frequencies: tuple[float, float]
    period: float
    filter_order: int
    goal: Goal
    bounds: Bounds
    modes: HigherModes | None = None

    @property
    def box(self) -> list[tuple[float, float]]:
        """Lower and upper end of every parameter, the objective's last."""
        highest = (
            min(self.loop.link_order, float(self.filter_order)) - 0.02
        )  # Ĉ stays strictly proper
        # Wide ends that no arm needs, in ln k_d and ln of the goal: they keep the steps
        # of the solver finite. β stays off 0, where Ĉ is a constant that (28) forbids.
        return [(-27.0, 27.0), (0.05, highest), (_SHORTEST, _LONGEST), (-20.0, 20.0)]

    @cached_property
    def _links(self) -> Real:
        # Ms and noise are smooth over ω₀: five links are enough to steer by, and what
        # is found is measured over the whole range afterwards. On the bundled rigs the
        # two ends lead to the same controller in two thirds of the time; a late gauge
        # puts the worst link between them.
        return np.geomspace(*self.natural_frequencies, _PAYLOADS)

    @cached_property
    def _near(self) -> tuple[Real, Complex]:
        """(ω, L without Ĉ) where the distance from -1 is asked for."""
        scan = np.geomspace(0.3, 20.0, _FREQUENCIES)
        w = np.minimum(
            self.loop.peak(self._links)[:, None] * scan, math.pi / self.period
        )
        return w.ravel(), self.loop(w, self._links[:, None]).ravel()

    @cached_property
    def _noise(self) -> list[tuple[Real, Real, Complex]]:
        """(ω, weight, L without Ĉ) of the mean that is the noise gain, for each ω₀."""
        found = []
        for value in map(float, self._links):
            w, weights = noise_points(self.loop, value, self.period)
            found.append((w, weights, self.loop(w, value)))
        return found

    def outer(self, x: Real, w: Real) -> tuple[Complex, Complex]:
        """(Ĉ, d ln Ĉ/dx) at ω; the derivatives have shape (parameters, N)."""
        s = 1j * w
        delta = math.exp(x[2])
        # d ln(1 + δs)/d ln δ, the third parameter being ln δ.
        lagged = delta * s / (1.0 + delta * s)
        # In ln k_d, β and ln δ, ln Ĉ is linear but for the filter: a step of the solver
        # stays near the truth.
        log = x[0] + x[1] * np.log(s) - self.filter_order * np.log(1.0 + delta * s)
        rows = [
            np.ones_like(s),
            np.log(s),
            -self.filter_order * lagged,
            np.zeros_like(s),
        ]
        return np.exp(log), np.array(rows)

    def constraints(self, x: Real) -> tuple[Real, Real]:
        """(values that must not be negative, their gradients)."""
        w, rest = self._near
        outer, slopes = self.outer(x, w)
        value = outer * rest
        rows = [np.log(np.abs(1.0 + value)) + math.log(self.bounds.max_sensitivity)]
        # d ln|1 + L| = Re dL/(1 + L), and dL = L d ln Ĉ.
        gradients = [(value / (1.0 + value) * slopes).real]
        for bound, gradient in (self._crossover(x), *self._quiet(x), *self._still(x)):
            rows.append(np.atleast_1d(bound))
            gradients.append(gradient.reshape(gradient.shape[0], -1))
        return np.concatenate(rows), np.concatenate(gradients, axis=1).T

    def _crossover(self, x: Real) -> tuple[Real, Real]:
        """ln|L| >= 0 at the crossover asked for: right of the peak L then crosses one
        there or later.
        """
        chosen = self.goal == "crossover"
        w = np.array([math.exp(x[-1]) if chosen else self.bounds.gain_crossover])
        low = self.natural_frequencies[0]
        outer, slopes = self.outer(x, w)
        gradient = slopes.real.copy()
        if chosen:
            trial = replace(
                self.loop,
                order=float(x[1]),
                filter_time=math.exp(x[2]),
                filter_order=self.filter_order,
            )
            # Where the crossover is the goal, the point at which |L| is asked for moves
            # with the last parameter.
            gradient[-1] = trial.slope(w, low).real
        return np.log(np.abs(outer)) + self.loop.level(w, low), gradient

    def _quiet(self, x: Real) -> list[tuple[Real, Real]]:
        """ln noise <= its bound, or the last parameter, at every payload."""
        ceiling = (
            math.log(self.bounds.noise_gain) if self.goal == "crossover" else x[-1]
        )
        found = []
        for w, weights, rest in self._noise:
            outer, slopes = self.outer(x, w)
            part = outer / (1.0 + outer * rest)
            power = np.abs(part) ** 2 * weights
            total = float(np.sum(power))
            # Noise passes through Ĉ/(1 + L), so ln of it changes by d ln Ĉ/(1 + L).
            gradient = (
                -np.sum(power * (slopes / (1.0 + outer * rest)).real, axis=1) / total
            )
            if self.goal == "noise":
                gradient[-1] = 1.0
            found.append((np.asarray(ceiling - 0.5 * math.log(total)), gradient))
        return found

    def _still(self, x: Real) -> list[tuple[Real, Real]]:
        """ln of the loop gain at the higher modes <= its bound."""
        if self.modes is None or self.bounds.mode_gain is None:
            return []
        w, level = self.modes.frequency.ravel(), self.modes.level.ravel()
        outer, slopes = self.outer(x, w)
        return [
            (
                math.log(self.bounds.mode_gain) - level - np.log(np.abs(outer)),
                -slopes.real,
            )
        ]

    def start(self, controller: Controller) -> Real:
        """The parameters of a controller, its β brought into range for this n."""
        # β is changed about twice the crossover, where |Ĉ| matters most, so that a
        # start in range stays a loop.
        centre = 2.0 * self.bounds.gain_crossover
        low, high = self.box[1]
        order = min(max(controller.order, low), high)
        gain = math.log(controller.gain) + (controller.order - order) * math.log(centre)
        time = math.log(controller.filter_time or 0.1 / centre)
        time -= math.log(self.filter_order / controller.filter_order)
        goal = (
            self.bounds.gain_crossover
            if self.goal == "crossover"
            else self.bounds.noise_gain
        )
        return np.array([gain, order, time, math.log(goal)])

    def controller(self, x: Real, like: Controller) -> Controller:
        """The controller of parameters `x`, for the rig that `like` was made for."""
        return replace(
            like,
            gain=math.exp(x[0]),
            order=float(x[1]),
            filter_time=math.exp(x[2]),
            filter_order=self.filter_order,
        )

    def solve(self, start: Real) -> Real:
        """Return the parameters where sequential quadratic programming stops, feasible
        or not.
        """

        sign = -1.0 if self.goal == "crossover" else 1.0
        direction = np.zeros(start.size)
        direction[-1] = sign
        # The goal is a parameter of its own, bounded by all payloads at once: a maximum
        # that has derivatives.
        objective: Callable[[Real], tuple[float, Real]] = lambda x: (  # noqa: E731
            sign * float(x[-1]),
            direction,
        )
        low, high = np.array(self.box).T
        with np.errstate(
            all="ignore"
        ):  # trial steps may go far astray; what they find is judged afterwards
            found = minimize(
                objective,
                np.clip(start, low, high),
                jac=True,
                bounds=self.box,
                constraints={
                    "type": "ineq",
                    "fun": lambda x: self.constraints(x)[0],
                    "jac": lambda x: self.constraints(x)[1],
                },
                method="SLSQP",
                options={"maxiter": _STEPS, "ftol": 1e-9},
            )
        return np.asarray(found.x, dtype=float)
