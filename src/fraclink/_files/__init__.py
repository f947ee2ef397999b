"""Results on disk: one versioned codec for frozen dataclasses, as JSON or NPZ.

A class becomes a document by one decorator; its type hints say how each field is
written:

    @document("design", version=3)
    @dataclass(frozen=True)
    class Design: ...

    save(design, "design.json")
    load("design.json", kind=Design)

A document is one JSON object: its kind ("fraclink"), the version of the format, the
version of the tool, units, the period and the hashes of its sources if any, a SHA-256,
and the content. The hash covers everything except the tool's version, including arrays,
so that an edited gain is rejected. In an NPZ file the same object is the header and the
arrays are members that `numpy.load` opens.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self, TypeVar, overload
from zipfile import is_zipfile

from numpy.typing import NDArray

from fraclink import __version__
from fraclink._files.codec import Arrays, from_plain, plain
from fraclink._files.containers import (
    HEADER,
    JSON_LIMIT,
    array_digest,
    atomic_write,
    broken,
    checked_path,
    first_bytes,
    json_text,
    opened_archive,
    output_path,
    parse_json,
    read_archive,
    read_text,
    sha256_of,
    write_archive,
    write_text,
)
from fraclink._files.kinds import class_of, document, document_of
from fraclink.errors import FieldError, FileFormatError, SizeError

__all__ = [
    "Saved",
    "atomic_write",
    "check_ending",
    "checked_path",
    "digest_of",
    "document",
    "from_plain",
    "kind_of",
    "load",
    "output_path",
    "parse_json",
    "save",
    "sha256_of",
    "write_text",
]

T = TypeVar("T")
U = TypeVar("U")
UNITS = "SI, radians"
_ENDINGS = {".json", ".npz", ".toml", ".csv"}
_ZIP = b"PK"  # every zip archive starts with this
# The keys of a document; any other is refused, although the digest covers it.
_ENVELOPE = {"fraclink", "format", "tool", "units", "period", "sources"}
_ENVELOPE |= {"summary", "arrays", "sha256", "content"}


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
        whether an existing file may be replaced.

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
    file_format = document_of(type(value))
    place = output_path(path, force=force)
    container = check_ending(type(value), place)
    if container == "toml":
        getattr(value, "save")(place)  # noqa: B009
        return place
    # Encoded completely before the file is opened: a value that cannot be written
    # leaves nothing behind.
    arrays: Arrays | None = {} if container == "npz" else None
    envelope = _enveloped(value, file_format, arrays)
    if arrays is not None:
        with atomic_write(place, "wb") as stream:
            write_archive(stream, json.dumps(envelope, allow_nan=False), arrays)
        return place
    text = json_text(envelope) + "\n"
    # Nothing is written that `load` would reject: a result that cannot be read back
    # would be lost unnoticed.
    if len(text) > JSON_LIMIT:
        allowed = f"<= {JSON_LIMIT} bytes, which can be read back"
        problem, remedy = "too large to save", "save a part of it"
        if file_format.container == "either":
            remedy += ", or end its name in .npz"
        raise SizeError(file_format.kind, len(text), problem, allowed, remedy)
    write_text(place, text)
    return place


def check_ending(cls: type, place: Path) -> str:
    """Return the container, json, npz or toml, of a value of that class.

    Raises FieldError where the ending of the name promises another one; call it before
    work that cannot be repeated, such as the motion of an arm. A name with no ending, or
    one that fraclink does not use, is taken as it is.
    """
    file_format = document_of(cls)
    container = file_format.container
    if container == "either":
        container = "npz" if place.suffix == ".npz" else "json"
    if place.suffix in _ENDINGS and place.suffix != f".{container}":
        raise FieldError(
            "out",
            place.name,
            "of another kind of file",
            f".{container}, the ending of a {file_format.kind}",
            "change the ending",
        )
    return container


def _enveloped(
    value: object, file_format: document, arrays: Arrays | None
) -> dict[str, Any]:
    content = plain(
        value, type(value), hex_floats=file_format.hex_floats, arrays=arrays
    )
    members = {} if arrays is None else arrays
    optional = {
        "period": file_format.period(value),
        "sources": dict(file_format.sources(value)),
        "summary": plain(file_format.summary(value), Any),
        "arrays": {name: array_digest(values) for name, values in members.items()},
    }
    head = {"fraclink": file_format.kind, "format": file_format.version}
    head |= {"tool": __version__, "units": UNITS}
    head |= {key: item for key, item in optional.items() if item not in (None, {})}
    digest = _digest(head | {"content": content})
    return head | {"sha256": digest, "content": content}


def digest_of(value: object) -> str:
    """Return the SHA-256 that the JSON file of a result states."""
    return str(_enveloped(value, document_of(type(value)), None)["sha256"])


def _digest(data: Mapping[str, Any]) -> str:
    """SHA-256 of a document without the tool's version: sorted keys, no spaces, ASCII."""
    # Without the tool's version, two releases give the same digest for the same result;
    # sorted keys and no blanks make it independent of the writer.
    covered = {key: data[key] for key in data if key not in ("sha256", "tool")}
    text = json.dumps(covered, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode("ascii")).hexdigest()


@overload
def load(path: Path | str, kind: type[T]) -> T: ...
@overload
def load(path: Path | str, kind: tuple[type[T], type[U]]) -> T | U: ...
@overload
def load(path: Path | str, kind: tuple[type, ...] | None = None) -> Any: ...
def load(path: Path | str, kind: type[Any] | tuple[type, ...] | None = None) -> Any:
    """Read back what `save` wrote.

    `kind` is the expected class, or several of them; without it, any is read.
    FileFormatError is raised for every other file: missing, foreign, of another kind
    or format, damaged, edited.

    >>> import fraclink as fl
    >>> fl.load("no-such-file.json")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    fraclink.errors.FileFormatError: file: ...
    """
    place = checked_path("path", path)
    kinds = kind if isinstance(kind, tuple) else (kind,) if kind else ()
    if place.suffix == ".toml":
        return getattr(_expected("rig", kinds, place), "load")(place)  # noqa: B009
    data, arrays = _read(place)
    cls = _expected(data.get("fraclink"), kinds, place)
    file_format = document_of(cls)
    try:
        _check_version(data.get("format"), file_format.version)
        _check_digest(data, arrays, place)
        content = data["content"]
        return from_plain(
            cls, content, hex_floats=file_format.hex_floats, arrays=arrays
        )
    except RecursionError as error:
        raise broken(
            "a file of fraclink", place, "nested too deeply", "make it again"
        ) from error


class Saved:
    """A result that has a file of its own."""

    def save(self, path: Path | str) -> None:
        """Write this to one file, complete or not at all; `load` reads back an equal
        one. SizeError where the file could not be read back.
        """
        save(self, path, force=True)

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read what `save` wrote; FileFormatError where the file is of another kind,
        damaged or edited.
        """
        return load(path, cls)


def _expected(kind: object, wanted: tuple[type, ...], place: Path) -> type:
    """The class of a kind of file, which must be one of those wanted, if any are given."""
    kinds = {document_of(cls).kind: cls for cls in wanted}
    # JSON may contain a list here, which cannot be looked up in a dict.
    cls = kinds.get(str(kind)) if wanted else class_of(kind)
    if cls is None:
        allowed = " or ".join(kinds) or "a file that fraclink wrote"
        problem = f"of kind {str(kind)[:40]!r}"
        raise broken(allowed, place, problem, "give another file")
    return cls


def kind_of(path: Path | str) -> str:
    """Return the kind in the envelope of a file; an empty text if it is foreign, or not
    a file.

    Raises FileFormatError for a damaged .json or .npz, since it may be the wanted file.
    """
    place, what = Path(path), "a file of fraclink"
    if place.suffix == ".toml":
        return "rig"
    if not place.is_file():
        return ""
    # `save` writes kind and format first: 200 bytes are enough to tell the files of a
    # folder apart, however large they are.
    start = first_bytes(place, what, 200)
    if is_zipfile(place):
        # A damaged member may raise anything.
        with contextlib.suppress(Exception), opened_archive(place) as archive:
            start = str(archive[HEADER])[:200].encode("utf-8", "replace")
    elif place.suffix == ".npz":
        raise broken(what, place, "damaged", "make it again, or delete it")
    envelope = re.match(rb'\s*\{\s*"fraclink":\s*"([\w-]+)"', start)
    if not envelope and place.suffix == ".json":
        parse_json(read_text(place, what), source=place.name)
    return envelope.group(1).decode() if envelope else ""


def _read(place: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the object of a document and its arrays, as JSON or NPZ according to the
    file's first bytes.
    """
    what = "a file of fraclink"
    arrays: dict[str, NDArray[Any]] = {}
    if first_bytes(place, what, 2) == _ZIP:
        text, arrays = read_archive(place, what)
    else:
        text = read_text(place, what)
    data = parse_json(text, source=place.name)
    if not isinstance(data, dict) or "fraclink" not in data:
        raise broken(what, place, "not written by fraclink", "give another file")
    return data, arrays


def _check_version(version: object, expected: int) -> None:
    # Not by `!=` alone, because True and 1.0 equal 1.
    if type(version) is not int or version != expected:
        raise FileFormatError(
            "format",
            version,
            "a version this release does not read",
            str(expected),
            "make the file again with this release",
        )


def _check_digest(
    data: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], place: Path
) -> None:
    digests = {name: array_digest(values) for name, values in arrays.items()}
    unknown = sorted(set(data) - _ENVELOPE)
    digest, expected = data.get("sha256"), _digest(data)
    field, problem = "", ""
    if unknown:  # the digest covers it, but no release writes it
        field, problem = unknown[0], "an unknown key"
    elif "content" not in data:
        field, problem = "content", "missing"
    elif data.get("arrays", {}) != digests or digest != expected:
        field = "arrays" if digest == expected else "sha256"
        problem = f"{place.name} was changed after it was written: its content is no longer as computed"
    if field:
        remedy = "make the file again; to try another value, give it to the command or the function"
        value, allowed = data.get(field), f"{expected}, the digest of its content"
        raise FileFormatError(field, value, problem, allowed, remedy)
