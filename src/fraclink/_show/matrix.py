"""A fault campaign as a map: one row a fault, one cell for each severity and payload, worst first."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from fraclink._campaign.faults import GROUPS, FaultTable, Outcome, fault_named
from fraclink._show.text import grams
from fraclink._show.views import repeated

__all__ = ["Cell", "FaultRow", "fault_columns", "fault_counts", "fault_rows"]

_SIGNS = ("✓", "!", "✗", "✗")


@dataclass(frozen=True)
class Cell:
    """The runs of one severity and payload: level of colour 0 to 3 or -1 for none, sign, and words."""

    level: int
    sign: str
    words: str


@dataclass(frozen=True)
class FaultRow:
    """One fault: what happened in each cell, and what unfolds."""

    number: str
    title: str
    group: str
    level: int
    cells: tuple[Cell, ...]
    required: str
    runs: int
    failed: int
    worst: str
    cause: str
    note: str
    command: str


def _columns(table: FaultTable) -> list[tuple[int, float]]:
    return sorted({(outcome.case.severity, outcome.case.payload) for outcome in table.outcomes})


def fault_columns(table: FaultTable) -> tuple[str, ...]:
    """What the cells of a row stand for, from left to right."""
    return tuple(f"severity {severity}, {grams(payload)}" for severity, payload in _columns(table))


def fault_counts(table: FaultTable) -> list[tuple[str, int, int]]:
    """Each group with its level and how many faults are in it, the worst first."""
    found = Counter(row.group for row in table.rows())
    return [(group, level, found[group]) for level, group in reversed([*enumerate(GROUPS)])]


def fault_rows(table: FaultTable) -> list[FaultRow]:
    """The rows of the map, the worst group first."""
    rows = []
    for row in sorted(table.rows(), key=lambda row: (-GROUPS.index(row.group), row.number)):
        known = fault_named(row.number)
        mine = [outcome for outcome in table.outcomes if outcome.case.fault == row.number]
        rows.append(
            FaultRow(
                row.number,
                row.title,
                row.group,
                GROUPS.index(row.group),
                tuple(_cell(mine, *column) for column in _columns(table)),
                row.required.replace("<=", "≤").replace(" x ", " × "),
                row.runs,
                row.failed,
                row.worst,
                known.cause if row.failed else "",
                known.note,
                repeated(table, row.example) if row.example else "",
            )
        )
    return rows


def _cell(mine: list[Outcome], severity: int, payload: float) -> Cell:
    here = [o for o in mine if (o.case.severity, o.case.payload) == (severity, payload)]
    where = f"severity {severity}, {grams(payload)}"
    if not here:
        return Cell(-1, "", f"{where}: not run")
    level = max(GROUPS.index(outcome.group) for outcome in here)
    failed = sum(not outcome.passed for outcome in here)
    words = f"{where}: {GROUPS[level]}" + (f", {failed} of {len(here)} runs" if failed else "")
    return Cell(level, _SIGNS[level], words)
