"""The paper's controllers for the same arm, C' of the integer-order model, and a
quieter design.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fraclink._arm.controller import Controller
from fraclink._arm.loop import Loop
from fraclink._arm.motor_loop import MotorLoop
from fraclink._campaign.rival_controllers import integer_mode
from fraclink._campaign.setting import Setting
from fraclink._design import deg, design
from fraclink._design.assess import matched_in
from fraclink.errors import InfeasibleError

__all__ = [
    "CORRECTED",
    "INTEGER",
    "PRINTED",
    "QUIETER",
    "corrected",
    "integer_twin",
    "printed",
    "quieter",
]

PRINTED, CORRECTED, INTEGER = (
    "C as printed (58)",
    "C as corrected",
    "C' (integer model)",
)
Ruled = tuple[str, Controller]


def printed(setting: Setting) -> Ruled:
    """Return (58) with the numbers the paper prints."""
    own = setting.controller
    controller = Controller(
        # Not rounded, not corrected: (58) as it stands in the paper, although δ = 0.16
        # s is probably a misprint for 0.0016 s. What comes of it is shown and not
        # judged here.
        gain=0.148,
        order=0.65,
        filter_time=0.16,
        filter_order=2,
        link=own.link,
        inner=own.inner,
    )
    return "the paper's numbers: k_d 0.148, β 0.65, δ 0.16 s, n 2", controller


def corrected(setting: Setting) -> Ruled:
    """Return the paper's procedure done right: (54)-(57) with M = 1, 16 rad/s, 70°, 10
    % for δ.
    """
    payloads = setting.rig.payloads
    result = design(
        setting.model,
        setting.rig,
        payloads=(payloads.low, payloads.high),
        gain_crossover=16.0,
        phase_margin=deg(70.0),
        # As the paper computes them: M(s) = 1 and no sampling. Its own specification,
        # 16 rad/s and 70°, is not feasible with hold and delay.
        margins="ideal",
        filter_order=2,
        law=False,
    )
    rule = "the paper's procedure (54)-(57) recomputed: ω_c 16 rad/s, 70° for M = 1 without sampling"
    return rule, result.controller


def integer_twin(setting: Setting) -> Ruled:
    """Return C': k' s^β' on an undamped integer-order model, through the nominal
    crossing of fraclink's loop.

    β' and k' give the loop with the mode ω²/(s² + ω²) the crossover and the phase
    margin of the design at the nominal payload; filter, M(s), hold and delay are in
    both.
    """
    crossover, margin = _nominal_crossing(setting)
    mode, _ = integer_mode(setting.model)
    # s^β with gain 1 and order 0 is 1: the loop without its controller, whose phase and
    # gain at the crossover say what k and β must be.
    beside = replace(_loop(setting), gain=1.0, order=0.0, link_order=2.0, damping=0.0)
    matched = matched_in(beside, mode, crossover, margin)
    controller = replace(setting.controller, gain=matched.gain, order=matched.order)
    rule = "integer-order model with the nominal mode; the design's crossover and phase margin there"
    return rule, controller


def _nominal_crossing(setting: Setting) -> tuple[float, float]:
    """Upper gain crossover [rad/s] and phase margin [rad] of the design's loop at the
    nominal payload.
    """
    crossings = _loop(setting).crossings(setting.model.natural_frequency)
    # The loop crosses one twice, below the resonance and above; bandwidth and margin
    # are those of the upper crossing, (54) and (55).
    upper = int(np.argmax(crossings.frequency))
    return float(crossings.frequency[upper]), float(crossings.phase[upper]) + math.pi


def _loop(setting: Setting) -> Loop:
    """The design's loop, with the ideal motor loop of its law."""
    motor_loop = MotorLoop(setting.law.inner_pole, setting.rig.motor_loop.delay_samples)
    beside = Loop.around(
        setting.model, motor_loop, setting.rig.motor, setting.rig.period
    )
    return beside.with_controller(setting.controller)


QUIETER = "fraclink, longer filter"
FACTORS = (2.0, 4.0, 8.0, 12.0, 16.0)


def quieter(setting: Setting) -> tuple[str, Controller]:
    """Return fraclink's design for the same request with the quietest of longer
    filters, δ × 2 … 16.

    The procedure puts the filter inside equation (55), so that a longer δ is paid for
    with a larger β and not with margin: crossover and phase margin stay those asked
    for. Beyond some δ the request is infeasible.

    Raises InfeasibleError where no longer filter meets the request.
    """
    rig, made = setting.rig, []
    # A design without a filter has none to lengthen: from a millisecond on, a quarter
    # of a period.
    base = max(setting.controller.filter_time, 1e-3)
    refused: InfeasibleError | None = None
    for factor in FACTORS:
        try:
            result = design(
                setting.model,
                rig,
                payloads=(rig.payloads.low, rig.payloads.high),
                gain_crossover=setting.gain_crossover,
                phase_margin=setting.phase_margin,
                filter_time=factor * base,
                law=False,
            )
        except InfeasibleError as error:
            # Beyond some δ the phase that it takes cannot be paid for by β any more;
            # shorter ones still may do.
            refused = error
            continue
        made.append((setting.loop.noise(result.controller.response), result.controller))
    if not made:
        raise refused or InfeasibleError("filter_time", "no longer filter was tried")
    best = min(made, key=lambda pair: pair[0])
    return (
        "the same request, δ 2 to 16 times the 10 % rule's, the one with the least noise",
        best[1],
    )
