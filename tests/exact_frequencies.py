"""The frequencies of the twin's link from its transcendental equation, to check the
finite elements.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FieldError
from fraclink.extend import Beam

__all__ = ["exact_frequencies"]


def exact_frequencies(beam: Beam, count: int = 3) -> NDArray[np.float64]:
    """Return the first frequencies of the beam from its transcendental equation
    [rad/s].

    With β = kL, μ = m/(ρA L) and j = J/(ρA L³), ω = β² √(EI/(ρA L⁴)) and

        1 + cos β cosh β + μ β (cos β sinh β − sin β cosh β)
          − j β³ (cos β sinh β + sin β cosh β) + μ j β⁴ (1 − cos β cosh β) = 0.

    It shares nothing with the finite elements of `Beam.modes`, which are checked
    against it. A massless link has the one frequency of equation (5).

    Source: Meirovitch, Fundamentals of Vibrations (2001), section 8.4, with a tip mass.

    >>> rod = Beam(0.65, 0.26, 0.00735, 0.030)
    >>> [round(w, 2) for w in exact_frequencies(rod).tolist()]
    [9.46, 177.53, 569.81]
    """
    if beam.link_mass == 0.0:
        if beam.payload_inertia > 0.0 and beam.payload > 0.0:
            raise FieldError(
                "payload_inertia",
                beam.payload_inertia,
                "not covered by the transcendental equation of a massless link",
                allowed="0 kg·m²",
                remedy="use Beam.modes",
            )
        inertia = beam.payload * beam.length**2 + beam.payload_inertia
        return np.array([math.sqrt(beam.stiffness / inertia)])
    scale = math.sqrt(beam.flexural_rigidity / (beam.link_mass * beam.length**3))
    mass = beam.payload / beam.link_mass
    inertia = beam.payload_inertia / (beam.link_mass * beam.length**2)

    def equation(beta: float) -> float:
        # Divided by cosh β, so that it neither overflows nor loses the roots at large
        # β.
        c, s, th, sech = (
            math.cos(beta),
            math.sin(beta),
            math.tanh(beta),
            1.0 / math.cosh(beta),
        )
        return (
            sech
            + c
            + mass * beta * (c * th - s)
            - inertia * beta**3 * (c * th + s)
            + mass * inertia * beta**4 * (sech - c)
        )

    roots: list[float] = []
    # The first root tends to 0 like (3 ρA L/m)^¼ as the link gets lighter; the others
    # lie about π apart, never closer than 0.5, so that this step cannot jump over two
    # of them.
    low = 1e-6
    value = equation(low)
    while len(roots) < count:
        high = low * 1.5 if low < 0.1 else low + 0.05
        following = equation(high)
        if value * following <= 0.0:
            roots.append(_bisect(equation, low, high))
        low, value = high, following
    return np.array([scale * root * root for root in roots])


def _bisect(equation: Callable[[float], float], low: float, high: float) -> float:
    sign = math.copysign(1.0, equation(low))
    for _ in range(200):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        if sign * equation(middle) > 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
