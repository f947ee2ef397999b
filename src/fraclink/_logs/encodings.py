"""Which bytes are text, and what the others probably are."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FileFormatError

__all__ = ["normal_bytes"]

_HEADER = 200  # lines among which names stand; what is behind them are numbers
_FEWEST = 200  # numbers of a file that is looked at: the shortest log that can be fitted has more
_MOST_COLUMNS = 32
_LARGEST, _SMALLEST = 1e12, 1e-15  # no unit of a laboratory makes numbers beyond
_WIDE = (  # their marks; that of UTF-32 begins as that of UTF-16 does
    (b"\xff\xfe\x00\x00", "utf-32"),
    (b"\x00\x00\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)


def normal_bytes(raw: bytes, path: Path) -> bytes:
    """The text as UTF-8 bytes with line feeds only, whatever editor wrote it; what is no text is refused.

    UTF-16 is known by its mark. Where a byte above 127 is not UTF-8, names are read as Windows-1252, the
    encoding of ° and µ in older programs; numbers have no such byte.
    """
    encoding = next((encoding for mark, encoding in _WIDE if raw.startswith(mark)), "")
    if encoding:
        try:
            raw = raw.decode(encoding).encode()
        except UnicodeDecodeError as error:
            raise _not_text(path, f"damaged {encoding.upper()} text", "save it as UTF-8") from error
    if b"\x00" in raw:
        raise _binary(raw, path)
    raw = raw.removeprefix(b"\xef\xbb\xbf")
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raw = _of_windows(raw, path, error)
    return raw.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in raw else raw


def _not_text(path: Path, problem: str, remedy: str) -> FileFormatError:
    return FileFormatError("log", path.name, problem, allowed="UTF-8 text", remedy=remedy)


def _of_windows(raw: bytes, path: Path, error: UnicodeDecodeError) -> bytes:
    """Names as Windows-1252 wrote them; refused where a byte that is no text stands among the numbers."""
    problem, remedy = f"not UTF-8 (byte {raw[error.start]:#04x} at {error.start})", "save it as UTF-8"
    high = np.flatnonzero(np.frombuffer(raw, dtype=np.uint8) > 127)
    if raw.count(b"\n", 0, int(high[-1])) >= _HEADER:
        raise _not_text(path, problem, remedy) from error
    try:
        return raw.decode("cp1252").encode()
    except UnicodeDecodeError:
        raise _not_text(path, problem, remedy) from error


def _binary(raw: bytes, path: Path) -> FileFormatError:
    """The error for bytes that are no text, with a line to paste where they look like raw numbers."""
    for kind, words in (("<f8", "float64"), ("<f4", "float32")):
        if len(raw) % np.dtype(kind).itemsize == 0 and (shape := _shape_of(np.frombuffer(raw, kind))):
            columns, order, clock = shape
            turned = ".T" if order == "rows" else ""
            at = f"({columns}, -1){turned}" if turned else f"(-1, {columns})"
            name, target = path.name, f"{path.stem}.npy"
            line = f"import numpy as np; np.save({target!r}, np.fromfile({name!r}, '{kind}').reshape{at})"
            quoted = f'"{line}"' if re.fullmatch(r"[\w. -]+", name) else shlex.quote(line)
            seen = f"raw {words}: as {columns} {order} the {clock} of them rises steadily, as a time does"
            return _not_text(path, seen, f"if that is its shape, run python -c {quoted} and read {target}")
    return _not_text(
        path,
        f"damaged or binary (NUL at byte {raw.index(0)})",
        "export the log as CSV in UTF-8; raw numbers: np.save('log.npy', "
        "np.fromfile('log.bin').reshape(-1, columns)), and read log.npy",
    )


def _shape_of(numbers: NDArray[np.floating]) -> tuple[int, str, str] | None:
    """Columns, and whether they stand one after the other, with which one of them is a clock."""
    if numbers.size < _FEWEST or not np.isfinite(numbers).all():
        return None
    size = np.abs(numbers)
    if size.max() > _LARGEST or np.any((size > 0) & (size < _SMALLEST)):
        return None
    for columns in (n for n in range(2, _MOST_COLUMNS + 1) if numbers.size % n == 0):
        for order in ("columns", "rows"):
            table = numbers.reshape(-1, columns).T if order == "columns" else numbers.reshape(columns, -1)
            for place, values in enumerate(table):
                steps = np.diff(values)
                if np.all(steps > 0) and np.ptp(steps) < 0.5 * np.median(steps):
                    named = ("first", "second", "third")
                    return columns, order, named[place] if place < len(named) else f"{place + 1}th"
    return None
