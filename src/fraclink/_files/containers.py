"""Bytes on disk: written completely or not at all, and never trusted when read.

Two containers carry every result: JSON text, and NPZ (a zip archive of .npy arrays)
where there are signals. However a file was damaged or manipulated, reading it ends in a
value or in FileFormatError, and sizes are checked before memory is allocated.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import secrets
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FieldError, FileFormatError, SizeError
from fracsys.checks import rule

# bytes; a saved fit of 100 000 samples takes about 4 MB
JSON_LIMIT = 16_000_000
# bytes of all members together: 8 signals of 6 million samples
UNPACKED_LIMIT = 400_000_000
# Types that a reader accepts: numbers and flags, but no objects, because loading
# objects executes code from the file.
_TYPES = tuple(map(np.dtype, ("<f8", "<c16", "<u4", "<i8", "|b1")))
# the member of an archive that holds the document without its arrays
HEADER = "about"


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's bytes as 64 hexadecimal digits."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def array_digest(values: NDArray[Any]) -> str:
    """SHA-256 of an array's type, shape and little-endian bytes: the same on every
    machine.
    """
    stored = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return hashlib.sha256(
        f"{stored.dtype.str}{values.shape}".encode() + stored.tobytes()
    ).hexdigest()


def checked_path(field: str, value: object) -> Path:
    """Return `value` as a path; FieldError for anything that names no file.

    An empty text is refused: it would denote the current folder.

    >>> checked_path("out", "law.fmu").name
    'law.fmu'
    """
    return cast(Path, rule(Path).check(field, value))


def output_path(path: Path | str, *, force: bool = False) -> Path:
    """Return `path` after checking that it may be written; an existing file needs
    `force`.

    A place where no file can be made is refused now, before work whose result would be
    lost.
    """
    place = checked_path("out", path)
    allowed, remedy = "a place in a folder that can be written", "choose another folder"
    # Missing folders are created below the nearest existing one; the root has no
    # parent.
    folders = place.absolute().parents
    ground = next((folder for folder in folders if os.path.lexists(folder)), place)
    problem = ""
    if not ground.is_dir():
        problem = f"below {ground.name}, which is not a folder"
    elif not os.access(ground, os.W_OK | os.X_OK):
        problem = f"not writable (no permission in {ground})"
    elif place.is_dir() and force:  # a folder is never replaced by a file
        problem, allowed, remedy = (
            "a folder",
            "the name of a file",
            "give a file's name",
        )
    elif place.exists() and not force:
        problem, allowed = "already there", "a new name"
        remedy = "choose another name or add --force"
    if problem:
        raise FieldError("out", str(place), problem, allowed, remedy)
    return place


@contextlib.contextmanager
def atomic_write(path: Path | str, mode: str = "w") -> Iterator[IO[Any]]:
    """Open a temporary file beside `path` and rename it over `path` when the block ends
    without error.

    A full disk or a kill leaves the old file or none, never half of one.
    """
    place = Path(path)
    place.parent.mkdir(parents=True, exist_ok=True)
    # Next to the file instead of in /tmp, because a rename is atomic only within one
    # file system. The name is cut, since most file systems allow 255 bytes.
    temporary = place.with_name(f".{place.name[:100]}.{secrets.token_hex(8)}.tmp")
    binary = "b" in mode
    # Mode "x" is O_CREAT | O_EXCL with permissions 0666, to which the kernel applies
    # the umask. Reading the umask requires setting it for a moment, in which files of
    # other threads would be created with 0666.
    try:
        file = temporary.open(
            "xb" if binary else "x", encoding=None if binary else "utf-8"
        )
    except OSError as error:
        # the name given by the user, not that of the removed temporary file
        error.filename = str(place)
        raise
    with file as stream:
        try:
            yield stream
            stream.flush()
            # The content is written to disk before the rename; the other order could
            # leave an empty file after a power failure.
            os.fsync(stream.fileno())
            stream.close()
            temporary.replace(place)
        except BaseException:
            # Closed first, since Windows cannot remove an open file; on a full disk the
            # flush on closing fails once more.
            with contextlib.suppress(OSError):
                stream.close()
            temporary.unlink(missing_ok=True)
            raise


def write_text(path: Path | str, text: str) -> None:
    """Write `text` to `path` in one step."""
    with atomic_write(path) as stream:
        stream.write(text)


def first_bytes(path: Path | str, what: str, count: int) -> bytes:
    """Return at most `count` bytes of a file; FileFormatError if there is no readable
    file.
    """
    place = Path(path)
    # Opening a pipe without a writer would block for ever, and a device never ends.
    if not place.is_file():
        raise broken(
            what,
            place,
            "not a file" if place.exists() else "not there",
            "check the path",
        )
    try:
        with place.open("rb") as stream:
            return stream.read(count)
    except OSError as error:
        raise broken(
            what, place, f"not readable ({error.strerror})", "check its permissions"
        ) from error


def read_text(path: Path | str, what: str, *, limit: int = JSON_LIMIT) -> str:
    """Return the text of a UTF-8 file of at most `limit` bytes; FileFormatError
    otherwise.
    """
    place = Path(path)
    # One byte more than allowed, because the size may have changed since it was
    # checked.
    raw = first_bytes(place, what, limit + 1)
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
    return FileFormatError("file", place.name, problem, what, remedy)


def parse_json(text: str, *, source: str = "json") -> Any:
    """Parse JSON that may be hostile: keys given twice, NaN, infinity and endless
    digits are FileFormatErrors.

    An error about the text as a whole names `source`, such as the file's name.

    >>> parse_json('{"a": 1}')
    {'a': 1}
    """
    try:
        return json.loads(
            text,
            parse_constant=_finite,
            parse_float=_finite,
            object_pairs_hook=_unique,
        )
    except FileFormatError:
        raise
    except (
        RecursionError,
        ValueError,
    ) as error:  # also for integers of over 4300 digits
        problem = f"not valid JSON ({error})"
        if isinstance(error, RecursionError):
            problem = "nested too deeply"
        raise FileFormatError(
            source,
            text,
            problem,
            "JSON text",
            "give a file that fraclink has written; `fraclink identify` makes a model of a log",
        ) from error


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise FileFormatError(
            "number",
            text,
            "not a finite number",
            "finite numbers",
            "remove it from the file",
        )
    return value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys = [key for key, _ in pairs]
    if len(set(keys)) < len(keys):
        # json silently keeps the last value; only the author knows which one is right.
        twice = next(key for key in keys if keys.count(key) > 1)
        raise FileFormatError(
            twice,
            "two values",
            "given twice",
            "each key once",
            "remove one",
        )
    return dict(pairs)


def json_text(value: object, level: int = 0) -> str:
    """JSON with one line per key or list of numbers; ``indent=1`` would break the line
    at every number.
    """
    inner, outer = "\n" + " " * (level + 1), "\n" + " " * level
    if isinstance(value, dict) and value:
        parts = [
            f"{json.dumps(key)}: {json_text(item, level + 1)}"
            for key, item in value.items()
        ]
        return "{" + inner + f",{inner}".join(parts) + outer + "}"
    # Lists of numbers stay on one line, lists of objects do not: a file of 100 000
    # samples has few lines, and the rest remains readable.
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        parts = [json_text(item, level + 1) for item in value]
        return "[" + inner + f",{inner}".join(parts) + outer + "]"
    return json.dumps(value, allow_nan=False)


def write_archive(
    stream: IO[bytes], header: str, arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write `header` and the arrays to an NPZ archive; the same content gives the same
    bytes.
    """
    size = sum(values.nbytes for values in arrays.values())
    # A tenth is reserved for the headers of the members, which count when the file is
    # read.
    if size > 0.9 * UNPACKED_LIMIT:
        raise SizeError(
            "arrays",
            size,
            "too large to save",
            f"<= {0.9 * UNPACKED_LIMIT:.0f} bytes, which can be read back",
            "save a shorter run",
        )
    members = {name: np.asarray(values, order="C") for name, values in arrays.items()}
    np.savez(stream, **members, **{HEADER: np.array(header)})  # type: ignore[arg-type]


def read_archive(path: Path | str, what: str) -> tuple[str, dict[str, NDArray[Any]]]:
    """Return the header's text and the arrays (read-only) of an NPZ archive;
    FileFormatError otherwise.
    """
    place = Path(path)
    try:
        with opened_archive(place) as archive:
            members = dict(archive.items())
    # A damaged zip archive may raise anything, even a SyntaxError from an array header.
    except Exception as error:
        raise broken(what, place, f"damaged ({error})", "make it again") from error
    header = members.pop(HEADER, np.zeros(0))
    if header.dtype.kind != "U" or header.ndim:
        raise broken(what, place, "without a header", f"give {what}")
    for name, values in members.items():
        if values.dtype not in _TYPES:
            raise broken(
                what,
                place,
                f"with {name} of type {values.dtype}, not float64",
                "make it again",
            )
        values.flags.writeable = False
    return str(header), members


def opened_archive(path: Path | str) -> np.lib.npyio.NpzFile:
    """An open archive; members with objects are rejected, since loading objects
    executes code from the file.
    """
    # From the directory of the archive, before anything is unpacked.
    with zipfile.ZipFile(path) as archive:
        items = archive.infolist()
    unpacked = sum(item.file_size for item in items)
    if unpacked > UNPACKED_LIMIT:
        raise ValueError(f"too large: it unpacks to {unpacked} bytes")
    if len({item.filename for item in items}) < len(items):
        raise ValueError("a member given twice")
    opened: np.lib.npyio.NpzFile = np.load(path, allow_pickle=False)
    return opened
