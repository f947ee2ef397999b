"""What a tuning is going to do, said before anything moves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from fraclink._arm.rig import Rig
from fraclink._realtime.tune_guard import PLANNED, MotionLimits
from fraclink._realtime.tune_wiring import _MOST
from fraclink._validate import Between, Payload, checked, checked_noun
from fraclink.errors import FieldError

__all__ = ["TuningPlan"]


@checked
@dataclass(frozen=True)
class TuningPlan:
    """What is asked of a tuning: the limits, the payload that the arm carries, and the range it shall carry.

    Parameters
    ----------
    limits
        of angle, speed, torque and voltage.
    payload
        at the tip during the tuning [kg]: no motion shows it.
    payloads
        (lightest, heaviest) that the law is for [kg]; default: from three quarters of the payload to a third
        more.
    period
        of the arm [s]; None for an arm that states its own.
    rig
        what is known of the arm: scales are compared with its motor and link, tolerances and the wish for
        the design come from it.

    Examples
    --------
    >>> limits = MotionLimits(angle=0.5, speed=3.0, torque=2.0, voltage=5.0)
    >>> plan = TuningPlan(limits, payload=0.030)
    >>> plan.range
    (0.0225, 0.04)
    >>> print(plan.text.splitlines()[1])
    limits: 28.6° to each side of where the arm stands, 3 rad/s, 2 N·m at the gauge, 5 V
    """

    limits: MotionLimits
    payload: Payload
    payloads: tuple[float, float] | None = None
    period: Annotated[float, Between(5e-5, 1.0, "s")] | None = None
    rig: Rig | None = None

    def __post_init__(self) -> None:
        checked_noun(
            "limits", self.limits, MotionLimits, remedy="MotionLimits(angle, speed, torque, voltage)"
        )
        if self.payloads is not None:
            low, high = self.payloads
            if not 0 < low <= self.payload <= high:
                raise FieldError(
                    "payloads",
                    self.payloads,
                    "without the payload of the tuning",
                    allowed=f"low <= {self.payload:g} <= high [kg]",
                    remedy="tune with a payload of the range",
                )

    @property
    def range(self) -> tuple[float, float]:
        """(lightest, heaviest) payload that the law is for [kg]."""
        if self.payloads is not None:
            return self.payloads
        if self.rig is not None and self.rig.payloads.low <= self.payload <= self.rig.payloads.high:
            return self.rig.payloads.low, self.rig.payloads.high
        return 0.75 * self.payload, float(f"{4 / 3 * self.payload:.6g}")

    @property
    def text(self) -> str:
        """What will move, how far, how hard and how long."""
        limits, part = self.limits, round(100 * PLANNED)
        low, high = (1e3 * payload for payload in self.range)
        return "\n".join(
            (
                "The motor will move the arm: nobody may be within its reach, and a hand stays at the "
                "emergency stop.",
                f"limits: {math.degrees(limits.angle):.3g}° to each side of where the arm stands, "
                f"{limits.speed:g} rad/s, {limits.torque:g} N·m at the gauge, {limits.voltage:g} V",
                "1 wiring: short pulses that grow until the motor turns by 1°, "
                f"{math.degrees(_MOST):.2g}° at most; nothing is closed; 8 s",
                f"2 motor: slow moves within ±{math.degrees(min(0.12, PLANNED * limits.angle)):.2g}°, "
                f"growing to {part} % of the limits where that is needed; 8 to 15 s",
                f"3 link: a random sequence within ±5.7°, growing to {part} % of the limits where that is "
                "needed, and a random voltage for 2 s; 12 to 50 s",
                f"4 the drive is off: model, design for {low:.3g} to {high:.3g} g, proof, law; some seconds",
                f"5 first moves: {math.degrees(PLANNED * limits.angle):.3g}° at a tenth of the speed, then "
                "two or three times at full speed; 13 to 17 s for each law, three at most",
            )
        )
