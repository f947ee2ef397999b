"""Figures that a verb writes: one set of axes to one file, the same bytes for the same numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from fraclink._files import atomic_write
from fraclink.errors import MissingExtraError

__all__ = ["save_axes"]


def save_axes(path: Path, draw: Callable[[Any], object], *, size: tuple[float, float] = (7.5, 5.0)) -> None:
    """Let `draw` fill one set of axes of `size` [inches] and write them as the suffix says (SVG without one).

    Raises MissingExtraError where matplotlib is not installed.
    """
    try:
        import matplotlib as mpl
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise MissingExtraError("matplotlib", "report") from error
    kind = path.suffix.lstrip(".").lower() or "svg"
    # Without a date and with ids that do not change a second run writes the same file.
    extra = {"metadata": {"Date": None}} if kind == "svg" else {"dpi": 110}
    with mpl.rc_context({"svg.hashsalt": "fraclink"}):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure.subplots())
        with atomic_write(path, "wb") as stream:
            figure.savefig(stream, format=kind, **extra)
