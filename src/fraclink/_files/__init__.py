"""Results on disk: one versioned codec for frozen dataclasses, as JSON or NPZ.

A class becomes a document by one decorator; its type hints say how each field is
written:

    @document("design", version=3)
    @dataclass(frozen=True)
    class Design: ...

    save(design, "design.json")
    load("design.json", kind=Design)

A document is one JSON object: what it is ("fraclink"), the format's version, the tool's
version, units, the period and the hashes of its sources where there are any, a SHA-256,
and the content. The hash covers everything but the tool's version, arrays included, so
that an edited gain is refused. In an NPZ file the same object is the header and the
arrays are members that `numpy.load` opens.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar, cast, overload

import numpy as np
from numpy.typing import NDArray

from fraclink import __version__
from fraclink._files.codec import Storage, codec_of, stored_as
from fraclink._files.containers import (
    JSON_LIMIT,
    array_digest,
    atomic_write,
    broken,
    checked_path,
    edited,
    existing_file,
    guarded,
    header_of,
    json_text,
    misfit,
    output_path,
    parse_json,
    read_archive,
    read_text,
    sha256_of,
    write_archive,
    write_text,
)
from fraclink._files.kinds import (
    HOMES,
    Document,
    document,
    document_of,
    document_of_class,
    registered,
)
from fraclink.errors import FieldError, FileFormatError, SizeError

__all__ = [
    "HOMES",
    "atomic_write",
    "check_ending",
    "checked_envelope",
    "checked_path",
    "document",
    "from_plain",
    "kind_of",
    "load",
    "output_path",
    "parse_json",
    "read_json",
    "save",
    "sha256_of",
    "stored_as",
    "write_json",
    "write_npz",
    "write_text",
]

T = TypeVar("T")
U = TypeVar("U")
UNITS = "SI, radians"
_ENDINGS = {".json", ".npz", ".toml", ".csv"}
_ZIP = b"PK"  # how every zip archive begins


def save(value: object, path: Path | str, *, force: bool = False) -> Path:
    """Write a result to one file and return its path; `load` reads back an equal one.

    The file is complete or not there. Designs, fits, laws, certificates and tables
    become JSON, runs and logs NPZ, a rig TOML.

    Parameters
    ----------
    value
        a result of fraclink.
    path
        the file's name.
    force
        whether a file that is there already may be replaced.

    Raises
    ------
    FieldError
        where `value` has no file format, or `path` exists and `force` is not set.
    SizeError
        where the file would be too large to be read back.

    Examples
    --------
    >>> import tempfile
    >>> import fraclink as fl
    >>> log = fl.Experiment(period=0.004, motor_angle=[0.0, 0.1], output=[0.0, 0.01])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fl.load(fl.save(log, f"{folder}/log.npz")).output.tolist()
    [0.0, 0.01]
    """
    found = document_of(value)
    # First, as it may refuse: nothing is encoded, and no file of that name is touched.
    found.before_save(value)
    place = output_path(path, force=force)
    found = _fitting(found, place)
    container = found.container
    if found.own:
        getattr(value, "save")(place)  # noqa: B009
        return place
    if container == "toml":
        write_text(place, getattr(value, "to_toml")())  # noqa: B009
        return place
    # Encoded whole before the file is opened: a value that does not fit leaves nothing
    # behind.
    envelope, arrays = _enveloped(value, found)
    if container == "npz":
        with atomic_write(place, "wb") as stream:
            write_archive(stream, json.dumps(envelope, allow_nan=False), arrays)
        return place
    text = json_text(envelope) + "\n"
    # What `load` would refuse is not written: a result that cannot be read back is lost
    # in silence.
    if len(text) > JSON_LIMIT:
        allowed, remedy = (
            f"<= {JSON_LIMIT} bytes, which can be read back",
            "save a shorter one",
        )
        raise SizeError(
            found.kind, len(text), "too large to save", allowed=allowed, remedy=remedy
        )
    write_text(place, text)
    return place


def check_ending(cls: type, place: Path) -> None:
    """Raise FieldError where `save` would refuse a value of that class for the ending
    of the name.

    For work that cannot be repeated, such as the motion of an arm: a wrong name is
    found before it.
    """
    _fitting(document_of_class(cls), place)


def _fitting(found: Document, place: Path) -> Document:
    """The document in the container that the ending of the name asks for."""
    if found.container == "either":
        found = dataclasses.replace(
            found, container="npz" if place.suffix == ".npz" else "json"
        )
    # Only endings that promise another container are refused; a name without one, or
    # with a person's own, is taken as it is, since `load` looks at the first bytes.
    if place.suffix in _ENDINGS - {f".{found.container}"}:
        allowed, remedy = (
            f".{found.container}, the ending of a {found.kind}",
            "change the ending",
        )
        raise FieldError(
            "out", place.name, "of another kind of file", allowed=allowed, remedy=remedy
        )
    return found


def _enveloped(
    value: object, found: Document
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    arrays: dict[str, NDArray[Any]] = {}
    storage = Storage(found.hex_floats, arrays if found.container == "npz" else None)
    content = codec_of(found.cls).encode(value, "", storage)
    optional = {
        "period": found.period(value),
        "sources": dict(found.sources(value)),
        "summary": codec_of(Any).encode(found.summary(value), "summary", Storage()),
        "arrays": {name: array_digest(values) for name, values in arrays.items()},
    }
    head = _head(found.kind, found.version)
    head |= {key: item for key, item in optional.items() if item not in (None, {})}
    return head | {
        "sha256": _digest(head | {"content": content}),
        "content": content,
    }, arrays


def _head(kind: str, version: int) -> dict[str, Any]:
    return {"fraclink": kind, "format": version, "tool": __version__, "units": UNITS}


def _digest(data: Mapping[str, Any]) -> str:
    """SHA-256 of everything in a document but the tool's version: sorted keys, no
    spaces, ASCII.
    """
    # Without the tool's version two releases give one digest to one result; sorted keys
    # and no blanks make it independent of who wrote the file.
    covered = {
        key: value for key, value in data.items() if key not in ("sha256", "tool")
    }
    text = json.dumps(covered, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode("ascii")).hexdigest()


_ENVELOPE = {
    "fraclink",
    "format",
    "tool",
    "units",
    "period",
    "sources",
    "summary",
    "arrays",
    "sha256",
    "content",
}


@overload
def load(path: Path | str, kind: type[T]) -> T: ...
@overload
def load(path: Path | str, kind: tuple[type[T], type[U]]) -> T | U: ...
@overload
def load(path: Path | str, kind: tuple[type, ...] | None = None) -> Any: ...
def load(path: Path | str, kind: type[Any] | tuple[type, ...] | None = None) -> Any:
    """Read back what `save` wrote.

    `kind` is the class that is expected, or several of them; any when it is left out.
    FileFormatError is raised for every other file: missing, foreign, of another kind
    or format, damaged, edited.

    >>> import fraclink as fl
    >>> fl.load("no-such-file.json")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    fraclink.errors.FileFormatError: file: ...
    """
    place, wanted = (
        checked_path("path", path),
        (kind if isinstance(kind, tuple) else (kind,) if kind else ()),
    )
    if place.suffix == ".toml":
        found = registered("rig", wanted, place)
        return getattr(found.cls, "load")(place)  # noqa: B009
    data, arrays = _read(place)
    found = registered(data.get("fraclink"), wanted, place)
    if found.own:
        return getattr(found.cls, "load")(place)  # noqa: B009
    content = _content(data, arrays, found, place)
    return codec_of(found.cls).decode(content, "", Storage(found.hex_floats, arrays))


def from_plain(kind: type[T], data: Any, path: str = "") -> T:
    """Return the `kind` that plain JSON holds; FileFormatError names the place, below
    `path`.
    """
    hint: Any = kind
    return cast(T, codec_of(hint).decode(data, path, Storage()))


def kind_of(path: Path | str) -> str:
    """Return the kind in the envelope of a file; an empty text where it is damaged or
    foreign.
    """
    place = Path(path)
    if place.suffix == ".toml":
        return "rig"
    if not place.is_file():
        return ""
    start = b""
    with contextlib.suppress(OSError), place.open("rb") as stream:
        # Kind and format stand in front of everything in what `save` writes: 200 bytes
        # tell a folder's files apart, however large they are.
        start = stream.read(200)
    # In an archive the same text is the member "about", whose beginning is enough.
    if start.startswith(_ZIP):
        start = header_of(place)[:200].encode("utf-8", "replace")
    found = re.match(rb'\s*\{\s*"fraclink":\s*"([\w-]+)"', start)
    return found.group(1).decode() if found else ""


def _read(place: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the object of a document and its arrays, JSON or NPZ by the file's first
    bytes.
    """
    what, archive = "a file of fraclink", False
    arrays: dict[str, NDArray[Any]] = {}
    existing_file(place, what)
    with contextlib.suppress(OSError), place.open("rb") as stream:
        archive = stream.read(2) == _ZIP
    if archive:
        text, arrays = read_archive(place, what)
    else:
        text = read_text(place, what)
    data = parse_json(text, source=place.name)
    if not isinstance(data, dict) or "fraclink" not in data:
        raise broken(what, place, "not written by fraclink", "give another file")
    return data, arrays


def _content(
    data: dict[str, Any],
    arrays: Mapping[str, NDArray[Any]],
    found: Document,
    place: Path,
) -> Any:
    """Return the content, after the digest of what was written has been compared."""
    # The version first: another format may count its digest otherwise.
    _check_version(data.get("format"), (found.version,))
    if "content" not in data:
        raise misfit("content", "(nothing)", "missing", "content and sha256")
    _check_digest(data, arrays, place)
    return data["content"]


def _check_version(version: object, versions: tuple[int, ...]) -> None:
    # Not by `in` alone: True and 1.0 equal 1.
    if type(version) is not int or version not in versions:
        raise FileFormatError(
            "format",
            version,
            "a version this release does not read",
            allowed=", ".join(map(str, versions)),
            remedy="make the file again with this release",
        )


def _check_digest(
    data: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], place: Path
) -> None:
    # A key that the digest covers and no release writes: the file was made by something
    # else.
    if unknown := sorted(set(data) - _ENVELOPE):
        raise misfit(
            unknown[0], data[unknown[0]], "an unknown key", ", ".join(sorted(_ENVELOPE))
        )
    actual = {name: array_digest(values) for name, values in arrays.items()}
    if data.get("arrays", {}) != actual:
        raise misfit(
            "arrays",
            ", ".join(actual),
            "changed after they were written",
            "the arrays as written",
        )
    digest = guarded(lambda: _digest(data), "sha256")
    if data.get("sha256") != digest:
        raise edited(place, data.get("sha256"), digest)


# --- files that a class writes itself: an envelope without a digest ---------


def write_json(
    path: Path | str, kind: str, version: int, payload: Mapping[str, Any]
) -> None:
    """Write values with their envelope; floats round-trip exactly, NaN and infinity are
    refused.
    """
    text = json.dumps(_head(kind, version) | dict(payload), indent=1, allow_nan=False)
    write_text(path, text + "\n")


def read_json(
    path: Path | str, kind: str, versions: tuple[int, ...] = (1,)
) -> dict[str, Any]:
    """Read back what `write_json` wrote, after checking its kind and its format's
    version.
    """
    data = parse_json(read_text(path, f"a {kind} file"), source=Path(path).name)
    return checked_envelope(data, kind, versions, Path(path))


def write_npz(
    path: Path | str,
    kind: str,
    version: int,
    about: Mapping[str, Any],
    arrays: Mapping[str, NDArray[Any]],
) -> None:
    """Write arrays with their envelope (`kind`, `version`, `about`) in one step;
    `about` holds no NaN.
    """
    header = json.dumps(_head(kind, version) | dict(about), allow_nan=False)
    plain = {
        # Little-endian, whatever the machine: a file is compared by its bytes.
        name: np.asarray(values).astype(
            "<u4" if np.asarray(values).dtype == np.uint32 else "<f8", order="C"
        )
        for name, values in arrays.items()
    }
    with atomic_write(path, "wb") as stream:
        write_archive(stream, header, plain)


def checked_envelope(
    data: object, kind: str, versions: tuple[int, ...], place: Path
) -> dict[str, Any]:
    """Return the object of a saved result after checking its kind and its format's
    version.
    """
    found = data.get("fraclink") if isinstance(data, dict) else None
    if not isinstance(data, dict) or found != kind:
        problem, remedy = f"of kind {found!r}", f"give a {kind} file"
        raise FileFormatError(
            "file", str(place), problem, allowed=f"kind {kind!r}", remedy=remedy
        )
    _check_version(data.get("format"), versions)
    return data
