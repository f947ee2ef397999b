"""The rig: everything that is known about one flexible arm before a log is read, in one
TOML file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar

from fraclink import __version__
from fraclink._arm.link import LinkModel, SecondMode
from fraclink._arm.log_columns import Channel, LogColumns
from fraclink._arm.motor_loop import LONGEST_DELAY, MotorLoop
from fraclink._arm.rig_parts import (
    DesignDefaults,
    Encoder,
    Gauge,
    Link,
    Motor,
    Moves,
    Name,
    Payloads,
    Sentence,
    Source,
    StatedTolerances,
    at_least_zero,
    positive,
)
from fraclink._display import displayed
from fraclink._files import document, stored_as, write_text
from fraclink._files.toml import (
    parse_toml,
    read_table,
    read_toml,
    suggestion,
    table_of,
    toml_text,
)
from fraclink.errors import FieldError, FileFormatError
from fraclink.findings import Finding
from fracsys.checks import Between, Frequency, Payload, Period, checked

__all__ = [
    "DesignDefaults",
    "Encoder",
    "Gauge",
    "Link",
    "Motor",
    "Moves",
    "Payloads",
    "Rig",
    "StatedTolerances",
]

T = TypeVar("T")

_FOLDER = Path(__file__).resolve().parents[1] / "data" / "rigs"
# two measurements of one stiffness agree to about 2 %; the paper's differ by 30 %
_AGREEMENT = 0.02


@displayed
@checked
@dataclass(frozen=True)
class Rig:
    """One flexible-link robot: motor, link, payloads, sensors, sampling period, and
    what was assumed.

    Parameters
    ----------
    name
        how reports call it.
    motor, link, payloads, encoder, gauge
        its parts.
    period
        sampling period Ts [s], > 0 and <= 10.
    motor_loop
        the loop that closes the motor: pole [rad/s] and computation delay [samples].
    model
        link model that the file carries, or None.
    log
        which column of a log is what, or None.
    design
        what a design reaches where the call does not say, or None.
    tolerances
        how far the arm may differ from its model.
    moves
        the largest move that the arm is meant to make: the limits of its law.
    assumptions
        sentences on values that were not measured, shown in every report.
    source
        where the values come from.

    `warnings` lists contradictions between the values (codes W101 …).

    Raises
    ------
    FieldError
        a value out of its range.

    References
    ----------
    Benftima, Gharab, Feliu-Batlle (2023), section 2 and Table 1.

    Examples
    --------
    >>> rig = Rig.named("paper-2023")
    >>> rig.link.stiffness, rig.period
    (1.56, 0.004)
    """

    __made_by__ = "Rig.named or Rig.load"

    name: Name
    motor: Motor
    link: Link
    payloads: Payloads
    period: Period
    encoder: Encoder = field(default_factory=Encoder)
    gauge: Gauge = field(default_factory=Gauge)
    motor_loop: MotorLoop = field(default_factory=MotorLoop)
    model: LinkModel | None = None
    log: LogColumns | None = None
    design: DesignDefaults | None = None
    assumptions: tuple[Sentence, ...] = ()
    source: Source = ""
    tolerances: StatedTolerances = field(default_factory=StatedTolerances)
    moves: Moves = field(default_factory=Moves)

    @staticmethod
    def named(name: str) -> Rig:
        """Return a rig that comes with the package; `Rig.names()` lists them.

        >>> Rig.named("paper")  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        fracsys.errors.FieldError: rig: unknown (got paper); expected ... Did you mean 'paper-2023'?
        """
        names = Rig.names()
        if name not in names:
            remedy = (
                suggestion(str(name), names)
                or "give one of these, or the path of your own file"
            )
            raise FieldError(
                "rig", name, "unknown", allowed=", ".join(names), remedy=remedy
            )
        return Rig.load(_FOLDER / f"{name}.toml")

    @staticmethod
    def names() -> tuple[str, ...]:
        """The names of the rigs that come with the package.

        >>> Rig.names()
        ('flexible-joint', 'paper-2023', 'paper-2023-geared')
        """
        return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))

    @staticmethod
    def load(path: Path | str) -> Rig:
        """Read a rig file; every fault of it is listed at once.

        Raises FileFormatError (not TOML, or over its limits), FieldError (a value) or
        FileFaults (several).
        """
        place = Path(path)
        if not place.is_file():
            remedy = f"check the path; rigs by name: {', '.join(Rig.names())}"
            raise FileFormatError(
                "rig",
                str(path),
                "not a file",
                allowed="a rig file (TOML)",
                remedy=remedy,
            )
        return Rig.from_tables(read_toml(place))

    @staticmethod
    def from_tables(data: Any) -> Rig:
        """Return the rig of a file's tables; FieldError for one fault, FileFaults for
        several.
        """
        # Until the motor loop had one name everywhere, its table was called
        # [inner_loop].
        names = (
            {"inner_loop": "motor_loop"}
            if isinstance(data, dict) and "motor_loop" not in data
            else {}
        )
        if isinstance(data, dict):
            data = {names.get(name, name): table for name, table in data.items()}
        file: _RigFile = read_table(_RigFile, data)
        return file.build()

    def tables(self) -> dict[str, Any]:
        """Return the tables of the rig's file: SI units, plain values; `from_tables`
        reads them back.
        """
        return table_of(_RigFile.of(self))

    @staticmethod
    def from_toml(text: str) -> Rig:
        """Return the rig of a file's text; see `load`."""
        return Rig.from_tables(parse_toml(text, Path("rig")))

    def to_toml(self) -> str:
        """Return the rig file of this rig; `load` reads back an equal one."""
        return f"# Written by fraclink {__version__}.\n{toml_text(self.tables())}"

    def save(self, path: Path | str) -> None:
        """Write the rig to one TOML file that `Rig.load` reads back equal."""
        write_text(path, self.to_toml())

    @checked
    def natural_frequency(self, payload: Payload) -> float:
        """ω₀ = √(c/(m L²)) of a payload m [kg] > 0, eq. (5), in s^(−λ/2): rad/s for λ =
        2 only.

        >>> round(Rig.named("paper-2023").natural_frequency(0.030), 4)
        11.094
        """
        return _lumped_frequency(self.link.stiffness, payload, self.link.length)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Contradictions between the rig's own values, each with both of them."""
        link, model = self.link, self.model
        # Each contradiction with both of its values, as only a person can say which of
        # them is wrong.
        found = [self._stiffness_finding()]
        if model is not None:
            stated = ("model.stiffness", model.stiffness)
            found.append(
                _contradiction("W101", *stated, "link.stiffness", link.stiffness)
            )
        if model is not None and model.payload is not None:
            lumped = (
                f"eq. (5) at {model.payload:g} kg",
                self.natural_frequency(model.payload),
            )
            found.append(
                _contradiction(
                    "W101", "model.natural_frequency", model.natural_frequency, *lumped
                )
            )
        return tuple(
            finding for finding in (*found, self._mass_finding()) if finding is not None
        )

    def _stiffness_finding(self) -> Finding | None:
        stated, computed = self.link.stiffness, self.link.beam_stiffness
        if abs(stated - computed) <= _AGREEMENT * computed:
            return None
        return Finding(
            "W101",
            "warning",
            f"link.stiffness = {stated:.6g} N·m/rad contradicts 3EI/L = {computed:.6g} N·m/rad",
            {"stiffness": stated, "beam_stiffness": computed},
            "fraclink uses the stated stiffness; measure it, or correct EI or L",
        )

    def _mass_finding(self) -> Finding | None:
        if self.link.mass <= self.payloads.low:
            return None
        return Finding(
            "W104",
            "info",
            f"the link ({self.link.mass:g} kg) outweighs the lightest payload ({self.payloads.low:g} kg): "
            "one vibration mode may not be enough",
            {"link_mass": self.link.mass, "lightest_payload": self.payloads.low},
            "look at the residual of the fit above the first resonance",
        )


def _lumped_frequency(stiffness: float, mass: float, length: float) -> float:
    return math.sqrt(stiffness / (mass * length**2))


def _contradiction(
    code: str, first: str, value: float, second: str, other: float
) -> Finding | None:
    if abs(value - other) <= _AGREEMENT * other:
        return None
    return Finding(
        code,
        "warning",
        f"{first} = {value:.6g} contradicts {second} = {other:.6g}",
        {"stated": value, "expected": other},
        f"fraclink uses {first}; correct the one that is wrong",
    )


# --- the file: one class a table, where it differs from the object that it becomes -----------------------


def _like(kind: type[T], other: Any, **changes: Any) -> T:
    """Return a `kind` with the fields that it shares with `other`, but for `changes`."""
    shared = {item.name for item in fields(kind)} & {  # type: ignore[arg-type]
        item.name for item in fields(other)
    }
    return kind(**({name: getattr(other, name) for name in shared} | changes))


@checked(prefix="motor_loop.")
@dataclass(frozen=True)
class _MotorLoopTable:
    pole: Frequency = MotorLoop.pole
    delay_samples: Annotated[int, Between(0, LONGEST_DELAY, "samples")] = (
        MotorLoop.delay_samples
    )


@checked(prefix="model.second_mode.")
@dataclass(frozen=True)
class _SecondModeTable:
    frequency: Frequency
    gain: Annotated[float, Between(0.0, 1e3, low_open=True)]
    damping_ratio: Annotated[
        float, Between(0.0, 1.0, low_open=True, high_open=True)
    ] = 0.02


@checked(prefix="model.")
@dataclass(frozen=True)
class _ModelTable:
    """What it leaves out follows from the link and the nominal payload."""

    order: Annotated[float, Between(1.0, 2.0, low_open=True)]
    stiffness: Annotated[float | None, positive("N·m/rad")] = None
    natural_frequency: Annotated[float | None, positive("s^(-order/2)")] = None
    damping: Annotated[float, at_least_zero()] = 0.0
    damping_order: Annotated[float, Between(0.0, 2.0)] = 1.0
    payload: Annotated[float | None, positive("kg")] = None
    gauge_delay: Annotated[float | None, Between(-10.0, 10.0, "s")] = None
    gauge_gain: Annotated[float | None, Between(-1e6, 1e6)] = None
    second_mode: _SecondModeTable | None = None
    unseen_up_to: Annotated[float | None, positive("rad/s")] = None
    intervals: dict[str, tuple[float, float]] | None = None

    def build(self, link: Link, payloads: Payloads) -> LinkModel:
        """Return the link model, with eq. (5) where the file states no natural
        frequency.
        """
        stiffness, payload = (
            self.stiffness or link.stiffness,
            self.payload or payloads.nominal,
        )
        return _like(
            LinkModel,
            self,
            stiffness=stiffness,
            natural_frequency=self.natural_frequency
            or _lumped_frequency(stiffness, payload, link.length),
            payload=payload,
            gauge_delay=self.gauge_delay or 0.0,
            gauge_gain=1.0 if self.gauge_gain is None else self.gauge_gain,
            second_mode=self.second_mode and _like(SecondMode, self.second_mode),
            intervals=tuple(
                (name, *pair) for name, pair in (self.intervals or {}).items()
            ),
        )

    @staticmethod
    def of(model: LinkModel) -> _ModelTable:
        """Return the table of a link model; an ideal gauge is left out."""
        return _like(
            _ModelTable,
            model,
            gauge_delay=model.gauge_delay or None,
            gauge_gain=None if model.gauge_gain == 1.0 else model.gauge_gain,
            second_mode=model.second_mode
            and _like(_SecondModeTable, model.second_mode),
            intervals={name: (low, high) for name, low, high in model.intervals}
            or None,
        )


@checked(prefix="log.")
@dataclass(frozen=True)
class _LogTable:
    time: Channel
    motor_angle: Channel
    torque: Channel | None = None
    deflection: Channel | None = None
    voltage: Channel | None = None

    def __post_init__(self) -> None:
        # so that a unit of another quantity is among the faults of the file
        self.build()

    def build(self) -> LogColumns:
        """Return the columns; FieldError where there is not one output, or a unit
        measures something else.
        """
        outputs = {"torque": self.torque, "deflection": self.deflection}
        stated = [
            (kind, channel) for kind, channel in outputs.items() if channel is not None
        ]
        if len(stated) != 1:
            raise FieldError(
                "log",
                " and ".join(kind for kind, _ in stated) or "(no output)",
                "not one output",
                allowed="torque or deflection",
                remedy="state exactly one of log.torque and log.deflection",
            )
        return LogColumns(
            self.time,
            self.motor_angle,
            stated[0][1],
            stated[0][0],  # type: ignore[arg-type]
            self.voltage,
        )


@checked
@dataclass(frozen=True, kw_only=True)
class _RigFile:
    """A rig file: its keys and tables in the order in which they are written."""

    format: Annotated[int, Between(1, 1)] = 1
    name: Name
    source: Source | None = None
    period: Period | None = None
    period_ms: Annotated[float | None, Between(0.0, 10_000.0, "ms", low_open=True)] = (
        None
    )
    assumptions: tuple[Sentence, ...] = ()
    motor: Motor
    link: Link
    payloads: Payloads
    encoder: Encoder = field(default_factory=Encoder)
    gauge: Gauge = field(default_factory=Gauge)
    motor_loop: _MotorLoopTable = field(default_factory=_MotorLoopTable)
    model: _ModelTable | None = None
    design: DesignDefaults | None = None
    tolerances: StatedTolerances | None = None
    moves: Moves | None = None
    log: _LogTable | None = None

    def __post_init__(self) -> None:
        if (self.period is None) == (self.period_ms is None):
            raise FieldError(
                "period_ms" if self.period is None else "period_s",
                "(nothing)" if self.period is None else self.period,
                "missing"
                if self.period is None
                else "given twice, as period_s and as period_ms",
                allowed="one sampling period",
                remedy="state the control period as period_ms = … or period_s = …",
            )

    def build(self) -> Rig:
        """Return the rig that the file describes."""
        return _like(
            Rig,
            self,
            source=self.source or "",
            period=self.period_ms / 1000 if self.period is None else self.period,  # type: ignore[operator]
            motor_loop=_like(MotorLoop, self.motor_loop),
            model=self.model and self.model.build(self.link, self.payloads),
            log=self.log and self.log.build(),
            tolerances=self.tolerances or StatedTolerances(),
            moves=self.moves or Moves(),
        )

    @staticmethod
    def of(rig: Rig) -> _RigFile:
        """Return the file that describes `rig`."""
        return _like(
            _RigFile,
            rig,
            source=rig.source or None,
            motor_loop=_like(_MotorLoopTable, rig.motor_loop),
            model=rig.model and _ModelTable.of(rig.model),
            tolerances=None if rig.tolerances == StatedTolerances() else rig.tolerances,
            moves=None if rig.moves == Moves() else rig.moves,
            log=rig.log and _LogTable(**rig.log.channels()),
        )


def _stored(data: Any) -> Rig:
    """The rig inside another document: its tables, or the text of its file as the first
    formats had it.
    """
    return Rig.from_toml(data) if isinstance(data, str) else Rig.from_tables(data)


document("rig", container="toml")(Rig)
stored_as(Rig, write=Rig.tables, read=_stored)
