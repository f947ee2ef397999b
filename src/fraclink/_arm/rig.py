"""The rig: all that is known about a flexible arm before a log is read, in one TOML
file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fraclink import __version__
from fraclink._arm.link import LinkModel
from fraclink._arm.log_columns import LogColumns
from fraclink._arm.motor_loop import MotorLoop
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
)
from fraclink._display import Overview, Row, displayed, rows_of
from fraclink._files import document, write_text
from fraclink._files.codec import suggestion
from fraclink._files.toml import (
    read_table,
    read_toml,
    table_of,
    toml_text,
)
from fraclink.errors import FieldError, FileFormatError, FraclinkError
from fraclink.findings import Finding
from fracsys.checks import Between, Payload, Period, checked

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

_FOLDER = Path(__file__).resolve().parent.parent / "data" / "rigs"
# Two measurements of the same stiffness agree to about 2 %; the paper's two values
# differ by 30 %.
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
        what reports call it.
    motor, link, payloads, encoder, gauge
        its parts.
    period
        sampling period Ts [s], > 0 and <= 10.
    motor_loop
        the position loop of the motor: pole [rad/s] and computation delay [samples].
    model
        link model that the file carries, or None.
    log
        which column of a log is what, or None.
    design
        what a design aims at if the call does not say, or None.
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
            raise FieldError(
                "rig",
                name,
                "unknown",
                ", ".join(names),
                (
                    suggestion(str(name), names)
                    or "give one of these, or the path of your own file"
                ),
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
        """Read a rig file; all its faults are listed at once.

        Raises FileFormatError (not TOML, or over its limits), FieldError (a value) or
        FileFaults (several).
        """
        place = Path(path)
        if not place.is_file():
            raise FileFormatError(
                "rig",
                str(path),
                "not a file",
                "a rig file (TOML)",
                f"check the path; rigs by name: {', '.join(Rig.names())}",
            )
        try:
            return Rig.from_tables(read_toml(place))
        except FraclinkError as error:
            error.add_note(f"in {place}")
            raise

    @staticmethod
    def from_tables(data: Any) -> Rig:
        """Return the rig of a file's tables; FieldError for one fault, FileFaults for
        several.
        """
        if isinstance(data, dict):
            data = _with_usual_model(_in_seconds(data))
        rig: Rig = read_table(Rig, data)
        return rig

    def to_toml(self) -> str:
        """Return the rig file of this rig; `load` reads back an equal one."""
        return f"# Written by fraclink {__version__}.\n{toml_text(table_of(self))}"

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
        stiffness = ("link.stiffness", link.stiffness)
        # Each contradiction is reported with both values, since only a person can tell
        # which is wrong.
        findings = _contradiction(*stiffness, "3EI/L", link.beam_stiffness, "N·m/rad")
        if model is not None:
            findings += _contradiction(
                "model.stiffness", model.stiffness, *stiffness, "N·m/rad"
            )
        if model is not None and model.payload is not None:
            findings += _contradiction(
                "model.natural_frequency",
                model.natural_frequency,
                f"eq. (5) at {model.payload:g} kg",
                self.natural_frequency(model.payload),
                "s^(−λ/2)",
            )
        if link.mass > self.payloads.low:
            heavy = Finding(
                "W104",
                "info",
                f"the link ({link.mass:g} kg) outweighs the lightest payload ({self.payloads.low:g} kg): "
                "one vibration mode may not be enough",
                {"link_mass": link.mass, "lightest_payload": self.payloads.low},
                "look at the residual of the fit above the first resonance",
            )
            findings += (heavy,)
        return findings

    def overview(self) -> Overview:
        """Everything that the rig states."""
        payloads = self.payloads.low, self.payloads.high
        counts = self.encoder.counts_per_revolution
        rows = rows_of(
            self,
            ("motor.inertia", "motor inertia J", "kg·m²"),
            ("motor.viscous_friction", "motor viscous friction ν", "N·m·s"),
            ("motor.torque_constant", "motor torque constant K", "N·m/V"),
            ("motor.gear_ratio", "gear ratio"),
            ("motor.coulomb_torque", "Coulomb torque", "N·m"),
            ("motor.voltage_limit", "voltage limit", "V"),
            ("link.length", "link length L", "m"),
            ("link.flexural_rigidity", "flexural rigidity EI", "N·m²"),
            ("link.stiffness", "link stiffness c", "N·m/rad"),
            ("link.mass", "link mass", "g"),
            Row("payloads.range", "payloads m", payloads, "g"),
            ("payloads.nominal", "nominal payload", "g"),
            Row("encoder", "encoder", counts or "exact", "counts per turn"),
            ("gauge.noise", "gauge noise", "N·m"),
            ("gauge.offset", "gauge offset", "N·m"),
            ("motor_loop.pole", "motor loop, double pole", "rad/s"),
            ("motor_loop.delay_samples", "computation delay, in sampling periods"),
            ("period", "sampling period Ts", "ms"),
        )
        return Overview(self.name, rows=rows, findings=self.warnings)


def _lumped_frequency(stiffness: float, mass: float, length: float) -> float:
    return math.sqrt(stiffness / (mass * length**2))


def _contradiction(
    first: str, value: float, second: str, other: float, unit: str
) -> tuple[Finding, ...]:
    """W101 where two values of one quantity differ, or nothing."""
    if abs(value - other) <= _AGREEMENT * other:
        return ()
    contradiction = Finding(
        "W101",
        "warning",
        f"{first} = {value:.6g} {unit} contradicts {second} = {other:.6g} {unit}",
        {"stated": value, "expected": other},
        f"fraclink uses {first}; correct the one that is wrong",
    )
    return (contradiction,)


# --- the file: what may be written differently or left out ------------------------------------------------


def _in_seconds(data: dict[str, Any]) -> dict[str, Any]:
    """The tables with the period as `period_s`, where the file has `period_ms`."""
    if "period_ms" not in data:
        return data
    if "period_s" in data:
        raise FieldError(
            "period_s",
            data["period_s"],
            "given twice, as period_s and as period_ms",
            "one sampling period",
            "leave one of them out",
        )
    # 10 µs is the period of the fastest drives' current loops; 0.004 would be in seconds
    period = Between(0.01, 1e4, "ms", remedy="give milliseconds: 4 for 250 Hz").check(
        "period_ms", data["period_ms"]
    )
    rest = {key: value for key, value in data.items() if key != "period_ms"}
    return rest | {"period_s": period / 1e3}


def _with_usual_model(data: dict[str, Any]) -> dict[str, Any]:
    """The tables with a complete model: missing values follow from the link and the
    nominal payload, eq. (5).
    """
    model = data.get("model")
    if not isinstance(model, dict):
        return data
    try:
        link: Link = read_table(Link, data.get("link", {}))
        payloads: Payloads = read_table(Payloads, data.get("payloads", {}))
    except FieldError:
        # The file is rejected because of its link or payloads; the values of the model
        # do not matter.
        link, payloads = Link(1.0, 1.0), Payloads(1.0, 1.0)
    usual = {"stiffness_Nm_per_rad": link.stiffness, "payload_kg": payloads.nominal}
    stiffness, payload = ((usual | model)[key] for key in usual)
    if all(isinstance(x, float | int) and x > 0 for x in (stiffness, payload)):
        frequency = _lumped_frequency(stiffness, payload, link.length)
        usual["natural_frequency"] = frequency
    return data | {"model": usual | model}


document("rig", container="toml")(Rig)
