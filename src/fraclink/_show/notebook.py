"""What a prompt and a notebook show of each result: a line, its tables, and a drawing where one exists."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from typing import Any

from fraclink._show import figures, moves
from fraclink._show.text import looked_up, marked
from fraclink._show.views import view
from fraclink.errors import MissingExtraError

__all__ = ["drawing", "page_part", "short"]

_LONGEST = 110  # characters of a repr: a list of results stays readable

_DRAWINGS: dict[str, Callable[[Any], str]] = {
    "Experiment": figures.log_figure,
    "Fit": lambda fit: figures.models_figure({fit.structure: fit}),
    "Start": lambda started: figures.fit_figure(started.experiment, started.fit),
    "Comparison": lambda comparison: figures.models_figure(comparison.fits),
    "Design": figures.bode_figure,
    "StructureFit": figures.structure_figure,
    "DrivenLinkFit": lambda found: figures.structure_figure(found.fit),
    "Run": lambda run: figures.moves_figure([run]),
    "ShapedMove": moves.shaped_figure,
}


def short(result: Any) -> str:
    """Return the class and the headline of a result.

    >>> import fraclink as fl
    >>> short(fl.Experiment(period=0.004, motor_angle=[0, 0.1], output=[0, 0.01], source="a/log.csv"))
    'Experiment(log.csv)'
    """
    shown = view(result)
    text = " ".join(f"{marked(shown.state)}: {shown.headline}".removeprefix(": ").split())
    text = text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"
    return f"{type(result).__name__}({text})"


def drawing(result: Any) -> str | None:
    """Return the drawing of a result as SVG; None where it has none, or matplotlib is not installed."""
    if type(result).__name__ not in _DRAWINGS:
        return None
    try:
        text = looked_up(_DRAWINGS, result)(result)
    except MissingExtraError:
        return None
    # Cells share one page: the clip paths of one drawing must not be those of another.
    mark = hashlib.sha256(text.encode()).hexdigest()[:8]
    return re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{mark}-", text)


def page_part(result: Any) -> str:
    """Return a result as HTML: verdict, tables, notes, then its drawing."""
    return "\n".join([view(result)._repr_html_(), drawing(result) or ""]).strip()
