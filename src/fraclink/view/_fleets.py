"""Many runs on pages: failures and drivers of a campaign, the map of faults."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np

from fraclink._display import Row, Table
from fraclink.trials._faults import GROUPS, FaultTable
from fraclink.trials._summary import WEAK, Summary
from fraclink.view._drawing import Figure, Panel
from fraclink.view._marks import Cells
from fraclink.view._scales import Scale
from fraclink.view._text import grams, ranges_of
from fracsys.checks import Mask, Real

__all__ = ["drivers_table", "failures_figure", "fault_columns"]
__all__ += ["fault_counts", "fault_rows", "strongest"]


# Metric of a campaign -> title of its column.
_SHOWN = {
    "settling_time": "settling time",
    "overshoot": "overshoot",
    "residual_vibration": "residual vibration",
    "peak_tip_error": "largest tip error",
    "peak_voltage": "largest voltage",
    "motor_reference_noise": "reference noise",
}
# runs of a cell: with fewer the share is meaningless, and the cell stays empty
_FEWEST = 30
_SHARES = (1.0, 10.0, 30.0)  # [%] limits of the colours


def strongest(summary: Summary) -> tuple[str, str]:
    """The two parameters on which the settling time depends most."""
    drivers = next(
        metric for metric in summary.metrics if metric.name == "settling_time"
    ).drivers
    first, second = (name for name, _ in drivers[:2])
    return first, second


def failures_figure(
    across: Real, up: Real, failed: Mask, names: tuple[str, str]
) -> Figure:
    """Failure rate over two drawn parameters, with axes titled `names`."""
    # Cells with 2 · 30 runs on average, so that most of them can be coloured: a share
    # from 30 runs has a standard error of up to 9 %.
    cells = max(3, math.isqrt(across.size // (2 * _FEWEST)))
    runs, x, y = np.histogram2d(across, up, bins=cells)
    bad, _, _ = np.histogram2d(across[failed], up[failed], bins=(x, y))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(runs >= _FEWEST, 100.0 * bad / runs, np.nan)
    # histogram2d has its first parameter along the rows, the drawing has it on the
    # horizontal axis: hence the transposition.
    levels = np.where(
        np.isfinite(share), np.digitize(np.nan_to_num(share), _SHARES), -1
    ).T
    key = ("runs that fail [%]", *ranges_of(_SHARES))
    sides = Scale(float(x[0]), float(x[-1])), Scale(float(y[0]), float(y[-1]))
    panel = Panel(names[1], [Cells(x, y, levels)], 260.0, sides[1])
    remark = f"cells of fewer than {_FEWEST} runs are empty"
    return Figure(
        "failures",
        f"Share of failing runs over two parameters; {remark}",
        (panel,),
        f"{names[0]}; {remark}",
        scale=sides[0],
        key=key,
    )


def drivers_table(summary: Summary) -> Table:
    """Spearman's rank correlation of every metric with every parameter that drives one
    of them, the strongest of the settling time first.
    """
    metrics = {metric.name: metric for metric in summary.metrics}
    drivers = {title: dict(metrics[name].drivers) for name, title in _SHOWN.items()}
    lines = (
        (
            Row("", "parameter", parameter.replace("_", " ")),
            *(
                # None is shown as a dash
                Row("", title, r if abs(r) >= WEAK else None, digits=2)
                for title, r in (
                    (title, own[parameter]) for title, own in drivers.items()
                )
            ),
        )
        for parameter, _ in metrics["settling_time"].drivers
    )
    shown = (line for line in lines if any(row.value is not None for row in line[1:]))
    return Table.of("drivers", shown)


# --- the map of faults: one row a fault, one cell for each severity and payload, worst first ---------------

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
