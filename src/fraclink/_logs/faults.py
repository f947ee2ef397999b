"""What is wrong with a row or a cell of a table of text, and how it is mended."""

from __future__ import annotations

import itertools
import re
import shlex
from pathlib import Path

from fraclink._logs.forms import CLOCK, DECIMAL_COMMA, NUMBER, SEPARATORS, Layout, split_cells
from fraclink.errors import LogError

__all__ = ["cell_remedy", "check_width", "fault_of_names", "ragged", "width_of"]


def width_of(layout: Layout) -> int:
    """Cells of the first row."""
    return len(split_cells(layout.body[: layout.body.index(b"\n")].decode(), layout.separator))


def fault_of_names(layout: Layout, path: Path) -> LogError | None:
    """The error of names that are not as many as the cells of the rows, with the line that mends them."""
    width, rows = width_of(layout), [line.decode() for line in layout.body.split(b"\n", 20)[:20]]
    cells = [split_cells(row, layout.separator) for row in rows if row.strip()]
    same = len(cells) > 2 and all(len(row) == width for row in cells)
    if width == len(layout.names) or not same or not all(map(NUMBER.fullmatch, cells[0])):
        return None
    names, more = layout.names[:width], width - len(layout.names)
    if more > 0:
        counted = [row[0] for row in cells]  # R writes the number of the row without a name for it
        first = more == 1 and all(int(float(b)) - int(float(a)) == 1 for a, b in itertools.pairwise(counted))
        names = ("row", *names) if first else (*names, *(f"#{len(names) + k + 1}" for k in range(more)))
    if layout.separator == "," and width == 2 * len(layout.names) and b"." not in layout.body:
        return None  # decimal commas: `ragged` says so
    line, mark = layout.first_line - 1, layout.separator or " "
    text = mark.join(layout.names)
    whole = re.findall(r"\s*([^()\[\]]+[(\[][^()\[\]]*[)\]])", text)
    names = tuple(whole) if mark == " " and len(whole) == width else names
    program = re.sub(r"([\\|&])", r"\\\1", mark.join(name.replace(" ", "_") for name in names))
    command = f"sed -i {shlex.quote(f'{line}s|.*|{program}|')} {shlex.quote(path.name)}"
    return LogError(
        f"line {line}",
        text,
        f"{len(layout.names)} names above rows of {width} cells",
        allowed=f"{width} names",
        remedy=f"see by fraclink inspect what each column holds, and name it; such as by {command}",
    )


def ragged(layout: Layout, row: int, found: int, count: int) -> LogError:
    """The error of row `row` with `found` cells, one of `count` whose cells are not as many as the names."""
    width, line = len(layout.names), layout.first_line + row
    text = layout.body.split(b"\n", row + 1)[row].decode()
    remedy = "repair or remove the line"
    rows = layout.body.count(b"\n")
    if row >= rows - 1 or not any(c.isdigit() for c in layout.body.split(b"\n", row)[-1].decode()):
        remedy = f"if the table ends before it, cut off the rest by sed -i '{line},$d'"
    elif not text.strip():
        remedy = "remove the blank line"
    elif layout.separator == "," and (found == 2 * width or (2 * count > rows and b"." not in layout.body)):
        remedy = "numbers seem to have decimal commas, and commas separate them, too: export with decimal "
        remedy += "points, or with semicolons between the cells"
    elif found == width + 1 and text.rstrip().endswith(layout.separator):
        remedy = "rows end with a separator: remove it, or end the header with one as well"
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
            remedy="repair or remove the line" if text.strip() else "remove the blank line",
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
