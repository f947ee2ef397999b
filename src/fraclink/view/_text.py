"""Numbers, tables and views as text: what every result is shown with, whatever it is."""

from __future__ import annotations

import html
import math
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from fraclink.findings import Finding

__all__ = ["Table", "View", "finding_line", "marked", "plain_text"]

Row = tuple[str, ...]


# --- numbers as people read them: few digits, a real minus, powers of ten ---------------------------------

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float | None, digits: int = 4) -> str:
    """Return `value` with `digits` significant digits.

    >>> number(-0.00068712), number(13399.771, 8), number(float("inf")), number(None)
    ('−6.871×10⁻⁴', '13399.771', '∞', '–')
    """
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    # of −0.0 the sum is 0.0: nobody reads a sign of nothing
    text = f"{value + 0.0:.{digits}g}"
    mantissa, _, exponent = text.partition("e")
    # Python turns to powers of ten only below 1e-4; 0.0006871 and 0.006871 in one
    # column are misread.
    if 0 < abs(value) < 1e-3 and not exponent:
        mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    mantissa = mantissa.replace("-", "−")
    if not exponent:
        return mantissa
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return f"{mantissa}×10{str(int(exponent)).translate(_RAISED)}"


def uncertain(value: float, error: float | None) -> str:
    """Return `value ± error`, both with the digits that the error leaves meaningful.

    >>> uncertain(1.918734, 0.000213), uncertain(10.02, None), uncertain(116.0, 145.0)
    ('1.91873 ± 0.00021', '10.02', 'undetermined')
    """
    if error is None or not math.isfinite(error) or error <= 0:
        return number(value, 5)
    # Digits of a value that may as well have the other sign would be read as knowledge.
    if error >= abs(value):
        return "undetermined"
    # Two digits of the error: one would round 0.14 to 0.1, three claim what no
    # covariance knows.
    places = max(0, 1 - math.floor(math.log10(error)))
    if places > 9 or abs(value) >= 1e6:
        return f"{number(value, 5)} ± {number(error, 2)}"
    return f"{_fixed(value, places)} ± {_fixed(error, places)}"


def grams(payload: float | None) -> str:
    """A payload in grams.

    >>> grams(0.0305)
    '30.5 g'
    """
    return "–" if payload is None else f"{number(1e3 * payload)} g"


def milli(value: float | None, places: int = 1) -> str:
    """A value in thousandths, with as many decimal places as matter beside its
    neighbours in a column.

    >>> milli(0.0633), milli(-0.0000519, 2), milli(-1e-9, 2)
    ('63.3', '−0.05', '0.00')
    """
    if value is None or not math.isfinite(value):
        return "–"
    return _fixed(1e3 * value, places)


def _fixed(value: float, places: int) -> str:
    """A value with a fixed number of places; what rounds to nothing has no sign."""
    text = f"{value:.{places}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−")


def degrees(angle: float | None, places: int = 1) -> str:
    """An angle in degrees.

    >>> degrees(math.pi / 6), degrees(-1e-5)
    ('30.0°', '0.0°')
    """
    if angle is None or math.isnan(angle):
        return "–"
    return f"{_fixed(math.degrees(angle), places)}°"


def quantity(value: float | None, unit: str) -> str:
    """A value with its unit; angles in degrees.

    >>> quantity(12.0, "rad/s"), quantity(math.pi / 4, "rad")
    ('12 rad/s', '45.0°')
    """
    return degrees(value) if unit == "rad" else f"{number(value)} {unit}".strip()


def option(name: str, value: float) -> str:
    """A keyword argument as the option that stands for it, with every digit that
    decides.

    >>> option("phase_margin", math.radians(50.0)), option("gain_crossover", 12.346)
    ('--phase-margin-deg 50', '--gain-crossover 12.346')
    """
    word = f"--{name.replace('_', '-')}"
    shown, word = (
        (math.degrees(value), f"{word}-deg")
        if name == "phase_margin"
        else (value, word)
    )
    # Eight digits: a request on its bound would be infeasible with fewer.
    return f"{word} {shown:.8g}"


def sentence(text: str) -> str:
    """`text` with a capital and a full stop; the name of a field keeps its spelling.

    >>> sentence("measure it"), sentence("link.stiffness = 1.56 contradicts 3EI/L")
    ('Measure it.', 'link.stiffness = 1.56 contradicts 3EI/L.')
    """
    text = text.strip()
    first = text.partition(" ")[0]
    # Fields such as link.stiffness are what the user types: a capital would make
    # another name of them.
    named = "_" in first or "." in first.rstrip(".") or first == "fraclink"
    ended = text.endswith((".", "?", "!", ":")) or not text
    return (text[:1] if named else text[:1].upper()) + text[1:] + ("" if ended else ".")


# --- tables and views -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Table:
    """Header and rows of text; the last column is a word of a verdict where `judged`."""

    header: Row
    rows: tuple[Row, ...]
    judged: bool = False

    @property
    def shown(self) -> tuple[Row, ...]:
        """The rows as people read them: the word of a verdict behind its sign."""
        return (
            tuple((*row[:-1], marked(row[-1])) for row in self.rows)
            if self.judged
            else self.rows
        )


def finding_line(finding: Finding) -> str:
    """A finding in a line; the numbers behind a remark, which fill two lines more, are
    left to the JSON.
    """
    return str(finding if finding.severity != "info" else replace(finding, evidence={}))


@dataclass(frozen=True)
class View:
    """What people read of a result: verdict first, tables, then notes; `state` is the
    word of the verdict.
    """

    headline: str = ""
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()
    state: str = ""

    def __str__(self) -> str:
        return plain_text(self)

    def doubted(self, findings: tuple[Finding, ...]) -> View:
        """The same with errors of the input, which stand first: nothing is shown by
        this result.
        """
        if not findings:
            return self
        notes = (*map(finding_line, findings), *self.notes)
        return replace(
            self,
            headline=f"the input is in doubt; {self.headline}",
            notes=notes,
            state="not shown",
        )

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        parts = [
            f"<p><b>{html.escape(marked(self.state))}</b> {html.escape(self.headline)}</p>"
        ]
        for table in self.tables:
            lines = [("th", table.header), *(("td", row) for row in table.shown)]
            cells = (
                "".join(f"<{t}>{html.escape(c)}</{t}>" for c in row) for t, row in lines
            )
            parts.append(
                "<table>" + "".join(f"<tr>{row}</tr>" for row in cells) + "</table>"
            )
        return "\n".join(
            [*parts, *(f"<p>{html.escape(note)}</p>" for note in self.notes)]
        )


_MARKS = {
    "passed": "✓",
    "failed": "✗",
    "missed": "✗",
    "not shown": "!",
    "missing": "!",
    "not run": "–",
    "outdated": "⟳",
}


def marked(state: str) -> str:
    """A verdict's word behind its sign, which is there without colours, too.

    >>> marked("passed"), marked("failed"), marked("")
    ('✓ passed', '✗ failed', '')
    """
    return f"{_MARKS[state]} {state}" if state in _MARKS else state


def plain_text(shown: View, width: int = 80) -> str:
    """Return `shown` as lines of at most `width` columns, broken between words."""
    lead = (
        f"{marked(shown.state)}: "
        if shown.state and shown.headline
        else marked(shown.state)
    )
    # The verdict first: it is what a person reads at all, and what a pipe into `head`
    # keeps.
    parts = (
        [folded(lead + shown.headline, width)] if shown.headline or shown.state else []
    )
    parts += [table_text(table, width) for table in shown.tables if table.rows]
    notes = "\n".join(folded(note, width) for note in shown.notes)
    return "\n\n".join([*parts, *([notes] if notes else [])])


def folded(text: str, width: int) -> str:
    """Every line of `text` broken between words, then indented by two columns more;
    paths stay whole.
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


def table_text(table: Table, width: int = 80) -> str:
    """A table of text: first column flush left, others right; heads and sentences wrap
    at words.

    >>> print(table_text(Table(("payload", "phase margin [°]"), (("20 g", "48.8"), ("8 g", "23.9"))), 16))
              phase
             margin
    payload     [°]
    20 g       48.8
    8 g        23.9
    """
    # What keeps a value and its error together on a page only shows as an escape in a
    # terminal.
    rows = [
        tuple(cell.replace("\N{NO-BREAK SPACE}", " ") for cell in row)
        for row in table.shown
    ]
    # A head folds into three lines at most, and never within a word.
    words = [
        max(-(-len(head) // 3), *map(len, head.split() or [""]))
        for head in table.header
    ]
    widths = [max(word, *(len(row[k]) for row in rows)) for k, word in enumerate(words)]
    spare = width - sum(widths) - 2 * (len(widths) - 1)
    # The order in which room is found: sentences fold, then columns move below, and
    # only heads and paths overrun.
    if spare < 0:
        # Sentences give way: the widest column folds, as far as a line of it can still
        # be read.
        widest = max(range(len(widths)), key=widths.__getitem__)
        # 24 letters hold three or four words: below that a sentence becomes a column of
        # single ones.
        widths[widest] = max(24, widths[widest] + spare)
        fitting = [
            sum(widths[:k]) + 2 * (k - 1) <= width for k in range(1, len(widths) + 1)
        ]
        if not fitting[-1] and len(widths) > 2:
            # Still too wide: the columns that do not fit stand below, behind the first
            # one again.
            k = max(2, sum(fitting))
            above = Table(table.header[:k], tuple(row[:k] for row in table.rows))
            rest = tuple((row[0], *row[k:]) for row in table.rows)
            below = Table((table.header[0], *table.header[k:]), rest, table.judged)
            return f"{table_text(above, width)}\n\n{table_text(below, width)}"
    # Heads need not fold where there is room: from left to right each takes what it
    # needs.
    for k, head in enumerate(table.header):
        more = (
            min(max(spare, 0), max(0, len(head) - widths[k]))
            if spare >= len(head) - widths[k]
            else 0
        )
        widths[k], spare = widths[k] + more, spare - more
    # Numbers flush right, so that their digits stand below one another; words flush
    # left.
    last = len(widths) - 1
    left = [
        k == 0 or (k == last and table.judged) or _wordy(rows, k)
        for k in range(len(widths))
    ]
    lines = _folded_row(table.header, widths, left, bottom=True)
    for row in rows:
        lines += _folded_row(row, widths, left, bottom=False)
    return "\n".join(lines)


def _wordy(rows: Sequence[Row], column: int) -> bool:
    return any(re.search(r"[^\W\d_]{4,} [^\W\d_]{2,}", row[column]) for row in rows)


def _folded_row(
    row: Row, widths: list[int], left: list[bool], *, bottom: bool
) -> list[str]:
    cells = [
        textwrap.wrap(cell, size, break_long_words=False, break_on_hyphens=False)
        or [""]
        for cell, size in zip(row, widths, strict=True)
    ]
    height = max(map(len, cells))
    padded = [
        [""] * (height - len(cell)) + cell
        if bottom
        else cell + [""] * (height - len(cell))
        for cell in cells
    ]
    return [
        "  ".join(
            part.ljust(size) if flush else part.rjust(size)
            for part, size, flush in zip(line, widths, left, strict=True)
        ).rstrip()
        for line in zip(*padded, strict=True)
    ]


def looked_up(
    by_class: Mapping[str, Callable[[Any], Any]], result: Any
) -> Callable[[Any], Any]:
    """The entry of a result's class, or of the nearest class above it that has one."""
    # By name, as importing the classes would load every package to show one result; by
    # the bases too, so that a user's subclass of a result is shown as that result.
    return next(
        by_class[kind.__name__]
        for kind in type(result).__mro__
        if kind.__name__ in by_class
    )
