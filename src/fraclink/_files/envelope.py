"""The envelopes of the first formats, for packages that do not use the codec of `_files` yet."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink import __version__
from fraclink._files.containers import (
    atomic_write,
    guarded,
    header_of,
    parse_json,
    read_archive,
    read_text,
    write_archive,
    write_text,
)
from fraclink.errors import FieldError, FileFormatError

__all__ = [
    "RENAMED",
    "checked_envelope",
    "kind_of",
    "read_json",
    "read_npz",
    "renamed",
    "write_json",
    "write_npz",
]

# Release 0.1 wrote the verdict of a run, a requirement and a cell under another name.
RENAMED = {"holds": "passed"}


def renamed(data: Any) -> Any:
    """Return plain JSON with the keys of release 0.1 under their names of today."""
    if isinstance(data, list):
        return [renamed(item) for item in data]
    if not isinstance(data, dict):
        return data
    # Renaming one onto the other would keep whichever stands last: a forged file could show one verdict and
    # mean another.
    twice = next((old for old, new in RENAMED.items() if old in data and new in data), None)
    if twice is not None:
        problem, allowed = "given twice, under its old and its new name", "each key once"
        raise FileFormatError(twice, data[twice], problem, allowed=allowed, remedy="remove one")
    return {RENAMED.get(key, key): renamed(item) for key, item in data.items()}


def _envelope(kind: str, version: int, payload: Mapping[str, Any]) -> dict[str, Any]:
    head = {"fraclink": kind, "format": version, "tool": __version__, "units": "SI, radians"}
    return head | dict(payload)


def write_json(path: Path | str, kind: str, version: int, payload: Mapping[str, Any]) -> None:
    """Write values with their envelope; floats round-trip exactly, NaN and infinity are refused."""
    text = json.dumps(_envelope(kind, version, payload), indent=1, allow_nan=False)
    write_text(path, text + "\n")


def read_json(path: Path | str, kind: str, versions: tuple[int, ...] = (1,)) -> dict[str, Any]:
    """Read back what `write_json` wrote, after checking its kind and its format's version."""
    data = parse_json(read_text(path, f"a {kind} file"), source=Path(path).name)
    return checked_envelope(data, kind, versions, Path(path))


def write_npz(
    path: Path | str,
    kind: str,
    version: int,
    about: Mapping[str, Any],
    arrays: Mapping[str, NDArray[Any]],
    *,
    compressed: bool = False,
) -> None:
    """Write arrays with their envelope (`kind`, `version`, `about`) in one step; `about` holds no NaN."""
    header = json.dumps(_envelope(kind, version, about), allow_nan=False)
    plain = {
        # Little-endian, whatever the machine: a file is compared by its bytes.
        name: np.asarray(values).astype("<u4" if np.asarray(values).dtype == np.uint32 else "<f8", order="C")
        for name, values in arrays.items()
    }
    with atomic_write(path, "wb") as stream:
        write_archive(stream, header, plain)


def read_npz(
    path: Path | str, kind: str, versions: tuple[int, ...] = (1,)
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read back what `write_npz` wrote: the envelope, and the arrays (read-only; float64 or uint32)."""
    text, arrays = read_archive(path, f"a {kind} file of fraclink (NPZ)")
    return checked_envelope(parse_json(text, source=Path(path).name), kind, versions, Path(path)), arrays


def kind_of(path: Path | str) -> str:
    """Return the kind in the envelope of an NPZ file; an empty text where it is damaged or foreign."""
    try:
        about = parse_json(header_of(path), source=Path(path).name)
    except FieldError:
        return ""
    return str(about.get("fraclink", "")) if isinstance(about, dict) else ""


def checked_envelope(data: object, kind: str, versions: tuple[int, ...], place: Path) -> dict[str, Any]:
    """Return the object of a saved result after checking its kind and its format's version."""
    found = data.get("fraclink") if isinstance(data, dict) else None
    if not isinstance(data, dict) or found != kind:
        problem, remedy = f"of kind {found!r}", f"give a {kind} file"
        raise FileFormatError("file", str(place), problem, allowed=f"kind {kind!r}", remedy=remedy)
    if data.get("format") not in versions:
        allowed, remedy = ", ".join(map(str, versions)), "make the file again with this release"
        problem = "a version this release does not read"
        raise FileFormatError("format", data.get("format"), problem, allowed=allowed, remedy=remedy)
    return dict(guarded(lambda: renamed(data), kind))
