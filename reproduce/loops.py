"""The loops of (60) for every reading: their last crossover at one payload and over a
range of payloads.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.controller import Controller
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.sampled import sampled_plant
from fraclink._law import discretize
from fraclink._law.requirement import margins_of
from fracsys._margins import Margins, margins
from reproduce import designs

__all__ = [
    "LOOP_DELAY",
    "SWEEP",
    "Crossing",
    "Curves",
    "curves",
    "last_crossing",
    "open_loop",
    "sampled",
]

Complex = NDArray[np.complex128]

# s: half a sample of hold and one of computation, at 4 ms; `sampled` models both
# exactly
LOOP_DELAY = 0.006
SWEEP = tuple(
    round(0.001 * grams, 3) for grams in range(8, 46)
)  # kg, the payloads of Fig. 10


@dataclass(frozen=True)
class Crossing:
    """The last gain crossover of a loop: frequency [rad/s] and phase margin [°]; also
    whether the whole loop is stable, and its distance from −1, which exist without a
    crossover, too.
    """

    frequency: float
    margin: float
    stable: bool
    distance: float

    def __str__(self) -> str:
        return (
            f"{self.frequency:.2f} rad/s and {self.margin:.1f}°"
            if self.crosses
            else "no crossing"
        )

    @property
    def crosses(self) -> bool:
        """Whether |L| reaches one at all."""
        return not math.isnan(self.frequency)


def open_loop(
    controller: Controller,
    payload: float,
    *,
    motor: bool = False,
    delay: float = 0.0,
    order: float = designs.ORDER,
) -> Callable[[Complex], Complex]:
    """Ĉ·G of (60) at `payload` [kg], with M(s) if `motor`, and with a delay [s], as a
    function of s on the imaginary axis.
    """
    tip = designs.link(payload, order).tip()

    def loop(s: Complex) -> Complex:
        value = controller.response(np.imag(s)) * tip(s) * np.exp(-delay * s)
        return np.asarray(
            value / (1.0 + s / 80.0) ** 2 if motor else value, dtype=np.complex128
        )

    return loop


@cache
def last_crossing(
    controller: Controller,
    payload: float,
    *,
    motor: bool = False,
    delay: float = 0.0,
    order: float = designs.ORDER,
) -> Crossing:
    """The last crossover of Ĉ·G at `payload` [kg], with M(s) if `motor`; NaN if |L| < 1
    everywhere.
    """
    loop = open_loop(controller, payload, motor=motor, delay=delay, order=order)
    return _last(margins(loop, unstable_poles=0))


def _last(found: Margins) -> Crossing:
    if not found.gain_crossings:
        return Crossing(
            math.nan, math.nan, found.stable is not False, found.modulus_margin
        )
    last = max(found.gain_crossings, key=lambda item: item.frequency)
    return Crossing(
        last.frequency,
        math.degrees(last.phase_margin),
        found.stable is not False,
        found.modulus_margin,
    )


@cache
def sampled(controller: Controller, payload: float) -> Crossing:
    """The last crossover of the loop that actually runs, exactly sampled: the shipped
    law, M(s), 4 ms and one sample of delay.
    """
    arm = designs.rig()
    law = discretize(controller, arm.period, precision="double")
    plant = sampled_plant(
        designs.link(payload),
        MotorLoop(pole=80.0, delay_samples=1),
        arm.motor,
        arm.period,
    )
    return _last(margins_of(law.frequency_response, plant))


@dataclass(frozen=True)
class Curves:
    """The four loops of (60) against payload, by name, with one crossover for each mass
    of `SWEEP`.
    """

    pair: designs.Pair
    loops: dict[str, tuple[Crossing, ...]]


@cache
def curves(pair: designs.Pair) -> Curves:
    """L_M, L'_M, LM_M and LM'_M of a pair, all with λ = 1.92, as in (60)."""
    return Curves(
        pair,
        {
            name: tuple(last_crossing(controller, m, motor=motor) for m in SWEEP)
            for name, controller, motor in (
                ("L_M", pair.fractional, False),
                ("L'_M", pair.integer, False),
                ("LM_M", pair.fractional, True),
                ("LM'_M", pair.integer, True),
            )
        },
    )
