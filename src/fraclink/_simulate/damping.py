"""Damping of the link's material: a passive chain of springs and dashpots for each
damping law.

Stress and strain of the link are related by D(s), in the modal equation q̈i + ωi² D(s)
qi = −Γi θ̈m:

    viscous (Kelvin–Voigt)       D = 1 + η s            massless limit: D-IOM, equation (15), μ = η ω₀²
    fractional (Kelvin–Voigt)    D = 1 + η s^α          massless limit: D-FOM, equation (16), μ = η ω₀²
    power law (springpot)        D = s^(2−λ) + η s      massless limit: UD-FOM, equation (10)

s^a with 0 < a < 1 is the exact superposition of Maxwell elements s/(s + r),

    s^a = (sin πa/π) ∫ r^a s/(s + r) d(ln r),

and the trapezoid rule in ln r is exponentially accurate. Every weight is positive, so
the chain is passive for any step and truncation: it stores or dissipates energy, but
never generates it. The two tails of the integral become two elements each, by Gauss
quadrature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from fracsys.checks import Between, Real, above, checked

__all__ = [
    "Chain",
    "Damping",
    "FractionalKelvinVoigt",
    "KelvinVoigt",
    "PowerLaw",
]


# Range of the relaxation rates [1/s] covered by the trapezoidal rule. The rest is
# represented by two elements at either end with the first four moments of the tail, so
# that the neglected terms are (SLOWEST/s)⁴ and (s/fastest)⁴ times the tail: 3e-6 of the
# damping at 1000 rad/s, and less than 2e-7 of the tip angle at low frequencies, where
# the effect of D falls as (s/ω)². The trapezoidal rule alone would need twice as many
# elements.
SLOWEST, FASTEST = 0.1, 3e3
# least ratio of the fastest rate of the trapezoidal rule to the highest frequency
REACH = 2.0


@dataclass(frozen=True)
class Chain:
    """D(s) = spring + dashpot·s + Σ weights·s/(s + rates), all coefficients >= 0, hence
    passive.
    """

    spring: float
    dashpot: float
    weights: Real
    rates: Real

    def __call__(self, s: complex) -> complex:
        """Return D(s)."""
        return complex(
            self.spring + self.dashpot * s + np.sum(self.weights * s / (s + self.rates))
        )


def _gauss(moments: list[float]) -> tuple[Real, Real]:
    """Two nodes and weights, all positive, with the first four moments of a positive
    measure on (0, 1).
    """
    m0, m1, m2, m3 = moments
    determinant = m0 * m2 - m1 * m1
    linear = (m1 * m2 - m0 * m3) / determinant
    constant = (m1 * m3 - m2 * m2) / determinant
    # Roots of the quadratic orthogonal polynomial of the measure; the smaller one from
    # the product, since the difference would cancel.
    large = 0.5 * (-linear + math.sqrt(linear * linear - 4.0 * constant))
    small = constant / large
    weight = (m1 - m0 * small) / (large - small)
    return np.array([small, large]), np.array([m0 - weight, weight])


def _chain(
    spring: float, scale: float, order: float, tolerance: float, highest: float
) -> Chain:
    """Return spring + scale·s^order as a passive chain, with relative error `tolerance`
    on the imaginary axis.
    """
    # For s = jω the nearest singularity of the integrand lies π/2 off the real axis of
    # ln r, so the error of the trapezoidal rule is 2 exp(−π²/h): 3e-8 takes h = 0.55,
    # which is 20 elements for four and a half decades of rates.
    step = math.pi**2 / math.log(2.0 / tolerance)
    count = math.ceil(math.log(max(FASTEST, REACH * highest) / SLOWEST) / step) + 1
    rates = SLOWEST * np.exp(step * np.arange(count))
    factor = scale * step * math.sin(math.pi * order) / math.pi
    # The trapezoidal sum continues on both sides; its moments there are geometric sums,
    # in r/SLOWEST below the range and, for Σ w s/(s + r) = s Σ (w/r)/(1 + s/r), in
    # fastest/r above it.
    near, near_weights = _gauss(
        [factor / math.expm1((order + k) * step) for k in range(4)]
    )
    far, far_weights = _gauss(
        [factor / math.expm1((1.0 - order + k) * step) for k in range(4)]
    )
    fast = rates[-1] / far
    return Chain(
        spring,
        0.0,
        np.concatenate(
            [
                SLOWEST**order * near_weights,
                factor * rates**order,
                rates[-1] ** (order - 1.0) * far_weights * fast,
            ]
        ),
        np.concatenate([SLOWEST * near, rates, fast]),
    )


_ENERGY = "a negative one would generate energy: check its sign"
_Time = Annotated[float, Between(0.0, 1e6, "s", remedy=_ENERGY)]


@checked
@dataclass(frozen=True)
class KelvinVoigt:
    """Viscous damping, D = 1 + η s.

    time: η [s], >= 0; 0 is the undamped link. Negative η generates energy and is rejected.
    higher: η of the modes beyond the first [s], if it differs from the material's.

    A mode at ω has the damping ratio ζ = η ω/2.

    >>> KelvinVoigt(2 * 0.0655 / 10.0)
    KelvinVoigt(time=0.0131, higher=None)
    """

    time: _Time
    higher: _Time | None = None

    def chain(self, tolerance: float, highest: float = 1500.0) -> Chain:
        """Return D(s) as a passive chain, accurate up to `highest` [rad/s]."""
        return Chain(1.0, self.time, np.zeros(0), np.zeros(0))

    @property
    def label(self) -> str:
        """Name and parameters, for headers of logs."""
        return f"viscous, D = 1 + {self.time:g} s"


@checked
@dataclass(frozen=True)
class FractionalKelvinVoigt:
    """Fractional damping, D = 1 + η s^α.

    coefficient: η [s^α], >= 0; order: α, 0 < α < 1. With another order the element is
    not a material's damper (α = 1 is `KelvinVoigt`, α > 1 is partly an inertia); η < 0
    generates energy. higher: as in `KelvinVoigt`.

    >>> FractionalKelvinVoigt(coefficient=0.012, order=0.9).label
    'fractional, D = 1 + 0.012 s^0.9'
    """

    coefficient: Annotated[float, Between(0.0, 1e6, "s^α", remedy=_ENERGY)]
    order: Annotated[
        float,
        above(0.0, 1.0, high_open=True, remedy="use KelvinVoigt for α = 1"),
    ]
    higher: _Time | None = None

    def chain(self, tolerance: float, highest: float = 1500.0) -> Chain:
        """Return D(s) as a passive chain, accurate up to `highest` [rad/s]."""
        return _chain(1.0, self.coefficient, self.order, tolerance, highest)

    @property
    def label(self) -> str:
        """Name and parameters, for headers of logs."""
        return f"fractional, D = 1 + {self.coefficient:g} s^{self.order:g}"


@checked
@dataclass(frozen=True)
class PowerLaw:
    """Power-law link, D = s^(2−λ): the paper's order λ of the inertia, attributed to
    the material.

    m L² s^λ θt = c (θm − θt), equation (8), is m L² s² θt = c s^(2−λ) (θm − θt):
    Newton's law with a link whose stiffness is a springpot. D is in units of s^(λ−2),
    with the second as its reference time.

    order: λ, 1 < λ < 2; λ = 2 is `KelvinVoigt(0)`. λ > 2 generates energy and is rejected.
    higher: as in `KelvinVoigt`.
    dashpot: η of a dashpot beside the springpot, D = s^(2−λ) + η s, >= 0.

    >>> round(abs(PowerLaw(1.92).chain(1e-7)(12.0j)) / 12.0**0.08, 6)
    1.0
    """

    order: Annotated[
        float,
        above(
            1.0,
            2.0,
            "(λ)",
            high_open=True,
            remedy="use KelvinVoigt(0.0) for λ = 2; beyond it the link would generate energy",
        ),
    ]
    higher: _Time | None = None
    dashpot: _Time = 0.0

    def chain(self, tolerance: float, highest: float = 1500.0) -> Chain:
        """Return D(s) as a passive chain, accurate up to `highest` [rad/s]."""
        # A springpot has no parallel spring: at rest its slowest element bears the
        # load, and creeps.
        return replace(
            _chain(0.0, 1.0, 2.0 - self.order, tolerance, highest),
            dashpot=self.dashpot,
        )

    @property
    def label(self) -> str:
        """Name and parameters, for headers of logs."""
        return f"power law, D = s^{2.0 - self.order:.6g} (lambda = {self.order:g})"


Damping = KelvinVoigt | FractionalKelvinVoigt | PowerLaw
