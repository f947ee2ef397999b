"""The controller's second term Ĉ by the parameters of a search."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.controller import Controller
from fraclink._arm.notch import Notch
from fracsys.checks import Complex, Real

__all__ = ["Outer"]


@dataclass(frozen=True, eq=False)
class Outer:
    """Ĉ by parameters `x` in which its rows are nearly linear: ln|Ĉ| without a notch at
    a frequency ω_r, β and ln δ,

        ln Ĉ = x₀ + β ln(s/ω_r) − n (ln(1 + δs) − ln|1 + jδω_r|) + ln N(s; x₃, x₄, x₅)

    so that neither β nor δ moves a crossover at ω_r.

    ``reference`` is ω_r [rad/s], ``filter_order`` n; parameters beyond the third are
    ln ω_N, ln ζ_p and ln(ζ_z/ζ_p) of a notch.
    """

    x: Real
    reference: float
    filter_order: int

    @staticmethod
    def of(controller: Controller, reference: float) -> Outer:
        """Return Ĉ of a controller."""
        order, notch = controller.filter_order, controller.notch
        # no filter is one far above every frequency
        lag = max(controller.filter_time, np.finfo(float).tiny)
        level = math.log(controller.derivative_gain)
        level += controller.derivative_order * math.log(reference)
        level -= 0.5 * order * math.log1p((lag * reference) ** 2)
        x = [level, controller.derivative_order, math.log(lag)]
        if notch is not None:
            parts = notch.frequency, notch.poles, notch.zeros / notch.poles
            x += map(math.log, parts)
        return Outer(np.array(x), reference, order)

    def log(self, w: NDArray[Any]) -> Complex:
        """Return ln Ĉ(jω)."""
        s, lag = 1j * w, math.exp(self.x[2])
        filtered = np.log1p(lag * s) - 0.5 * math.log1p((lag * self.reference) ** 2)
        value = self.x[0] + self.x[1] * (np.log(w / self.reference) + 0.5j * math.pi)
        value = value - self.filter_order * filtered
        if self.x.size > 3:
            top, bottom, *_ = self._notch_parts(s)
            value = value + np.log(top / bottom)
        return np.asarray(value)

    def slope(self, w: Real) -> Complex:
        """Return d ln Ĉ/d ln ω."""
        s = 1j * w
        lagged = math.exp(self.x[2]) * s
        value = self.x[1] - self.filter_order * lagged / (1.0 + lagged)
        if self.x.size > 3:
            top, bottom, zero, pole = self._notch_parts(s)
            value = value + 2.0 * s * ((s + zero) / top - (s + pole) / bottom)
        return np.asarray(value)

    def gradient(self, w: NDArray[Any]) -> Complex:
        """Return ∂ ln Ĉ/∂x at ω, the parameters along the first axis."""
        s, lag = 1j * w, math.exp(self.x[2])
        lagged, square = lag * s, (lag * self.reference) ** 2
        filtered = lagged / (1.0 + lagged) - square / (1.0 + square)
        rows = [
            np.ones_like(s),
            np.log(w / self.reference) + 0.5j * math.pi,
            -self.filter_order * filtered,
        ]
        if self.x.size > 3:
            top, bottom, zero, pole = self._notch_parts(s)
            square = 2.0 * math.exp(2.0 * self.x[3])
            above, below = 2.0 * zero * s / top, 2.0 * pole * s / bottom
            rows += [
                square / top - square / bottom + above - below,
                above - below,
                above,
            ]
        return np.array(rows)

    def _notch_parts(self, s: NDArray[Any]) -> tuple[Complex, Complex, float, float]:
        """Numerator and denominator of N(s), and ζ ω_N for each."""
        centre, poles, depth = np.exp(self.x[3:])
        pole, zero = poles * centre, depth * poles * centre
        rest = s * s + centre * centre
        return rest + 2.0 * zero * s, rest + 2.0 * pole * s, zero, pole

    @property
    def notch(self) -> Notch | None:
        """The notch of these parameters."""
        if self.x.size == 3:
            return None
        centre, poles, depth = np.exp(self.x[3:])
        return Notch(float(centre), float(min(poles * depth, poles)), float(poles))
