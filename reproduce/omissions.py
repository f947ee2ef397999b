"""What the paper's procedure leaves out and what that costs, in figures that are not in
the paper.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.motor import place_pid
from fraclink._arm.motor_loop import SampledMotorLoop
from fraclink._design import Design
from fracsys._margins import margins
from reproduce import designs

__all__ = ["costs", "facts", "sampled_margins"]

Complex = NDArray[np.complex128]
# delay, in periods, of a loop with a zero-order hold and one sample of computation
_SAMPLED = 1.5
_LIGHTEST = {
    "printed": 14.14,
    "measured": designs.rig().natural_frequency(0.020),
}  # ϖ at 20 g
_NOMINAL = 11.54  # ϖ at 30 g as Table 1 prints it


def costs() -> tuple[tuple[str, float, float], ...]:
    """Phase margins [°] at 20 g, step by step: for the inputs of Table 1, and for c =
    1.56 N·m.
    """
    period = designs.rig().period
    steps = {
        "as the procedure has it: M(s) = 1, no filter": _Parts(),
        "with the filter of its own 10 % rule, n = 2": _Parts(filtered=True),
        "and with M(s)": _Parts(filtered=True, motor=True),
        "and with the hold and one sample of delay at 4 ms": _Parts(
            True, True, _SAMPLED * period
        ),
        "and with the paper's sums for s^β, all their memory": _Parts(
            True, True, _SAMPLED * period, period
        ),
    }
    return tuple(
        (name, _margin("printed", parts), _margin("measured", parts))
        for name, parts in steps.items()
    )


@dataclass(frozen=True)
class _Parts:
    """Parts of the loop besides Ĉ and the link; delay, and period of the sums, in s, 0
    for none.
    """

    filtered: bool = False
    motor: bool = False
    delay: float = 0.0
    sums: float = 0.0


def _margin(which: str, parts: _Parts) -> float:
    """Phase margin [°] at the last gain crossover, with the controller from the
    procedure.
    """
    designed = designs.printed_design() if which == "printed" else designs.measured()[0]
    delta = designs.rule_filter(which, 2) if parts.filtered else 0.0
    controller = replace(designed.controller, filter_time=delta, filter_order=2)
    found = margins(_loop(controller, _LIGHTEST[which], parts), unstable_poles=0)
    return math.degrees(
        max(found.gain_crossings, key=lambda item: item.frequency).phase_margin
    )


def _loop(
    controller: Controller, natural_frequency: float, parts: _Parts
) -> Callable[[Complex], Complex]:
    tip = LinkModel(
        designs.rig().link.stiffness, natural_frequency, order=designs.ORDER
    ).tip()

    def loop(s: Complex) -> Complex:
        value = controller.response(np.imag(s)) * tip(s) * np.exp(-parts.delay * s)
        if parts.sums:  # backward difference in place of s
            value = (
                value
                * ((1.0 - np.exp(-s * parts.sums)) / (s * parts.sums))
                ** controller.derivative_order
            )
        motor = (1.0 + s / designs.rig().motor_loop.pole) ** -2 if parts.motor else 1.0
        return np.asarray(value * motor, dtype=np.complex128)

    return loop


def sampled_margins() -> tuple[tuple[float, ...], ...]:
    """Payload [kg] and exactly sampled phase margins [°] of 12 rad/s and 50° designed
    in the loop, no filter.

    With Ĉ(jω) itself, with the law that is shipped, and with the paper's sums in place
    of s^β.
    """
    designed = designs.designed_in_loop(ruled=False)
    return tuple(
        (
            payload,
            *(
                math.degrees(
                    designed.sampled_at(payload, correction=which).phase_margin
                )
                for which in (designed.controller.response, None, _sums(designed))
            ),
        )
        for payload in (0.040, 0.030, 0.020, 0.016, 0.008)
    )


def _sums(designed: Design) -> Callable[[NDArray[np.float64]], Complex]:
    """Ĉ with the paper's backward difference in place of s and unlimited memory, which
    adds a lag of β ωTs/2.
    """
    correction, period = designed.controller.correction(), designed.rig.period
    return lambda w: correction(-np.expm1(-1j * w * period) / period)


def facts() -> tuple[tuple[str, str], ...]:
    """Other findings, as (what, our value)."""
    return (
        *(
            (f"dominant poles at 30 g with {number} as printed and M(s)", text)
            for number, text in _printed_poles()
        ),
        (
            "phase margin of the integer loop with β' = 0.65, any payload",
            f"{0.65 * 90:.1f}°, printed 70.087°",
        ),
        (
            "largest |z| of the inner loop at 4 ms with one sample of delay",
            _inner_radii(),
        ),
        ("damping ratio of the 30 g mode", f"{_damping(0.0):.4f}"),
        (
            "the same by Grünwald–Letnikov sums at 4 ms",
            f"{_damping(designs.rig().period):.4f}",
        ),
    )


def _printed_poles() -> list[tuple[str, str]]:
    link = LinkModel(designs.rig().link.stiffness, _NOMINAL, order=designs.ORDER)
    found = []
    for number, controller in designs.PRINTED.items():
        pole = designs.closed_loop_poles(
            controller, link, motor_loop_pole=designs.rig().motor_loop.pole
        )[0]
        found.append((number, f"{pole.real:+.3f} ± {abs(pole.imag):.2f}j rad/s"))
    return found


def _inner_radii() -> str:
    """The spectral radius for three discretisations of 1/s and 1/(s + c); the law uses
    Tustin's.
    """
    rig = designs.rig()
    placed, period = place_pid(rig.motor, rig.motor_loop.pole), rig.period
    c, tustin = placed.filter_pole, placed.discretize(period)
    backward = replace(
        tustin,
        integral_now=period,
        integral_before=0.0,
        filter_now=period / (1 + c * period),
        filter_before=0.0,
        filter_decay=1 / (1 + c * period),
    )
    held = replace(
        tustin,
        integral_now=0.0,
        integral_before=period,
        filter_now=0.0,
        filter_before=-math.expm1(-c * period) / c,
        filter_decay=math.exp(-c * period),
    )
    rules = {"tustin": tustin, "backward": backward, "zero-order-hold": held}
    return ", ".join(
        f"{name} {abs(SampledMotorLoop(pid, rig.motor, 1).poles()[0]):.3f}"
        for name, pid in rules.items()
    )


def _damping(period: float) -> float:
    """−cos(π/λ), or what remains of it with (1 − e^(−sT))/T in place of s in the
    denominator of the link.
    """
    pole = cmath.rect(
        designs.link(0.030).natural_frequency ** (2 / designs.ORDER),
        math.pi / designs.ORDER,
    )
    seen = -cmath.log(1 - pole * period) / period if period else pole
    return -seen.real / abs(seen)
