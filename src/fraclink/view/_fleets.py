"""Drawings of many runs: a campaign's spread, failures and drivers, the map of faults,
a tournament.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink.trials._faults import GROUPS, FaultTable, Outcome, fault_named
from fraclink.trials._summary import Summary
from fraclink.view._drawing import Figure, Panel, beside, save_svg
from fraclink.view._marks import Bars, Cells, Frame, Mark, Upright, escaped, percent
from fraclink.view._scales import Scale
from fraclink.view._tables import UNITS, WEAK
from fraclink.view._text import grams, number
from fraclink.view._views import repeated

if TYPE_CHECKING:
    from fraclink.trials._tournament import Standing, Tournament

__all__ = [
    "SHOWN",
    "driver_rows",
    "drivers_figure",
    "failures_figure",
    "spread_figures",
    "strongest",
]
__all__ += [
    "Cell",
    "FaultRow",
    "draw_rivals",
    "fault_columns",
    "fault_counts",
    "fault_rows",
    "rivals_figure",
]

Real = NDArray[np.float64]

# Metric of a campaign: what its histogram is called.
SHOWN = {
    "settling_time": "settling time",
    "overshoot": "overshoot",
    "residual_vibration": "residual vibration",
    "peak_tip_error": "largest tip error",
    "peak_voltage": "largest voltage",
    "motor_reference_noise": "motor reference noise",
}
_BINS = 40
_MOST_CELLS = (
    14  # each way, of many runs; of few a cell still holds twice the fewest on average
)
_FEWEST = 30  # runs of a cell: of fewer a share says little, and the cell stays empty
_SHARES = (1.0, 10.0, 30.0)  # [%] limits of the colours


def spread_figures(values: Mapping[str, Real]) -> list[Figure]:
    """A histogram of each metric in SHOWN, with its median and 95 % quantile and a bar
    for "never".
    """
    return [_histogram(name, np.asarray(values[name], dtype=float)) for name in SHOWN]


def _histogram(name: str, column: Real) -> Figure:
    unit, factor = UNITS[name]
    column = factor * column
    finite = column[np.isfinite(column)]
    never = len(column) - len(finite)
    low = float(finite.min()) if finite.size else 0.0
    # One run in a thousand may stand far out; on a scale that reaches it the others
    # would share one bar. What lies beyond is counted in the last bar, not left out.
    top = float(np.quantile(finite, 0.999)) if finite.size else 1.0
    top = top if top > low else low + 1.0
    heights, edges = np.histogram(
        np.clip(finite, low, top), bins=_BINS, range=(low, top)
    )
    marks: list[Mark] = [Bars(edges, heights)]
    end = top
    if never:  # a bar of its own behind a gap: infinity is no large value
        width = (top - low) / 12
        end = top + 2 * width
        marks.append(Bars([top + width, end], [never], 2))
        marks.append(
            Upright(end, f"never: {100 * never / len(column):.3g} %", left=True)
        )
    for share, text in ((0.5, "median"), (0.95, "95 %")) if finite.size else ():
        at = float(np.quantile(finite, share))
        # Beside the bar for "never" there is no room for a second text: the line stays.
        marks.append(Upright(at, text if not (share > 0.9 and never) else ""))
    panel = Panel(
        f"{SHOWN[name]} [{unit}]",
        Scale(0.0, 1.15 * max(*heights, never, 1), ticks=()),
        marks,
        90.0,
    )
    said = f"Histogram of the {SHOWN[name]} of {len(column)} runs; {never} never settle or have none"
    return Figure(
        f"spread-{name}", said, Scale(low, end), (panel,), left=12.0, width=280.0
    )


def strongest(summary: Summary) -> tuple[str, str]:
    """The two parameters that the settling time depends on most."""
    drivers = next(
        metric for metric in summary.metrics if metric.name == "settling_time"
    ).drivers
    first, second = (name for name, _ in drivers[:2])
    return first, second


def failures_figure(
    across: Real, up: Real, failed: NDArray[np.bool_], names: tuple[str, str]
) -> Figure:
    """Share of runs that fail over two drawn parameters, whose axes `names` title."""
    # As many cells as hold 2 · 30 runs on the average, so that most of them may be
    # coloured: a share of 30 runs is known to ± 9 % at best (one standard error at one
    # half).
    cells = int(np.clip(np.sqrt(across.size / (2 * _FEWEST)), 3, _MOST_CELLS))
    runs, x, y = np.histogram2d(across, up, bins=cells)
    bad, _, _ = np.histogram2d(across[failed], up[failed], bins=(x, y))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(runs >= _FEWEST, 100.0 * bad / runs, np.nan)
    # histogram2d has its first parameter along the rows, a drawing across: hence the
    # transposition.
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
    panel = Panel(
        names[1], Scale(float(y[0]), float(y[-1])), [Cells(x, y, levels)], 260.0
    )
    said = f"Share of failing runs over two parameters; cells of fewer than {_FEWEST} runs are empty"
    xlabel = f"{names[0]}; cells of fewer than {_FEWEST} runs are empty"
    return Figure(
        "failures", said, Scale(float(x[0]), float(x[-1])), (panel,), xlabel, key=key
    )


def driver_rows(
    summary: Summary,
) -> tuple[tuple[str, ...], Sequence[tuple[str, tuple[tuple[str, int], ...]]]]:
    """Parameters, and for each metric its rank correlations as text with a level of
    colour.
    """
    # Saturation is a means, not an end: no requirement is stated for it.
    metrics = [m for m in summary.metrics if m.name != "saturated"]
    names = sorted({p for p, _ in metrics[0].drivers})
    rows = []
    for metric in metrics:
        known = dict(metric.drivers)
        cells = tuple(
            (
                _correlation(known[name]),
                int(np.digitize(abs(known[name]), (WEAK, 0.4, 0.7))),
            )
            for name in names
        )
        rows.append((metric.name.replace("_", " "), cells))
    return tuple(name.replace("_", " ") for name in names), rows


_HEAD, _LINE = 92.0, 24.0  # dots of the parameters' names over the table, and of a row


def drivers_figure(summary: Summary) -> str:
    """Draw Spearman's rank correlation of every metric with every parameter as a table
    in colours.
    """
    names, rows = driver_rows(summary)

    def table(frame: Frame) -> str:
        # Names are turned by 45° to fit over their columns, and the last of them needs
        # room to the right.
        parts, width = [], 0.94 / len(names)  # the last name leans over the right edge
        for column, name in enumerate(names):
            place = f'x="{percent((column + 0.5) * width)}" y="{frame.top + _HEAD - 8}"'
            text = f'<text transform="rotate(-45)">{escaped(name)}</text>'
            parts.append(f'<svg {place} overflow="visible">{text}</svg>')
        for row, (metric, cells) in enumerate(rows):
            y = frame.top + _HEAD + _LINE * row
            parts.append(
                f'<text class="name" x="-8" y="{y + 16}" text-anchor="end">{escaped(metric)}</text>'
            )
            for column, (text, level) in enumerate(cells):
                size = f'width="{percent(0.96 * width)}" height="{_LINE - 2}"'
                parts.append(
                    f'<rect class="l{level}" x="{percent(column * width)}" y="{y}" {size}/>'
                )
                place = f'x="{percent((column + 0.5) * width)}" y="{y + 15}" text-anchor="middle"'
                parts.append(f'<text class="on-l{level}" {place}>{text}</text>')
        return "".join(parts)

    panel = Panel("", Scale(0.0, 1.0, ticks=()), (), _HEAD + _LINE * len(rows), table)
    said = "Rank correlation of metrics with parameters"
    key = ("size of the correlation", "below 0.15", "to 0.4", "to 0.7", "above 0.7")
    return Figure(
        "drivers", said, Scale(0.0, 1.0, ticks=()), (panel,), left=170.0, key=key
    ).alone()


def _correlation(value: float) -> str:
    # Of 1000 runs a rank correlation of 0.05 is about 1.6 standard errors (1/√n):
    # noise, left blank.
    return f"{value:+.2f}".replace("-", "−") if abs(value) >= 0.05 else ""


# --- the map of faults: one row a fault, one cell for each severity and payload, worst first ---------------

_SIGNS = ("✓", "!", "✗", "✗")


@dataclass(frozen=True)
class Cell:
    """The runs of one severity and payload: level of colour 0 to 3 or -1 for none,
    sign, and words.
    """

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
    return sorted(
        {(outcome.case.severity, outcome.case.payload) for outcome in table.outcomes}
    )


def fault_columns(table: FaultTable) -> tuple[str, ...]:
    """What the cells of a row stand for, from left to right."""
    return tuple(
        f"severity {severity}, {grams(payload)}"
        for severity, payload in _columns(table)
    )


def fault_counts(table: FaultTable) -> list[tuple[str, int, int]]:
    """Each group with its level and how many faults are in it, the worst first."""
    found = Counter(row.group for row in table.rows())
    return [
        (group, level, found[group]) for level, group in reversed([*enumerate(GROUPS)])
    ]


def fault_rows(table: FaultTable) -> list[FaultRow]:
    """The rows of the map, the worst group first."""
    rows = []
    for row in sorted(
        table.rows(), key=lambda row: (-GROUPS.index(row.group), row.number)
    ):
        known = fault_named(row.number)
        mine = [
            outcome for outcome in table.outcomes if outcome.case.fault == row.number
        ]
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
    # A cell is as bad as its worst run; how many runs were so is said in words under
    # the pointer.
    level = max(GROUPS.index(outcome.group) for outcome in here)
    failed = sum(not outcome.passed for outcome in here)
    words = f"{where}: {GROUPS[level]}" + (
        f", {failed} of {len(here)} runs" if failed else ""
    )
    return Cell(level, _SIGNS[level], words)


# --- a tournament: one row a rival, one column a figure, a dot for what it reached -------------------------

# Attribute, title, factor, and the left end of a logarithmic scale: what is below
# counts as that.
_COLUMNS = (
    ("settling_time", "settling [s]", 1.0, 0.0),
    ("worst_settling", "worst payload [s]", 1.0, 0.0),
    ("residual_vibration", "vibration [mrad]", 1e3, 0.1),
    ("offset_error", "by offset [mrad]", 1e3, 0.001),
    ("motor_reference_noise", "noise [mrad]", 1e3, 0.1),
    ("mode_gain", "gain at mode 2", 1.0, 0.001),
)
_RIVAL, _NAMES, _WIDE = 24.0, 190.0, 128.0  # dots of a row, of the names, of a column
_END = 1.6  # of the largest value: room for its dot


def rivals_figure(result: Tournament) -> str:
    """Draw a dot for every rival and figure, in the order of the table; left is better
    throughout.
    """
    columns = []
    for column, (attribute, title, factor, left) in enumerate(_COLUMNS):
        values = [
            factor * float(getattr(standing, attribute))
            for standing in result.standings
        ]
        # Some rival may never settle: infinity has no place on a scale, and is said in
        # words.
        finite = [value for value in values if math.isfinite(value)] or [1.0]
        # From zero where values share a decade; a rival's vibration or noise may be a
        # thousand times another's.
        x = (
            Scale(left, _END * max(*finite, 10 * left), log=True)
            if left
            else Scale(0.0, 1.1 * max(finite))
        )
        rows = _rows(result.standings, values, x, names=not column)
        panel = Panel(title, Scale(0.0, 1.0, ticks=()), (), _RIVAL * len(values), rows)
        room = _NAMES if not column else 12.0
        width = room + _WIDE
        columns.append(
            Figure(attribute, title, x, (panel,), left=room, width=width, ticks=3)
        )
    return beside(columns, "What each rival reached in six figures; left is better")


def draw_rivals(result: Tournament, path: Path | str) -> None:
    """Write `rivals_figure` to an SVG file."""
    save_svg(rivals_figure(result), path)


def _rows(
    standings: tuple[Standing, ...], values: list[float], x: Scale, *, names: bool
) -> Callable[[Frame], str]:
    def draw(frame: Frame) -> str:
        parts = []
        for row, (standing, value) in enumerate(zip(standings, values, strict=True)):
            y = frame.top + _RIVAL * (row + 0.5)
            ours = standing.name.startswith("fraclink")
            parts.append(f'<line class="grid" x2="100%" y1="{y}" y2="{y}"/>')
            if names:
                style = "label" if ours else "name"
                text = standing.name + ("" if standing.sound else " ✗")
                parts.append(
                    f'<text class="{style}" x="-10" y="{y + 4}" text-anchor="end">{escaped(text)}</text>'
                )
            if not math.isfinite(value):
                parts.append(
                    f'<text class="name" x="100%" dx="-4" y="{y + 4}" text-anchor="end">never</text>'
                )
                continue
            at = frame.across(max(value, x.low))
            if standing.sound:
                parts.append(
                    f'<circle class="f{1 if ours else 2}" cx="{at}" cy="{y}" r="{6 if ours else 4.5}"/>'
                )
            else:  # unstable, or only held by friction or a limit: no figure counts
                cross = '<path class="c0 cross" d="M-4-4l8 8m0-8l-8 8"/>'
                parts.append(f'<svg x="{at}" y="{y}" overflow="visible">{cross}</svg>')
        return "".join(parts)

    return draw
