"""From the text of a rig file to a `Rig`, with every fault of the file listed at once."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fraclink.errors import FieldError, FileFormatError

__all__ = ["RigError", "load_arguments", "parse_arguments", "suggestion"]

# A dotted key of 20 000 parts takes tomllib 6.8 s (its time is quadratic in the parts), so that sizes
# are checked before it sees the text. A rig file is 2 kB; its longest line a sentence.
FILE_LIMIT = 64_000  # bytes
LINE_LIMIT = 1_000  # bytes
DEPTH_LIMIT = 8  # tables within tables


class RigError(FieldError):
    """Several values of one rig file are wrong; `faults` holds a FieldError for each.

    The attributes of the error itself are those of the first fault.
    """

    def __init__(self, faults: Iterable[FieldError]) -> None:
        self.faults = tuple(faults)
        first = self.faults[0]
        super().__init__(first.field, first.value, first.problem, allowed=first.allowed, remedy=first.remedy)
        self.args = ("\n".join(str(fault) for fault in self.faults),)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.faults,)


def suggestion(word: str, known: Iterable[str]) -> str:
    """``did you mean 'x'?`` for the nearest known word, or nothing where none is near."""
    near = difflib.get_close_matches(word.lower(), {name.lower(): name for name in known}, n=1, cutoff=0.5)
    original = {name.lower(): name for name in known}
    return f"did you mean {original[near[0]]!r}?" if near else ""


def load_arguments(path: Path, names: tuple[str, ...]) -> dict[str, Any]:
    """What `Rig` takes, from the file at `path`; `names` are the rigs that an error offers instead."""
    return parse_arguments(_parse_toml(_read_text(path, names), path))


def _broken(path: Path, problem: str, allowed: str, remedy: str) -> FileFormatError:
    return FileFormatError("rig", str(path), problem, allowed=allowed, remedy=remedy)


def _read_text(path: Path, names: tuple[str, ...]) -> str:
    if not path.is_file():
        known = ", ".join(names)
        raise _broken(path, "not a file", "a rig file (TOML)", f"check the path; rigs by name: {known}")
    with path.open("rb") as stream:
        raw = stream.read(FILE_LIMIT + 1)
    if len(raw) > FILE_LIMIT:
        raise _broken(path, "too large", f"{FILE_LIMIT} bytes", "give a rig file, not a log")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _broken(path, f"not UTF-8 ({error.reason})", "UTF-8 text", "save it as UTF-8") from error
    for number, line in enumerate(text.split("\n"), 1):
        if len(line.encode()) > LINE_LIMIT:
            raise _broken(
                path, f"too long in line {number}", f"lines of {LINE_LIMIT} bytes", "break the line"
            )
    return text.replace("\r\n", "\n")


def _parse_toml(text: str, path: Path) -> dict[str, Any]:
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _broken(path, f"not valid TOML ({error})", "a rig file (TOML)", "correct that line") from error
    except (RecursionError, ValueError) as error:  # deep nesting; an integer of thousands of digits
        raise _broken(path, f"not readable ({error})", "a rig file (TOML)", "correct the file") from error
    if _depth(data) > DEPTH_LIMIT:
        raise _broken(path, "nested too deeply", f"{DEPTH_LIMIT} levels", "remove the nested tables")
    return data


def _depth(data: object) -> int:
    level, layer = 0, [data]
    while layer:
        layer = [
            child
            for item in layer
            if isinstance(item, (dict, list))
            for child in (item.values() if isinstance(item, dict) else item)
        ]
        level += 1
    return level - 1


def parse_arguments(data: Mapping[str, Any]) -> dict[str, Any]:
    """What `Rig` takes, from the tables of its file; raises FieldError, or RigError for several faults."""
    from pydantic import ValidationError

    from fraclink._arm.rig.schema import rig_arguments, rig_schema

    try:
        return rig_arguments(rig_schema().model_validate(dict(data)))
    except ValidationError as error:
        faults = [_fault(item) for item in error.errors(include_url=False)]
    raise faults[0] if len(faults) == 1 else RigError(faults)


def _fault(item: Any) -> FieldError:
    """One of pydantic's findings as a FieldError whose field is the path in the file."""
    from fraclink._arm.rig.schema import keys_at, missing_remedy

    path = ".".join(str(part) for part in item["loc"])
    place, _, key = path.rpartition(".")
    kind = item["type"]
    if kind == "extra_forbidden":
        known = keys_at(place)
        remedy = suggestion(key, known) or "remove it"
        return FieldError(path, item["input"], "an unknown key", allowed=", ".join(known), remedy=remedy)
    if kind == "missing":
        allowed, remedy = missing_remedy(place, key)
        return FieldError(path, "(nothing)", "missing", allowed=allowed, remedy=remedy)
    inner = item.get("ctx", {}).get("error")
    if isinstance(inner, FieldError):
        field = _place(path, inner.field)
        return FieldError(field, inner.value, inner.problem, allowed=inner.allowed, remedy=inner.remedy)
    problem = f"of type {type(item['input']).__name__}, not a table"
    return FieldError(path, item["input"], problem, allowed="a table", remedy=f"write it as [{path}]")


def _place(path: str, field: str) -> str:
    """The path in the file of a fault that a part found in its own `field`."""
    if field.startswith("channel."):
        return f"{path}.{field.removeprefix('channel.')}"
    return field if not path or field.startswith(f"{path}.") else path
