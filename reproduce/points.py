"""Random links, loops and crossovers, and the independent computations used by the
checks of equations.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop
from reproduce import forms

__all__ = [
    "Check",
    "Mass",
    "Sides",
    "crossing_at",
    "mass",
    "power",
    "random_crossing",
    "slope_of",
    "somewhere",
]

Sides = tuple[ArrayLike, ArrayLike, ArrayLike]  # printed, code, independent


@dataclass(frozen=True)
class Check:
    """How one equation is evaluated: `sides(code, draw)` at one random point, and the
    number of points.
    """

    sides: Callable[[Any, np.random.Generator], Sides]
    points: int = 40


@dataclass(frozen=True)
class Mass:
    """A payload at the tip of a link: c [N·m/rad], m [kg], L [m], λ, μ and α."""

    stiffness: float
    payload: float
    length: float
    order: float
    damping: float = 0.0
    damping_order: float = 1.0

    @property
    def inertia(self) -> float:
        """m L² [kg·m²]."""
        return self.payload * self.length**2

    @property
    def natural(self) -> float:
        """ω₀ from the energy balance ½ m L² ω₀² = ½ c, by logarithms instead of a root."""
        return math.exp(0.5 * (math.log(self.stiffness) - math.log(self.inertia)))

    @property
    def link(self) -> LinkModel:
        """The same link as an object of the package."""
        return LinkModel(
            self.stiffness, self.natural, self.order, self.damping, self.damping_order
        )

    def solved(self, s: complex) -> tuple[complex, complex]:
        """(θt, Γ) for θm = 1: Newton's law with the restoring torque, and the strain
        measured by the gauge.
        """
        pull = (
            self.inertia * self.damping * power(s, self.damping_order) + self.stiffness
        )
        matrix = [
            [self.inertia * power(s, self.order) + pull, 0.0],
            [self.stiffness, 1.0],
        ]
        tip, torque = np.linalg.solve(
            np.array(matrix), np.array([pull, self.stiffness], dtype=complex)
        )
        return complex(tip), complex(torque)


def power(s: complex, order: float) -> complex:
    """s^order in polar form, on the principal sheet."""
    return cmath.rect(abs(s) ** order, order * cmath.phase(s))


def mass(draw: np.random.Generator, *, order: float | None = None) -> Mass:
    """A random payload on a random link; 1 < λ < 2 unless `order` is given."""
    found = draw.uniform(1.05, 1.98) if order is None else order
    return Mass(
        draw.uniform(0.5, 3.0),
        draw.uniform(0.005, 0.08),
        draw.uniform(0.3, 1.0),
        float(found),
    )


def somewhere(draw: np.random.Generator, scale: float) -> complex:
    """A random s with a positive real part, within a factor of four of `scale`."""
    return cmath.rect(scale * draw.uniform(0.25, 4.0), draw.uniform(0.05, 1.5))


def slope_of(
    function: Callable[[float], float], at: float, step: float = 1e-3
) -> float:
    """d/dx by a five-point formula; the error is h⁴/30 times the fifth derivative, with
    h = `step`·`at`.
    """
    h = step * at
    near, far = (
        function(at + h) - function(at - h),
        function(at + 2 * h) - function(at - 2 * h),
    )
    return (8.0 * near - far) / (12.0 * h)


def random_crossing(draw: np.random.Generator) -> forms.Crossing:
    """A random crossover of (34) that meets (39), with ω₀ > 1 and 0 < β < λ."""
    order = float(draw.uniform(1.1, 1.97))
    beta, natural = (
        order * float(draw.uniform(0.1, 0.9)),
        float(draw.uniform(1.5, 30.0)),
    )
    frequency = Loop(link_order=order).sufficient(natural) * float(
        draw.uniform(1.05, 4.0)
    )
    gain = 1.0 / abs(forms.loop_value(frequency, 1.0, beta, order, natural))
    return forms.Crossing(gain, beta, order, natural, frequency)


def crossing_at(of: forms.Crossing, natural: float) -> forms.Crossing:
    """The crossover with the same controller at another ω₀, by bisection above the
    resonance of the torque.
    """

    def level(w: float) -> float:
        return math.log(abs(forms.loop_value(w, of.gain, of.beta, of.order, natural)))

    start = (natural**2 / -math.cos(0.5 * math.pi * of.order)) ** (1.0 / of.order)
    end = start
    while level(end) > 0.0:
        end *= 2.0
    found = float(brentq(level, start, end, xtol=1e-300, rtol=8.9e-16, maxiter=500))
    return forms.Crossing(of.gain, of.beta, of.order, natural, found)
