"""Arrays in one NPZ file, read without trusting a byte of it.

An NPZ file is a zip archive of .npy files, which `numpy.load` opens for anybody; the other way round its
header may claim a thousand billion items, its members may unpack to a thousand times their size, carry
paths or Python objects. So sizes are compared before memory is taken, and only plain arrays of float64 or
uint32 and one text are accepted.
"""

from __future__ import annotations

import io
import json
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._files import atomic_write, checked_envelope, parse_json
from fraclink.errors import FieldError, FileFormatError

__all__ = ["kind_of", "read_npz", "write_npz"]

UNPACKED_LIMIT = 400_000_000  # bytes of all members: 8 signals of 6 million samples
RATIO_LIMIT = 200  # unpacked to packed, above 10 MB: a constant signal packs that well, a log does not
_SMALL = 10_000_000
_TEXT_LIMIT = 4_000_000  # bytes of the header's text
_MEMBER = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}\.npy")
_TYPES = (np.dtype("<f8"), np.dtype("<u4"))  # signals, and flags of the law
# What numpy writes before an array in the order of C; nothing of it is evaluated.
_NPY = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '([<>|=]?[A-Za-z][0-9]{1,7})', 'fortran_order': False, "
    rb"'shape': \(((?:[0-9]{1,15},? ?)*)\), \} *\n",
    re.DOTALL,
)
_ABOUT = "about"
# What zip archives and headers with wrong bytes raise, found by feeding them (tests/test_npz.py).
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
    from fraclink import __version__

    envelope = {"fraclink": kind, "format": version, "tool": __version__, "units": "SI, radians"} | dict(
        about
    )
    members = {name: _plain(values) for name, values in arrays.items()}
    members[_ABOUT] = np.array(json.dumps(envelope, allow_nan=False))
    way = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with atomic_write(path, "wb") as stream, zipfile.ZipFile(stream, "w", way) as archive:
        for name, values in members.items():
            blob = io.BytesIO()
            np.lib.format.write_array(blob, values, version=(1, 0), allow_pickle=False)
            # A fixed date: the same content gives the same bytes.
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0)), blob.getvalue(), way)


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    array = np.asarray(values)
    return array.astype("<u4" if array.dtype == np.uint32 else "<f8", order="C")


def read_npz(
    path: Path | str, kind: str, versions: tuple[int, ...] = (1,)
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read back what `write_npz` wrote: the envelope, and the arrays (read-only; float64 or uint32).

    Raises FileFormatError for anything else: damaged, hostile, of another kind or version.
    """
    place = Path(path)
    if not place.is_file():
        raise _broken(kind, place, "not there", "check the path")
    try:
        with zipfile.ZipFile(place) as archive:
            _check_members(archive, kind, place)
            members = {item.filename[:-4]: _member(archive, item, kind, place) for item in archive.infolist()}
    except _DAMAGES as error:
        if isinstance(error, FieldError):
            raise
        raise _broken(kind, place, f"damaged ({error})", "make it again") from error
    about = _about(members.pop(_ABOUT, None), kind, versions, place)
    return about, {name: values for name, values in members.items() if isinstance(values, np.ndarray)}


def kind_of(path: Path | str) -> str:
    """Return the kind in the envelope of an NPZ file; an empty text where it is damaged or foreign."""
    place = Path(path)
    try:
        with zipfile.ZipFile(place) as archive:
            item = archive.getinfo(f"{_ABOUT}.npy")
            text = _member(archive, item, "fraclink", place) if item.file_size <= _TEXT_LIMIT else ""
        about = parse_json(text) if isinstance(text, str) else None
    except _DAMAGES:
        return ""
    return str(about.get("fraclink", "")) if isinstance(about, dict) else ""


def _broken(kind: str, place: Path, problem: str, remedy: str) -> FileFormatError:
    return FileFormatError(
        kind, place.name, problem, allowed=f"a {kind} file of fraclink (NPZ)", remedy=remedy
    )


def _check_members(archive: zipfile.ZipFile, kind: str, place: Path) -> None:
    """Refuse by the archive's directory, before anything is unpacked."""
    items = archive.infolist()
    names = [item.filename for item in items]
    strange = [name for name in names if not _MEMBER.fullmatch(name)]
    if strange:
        raise _broken(kind, place, f"one with a member {strange[0][:60]!r}", "make it again")
    if len(set(names)) != len(names):
        raise _broken(kind, place, "one with a member given twice", "make it again")
    if any(item.flag_bits & 1 for item in items):
        raise _broken(kind, place, "encrypted", "unpack it first")
    unpacked, packed = sum(item.file_size for item in items), sum(item.compress_size for item in items)
    if unpacked > UNPACKED_LIMIT or (unpacked > _SMALL and unpacked > RATIO_LIMIT * max(packed, 1)):
        raise _broken(
            kind,
            place,
            f"too large: {packed} bytes unpack to {unpacked} (limit {UNPACKED_LIMIT}, ratio {RATIO_LIMIT})",
            "record less, or make it again",
        )


def _member(archive: zipfile.ZipFile, item: zipfile.ZipInfo, kind: str, place: Path) -> NDArray[Any] | str:
    with archive.open(item) as stream:
        raw = stream.read(item.file_size + 1)
    if len(raw) != item.file_size:
        raise _broken(kind, place, f"damaged (member {item.filename})", "make it again")
    described = _NPY.match(raw)
    if described is None or described.end() != 10 + int.from_bytes(raw[8:10], "little"):
        raise _broken(kind, place, f"damaged ({item.filename} is no plain array)", "make it again")
    dtype, rest = np.dtype(described[1].decode()), raw[described.end() :]
    shape = tuple(int(size) for size in described[2].replace(b",", b" ").split())
    # The header is compared with what is there before an array of its size is made.
    if math.prod(shape) * dtype.itemsize != len(rest):
        raise _broken(kind, place, f"damaged ({item.filename} claims the shape {shape})", "make it again")
    if item.filename == f"{_ABOUT}.npy" and dtype.kind == "U" and len(rest) <= _TEXT_LIMIT:
        return str(np.frombuffer(rest, dtype=dtype)[0]) if dtype.itemsize else ""
    if dtype not in _TYPES:
        raise _broken(kind, place, f"one with {item.filename} of type {dtype}, not float64", "make it again")
    values = np.frombuffer(rest, dtype=dtype).reshape(shape).astype(dtype.newbyteorder("="))
    values.flags.writeable = False
    return values


def _about(text: object, kind: str, versions: tuple[int, ...], place: Path) -> dict[str, Any]:
    if not isinstance(text, str):
        raise _broken(kind, place, "one without a header", f"give a {kind} file")
    try:
        about = parse_json(text)
    except ValueError as error:  # FieldError is one
        raise _broken(kind, place, f"damaged ({error})", "make it again") from error
    return checked_envelope(about, kind, versions, place)
