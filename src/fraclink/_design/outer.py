"""Ĉ by parameters in which ln Ĉ is nearly linear, with its gradients.

The parameters are ln|Ĉ| without its filter at a frequency ω_r, β and ln δ, so that

    ln Ĉ = x₀ + β ln(s/ω_r) − n ln(1 + e^{x₂} s) + ln N(s; x₃, x₄, x₅)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.notch import Notch
from fracsys.checks import Complex, Real

__all__ = ["Outer"]

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Outer:
    """Ĉ of the parameters `x`, shape (P, K): one column for each link of a table.

    ``reference`` is ω_r [rad/s], ``filter_order`` n; parameters beyond the third are
    ln ω_N, ln ζ_p and ln(ζ_z/ζ_p) of a notch. Frequencies [rad/s] come with the column
    that each belongs to.
    """

    x: Real
    reference: float
    filter_order: int

    def log(self, w: NDArray[Any], link: Index) -> Complex:
        """Return ln Ĉ(jω)."""
        s = 1j * w
        gain, order, lag, *notch = self.x[:, link]
        value = gain + order * (np.log(w / self.reference) + 0.5j * math.pi)
        value = value - self.filter_order * np.log1p(np.exp(lag) * s)
        if notch:
            top, bottom, *_ = _notch_parts(s, *notch)
            value = value + np.log(top / bottom)
        return np.asarray(value)

    def slope(self, w: Real, link: Index) -> Complex:
        """Return d ln Ĉ/d ln ω."""
        s = 1j * w
        _, order, lag, *notch = self.x[:, link]
        lagged = np.exp(lag) * s
        value = order - self.filter_order * lagged / (1.0 + lagged)
        if notch:
            top, bottom, zero, pole = _notch_parts(s, *notch)
            value = value + 2.0 * s * ((s + zero) / top - (s + pole) / bottom)
        return np.asarray(value)

    def gradient(self, w: NDArray[Any], link: Index) -> Complex:
        """Return ∂ ln Ĉ/∂x at ω, the parameters along the first axis."""
        s = 1j * w
        _, _, lag, *notch = self.x[:, link]
        lagged = np.exp(lag) * s
        rows = [
            np.ones_like(s),
            np.log(w / self.reference) + 0.5j * math.pi,
            -self.filter_order * lagged / (1.0 + lagged),
        ]
        if notch:
            top, bottom, zero, pole = _notch_parts(s, *notch)
            square = 2.0 * np.exp(2.0 * notch[0])
            above, below = 2.0 * zero * s / top, 2.0 * pole * s / bottom
            rows += [
                square / top - square / bottom + above - below,
                above - below,
                above,
            ]
        return np.array(rows)

    @property
    def notch(self) -> Notch | None:
        """The notch of the first link's parameters."""
        if len(self.x) == 3:
            return None
        centre, poles, depth = np.exp(self.x[3:, 0])
        return Notch(float(centre), float(min(poles * depth, poles)), float(poles))


def _notch_parts(
    s: NDArray[Any], centre: Real, poles: Real, depth: Real
) -> tuple[Complex, Complex, Real, Real]:
    """Numerator and denominator of N(s), and ζ ω_N for each."""
    centre = np.exp(centre)
    pole = np.exp(poles) * centre
    zero = np.exp(depth) * pole
    rest = s * s + centre * centre
    return rest + 2.0 * zero * s, rest + 2.0 * pole * s, zero, pole
