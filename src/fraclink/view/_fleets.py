"""The map of faults: one row a fault, one cell for each severity and payload, worst
first.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from fraclink.trials._faults import GROUPS, FaultTable
from fraclink.view._text import grams

__all__ = ["fault_columns", "fault_counts", "fault_rows"]

_SIGNS = ("✓", "!", "✗", "✗")


def fault_columns(table: FaultTable) -> dict[tuple[int, float], str]:
    """The meaning of the cells of a row, from left to right, by severity and payload."""
    cases = {(each.case.severity, each.case.payload) for each in table.outcomes}
    return {
        (severity, payload): f"severity {severity}, {grams(payload)}"
        for severity, payload in sorted(cases)
    }


def fault_counts(table: FaultTable) -> list[tuple[str, int, int]]:
    """Each group with its level and its number of faults, the worst first."""
    counts = Counter(row.group for row in table.rows())
    return [
        (group, level, counts[group]) for level, group in reversed([*enumerate(GROUPS)])
    ]


def fault_rows(table: FaultTable) -> list[dict[str, Any]]:
    """The rows of the map, the worst group first: a fault's summary, its entry in the
    catalogue, its cells, and the command that repeats its worst run.
    """
    summaries = sorted(
        table.rows(), key=lambda row: (-GROUPS.index(row.group), row.number)
    )
    return [
        {
            "summary": summary,
            "fault": summary.fault,
            "cells": _cells(table, summary.number),
            "command": table.repeated(summary.worst[1]) if summary.worst else "",
        }
        for summary in summaries
    ]


def _cells(table: FaultTable, number: str) -> list[tuple[int, str, str]]:
    """Colour level, sign and words of every cell of a fault; level −1 if nothing was
    run.
    """
    cells = []
    for place, words in fault_columns(table).items():
        here = [
            outcome
            for outcome in table.outcomes
            if outcome.case.fault == number
            and (outcome.case.severity, outcome.case.payload) == place
        ]
        # A cell is as bad as its worst run; how many runs were so is said in words
        # under the pointer.
        level = max((GROUPS.index(outcome.group) for outcome in here), default=-1)
        count = sum(not outcome.passed for outcome in here)
        text = f"{words}: {GROUPS[level] if here else 'not run'}"
        text += f", {count} of {len(here)} runs" if count else ""
        cells.append((level, _SIGNS[level] if here else "", text))
    return cells
