"""What the command line prints, and where.

Results go to standard output, everything else to standard error, so that a pipe carries results only.
Names that come from files are stripped of terminal escapes before they are printed: a log's column
called ``\\x1b]0;...`` must not retitle, recolour or rewrite anybody's terminal.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Protocol

__all__ = ["Step", "clean", "emit", "emit_json", "steps", "table", "tell"]


def clean(text: object) -> str:
    """Return `text` with everything a terminal would obey written out.

    >>> clean("a\\x1b[31mb\\u202ec")
    'a\\\\x1b[31mb\\\\u202ec'
    """
    return "".join(_visible(character) for character in str(text))


def _visible(character: str) -> str:
    if character.isprintable() or character == "\n":
        return character
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


def emit(text: str) -> None:
    """Print a result on standard output."""
    sys.stdout.write(clean(text) + "\n")


def emit_json(value: Mapping[str, object]) -> None:
    """Print a result for machines: one JSON object, numbers that read back exactly."""
    sys.stdout.write(json.dumps(value, allow_nan=False, ensure_ascii=True) + "\n")


def tell(text: str) -> None:
    """Print a remark on standard error."""
    sys.stderr.write(clean(text) + "\n")


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a plain table: first column flush left, the others flush right.

    >>> print(table(["payload", "margin"], [["20 g", "48.8°"], ["8 g", "23.9°"]]))
    payload  margin
    20 g      48.8°
    8 g       23.9°
    """
    cells = [list(map(str, row)) for row in (header, *rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(header))]
    lines = (
        "  ".join(
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in cells
    )
    return "\n".join(line.rstrip() for line in lines)


class Step(Protocol):
    """Tells the user which part of the work begins."""

    def __call__(self, name: str) -> None:
        """Begin the part called `name`."""


@contextmanager
def steps(total: int) -> Iterator[Step]:
    """Show progress over `total` parts on standard error; silent where that is not a terminal."""
    if not sys.stderr.isatty():
        yield lambda name: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("", total=total + 1)

        def begin(name: str) -> None:
            progress.update(task, description=clean(name), advance=1)

        yield begin
