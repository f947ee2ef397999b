"""Bytes on disk: written complete or not at all, read without trusting one of them.

Two containers carry every result: JSON text, and NPZ (a zip archive of .npy arrays)
where there are signals. Whatever a disk, a cable or an enemy did to a file, reading it
ends in a value or in FileFormatError, and sizes are compared before memory is taken.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import os
import re
import secrets
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FieldError, FileFormatError, SizeError
from fracsys.checks.rules import rule

__all__ = [
    "JSON_LIMIT",
    "atomic_write",
    "broken",
    "checked_path",
    "existing_file",
    "guarded",
    "header_of",
    "json_text",
    "misfit",
    "output_path",
    "parse_json",
    "read_archive",
    "read_text",
    "sha256_of",
    "write_archive",
    "write_text",
]

JSON_LIMIT = (
    16_000_000  # bytes; a saved fit with its residuals of 100 000 samples is about 2 MB
)
UNPACKED_LIMIT = 400_000_000  # bytes of all members: 8 signals of 6 million samples
# unpacked to packed, above 10 MB: a constant signal packs that well, a log does not
RATIO_LIMIT = 200
_SMALL = 10_000_000
_TEXT_LIMIT = 4_000_000  # bytes of the header's text
_DIGIT_LIMIT = (
    400  # a 5 000-digit integer is an attack or a damaged file, not a measurement
)
_NAME_LIMIT = (
    120  # characters of a member's name: the path of a field, such as runs.0.tip_angle
)
_MEMBER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z0-9_-]+)*\.npy")
# What a reader may expect: numbers, flags and marks; never objects, whose loading runs
# what a file holds.
_TYPES = tuple(map(np.dtype, ("<f8", "<c16", "<u4", "<i8", "|b1")))
# What numpy writes before an array in the order of C; nothing of it is evaluated.
_NPY = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '([<>|=]?[A-Za-z][0-9]{1,7})', 'fortran_order': False, "
    rb"'shape': \(((?:[0-9]{1,15},? ?)*)\), \} *\n",
    re.DOTALL,
)
_HEADER = "about"
# What zip archives and headers with wrong bytes raise, found by feeding them
# (tests/test_files.py).
_DAMAGES = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    OSError,
    EOFError,
    RuntimeError,  # NotImplementedError and RecursionError among them
    ValueError,
    TypeError,
    LookupError,
    ArithmeticError,
    MemoryError,
)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's bytes as 64 hexadecimal digits."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def array_digest(values: NDArray[Any]) -> str:
    """SHA-256 of an array's type, shape and little-endian bytes: the same on every
    machine.
    """
    stored = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    return hashlib.sha256(
        f"{stored.dtype.str}{values.shape}".encode() + stored.tobytes()
    ).hexdigest()


def checked_path(field: str, value: object) -> Path:
    """Return `value` as a path; FieldError for anything that names no file.

    An empty text is refused: it would stand for the folder one happens to be in.

    >>> checked_path("out", "law.fmu").name
    'law.fmu'
    """
    return cast(Path, rule(Path).check(field, value))


def output_path(path: Path | str, *, force: bool = False) -> Path:
    """Return `path` after checking that it may be written; an existing file needs
    `force`.
    """
    place = checked_path("out", path)
    _check_ground(place)
    if place.is_dir() and force:  # only a file is replaced by a file
        remedy = "give a file's name"
        raise FieldError(
            "out", str(place), "a folder", allowed="the name of a file", remedy=remedy
        )
    if place.exists() and not force:
        remedy = "choose another name or add --force"
        raise FieldError(
            "out", str(place), "already there", allowed="a new name", remedy=remedy
        )
    return place


def _check_ground(place: Path) -> None:
    """Refuse a place in which no file can be made before the work, which would be lost
    there.
    """
    # Folders that are missing are made, below the nearest one that is there; the root
    # has none above it.
    ground = next(
        (folder for folder in place.absolute().parents if os.path.lexists(folder)),
        place,
    )
    if not ground.is_dir():
        problem = f"below {ground.name}, which is not a folder"
    elif not os.access(ground, os.W_OK | os.X_OK):
        problem = f"not writable (no permission in {ground})"
    else:
        return
    allowed, remedy = "a place in a folder that can be written", "choose another folder"
    raise FieldError("out", str(place), problem, allowed=allowed, remedy=remedy)


@contextlib.contextmanager
def atomic_write(path: Path | str, mode: str = "w") -> Iterator[IO[Any]]:
    """Open a temporary file beside `path` and rename it over `path` when the block ends
    without error.

    A full disk or a kill leaves the old file or none, never half of one.
    """
    place = Path(path)
    place.parent.mkdir(parents=True, exist_ok=True)
    # Beside the file and not in /tmp: a rename replaces in one step only within one
    # file system. The name is cut, as 255 bytes are all that most of them allow.
    temporary = place.with_name(f".{place.name[:100]}.{secrets.token_hex(8)}.tmp")
    binary = "b" in mode
    # Mode "x" is O_CREAT | O_EXCL with permissions 0666, from which the kernel takes
    # the umask. Asking for the umask instead means setting it for a moment, in which
    # files of other threads come out as 0666.
    try:
        opened = temporary.open(
            "xb" if binary else "x", encoding=None if binary else "utf-8"
        )
    except OSError as error:
        error.filename = str(place)  # the name that the user gave, not one that is gone
        raise
    with opened as stream:
        try:
            yield stream
            stream.flush()
            # The content reaches the disk before the name does; the other order leaves
            # an empty file after a power cut.
            os.fsync(stream.fileno())
            stream.close()
            temporary.replace(place)
        except BaseException:
            # Closed first, as Windows removes no open file; on a full disk the flush
            # within fails once more.
            with contextlib.suppress(OSError):
                stream.close()
            temporary.unlink(missing_ok=True)
            raise


def write_text(path: Path | str, text: str) -> None:
    """Write `text` to `path` in one step."""
    with atomic_write(path) as stream:
        stream.write(text)


def existing_file(path: Path | str, what: str) -> Path:
    """Return `path` after checking that a file of that name is there; FileFormatError
    otherwise.
    """
    place = Path(path)
    # A pipe without a writer would hold whoever opens it for ever, and a device never
    # ends.
    if not place.is_file():
        problem = "not a file" if place.exists() else "not there"
        raise broken(what, place, problem, "check the path")
    return place


def read_text(path: Path | str, what: str, *, limit: int = JSON_LIMIT) -> str:
    """Return the text of a UTF-8 file of at most `limit` bytes; FileFormatError
    otherwise.
    """
    place = existing_file(path, what)
    try:
        with place.open("rb") as stream:
            # One byte more than is allowed, as a size that is asked for before may be
            # another by now.
            raw = stream.read(limit + 1)
    except OSError as error:
        raise broken(
            what, place, f"not readable ({error.strerror})", "check its permissions"
        ) from error
    if len(raw) > limit:
        raise broken(what, place, f"too large: more than {limit} bytes", f"give {what}")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise broken(
            what, place, f"not UTF-8 text ({error.reason})", "save it as UTF-8"
        ) from error


def broken(what: str, place: Path, problem: str, remedy: str) -> FileFormatError:
    """Return the error about a file as a whole."""
    return FileFormatError("file", place.name, problem, allowed=what, remedy=remedy)


def misfit(path: str, value: object, problem: str, allowed: str) -> FileFormatError:
    """Return the error about one value of a document."""
    return FileFormatError(
        path or "content", value, problem, allowed=allowed, remedy="make the file again"
    )


def edited(place: Path, stated: object, digest: str) -> FileFormatError:
    """Return the error about a document whose digest is not that of its content."""
    return FileFormatError(
        "sha256",
        stated,
        f"{place.name} was changed after it was written, and holds nothing that was computed any more",
        allowed=f"{digest}, that of its content",
        remedy="make the file again; to try another value, give it to the command or the function",
    )


def guarded(make: Callable[[], Any], path: str) -> Any:
    """Return what `make` returns; whatever it raises over the values of a file becomes
    FileFormatError.
    """
    try:
        return make()
    except FileFormatError:
        raise
    except FieldError as error:
        field = f"{path}.{error.field}" if path else error.field
        raise FileFormatError(
            field,
            error.value,
            error.problem,
            allowed=error.allowed,
            remedy=error.remedy,
        ) from error
    except (
        Exception
    ) as error:  # a constructor that meets unforeseen values may raise anything
        raise misfit(
            path, f"{type(error).__name__}: {error}", "damaged", "a file of fraclink"
        ) from error


def _not_a_number(text: str, problem: str, allowed: str) -> FileFormatError:
    return FileFormatError(
        "number", text, problem, allowed=allowed, remedy="remove it from the file"
    )


def _refuse_constant(text: str) -> float:
    raise _not_a_number(text, "not a finite number", "finite numbers")


def _integer(text: str) -> int:
    if len(text) > _DIGIT_LIMIT:
        raise _not_a_number(text, "too long", f"{_DIGIT_LIMIT} digits")
    return int(text)


def _float(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _refuse_constant(text)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, value in pairs:
        if key in result:
            # json keeps the last one silently; which of two values was meant only the
            # author knows.
            raise FileFormatError(
                key, value, "given twice", allowed="each key once", remedy="remove one"
            )
        result[key] = value
    return result


def parse_json(text: str, *, source: str = "json") -> Any:
    """Parse JSON that may be hostile: keys given twice, NaN, infinity, endless digits
    are FileFormatErrors.

    `source`, such as the file's name, is what an error about the text as a whole names.

    >>> parse_json('{"a": 1}')
    {'a': 1}
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
        allowed, remedy = "a few levels", "make the file again"
        raise FileFormatError(
            source, text, "nested too deeply", allowed=allowed, remedy=remedy
        ) from error
    except json.JSONDecodeError as error:
        allowed, remedy = "JSON text", "make the file again"
        raise FileFormatError(
            source, text, f"not valid JSON ({error})", allowed=allowed, remedy=remedy
        ) from error


def json_text(value: object, level: int = 0) -> str:
    """JSON with one line for a key or a list of numbers; ``indent=1`` would break the
    line at each number.
    """
    inner, outer = "\n" + " " * (level + 1), "\n" + " " * level
    if isinstance(value, dict) and value:
        pairs = (
            f"{json.dumps(key)}: {json_text(item, level + 1)}"
            for key, item in value.items()
        )
        return "{" + inner + f",{inner}".join(pairs) + outer + "}"
    # Lists of numbers stay on a line, lists of objects do not: a file of 100 000
    # samples has few lines, and a person can read the rest.
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return (
            "["
            + inner
            + f",{inner}".join(json_text(item, level + 1) for item in value)
            + outer
            + "]"
        )
    return json.dumps(value, allow_nan=False)


def write_archive(
    stream: IO[bytes], header: str, arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write `header` and the arrays to an NPZ archive; the same content gives the same
    bytes.
    """
    size = sum(values.nbytes for values in arrays.values())
    # A tenth for the headers of the members, which count when the file is read.
    if size > 0.9 * UNPACKED_LIMIT:
        allowed = f"<= {0.9 * UNPACKED_LIMIT:.0f} bytes, which can be read back"
        raise SizeError(
            "arrays",
            size,
            "too large to save",
            allowed=allowed,
            remedy="save a shorter run",
        )
    members = {name: np.asarray(values, order="C") for name, values in arrays.items()}
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, values in (members | {_HEADER: np.array(header)}).items():
            # Stored, not deflated, at a fixed date: signals with noise pack by a few
            # percent, and the same run is the same bytes.
            blob = io.BytesIO()
            np.lib.format.write_array(blob, values, version=(1, 0), allow_pickle=False)
            archive.writestr(
                zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0)), blob.getvalue()
            )


def read_archive(path: Path | str, what: str) -> tuple[str, dict[str, NDArray[Any]]]:
    """Return the header's text and the arrays (read-only) of an NPZ archive;
    FileFormatError otherwise.
    """
    place = existing_file(path, what)
    try:
        with zipfile.ZipFile(place) as archive:
            _check_members(archive, what, place)
            members = {
                item.filename[:-4]: _member(archive, item, what, place)
                for item in archive.infolist()
            }
    except _DAMAGES as error:
        if isinstance(error, FieldError):
            raise
        raise broken(what, place, f"damaged ({error})", "make it again") from error
    header = members.pop(_HEADER, None)
    if not isinstance(header, str):
        raise broken(what, place, "one without a header", f"give {what}")
    return header, {
        name: values
        for name, values in members.items()
        if isinstance(values, np.ndarray)
    }


def header_of(path: Path | str) -> str:
    """Return the header's text of an NPZ archive alone; an empty text where it is
    damaged or foreign.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            item = archive.getinfo(f"{_HEADER}.npy")
            text = (
                _member(archive, item, "a header", Path(path))
                if item.file_size <= _TEXT_LIMIT
                else ""
            )
    except _DAMAGES:
        return ""
    return text if isinstance(text, str) else ""


def _check_members(archive: zipfile.ZipFile, what: str, place: Path) -> None:
    """Refuse by the archive's directory, before anything is unpacked."""
    items = archive.infolist()
    names = [item.filename for item in items]
    strange = [
        name for name in names if len(name) > _NAME_LIMIT or not _MEMBER.fullmatch(name)
    ]
    if strange:
        raise broken(
            what, place, f"one with a member {strange[0][:60]!r}", "make it again"
        )
    if len(set(names)) != len(names):
        raise broken(what, place, "one with a member given twice", "make it again")
    if any(item.flag_bits & 1 for item in items):
        raise broken(what, place, "encrypted", "unpack it first")
    unpacked, packed = (
        sum(item.file_size for item in items),
        sum(item.compress_size for item in items),
    )
    if unpacked > UNPACKED_LIMIT or (
        unpacked > _SMALL and unpacked > RATIO_LIMIT * max(packed, 1)
    ):
        limits = f"limit {UNPACKED_LIMIT}, ratio {RATIO_LIMIT}"
        problem = f"too large: {packed} bytes unpack to {unpacked} ({limits})"
        raise broken(what, place, problem, "record less, or make it again")


def _member(
    archive: zipfile.ZipFile, item: zipfile.ZipInfo, what: str, place: Path
) -> NDArray[Any] | str:
    with archive.open(item) as stream:
        # The directory's word for the size was compared with the limits; a member that
        # unpacks to more is cut off here.
        raw = stream.read(item.file_size + 1)
    if len(raw) != item.file_size:
        raise broken(what, place, f"damaged (member {item.filename})", "make it again")
    # numpy's own reader evaluates the header as a Python literal, and makes the array
    # that it claims before it looks for its bytes.
    described = _NPY.match(raw)
    if described is None or described.end() != 10 + int.from_bytes(raw[8:10], "little"):
        raise broken(
            what, place, f"damaged ({item.filename} is no plain array)", "make it again"
        )
    dtype, rest = np.dtype(described[1].decode()), raw[described.end() :]
    shape = tuple(int(size) for size in described[2].replace(b",", b" ").split())
    # The header is compared with what is there before an array of its size is made.
    if math.prod(shape) * dtype.itemsize != len(rest):
        raise broken(
            what,
            place,
            f"damaged ({item.filename} claims the shape {shape})",
            "make it again",
        )
    if (
        item.filename == f"{_HEADER}.npy"
        and dtype.kind == "U"
        and len(rest) <= _TEXT_LIMIT
    ):
        return str(np.frombuffer(rest, dtype=dtype)[0]) if dtype.itemsize else ""
    if dtype not in _TYPES:
        raise broken(
            what,
            place,
            f"one with {item.filename} of type {dtype}, not float64",
            "make it again",
        )
    values = (
        np.frombuffer(rest, dtype=dtype).reshape(shape).astype(dtype.newbyteorder("="))
    )
    values.flags.writeable = False
    return values
