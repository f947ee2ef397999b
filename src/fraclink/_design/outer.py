"""The controller's second term Ĉ as a function of the parameters of a search."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fraclink._arm.controller import Controller
from fraclink._arm.notch import Notch
from fracsys.checks import Real

__all__ = ["Outer"]


@dataclass(frozen=True, eq=False)
class Outer:
    """Ĉ in terms of parameters `x` in which the rows of a design are nearly linear: ln|Ĉ|
    at a frequency ω_r (of Ĉ without its notch), β and ln δ,

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
        # no filter is one whose corner lies far above every frequency
        lag = max(controller.filter_time, np.finfo(float).tiny)
        level = math.log(controller.derivative_gain)
        level += controller.derivative_order * math.log(reference)
        level -= 0.5 * order * math.log1p((lag * reference) ** 2)
        x = [level, controller.derivative_order, math.log(lag)]
        if notch is not None:
            parts = notch.frequency, notch.poles, notch.zeros / notch.poles
            x += map(math.log, parts)
        return Outer(np.array(x), reference, order)

    @property
    def notch(self) -> Notch | None:
        """The notch of these parameters."""
        if self.x.size == 3:
            return None
        centre, poles, depth = np.exp(self.x[3:])
        return Notch(float(centre), float(min(poles * depth, poles)), float(poles))
