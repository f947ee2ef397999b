"""Display of a result at a prompt and in a notebook: a line, its tables, and its
drawing if there is one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fraclink.errors import FieldError
from fraclink.view import _figures, _loops, _runs, _sketches
from fraclink.view import _text as texts
from fraclink.view._drawing import figure_of, save_svg

__all__ = ["draw", "drawing", "page_part", "text"]

# Importing these modules registers the drawings of all classes.
_DRAWINGS = (_figures, _loops, _runs, _sketches)


def text(result: Any) -> str:
    """Return the output of the command line for a result."""
    return texts.plain_text(texts.view(result))


def drawing(result: Any) -> str | None:
    """Return the drawing of a result as SVG, in the colours of both themes; None if it
    has none.
    """
    figure = figure_of(result)
    return figure if figure is None or isinstance(figure, str) else figure.alone()


def draw(result: Any, path: Path | str) -> None:
    """Write the drawing of a result to an SVG file, as a notebook shows it, in the
    colours of both themes.

    FieldError for a result without a drawing, and for a file of another kind.

    >>> import fraclink as fl, tempfile
    >>> place = Path(tempfile.mkdtemp()) / "arm.svg"
    >>> fl.view.draw(fl.Rig.named("paper-2023"), place)
    >>> place.read_text().startswith("<svg")
    True
    """
    svg = drawing(result)
    if svg is None:
        raise FieldError(
            "result",
            type(result).__name__,
            "without a drawing",
            ", ".join(
                sorted(
                    kind.__name__ for kind in figure_of.registry if kind is not object
                )
            ),
            "draw one of these",
        )
    save_svg(svg, path)


def page_part(result: Any) -> str:
    """Return a result as HTML: verdict, tables, notes, then its drawing."""
    part = texts.page_part(texts.view(result))
    return "\n".join([part, drawing(result) or ""]).strip()
