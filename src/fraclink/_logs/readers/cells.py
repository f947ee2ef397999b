"""Cells looked at one by one: which are numbers, which are missing, and which are neither.

`float()` accepts ``1_000``, ``infinity``, digits of other scripts; readers that replace what they do not
understand by NaN hide faults. Here a number is what the regular expression says, and nothing else.
"""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

from fraclink._logs.readers.table import CellFaults
from fraclink.errors import LogError

__all__ = ["DECIMAL_COMMA", "NUMBER", "parse_cells"]

NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?")
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+(?:[eE][+-]?[0-9]{1,3})?")
CLOCK = re.compile(r"[0-9-/.T ]*[0-9]{1,2}:[0-9]{2}(?::[0-9]{2}.*)?|[0-9]{4}-[0-9]{2}-[0-9]{2}")
_MISSING = frozenset(
    ("", "nan", "+nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-", "inf", "+inf", "-inf")
)


def parse_cells(
    body: bytes, separator: str, names: tuple[str, ...], first_line: int
) -> tuple[NDArray[np.float64], dict[int, CellFaults]]:
    """Convert every cell, NaN where it is not a finite number; also return what was wrong, by column.

    Raises LogError where a row of a table separated by blanks has another number of cells.
    """
    lines = body.decode().split("\n")[:-1]
    values = np.empty((len(lines), len(names)))
    faults: dict[int, CellFaults] = {}
    blanks = "[ \\t]+" if not separator else f" *{re.escape(separator)} *"
    good_row = re.compile(" *" + blanks.join([NUMBER.pattern] * len(names)) + "[ \\t]*")
    for row, line in enumerate(lines):
        cells = line.split(separator or None)
        if good_row.fullmatch(line):
            values[row] = cells  # numpy converts a row of checked cells at once
        else:
            _check_width(first_line + row, line, len(cells), len(names))
            _fill(values[row], cells, first_line + row, faults)
    for place in np.flatnonzero(np.isinf(values).any(axis=0)).tolist():  # such as 1e999
        rows = np.flatnonzero(np.isinf(values[:, place]))
        cell = lines[rows[0]].split(separator or None)[place].strip()
        old = faults.get(place, CellFaults())
        faults[place] = CellFaults(
            old.missing, old.first_missing, rows.size, (first_line + int(rows[0]), cell)
        )
    return values, faults


def _check_width(line: int, text: str, found: int, wanted: int) -> None:
    if found != wanted:
        raise LogError(
            f"line {line}",
            text,
            f"a row of {found} cells",
            allowed=f"{wanted} cells",
            remedy="repair or remove the line" if text.strip() else "remove the blank line",
        )


def _fill(row: NDArray[np.float64], cells: list[str], line: int, faults: dict[int, CellFaults]) -> None:
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
