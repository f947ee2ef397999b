"""Which column is what, and whether it is a signal: names that state a role and a unit,
complete columns.

Only names such as ``motor_angle_rad`` count as stated. Everything else needs the
`[log]` table of a rig file.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.log_columns import QUANTITY_OF, UNITS, Channel, LogColumns
from fraclink._files.toml import toml_value
from fraclink._reading.faults import cell_remedy
from fraclink._reading.forms import NUMBER
from fraclink._reading.names import (
    names_time,
    roles_of,
    unit_in,
    unit_of_name,
    words_of,
)
from fraclink._reading.text import LogTable
from fraclink.errors import LogError
from fraclink.findings import Finding
from fracsys.checks import Payload
from fracsys.checks.rules import rule

# Role, then a unit: both in the name, or a person has to state them. "theta" alone is a
# motor angle to a reader and nothing to this one.
_NAME = re.compile(
    r"(time|motor_angle|torque|deflection|voltage)(?:_| *\[| *\()([A-Za-z·*]{1,5})[\])]?"
)


def columns_of_names(names: tuple[str, ...]) -> LogColumns | None:
    """The columns that `names` state by themselves, or None where one of the three
    needed is not stated.

    >>> columns_of_names(("time_s", "motor_angle_deg", "torque_Nm")).motor_angle.unit
    'deg'
    """
    found: dict[str, Channel] = {}
    for name in names:
        match = _NAME.fullmatch(name)
        if match is None or not is_stated(name):
            continue
        if match[1] in found:
            raise LogError(
                f"column of {match[1]}",
                name,
                f"stated twice, as {found[match[1]].column!r} too",
                allowed="one column for each role",
                remedy="say in [log] of the rig file which one is meant",
            )
        found[match[1]] = Channel(name, match[2])
    # Two signals of one flexion: which of them the model is to explain decides the unit
    # of c, and is no business of the order of columns.
    if "torque" in found and "deflection" in found:
        raise LogError(
            "columns",
            f"{found['torque'].column}, {found['deflection'].column}",
            "two outputs",
            allowed="torque or deflection",
            remedy="say in [log] of the rig file which one is meant",
        )
    output = found.get("torque") or found.get("deflection")
    if output is None or "time" not in found or "motor_angle" not in found:
        return None
    kind = "torque" if "torque" in found else "deflection"
    return LogColumns(
        found["time"],
        found["motor_angle"],
        output,
        kind,  # type: ignore[arg-type]
        found.get("voltage"),
    )


def is_stated(name: str) -> bool:
    """Whether a name states a role and its unit, as ``motor_angle_rad`` does."""
    match = _NAME.fullmatch(name)
    return match is not None and match[2] in UNITS[QUANTITY_OF[match[1]]]


def clock_step(values: NDArray[np.float64]) -> float | None:
    """Median step of values that never decrease, as those of a clock; None for others."""
    finite = values[np.isfinite(values)]
    steps = np.diff(finite)
    # Two values always rise or fall; "never decrease" says something of three and more.
    # Equal stamps are allowed: a coarse clock repeats itself.
    if finite.size < 3 or bool((steps < 0).any()):
        return None
    step = float(np.median(steps))
    return step if step > 0 else None


_DISTINCT_LIMIT = 100_000  # samples looked at for the step of the converter


def converter_step(values: NDArray[np.float64]) -> float:
    """Step of the converter: the smallest gap between distinct values, 0 where they do
    not repeat.

    Gaps below a thousandth of the median gap are rounding of the numbers' text, not
    steps.
    """
    # A converter of 16 bits has 65536 values: the limit holds more, and sorts a long
    # log in milliseconds.
    distinct = np.unique(values[:_DISTINCT_LIMIT])
    # A converter's readings occur again and again; where more than half are distinct
    # the values are continuous, and their smallest gap is an accident.
    if distinct.size < 2 or distinct.size > 0.5 * min(values.size, _DISTINCT_LIMIT):
        return 0.0
    gaps = np.diff(distinct)
    return float(gaps[gaps > 1e-3 * np.median(gaps)].min())


def suggested_mapping(table: LogTable) -> str:
    """A `[log]` table to paste into a rig file; what it could not tell is a ``?`` for a
    person to fill in.
    """
    lines = ["[log] # check every line: column, unit and sign"]
    for role, name, unit in suggested_columns(table):
        lines.append(
            f"{role} = {{ column = {toml_value(name)}, unit = {toml_value(unit)} }}"
        )
    return "\n".join(lines)


def suggested_columns(table: LogTable) -> list[tuple[str, str, str]]:
    """What the names and values of the columns suggest: (role, column, unit), "?" for
    what they do not.
    """
    roles = roles_of(table.hints or table.names)
    # The clock of most samples: files of TDMS and of ROS hold one for each channel or
    # topic. An angle that only grows is no clock, and the row's number is one where
    # nothing else is.
    clocks = [
        place
        for place, values in enumerate(table.values)
        if clock_step(values) is not None and not roles[place][0]
    ]
    clocks.sort(key=lambda k: (-table.values[k].size, not names_time(table.names[k])))
    sizes = [values.size for values in table.values]
    length = sizes[clocks[0]] if clocks else max(sizes, default=0)
    found = {"time": table.names[clocks[0]] if clocks else seconds_and_parts(table)}
    outputs = [role for role in ("torque", "deflection") if (role in dict(roles))]
    for role in ("motor_angle", (outputs or ["deflection"])[0], "voltage"):
        named = [
            name
            for name, size, (own, _) in zip(table.names, sizes, roles, strict=True)
            if own == role and size == length
        ]
        if named or role != "voltage":
            found[role] = named[0] if named else ""
    return [
        (role, name or "?", _suggested_unit(table, role, name or "?"))
        for role, name in found.items()
    ]


def _suggested_unit(table: LogTable, role: str, name: str) -> str:
    if role == "time" and name not in table.names:
        return "s" if name != "?" else "?"
    stated = table.units[table.names.index(name)] if table.units and name != "?" else ""
    known = UNITS[QUANTITY_OF[role]]
    return next(
        (
            unit
            for unit in (stated, unit_in(name, role), unit_of_name(name))
            if unit in known
        ),
        "?",
    )


# --- what a stated column must be ------------------------------------------------------------------------


_AGAIN = "the names stand again where the logger was started again: keep one run, such as by sed -i '{line},$d'"
_INTERPOLATED = 0.01  # largest share of missing cells that may be interpolated


def bad_cell_remedy(name: str, line: int, cell: str) -> str:
    """What to do about a cell of column `name` that is no number."""
    return _AGAIN.format(line=line) if cell == name else cell_remedy(cell)


def bad_cells(table: LogTable) -> list[str]:
    """A sentence for each column with cells that are no numbers, with the first of
    them.
    """
    return [
        f"{name}: {fault.bad} cells are no numbers, the first in line {fault.first_bad[0]}, "
        f"{fault.first_bad[1]!r}: {bad_cell_remedy(name, *fault.first_bad)}"
        for place, name in enumerate(table.names)
        if (fault := table.faults.get(place)) is not None and fault.bad
    ]


def clean_column(
    table: LogTable, place: int, *, interpolate: bool
) -> tuple[NDArray[np.float64], list[Finding]]:
    """One column without missing cells, or an error that names the first one."""
    values, name = table.values[place], table.names[place]
    faults = table.faults.get(place)
    if faults is not None and faults.bad:
        line, cell = faults.first_bad
        raise LogError(
            f"line {line}, column {name}",
            cell,
            f"not a number ({faults.bad} such cells)",
            allowed="numbers such as -1.5e-3",
            remedy=bad_cell_remedy(name, line, cell),
        )
    missing = np.flatnonzero(~np.isfinite(values))
    if not missing.size:
        return values, []
    share = missing.size / values.size
    line, cell = (
        faults.first_missing
        if faults is not None
        else (int(missing[0]), repr(float(values[missing[0]])))
    )
    where = f"line {line}" if faults is not None else f"sample {line}"
    # Not even asked for beyond a percent: a line over a missing second of vibration is
    # a false torque, and least squares believe it.
    if not interpolate or share > _INTERPOLATED:
        few = share <= _INTERPOLATED
        raise LogError(
            f"{where}, column {name}",
            cell or "(empty)",
            f"missing ({missing.size} of {values.size} cells)",
            allowed="finite numbers",
            remedy="record again, or read with interpolate=True (--interpolate)"
            if few
            else "record again",
        )
    good = np.flatnonzero(np.isfinite(values))
    # Over the sample's number: whether the samples are uniform is found later, from the
    # stamps.
    filled = np.interp(np.arange(values.size), good, values[good])
    return filled, [
        Finding(
            "W205",
            "warning",
            f"{missing.size} missing cells of column {name!r} were interpolated",
            {"missing": missing.size, "share": share},
            "check whether they lie where the arm moves",
        )
    ]


_FEWEST = (
    200  # samples: three parameters, an offset and a held-out part need more than that
)


def check_count(count: int) -> None:
    """Raise LogError where a log of `count` samples is too short for a fit."""
    if count < _FEWEST:
        raise LogError(
            "log",
            f"{count} samples",
            "too short",
            allowed=f">= {_FEWEST} samples and 3 periods of the vibration",
            remedy="record for longer",
        )


def check_signals(
    angle: NDArray[np.float64], output: NDArray[np.float64], kind: str
) -> None:
    """Raise LogError where the motor angle or the output is the same in all samples."""
    for role, values, remedy in (
        (
            "motor_angle",
            angle,
            "excite the arm: a pulse, a PRBS or a square wave; or state another column",
        ),
        (kind, output, "check the gauge and its amplifier, or state another column"),
    ):
        # Exactly constant is refused here, as no fit can begin; what moves by a
        # billionth is for `diagnose` to judge.
        if np.ptp(values) == 0:
            value = float(values[0])
            raise LogError(
                role,
                f"{value:.6g} in all {values.size} samples (standard deviation 0)",
                "constant",
                allowed="a signal that moves",
                remedy=remedy,
            )


def stated_payload(
    table: LogTable, stated: float | None
) -> tuple[float | None, list[Finding]]:
    """The payload of a log, from the call or from its own header."""
    mass_range = rule(Payload)
    # A set: the same label twice contradicts nothing.
    labels = {value for key, value in table.notes if key == "payload_kg"}
    if len(labels) > 1:
        raise LogError(
            "payload_kg",
            ", ".join(sorted(labels)),
            "given more than once",
            allowed="one label",
            remedy="remove one",
        )
    header = None
    for label in labels:
        if not NUMBER.fullmatch(label):
            raise LogError(
                "payload_kg",
                label,
                "not a number",
                allowed="> 0 [kg]",
                remedy="write # payload_kg: 0.030",
            )
        header = mass_range.check("payload_kg", float(label))
    if stated is None:
        return header, []
    mass = mass_range.check("payload", stated)
    # 0.03 and 30 g that somebody converted differ in the last bit.
    if header is None or abs(mass - header) <= 1e-9 * mass:
        return mass, []
    return mass, [
        Finding(
            "W216",
            "warning",
            f"payload {mass:g} kg was stated, the log's header says {header:g} kg",
            {"stated": mass, "header": header},
            "fraclink uses the stated one; correct the other",
        )
    ]


_FACTOR = r"(?:([0-9.]+(?:[eE][-+]?[0-9]+)?) *\* *)?"
_COMBINED = re.compile(_FACTOR + r"(\S.*?)\s+([-+])\s+" + _FACTOR + r"(\S.*)")


def with_combined(table: LogTable, stated: Iterable[str]) -> LogTable:
    """Return the table with a column for each stated sum or difference, such as ``"enc
    - 179 * tip"``.

    A name that a column has is that column. The cells that either part misses are
    missing.
    """
    for name in dict.fromkeys(stated):
        found = _COMBINED.fullmatch(name)
        if found is None or name in table.names:
            continue
        first, second = (table.place(part, name) for part in (found[2], found[5]))
        if table.values[first].shape != table.values[second].shape:
            allowed, remedy = (
                "two columns of one length",
                "combine columns that were sampled together",
            )
            raise LogError(
                "columns", name, "of two lengths", allowed=allowed, remedy=remedy
            )
        of_first, of_second = _factor(found[1], name), _factor(found[4], name)
        sign = 1.0 if found[3] == "+" else -1.0
        # What is wrong with either part is wrong with the sum; the first fault is named
        # by its line, which both share.
        faults = table.faults.get(first) or table.faults.get(second)
        table = replace(
            table,
            names=(*table.names, name),
            values=(
                *table.values,
                of_first * table.values[first]
                + sign * of_second * table.values[second],
            ),
            units=(*table.units, "") if table.units else (),
            faults={**table.faults, **({len(table.names): faults} if faults else {})},
        )
    return table


def _factor(text: str | None, name: str) -> float:
    try:
        return float(text or 1)
    except ValueError:
        allowed, remedy = "numbers such as 1.5e-3", "write it as 179 * tip"
        raise LogError(
            "columns", name, f"with a factor {text}", allowed=allowed, remedy=remedy
        ) from None


_PARTS = {
    "nanosec": "1e-9",
    "nsec": "1e-9",
    "nsecs": "1e-9",
    "usec": "1e-6",
    "microsec": "1e-6",
}


def seconds_and_parts(table: LogTable) -> str:
    """The stamps of ROS and of Unix, whole seconds beside the parts of one, as one
    combined column; or "".
    """
    # By the last word: header.stamp.sec and header.stamp.nanosec, as well as sec and
    # nsec.
    last = {
        words[-1]: place
        for place, name in enumerate(table.names)
        if (words := words_of(name))
    }
    whole = next((last[word] for word in ("sec", "secs") if word in last), None)
    part = next((word for word in _PARTS if word in last), "")
    if whole is None or not part:
        return ""
    name = f"{table.names[whole]} + {_PARTS[part]} * {table.names[last[part]]}"
    values = with_combined(table, [name]).values[-1]
    # Parts that were not carried over into seconds jump back once a second: such a pair
    # is no clock.
    return name if clock_step(values) is not None else ""
