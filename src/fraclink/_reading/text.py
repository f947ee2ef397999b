"""Tables of raw numbers: as a file holds them, the limits beyond which one is refused,
and as text.

A rig that runs for an hour at 1 kHz makes 3.6 million samples; four columns of them are
about 200 MB of text. What is larger is not one experiment and is refused before memory
is taken.

The whole body is checked at once by its bytes (only digits, signs, points, exponents
and the separator; the same number of separators in every line), then converted by
numpy's C parser. Only where that check fails are the cells looked at one by one, to say
which line is wrong and how.

`float()` accepts ``1_000``, ``infinity``, digits of other scripts; readers that replace
what they do not understand by NaN hide faults. Here a number is what the regular
expression says, and nothing else.
"""

from __future__ import annotations

import difflib
import io
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from fraclink._reading.faults import (
    check_width,
    fault_of_names,
    normal_bytes,
    ragged,
    width_of,
)
from fraclink._reading.forms import (
    LINE_LIMIT,
    NUMBER,
    Layout,
    plain_form,
    separator_of,
    split_cells,
)
from fraclink.errors import FileFormatError, LogError, SizeError

FILE_LIMIT = 256_000_000  # bytes
SAMPLE_LIMIT = 4_000_000  # rows
COLUMN_LIMIT = 1_000
VALUE_LIMIT = 32_000_000  # numbers in all: 256 MB in memory
MEMORY_LIMIT = (
    1_000_000_000  # bytes of address space of the child that reads binary files
)
CPU_SECONDS = 10  # of that child, for one file
WALL_SECONDS = 60  # of that child, for one file: the disk may be slow


def check_file(path: Path) -> int:
    """Return the size of the file at `path` [bytes], or raise where there is none or it
    is too large.
    """
    if not path.exists():
        raise FileFormatError(
            "log", str(path), "not there", allowed="a log file", remedy="check the path"
        )
    if not path.is_file():
        raise FileFormatError(
            "log",
            str(path),
            "not a file",
            allowed="a log file",
            remedy="give the file itself",
        )
    size = path.stat().st_size
    check_bytes(size)
    if size == 0:
        raise FileFormatError(
            "log",
            str(path),
            "empty",
            allowed="a header and samples",
            remedy="record again",
        )
    return size


def check_bytes(size: int) -> None:
    """Raise SizeError where a log is of more bytes than one experiment needs."""
    if size > FILE_LIMIT:
        raise SizeError(
            "log",
            f"{size / 1e6:.0f} MB",
            "too large",
            allowed=f"{FILE_LIMIT / 1e6:.0f} MB",
            remedy="cut the recording to one experiment, or record at a lower rate",
        )


@dataclass(frozen=True)
class CellFaults:
    """What is wrong with the cells of one text column: how many, and the first of each
    sort.

    `first_missing` and `first_bad` are (line number, text).
    """

    missing: int = 0
    first_missing: tuple[int, str] = (0, "")
    bad: int = 0
    first_bad: tuple[int, str] = (0, "")


@dataclass(frozen=True, eq=False)
class LogTable:
    """Columns of raw numbers in the order of the file; cells that are missing or bad
    hold NaN.

    Parameters
    ----------
    names
        column names, as the file has them; they may repeat.
    values
        one array for each name, shape (N,); binary files may hold columns of different
        lengths.
    kind
        file format in words.
    notes
        header entries (key, value).
    faults
        what is wrong with the cells of a column, by its place.
    units
        unit that the file states for a column, by its place; "" for none.
    remarks
        what was done to the file's form to read it, in sentences.
    hints
        names that the file has, but not as many as columns; () where `names` are its
        own. They suggest and state nothing.
    """

    names: tuple[str, ...]
    values: tuple[NDArray[np.float64], ...]
    kind: str
    notes: tuple[tuple[str, str], ...] = ()
    faults: Mapping[int, CellFaults] = field(
        default_factory=lambda: MappingProxyType({})
    )
    units: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    hints: tuple[str, ...] = ()

    def place(
        self, name: str, role: str, remedy: str = "correct [log] of the rig file"
    ) -> int:
        """The place of the column that is stated for `role`; ``"#2"`` names the second
        by its number.

        `remedy` says where the name was stated and how to mend it.
        """
        if (
            name.startswith("#")
            and name[1:].isascii()
            and name[1:].isdigit()
            and name not in self.names
        ):
            # Four digits hold every place there may be; an integer of thousands of
            # digits is not even made.
            number = int(name[1:]) if len(name) <= 5 else 0
            if 1 <= number <= len(self.names):
                return number - 1
        places = [place for place, known in enumerate(self.names) if known == name]
        if not places:
            raise self._missing(name, role, remedy)
        if len(places) > 1:
            raise LogError(
                f"column of {role}",
                name,
                f"the name of {len(places)} columns",
                allowed="a name that only one column has",
                remedy="rename one in the log, or give its number: "
                + " or ".join(f'"#{place + 1}"' for place in places[:3]),
            )
        return places[0]

    def _missing(self, name: str, role: str, remedy: str) -> LogError:
        known = {known.lower(): known for known in self.names}
        near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
        listed = ", ".join(self.names[:12]) + (", …" if len(self.names) > 12 else "")
        hint = f"did you mean {known[near[0]]!r}?" if near else remedy
        return LogError(
            f"column of {role}", name, "not in the log", allowed=listed, remedy=hint
        )


_NOTE = re.compile(r"[#%]+\s*([^:=]{1,80}?)\s*[:=]\s*(.{0,500})")
# of a header: more lines of comments are a log's own chatter
_NOTE_LIMIT = 200


def read_text_table(path: Path, *, numbered: bool = False) -> LogTable:
    """Read the table of numbers at `path`.

    Where `numbered`, columns that the names do not fit are called by their numbers.

    Raises FileFormatError (another encoding, binary), LogError (no header, no rows,
    ragged rows) or SizeError (over the limits of `fraclink._reading.text`).
    """
    check_file(path)
    form = plain_form(normal_bytes(path.read_bytes(), path))
    layout, hints = _layout(form.text, path)
    _check_size(layout)
    if unfitting := fault_of_names(layout, path):
        fault, hints = unfitting
        if not numbered:
            raise fault
        layout = replace(layout, names=_numbers(width_of(layout)))
        form = form.told(
            f"columns by number: {fault.field} has {fault.problem}; {fault.remedy}"
        )
    _check_rows(layout)
    values = _parse_fast(layout)
    faults: dict[int, CellFaults] = {}
    if values is None:
        values, faults = parse_cells(
            layout.body, layout.separator, layout.names, layout.first_line
        )
    columns = tuple(
        np.ascontiguousarray(values[:, place]) for place in range(len(layout.names))
    )
    units = (
        tuple(form.units.get(name, "") for name in layout.names) if form.units else ()
    )
    return LogTable(
        *(layout.names, columns, "text", layout.notes, faults, units, form.remarks),
        hints,
    )


def _numbers(count: int) -> tuple[str, ...]:
    return tuple(f"#{place + 1}" for place in range(count))


def _layout(text: bytes, path: Path) -> tuple[Layout, tuple[str, ...]]:
    """Split comments, header and body, and return with them the names that a comment
    has for some of the columns; a table without a header has columns ``#1``, ``#2`` …
    """
    comments: list[str] = []
    start, number = 0, 0
    while start < len(text):
        end = text.find(b"\n", start)
        end = len(text) if end < 0 else end
        _check_line_length(end - start, number + 1)
        line = text[start:end].decode().strip()
        if line and line[0] not in "#%":
            return _with_header(text, (start, end), number, comments, path)
        comments += [line] if line else []
        start, number = end + 1, number + 1
    raise LogError(
        "log",
        path.name,
        "without samples",
        allowed="a header and samples",
        remedy="record or export again",
    )


def _with_header(
    text: bytes, span: tuple[int, int], number: int, comments: list[str], path: Path
) -> tuple[Layout, tuple[str, ...]]:
    notes = tuple(
        (m[1], m[2]) for c in comments[:_NOTE_LIMIT] if (m := _NOTE.fullmatch(c))
    )
    line = text[slice(*span)].decode()
    separator = separator_of(line)
    cells = split_cells(line, separator)
    if all(NUMBER.fullmatch(cell) for cell in cells):
        # The first row is numbers already: the names may stand in the last comment, as
        # numpy writes them.
        hints = _names_of_comment(comments, len(cells))
        whole = all(hints) and bool(hints)
        names = hints if whole else _numbers(len(cells))
        hints = () if whole else hints
        body, first = text[span[0] :], number + 1
    else:
        names, body, first = tuple(cells), text[span[1] + 1 :], number + 2
        hints = ()
    if len(names) > COLUMN_LIMIT:
        raise SizeError(
            "columns",
            len(names),
            "too many",
            allowed=f"{COLUMN_LIMIT}",
            remedy="export fewer channels",
        )
    # Blank lines at the end are the editor's. A trailing tab of a table of tabs is an
    # empty last cell.
    body = body.rstrip(b" \t\n") if separator != "\t" else body.rstrip(b" \n")
    if not body:
        raise LogError(
            "log",
            path.name,
            "a header only",
            allowed="samples",
            remedy="record or export again",
        )
    return Layout(names, separator, first, body + b"\n", notes), hints


def _names_of_comment(comments: list[str], count: int) -> tuple[str, ...]:
    """The names in the last comment, "" for the columns that it leaves over; () where
    it holds no names.
    """
    line = comments[-1].lstrip("#% ") if comments else ""
    separator = separator_of(line)
    cells = split_cells(line, separator)
    # Of blanks every sentence has some: fewer than the columns they are no names.
    least = count if not separator else count / 2
    fitting = least <= len(cells) <= count and (all(cells) or len(cells) < count)
    return (*cells, *[""] * (count - len(cells))) if fitting else ()


def _check_line_length(length: int, number: int) -> None:
    if length > LINE_LIMIT:
        raise SizeError(
            f"line {number}",
            f"{length} bytes",
            "too long",
            allowed=f"{LINE_LIMIT} bytes",
            remedy="write one sample a line",
        )


def _check_size(layout: Layout) -> None:
    """Refuse what is over the limits."""
    data = np.frombuffer(layout.body, dtype=np.uint8)
    ends = np.flatnonzero(data == ord("\n"))
    lengths = np.diff(ends, prepend=-1) - 1
    longest = int(np.argmax(lengths))
    _check_line_length(int(lengths[longest]), layout.first_line + longest)
    width = len(layout.names)
    if ends.size > SAMPLE_LIMIT or ends.size * width > VALUE_LIMIT:
        raise SizeError(
            "log",
            f"{ends.size} rows of {width} columns",
            "too large",
            allowed=f"{SAMPLE_LIMIT} rows, {VALUE_LIMIT} numbers",
            remedy="cut the recording to one experiment, or record at a lower rate",
        )


def _check_rows(layout: Layout) -> None:
    """Refuse rows whose number of cells differs from the header's."""
    data, width = np.frombuffer(layout.body, dtype=np.uint8), len(layout.names)
    ends = np.flatnonzero(data == ord("\n"))
    if not layout.separator:
        return  # blanks repeat: the parser itself counts the cells
    marks = np.flatnonzero(data == ord(layout.separator))
    cells = np.diff(np.searchsorted(marks, ends), prepend=0) + 1
    wrong = np.flatnonzero(cells != width)
    if wrong.size:
        raise ragged(layout, int(wrong[0]), int(cells[wrong[0]]), wrong.size)


def _parse_fast(layout: Layout) -> NDArray[np.float64] | None:
    """The whole body by numpy's C parser, or None where a cell is not a plain finite
    number.
    """
    allowed = np.zeros(256, dtype=bool)
    # A letter other than e and E or a quote: one table lookup for each byte says
    # whether the careful way is needed, before a cell is looked at.
    allowed[list(b"0123456789+-.eE\n " + (layout.separator or "\t").encode())] = True
    if not allowed[np.frombuffer(layout.body, dtype=np.uint8)].all():
        return None
    try:
        values = np.loadtxt(
            io.BytesIO(layout.body),
            delimiter=layout.separator or None,
            comments=None,
            ndmin=2,
        )
    except ValueError:
        return None
    if (
        values.shape != (layout.body.count(b"\n"), len(layout.names))
        or not np.isfinite(values).all()
    ):
        return None  # blank lines are skipped by the parser; 1e999 becomes infinite
    return np.asarray(values, dtype=np.float64)


# --- cells, one by one -----------------------------------------------------------------------------------


_MISSING = frozenset(
    (
        "",
        "nan",
        "+nan",
        "-nan",
        "na",
        "n/a",
        "#n/a",
        "null",
        "none",
        "-",
        "inf",
        "+inf",
        "-inf",
    )
)


def parse_cells(
    body: bytes, separator: str, names: tuple[str, ...], first_line: int
) -> tuple[NDArray[np.float64], dict[int, CellFaults]]:
    """Convert every cell, NaN where it is not a finite number; also return what was
    wrong, by column.

    Raises LogError where a row of a table separated by blanks has another number of
    cells.
    """
    lines = body.decode().split("\n")[:-1]
    values = np.empty((len(lines), len(names)))
    faults: dict[int, CellFaults] = {}
    blanks = "[ \\t]+" if not separator else f" *{re.escape(separator)} *"
    good_row = re.compile(" *" + blanks.join([NUMBER.pattern] * len(names)) + "[ \\t]*")
    for row, line in enumerate(lines):
        cells = line.split(separator or None)
        # Most rows of a faulty file are good: they are recognised whole, and only the
        # others are looked at cell by cell.
        if good_row.fullmatch(line):
            values[row] = cells  # numpy converts a row of checked cells at once
        else:
            check_width(first_line + row, line, len(cells), len(names))
            _fill(values[row], cells, first_line + row, faults)
    # A number by its form that no double holds. It is a fault of its cell like any
    # other, found once for the column.
    for place in np.flatnonzero(np.isinf(values).any(axis=0)).tolist():  # such as 1e999
        rows = np.flatnonzero(np.isinf(values[:, place]))
        cell = lines[rows[0]].split(separator or None)[place].strip()
        old = faults.get(place, CellFaults())
        faults[place] = CellFaults(
            old.missing, old.first_missing, rows.size, (first_line + int(rows[0]), cell)
        )
    return values, faults


def _fill(
    row: NDArray[np.float64], cells: list[str], line: int, faults: dict[int, CellFaults]
) -> None:
    for place, cell in enumerate(cells):
        row[place] = number = _number(cell.strip())
        if math.isnan(number):
            faults[place] = _noted(faults.get(place, CellFaults()), line, cell.strip())


def _number(cell: str) -> float:
    return float(cell) if NUMBER.fullmatch(cell) else math.nan


def _noted(known: CellFaults, line: int, cell: str) -> CellFaults:
    if cell.lower() in _MISSING:
        first = known.first_missing if known.missing else (line, cell)
        return CellFaults(known.missing + 1, first, known.bad, known.first_bad)
    first = known.first_bad if known.bad else (line, cell)
    return CellFaults(known.missing, known.first_missing, known.bad + 1, first)
