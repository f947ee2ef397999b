"""Incomplete rigs and contradictions: drafts for reading a first log, and doubts about
a model on a rig.

`Rig.warnings` reports values that differ by more than measurements do. The doubts here
concern larger differences: a wrong unit, or the values of another arm.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from fraclink._arm.link import LinkModel
from fraclink._arm.log_columns import LogColumns
from fraclink._arm.rig import Rig
from fraclink._arm.rig_parts import Link, Motor, Name, Payloads
from fraclink._files.toml import keys_of, read_table, read_toml, table_of, toml_value
from fraclink.errors import FieldError
from fraclink.findings import Finding
from fracsys.checks import checked

__all__ = ["RigDraft", "doubts_of", "draft_text", "load_rig_or_draft"]

_PARTS = {"motor": Motor, "link": Link, "payloads": Payloads}
# Entries without which `design` cannot work, each with what to measure or to look up in
# a data sheet.
_ASKED = {
    "motor": {
        "inertia": "J, motor and gear, at the motor",
        "torque_constant": "K, motor torque for one volt at the amplifier's input",
    },
    "link": {
        "length": "L, from the motor's axis to the payload",
        "stiffness": "c, torque at the base for one radian of deflection; 3EI/L of a uniform link",
    },
    "payloads": {"low": "lightest payload", "high": "heaviest payload"},
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
    """Return the rig of a file, or a draft if only numbers of motor, link or payloads
    are missing.

    Raises the errors of `Rig.load` if anything else is wrong with the file, or if it
    has no [log] table.
    """
    try:
        return Rig.load(path)
    except FieldError as error:
        # Any fault other than a blank is a mistake in the file, which a draft would
        # hide until `design`.
        faults: tuple[FieldError, ...] = getattr(error, "faults", (error,))
        if not all(_is_blank(fault) for fault in faults):
            raise
        data = read_toml(Path(path))
        if "log" not in data:
            raise
        columns: LogColumns = read_table(LogColumns, data["log"])
        blanks = [fault.field for fault in faults]
        if not {"stiffness_Nm_per_rad", "flexural_rigidity_Nm2"} & set(
            data.get("link", {})
        ):
            # `Link` reports a missing stiffness only once its length is known
            blanks.append("link.stiffness_Nm_per_rad")
        return RigDraft(columns, tuple(dict.fromkeys(blanks)), Path(path).stem[:100])


def _is_blank(fault: FieldError) -> bool:
    return fault.problem == "missing" and fault.field.partition(".")[0] in _PARTS


def draft_text(
    name: str,
    period: float,
    columns: LogColumns,
    remarks: Mapping[str, tuple[str, ...]],
    *,
    known: Mapping[str, tuple[float, str]] | None = None,
) -> str:
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
        comments above each line of that table, by role.
    known
        numbers that are known, such as "link.stiffness", with a comment on each.
    """
    # ν shifts the poles of the closed motor loop by ν/J divided by their sum, 5 % for
    # the paper's motor: no need to ask for it.
    friction = (0.0, "assumed; ν at the motor, where you know it")
    values = {"motor.viscous_friction": friction, **(known or {})}
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
        for key, row in keys_of(kind).items():
            if f"{part}.{row.name}" in values:
                value, why = values[f"{part}.{row.name}"]
                lines.append(f"{key} = {toml_value(value)}  # {why}")
            elif row.name in _ASKED[part]:
                lines.append(
                    f"# {key} =   # {_ASKED[part][row.name]} [{row.rule.unit}]"
                )
    return "\n".join(lines) + "\n"


def _comment(text: str) -> str:
    """Text from a log as a TOML comment, which a control character in a column name
    would end.
    """
    return "".join(
        character if character.isprintable() else "?"
        for character in " ".join(text.split())
    )


def _inline(channel: object) -> str:
    """A channel as an inline table, without default values."""
    usual = {"sign": 1, "scale": 1.0, "offset": 0.0}
    pairs = {
        key: value
        for key, value in table_of(channel).items()
        if usual.get(key) != value
    }
    return ", ".join(f"{key} = {toml_value(value)}" for key, value in pairs.items())


# The paper's stated and computed stiffness differ by 30 %, the calibration of a gauge
# may be off by 20 %, and a beam rolled 15 % thicker has 1.5 times the stiffness: any two
# of these together stay below a factor of 2. A link mass missing from the rig lowers
# the frequency by a factor of 1.55 for 60 g and a payload of 10 g.
_MOST = 2.0
_UNITS = {
    math.degrees(1.0): "as if degrees were called radians",
    1000.0: "as if milli- or kilo- were missing in a unit",
}


def doubts_of(
    rig: Rig, model: LinkModel, payloads: Iterable[float] = ()
) -> tuple[Finding, ...]:
    """Return the errors W105 and W106 of a model and of payloads [kg] on this
    rig.

    A payload is doubted if it is a hundred times outside the rig's range, a stiffness
    if it differs from the rig's by more than a factor of 2, a frequency if it differs
    as much from √(c/J) with the rig's c, J = (m + 33/140 M) L², payload m, link mass M.

    >>> rig = Rig.named("paper-2023")
    >>> [finding.code for finding in doubts_of(rig, LinkModel(0.0272, 10.0, order=1.92, payload=0.030))]
    ['W106']
    """
    masses = (*payloads, *(() if model.payload is None else (model.payload,)))
    doubts = filter(None, map(rig.payloads.doubt, dict.fromkeys(masses)))
    return (*doubts, *_of_stiffness(rig, model), *_of_frequency(rig, model))


def _of_stiffness(rig: Rig, model: LinkModel) -> Iterator[Finding]:
    expected, stiffness = rig.link.stiffness, model.stiffness
    ratio = max(stiffness / expected, expected / stiffness)
    if ratio <= _MOST:
        return
    # A wrong unit may add to an ordinary error: it is named within 60 % of its factor;
    # farther off it would be a guess.
    unit = next(
        (words for factor, words in _UNITS.items() if 0.6 < ratio / factor < 1.6), ""
    )
    hint = f": a factor of {ratio:.3g}, {unit}" if unit else ""
    yield Finding(
        "W106",
        "error",
        f"the model's stiffness is {stiffness:.4g} N·m/rad, the rig's {expected:.4g} N·m/rad{hint}",
        {"model": stiffness, "rig": expected, "ratio": ratio, "most": _MOST},
        "check the units in [log] of the rig file, and that model and rig are of one arm",
    )


def _of_frequency(rig: Rig, model: LinkModel) -> Iterator[Finding]:
    if model.payload is None:  # ω₀ is then taken from the rig
        return
    own = rig.natural_frequency(model.payload + rig.link.tip_mass)
    # Eq. (5) gives ω₀ in s^(−λ/2), while a vibration has |p| in rad/s: either may be
    # meant.
    frequencies = (model.natural_frequency, model.resonance)
    ratios = [
        max(value / own, own / value) if value > 0 else math.inf
        for value in frequencies
    ]
    if min(ratios) <= _MOST:
        return
    yield Finding(
        "W106",
        "error",
        f"the model vibrates at {frequencies[1]:.4g} rad/s with {model.payload:.4g} kg, where the rig's stiffness "
        f"and length give {own:.4g} rad/s",
        {
            "model": frequencies[1],
            "rig": own,
            "ratio": min(ratios),
            "most": _MOST,
        },
        "check the payload of the log, the rig's length, and that model and rig are of one arm",
    )
