"""The loop as it is sampled: the law's own response times the zero-order-hold plant, alias sum included.

Between two ticks the motor reference is held, so the computer sees
``P_d(e^{jωTs}) = z^{-d} (1 - z^{-1})/Ts · Σ_k F(s_k)/s_k``, ``s_k = j(ω + kω_s)``, ``F = M·G``: the exact
zero-order-hold discretisation, without a state-space model of an irrational plant.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.controller import Controller
from fraclink._arm.motor_loop import SampledMotorLoop
from fraclink._design.loop import OpenLoop
from fraclink._validate import checked_choice

if TYPE_CHECKING:
    from fraclink._law import Law

__all__ = ["SampledPlant", "grunwald_response", "link_plant", "realised", "tail_sum"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]
_TERMS = 12  # aliases summed one by one on either side; the rest is 1e-7 of the sum and summed in closed form


def tail_sum(exponent: float, start: Real | float) -> Real:
    """Return ``Σ_{k>=0} (k + start)^(-exponent)`` by Euler–Maclaurin, for exponent > 1 and start >= 8.

    The first term left out is below 1e-9 of the sum for exponents up to 6.

    >>> round(float(tail_sum(2.0, 10.0)), 9)
    0.105166336
    """
    a, q = np.asarray(start, dtype=float), exponent
    third = q * (q + 1.0) * (q + 2.0)
    fifth = third * (q + 3.0) * (q + 4.0)
    series = a / (q - 1.0) + 0.5 + q / (12.0 * a) - third / (720.0 * a**3) + fifth / (30240.0 * a**5)
    return np.asarray(a ** (-q) * series)


@dataclass(frozen=True)
class SampledPlant:
    """``P_d``: hold, computation delay, motor loop and link, sampled at `period` [s].

    ``response(s)`` is F(s), vectorised over complex s; ``decay`` and ``leading`` its asymptote
    ``F(s)/s → leading · s^(-decay)``, which sums the far aliases. ``delay`` [s] need not be whole samples.
    """

    response: Callable[[Complex], Complex]
    period: float
    delay: float
    decay: float
    leading: float
    before: Callable[[Real], Complex] | None = None  # what acts ahead of the hold, on the unit circle

    def __call__(self, frequency: ArrayLike) -> Complex:
        """Return P_d at `frequency` [rad/s], 0 < ω <= π/Ts, shape kept."""
        w = np.asarray(frequency, dtype=float)
        rate = 2.0 * math.pi / self.period
        s = 1j * (w[..., None] + rate * np.arange(-_TERMS, _TERMS + 1))
        total = np.sum(self.response(s) / s * np.exp(-self.delay * s), axis=-1)
        if self._whole_samples:
            total = total + self._far(w, rate) * np.exp(-1j * self.delay * w)
        held = -np.expm1(-1j * self.period * w) / self.period * total
        return np.asarray(held if self.before is None else held * self.before(w), dtype=np.complex128)

    @property
    def _whole_samples(self) -> bool:
        # e^{-τ s_k} turns with k unless τ is whole samples; its tail is then bounded, not summed.
        return abs(self.delay / self.period - round(self.delay / self.period)) < 1e-12

    def _far(self, w: Real, rate: float) -> Complex:
        """Both tails of the alias sum from the asymptote: ``(±j)^(-q) ω_s^(-q) ζ(q, K + 1 ± ω/ω_s)``."""
        q = self.decay
        turn = np.exp(-0.5j * math.pi * q)
        above = tail_sum(q, _TERMS + 1.0 + w / rate)
        below = tail_sum(q, _TERMS + 1.0 - w / rate)
        return np.asarray(self.leading * rate**-q * (turn * above + np.conj(turn) * below))


def grunwald_response(gain: float, order: float, frequency: ArrayLike, period: float) -> Complex:
    """Return ``k_d ((1 - z^{-1})/Ts)^β`` on the unit circle: Grünwald–Letnikov with all its memory.

    It lags behind ``k_d (jω)^β`` by β ωTs/2, the price of a backward difference.
    """
    w = np.asarray(frequency, dtype=float)
    difference = -np.expm1(-1j * w * period) / period
    return np.asarray(gain * np.exp(order * np.log(difference)), dtype=np.complex128)


def link_plant(
    link: OpenLoop,
    natural_frequency: float,
    *,
    motor: float | SampledMotorLoop,
    period: float,
    delay: float,
) -> SampledPlant:
    """Return the sampled ``M(s) G(s)``, or motor and link under the sampled motor loop's voltage.

    `link` is the open loop with k = 1, β = 0 and nothing else in it; `motor` is ε = 1/p of M(s), zero for the
    ideal one, or the sampled loop itself.
    """
    spring = natural_frequency**2
    sampled = motor if isinstance(motor, SampledMotorLoop) else None
    lag = 0.0 if isinstance(motor, SampledMotorLoop) else motor

    def response(s: Complex) -> Complex:
        inertia = np.exp(link.link_order * np.log(s))
        drag = link.damping * np.exp(link.damping_order * np.log(s)) if link.damping else 0.0
        drive = s * (s + sampled.motor.decay) / sampled.motor.gain if sampled else (1.0 + lag * s) ** 2
        return np.asarray((drag + spring) / ((inertia + drag + spring) * drive), dtype=np.complex128)

    softest = link.link_order - (link.damping_order if link.damping else 0.0)
    strength = link.damping if link.damping else spring
    motor_order = 2.0 if lag or sampled else 0.0
    drive_gain = sampled.motor.gain if sampled else (lag**-2 if lag else 1.0)
    return SampledPlant(
        response=response,
        period=period,
        delay=delay,
        decay=1.0 + motor_order + softest,
        leading=strength * drive_gain,
        before=sampled.voltage if sampled else None,
    )


def realised(controller: Controller, period: float, realisation: str) -> Callable[[Real], Complex]:
    """Return Ĉ as a function of ω [rad/s]: of the law, of the continuous Ĉ, or of Grünwald–Letnikov."""
    remedy = "say 'law' for what is shipped"
    checked_choice("realisation", realisation, ("law", "exact", "grunwald"), remedy=remedy)
    if realisation == "law":
        return _law(controller, period).frequency_response
    if realisation == "exact":
        return controller.response
    return lambda w: _grunwald(controller, w, period)


@lru_cache(maxsize=8)
def _law(controller: Controller, period: float) -> Law:
    # The minimax fit costs a tenth of a second; a table of margins asks for the same law once a payload.
    return controller.discretize(period)


def _grunwald(controller: Controller, frequency: Real, period: float) -> Complex:
    lead = grunwald_response(controller.gain, controller.order, frequency, period)
    difference = -np.expm1(-1j * np.asarray(frequency) * period) / period
    value = lead / (1.0 + controller.filter_time * difference) ** controller.filter_order
    return np.asarray(value if controller.lead is None else value * controller.lead.at(difference))
