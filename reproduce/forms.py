"""The equations of the paper that the package does not use in this form, each as a
function of its own symbols.

`reproduce.equations` evaluates them, and those of the package, at random points against
expressions that do not share their algebra. ω₀ is the paper's ϖ throughout.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "aic_of_likelihood",
    "closed_loop",
    "control_law",
    "crossover_rate",
    "derivative_of_modulus",
    "differential",
    "differential_at_crossing",
    "inequality_37",
    "inequality_41",
    "margin_rate",
    "margin_rate_from_crossover",
    "offset_error",
    "rate_of_reserve",
    "rate_of_reserve_from_crossover",
    "reserve",
    "reserve_by_integral",
    "square_of_modulus",
    "tip_estimate",
    "tip_resonance",
]

Complex = NDArray[np.complex128]


def _cosine(order: float) -> float:
    return math.cos(0.5 * math.pi * order)


def _sine(order: float) -> float:
    return math.sin(0.5 * math.pi * order)


# ---- section 3 --------------------------------------------------------------------------------------------


def square_of_modulus(w: float, natural: float, order: float) -> float:
    """|f(jω)|² of (12), f = (jω)^λ + ω₀²."""
    return float(
        (_cosine(order) * w**order + natural**2) ** 2 + (_sine(order) * w**order) ** 2
    )


def tip_resonance(natural: float, order: float) -> float:
    """The frequency of (14) at which |θt/θm| peaks, (−ω₀² cos(πλ/2))^(1/λ)."""
    return float((-(natural**2) * _cosine(order)) ** (1.0 / order))


def derivative_of_modulus(w: float, natural: float, order: float) -> float:
    """∂|f|²/∂ω of (13), with the factor 2λω^(λ−1), which is missing in print."""
    return float(
        2.0 * order * w ** (order - 1.0) * (w**order + natural**2 * _cosine(order))
    )


def aic_of_likelihood(log_likelihood: float, free: int) -> float:
    """AIC = 2k − 2 ln Lik (17)."""
    return 2.0 * free - 2.0 * log_likelihood


# ---- sections 4 and 5 -------------------------------------------------------------------------------------


def control_law(
    reference: complex,
    estimate: complex,
    inertia: complex,
    natural: float,
    controller: complex,
) -> complex:
    """θm* of (22), corrected: θtᵉ + (s^λ/ω₀²) θt* + C (θt* − θtᵉ); `inertia` is s^λ."""
    return (
        estimate
        + inertia / natural**2 * reference
        + controller * (reference - estimate)
    )


def tip_estimate(
    motor: complex, torque: complex, disturbance: complex, stiffness: float
) -> complex:
    """θtᵉ of (23), with a disturbance d' of the measured torque [N·m]: θm − (Γ + d')/c."""
    return motor - (torque + disturbance) / stiffness


def closed_loop(
    inertia: complex,
    natural: float,
    controller: complex,
    motor: complex,
    *,
    divided: bool,
) -> Complex:
    """P(s) of (25), or of (24) divided by G: (θt, θm*) from (θt*, d), with s^λ/ω₀² for
    s^λ.
    """
    square, correction = natural**2, controller - 1.0
    if divided:
        tip = square / (inertia + square)
        ahead = controller + inertia / square
        rows = [[motor * tip * ahead, -motor * tip * correction], [ahead, -correction]]
        return np.array(rows) / (1.0 + motor * tip * correction)
    whole = inertia + square
    ahead = square * controller + inertia
    rows = [
        [motor * ahead, -square * motor * correction],
        [ahead * whole / square, -correction * whole],
    ]
    return np.array(rows) / (whole + square * motor * correction)


def offset_error(correction: float) -> float:
    """The error in θt that an offset of 1 in the tip estimate leaves by (27), for Ĉ(0)
    = `correction` and M(0) = 1.
    """
    return -correction / (1.0 + correction) + 0.0


# ---- section 6: Lemma 1 and the theorems ------------------------------------------------------------------


@dataclass(frozen=True)
class Crossing:
    """A crossover of (34): k_d, β, λ, ω₀ and ω_c [rad/s], where |L(jω_c)| = 1."""

    gain: float
    beta: float
    order: float
    natural: float
    frequency: float

    @property
    def cosine(self) -> float:
        """cos(πλ/2)."""
        return _cosine(self.order)

    @property
    def power(self) -> float:
        """ω_c^λ."""
        return float(self.frequency**self.order)

    @property
    def square(self) -> float:
        """ω₀²."""
        return float(self.natural**2)

    @property
    def modulus(self) -> float:
        """ω_c^(2λ) + 2 cos(πλ/2) ω₀² ω_c^λ + ω₀⁴."""
        return (
            self.power**2
            + 2.0 * self.cosine * self.square * self.power
            + self.square**2
        )

    @property
    def denominator(self) -> float:
        """The denominator of (48), (49) and (52), whose sign is opposite to that of the
        slope of |L|.
        """
        ahead = (
            (self.order - self.beta)
            * self.power
            * (self.power + self.cosine * self.square)
        )
        return ahead - self.beta * self.square * (
            self.square + self.cosine * self.power
        )


def inequality_37(w: float, natural: float, order: float) -> tuple[float, float]:
    """Both sides of (37): the denominator of (36), and the square that is its lower
    bound.
    """
    power, square = w**order, natural**2
    return power**2 + 2.0 * square * _cosine(order) * power + square**2, (
        power - square
    ) ** 2


def inequality_41(at: Crossing) -> tuple[float, float]:
    """The two terms of (41): 0 < first ≤ second if (39) holds."""
    return at.square / at.cosine + at.power, at.cosine * at.square + at.power


def margin_rate_from_crossover(at: Crossing, rate: float) -> float:
    """dφ_m/dω₀ of (45), from dω_c/dω₀ = `rate`."""
    top = at.order * at.natural * rate - 2.0 * at.frequency
    return float(
        -_sine(at.order)
        * at.natural
        * at.frequency ** (at.order - 1.0)
        * top
        / at.modulus
    )


def differential(at: Crossing) -> tuple[float, float]:
    """The two coefficients of (46), of dω₀ and of dω_c, which contain k_d."""
    first = (at.gain**2 * at.frequency ** (2.0 * at.beta) - 1.0) * at.natural**3
    first -= at.cosine * at.natural * at.power
    second = at.beta * at.gain**2 * at.square**2 * at.frequency ** (2.0 * at.beta - 1.0)
    second -= at.order * at.cosine * at.square * at.frequency ** (at.order - 1.0)
    second -= at.order * at.frequency ** (2.0 * at.order - 1.0)
    return 2.0 * first, second


def differential_at_crossing(at: Crossing) -> tuple[float, float]:
    """The two coefficients of (47), with k_d eliminated by (43)."""
    first = 2.0 * at.power / at.natural * (at.power + at.square * at.cosine)
    return first, -at.denominator / at.frequency


def crossover_rate(at: Crossing) -> float:
    """dω_c/dω₀ of (48)."""
    top = (
        2.0
        * at.frequency ** (at.order + 1.0)
        / at.natural
        * (at.power + at.square * at.cosine)
    )
    return float(top / at.denominator)


def margin_rate(at: Crossing) -> float:
    """dφ_m/dω₀ of (49)."""
    return -2.0 * at.beta * _sine(at.order) * at.natural * at.power / at.denominator


def reserve(at: Crossing) -> float:
    """h(ω₀) of (50), which is negative where (39) holds."""
    return at.square + at.cosine * at.power


def rate_of_reserve_from_crossover(at: Crossing, rate: float) -> float:
    """dh/dω₀ of (51), from dω_c/dω₀ = `rate`."""
    return float(
        2.0 * at.natural
        + at.order * at.cosine * at.frequency ** (at.order - 1.0) * rate
    )


def rate_of_reserve(at: Crossing) -> float:
    """dh/dω₀ of (52)."""
    left = at.order * at.power * reserve(at) * (at.power + at.cosine * at.square)
    return 2.0 / at.natural * (left - at.beta * at.square * at.modulus) / at.denominator


def reserve_by_integral(
    start: Crossing, rates: NDArray[np.float64], weights: NDArray[np.float64]
) -> float:
    """h at the end of a range of ω₀ by (53): its value at the start plus the integral
    of dh/dω₀ by quadrature.
    """
    return reserve(start) + float(rates @ weights)


def loop_value(
    w: float, gain: float, beta: float, order: float, natural: float
) -> complex:
    """L(jω) of (34) by powers of a complex base, where no class is needed."""
    return (
        gain
        * cmath.exp(beta * cmath.log(1j * w))
        / (cmath.exp(order * cmath.log(1j * w)) / natural**2 + 1.0)
    )
