"""The forms in which laboratories write a table of numbers as text, brought to one.

The plain form is comments, one line of names, and rows of numbers with decimal points.
What is brought to it leaves no doubt in the whole file: a title above the names, a row
of units below them, decimal commas where no comma separates cells, quotes around
numbers, stamps of a clock, a separator at the end of every row, a LabVIEW header, a
table on its side. Each step is told in a sentence. What may mean two things stays as it
is, and the reader refuses it. Lines keep their numbers, so that an error names the line
of the file.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from datetime import date

from fraclink._reading.names import unit_of_name

__all__ = [
    "CLOCK",
    "DECIMAL_COMMA",
    "LINE_LIMIT",
    "NUMBER",
    "SEPARATORS",
    "Form",
    "Layout",
    "plain_form",
]
__all__ += ["separator_of", "split_cells"]

NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?")
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+(?:[eE][+-]?[0-9]{1,3})?")
CLOCK = re.compile(
    r"[0-9-/.T ]*[0-9]{1,2}:[0-9]{2}(?::[0-9]{2}.*)?|[0-9]{4}-[0-9]{2}-[0-9]{2}"
)
SEPARATORS = ("\t", ";", ",")  # in this order: a semicolon file may have decimal commas

_LOOKED_AT = 200  # lines in which a table begins; a longer header is no header
_HEAD_BYTES = 1_000_000  # that hold them
LINE_LIMIT = 100_000  # bytes of one line of text
# rows of one width that are a table, where a line of two numbers may be part of a title
_ALIKE = 3
_FEWEST, _MOST_ROWS = (
    200,
    64,
)  # a table with fewer rows than channels have samples lies on its side
_LABVIEW = "***End_of_Header***"
_DAY = 86_400.0
_GROUPED = re.compile(r"[+-]?(?:0|[1-9][0-9]{0,2}(?:\.[0-9]{3})*),[0-9]+")  # 1.234,56


@dataclass(frozen=True)
class Form:
    """A table of text: its bytes, the units of columns by name, and in sentences what
    was done to it.
    """

    text: bytes
    units: dict[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def told(self, remark: str) -> Form:
        """The same with one more sentence."""
        return replace(self, remarks=(*self.remarks, remark))


@dataclass(frozen=True)
class Layout:
    """Where the body of a text table begins, and how its cells are separated ("" for
    blanks).
    """

    names: tuple[str, ...]
    separator: str
    first_line: int  # number of the body's first line in the file, counted from 1
    body: bytes
    notes: tuple[tuple[str, str], ...]


def split_cells(line: str, separator: str) -> list[str]:
    """The cells of a line, without the blanks around them; separated by blanks where
    `separator` is "".
    """
    cells = next(csv.reader([line], delimiter=separator)) if separator else line.split()
    return [cell.strip() for cell in cells]


def separator_of(line: str) -> str:
    """What separates the cells of a line, "" for blanks."""
    return next((mark for mark in SEPARATORS if mark in line), "")


def _is_numeric(cell: str) -> bool:
    plain = cell.strip().strip('"')
    return any(
        form.fullmatch(plain) for form in (NUMBER, DECIMAL_COMMA, _GROUPED, CLOCK)
    )


def _is_row(cells: list[str]) -> bool:
    """Whether these are numbers; a column of text beside them does no harm."""
    # Two numbers: a date or a serial number stands alone in many titles.
    return sum(map(_is_numeric, cells)) >= min(2, len(cells)) and bool(cells)


def plain_form(text: bytes) -> Form:
    """`text` in the plain form, with what was done to it."""
    form = Form(text)
    # In this order: LabVIEW's header hides the table, a table on its side has no rows
    # to look at, a title hides the names, and quotes hide the commas.
    for step in (
        _without_labview,
        _upright,
        _without_title,
        _without_quotes,
        _with_points,
    ):
        form = step(form)
    return _with_seconds(_without_last_separators(form))


def _head(text: bytes) -> list[str]:
    """The first lines."""
    lines = text[:_HEAD_BYTES].split(b"\n", _LOOKED_AT)[:_LOOKED_AT]
    return [line[:LINE_LIMIT].decode("utf-8", "replace") for line in lines]


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip()[0] in "#%"


def _commented(text: bytes, count: int, order: Iterable[int] = ()) -> bytes:
    """The first `count` lines as comments; those of `order` as they are, in that order,
    behind them.
    """
    lines = text.split(b"\n", max([count, *(place + 1 for place in order)]))
    kept = list(order)
    rest = lines[max([count - 1, *kept]) + 1 :]
    comments = [line if line[:1] in b"#%" else b"# " + line for line in lines[:count]]
    before = [comment for place, comment in enumerate(comments) if place not in kept]
    return b"\n".join([*before, *(lines[place] for place in kept), *rest])


def _without_labview(form: Form) -> Form:
    """A measurement file of LabVIEW (.lvm): its headers become comments, the step of
    time a column.
    """
    if not form.text.startswith(b"LabVIEW Measurement"):
        return form
    lines = _head(form.text)
    ends = [place for place, line in enumerate(lines) if line.startswith(_LABVIEW)]
    if len(ends) < 2 or len(lines) < ends[1] + 3:
        return form
    fields = {
        key: rest
        for key, *rest in (line.split("\t") for line in lines[: ends[1]] if line)
    }
    names = [name.strip() for name in lines[ends[1] + 1].split("\t")]
    units = [unit.strip() for unit in fields.get("Y_Unit_Label", [])]
    first = 1 if names[:1] == ["X_Value"] else 0
    by_name = dict(zip(names[first:], units, strict=False))
    own = {
        name: unit
        for name in names
        if (unit := unit_of_name(f"x [{by_name.get(name, '')}]"))
    }
    told = Form(
        _commented(form.text, ends[1] + 1), own | {"X_Value": "s"}, form.remarks
    )
    told = told.told(f"a measurement file of LabVIEW: {ends[1] + 1} lines of header")
    return _labview_columns(told, fields, lines[ends[1] + 1 : ends[1] + 3])


def _labview_columns(
    form: Form, fields: dict[str, list[str]], sample: list[str]
) -> Form:
    """Take out the empty column of comments, and write the stamps that the header has
    instead of a column.
    """
    names, row = (line.split("\t") for line in sample)
    step = next((cell.replace(",", ".") for cell in fields.get("Delta_X", [])), "")
    no_stamps = (
        names[:1] == ["X_Value"] and not row[0].strip() and bool(NUMBER.fullmatch(step))
    )
    comment = names[-1].strip() == "Comment"
    if not (no_stamps or comment):
        return form
    lines = form.text.split(b"\n")
    start = next(k for k, line in enumerate(lines) if line[:1] not in (b"#", b"%"))
    width = len(names) - comment
    for k in range(start, len(lines)):
        cells = lines[k].split(b"\t")
        if len(cells) < width:
            continue
        if no_stamps and k > start:
            cells[0] = repr((k - start - 1) * float(step)).encode()
        lines[k] = b"\t".join(cells[:width])
    form = replace(form, text=b"\n".join(lines))
    return (
        form.told(f"the time is counted in steps of {step} s, as its header says")
        if no_stamps
        else form
    )


def _upright(form: Form) -> Form:
    """A table whose channels are rows is turned upright."""
    # Before anything is split: a log of a million rows is looked at no further.
    if form.text.count(b"\n") > 4 * _MOST_ROWS:
        return form
    lines = [line for line in form.text.split(b"\n") if line.strip()]
    rows = [line.decode() for line in lines if line[:1] not in (b"#", b"%")]
    if (
        not 2 <= len(rows) <= _MOST_ROWS
        or not 2 * _FEWEST <= len(max(rows, key=len)) <= LINE_LIMIT
    ):
        return form
    separator = separator_of(rows[0])
    table = [split_cells(row, separator) for row in rows]
    width = len(table[0])
    # Four times as wide as high, and long enough for a log: a matrix of 64 by 100
    # numbers is no table of channels.
    if width <= max(_FEWEST, 4 * len(rows)) or any(len(row) != width for row in table):
        return form
    named = not any(_is_numeric(row[0]) for row in table)
    if not named and not all(map(_is_numeric, (row[0] for row in table))):
        return form
    comments = [line for line in lines if line[:1] in (b"#", b"%")]
    mark = separator or " "
    names = [mark.join(row[0] for row in table)] if named else []
    samples = zip(*(row[named:] for row in table), strict=True)
    turned = [*names, *(mark.join(cells) for cells in samples)]
    text = b"\n".join([*comments, *(line.encode() for line in turned)]) + b"\n"
    return replace(form, text=text).told(
        f"{len(rows)} rows of {width - named} samples: turned upright"
    )


def _without_title(form: Form) -> Form:
    """A title above the names becomes a comment, and a row of units below them a
    statement.
    """
    lines = _head(form.text)
    places = [place for place, line in enumerate(lines) if not _is_comment(line)]
    begin = _first_row(lines, places)
    if begin is None or begin < 2:
        return form
    separator = separator_of(lines[places[begin]])
    cells = [split_cells(lines[place], separator) for place in places[: begin + 1]]
    width, above = len(cells[begin]), cells[begin - 1]
    units = (
        _units_of(above)
        if len(above) == width and len(cells[begin - 2]) == width
        else None
    )
    if (
        units is None
        and begin > 1
        and len(above) < width
        and all(map(_is_numeric, above))
    ):
        return _without_fragment(form, lines, places[begin - 1])
    header = begin - 1 if units is None else begin - 2
    # A line of as many cells as the rows may be the names as well: which one is, only a
    # person knows.
    if len(cells[header]) != width or any(len(row) == width for row in cells[:header]):
        return form
    kept = [places[header]]
    count = places[begin] if units is not None else places[header]
    told = Form(_commented(form.text, count, kept), form.units, form.remarks)
    if header:
        lines_above = "1 line" if places[header] == 1 else f"{places[header]} lines"
        told = told.told(f"{lines_above} of title above the names")
    if units is not None:
        told = replace(
            told, units=form.units | dict(zip(cells[header], units, strict=True))
        )
        told = told.told(f"line {places[begin - 1] + 1} holds the units")
    return told


def _without_fragment(form: Form, lines: list[str], place: int) -> Form:
    """The part of a row below the names, with which a recording begins that was
    switched on in its middle.
    """
    before = [number for number in range(place) if not _is_comment(lines[number])]
    separator = separator_of(lines[place + 1])
    names = split_cells(lines[before[-1]], separator) if before else []
    if len(names) != len(split_cells(lines[place + 1], separator)) or any(
        map(_is_numeric, names)
    ):
        return form
    kept = _commented(form.text, place + 1, [before[-1]])
    return _without_title(
        replace(form, text=kept).told(f"line {place + 1} is part of a row: left out")
    )


def _first_row(lines: list[str], places: list[int]) -> int | None:
    """Which of `places` is the first row of the table: rows of one width follow it."""
    for start in range(len(places) - _ALIKE + 1):
        rows = [lines[place] for place in places[start : start + _ALIKE]]
        separator = separator_of(rows[0])
        if separator == "," and all(_is_row(row.split()) for row in rows):
            separator = ""  # decimal commas between blanks
        cells = [split_cells(row, separator) for row in rows]
        if len({len(row) for row in cells}) == 1 and all(map(_is_row, cells)):
            return start
    return None


def _units_of(cells: list[str]) -> list[str] | None:
    """The units that a row of nothing else states, "" for those that no reader
    converts; None otherwise.
    """
    inside = [cell.strip("()[] -") for cell in cells]
    units = [unit_of_name(f"x [{cell}]") for cell in inside]
    bracketed = all(
        not plain or cell[0] in "([" for cell, plain in zip(cells, inside, strict=True)
    )
    known = all(unit or not plain for unit, plain in zip(units, inside, strict=True))
    return units if bracketed or known else None


def _begin(text: bytes) -> int:
    """Where the first row of numbers begins; behind the last byte where there is none."""
    lines = _head(text)
    begin = _first_row(
        lines, [place for place, line in enumerate(lines) if not _is_comment(line)]
    )
    if begin is None:
        return len(text)
    lines_before = [place for place, line in enumerate(lines) if not _is_comment(line)][
        begin
    ]
    return sum(
        len(line) + 1
        for line in text[:_HEAD_BYTES].split(b"\n", lines_before)[:lines_before]
    )


def _line(text: bytes, begin: int) -> str:
    end = text.find(b"\n", begin)
    return text[
        begin : end if 0 <= end < begin + LINE_LIMIT else begin + LINE_LIMIT
    ].decode("utf-8", "replace")


def _names(text: bytes, begin: int) -> str:
    """The line before the first row."""
    return text[:begin].rstrip(b"\n").rpartition(b"\n")[2].decode("utf-8", "replace")


def _without_quotes(form: Form) -> Form:
    """Numbers in quotes; in quotes a decimal comma does not separate."""
    if b'"' not in form.text:
        return form
    begin = _begin(form.text)
    first = _line(form.text, begin)
    if not re.search(r'(?:^|[,;\t])\s*"[^"]*"', first):
        return form
    quoted, body = re.compile(rb'"([^"\n]*)"'), form.text[begin:]
    commas = [cell for cell in set(quoted.findall(body)) if b"," in cell]
    # A quoted text with a comma in it is no number: what it means, only its reader
    # knows.
    if not all(DECIMAL_COMMA.fullmatch(cell.decode().strip()) for cell in commas):
        return form
    plain = quoted.sub(lambda match: match[1].replace(b",", b"."), body)
    if b'"' in plain:
        return form
    told = replace(form, text=form.text[:begin] + plain).told("numbers in quotes")
    return told.told("decimal commas") if commas else told


def _with_points(form: Form) -> Form:
    """Decimal commas become points, where commas separate nothing and group no
    thousands.
    """
    if b"," not in form.text:
        return form
    begin = _begin(form.text)
    first = _line(form.text, begin)
    blanks = len(first.split()) > 1 and _is_row(first.split())
    if separator_of(first) == "," and not blanks:
        return form
    body = form.text[begin:]
    if b"," not in body:
        return form
    if b"." in body:  # 1.234,56 beside 0,04: points that group thousands
        cells = set(re.findall(rb"[^;\t\n ]+", body))
        if not all(_GROUPED.fullmatch(cell.decode()) for cell in cells):
            return form
        plain = body.replace(b".", b"").replace(b",", b".")
        return replace(form, text=form.text[:begin] + plain).told(
            "decimal commas, points between thousands"
        )
    between = re.findall(rb"(?<![0-9,])([0-9]+),([0-9]+)(?![0-9,])", body)
    if len(between) != body.count(b","):
        return form
    thousands = all(len(below) == 3 and len(above) <= 3 for above, below in between)
    if thousands and not any(above.startswith(b"0") for above, _ in between):
        return form  # 1,234 is one and a bit, or more than a thousand
    return replace(form, text=form.text[:begin] + body.replace(b",", b".")).told(
        "decimal commas"
    )


def _without_last_separators(form: Form) -> Form:
    """A separator at the end of every row, or of the names alone, begins no column."""
    begin = _begin(form.text)
    first, names = _line(form.text, begin), _names(form.text, begin)
    mark = separator_of(first)
    if mark in ("", "\t") or _is_comment(names):
        return form  # trailing tabs are blanks to the reader
    of_names, of_row = names.rstrip().endswith(mark), first.rstrip().endswith(mark)
    more = len(names.split(mark)) - len(first.split(mark))
    head, body = form.text[:begin], form.text[begin:]
    if of_names and not of_row and more == 1:
        form = replace(form, text=head.rstrip(b"\n ")[:-1] + b"\n" + body)
        return form.told(f"a {mark} at the end of the names")
    rows = (
        body.rstrip(b"\n").split(b"\n")
        if of_row and not of_names and more == -1
        else []
    )
    if rows and all(row.rstrip().endswith(mark.encode()) for row in rows):
        trimmed = b"\n".join(row.rstrip()[:-1] for row in rows) + b"\n"
        return replace(form, text=head + trimmed).told(
            f"a {mark} at the end of every row"
        )
    return form


# --- clocks -----------------------------------------------------------------------------------------------


_STAMP = re.compile(
    r"(?:(?P<day>[0-9]{1,4}[-./][0-9]{1,2}[-./][0-9]{1,4})[T ]\s*)?"
    r"(?P<h>[0-9]{1,2}):(?P<m>[0-9]{2}):(?P<s>[0-9]{2}(?:\.[0-9]+)?)(?P<zone>Z|[+-][0-9]{2}:?[0-9]{2})?"
)


def _with_seconds(form: Form) -> Form:
    """Stamps of a clock become seconds since the first of them."""
    if b":" not in form.text:
        return form
    begin = _begin(form.text)
    first = _line(form.text, begin)
    separator = separator_of(first)
    clocks = [
        k
        for k, cell in enumerate(split_cells(first, separator))
        if _STAMP.fullmatch(cell)
    ]
    if not clocks or not separator:
        return form
    head, body = form.text[:begin], form.text[begin:]
    lines = body.decode().rstrip("\n").split("\n")
    rows = [line.split(separator) for line in lines]
    names = split_cells(_names(head, begin), separator)
    for place in clocks:
        seconds = _seconds(
            [row[place].strip() if place < len(row) else "" for row in rows]
        )
        if seconds is None:
            continue  # the reader names the cell, should the column be needed
        for row, value in zip(rows, seconds, strict=True):
            row[place] = repr(value)
        name = names[place] if len(names) == len(rows[0]) else f"#{place + 1}"
        stamp = split_cells(first, separator)[place]
        form = replace(form, units=form.units | {name: "s"})
        form = form.told(f"{name} holds a clock's stamps: seconds since {stamp}")
    return replace(
        form, text=head + "\n".join(map(separator.join, rows)).encode() + b"\n"
    )


def _seconds(cells: list[str]) -> list[float] | None:
    """Seconds since the first stamp; None where a cell is none, or two dates cannot be
    told apart.
    """
    found = [_STAMP.fullmatch(cell) for cell in cells]
    stamps = [match for match in found if match is not None]
    if len(stamps) < len(cells) or len({match["zone"] for match in stamps}) > 1:
        return None
    days = {match["day"] for match in stamps}
    try:
        number = {
            day: date.fromisoformat(day.replace("/", "-")).toordinal()
            for day in days
            if day
        }
    except ValueError:
        if len(days) > 1:
            # 03.04.2026 may be April or March: within one day that does not matter
            return None
        number = {}
    start, last, added = 0.0, -1.0, 0.0
    result: list[float] = []
    for match in stamps:
        clock = 3600 * int(match["h"]) + 60 * int(match["m"]) + float(match["s"])
        # Half a day back is midnight; a little back is a stamp out of order, which the
        # reader refuses by its line.
        if not match["day"] and clock < last - 0.5 * _DAY:
            added += _DAY  # midnight
        last = clock
        value = (
            clock
            + added
            + _DAY * (number.get(match["day"], 0) - number.get(stamps[0]["day"], 0))
        )
        start = start if result else value
        # Nanoseconds: the difference of two times of day of 86 400 s carries 1e-11 s of
        # rounding, which would look like jitter in the last digits.
        result.append(round(value - start, 9))
    return result
