"""What happens to the arm while it moves."""

from __future__ import annotations

from dataclasses import dataclass

from fraclink._validate import checked_between, checked_choice, is_whole
from fraclink.errors import FieldError

__all__ = ["FAULTS", "Event", "Obstacle", "PayloadChange", "Restart", "SensorFault", "TipPulse"]


def _time(field: str, value: object, *, zero: bool = True) -> None:
    checked_between(field, value, 0.0, 1e6, "s", open_low=not zero, remedy="give seconds")


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
        checked_between("payload", self.payload, 0.0, 1e9, "kg", remedy="give the new mass in kg")


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
        checked_between("force", self.force, -1e9, 1e9, "N", remedy="give newtons")


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
        if not is_whole(self.side, -1, 1) or self.side == 0:
            raise FieldError("side", self.side, "unknown", allowed="+1 or -1", remedy="which way is barred?")
        checked_between("angle", self.angle, -1e6, 1e6, "rad", remedy="give radians")
        # Above 1e4 N/m a 1 ms step no longer resolves the contact of a payload of 10 g.
        checked_between(
            "stiffness",
            self.stiffness,
            0.0,
            1e4,
            "N/m",
            open_low=True,
            remedy="a stop of foam has 500 N/m, one of wood 1e4",
        )
        checked_between("damping", self.damping, 0.0, 20.0, "N·s/m", remedy="2 is a dull contact")


@dataclass(frozen=True)
class Restart:
    """At `time` [s] the controller loses its memory and starts anew while the arm goes on moving.

    >>> Restart(time=0.7).time
    0.7
    """

    time: float

    def __post_init__(self) -> None:
        _time("time", self.time)


# Kind -> (bit of the kernel's fault word or 0, name of the input column it sets or None).
FAULTS: dict[str, tuple[int, str | None]] = {
    "encoder value": (1, "ENCODER_VALUE"),
    "gauge value": (2, "GAUGE_VALUE"),
    "encoder frozen": (4, None),
    "gauge frozen": (8, None),
    "channels swapped": (16, None),
    "tick missed": (32, None),
    "tick repeated": (64, None),
    "encoder gain": (0, "ENCODER_GAIN"),
    "encoder offset": (0, "ENCODER_ERROR"),
    "gauge gain": (0, "GAUGE_GAIN"),
    "gauge offset": (0, "GAUGE_ERROR"),
}
_VALUED = tuple(kind for kind, (_, column) in FAULTS.items() if column)


@dataclass(frozen=True)
class SensorFault:
    """From `time` to `until` [s] a sensor or the control task fails.

    kind: "encoder value" and "gauge value" replace the reading by `value` (NaN and infinity are allowed: that
    is what broken interfaces give); "encoder gain", "gauge gain" multiply the true value, "encoder offset",
    "gauge offset" add to it [rad, N·m]; "encoder frozen", "gauge frozen" repeat the last reading; "channels
    swapped" exchanges the two; "tick missed" does not run the law, "tick repeated" runs it twice.

    >>> SensorFault(time=0.5, until=0.52, kind="gauge value", value=float("nan")).kind
    'gauge value'
    """

    time: float
    until: float
    kind: str
    value: float | None = None

    def __post_init__(self) -> None:
        _time("time", self.time)
        _time("until", self.until, zero=False)
        if self.until <= self.time:
            raise FieldError(
                "until", self.until, "not after time", allowed=f"> {self.time:g} s", remedy="exchange the two"
            )
        checked_choice("kind", self.kind, FAULTS)
        if (self.value is not None) != (self.kind in _VALUED):
            raise FieldError(
                "value",
                self.value,
                "missing" if self.kind in _VALUED else "not used by this kind",
                allowed=f"a number for {', '.join(_VALUED)}",
                remedy="give value=, or leave it out",
            )


Event = PayloadChange | TipPulse | Obstacle | Restart | SensorFault
