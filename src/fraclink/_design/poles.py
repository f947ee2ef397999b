"""Closed-loop poles of the fractional loop, and the controllers that the paper printed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.controller import Controller
from fraclink._design.loop import OpenLoop

if TYPE_CHECKING:
    from fraclink._arm.link import LinkModel
    from fraclink._systems.fractional import FractionalTransferFunction

__all__ = ["PRINTED", "closed_loop", "closed_loop_poles", "match_at"]

# (58) from the fractional model and (59) from the integer one, as section 7.1 prints them.
PRINTED: dict[str, Controller] = {
    "(58)": Controller(gain=0.148, order=0.65, filter_time=0.16, filter_order=2),
    "(59)": Controller(gain=0.241, order=0.65, filter_time=0.16, filter_order=2),
}


def closed_loop(
    controller: Controller, link: LinkModel, *, inner_pole: float | None = None
) -> FractionalTransferFunction:
    """Return ``T = L/(1 + L)``, ``L = Ĉ M G`` (eq. (25)); M = 1 without `inner_pole` [rad/s].

    Hold and delay are left out: with them the loop has infinitely many poles.
    """
    from fraclink._systems.fractional import s

    open_loop = controller.correction() * link.tip()
    if inner_pole is not None:
        open_loop = open_loop / (1.0 + s / inner_pole) ** 2
    return open_loop.feedback()


def closed_loop_poles(
    controller: Controller, link: LinkModel, *, inner_pole: float | None = None
) -> NDArray[np.complex128]:
    """Return the poles of the closed loop on the principal sheet, rightmost first [rad/s].

    Examples
    --------
    The paper's controller (58) on the paper's link at 30 g, with its motor loop, is unstable:

    >>> from fraclink._design.poles import PRINTED, closed_loop_poles
    >>> from fraclink._arm.link import LinkModel
    >>> link = LinkModel(stiffness=1.56, natural_frequency=11.547, order=1.92)
    >>> pole = closed_loop_poles(PRINTED["(58)"], link, inner_pole=80.0)[0]
    >>> print(f"{pole.real:+.3f} ± {abs(pole.imag):.2f}j")
    +0.106 ± 12.89j
    """
    from fraclink._systems.stability import poles

    found = poles(closed_loop(controller, link, inner_pole=inner_pole))
    return np.asarray(found[np.argsort(-found.real)], dtype=np.complex128)


def match_at(
    model: LinkModel,
    natural_frequency: float,
    gain_crossover: float,
    phase_margin: float,
) -> Controller:
    """Return the unfiltered controller that has this crossover and margin at one ω₀ (eq. (42)): C'.

    One complex equation in k_d and β; `gain_crossover` [rad/s], `phase_margin` [rad].

    >>> from fraclink._design.poles import match_at
    >>> from fraclink._arm.link import LinkModel
    >>> link = LinkModel(stiffness=1.56, natural_frequency=11.54, order=2.0)
    >>> matched = match_at(link, 11.54, 20.865280, 1.2346783)
    >>> print(f"{matched.order:.6f} {matched.gain:.6f}")
    0.786021 0.208339
    """
    bare = OpenLoop(1.0, 0.0, model.order, model.damping, model.damping_order)
    value = complex(bare.log(gain_crossover, natural_frequency))
    order = 2.0 / math.pi * (phase_margin - math.pi - value.imag)
    return Controller(gain=math.exp(-value.real) / gain_crossover**order, order=order)
