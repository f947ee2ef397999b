"""An experiment: one recorded motion in SI units and radians, and how the columns of a log state it.

Nothing about a log is ever guessed: one whose columns and units are not stated is refused.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._display import displayed
from fraclink._files import document, write_text
from fraclink._validate import Array, Between, Length, Payload, Positive, Where, checked
from fraclink.errors import FieldError, LogError
from fraclink.findings import Finding

__all__ = ["QUANTITY_OF", "UNITS", "Channel", "Experiment", "LogColumns", "OutputKind", "parse_columns"]

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


@checked
@dataclass(frozen=True)
class Channel:
    """One column of a log: value = sign · scale · (raw − offset), in `unit`.

    Parameters
    ----------
    column
        its name in the log (``"#2"`` is the second column where the log names none).
    unit
        unit of the scaled value: s, ms, us, ns; rad, mrad, deg, rev; Nm, mNm; V, mV.
    sign
        +1 or −1.
    scale
        units for one raw unit, not 0.
    offset
        raw reading that means zero; ``"first"`` takes the first sample of the log.

    Raises
    ------
    FieldError
        a value out of its range.

    Examples
    --------
    >>> Channel("pot_V", "deg", scale=36.79).column
    'pot_V'
    """

    column: Annotated[str, Length(1, 200)]
    unit: Annotated[str, Length(1, 10)]
    sign: Literal[1, -1] = 1
    scale: Annotated[
        float, Between(-1e15, 1e15), Where(bool, "not 0, which erases the signal", remedy="give 1 or -1")
    ] = 1.0
    offset: Annotated[float, Between(-1e15, 1e15)] | Literal["first"] = 0.0

    def in_si(self, raw: NDArray[np.float64], role: str) -> NDArray[np.float64]:
        """The column in SI units and radians; `role` is time, motor_angle, torque, deflection or voltage."""
        offset = raw[0] if self.offset == "first" else self.offset
        factor = self.sign * self.scale * UNITS[QUANTITY_OF[role]][self.unit]
        # Multiplying by 1.0 is exact, so that a log in SI units is read bit for bit.
        return np.asarray((raw - offset) * factor if offset else raw * factor, dtype=np.float64)


@checked(prefix="log.")
@dataclass(frozen=True)
class LogColumns:
    """Which column is the time, the motor angle, the output and (optionally) the motor voltage.

    Parameters
    ----------
    time
        stamps of the samples.
    motor_angle
        θm, angle of the gear's output.
    output
        base torque Γ, positive where it drives the tip forward, or deflection θm − θt.
    output_kind
        which of the two it is.
    voltage
        voltage at the amplifier's input, or None.

    Raises
    ------
    FieldError
        where a unit does not measure its quantity.

    Examples
    --------
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
        for role, channel in self.channels().items():
            known = UNITS[QUANTITY_OF[role]]
            if channel.unit not in known:
                near = difflib.get_close_matches(channel.unit, known, n=1, cutoff=0.3)
                remedy = f"did you mean {near[0]!r}?" if near else f"give one of {', '.join(known)}"
                problem, allowed = f"not a unit of {role}", ", ".join(known)
                raise FieldError(f"log.{role}.unit", channel.unit, problem, allowed=allowed, remedy=remedy)

    def channels(self) -> dict[str, Channel]:
        """The stated channels by role: time, motor_angle, torque or deflection, voltage."""
        stated = {"time": self.time, "motor_angle": self.motor_angle, str(self.output_kind): self.output}
        return stated | ({"voltage": self.voltage} if self.voltage is not None else {})


_STATED = re.compile(r"(\w+) *= *(-?) *(.+?) *\[([^\[\]]*)\]")


def parse_columns(texts: Iterable[str]) -> LogColumns:
    """Return the columns that texts such as ``motor_angle=theta [deg]`` state; a minus turns the sign.

    Raises FieldError where a text has another form, a role is missing, unknown or stated twice, or where the
    unit in brackets does not measure its role.

    >>> parse_columns(["time=t [s]", "motor_angle=theta [deg]", "torque=-gamma [Nm]"]).output.sign
    -1
    """
    channels: dict[str, Channel] = {}
    for text in texts:
        match = _STATED.fullmatch(text.strip())
        if match is None or match[1] not in QUANTITY_OF or match[1] in channels:
            raise FieldError(
                "column",
                text,
                "stated twice" if match and match[1] in channels else "not understood",
                allowed=f"role=name [unit], each of {', '.join(QUANTITY_OF)} once",
                remedy='write "motor_angle=theta [deg]", or "torque=-gamma [Nm]" to turn the sign',
            )
        channels[match[1]] = Channel(match[3], match[4].strip(), sign=-1 if match[2] else 1)
    kinds: tuple[OutputKind, ...] = ("torque", "deflection")
    outputs = [kind for kind in kinds if kind in channels]
    if len(outputs) != 1 or not {"time", "motor_angle"} <= channels.keys():
        raise FieldError(
            "column",
            ", ".join(channels) or "(nothing)",
            "not one time, one motor_angle and one output",
            allowed="time, motor_angle, and torque or deflection; voltage as well",
            remedy="state every column once, or write [log] in the rig file",
        )
    kind, voltage = outputs[0], channels.get("voltage")
    return LogColumns(channels["time"], channels["motor_angle"], channels[kind], kind, voltage)


@displayed
@document(
    "log",
    version=2,
    container="npz",
    upgrades={1: dict},  # without a digest and without findings
    period=lambda log: log.period,
    sources=lambda log: {log.source: log.sha256} if log.sha256 else {},
)
@checked(error=LogError)
@dataclass(frozen=True, eq=False)
class Experiment:
    """One recorded motion of a flexible arm; what every identification starts from.

    Parameters
    ----------
    period
        sampling period Ts [s], > 0.
    motor_angle
        θm, shape (N,) [rad].
    output
        shape (N,): base torque Γ [N·m], or deflection θm − θt [rad]. Both are positive where the tip lags
        behind a motor that turns forward: Γ = c(θm − θt), eq. (3).
    output_kind
        ``"torque"`` or ``"deflection"``.
    payload
        m [kg], > 0, or None where it was not stated.
    source
        file name or a sentence on where it comes from.
    sha256
        hash of the file, or "".
    findings
        what the reader noticed (codes W2xx).
    start_time
        stamp of the first sample [s].
    voltage
        at the amplifier's input, shape (N,) [V], or None.
    notes
        header entries of the log, such as (("simulated", "true"),).

    Arrays are stored as read-only copies.

    Raises
    ------
    LogError
        arrays of different lengths, fewer than two samples, a value that is not finite or out of its range.

    References
    ----------
    Benftima et al. (2023), section 3.1.

    Examples
    --------
    >>> log = Experiment(period=0.004, motor_angle=[0, 0.1, 0.2], output=[0, 0.01, 0.03])
    >>> log.time.tolist(), log.output_kind
    ([0.0, 0.004, 0.008], 'torque')
    """

    __made_by__ = "read_log(path)"

    period: Positive
    motor_angle: Annotated[NDArray[np.float64], Array(1, min_size=2)]
    output: Annotated[NDArray[np.float64], Array(1)]
    output_kind: OutputKind = "torque"
    payload: Payload | None = None
    source: str = ""
    sha256: str = ""
    findings: tuple[Finding, ...] = ()
    start_time: float = 0.0
    voltage: Annotated[NDArray[np.float64], Array(1)] | None = None
    notes: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        count = self.motor_angle.size
        for name, values in (("output", self.output), ("voltage", self.voltage)):
            if values is not None and values.size != count:
                raise LogError(
                    name,
                    values.size,
                    f"another number of samples than motor_angle has ({count})",
                    allowed=f"{count} samples",
                    remedy="cut the channels to their common span of time",
                )

    @property
    def time(self) -> NDArray[np.float64]:
        """Time of the samples, shape (N,) [s]."""
        return np.asarray(self.start_time + self.period * np.arange(self.motor_angle.size), dtype=np.float64)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Experiment):
            return NotImplemented
        return all(_same(getattr(self, item.name), getattr(other, item.name)) for item in fields(self))

    def __hash__(self) -> int:
        return hash((self.period, self.output_kind, self.source, self.sha256, self.output.tobytes()))

    def save(self, path: Path | str) -> None:
        """Write the log as CSV with its notes, in SI units, so that `read_log` gives the same numbers back.

        Findings are not written: reading and `diagnose` find them again.

        >>> log = Experiment(period=0.004, motor_angle=[0, 0.1], output=[0, 0.01], payload=0.03)
        >>> print(log.text())
        # payload_kg: 0.03
        time_s,motor_angle_rad,torque_Nm
        0.0,0.0,0.0
        0.004,0.1,0.01
        """
        write_text(path, self.text() + "\n")

    def text(self) -> str:
        """The log as CSV [s, rad, N·m or rad, V]; see `save`."""
        notes = [(key, value) for key, value in self.notes if key != "payload_kg"]
        if self.payload is not None:
            notes.append(("payload_kg", repr(self.payload)))
        lines = ["# " + " ".join(f"{key}: {value}".split()) for key, value in notes]
        columns = {"time_s": self.time, "motor_angle_rad": self.motor_angle}
        columns["torque_Nm" if self.output_kind == "torque" else "deflection_rad"] = self.output
        if self.voltage is not None:
            columns["voltage_V"] = self.voltage
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        return "\n".join([*lines, ",".join(columns), *(",".join(map(repr, row)) for row in rows)])

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return self.period * (self.motor_angle.size - 1)

    @property
    def output_unit(self) -> str:
        """Unit of the output: ``N·m`` of a torque, ``rad`` of a deflection."""
        return "N·m" if self.output_kind == "torque" else "rad"

    @property
    def simulated(self) -> bool:
        """Whether the log says of itself that it was simulated."""
        return dict(self.notes).get("simulated", "").lower() in ("true", "yes", "1")

    def split(self, fraction: float) -> tuple[slice, slice]:
        """The first `fraction` of the samples and the rest, as two slices.

        Raises FieldError where `fraction` is outside (0, 1) or leaves one part empty.

        >>> Experiment(period=0.004, motor_angle=[0, 1, 2, 3], output=[0, 1, 2, 3]).split(0.5)
        (slice(0, 2, None), slice(2, 4, None))
        """
        # The border is rounded: half a sample at either end still leaves a part empty.
        count = self.motor_angle.size
        edge = 0.5 / count
        inside = Between(edge, 1 - edge, low_open=True, high_open=True, remedy="give a fraction such as 0.6")
        border = round(inside.check("fraction", fraction) * count)
        return slice(0, border), slice(border, count)


def _same(one: object, other: object) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.array_equal(one, other)
    return not isinstance(one, np.ndarray) and not isinstance(other, np.ndarray) and one == other
