"""The `[log]` table of a rig: which column of a log is which quantity, in which unit, with which sign.

Nothing here is ever guessed: a log whose columns and units are not stated is refused.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.rig.quantities import Quantity, Text, check_fields
from fraclink.errors import FieldError

__all__ = ["QUANTITY_OF", "UNITS", "Channel", "LogColumns", "OutputKind", "check_unit", "parse_columns"]

OutputKind = Literal["torque", "deflection"]

# Unit -> factor to SI and radians, by the quantity it measures.
UNITS = MappingProxyType(
    {
        "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
        "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "rev": 2 * math.pi},
        "torque": {"Nm": 1.0, "mNm": 1e-3, "N·m": 1.0, "N*m": 1.0},
        "voltage": {"V": 1.0, "mV": 1e-3},
    }
)
QUANTITY_OF = MappingProxyType(
    {
        "time": "time",
        "motor_angle": "angle",
        "torque": "torque",
        "deflection": "angle",
        "voltage": "voltage",
    }
)


@dataclass(frozen=True)
class Channel:
    """One column of a log: value = sign · scale · (raw − offset), in `unit`.

    Arguments:
        column: its name in the log (``"#2"`` is the second column where the log names none).
        unit: unit of the scaled value: s, ms, us, ns; rad, mrad, deg, rev; Nm, mNm; V, mV.
        sign: +1 or −1.
        scale: units for one raw unit, not 0.
        offset: raw reading that means zero; ``"first"`` takes the first sample of the log.

    Raises FieldError.

    >>> Channel("pot_V", "deg", scale=36.79).column
    'pot_V'
    """

    column: Annotated[str, Text("column")]
    unit: Annotated[str, Text("unit", limit=10)]
    sign: Annotated[int, Quantity("sign", "", at_least=-1, at_most=1, integer=True)] = 1
    scale: Annotated[float, Quantity("scale", "")] = 1.0
    offset: float | Literal["first"] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "channel")
        if self.offset != "first":
            object.__setattr__(self, "offset", float(Quantity("offset").check("channel.offset", self.offset)))
        for name in ("sign", "scale"):
            if getattr(self, name) == 0:
                raise FieldError(
                    f"channel.{name}",
                    0,
                    "zero, which erases the signal",
                    allowed="not 0",
                    remedy="give 1 or -1",
                )

    def in_si(self, raw: NDArray[np.float64], role: str) -> NDArray[np.float64]:
        """The column in SI units and radians; `role` is time, motor_angle, torque, deflection or voltage."""
        offset = raw[0] if self.offset == "first" else self.offset
        factor = self.sign * self.scale * UNITS[QUANTITY_OF[role]][self.unit]
        # Multiplying by 1.0 is exact, so that a log in SI units is read bit for bit.
        return np.asarray((raw - offset) * factor if offset else raw * factor, dtype=np.float64)


@dataclass(frozen=True)
class LogColumns:
    """Which column is the time, the motor angle, the output and (optionally) the motor voltage.

    Arguments:
        time: stamps of the samples.
        motor_angle: θm, angle of the gear's output.
        output: base torque Γ, positive where it drives the tip forward, or deflection θm − θt.
        output_kind: ``"torque"`` or ``"deflection"``.
        voltage: voltage at the amplifier's input, or None.

    Raises FieldError where a unit does not measure its quantity.

    >>> columns = LogColumns(Channel("t", "s"), Channel("enc", "deg"), Channel("gauge", "Nm"), "torque")
    >>> columns.output.unit
    'Nm'
    """

    time: Channel
    motor_angle: Channel
    output: Channel
    output_kind: OutputKind
    voltage: Channel | None = None

    def __post_init__(self) -> None:
        Text("output_kind", choices=("torque", "deflection")).check("log.output_kind", self.output_kind)
        for role, channel in self.channels().items():
            if not isinstance(channel, Channel):
                raise FieldError(
                    f"log.{role}",
                    channel,
                    "not a Channel",
                    allowed="a Channel",
                    remedy="give Channel(column, unit)",
                )
            check_unit(f"log.{role}.unit", role, channel.unit)

    def channels(self) -> dict[str, Channel]:
        """The stated channels by role: time, motor_angle, torque or deflection, voltage."""
        found = {"time": self.time, "motor_angle": self.motor_angle, str(self.output_kind): self.output}
        return found | ({"voltage": self.voltage} if self.voltage is not None else {})


_STATED = re.compile(r"(\w+) *= *(-?) *(.+?) *\[([^\[\]]*)\]")


def parse_columns(texts: Iterable[str]) -> LogColumns:
    """The columns that texts such as ``motor_angle=theta [deg]`` state; a minus turns the sign.

    Raises FieldError where a text has another form, a role is missing, unknown or stated twice, or where the
    unit in brackets does not measure its role.

    >>> parse_columns(["time=t [s]", "motor_angle=theta [deg]", "torque=-gamma [Nm]"]).output.sign
    -1
    """
    found: dict[str, Channel] = {}
    for text in texts:
        match = _STATED.fullmatch(text.strip())
        if match is None or match[1] not in QUANTITY_OF or match[1] in found:
            raise FieldError(
                "column",
                text,
                "stated twice" if match and match[1] in found else "not understood",
                allowed=f"role=name [unit], each of {', '.join(QUANTITY_OF)} once",
                remedy='write "motor_angle=theta [deg]", or "torque=-gamma [Nm]" to turn the sign',
            )
        found[match[1]] = Channel(match[3], match[4].strip(), sign=-1 if match[2] else 1)
    output = found.get("torque", found.get("deflection"))
    if (
        output is None
        or "time" not in found
        or "motor_angle" not in found
        or {"torque", "deflection"} <= set(found)
    ):
        raise FieldError(
            "column",
            ", ".join(found) or "(nothing)",
            "not one time, one motor_angle and one output",
            allowed="time, motor_angle, and torque or deflection; voltage as well",
            remedy="state every column once, or write [log] in the rig file",
        )
    kind: OutputKind = "torque" if "torque" in found else "deflection"
    return LogColumns(found["time"], found["motor_angle"], output, kind, found.get("voltage"))


def check_unit(path: str, role: str, unit: str) -> None:
    """Raise FieldError where `unit` does not measure what `role` is; suggest the nearest that does."""
    known = UNITS[QUANTITY_OF[role]]
    if unit in known:
        return
    near = difflib.get_close_matches(unit, known, n=1, cutoff=0.3)
    remedy = f"did you mean {near[0]!r}?" if near else f"give one of {', '.join(known)}"
    raise FieldError(path, unit, f"not a unit of {role}", allowed=", ".join(known), remedy=remedy)
