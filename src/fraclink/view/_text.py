"""An overview as text, HTML and JSON, for terminals, notebooks and programs."""

from __future__ import annotations

import html
import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fraclink._display import Overview, Row, Table, marked, number
from fraclink.findings import Finding

__all__ = [
    "Grid",
    "finding_line",
    "folded",
    "grams",
    "grams_between",
    "grid_of",
    "options_text",
    "page_part",
    "plain",
    "plain_text",
    "sentence",
    "to_json",
    "view",
]

Cells = tuple[str, ...]


def grams(payload: float | None) -> str:
    """A payload in grams.

    >>> grams(0.0305)
    '30.5 g'
    """
    return "–" if payload is None else f"{number(1e3 * payload)} g"


def grams_between(low: float, high: float) -> str:
    """A range of payloads in grams.

    >>> grams_between(0.02, 0.0405)
    '20 to 40.5 g'
    """
    return f"{number(1e3 * low)} to {grams(high)}"


def options_text(arguments: Mapping[str, Any]) -> str:
    """Keyword arguments as command-line options, with all significant digits.

    >>> options_text({"payloads": (0.02, 0.04), "phase_margin": math.radians(50.0), "box": False})
    '--payloads 0.02 0.04 --no-box --phase-margin-deg 50'
    """
    options = dict(arguments)
    if "phase_margin" in options:
        options["phase_margin_deg"] = math.degrees(options.pop("phase_margin"))
    words = []
    for name, value in options.items():
        words.append(f"--{'no-' if value is False else ''}{name.replace('_', '-')}")
        if not isinstance(value, bool):  # a flag has no word after it
            # Eight digits: with fewer, a request at its bound would be infeasible.
            words += [f"{figure:.8g}" for figure in np.atleast_1d(value)]
    return " ".join(words)


def sentence(text: str) -> str:
    """`text` with an initial capital and a full stop; field names keep their spelling.

    >>> sentence("measure it"), sentence("link.stiffness = 1.56 contradicts 3EI/L")
    ('Measure it.', 'link.stiffness = 1.56 contradicts 3EI/L.')
    """
    text = text.strip()
    first = text.partition(" ")[0]
    # Users type fields such as link.stiffness: a capital would make it another name.
    is_name = "_" in first or "." in first.rstrip(".") or first == "fraclink"
    complete = text.endswith((".", "?", "!", ":")) or not text
    return (
        (text[:1] if is_name else text[:1].upper())
        + text[1:]
        + ("" if complete else ".")
    )


# --- from figures to texts ---------------------------------------------------------------


@dataclass(frozen=True)
class Grid:
    """A table as texts; `words` marks the columns with words instead of figures."""

    header: Cells
    lines: tuple[Cells, ...]
    words: tuple[bool, ...]


def grid_of(figures: Table | Sequence[Row]) -> Grid:
    """Return a table as texts: one line per record, or per given row."""
    if not isinstance(figures, Table):
        entries = (row for row in figures if row.label and row.value is not None)
        lines = tuple((row.label, marked(row.text)) for row in entries)
        return Grid(("", ""), lines, (True, True))
    columns = [
        column
        for column in zip(*figures.records, strict=True)
        if any(row.label for row in column)
    ]
    # If every column has a single unit, it is in the header; requirements have
    # different units.
    alike = all(len({row.unit for row in column}) == 1 for column in columns)
    header = [column[0].heading if alike else column[0].label for column in columns]
    texts = [
        [marked(row.cell if alike else row.text) for row in column]
        for column in columns
    ]
    words = tuple(
        all(isinstance(row.value, str | bool) for row in column) for column in columns
    )
    return Grid(tuple(header), tuple(zip(*texts, strict=True)), words)


def grids(overview: Overview) -> list[Grid]:
    """All non-empty tables of an overview."""
    tables = [grid_of(overview.rows), *map(grid_of, overview.tables)]
    return [grid for grid in tables if grid.lines]


def finding_line(finding: Finding) -> str:
    """A finding in one line; the numbers of an info finding, which would fill two more
    lines, are only in the JSON.
    """
    return str(finding if finding.severity != "info" else replace(finding, evidence={}))


def view(result: Any) -> Overview:
    """Return the overview of a result; an overview is returned as it is."""
    return result if isinstance(result, Overview) else result.overview()


def doubted(overview: Overview, findings: tuple[Finding, ...]) -> Overview:
    """`overview`, preceded by the errors of its input, with which it cannot pass."""
    if not findings:
        return overview
    failed = overview.state == "failed"
    headline = "" if failed else "the log or the model is doubtful; "
    return replace(
        overview,
        headline=headline + overview.headline,
        findings=(*findings, *overview.findings),
        state="failed" if failed else "not shown",
    )


def notes(overview: Overview) -> list[str]:
    """Findings that require action, and notes; infos are only in the report and in the
    JSON, unless there is nothing but findings.
    """
    alone = not overview.rows and not overview.tables
    findings = (f for f in overview.findings if alone or f.severity != "info")
    return [*map(finding_line, findings), *overview.notes]


# --- for programs ------------------------------------------------------------------------


def plain(value: Any) -> Any:
    """Return `value` in the form of JSON: results by their figures, other dataclasses
    by their fields.

    >>> plain({"gain": np.float64(1.5), "limit": math.inf, "payloads": (0.02, 0.04)})
    {'gain': 1.5, 'limit': None, 'payloads': [0.02, 0.04]}
    """
    if isinstance(value, float | np.floating):
        # JSON has neither infinity nor NaN; Python's writer would put words there that
        # no other parser reads.
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray | np.generic):
        # JSON does not accept numpy's scalars; bool and str of numpy become Python's
        # own.
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "overview"):
        return to_json(value)
    if hasattr(value, "rows"):
        return _object(value.rows)
    if is_dataclass(value):
        return {item.name: plain(getattr(value, item.name)) for item in fields(value)}
    return str(value) if isinstance(value, Path) else value


def _object(rows: Sequence[Row]) -> dict[str, Any]:
    """The figures by their keys; a dot in a key denotes a nested object."""
    values: dict[str, Any] = {}
    for row in rows:
        *outer, name = row.key.split(".")
        place = values
        for part in outer:
            place = place.setdefault(part, {})
        if name:
            place[name] = plain(row.value)
            if row.error is not None:
                values.setdefault("standard_errors", {})[name] = plain(row.error)
    return values


def to_json(result: Any) -> dict[str, Any]:
    """Return a result for programs: plain values in SI units and radians, null if not
    finite.
    """
    overview = view(result)
    verdict = {"passed": overview.state == "passed", "state": overview.state}
    values = verdict if overview.state else {}
    values |= _object(overview.rows)
    for table in overview.tables:
        if table.key:
            values[table.key] = [_object(record) for record in table.records]
    return values | {"findings": [plain(finding) for finding in overview.findings]}


# --- for a notebook ----------------------------------------------------------------------


def page_part(overview: Overview) -> str:
    """Return an overview as HTML: verdict, tables, notes."""
    verdict = html.escape(marked(overview.state)), html.escape(overview.headline)
    parts = ["<p><b>{}</b> {}</p>".format(*verdict)]
    for grid in grids(overview):
        head = [("th", grid.header)] if any(grid.header) else []
        lines = [*head, *(("td", row) for row in grid.lines)]
        cells = (
            "".join(f"<{t}>{html.escape(c)}</{t}>" for c in row) for t, row in lines
        )
        body = "".join(f"<tr>{row}</tr>" for row in cells)
        parts.append(f"<table>{body}</table>")
    return "\n".join(
        [*parts, *(f"<p>{html.escape(note)}</p>" for note in notes(overview))]
    )


# --- for a terminal ----------------------------------------------------------------------


def plain_text(overview: Overview, width: int = 80) -> str:
    """Return an overview as lines of at most `width` columns, broken between words."""
    # The verdict first: it is read first, and a pipe into `head` keeps it.
    lead = ": ".join(filter(None, (marked(overview.state), overview.headline)))
    parts = [folded(lead, width)] if lead else []
    parts += [table_text(grid, width) for grid in grids(overview)]
    remarks = "\n".join(folded(note, width) for note in notes(overview))
    return "\n\n".join([*parts, *([remarks] if remarks else [])])


def folded(text: str, width: int) -> str:
    """`text` with every line broken between words and continued two columns further
    in; paths stay whole.
    """
    return "\n".join(
        textwrap.fill(
            line,
            width,
            subsequent_indent=" " * (len(line) - len(line.lstrip()) + 2),
            break_long_words=False,
            break_on_hyphens=False,
        )
        for line in text.splitlines()
    )


def table_text(grid: Grid, width: int = 80) -> str:
    """A table as text: words flush left, figures right; headers and sentences wrap
    between words.

    >>> grid = Grid(("payload", "phase margin [°]"), (("20 g", "48.8"), ("8 g", "23.9")), (True, False))
    >>> print(table_text(grid, 16))
              phase
             margin
    payload     [°]
    20 g       48.8
    8 g        23.9
    """
    # The no-break space between a value and its error, meant for pages, would show as
    # an escape in a terminal.
    rows = [
        tuple(cell.replace("\N{NO-BREAK SPACE}", " ") for cell in row)
        for row in grid.lines
    ]
    # A header folds into three lines at most, and never within a word.
    least = [
        max(-(-len(head) // 3), *map(len, head.split() or [""])) for head in grid.header
    ]
    widths = [max(head, *(len(row[k]) for row in rows)) for k, head in enumerate(least)]
    spare = width - sum(widths) - 2 * (len(widths) - 1)
    if spare < 0:
        # The widest column, usually of sentences, folds first, down to 24 letters,
        # three or four words per line.
        widest = max(range(len(widths)), key=widths.__getitem__)
        widths[widest] = min(widths[widest], max(24, widths[widest] + spare))
        fitting = sum(
            sum(widths[:k]) + 2 * (k - 1) <= width for k in range(1, len(widths) + 1)
        )
        if 1 < fitting < len(widths):
            # Still too wide: the columns that do not fit are printed below, again after
            # the first column.
            above = _columns(grid, range(fitting))
            below = _columns(grid, (0, *range(fitting, len(widths))))
            return f"{table_text(above, width)}\n\n{table_text(below, width)}"
    for k, head in enumerate(grid.header):
        # With enough room a header need not fold.
        more = len(head) - widths[k]
        if 0 < more <= spare:
            widths[k], spare = len(head), spare - more
    lines = [_folded_row(row, widths, grid.words) for row in rows]
    if any(grid.header):
        lines.insert(0, _folded_row(grid.header, widths, grid.words, bottom=True))
    return "\n".join(lines)


def _columns(grid: Grid, columns: Iterable[int]) -> Grid:
    """The given columns of a table."""
    places = tuple(columns)

    def cut(cells: Cells) -> Cells:
        return tuple(cells[k] for k in places)

    words = tuple(grid.words[k] for k in places)
    return Grid(cut(grid.header), tuple(map(cut, grid.lines)), words)


def _folded_row(
    row: Cells, widths: Sequence[int], words: Sequence[bool], *, bottom: bool = False
) -> str:
    """The lines of a row, with shorter cells aligned at the top or at the bottom."""
    cells = [
        textwrap.wrap(cell, size, break_long_words=False, break_on_hyphens=False)
        for cell, size in zip(row, widths, strict=True)
    ]
    height = max(1, *map(len, cells))
    lines = []
    for k in range(height):
        first = [k - (height - len(cell) if bottom else 0) for cell in cells]
        parts = [
            (cell[at] if 0 <= at < len(cell) else "").ljust(size)
            if is_word
            else (cell[at] if 0 <= at < len(cell) else "").rjust(size)
            for cell, at, size, is_word in zip(cells, first, widths, words, strict=True)
        ]
        lines.append("  ".join(parts).rstrip())
    return "\n".join(lines)
