"""The meaning of the columns of a log: the signal, its unit and its sign.

Nothing about a log is guessed: a log whose columns and units are not stated is
rejected.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Literal

from fraclink.errors import FieldError
from fracsys.checks import Between, Real, Where, checked, length

__all__ = [
    "ROW_NUMBER",
    "UNITS",
    "UNITS_OF",
    "Channel",
    "ColumnStatement",
    "LogColumns",
    "OutputKind",
    "drive_columns",
    "parse_columns",
]

OutputKind = Literal["torque", "deflection"]

# Unit -> factor to SI and radians, grouped by quantity, the SI unit first.
UNITS = MappingProxyType(
    {
        "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
        "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "rev": math.tau},
        "torque": {"Nm": 1.0, "mNm": 1e-3, "N·m": 1.0, "N*m": 1.0},
        "voltage": {"V": 1.0, "mV": 1e-3},
        "length": {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
        | {"um": 1e-6, "µm": 1e-6, "inch": 0.0254},
        "frequency": {"rad/s": 1.0, "Hz": math.tau, "kHz": 2000 * math.pi},
        "ratio": {"1": 1.0},
        "gain": {"1": 1.0, "dB": 1.0},
    }
)
# The units of each column of a log.
UNITS_OF = MappingProxyType(
    {
        "time": UNITS["time"],
        "motor_angle": UNITS["angle"],
        "torque": UNITS["torque"],
        "deflection": UNITS["angle"],
        "voltage": UNITS["voltage"],
    }
)
# The column of a log without time stamps: 0, 1, 2 …, to be scaled by the period.
ROW_NUMBER = "#row"


@checked
@dataclass(frozen=True)
class Channel:
    """One column of a log: value = sign · scale · (raw − offset), in `unit`.

    Parameters
    ----------
    column
        its name in the log, or two names with ``" - "`` or ``" + "`` between them, each
        after its factor, if it has one (``"enc - 179 * tip"``). ``"#2"`` is the second
        column where the log names none; as the time ``"#row"`` is the number of the
        sample, for a log without time stamps: its scale is the period.
    unit
        unit of the scaled value: s, ms, us, ns; rad, mrad, deg, rev; Nm, mNm; V, mV.
    sign
        +1 or −1.
    scale
        units for one raw unit, not 0.
    offset
        raw reading at zero; ``"first"`` takes the first sample of the log.

    Raises
    ------
    FieldError
        a value out of its range.

    Examples
    --------
    >>> Channel("pot_V", "deg", scale=36.79).column
    'pot_V'
    """

    column: Annotated[str, length(1, 200)]
    unit: Annotated[str, length(1, 10), Where(bool, "units are never guessed")]
    sign: Literal[1, -1] = 1
    scale: Annotated[
        float,
        Between(-1e15, 1e15),
        Where(bool, "not 0, which erases the signal", remedy="give 1 or -1"),
    ] = 1.0
    offset: Annotated[float, Between(-1e15, 1e15)] | Literal["first"] = 0.0

    def in_si(self, raw: Real, role: str) -> Real:
        """The column in SI units and radians; `role` is time, motor_angle, torque,
        deflection or voltage.
        """
        # An encoder counts from the position at power-up: its first sample is its zero.
        offset = raw[0] if self.offset == "first" else self.offset
        factor = self.sign * self.scale * UNITS_OF[role][self.unit]
        # Multiplying by 1.0 is exact, so a log in SI units is read bit for bit.
        return (raw - offset) * factor if offset else raw * factor


@checked(prefix="log.")
@dataclass(frozen=True)
class LogColumns:
    """Which column is the time, the motor angle, the output and (optionally) the motor
    voltage: the `[log]` table of a rig file.

    Parameters
    ----------
    time
        time stamps of the samples.
    motor_angle
        θm, angle of the gear's output.
    torque
        base torque Γ, positive where it drives the tip forward, or None.
    deflection
        θm − θt, or None; one of the two is the output.
    voltage
        voltage at the amplifier's input, or None.

    Raises
    ------
    FieldError
        where there is not exactly one output, or a unit is not one of its quantity.

    Examples
    --------
    >>> columns = LogColumns(Channel("t", "s"), Channel("enc", "deg"), torque=Channel("gauge", "Nm"))
    >>> columns.output.unit
    'Nm'
    """

    time: Channel
    motor_angle: Channel
    torque: Channel | None = None
    deflection: Channel | None = None
    voltage: Channel | None = None

    def __post_init__(self) -> None:
        if (self.torque is None) == (self.deflection is None):
            raise FieldError(
                "log",
                "(no output)" if self.torque is None else "torque and deflection",
                "not one output",
                "torque or deflection",
                "state exactly one of log.torque and log.deflection",
            )
        for role, channel in self.channels().items():
            factors = UNITS_OF[role]
            if channel.unit not in factors:
                raise FieldError(
                    f"log.{role}.unit",
                    channel.unit,
                    f"not a unit of {role}",
                    ", ".join(factors),
                    _way_to(role, channel, factors),
                )

    def channels(self) -> dict[str, Channel]:
        """The stated channels by role: time, motor_angle, torque or deflection,
        voltage.
        """
        channels = {role: getattr(self, role) for role in UNITS_OF}
        return {role: channel for role, channel in channels.items() if channel}

    @property
    def output_kind(self) -> OutputKind:
        """Which of the two the output is."""
        return "deflection" if self.torque is None else "torque"

    @property
    def output(self) -> Channel:
        """The column of the output."""
        return self.channels()[self.output_kind]


_LENGTHS = (*UNITS["length"], "in")
_ACCELERATIONS = ("m/s2", "m/s^2", "m/s²", "mps2", "g")
_RAW = (
    "count",
    "counts",
    "adc",
    "digit",
    "digits",
    "lsb",
    "raw",
    "bit",
    "bits",
    "strain",
    "ustrain",
    "µstrain",
)


def _way_to(role: str, channel: Channel, known: Iterable[str]) -> str:
    """Advice for a unit that the role does not accept: a unit of another quantity is
    not a typing error.
    """
    unit, angle = channel.unit, UNITS_OF[role] is UNITS["angle"]
    # In this order: a length or an acceleration needs a conversion to an angle, and the
    # most similar unit ("mm" → "mrad") would mislead the user.
    if unit in _LENGTHS and angle:
        factor = UNITS["length"].get(unit, UNITS["length"]["inch"])
        return (
            "a length over the link's length is an angle: for a link of 0.32 m write "
            f'"{role}={channel.column} * {factor:g}/0.32 [rad]"'
        )
    if unit in _ACCELERATIONS and angle:
        return "an accelerometer measures no angle: fit it by identify --structure, as k*s**2/(s**a + w)/(T*s + 1)"
    # The gauge's scale need not be known: frequency and order of a link do not depend
    # on it.
    if (unit.lower() in _RAW or unit in UNITS["voltage"]) and role in (
        "torque",
        "deflection",
    ):
        return (
            f'a gauge that is not calibrated: write "deflection={channel.column} [rad]", its scale becomes '
            "part of the fitted gain; or let `fraclink start` scale it"
        )
    if unit in _LENGTHS + _ACCELERATIONS + _RAW or any(
        unit in units for units in UNITS_OF.values()
    ):
        return f"it measures another quantity; give one of {', '.join(known)}"
    # At least half of the letters must match: "nm" is "Nm" and "sec" is "s", but "hour"
    # is not "us", nor "minutes" "ms".
    near = difflib.get_close_matches(unit, known, n=1, cutoff=0.5)
    return f"did you mean {near[0]!r}?" if near else f"give one of {', '.join(known)}"


# The factor follows a space or an equals sign; without one, "k*2" may be the name of a
# column.
_NUMBER = r"[0-9.]+(?:[eE][-+]?[0-9]+)?"
_STATED = re.compile(
    r"(\w+) *= *([-+]?) *(.*?) *(?:(?<=[ =])\* *([-+]?"
    + _NUMBER
    + "(?:/"
    + _NUMBER
    + r")?))? *(?:\[([^\[\]]*)\])?"
)


@dataclass(frozen=True)
class ColumnStatement:
    """What a text such as ``motor_angle=-pot * 36.79 [deg]`` states about one column; a
    part that is not stated is None.

    Parameters
    ----------
    role
        time, motor_angle, torque, deflection or voltage.
    column
        name in the log.
    unit
        unit of the scaled value.
    sign
        −1 or +1.
    scale
        units for one raw unit.

    >>> ColumnStatement.of("motor_angle=pot * 360/4096 [deg]").scale
    0.087890625
    >>> ColumnStatement.of("deflection=strain * -1.301 [deg]").sign
    -1
    """

    role: str
    column: str | None = None
    unit: str | None = None
    sign: Literal[1, -1] | None = None
    scale: float | None = None

    @staticmethod
    def of(text: str) -> ColumnStatement:
        """Return the statement of `text`; FieldError if it has another form or names an
        unknown role.
        """
        match = _STATED.fullmatch(text.strip())
        if match is None or match[1] not in UNITS_OF:
            raise _not_understood(text, "not understood")
        sign: Literal[1, -1] | None = (
            None if not match[2] else -1 if match[2] == "-" else 1
        )
        scale = _factor(match[4], text)
        if scale is not None and scale < 0.0:
            # A calibration of -1.3 deg/V states the sign just as "-strain * 1.3" does.
            sign, scale = (1 if sign == -1 else -1), -scale
        return ColumnStatement(
            match[1], match[3] or None, match[5] or None, sign, scale
        )


def _factor(text: str | None, whole: str) -> float | None:
    if text is None:
        return None
    try:
        above, _, below = text.partition("/")
        return float(above) / float(below or 1)
    except (ValueError, ZeroDivisionError):
        raise _not_understood(
            whole, f"with a factor {text} that is not a number"
        ) from None


def _not_understood(text: str, problem: str) -> FieldError:
    return FieldError(
        "column",
        text,
        problem,
        f"role=name [unit], each of {', '.join(UNITS_OF)} once",
        'write "motor_angle=theta [deg]", or "torque=-gamma [Nm]" to turn the sign',
    )


def parse_columns(texts: Iterable[str]) -> LogColumns:
    """Return the columns stated by texts such as ``motor_angle=theta [deg]``; a minus
    reverses the sign.

    A factor follows the name: ``motor_angle=counts * 360/4096 [deg]``.

    Raises FieldError where a text has another form, a role is missing, unknown or
    stated twice, or the unit in brackets is not one of its role.

    >>> parse_columns(["time=t [s]", "motor_angle=theta [deg]", "torque=-gamma [Nm]"]).output.sign
    -1
    """
    channels: dict[str, Channel] = {}
    for text in texts:
        statement = ColumnStatement.of(text)
        if statement.column is None or statement.unit is None:
            raise _not_understood(text, "not understood")
        if statement.role in channels:
            raise _not_understood(text, "stated twice")
        scale = 1.0 if statement.scale is None else statement.scale
        channels[statement.role] = Channel(
            statement.column, statement.unit, sign=statement.sign or 1, scale=scale
        )
    outputs = {"torque", "deflection"} & channels.keys()
    if len(outputs) != 1 or not {"time", "motor_angle"} <= channels.keys():
        raise FieldError(
            "column",
            ", ".join(channels) or "(nothing)",
            "not one time, one motor_angle and one output",
            "time, motor_angle, and torque or deflection; voltage as well",
            "state every column once, or write [log] in the rig file",
        )
    return LogColumns(**channels)


def drive_columns(texts: Iterable[str]) -> LogColumns:
    """Return the columns of a log of the motor alone; without an output, the angle
    takes its place.

    >>> drive_columns(["time=t [s]", "motor_angle=enc [deg]", "voltage=u [V]"]).output.column
    'enc'
    >>> drive_columns(["time=t [s]", "motor_angle=enc [deg]", "torque=m [mNm]"]).output.column
    'm'
    """
    statements = list(texts)
    roles = {ColumnStatement.of(text).role: text for text in statements}
    if "motor_angle" in roles and not roles.keys() & {"torque", "deflection"}:
        # The readers require one output: an angle in the motor's unit can take its
        # place, a torque could not.
        statements.append("deflection=" + roles["motor_angle"].partition("=")[2])
    return parse_columns(statements)
