"""Files that fraclink writes: complete or not at all, and self-describing.

Every saved noun is one JSON object with an envelope: what it is, the format's version, the tool's
version, its units and the hashes of what it was made from. It is written to a temporary name beside its
place and renamed, so that a full disk or a kill leaves the old file or none, never half of one.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

from fraclink.errors import FieldError, FileFormatError

__all__ = [
    "atomic_write",
    "checked_envelope",
    "checked_path",
    "output_path",
    "parse_json",
    "read_json",
    "sha256_of",
    "write_json",
    "write_text",
]

JSON_LIMIT = 16_000_000  # bytes; a saved fit with its residuals of 100 000 samples is about 2 MB
_DIGIT_LIMIT = 400  # a 5 000-digit integer is an attack or a damaged file, not a measurement


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's bytes as 64 hexadecimal digits."""
    digest = hashlib.sha256()
    with Path(path).open("rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def checked_path(field: str, value: object) -> Path:
    """Return `value` as a path; FieldError for anything that names no file.

    An empty text is refused: it would stand for the folder one happens to be in.

    >>> checked_path("out", "law.fmu").name
    'law.fmu'
    >>> checked_path("out", None)
    Traceback (most recent call last):
    fraclink.errors.FieldError: out: no path (got None); expected a name of a file or a folder. Give its path.
    """
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str) or not text or "\0" in text:
        allowed = "a name of a file or a folder"
        raise FieldError(field, repr(value), "no path", allowed=allowed, remedy="give its path")
    return Path(text)


def output_path(path: Path | str, *, force: bool = False) -> Path:
    """Return `path` after checking that it may be written; an existing file needs `force`."""
    place = checked_path("out", path)
    if place.exists() and not force:
        raise FieldError(
            "out",
            str(place),
            "already there",
            allowed="a new name",
            remedy="choose another name or add --force",
        )
    return place


@contextlib.contextmanager
def atomic_write(path: Path | str, mode: str = "w") -> Iterator[IO[Any]]:
    """Open a temporary file beside `path` and rename it over `path` when the block ends without error."""
    place = Path(path)
    place.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=place.parent, prefix=f".{place.name[:100]}.", suffix=".tmp")
    try:
        with os.fdopen(handle, mode, encoding=None if "b" in mode else "utf-8") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        # mkstemp makes files private; results are meant to be shared like any other file a user makes.
        mask = os.umask(0)
        os.umask(mask)
        Path(name).chmod(0o666 & ~mask)
        Path(name).replace(place)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def write_text(path: Path | str, text: str) -> None:
    """Write `text` to `path` in one step."""
    with atomic_write(path) as stream:
        stream.write(text)


def write_json(path: Path | str, kind: str, version: int, payload: Mapping[str, Any]) -> None:
    """Write a noun with its envelope; floats round-trip exactly, NaN and infinity are refused."""
    from fraclink import __version__

    envelope = {"fraclink": kind, "format": version, "tool": __version__, "units": "SI, radians"}
    write_text(path, json.dumps(envelope | dict(payload), indent=1, allow_nan=False) + "\n")


def _refuse_constant(text: str) -> float:
    raise FieldError(
        "number", text, "not a finite number", allowed="finite numbers", remedy="remove it from the file"
    )


def _integer(text: str) -> int:
    if len(text) > _DIGIT_LIMIT:
        raise FieldError(
            "number", text, "too long", allowed=f"{_DIGIT_LIMIT} digits", remedy="remove it from the file"
        )
    return int(text)


def _float(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _refuse_constant(text)


# Release 0.1 wrote the verdict of a run, a requirement and a cell under another name.
RENAMED = {"holds": "passed"}


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for written, value in pairs:
        key = RENAMED.get(written, written)
        if key in result:
            # json keeps the last one silently; which of two values was meant only the author knows.
            raise FieldError(key, value, "given twice", allowed="each key once", remedy="remove one")
        result[key] = value
    return result


def parse_json(text: str) -> Any:
    """Parse JSON that may be hostile: keys given twice, NaN, infinity and endless digits are FieldErrors.

    >>> parse_json('{"a": 1, "a": 2}')
    Traceback (most recent call last):
    fraclink.errors.FieldError: a: given twice (got 2); expected each key once. Remove one.
    """
    try:
        return json.loads(
            text,
            parse_constant=_refuse_constant,
            parse_int=_integer,
            parse_float=_float,
            object_pairs_hook=_unique,
        )
    except RecursionError as error:
        raise FileFormatError(
            "json", text, "nested too deeply", allowed="a few levels", remedy="make the file again"
        ) from error


def read_json(path: Path | str, kind: str, versions: tuple[int, ...] = (1,)) -> dict[str, Any]:
    """Read back what `write_json` wrote, after checking its kind and its format's version."""
    place = Path(path)
    if not place.is_file():
        raise FileFormatError(
            "file", str(place), "not there", allowed=f"a {kind} file", remedy="check the path"
        )
    if place.stat().st_size > JSON_LIMIT:
        raise FileFormatError(
            "file", str(place), "too large", allowed=f"{JSON_LIMIT} bytes", remedy=f"give a {kind} file"
        )
    try:
        data = parse_json(place.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise FileFormatError(
            "file", str(place), f"not valid JSON ({error})", allowed=f"a {kind} file", remedy="make it again"
        ) from error
    return checked_envelope(data, kind, versions, place)


def checked_envelope(data: object, kind: str, versions: tuple[int, ...], place: Path) -> dict[str, Any]:
    """Return the object of a saved noun after checking its kind and its format's version."""
    found = data.get("fraclink") if isinstance(data, dict) else None
    if not isinstance(data, dict) or found != kind:
        raise FileFormatError(
            "file", str(place), f"of kind {found!r}", allowed=f"kind {kind!r}", remedy=f"give a {kind} file"
        )
    if data.get("format") not in versions:
        raise FileFormatError(
            "format",
            data.get("format"),
            "a version this release does not read",
            allowed=", ".join(map(str, versions)),
            remedy="make the file again with this release",
        )
    return dict(data)
