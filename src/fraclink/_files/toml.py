"""Frozen dataclasses as the tables of a TOML file that people write, and back.

A key is the field's name and its unit: ``inertia: Annotated[float, Between(0, 1e15,
"kg·m²")]`` is ``inertia_kg_m2``. A field that is a dataclass itself is a table within
the table, and the annotation is the rule of the value. All faults of a file are
reported together, each with its place in the file.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fraclink._files.codec import Decoder, faults_of
from fraclink._files.containers import read_text
from fraclink.errors import FieldError, FileFormatError
from fracsys.checks import Parameter, parameters
from fracsys.checks.ranges import Refused
from fracsys.checks.rules import rule

# A dotted key of 20 000 parts takes tomllib 6.8 s (its time is quadratic in the parts),
# so sizes are checked first. A rig file has 2 kB, its longest line is a sentence.
FILE_LIMIT = 64_000  # bytes
LINE_LIMIT = 1_000  # characters
_SUFFIX = {
    "s": "_s",
    "m": "_m",
    "kg": "_kg",
    "V": "_V",
    "rad/s": "_rad_per_s",
    "kg·m²": "_kg_m2",
    "N·m": "_Nm",
    "N·m·s": "_Nm_s",
    "N·m²": "_Nm2",
    "N·m/V": "_Nm_per_V",
    "N·m/rad": "_Nm_per_rad",
}


class FileFaults(FieldError):
    """Several values of one file are wrong; `faults` holds a FieldError for each.

    The attributes of the error itself are those of the first fault.
    """

    def __init__(self, faults: Iterable[FieldError]) -> None:
        self.faults = tuple(faults)
        first = self.faults[0]
        super().__init__(
            first.field, first.value, first.problem, first.allowed, first.remedy
        )
        self.args = ("\n".join(str(fault) for fault in self.faults),)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.faults,)


@functools.cache
def keys_of(kind: type) -> dict[str, Parameter]:
    """Return the fields of a dataclass by their keys in a table."""
    # Only units in `_SUFFIX` are written into keys: TOML would have to quote names with
    # ° or %. Fields that are not properties of an arm are marked ``metadata={"stated":
    # False}``.
    fields = parameters(kind)
    return {
        field.name + _SUFFIX.get(fields[field.name].rule.unit, ""): fields[field.name]
        for field in dataclasses.fields(kind)
        if field.metadata.get("stated", True)
    }


class _Tables(Decoder):
    """Values in the form of TOML: within the ranges of their annotations, under keys
    with units.
    """

    def __init__(self) -> None:
        super().__init__()
        self.own = {type: self.fields}

    def keys(self, kind: type) -> dict[str, Parameter]:
        return keys_of(kind)


def read_table(kind: type, data: Any) -> Any:
    """Return the `kind` described by a table; FieldError for one fault, FileFaults for
    several.
    """
    try:
        return _Tables()(rule(kind), data)
    except Refused as refused:
        faults = faults_of(refused, error=FieldError)
        raise (faults[0] if len(faults) == 1 else FileFaults(faults)) from None


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file that may be hostile; FileFormatError if it
    exceeds the limits.
    """
    text = read_text(path, "a rig file (TOML)", limit=FILE_LIMIT)
    lines = text.removeprefix("\ufeff").replace("\r\n", "\n").split("\n")
    number = next((k for k, line in enumerate(lines, 1) if len(line) > LINE_LIMIT), 0)
    try:
        if number:
            raise ValueError(f"too long in line {number}")
        return tomllib.loads("\n".join(lines))
    # Deep nesting, an integer of thousands of digits, or not TOML at all.
    except (RecursionError, ValueError) as error:
        raise FileFormatError(
            "rig",
            str(path),
            f"not valid TOML ({error})",
            "a rig file (TOML)",
            "correct that line",
        ) from error


def table_of(value: Any) -> dict[str, Any]:
    """Return a dataclass as a table, as a person would write it: without infinite limits
    and without defaults that are not numbers.
    """
    table: dict[str, Any] = {}
    kind: type = type(value)
    bare = {
        field.name: field.default_factory()
        if field.default is dataclasses.MISSING
        and field.default_factory is not dataclasses.MISSING
        else field.default
        for field in dataclasses.fields(kind)
    }
    for key, field in keys_of(kind).items():
        item = getattr(value, field.name)
        # TOML has inf, but a limit that was not stated is left out.
        unlimited = isinstance(item, float) and math.isinf(item)
        number = isinstance(item, float | int) and not isinstance(item, bool)
        if not unlimited and (number or item != bare[field.name]):
            table[key] = table_of(item) if dataclasses.is_dataclass(item) else item
    return table


def toml_text(table: Mapping[str, Any]) -> str:
    """Return a table with the keys of `keys_of` as TOML that reads back equal, whatever
    its texts contain; numbers are the shortest exact ones.
    """
    return "\n".join(_lines(table, "")) + "\n"


def _lines(table: Mapping[str, Any], place: str) -> list[str]:
    inner = {key: item for key, item in table.items() if isinstance(item, dict)}
    own = {key: item for key, item in table.items() if key not in inner}
    lines = [f"{key} = {toml_value(item)}" for key, item in own.items()]
    for key, item in inner.items():
        name = f"{place}.{key}" if place else key
        # [a.b] already defines a; a header without keys of its own would be
        # superfluous.
        only_tables = item and all(isinstance(part, dict) for part in item.values())
        lines += ([] if only_tables else ["", f"[{name}]"]) + _lines(item, name)
    return lines


def toml_value(value: Any) -> str:
    """Return a number, text, switch or list as TOML; a text is escaped, so that nothing
    in it ends its string or line.

    >>> toml_value('a "b"'), toml_value(True), toml_value([1, 0.5])
    ('"a \\\\"b\\\\""', 'true', '[1, 0.5]')
    """
    if isinstance(value, str | bool):
        # TOML uses the escapes of JSON, but also requires U+007F to be escaped.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        if value and all(isinstance(item, str) for item in value):  # sentences
            return "[\n" + "".join(f"  {toml_value(item)},\n" for item in value) + "]"
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return repr(value)
