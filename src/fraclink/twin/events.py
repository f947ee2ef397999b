"""What happens to the arm while it moves."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fraclink.errors import FieldError

__all__ = ["Event", "Obstacle", "PayloadChange", "Restart", "TipPulse"]


def _time(field: str, value: object, *, zero: bool = True) -> None:
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not good or value < 0.0 or (value == 0.0 and not zero):  # type: ignore[operator]
        raise FieldError(
            field, value, "not a time", allowed=f"{'>=' if zero else '>'} 0 s", remedy="give seconds"
        )


@dataclass(frozen=True)
class PayloadChange:
    """From `time` [s] on the tip carries `payload` [kg]; a new part moves with the tip when it is taken.

    Shape and speed of the link and what its material remembers stay; only the modes are new.

    >>> PayloadChange(time=0.5, payload=0.008).payload
    0.008
    """

    time: float
    payload: float

    def __post_init__(self) -> None:
        _time("time", self.time)
        if not (math.isfinite(self.payload) and self.payload >= 0.0):
            raise FieldError(
                "payload", self.payload, "not a mass", allowed=">= 0 kg", remedy="give the new mass in kg"
            )


@dataclass(frozen=True)
class TipPulse:
    """A force on the tip, at right angles to the link, from `time` for `duration` [s]; `force` [N].

    >>> TipPulse(time=1.0, force=0.5, duration=0.02).force
    0.5
    """

    time: float
    force: float
    duration: float = 0.02

    def __post_init__(self) -> None:
        _time("time", self.time)
        _time("duration", self.duration, zero=False)
        if not math.isfinite(self.force):
            raise FieldError("force", self.force, "not finite", allowed="any force", remedy="give newtons")


@dataclass(frozen=True)
class Obstacle:
    """A stop in the way of the tip between `time` and `until` [s].

    angle [rad]: where it stands. side: +1, the tip cannot pass above the angle; −1, not below. The stop is a
    spring of `stiffness` [N/m] that pushes and never pulls, with a loss of `damping` [N·s/m] while pressed.
    The default, 500 N/m, bends by 2 mm under a newton and makes a contact of about 20 ms with 30 g.

    >>> Obstacle(time=0.0, until=1.0, angle=0.4).side
    1
    """

    time: float
    until: float
    angle: float
    side: int = 1
    stiffness: float = 500.0
    damping: float = 2.0

    def __post_init__(self) -> None:
        _time("time", self.time)
        _time("until", self.until, zero=False)
        if self.until <= self.time:
            raise FieldError(
                "until", self.until, "not after time", allowed=f"> {self.time:g} s", remedy="exchange the two"
            )
        if self.side not in (-1, 1):
            raise FieldError("side", self.side, "unknown", allowed="+1 or -1", remedy="which way is barred?")
        if not math.isfinite(self.angle):
            raise FieldError("angle", self.angle, "not finite", allowed="any angle", remedy="give radians")
        # Above 1e4 N/m a 1 ms step no longer resolves the contact of a payload of 10 g.
        if not 0.0 < self.stiffness <= 1e4:
            raise FieldError(
                "stiffness",
                self.stiffness,
                "out of range",
                allowed="0 < stiffness <= 1e4 N/m",
                remedy="a stop of foam has 500 N/m, one of wood 1e4",
            )
        if not 0.0 <= self.damping <= 20.0:
            raise FieldError(
                "damping", self.damping, "out of range", allowed="0 to 20 N·s/m", remedy="2 is a dull contact"
            )


@dataclass(frozen=True)
class Restart:
    """At `time` [s] the controller loses its memory and starts anew while the arm goes on moving.

    >>> Restart(time=0.7).time
    0.7
    """

    time: float

    def __post_init__(self) -> None:
        _time("time", self.time)


Event = PayloadChange | TipPulse | Obstacle | Restart
