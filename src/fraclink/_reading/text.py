"""A table of numbers as text, in the forms in which laboratories write it.

The plain form is comments, one line of names, and rows of numbers with decimal points.
Four separators are tried; the one under which rows of numbers begin, and most cells are
numbers, separates the cells. Names stand above the first row, units may stand between.
Numbers in quotes, decimal commas where no comma separates, stamps of a clock, a
separator at the end of every row and a table on its side are told in a sentence. What
may mean two things stays as it is, and its cells are refused. Rows keep the numbers of
their lines, so that an error names the line of the file.

The whole body is checked at once by its bytes (only digits, signs, points, exponents
and the separator; the same number of separators in every line), then converted by
numpy's C parser. Only where that check fails are the cells looked at one by one, to say
which line is wrong and how.

`float()` accepts ``1_000``, ``infinity``, digits of other scripts; readers that replace
what they do not understand by NaN hide faults. Here a number is what the regular
expression says, and nothing else.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fraclink._reading.names import unit_of_name
from fraclink._reading.table import (
    DECIMAL_COMMA,
    NUMBER,
    SAMPLE_LIMIT,
    CellFaults,
    LogTable,
    check_file,
    check_size,
)
from fraclink.errors import FileFormatError, LogError, SizeError

__all__ = ["read_text_table"]

_CLOCK = re.compile(
    r"(?:([0-9]{1,4}[-./][0-9]{1,2}[-./][0-9]{1,4})[T ] *)?"
    r"([0-9]{1,2}):([0-9]{2}):([0-9]{2}(?:[.,][0-9]+)?)(Z|[+-][0-9]{2}:?[0-9]{2})?"
)
_MISSING = frozenset(
    ("", "nan", "+nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-")
) | {"inf", "+inf", "-inf"}
_NOTE = re.compile(r"[#%]+\s*([^:=]{1,80}?)\s*[:=]\s*(.{0,500})")
_SEPARATORS = ("\t", ";", ",", "")  # "": blanks

LINE_LIMIT = 100_000  # bytes of one line
_HEAD = 200  # lines in which a table begins; a longer header is no header
# rows of a table on its side: more channels than any log has, fewer than its samples
_MOST_CHANNELS = 64
_DAY = 86_400.0
_THOUSANDS = re.compile("[+-]?[1-9][0-9]{0,2},[0-9]{3}")
_LABVIEW = ("LabVIEW Measurement", "***End_of_Header***")


@dataclass(frozen=True)
class Layout:
    """Where the rows of a text begin, and what stands above them.

    Parameters
    ----------
    separator
        of the cells, "" for blanks.
    names, hints, remarks
        as a `LogTable` has them.
    units
        by the name of a column.
    first_line
        number of the first row in the file, counted from 1.
    body
        the rows, each with its line end.
    step
        of the stamps [s] that a header states instead of a column; "" for none.
    """

    separator: str
    names: tuple[str, ...]
    hints: tuple[str, ...]
    units: dict[str, str]
    first_line: int
    body: bytes
    remarks: tuple[str, ...]
    step: str = ""


def read_text_table(path: Path) -> LogTable:
    """Read the table of numbers at `path`.

    Raises FileFormatError (another encoding, binary), LogError (no rows, ragged rows)
    or SizeError (over the limits of `fraclink._reading.table`).
    """
    check_file(path)
    text, turned = _upright(_utf8(path.read_bytes(), path))
    _check_lines(text)
    raw = text.split(b"\n", _HEAD)
    lines = [line.decode() for line in raw[:_HEAD]]
    begin = 1 + max(
        (place for place, line in enumerate(lines) if line.startswith(_LABVIEW[1])),
        default=-1,
    )
    places = [k for k in range(begin, len(lines)) if not _is_comment(lines[k])]
    separator, row = _first_row([lines[place] for place in places])
    if row == len(places):
        raise LogError(
            "log",
            path.name,
            "a header only" if places else "without samples",
            allowed="a header and samples",
            remedy="record or export again",
        )
    start = places[row]
    head = [*(lines[:begin] if begin else ()), *(lines[k] for k in places[:row])]
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
        "text",
        tuple((note[1], note[2]) for note in notes),
        faults,
        tuple(layout.units.get(name, "") for name in names) if layout.units else (),
        (*turned, *layout.remarks),
        layout.hints,
    )


# --- bytes ------------------------------------------------------------------------------


def _utf8(raw: bytes, path: Path) -> bytes:
    """The text as UTF-8 bytes with line feeds only, whatever editor wrote it.

    UTF-16 is known by its mark. Where a byte above 127 is not UTF-8, names are read as
    Windows-1252, the encoding of ° and µ in older programs; numbers have no such byte.
    """
    wide = raw[:2] in (b"\xff\xfe", b"\xfe\xff")
    encoding = "utf-16" if wide else "utf-8-sig"
    # The mark of UTF-32 begins as that of UTF-16 does.
    if raw[:4] in (b"\xff\xfe\x00\x00", b"\x00\x00\xfe\xff"):
        encoding = "utf-32"
    if encoding == "utf-8-sig" and b"\x00" in raw:
        problem = f"damaged or binary (NUL at byte {raw.index(0)})"
        # Which shape raw numbers have, only who wrote them knows.
        raise _not_text(
            path,
            problem,
            "export the log as CSV in UTF-8; raw numbers: np.save('log.npy', "
            "np.fromfile('log.bin').reshape(-1, columns)), and read log.npy",
        )
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError as error:
        # A high byte far below the header is no ° of a name but damage, and would end
        # in a cell that some encoding makes a digit of.
        high = np.flatnonzero(np.frombuffer(raw, dtype=np.uint8) > 127)
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
    return FileFormatError(
        "log", path.name, problem, allowed="UTF-8 text", remedy=remedy
    )


def _check_lines(text: bytes) -> None:
    """Refuse what is over the limits."""
    ends = np.flatnonzero(np.frombuffer(text + b"\n", dtype=np.uint8) == ord("\n"))
    lengths = np.diff(ends, prepend=-1) - 1
    longest = int(np.argmax(lengths))
    size, allowed, remedy = "", "", "write one sample a line"
    if lengths[longest] > LINE_LIMIT:
        field, allowed = f"line {longest + 1}", f"{LINE_LIMIT} bytes"
        size = f"{lengths[longest]} bytes"
    elif ends.size > SAMPLE_LIMIT + _HEAD:
        field, size, allowed = "log", f"{ends.size} rows", f"{SAMPLE_LIMIT} rows"
        remedy = "cut the recording to one experiment, or record at a lower rate"
    if size:
        raise SizeError(field, size, "too large", allowed=allowed, remedy=remedy)


# --- the form of the table --------------------------------------------------------------


def _cells(line: str, separator: str) -> list[str]:
    """The cells of a line, without the blanks around them and their quotes."""
    if not separator:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]


def _is_numeric(cell: str) -> bool:
    forms = (NUMBER, DECIMAL_COMMA, _CLOCK)
    return any(form.fullmatch(cell) for form in forms)


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip()[0] in "#%"


def _upright(text: bytes) -> tuple[bytes, tuple[str, ...]]:
    """A table whose channels are rows is turned upright, with a remark on it."""
    if text.count(b"\n") > 4 * _MOST_CHANNELS:
        return text, ()
    lines = text.decode().split("\n")
    comments = [line for line in lines if _is_comment(line)]
    rows = [line for line in lines if not _is_comment(line)]
    for separator in _SEPARATORS:
        table = [_cells(row, separator) for row in rows]
        width = len(table[0]) if table else 0
        if not 2 <= len(table) <= _MOST_CHANNELS or {len(x) for x in table} != {width}:
            continue
        heads = [row[0] for row in table]
        # Every row begins with a name of its own; or there are no names, and no log has
        # as many channels as this has columns.
        named = len(set(heads)) == len(heads) and not any(map(_is_numeric, heads))
        wide = width > max(_HEAD, 4 * len(rows))
        cells = [cell for row in table for cell in row[named:]]
        if width > 1 and (named or wide) and all(map(_is_numeric, cells)):
            turned = [*comments, *map("\t".join, zip(*table, strict=True))]
            remark = f"{len(rows)} rows of {width - named} samples: turned upright"
            return "\n".join(turned).encode(), (remark,)
    return text, ()


def _first_row(lines: list[str]) -> tuple[str, int]:
    """What separates the cells, and which of `lines` is the first row of the table.

    A row has two numbers or more, or nothing else, and as many cells as one of the next
    two. Of the separators under which there is one, that under which most cells of it
    are numbers, and more than one stands in a row. Where no line holds numbers, the row
    is the second line, whose cells are refused.
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
    """Share of numbers among the cells that are not empty; 0 for a row of words."""
    present = [cell for cell in cells if cell]
    numbers = sum(map(_is_numeric, present))
    return numbers / len(present) if numbers >= min(2, max(1, len(present))) else 0.0


def _header(
    above: list[str], comments: list[str], separator: str, first_line: int, body: bytes
) -> Layout:
    """The layout of a table by the lines above its first row."""
    # Blank lines at the end are the editor's. A trailing tab of a table of tabs is an
    # empty last cell.
    body = body.rstrip(b" \n" if separator == "\t" else b" \t\n") + b"\n"
    mark, remarks, units = separator.encode(), [], {}
    closed = bool(mark) and body.count(mark + b"\n") == body.count(b"\n")
    if closed:
        body = body.replace(mark + b"\n", b"\n")
        remarks.append(f"a {separator.replace(chr(9), 'tab')} at the end of every row")
    rows = [_cells(line.decode(), separator) for line in body.split(b"\n", 20)[:20]]
    width = len(rows[0])
    fields = {line.split("\t")[0]: line.split("\t")[1:] for line in above}
    labview = bool(above) and above[0].startswith(_LABVIEW[0])
    split = partial(_names, separator=separator, width=width, closed=closed)
    if len(above) > 1 and _is_fragment(split(above[-1]), width):
        remarks.append(f"line {first_line - 1} is part of a row: left out")
        above = above[:-1]
    if len(above) > 1 and len(split(above[-2])) == width:
        stated = _units(split(above[-1]), width)
        units = dict(zip(split(above[-2]), stated, strict=False))
        if stated:
            remarks.append(f"line {first_line - 1} holds the units")
            above = above[:-1]
    names = split(
        above[-1] if above else comments[-1].lstrip("#% ") if comments else ""
    )
    if labview:
        remarks.append("a measurement file of LabVIEW")
        stated = [
            unit_of_name(f"x [{unit.strip()}]") for unit in fields["Y_Unit_Label"]
        ]
        units = {"X_Value": "s", **dict(zip(names[1:], stated, strict=False))}
    elif len(above) > 1:
        remarks.append(f"{len(above) - 1} lines of title above the names")
    hints: tuple[str, ...] = ()
    if len(names) != width or not all(names):
        hints = _hints(names, rows)
        if above:
            remarks.append(
                f"{len(names)} names above rows of {width} cells: columns by number"
            )
        names = tuple(f"#{place + 1}" for place in range(width))
    step = next(iter(fields.get("Delta_X", ())), "") if labview else ""
    return Layout(
        separator,
        names,
        hints,
        units,
        first_line,
        body,
        tuple(remarks),
        step.replace(",", "."),
    )


def _names(line: str, separator: str, width: int, closed: bool) -> tuple[str, ...]:
    """The cells of the line of names, whatever separates them, where they are as many
    as those of a row.
    """
    splits = [tuple(_cells(line, mark)) for mark in (separator, *_SEPARATORS)]
    # A separator at the end of the names or of the rows begins no column.
    splits += [x[:-1] for x in splits if len(x) == width + 1 and (closed or not x[-1])]
    return next((names for names in splits if len(names) == width), splits[0])


def _is_fragment(cells: Sequence[str], width: int) -> bool:
    """Whether a line is the end of a row: a recording that was switched on in it."""
    return len(cells) < width and all(map(_is_numeric, cells))


def _units(cells: Sequence[str], width: int) -> list[str]:
    """The units that a row of nothing else states, "" for those that no reader
    converts; [] where the line is another one.
    """
    inside = [cell.strip("()[] -") for cell in cells]
    units = [unit_of_name(f"x [{cell}]") for cell in inside]
    pairs = list(zip(cells, inside, units, strict=True))
    bracketed = all(not plain or cell[0] in "([" for cell, plain, _ in pairs)
    known = all(unit or not plain for _, plain, unit in pairs)
    return units if len(cells) == width and (bracketed or known) else []


def _hints(names: tuple[str, ...], rows: list[list[str]]) -> tuple[str, ...]:
    """Names that are not as many as the cells, for the columns from the first on; ()
    where they are fewer than half, as the words of a sentence are.
    """
    width = len(rows[0])
    firsts = [row[0] for row in rows if row]
    counts = [
        str(int(firsts[0]) + k) if firsts[0].isdigit() else ""
        for k in range(len(firsts))
    ]
    # R writes the number of the row without a name for it.
    if len(names) == width - 1 and firsts == counts:
        names = ("row", *names)
    return (*names, *[""] * width)[:width] if 2 * len(names) >= width else ()


def _plain_body(layout: Layout) -> Layout:
    """Numbers in quotes, decimal commas, stamps of a clock: brought to plain numbers
    between tabs.
    """
    body, separator = layout.body, layout.separator
    quoted, remarks, units = b'"' in body, [*layout.remarks], dict(layout.units)
    comma = b"," in body and b"." not in body and (separator != "," or quoted)
    first = _cells(body[: body.index(b"\n")].decode(), separator)
    clocks = [k for k, cell in enumerate(first) if _CLOCK.fullmatch(cell)]
    counted = layout.step and not first[0]
    if not (quoted or comma or clocks or counted):
        return layout
    lines = body.decode().split("\n")[:-1]
    rows = [line.split() for line in lines]
    if separator:
        rows = list(csv.reader(lines, delimiter=separator))
    # A quote that is not closed runs on over the line: its cell is refused as it is.
    if len(rows) != len(lines) or any(len(row) != len(first) for row in rows):
        return layout
    if quoted:
        remarks.append("numbers in quotes")
    decimals = [cell for row in rows for cell in row if "," in cell] if comma else []
    # 1,234 is one and a bit, or more than a thousand.
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
            remarks.append(
                f"{name} holds a clock's stamps: seconds since {first[place]}"
            )
    if counted:
        for k, row in enumerate(rows):
            row[0] = repr(k * float(layout.step))
        remarks.append(
            f"the time is counted in steps of {layout.step} s, as its header says"
        )
    body = "".join("\t".join(row) + "\n" for row in rows).encode()
    return replace(
        layout, separator="\t", body=body, units=units, remarks=tuple(remarks)
    )


def _seconds(cells: list[str]) -> list[float]:
    """Seconds since the first stamp; [] where a cell is none, or two dates cannot be
    told apart.
    """
    stamps = [stamp for cell in cells if (stamp := _CLOCK.fullmatch(cell))]
    days = {stamp[1] for stamp in stamps}
    if len(stamps) < len(cells) or len({stamp[5] for stamp in stamps}) > 1:
        return []
    try:
        number = {
            day: date.fromisoformat(str(day).replace("/", "-")).toordinal()
            for day in days
        }
    except ValueError:
        if len(days) > 1:  # 03.04.2026 may be April or March: within one day no matter
            return []
        number = dict.fromkeys(days, 0)
    clock = np.array(
        [[float(stamp[k].replace(",", ".")) for k in (2, 3, 4)] for stamp in stamps]
    )
    seconds = clock @ (3600.0, 60.0, 1.0)
    if days == {None}:
        seconds = np.unwrap(seconds, period=_DAY)  # half a day back is midnight
    ordinals = np.array([number[stamp[1]] for stamp in stamps])
    seconds = seconds + _DAY * (ordinals - ordinals[0])
    # Nanoseconds: the difference of two times of day of 86 400 s carries 1e-11 s of
    # rounding, which would look like jitter in the last digits.
    return [round(value, 9) for value in (seconds - seconds[0]).tolist()]


# --- rows and cells ---------------------------------------------------------------------


def _may_have_commas(layout: Layout) -> bool:
    """Whether the commas of a table may stand in its numbers, and between them, too."""
    return layout.separator == "," and b"." not in layout.body


def _ragged(layout: Layout, row: int, count: int) -> LogError:
    """The error of a row whose cells are not as many as those of the first."""
    lines, line = layout.body.decode().split("\n"), layout.first_line + row
    remedy = "repair or remove the line"
    # Nothing but text from here on: a footer, or a last row that was cut off when the
    # logger stopped.
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
    return LogError(f"line {line}", lines[row], problem, allowed=allowed, remedy=remedy)


def _parsed(layout: Layout) -> NDArray[np.float64] | None:
    """The whole body by numpy's C parser, or None where a cell is not a plain finite
    number.
    """
    allowed = np.zeros(256, dtype=bool)
    # A letter other than e and E or a quote: one table lookup for each byte says
    # whether the careful way is needed, before a cell is looked at.
    allowed[list(b"0123456789+-.eE\n " + (layout.separator or "\t").encode())] = True
    if not allowed[np.frombuffer(layout.body, dtype=np.uint8)].all():
        return None
    stream, mark = io.BytesIO(layout.body), layout.separator or None
    try:
        values = np.loadtxt(stream, delimiter=mark, comments=None, ndmin=2)
    except ValueError:
        return None
    # Blank lines are skipped by the parser; 1e999 becomes infinite.
    whole = values.shape == (layout.body.count(b"\n"), len(layout.names))
    return values if whole and np.isfinite(values).all() else None


def _parse_cells(layout: Layout) -> tuple[NDArray[np.float64], dict[int, CellFaults]]:
    """Every cell by itself, NaN where it is not a finite number, and what was wrong, by
    column.
    """
    lines, width = layout.body.decode().split("\n")[:-1], len(layout.names)
    values = np.full((len(lines), width), np.nan)
    faults: dict[int, CellFaults] = {}
    blanks = "[ \\t]+" if not layout.separator else f" *{re.escape(layout.separator)} *"
    good = re.compile(" *" + blanks.join([NUMBER.pattern] * width) + "[ \\t]*")
    for row, line in enumerate(lines):
        cells = line.split(layout.separator or None)
        if len(cells) != width:
            raise _ragged(layout, row, len(cells))
        # Most rows of a faulty file are good: they are recognised whole, and only the
        # others are looked at cell by cell.
        if good.fullmatch(line):
            values[row] = cells
        if np.isfinite(values[row]).all():
            continue
        # Blanks alone: str.strip would take control characters for them.
        for place, cell in enumerate(cell.strip(" \t") for cell in cells):
            value = float(cell) if NUMBER.fullmatch(cell) else math.inf
            values[row, place] = value if math.isfinite(value) else math.nan
            if math.isinf(value):  # 1e999 is a number by its form that no double holds
                where = (layout.first_line + row, cell)
                faults[place] = _with_fault(faults.get(place, CellFaults()), where)
    return values, faults


def _with_fault(known: CellFaults, where: tuple[int, str]) -> CellFaults:
    if where[1].lower() in _MISSING:
        first = known.first_missing if known.missing else where
        return replace(known, missing=known.missing + 1, first_missing=first)
    first = known.first_bad if known.bad else where
    return replace(known, bad=known.bad + 1, first_bad=first)
