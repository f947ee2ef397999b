"""Equations (2) to (18): the link, its resonance, the four structures, and the AIC."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

from reproduce import designs
from reproduce.points import Check, Mass, Sides, mass, power, slope_of, somewhere

__all__ = ["MODEL"]

Draw = np.random.Generator


def _place(draw: Draw, link: Mass) -> complex:
    return somewhere(draw, link.natural ** (2.0 / link.order))


def _frequency(draw: Draw, link: Mass) -> float:
    return abs(_place(draw, link))


def _newton(order: float | None) -> Check:
    """(2), (7): m L² s^λ θt = Γ."""

    def sides(code: Any, draw: Draw) -> Sides:
        link = mass(draw, order=order)
        s = _place(draw, link)
        tip, torque = link.solved(s)
        return link.inertia * s**link.order * tip, code(link.link)(s), torque

    return Check(sides)


def _deflection(code: Any, draw: Draw) -> Sides:
    """(3), (8): Γ = c (θm − θt), which is in balance with Newton's law."""
    link = mass(draw)
    s = _place(draw, link)
    tip = link.solved(s)[0]
    return (
        link.stiffness * (1.0 - tip),
        code(link.link)(s),
        link.inertia * power(s, link.order) * tip,
    )


def _tip(order: float | None) -> Check:
    def sides(code: Any, draw: Draw) -> Sides:
        link = mass(draw, order=order)
        s, square = _place(draw, link), link.natural**2
        return square / (s**link.order + square), code(link.link)(s), link.solved(s)[0]

    return Check(sides)


def _natural(code: Any, draw: Draw) -> Sides:
    """(5): the eigenvalues of the undamped oscillator."""
    link, rig = mass(draw, order=2.0), designs.rig()
    changed = replace(
        rig, link=replace(rig.link, stiffness=link.stiffness, length=link.length)
    )
    matrix = np.array([[0.0, 1.0], [-link.stiffness / link.inertia, 0.0]])
    true = float(np.max(np.linalg.eigvals(matrix).imag))
    return (
        math.sqrt(link.stiffness / (link.payload * link.length**2)),
        code(changed, link.payload),
        true,
    )


def _torque(
    order: float | None,
    damping: tuple[float, float] = (0.0, 0.0),
    viscous: bool = False,
) -> Check:
    """(6), (10), (15), (16)."""

    def sides(code: Any, draw: Draw) -> Sides:
        link = replace(
            mass(draw, order=order),
            damping=float(draw.uniform(*damping)),
            damping_order=1.0 if viscous else float(draw.uniform(0.3, 1.6)),
        )
        s, square = _place(draw, link), link.natural**2
        drag = link.damping * s**link.damping_order
        printed = link.stiffness * s**link.order / (s**link.order + drag + square)
        return printed, code(link.link)(s), link.solved(s)[1]

    return Check(sides)


def _modulus(link: Mass, w: float) -> float:
    """|f(jω)|² with f = ω₀²/G, from the linear system."""
    return link.natural**4 / abs(link.solved(1j * w)[0]) ** 2


def _response(code: Any, draw: Draw) -> Sides:
    """(11)."""
    link = mass(draw)
    w, square, angle = (
        _frequency(draw, link),
        link.natural**2,
        0.5 * math.pi * link.order,
    )
    printed = square / (
        w**link.order * (math.cos(angle) + 1j * math.sin(angle)) + square
    )
    return printed, code(link.link)(1j * w), link.solved(1j * w)[0]


def _square(code: Any, draw: Draw) -> Sides:
    """(12)."""
    link = mass(draw)
    w, angle = _frequency(draw, link), 0.5 * math.pi * link.order
    printed = (math.cos(angle) * w**link.order + link.natural**2) ** 2
    printed += math.sin(angle) ** 2 * w ** (2.0 * link.order)
    return printed, code(w, link.natural, link.order), _modulus(link, w)


def _derivative(code: Any, draw: Draw) -> Sides:
    """(13)."""
    link = mass(draw)
    w = _frequency(draw, link)
    printed = w**link.order + link.natural**2 * math.cos(0.5 * math.pi * link.order)
    return (
        printed,
        code(w, link.natural, link.order),
        slope_of(lambda x: _modulus(link, x), w, 1e-4),
    )


def _resonance(code: Any, draw: Draw) -> Sides:
    """(14): the zero of the numerical derivative of |f|²."""
    link = mass(draw, order=float(draw.uniform(1.2, 1.98)))
    printed = (-(link.natural**2) * math.cos(0.5 * math.pi * link.order)) ** (
        1.0 / link.order
    )
    scale = link.natural ** (2.0 / link.order)
    true = brentq(
        lambda x: slope_of(lambda w: _modulus(link, w), x, 1e-3),
        0.1 * scale,
        2.0 * scale,
        xtol=1e-13,
    )
    return printed, code(link.natural, link.order), true


def _residual(draw: Draw) -> tuple[int, int, float, float]:
    """Return k, n, the mean square of a random residual, and its Gaussian
    log-likelihood at that variance.
    """
    n = int(draw.integers(50, 400))
    error = draw.normal(0.0, draw.uniform(0.01, 2.0), n)
    square = float(np.mean(error**2))
    return (
        int(draw.integers(1, 4)),
        n,
        square,
        float(np.sum(norm.logpdf(error, scale=math.sqrt(square)))),
    )


def _likelihood(code: Any, draw: Draw) -> Sides:
    """(17), which for Gaussian residuals is (18) plus a constant."""
    k, n, square, likelihood = _residual(draw)
    constant = n * (math.log(2.0 * math.pi) + 1.0)
    return (
        2.0 * k - 2.0 * likelihood,
        code(likelihood, k),
        2.0 * k + n * cmath.log(square).real + constant,
    )


def _squares(code: Any, draw: Draw) -> Sides:
    """(18), without the constant of (17)."""
    k, n, square, likelihood = _residual(draw)
    constant = n * (math.log(2.0 * math.pi) + 1.0)
    return (
        2.0 * k + n * math.log(square),
        code(square, n, k),
        2.0 * k - 2.0 * likelihood - constant,
    )


MODEL: Mapping[str, Check] = {
    "(2)": _newton(2.0),
    "(3)": Check(_deflection),
    "(4)": _tip(2.0),
    "(5)": Check(_natural),
    "(6)": _torque(2.0),
    "(7)": _newton(None),
    "(8)": Check(_deflection),
    "(9)": _tip(None),
    "(10)": _torque(None),
    "(11)": Check(_response),
    "(12)": Check(_square),
    "(13)": Check(_derivative),
    "(14)": Check(_resonance, 20),
    "(15)": _torque(2.0, (0.1, 5.0), viscous=True),
    "(16)": _torque(2.0, (0.1, 5.0)),
    "(17)": Check(_likelihood),
    "(18)": Check(_squares),
}
