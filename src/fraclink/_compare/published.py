"""The paper's controller as printed and as corrected, and C' from the integer-order model."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fraclink._arm.controller import Controller
from fraclink._arm.loop import Loop
from fraclink._arm.motor_loop import MotorLoop
from fraclink._compare.optimal import integer_mode
from fraclink._design.assess import matched_in

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
    crossover, margin = _nominal_crossing(setting)
    mode, _ = integer_mode(setting.model)
    beside = replace(_loop(setting), gain=1.0, order=0.0, link_order=2.0, damping=0.0)
    matched = matched_in(beside, mode, crossover, margin)
    controller = replace(setting.controller, gain=matched.gain, order=matched.order)
    rule = (
        "integer-order model with the nominal mode; crossover and phase margin of ours at the nominal payload"
    )
    return rule, controller


def _nominal_crossing(setting: Setting) -> tuple[float, float]:
    """Crossover [rad/s] and phase margin [rad] of our continuous loop at the nominal payload."""
    loop, w0 = _loop(setting), setting.model.natural_frequency
    found = loop.crossings(w0)
    last = int(np.argmax(found.frequency))
    return float(found.frequency[last]), float(found.phase[last]) + math.pi


def _loop(setting: Setting) -> Loop:
    """Our loop, with the ideal motor loop of the law."""
    motor_loop = MotorLoop(setting.ours.inner_pole, setting.rig.inner.delay_samples)
    beside = Loop.around(setting.model, motor_loop, setting.rig.motor, setting.rig.period)
    return beside.with_controller(setting.controller)
