"""Figures as SVG text that stands inside a page and comes out the same, byte for byte, every time."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["BLUE", "FAINT", "GREEN", "GREY", "INK", "LEVELS", "ORANGE", "VIOLET", "figure", "svg"]

INK, GREY, FAINT = "#1f2430", "#7b8494", "#d9dde4"
BLUE, ORANGE, GREEN, VIOLET = "#1f5f99", "#c8572a", "#3b7d4f", "#76559b"
LEVELS = (BLUE, ORANGE, GREEN, VIOLET)  # distinguishable in every common colour blindness and in grey

_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same glyphs on every machine
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.3,
    "text.parse_math": False,  # a `$` in a file's name is a dollar, not a formula
    "svg.fonttype": "path",
    "svg.hashsalt": "fraclink",
    "path.simplify_threshold": 0.2,
}


@contextmanager
def figure(width: float, height: float) -> Iterator[Figure]:
    """Yield an empty figure of `width` × `height` inches in the report's style."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        yield Figure(figsize=(width, height), layout="constrained")


_PLACES = re.compile(r'\b(?:d|x|y|x1|x2|y1|y2|width|height|viewBox|points)="[^"]*"|\btranslate\([^)]*\)')


def _rounded(number: re.Match[str]) -> str:
    return f"{float(number.group()):.2f}".rstrip("0").rstrip(".")


def svg(drawing: Figure, name: str, description: str) -> str:
    """Return `drawing` as an inline SVG element whose ids begin with `name`.

    Several SVGs share one page, and matplotlib names its clip paths and glyphs alike in each of them.
    """
    import matplotlib
    from markupsafe import escape
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    stream = io.StringIO()
    with matplotlib.rc_context(_STYLE):
        FigureCanvasSVG(drawing).print_svg(stream, metadata={"Date": None, "Creator": None})  # type: ignore[no-untyped-call]
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    # matplotlib's ids are hashes of coordinates in all their digits, and the layout's solver does not find
    # the last one twice alike; numbers in the order of the page are the same every time.
    order = {old: f"{name}-{number}" for number, old in enumerate(re.findall(r'\bid="([^"]*)"', text))}
    text = re.sub(r'(\bid="|url\(#|href="#)([^")]*)', lambda at: at[1] + order[at[2]], text)
    # A hundredth of a point is a thirtieth of a screen's dot; more digits are half of the text, and they
    # differ in the last place between processors.
    text = _PLACES.sub(lambda place: re.sub(r"-?\d+\.\d{3,}", _rounded, place.group()), text)
    text = re.sub(r"\s*\n\s*", "\n", text)
    opening = f'<svg role="img" aria-label="{escape(description)}" '
    return opening + text[len("<svg") :].lstrip()
