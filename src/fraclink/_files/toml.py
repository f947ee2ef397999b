"""Frozen dataclasses as the tables of a TOML file that people write, and back.

A key is the field's name and its unit: ``inertia: Annotated[float, Between(0, 1e15,
"kg·m²")]`` is ``inertia_kg_m2``. A field that is a dataclass itself is a table within
the table, and the annotation is the rule of the value. Every fault of a file is found
at once, each with its place in the file.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_type_hints

from fraclink._files.containers import read_text
from fraclink.errors import FieldError, FileFormatError
from fracsys.checks import Rule, rules

__all__ = [
    "FileFaults",
    "keys_of",
    "parse_toml",
    "read_table",
    "read_toml",
    "suggestion",
    "table_of",
    "toml_text",
    "toml_value",
]

# A dotted key of 20 000 parts takes tomllib 6.8 s (its time is quadratic in the parts),
# so that sizes are checked before it sees the text. A rig file is 2 kB; its longest
# line a sentence.
FILE_LIMIT = 64_000  # bytes
LINE_LIMIT = 1_000  # bytes
DEPTH_LIMIT = 8  # tables within tables
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
_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t", "\r": "\\r"}


class FileFaults(FieldError):
    """Several values of one file are wrong; `faults` holds a FieldError for each.

    The attributes of the error itself are those of the first fault.
    """

    def __init__(self, faults: Iterable[FieldError]) -> None:
        self.faults = tuple(faults)
        first = self.faults[0]
        super().__init__(
            first.field,
            first.value,
            first.problem,
            allowed=first.allowed,
            remedy=first.remedy,
        )
        self.args = ("\n".join(str(fault) for fault in self.faults),)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.faults,)


class Key(NamedTuple):
    """One key of a table: its field, the field's rule, the dataclass of an inner table,
    and the default.
    """

    field: str
    rule: Rule
    table: Any
    default: Any

    @property
    def required(self) -> bool:
        """Whether the file must have the key."""
        return self.default is dataclasses.MISSING


@functools.cache
def keys_of(kind: type) -> dict[str, Key]:
    """Return the keys of a dataclass as a table, in the order of its fields."""
    hints, found = get_type_hints(kind), rules(kind)
    keys: dict[str, Key] = {}
    for field in dataclasses.fields(kind):
        # A table may be optional: the dataclass is looked for in X | None, too.
        kinds = [
            hint
            for hint in (hints[field.name], *get_args(hints[field.name]))
            if dataclasses.is_dataclass(hint)
        ]
        default = (
            field.default
            if field.default_factory is dataclasses.MISSING
            else field.default_factory
        )
        # Only units of the table are written into keys: dB or % would make names that
        # TOML has to quote.
        key = field.name + _SUFFIX.get(found[field.name].unit, "")
        keys[key] = Key(
            field.name, found[field.name], kinds[0] if kinds else None, default
        )
    return keys


def suggestion(word: str, known: Iterable[str]) -> str:
    """``did you mean 'x'?`` for the nearest known word, or nothing where none is near."""
    original = {name.lower(): name for name in known}
    # Half of the letters in common: enough for a slip of the keys or a missing unit,
    # too little for another word.
    near = difflib.get_close_matches(word.lower(), original, n=1, cutoff=0.5)
    return f"did you mean {original[near[0]]!r}?" if near else ""


def read_table(kind: type, data: Mapping[str, Any]) -> Any:
    """Return the `kind` that a table holds; FieldError for one fault, FileFaults for
    several.
    """
    faults: list[FieldError] = []
    value = _read(kind, data, "", faults)
    if faults:
        raise faults[0] if len(faults) == 1 else FileFaults(faults)
    return value


def _read(kind: Any, data: Any, place: str, faults: list[FieldError]) -> Any:
    """The `kind` in `data`; None after adding to `faults`."""
    if not isinstance(data, Mapping):
        problem = f"of type {type(data).__name__}, not a table"
        faults.append(
            FieldError(
                place, data, problem, allowed="a table", remedy=f"write it as [{place}]"
            )
        )
        return None
    # Every fault is collected: a rig file has thirty numbers, and nobody wants to run
    # the command thirty times.
    before, keys, values = len(faults), keys_of(kind), {}
    for name, key in keys.items():
        path = f"{place}.{name}" if place else name
        if name not in data:
            faults.extend([_missing(place, name, key)] if key.required else [])
        elif key.table is not None:
            values[key.field] = _read(key.table, data[name], path, faults)
        else:
            values[key.field] = _found(
                faults, path, functools.partial(key.rule.check, path, data[name])
            )
    for name in (name for name in data if name not in keys):
        path, allowed = f"{place}.{name}" if place else name, ", ".join(keys)
        remedy = suggestion(name, keys) or "remove it"
        faults.append(
            FieldError(
                path, data[name], "an unknown key", allowed=allowed, remedy=remedy
            )
        )
    # The constructor compares fields with each other: with one missing or wrong it
    # would blame another.
    return (
        None
        if len(faults) > before
        else _found(faults, place, functools.partial(kind, **values))
    )


def _found(faults: list[FieldError], place: str, make: Callable[[], Any]) -> Any:
    """What `make` returns; None after adding what it raises to `faults`, by its place
    in the file.
    """
    try:
        return make()
    except FieldError as error:
        # Checks of one value name the whole path already, those of a constructor the
        # field alone.
        field = (
            error.field
            if not place or error.field.startswith(place)
            else f"{place}.{error.field}"
        )
        faults.append(
            FieldError(
                field,
                error.value,
                error.problem,
                allowed=error.allowed,
                remedy=error.remedy,
            )
        )
        return None


def _missing(place: str, name: str, key: Key) -> FieldError:
    where = f"[{place}]" if place else "the top of the file"
    remedy = (
        f"add [{name}]" if key.table and not place else f"add {name} = … to {where}"
    )
    if name == "unit":
        remedy = f"state the unit in {where}: units are never guessed"
    allowed = "a table" if key.table else key.rule.expected
    return FieldError(
        f"{place}.{name}" if place else name,
        "(nothing)",
        "missing",
        allowed=allowed,
        remedy=remedy,
    )


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file that may be hostile; FileFormatError where it is
    over its limits.
    """
    return parse_toml(read_text(path, "a rig file (TOML)", limit=FILE_LIMIT), path)


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """Return the tables of TOML text that may be hostile; `path` stands in the error."""
    lines = text.removeprefix("\ufeff").replace("\r\n", "\n").split("\n")
    if len(text) > FILE_LIMIT:
        raise _broken(
            path, "too large", "give a rig file, not a log", f"{FILE_LIMIT} bytes"
        )
    for number, line in enumerate(lines, 1):
        if len(line) > LINE_LIMIT:
            problem = f"too long in line {number}"
            raise _broken(
                path, problem, "break the line", f"lines of {LINE_LIMIT} characters"
            )
    try:
        data = tomllib.loads("\n".join(lines))
    except tomllib.TOMLDecodeError as error:
        raise _broken(path, f"not valid TOML ({error})", "correct that line") from error
    except (
        RecursionError,
        ValueError,
    ) as error:  # deep nesting; an integer of thousands of digits
        raise _broken(path, f"not readable ({error})", "correct the file") from error
    if _depth(data) > DEPTH_LIMIT:
        raise _broken(
            path,
            "nested too deeply",
            "remove the nested tables",
            f"{DEPTH_LIMIT} levels",
        )
    return data


def _broken(
    path: Path, problem: str, remedy: str, allowed: str = "a rig file (TOML)"
) -> FileFormatError:
    return FileFormatError("rig", str(path), problem, allowed=allowed, remedy=remedy)


def _depth(data: object) -> int:
    # By layers and not by recursion, whose own limit a hostile file would meet here.
    level, layer = 0, [data]
    while layer:
        inside = (
            list(x.values()) if isinstance(x, dict) else x
            for x in layer
            if isinstance(x, dict | list)
        )
        level, layer = level + 1, [child for children in inside for child in children]
    return level - 1


def table_of(value: Any) -> dict[str, Any]:
    """Return a dataclass as a table; None, "no limit" and a switch at its default are
    left out.
    """
    table: dict[str, Any] = {}
    kind: type = type(value)
    for name, key in keys_of(kind).items():
        item = getattr(value, key.field)
        # TOML has inf, but a limit that a person did not state is left out, as they
        # left it out.
        unlimited = isinstance(item, float) and math.isinf(item)
        if (
            item is not None
            and not unlimited
            and not (isinstance(item, bool) and item is key.default)
        ):
            table[name] = table_of(item) if key.table else item
    return table


def toml_text(table: Mapping[str, Any]) -> str:
    """Return a table as TOML that reads back equal, whatever its texts contain:
    shortest exact numbers.
    """
    return "\n".join(_lines(table, "")) + "\n"


def _lines(table: Mapping[str, Any], place: str) -> list[str]:
    lines = [
        f"{_key(k)} = {toml_value(item)}"
        for k, item in table.items()
        if not isinstance(item, dict)
    ]
    for name, item in table.items():
        if isinstance(item, dict):
            inner = f"{place}.{_key(name)}" if place else _key(name)
            # [a.b] alone makes a: a header without a key of its own would be noise.
            only_tables = item and all(isinstance(part, dict) for part in item.values())
            lines += ([] if only_tables else ["", f"[{inner}]"]) + _lines(item, inner)
    return lines


def _key(name: str) -> str:
    # A bare key of TOML; any other name is a quoted one.
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else toml_value(name)


def toml_value(value: Any) -> str:
    """Return a number, text, switch or list as TOML; a text holds nothing that ends its
    string or line.

    >>> toml_value('a "b"'), toml_value(True), toml_value([1, 0.5])
    ('"a \\\\"b\\\\""', 'true', '[1, 0.5]')
    """
    if isinstance(value, str):
        return '"' + "".join(map(_escaped, value)) + '"'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        if all(isinstance(item, str) for item in value):  # sentences, one to a line
            return "[\n" + "".join(f"  {toml_value(item)},\n" for item in value) + "]"
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return repr(value)


def _escaped(character: str) -> str:
    # Control characters, and what TOML readers or editors treat as a line end, are
    # escaped by number.
    if character in _ESCAPES or character.isprintable():
        return _ESCAPES.get(character, character)
    return (
        f"\\u{ord(character):04X}"
        if ord(character) < 0x10000
        else f"\\U{ord(character):08X}"
    )
