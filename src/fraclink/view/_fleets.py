"""Drawings of many runs: spread, failures and drivers of a campaign, the map of faults,
a tournament.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fraclink._display import number, size_of
from fraclink.trials._faults import GROUPS, FaultTable, fault_named
from fraclink.trials._summary import Summary
from fraclink.trials._tournament import Tournament
from fraclink.view._drawing import Figure, Panel, beside, figure_of
from fraclink.view._marks import Bars, Cells, Mark, Point, Upright
from fraclink.view._scales import Scale
from fraclink.view._text import grams
from fracsys.checks import Mask, Real

__all__ = [
    "SHOWN",
    "drivers_figure",
    "failures_figure",
    "spread_figures",
    "strongest",
]
__all__ += [
    "fault_columns",
    "fault_counts",
    "fault_rows",
    "rivals_figure",
]


# Metric of a campaign -> title of its histogram.
SHOWN = {
    "settling_time": "settling time",
    "overshoot": "overshoot",
    "residual_vibration": "residual vibration",
    "peak_tip_error": "largest tip error",
    "peak_voltage": "largest voltage",
    "motor_reference_noise": "reference noise",
}
# cells in each direction for many runs; for few runs, a cell still contains twice
# `_FEWEST` on average
_MOST_CELLS = 14
# runs of a cell: with fewer the share is meaningless, and the cell stays empty
_FEWEST = 30
_SHARES = (1.0, 10.0, 30.0)  # [%] limits of the colours


def spread_figures(summary: Summary, values: Mapping[str, Real]) -> list[Figure]:
    """A histogram of each metric in SHOWN, with its median and 95 % quantile and a bar
    for "never".
    """
    units = {metric.name: metric.row("", 0.0).unit for metric in summary.metrics}
    return [
        _histogram(name, units[name], np.asarray(values[name], dtype=float))
        for name in SHOWN
    ]


def _histogram(name: str, unit: str, column: Real) -> Figure:
    column = column / size_of(unit)
    finite = column[np.isfinite(column)]
    never = len(column) - len(finite)
    low = float(finite.min()) if finite.size else 0.0
    # One run in a thousand may lie far out; on a scale that includes it the others
    # would share a single bar. Values beyond the scale are counted in the last bar.
    top = float(np.quantile(finite, 0.999)) if finite.size else 1.0
    top = top if top > low else low + 1.0
    heights, edges = np.histogram(
        np.clip(finite, low, top), bins="sqrt", range=(low, top)
    )
    marks: list[Mark] = [Bars(edges, heights)]
    end = top
    if never:  # a separate bar after a gap, since infinity is not a large value
        width = (top - low) / 12
        end = top + 2 * width
        marks.append(Bars([top + width, end], [never], 2))
        marks.append(
            Upright(end, f"never: {100 * never / len(column):.3g} %", left=True)
        )
    for share, text in ((0.5, "median"), (0.95, "95 %")) if finite.size else ():
        at = float(np.quantile(finite, share))
        # Next to the bar "never" there is no room for a second label; only the line
        # remains.
        marks.append(Upright(at, text if not (share > 0.9 and never) else ""))
    up = Scale(0.0, 1.15 * max(*heights, never, 1), ticks=())
    panel = Panel(f"{SHOWN[name]} [{unit}]", marks, 90.0, up)
    description = f"Histogram of the {SHOWN[name]} of {len(column)} runs; {never} never settle or have none"
    x = Scale(low, end)
    return Figure(
        f"spread-{name}", description, (panel,), scale=x, left=12.0, width=280.0
    )


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
    cells = int(np.clip(np.sqrt(across.size / (2 * _FEWEST)), 3, _MOST_CELLS))
    runs, x, y = np.histogram2d(across, up, bins=cells)
    bad, _, _ = np.histogram2d(across[failed], up[failed], bins=(x, y))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(runs >= _FEWEST, 100.0 * bad / runs, np.nan)
    # histogram2d has its first parameter along the rows, the drawing has it on the
    # horizontal axis: hence the transposition.
    levels = np.where(
        np.isfinite(share), np.digitize(np.nan_to_num(share), _SHARES), -1
    ).T
    first, second, third = (number(limit) for limit in _SHARES)
    key = (
        "runs that fail [%]",
        f"below {first}",
        f"{first} to {second}",
        f"{second} to {third}",
        f"above {third}",
    )
    sides = Scale(float(x[0]), float(x[-1])), Scale(float(y[0]), float(y[-1]))
    panel = Panel(names[1], [Cells(x, y, levels)], 260.0, sides[1])
    description = f"Share of failing runs over two parameters; cells of fewer than {_FEWEST} runs are empty"
    xlabel = f"{names[0]}; cells of fewer than {_FEWEST} runs are empty"
    return Figure("failures", description, (panel,), xlabel, scale=sides[0], key=key)


@figure_of.register
def drivers_figure(summary: Summary) -> str:
    """Draw Spearman's rank correlation of every metric with every parameter: a dot for
    each; far from the middle is strong.
    """
    metrics = [metric for metric in summary.metrics if metric.name in SHOWN]
    names = [name for name, _ in metrics[0].drivers]
    columns = [
        Column(
            SHOWN[metric.name],
            [dict(metric.drivers)[name] for name in names],
            Scale(-1.0, 1.0, ticks=((-1.0, "−1"), (0.0, "0"), (1.0, "1"))),
        )
        for metric in metrics
    ]
    words = [name.replace("_", " ") for name in names]
    description = "Rank correlation of metrics with parameters; ±1 is the strongest"
    return dots_in_columns(words, columns, description)


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
            "fault": fault_named(summary.number),
            "cells": _cells(table, summary.number),
            "command": table.repeated(summary.example) if summary.example else "",
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


# --- a tournament: one row a rival, one column a figure, a dot for what it reached -------------------------

# Attribute, title, factor, and the left end of a logarithmic scale, to which smaller
# values are clipped.
_COLUMNS = (
    ("settling_time", "settling [s]", 1.0, 0.0),
    ("worst_settling", "worst payload [s]", 1.0, 0.0),
    ("residual_vibration", "vibration [mrad]", 1e3, 0.1),
    ("offset_error", "by offset [mrad]", 1e3, 0.001),
    ("motor_reference_noise", "noise [mrad]", 1e3, 0.1),
    ("overshoot", "overshoot [%]", 100.0, 0.01),
)
_END = 1.6  # multiple of the largest value: room for its dot


@figure_of.register
def rivals_figure(result: Tournament) -> str:
    """Draw a dot for every rival and figure, in the order of the table; left is better
    throughout.
    """
    standings = result.standings
    columns = []
    for attribute, title, factor, low in _COLUMNS:
        values = [factor * float(getattr(each, attribute)) for each in standings]
        # A rival may never settle: infinity has no place on a scale and is stated in
        # words.
        finite = [value for value in values if math.isfinite(value)] or [1.0]
        # From zero for values within a decade; vibration and noise of rivals may differ
        # by a factor of a thousand.
        x = (
            Scale(low, _END * max(*finite, 10 * low), log=True)
            if low
            else Scale(0.0, 1.1 * max(finite))
        )
        columns.append(Column(title, values, x))
    names = [each.name + ("" if each.passed else " ✗") for each in standings]
    # unstable or tripped: none of its figures counts
    signs = ["dot" if each.passed else "cross" for each in standings]
    description = "What each rival reached in six figures; left is better"
    return dots_in_columns(names, columns, description, signs)


_ROW, _NAMES, _WIDE = 24.0, 190.0, 128.0  # dots per row, for the names, per column


@dataclass(frozen=True)
class Column:
    """One value for each row, on a scale of its own."""

    title: str
    values: Sequence[float]
    x: Scale


def dots_in_columns(
    names: Sequence[str],
    columns: Sequence[Column],
    description: str,
    signs: Sequence[str] = (),
) -> str:
    """Draw a dot for every row and column; the first row is drawn as the reference for
    the others.
    """
    figures = []
    count = len(names)
    for place, column in enumerate(columns):
        marks: list[Mark] = []
        for row, value in enumerate(column.values):
            sign, line = signs[row] if signs else "dot", 2 if signs and row else 1
            if math.isfinite(value):
                at = max(value, column.x.low)
                marks.append(Point(at, row + 0.5, line=line, sign=sign))
            else:
                end = column.x.high
                marks.append(Point(end, row + 0.5, "never", sign="", beside="left"))
        ticks = tuple((k + 0.5, "" if place else name) for k, name in enumerate(names))
        up = Scale(count, 0.0, ticks=ticks)
        room = 12.0 if place else _NAMES
        figures.append(
            Figure(
                f"column-{place}",
                column.title,
                (Panel(column.title, marks, _ROW * count, up),),
                scale=column.x,
                left=room,
                width=room + _WIDE,
                ticks=3,
            )
        )
    return beside(figures, description)
