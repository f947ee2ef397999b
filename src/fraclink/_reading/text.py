"""Tables of numbers in text files, in the forms that laboratories use.

The plain form is comments, one line of names, and rows of numbers with decimal points.
Four separators are tried; the one whose rows have the largest share of numbers is
used. Names stand above the first row, possibly followed by units. Numbers in
quotes, decimal commas where no comma separates, times of day and a separator at the
end of every row are accepted and reported. Ambiguous cells are left
unchanged and rejected. Rows keep their line numbers, so that an error names the line of
the file.

The bytes of the whole body are checked at once (only digits, signs, points, exponents
and the separator; the same number of separators in every line), then numpy's C parser
converts it. Only if that check fails are the cells examined one by one, to report which
line is wrong and how.

`float()` accepts ``1_000``, ``infinity`` and digits of other scripts, and readers that
replace unknown cells by NaN hide faults. Here only text that matches the regular
expression is a number.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from fraclink._reading.names import unit_of_name
from fraclink._reading.table import (
    DECIMAL_COMMA,
    NUMBER,
    SAMPLE_LIMIT,
    CellFaults,
    LogTable,
    check_size,
    too_large,
)
from fraclink.errors import FileFormatError, LogError
from fracsys.checks import Real

_CLOCK = re.compile(
    r"(?:([0-9]{1,4}[-./][0-9]{1,2}[-./][0-9]{1,4})[T ] *)?"
    r"([0-9]{1,2}):([0-9]{2}):([0-9]{2}(?:[.,][0-9]+)?)(Z|[+-][0-9]{2}:?[0-9]{2})?"
)
_MISSING = frozenset(
    ("", "nan", "+nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-")
) | {"inf", "+inf", "-inf"}
_NOTE = re.compile(r"[#%]+\s*([^:=]{1,80}?)\s*[:=]\s*(.{0,500})")
_SEPARATORS = ("\t", ";", ",", "")  # "": blanks

LINE_LIMIT = 100_000  # bytes of one line: a hundred for each of `COLUMN_LIMIT` columns
_HEAD = 200  # lines in which a table must begin
_THOUSANDS = re.compile("[+-]?[1-9][0-9]{0,2},[0-9]{3}")


@dataclass(frozen=True)
class Layout:
    """The rows of a text, and what the lines above them state.

    Parameters
    ----------
    separator
        of the cells, "" for blanks.
    names, hints, remarks
        as in `LogTable`.
    units
        by the name of a column.
    first_line
        number of the first row in the file, counted from 1.
    body
        the rows, each with its line end.
    """

    separator: str
    names: tuple[str, ...]
    hints: tuple[str, ...]
    units: dict[str, str]
    first_line: int
    body: bytes
    remarks: tuple[str, ...]


def read_text_table(path: Path) -> LogTable:
    """Read the table of numbers at `path`.

    Raises FileFormatError (another encoding, binary), LogError (no rows, ragged rows)
    or SizeError (over the limits of `fraclink._reading.table`).
    """
    text = _utf8(path.read_bytes(), path)
    _check_lines(text)
    raw = text.split(b"\n", _HEAD)
    lines = [line.decode() for line in raw[:_HEAD]]
    places = [k for k, line in enumerate(lines) if not _is_comment(line)]
    separator, row = _first_row([lines[place] for place in places])
    if row == len(places):
        raise LogError(
            "log",
            path.name,
            "a header only" if places else "without samples",
            "a header and samples",
            "record or export again",
        )
    start = places[row]
    head = [lines[k] for k in places[:row]]
    comments = [line for line in lines[:start] if line.strip() and _is_comment(line)]
    notes = [note for line in comments if (note := _NOTE.fullmatch(line))]
    layout = _header(head, comments, separator, start + 1, b"\n".join(raw[start:]))
    check_size(0, len(layout.names))
    layout = _plain_body(layout)
    names = layout.names
    check_size(layout.body.count(b"\n") * len(names), len(names))
    # Twice as many cells as names: 1,5,2,5 are two numbers.
    if 2 * sum(map(bool, layout.hints)) == len(names) and _may_have_commas(layout):
        raise _ragged(layout, 0, len(names))
    values = _parsed(layout)
    faults: dict[int, CellFaults] = {}
    if values is None:
        values, faults = _parse_cells(layout)
    return LogTable(
        names,
        tuple(np.ascontiguousarray(column) for column in values.T),
        tuple(layout.units.get(name, "") for name in names),
        "text",
        tuple((note[1], note[2]) for note in notes),
        faults,
        layout.remarks,
        layout.hints,
    )


# --- bytes ------------------------------------------------------------------------------


def _utf8(raw: bytes, path: Path) -> bytes:
    """The text as UTF-8 bytes with line feeds only, whatever program wrote it.

    UTF-16 is recognised by its byte order mark. If a byte above 127 is not UTF-8, names
    are read as Windows-1252, the encoding of ° and µ in older programs; numbers have no
    such byte.
    """
    wide = raw[:2] in (b"\xff\xfe", b"\xfe\xff")
    encoding = "utf-16" if wide else "utf-8-sig"
    if encoding == "utf-8-sig" and b"\x00" in raw:
        problem = f"damaged or binary (NUL at byte {raw.index(0)})"
        # Only the author knows the shape of raw binary numbers.
        raise _not_text(
            path,
            problem,
            "export the log as CSV in UTF-8; raw numbers: np.savetxt('log.csv', "
            "np.fromfile('log.bin').reshape(-1, columns), delimiter=',')",
        )
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError as error:
        # A high byte far below the header is damage and not the ° of a name; some
        # encoding might turn it into a digit.
        high = np.flatnonzero(np.frombuffer(raw, np.uint8) > 127)
        header = raw.count(b"\n", 0, int(high[-1])) < _HEAD
        if encoding != "utf-8-sig" or not header:
            raise _not_text(
                path,
                f"not {encoding.upper()} (at byte {error.start})",
                "save it as UTF-8",
            ) from error
        text = raw.decode("cp1252", "replace")
    return text.replace("\r\n", "\n").replace("\r", "\n").encode()


def _not_text(path: Path, problem: str, remedy: str) -> FileFormatError:
    return FileFormatError("log", path.name, problem, "UTF-8 text", remedy)


def _check_lines(text: bytes) -> None:
    """Reject a text beyond the limits."""
    ends = np.flatnonzero(np.frombuffer(text + b"\n", np.uint8) == ord("\n"))
    lengths = np.diff(ends, prepend=-1) - 1
    longest = int(np.argmax(lengths))
    if lengths[longest] > LINE_LIMIT:
        size, line = f"{lengths[longest]} bytes", f"line {longest + 1}"
        raise too_large(size, f"{LINE_LIMIT} bytes", line)
    if ends.size > SAMPLE_LIMIT + _HEAD:
        raise too_large(f"{ends.size} rows", f"{SAMPLE_LIMIT} rows")


# --- the form of the table --------------------------------------------------------------


def _cells(line: str, separator: str) -> list[str]:
    """The cells of a line, without the blanks around them and their quotes."""
    if not separator:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]


def _is_numeric(cell: str) -> bool:
    return any(form.fullmatch(cell) for form in (NUMBER, DECIMAL_COMMA, _CLOCK))


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip()[0] in "#%"


def _first_row(lines: list[str]) -> tuple[str, int]:
    """The separator of the cells, and the index in `lines` of the first row of the
    table.

    A row has at least two numbers, or a number alone, and as many cells as one of the
    next two lines. Of the separators that give such a row, the one with the largest
    share of numeric cells is chosen; among equals, one with several cells in a row. If
    no line holds numbers, the row is the second line, whose cells are then rejected.
    """
    best, separator, begin = (0.0, False), "", min(1, len(lines))
    for candidate in _SEPARATORS:
        table = [_cells(line, candidate) for line in lines]
        shares = [_share_of_numbers(row) for row in table]
        for place, row in enumerate(table):
            near = range(place + 1, min(place + 3, len(table)))
            alike = any(shares[k] and len(table[k]) == len(row) for k in near)
            if shares[place] and (alike or not near):
                score = (shares[place], len(row) > 1)
                if score > best:
                    best, separator, begin = score, candidate, place
                break
    return separator, begin


def _share_of_numbers(cells: list[str]) -> float:
    """Share of numbers among the non-empty cells; 0 for a row of words."""
    present = [cell for cell in cells if cell]
    numbers = sum(map(_is_numeric, present))
    return numbers / len(present) if numbers >= min(2, max(1, len(present))) else 0.0


def _header(
    above: list[str], comments: list[str], separator: str, first_line: int, body: bytes
) -> Layout:
    """The layout of a table from the lines above its first row."""
    end = len(body.rstrip())
    # Comments below the last row are cut off; the first row is not a comment.
    while _is_comment(body[body.rfind(b"\n", 0, end) + 1 : end].decode()):
        end = len(body[: body.rfind(b"\n", 0, end)].rstrip())
    body = body[: body.find(b"\n", end)] if b"\n" in body[end:] else body
    # Blank lines at the end come from the editor. In a tab-separated table a trailing
    # tab is an empty last cell.
    body = body.rstrip(b" \n" if separator == "\t" else b" \t\n") + b"\n"
    mark, remarks, units = separator.encode(), [], {}
    closed = bool(mark) and body.count(mark + b"\n") == body.count(b"\n")
    if closed:
        body = body.replace(mark + b"\n", b"\n")
        remarks.append(f"a {separator.replace(chr(9), 'tab')} at the end of every row")
    rows = [_cells(line.decode(), separator) for line in body.split(b"\n", 20)[:20]]
    width = len(rows[0])
    split = partial(_names, separator=separator, width=width, closed=closed)
    if len(above) > 1 and _is_fragment(split(above[-1]), width):
        remarks.append(f"line {first_line - 1} is part of a row: left out")
        above = above[:-1]
    if len(above) > 1 and len(split(above[-2])) == width:
        labels = _units(split(above[-1]), width)
        units = dict(zip(split(above[-2]), labels, strict=False))
        if labels:
            remarks.append(f"line {first_line - 1} holds the units")
            above = above[:-1]
    names = split(
        above[-1] if above else comments[-1].lstrip("#% ") if comments else ""
    )
    if len(above) > 1:
        remarks.append(f"{len(above) - 1} lines of title above the names")
    hints: tuple[str, ...] = ()
    if len(names) != width or not all(names):
        hints = _hints(names, rows)
        if above:
            remarks.append(
                f"{len(names)} names above rows of {width} cells: columns by number"
            )
        names = tuple(f"#{place + 1}" for place in range(width))
    return Layout(separator, names, hints, units, first_line, body, tuple(remarks))


def _names(line: str, separator: str, width: int, closed: bool) -> tuple[str, ...]:
    """The cells of the line of names, with whatever separator gives as many cells as a
    row has.
    """
    splits = [tuple(_cells(line, mark)) for mark in (separator, *_SEPARATORS)]
    # A separator at the end of the names or of the rows does not start a column.
    splits += [x[:-1] for x in splits if len(x) == width + 1 and (closed or not x[-1])]
    return next((names for names in splits if len(names) == width), splits[0])


def _is_fragment(cells: Sequence[str], width: int) -> bool:
    """Whether a line is the end of a row, cut off because the recording started within
    it.
    """
    return len(cells) < width and all(map(_is_numeric, cells))


def _units(cells: Sequence[str], width: int) -> list[str]:
    """The units in a row that holds only units, most of them known, "" for those that no
    reader converts; [] for any other line.
    """
    inside = [cell.strip("()[] -") for cell in cells]
    units = [unit_of_name(f"x [{cell}]") for cell in inside]
    pairs = list(zip(cells, inside, units, strict=True))
    bracketed = all(not plain or cell[0] in "([" for cell, plain, _ in pairs)
    valid = 2 * sum(bool(unit) for *_, unit in pairs) > sum(map(bool, inside))
    return units if len(cells) == width and (bracketed or valid) else []


def _hints(names: tuple[str, ...], rows: list[list[str]]) -> tuple[str, ...]:
    """Names that do not match the cells in number, assigned from the first column on;
    () if they are fewer than half of the cells, as in a sentence.
    """
    width = len(rows[0])
    firsts = [row[0] for row in rows if row]
    counts = [
        str(int(firsts[0]) + k) if firsts[0].isdigit() else ""
        for k in range(len(firsts))
    ]
    # R writes row numbers without a name for their column.
    if len(names) == width - 1 and firsts == counts:
        names = ("row", *names)
    return (*names, *[""] * width)[:width] if 2 * len(names) >= width else ()


def _plain_body(layout: Layout) -> Layout:
    """Numbers in quotes, decimal commas and times of day, converted to plain numbers
    between tabs.
    """
    body, separator = layout.body, layout.separator
    quoted, remarks, units = b'"' in body, [*layout.remarks], dict(layout.units)
    comma = b"," in body and b"." not in body and (separator != "," or quoted)
    first = _cells(body[: body.index(b"\n")].decode(), separator)
    clocks = [k for k, cell in enumerate(first) if _CLOCK.fullmatch(cell)]
    if not (quoted or comma or clocks):
        return layout
    lines = body.decode().split("\n")[:-1]
    rows = (
        list(csv.reader(lines, delimiter=separator))
        if separator
        else [line.split() for line in lines]
    )
    # An unclosed quote continues beyond its line; its cell is then rejected unchanged.
    if len(rows) != len(lines) or any(len(row) != len(first) for row in rows):
        return layout
    if quoted:
        remarks.append("numbers in quotes")
    decimals = [cell for row in rows for cell in row if "," in cell] if comma else []
    # In 1,234 the comma may mark decimals or thousands.
    if not all(_THOUSANDS.fullmatch(cell.strip()) for cell in decimals):
        rows = [[cell.replace(",", ".") for cell in row] for row in rows]
        remarks.append("decimal commas")
    for place in clocks:
        seconds = _seconds([row[place].strip() for row in rows])
        for row, value in zip(rows, seconds, strict=False):
            row[place] = repr(value)
        if seconds:
            name = layout.names[place]
            units[name] = "s"
            remarks.append(f"{name} holds time stamps: seconds since {first[place]}")
    body = "".join("\t".join(row) + "\n" for row in rows).encode()
    return replace(
        layout, separator="\t", body=body, units=units, remarks=tuple(remarks)
    )


def _seconds(cells: list[str]) -> list[float]:
    """Seconds since the first stamp; [] if a cell is not a stamp, or if dates are
    ambiguous.
    """
    stamps = [stamp for cell in cells if (stamp := _CLOCK.fullmatch(cell))]
    days = {stamp[1] for stamp in stamps}
    if len(stamps) < len(cells) or len({stamp[5] for stamp in stamps}) > 1:
        return []
    # 03.04.2026 may be April or March, which does not matter within one day.
    texts = [
        f"{stamp[1].replace('/', '-') if len(days) > 1 else '2000-01-01'}"
        f"T{stamp[2]:0>2}:{stamp[3]}:{stamp[4].replace(',', '.')}"
        for stamp in stamps
    ]
    try:
        # In whole nanoseconds: rounding errors of seconds would look like jitter.
        times = np.array(texts, "datetime64[ns]")
    except ValueError:
        return []
    nanoseconds = (times - times[0]).astype(np.int64)
    if days == {None}:
        # half a day back means that midnight has passed
        nanoseconds = np.unwrap(nanoseconds, period=86_400 * 10**9)
    return [float(value) for value in nanoseconds / 1e9]


# --- rows and cells ---------------------------------------------------------------------


def _may_have_commas(layout: Layout) -> bool:
    """Whether the commas of a table may be both decimal commas and separators."""
    return layout.separator == "," and b"." not in layout.body


def _ragged(layout: Layout, row: int, count: int) -> LogError:
    """The error for a row whose number of cells differs from the first row's."""
    lines, line = layout.body.decode().split("\n"), layout.first_line + row
    remedy = "repair or remove the line"
    # Only text from here on: a footer, or a last row that was cut off when the logger
    # stopped.
    if row >= len(lines) - 2 or not any(c.isdigit() for x in lines[row:] for c in x):
        remedy = f"if the table ends before it, cut off the rest by sed -i '{line},$d'"
    elif not lines[row].strip():
        remedy = "remove the blank line"
    elif _may_have_commas(layout):
        remedy = (
            "numbers seem to have decimal commas, and commas separate them, too: export "
            "with decimal points, or with semicolons between the cells"
        )
    problem, allowed = f"a row of {count} cells", f"{len(layout.names)} cells"
    return LogError(f"line {line}", lines[row], problem, allowed, remedy)


def _parsed(layout: Layout) -> Real | None:
    """The whole body by numpy's C parser, or None if a cell is not a plain finite
    number.
    """
    allowed = np.zeros(256, bool)
    # Any other byte, such as a letter or a quote, needs the slow path: one table lookup
    # per byte finds it, without examining cells.
    allowed[list(b"0123456789+-.eE\n " + (layout.separator or "\t").encode())] = True
    if not allowed[np.frombuffer(layout.body, np.uint8)].all():
        return None
    stream, mark = io.BytesIO(layout.body), layout.separator or None
    try:
        values = np.loadtxt(stream, delimiter=mark, comments=None, ndmin=2)
    except ValueError:
        return None
    # The parser skips blank lines; 1e999 becomes infinite.
    whole = values.shape == (layout.body.count(b"\n"), len(layout.names))
    return values if whole and np.isfinite(values).all() else None


def _parse_cells(layout: Layout) -> tuple[Real, dict[int, CellFaults]]:
    """Every cell on its own, NaN where it is not a finite number, and the faults by
    column.
    """
    lines, width = layout.body.decode().split("\n")[:-1], len(layout.names)
    values = np.full((len(lines), width), np.nan)
    faults: dict[int, CellFaults] = {}
    for row, line in enumerate(lines):
        cells = line.split(layout.separator or None)
        if len(cells) != width:
            raise _ragged(layout, row, len(cells))
        # Blanks only: str.strip would also remove control characters.
        for place, cell in enumerate(cell.strip(" \t") for cell in cells):
            value = float(cell) if NUMBER.fullmatch(cell) else math.nan
            # 1e999 has the form of a number, but exceeds the range of a double
            if math.isfinite(value):
                values[row, place] = value
                continue
            bad, where = cell.lower() not in _MISSING, (layout.first_line + row, cell)
            earlier = faults.get(place, CellFaults(0, where))
            first = where if bad and not earlier.bad else earlier.first
            faults[place] = CellFaults(earlier.bad + bad, first)
    return values, faults
