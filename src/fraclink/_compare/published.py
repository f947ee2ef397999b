"""The paper's controller as printed and as corrected, and C' from the integer-order model."""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING

from fraclink._arm.controller import Controller
from fraclink._compare.optimal import integer_mode

if TYPE_CHECKING:
    from fraclink._compare.setting import Setting

__all__ = ["CORRECTED", "INTEGER", "PRINTED", "corrected", "integer_twin", "printed"]

PRINTED, CORRECTED, INTEGER = "C as printed (58)", "C as corrected", "C' (integer model)"
Ruled = tuple[str, Controller]


def printed(setting: Setting) -> Ruled:
    """Return (58) with the numbers the paper prints."""
    ours = setting.controller
    controller = Controller(
        gain=0.148, order=0.65, filter_time=0.16, filter_order=2, link=ours.link, inner=ours.inner
    )
    return "the paper's numbers: k_d 0.148, β 0.65, δ 0.16 s, n 2", controller


def corrected(setting: Setting) -> Ruled:
    """Return the paper's procedure done right: (54)-(57) with M = 1, 16 rad/s, 70°, 10 % for δ."""
    from fraclink._design import deg, design

    payloads = setting.rig.payloads
    result = design(
        setting.model,
        setting.rig,
        payloads=(payloads.low, payloads.high),
        gain_crossover=16.0,
        phase_margin=deg(70.0),
        margins="ideal",
        filter_order=2,
    )
    rule = "the paper's procedure (54)-(57) recomputed: ω_c 16 rad/s, 70° for M = 1 without sampling"
    return rule, result.controller


def integer_twin(setting: Setting) -> Ruled:
    """Return C': k' s^β' on an undamped integer-order model, through our nominal crossing.

    β' and k' give the loop with the mode ω²/(s² + ω²) the crossover and the phase margin that ours has at the
    nominal payload; filter, M(s), hold and delay are in both.
    """
    ours, period = setting.controller, setting.rig.period
    crossover, margin = _nominal_crossing(setting)
    mode, _ = integer_mode(setting.model)
    s = 1j * crossover
    delay = (setting.rig.inner.delay_samples + 0.5) * period
    known = mode**2 / (s**2 + mode**2) / (1 + s / setting.ours.inner_pole) ** 2 * cmath.exp(-s * delay)
    known /= (1 + ours.filter_time * s) ** ours.filter_order
    # Above its resonance the undamped mode is at −180° exactly.
    order = (margin - math.pi - (cmath.phase(-known) - math.pi)) / (0.5 * math.pi)
    controller = Controller(
        gain=1.0 / (abs(known) * crossover**order),
        order=order,
        filter_time=ours.filter_time,
        filter_order=ours.filter_order,
        link=ours.link,
        inner=ours.inner,
        period=period,
    )
    rule = (
        "integer-order model with the nominal mode; crossover and phase margin of ours at the nominal payload"
    )
    return rule, controller


def _nominal_crossing(setting: Setting) -> tuple[float, float]:
    """Crossover [rad/s] and phase margin [rad] of our continuous loop at the nominal payload."""
    from fraclink._design.loop import OpenLoop

    c, period = setting.controller, setting.rig.period
    link = setting.model
    loop = OpenLoop(
        gain=c.gain,
        order=c.order,
        link_order=link.order,
        damping=link.damping,
        damping_order=link.damping_order,
        filter_time=c.filter_time,
        filter_order=c.filter_order,
        lag=1.0 / setting.ours.inner_pole,
        delay=(setting.rig.inner.delay_samples + 0.5) * period,
    )
    low, high = 1.02 * integer_mode(link)[0], 0.9 * math.pi / period
    for _ in range(200):  # |L| falls from the peak on: the crossing is bracketed
        middle = math.sqrt(low * high)
        if float(loop.level(middle, link.natural_frequency)) > 0.0:
            low = middle
        else:
            high = middle
    phase = float(loop.log(low, link.natural_frequency).imag)
    return low, phase + math.pi
