"""What a prompt and a notebook show of each result: a line, its tables, and a drawing
where one exists.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from fraclink.errors import FieldError
from fraclink.view import _figures as figures
from fraclink.view import _fleets as fleets
from fraclink.view import _loops as loops
from fraclink.view import _runs as runs
from fraclink.view._drawing import Figure, save_svg
from fraclink.view._sketches import arm_sketch
from fraclink.view._text import looked_up, marked
from fraclink.view._views import view
from fraclink.view._words import sketch_notes

__all__ = ["draw", "drawing", "page_part", "short"]

_LONGEST = 110  # characters of a repr: a list of results stays readable

_DRAWINGS: dict[str, Callable[[Any], Figure | str]] = {
    "Experiment": figures.log_figure,
    "Fit": figures.detail_figure,
    "Start": lambda started: figures.fit_figure(started.experiment, started.fit),
    "Comparison": lambda found: figures.models_figure(found.fits, found.preferred),
    "Design": loops.bode_figure,
    "PidTuning": loops.pid_figure,
    "StructureFit": figures.structure_figure,
    "Validation": figures.validation_figure,
    "DrivenLinkFit": lambda found: figures.structure_figure(found.fit),
    "FeasibilityMap": loops.map_figure,
    "Rig": lambda rig: arm_sketch(sketch_notes(rig, rig.model)),
    "Summary": fleets.drivers_figure,
    "Tournament": fleets.rivals_figure,
    "Run": lambda run: runs.moves_figure([run]),
    "ShapedMove": runs.shaped_figure,
}


def short(result: Any) -> str:
    """Return the class and the headline of a result.

    >>> import fraclink as fl
    >>> short(fl.Experiment(period=0.004, motor_angle=[0, 0.1], output=[0, 0.01], source="a/log.csv"))
    'Experiment(log.csv)'
    """
    shown = view(result)
    # Headlines may have several lines, as a tournament's; a repr is one.
    text = " ".join(
        f"{marked(shown.state)}: {shown.headline}".removeprefix(": ").split()
    )
    text = text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"
    return f"{type(result).__name__}({text})"


def drawing(result: Any) -> str | None:
    """Return the drawing of a result as SVG, in the colours of both themes; None where
    it has none.
    """
    # By the class itself and not by its bases: a subclass that has no drawing of its
    # own is not drawn as something else.
    if type(result).__name__ not in _DRAWINGS:
        return None
    drawn: Figure | str = looked_up(_DRAWINGS, result)(result)
    return drawn if isinstance(drawn, str) else drawn.alone()


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
    drawn = drawing(result)
    if drawn is None:
        allowed, given = ", ".join(sorted(_DRAWINGS)), type(result).__name__
        raise FieldError(
            "result",
            given,
            "without a drawing",
            allowed=allowed,
            remedy="draw one of these",
        )
    save_svg(drawn, path)


def page_part(result: Any) -> str:
    """Return a result as HTML: verdict, tables, notes, then its drawing."""
    return "\n".join([view(result)._repr_html_(), drawing(result) or ""]).strip()
