"""What is wrong with the bytes, the rows and the cells of a table of text, and how it
is mended.
"""

from __future__ import annotations

import itertools
import re
import shlex
from pathlib import Path

import numpy as np

from fraclink._reading.forms import (
    CLOCK,
    DECIMAL_COMMA,
    NUMBER,
    SEPARATORS,
    Layout,
    split_cells,
)
from fraclink.errors import FileFormatError, LogError

__all__ = [
    "cell_remedy",
    "check_width",
    "fault_of_names",
    "normal_bytes",
    "ragged",
    "width_of",
]


def width_of(layout: Layout) -> int:
    """Cells of the first row."""
    return len(
        split_cells(layout.body[: layout.body.index(b"\n")].decode(), layout.separator)
    )


def fault_of_names(
    layout: Layout, path: Path
) -> tuple[LogError, tuple[str, ...]] | None:
    """The error of names that are not as many as the cells of the rows, with the line
    that mends them; and the names which that line would write.
    """
    width, rows = (
        width_of(layout),
        [line.decode() for line in layout.body.split(b"\n", 20)[:20]],
    )
    cells = [split_cells(row, layout.separator) for row in rows if row.strip()]
    # Three rows that agree with each other and not with the names: then the names are
    # wrong. One odd row among many is the row's fault, which `ragged` tells.
    same = len(cells) > 2 and all(len(row) == width for row in cells)
    if (
        width == len(layout.names)
        or not same
        or not all(map(NUMBER.fullmatch, cells[0]))
    ):
        return None
    names, more = layout.names[:width], width - len(layout.names)
    if more > 0:
        counted = [
            row[0] for row in cells
        ]  # R writes the number of the row without a name for it
        first = more == 1 and all(
            int(float(b)) - int(float(a)) == 1 for a, b in itertools.pairwise(counted)
        )
        names = (
            ("row", *names)
            if first
            else (*names, *(f"#{len(names) + k + 1}" for k in range(more)))
        )
    # Twice as many cells as names, without a point anywhere: 1,5,2,5 are two numbers.
    if (
        layout.separator == ","
        and width == 2 * len(layout.names)
        and b"." not in layout.body
    ):
        return None  # decimal commas: `ragged` says so
    line, mark = layout.first_line - 1, layout.separator or " "
    text = mark.join(layout.names)
    # Names such as "torque (N m)" between blanks are three cells each; with their
    # brackets they are as many as the rows have.
    whole = re.findall(r"\s*([^()\[\]]+[(\[][^()\[\]]*[)\]])", text)
    names = tuple(whole) if mark == " " and len(whole) == width else names
    # What sed takes for itself in a replacement.
    program = re.sub(
        r"([\\|&])", r"\\\1", mark.join(name.replace(" ", "_") for name in names)
    )
    command = f"sed -i {shlex.quote(f'{line}s|.*|{program}|')} {shlex.quote(path.name)}"
    error = LogError(
        f"line {line}",
        text,
        f"{len(layout.names)} names above rows of {width} cells",
        allowed=f"{width} names",
        remedy=f"see by fraclink inspect what each column holds, and name it; such as by {command}",
    )
    return error, names


def ragged(layout: Layout, row: int, found: int, count: int) -> LogError:
    """The error of row `row` with `found` cells, one of `count` whose cells are not as
    many as the names.
    """
    width, line = len(layout.names), layout.first_line + row
    text = layout.body.split(b"\n", row + 1)[row].decode()
    remedy = "repair or remove the line"
    rows = layout.body.count(b"\n")
    # Nothing but text from here on: a footer, or a last row that was cut off when the
    # logger stopped.
    if row >= rows - 1 or not any(
        c.isdigit() for c in layout.body.split(b"\n", row)[-1].decode()
    ):
        remedy = f"if the table ends before it, cut off the rest by sed -i '{line},$d'"
    elif not text.strip():
        remedy = "remove the blank line"
    # Or most rows are wrong and no cell has a point: the header has commas between the
    # names, the rows inside their numbers.
    elif layout.separator == "," and (
        found == 2 * width or (2 * count > rows and b"." not in layout.body)
    ):
        remedy = "numbers seem to have decimal commas, and commas separate them, too: export with decimal "
        remedy += "points, or with semicolons between the cells"
    elif found == width + 1 and text.rstrip().endswith(layout.separator):
        remedy = (
            "rows end with a separator: remove it, or end the header with one as well"
        )
    elif found == 1 and any(mark in text for mark in (*SEPARATORS, " ")):
        remedy = "the separator differs from the header's: use one separator in the whole file"
    return LogError(
        f"line {line}",
        text,
        f"a row of {found} cells ({count} such)",
        allowed=f"{width} cells",
        remedy=remedy,
    )


def check_width(line: int, text: str, found: int, wanted: int) -> None:
    """Raise LogError where a row has `found` cells instead of `wanted`."""
    if found != wanted:
        raise LogError(
            f"line {line}",
            text,
            f"a row of {found} cells",
            allowed=f"{wanted} cells",
            remedy="repair or remove the line"
            if text.strip()
            else "remove the blank line",
        )


def cell_remedy(cell: str) -> str:
    """What to do about a cell that is no number."""
    if DECIMAL_COMMA.fullmatch(cell):
        return "it has a decimal comma: export with decimal points"
    if CLOCK.fullmatch(cell):
        return "write the time as seconds, such as those since the start"
    if cell[:1] in "'\"" and len(cell) > 1:
        return "write numbers without quotes"
    if any(c.isdigit() and not c.isascii() for c in cell):
        return "write the digits 0 to 9"
    if "_" in cell:
        return "write numbers without underscores"
    return "repair the cell, or state another column"


# --- bytes: which are text, and what the others probably are ------------------------------------------------


_HEADER = 200  # lines among which names stand; what is behind them are numbers
_WIDE = (  # their marks; that of UTF-32 begins as that of UTF-16 does
    (b"\xff\xfe\x00\x00", "utf-32"),
    (b"\x00\x00\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)


def normal_bytes(raw: bytes, path: Path) -> bytes:
    """The text as UTF-8 bytes with line feeds only, whatever editor wrote it; what is
    no text is refused.

    UTF-16 is known by its mark. Where a byte above 127 is not UTF-8, names are read as
    Windows-1252, the encoding of ° and µ in older programs; numbers have no such byte.
    """
    encoding = next((encoding for mark, encoding in _WIDE if raw.startswith(mark)), "")
    if encoding:
        try:
            raw = raw.decode(encoding).encode()
        except UnicodeDecodeError as error:
            raise _not_text(
                path, f"damaged {encoding.upper()} text", "save it as UTF-8"
            ) from error
    if b"\x00" in raw:
        # Which shape raw numbers have, only who wrote them knows.
        problem = f"damaged or binary (NUL at byte {raw.index(0)})"
        remedy = (
            "export the log as CSV in UTF-8; raw numbers: np.save('log.npy', "
            "np.fromfile('log.bin').reshape(-1, columns)), and read log.npy"
        )
        raise _not_text(path, problem, remedy)
    raw = raw.removeprefix(b"\xef\xbb\xbf")
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raw = _of_windows(raw, path, error)
    return raw.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in raw else raw


def _not_text(path: Path, problem: str, remedy: str) -> FileFormatError:
    return FileFormatError(
        "log", path.name, problem, allowed="UTF-8 text", remedy=remedy
    )


def _of_windows(raw: bytes, path: Path, error: UnicodeDecodeError) -> bytes:
    """Names as Windows-1252 wrote them; refused where a byte that is no text stands
    among the numbers.
    """
    problem, remedy = (
        f"not UTF-8 (byte {raw[error.start]:#04x} at {error.start})",
        "save it as UTF-8",
    )
    high = np.flatnonzero(np.frombuffer(raw, dtype=np.uint8) > 127)
    # A high byte far below the header is no ° of a name but damage, and would end in a
    # cell that some encoding makes a digit of.
    if raw.count(b"\n", 0, int(high[-1])) >= _HEADER:
        raise _not_text(path, problem, remedy) from error
    try:
        return raw.decode("cp1252").encode()
    except UnicodeDecodeError:
        raise _not_text(path, problem, remedy) from error
