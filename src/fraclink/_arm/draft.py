"""A rig file whose physics are still blank: what reading and fitting a log need is in it, nothing more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path

from fraclink._arm.log_columns import LogColumns
from fraclink._arm.rig import Rig, _LogTable
from fraclink._arm.rig_parts import Link, Motor, Name, Payloads
from fraclink._files.toml import keys_of, read_table, read_toml, table_of, toml_value
from fraclink._validate import checked
from fraclink.errors import FieldError

__all__ = ["RigDraft", "draft_text", "load_rig_or_draft"]

_PARTS = {"motor": Motor, "link": Link, "payloads": Payloads}
# What a person measures or finds in a data sheet, beside each blank of the file.
_MEANING = {
    "inertia": "J, motor and gear, at the motor",
    "viscous_friction": "ν, at the motor",
    "torque_constant": "K, motor torque for one volt at the amplifier's input",
    "length": "L, from the motor's axis to the payload",
    "flexural_rigidity": "EI; c·L/3 of a uniform link with the stiffness c",
    "low": "lightest payload",
    "high": "heaviest payload",
    "nominal": "usual payload",
}


@checked
@dataclass(frozen=True)
class RigDraft:
    """A rig file in which numbers of motor, link or payloads are still missing.

    Parameters
    ----------
    log
        which column of a log is what.
    blanks
        what is missing, such as "motor.inertia_kg_m2".
    name
        name of the file without its ending.
    """

    log: LogColumns
    blanks: tuple[str, ...]
    name: Name


def load_rig_or_draft(path: Path | str) -> Rig | RigDraft:
    """Return the rig of a file, or a draft where all that is missing are numbers of motor, link or payloads.

    Raises what `Rig.load` raises where anything else is wrong with the file, or it has no [log] table.
    """
    try:
        return Rig.load(path)
    except FieldError as error:
        faults: tuple[FieldError, ...] = getattr(error, "faults", (error,))
        if not all(_is_blank(fault) for fault in faults):
            raise
        data = read_toml(Path(path))
        if "log" not in data:
            raise
        table: _LogTable = read_table(_LogTable, data["log"])
        return RigDraft(table.build(), tuple(fault.field for fault in faults), Path(path).stem[:100])


def _is_blank(fault: FieldError) -> bool:
    return fault.problem == "missing" and fault.field.partition(".")[0] in _PARTS


def draft_text(name: str, period: float, columns: LogColumns, remarks: Mapping[str, tuple[str, ...]]) -> str:
    """Return the text of a rig file with blanks for motor, link and payloads.

    Parameters
    ----------
    name
        of the rig.
    period
        sampling period Ts [s].
    columns
        the [log] table.
    remarks
        comments above each line of it, by role.
    """
    lines = [
        "# Written by `fraclink start`. It is enough to read and fit logs; `design` needs the blanks, too.",
        f"name = {toml_value(name)}",
        f"period_ms = {1e3 * period:.10g}",
        "",
        "[log]",
    ]
    for role, channel in columns.channels().items():
        lines += [f"# {_comment(text)}" for text in remarks.get(role, ())]
        lines.append(f"{role} = {{ {_inline(channel)} }}")
    for part, kind in _PARTS.items():
        lines += ["", f"[{part}]  # blank: needed by `design`"]
        required = {item.name for item in fields(kind) if item.default is MISSING}
        for key, row in keys_of(kind).items():
            if row.field in required:
                lines.append(f"# {key} =   # {_MEANING[row.field]} [{row.rule.unit}]")
    return "\n".join(lines) + "\n"


def _comment(text: str) -> str:
    """Text from a log as a comment: a control character in a column's name would end it."""
    return "".join(character if character.isprintable() else "?" for character in " ".join(text.split()))


def _inline(channel: object) -> str:
    """A channel as an inline table, without the values that are usual."""
    usual = {"sign": 1, "scale": 1.0, "offset": 0.0}
    pairs = {key: value for key, value in table_of(channel).items() if usual.get(key) != value}
    return ", ".join(f"{key} = {toml_value(value)}" for key, value in pairs.items())
