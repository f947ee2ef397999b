"""Figures of matplotlib in the colours of the report, as SVG that is identical on every
run.
"""

from __future__ import annotations

import html
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from fraclink.view._pages import LINES, colours

__all__ = ["BLUE", "FAINT", "GREY", "INK", "LEVELS", "ORANGE", "figure", "svg"]

_LIGHT = colours()
INK, GREY, FAINT = _LIGHT["ink"], _LIGHT["quiet"], _LIGHT["rule"]
LEVELS = BLUE, ORANGE, *_ = tuple(_LIGHT[f"line-{line}"] for line in LINES)

_STYLE: dict[Any, Any] = {
    # comes with matplotlib: the same glyphs on every machine
    "font.family": "DejaVu Sans",
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
    "text.parse_math": False,  # a `$` in a file name is a dollar sign, not a formula
    "svg.fonttype": "path",
    "svg.hashsalt": "fraclink",
    "path.simplify_threshold": 0.2,
}


@contextmanager
def figure(width: float, height: float) -> Iterator[Figure]:
    """Yield an empty figure of `width` × `height` inches in the report's style."""
    # The layout is solved when the figure is drawn, and `svg` draws it in the same
    # style.
    with matplotlib.rc_context(_STYLE):
        yield Figure(figsize=(width, height), layout="constrained")


_PLACES = re.compile(
    r'\b(?:d|x|y|x1|x2|y1|y2|width|height|viewBox|points)="[^"]*"|\btranslate\([^)]*\)'
)


def _rounded(number: re.Match[str]) -> str:
    return f"{float(number.group()):.2f}".rstrip("0").rstrip(".")


def svg(drawing: Figure, name: str, description: str) -> str:
    """Return `drawing` as an inline SVG element whose ids begin with `name`.

    Several SVGs share one page, and matplotlib names its clip paths and glyphs alike in
    each of them.
    """
    stream = io.StringIO()
    with matplotlib.rc_context(_STYLE):
        canvas: Any = FigureCanvasSVG(drawing)
        canvas.print_svg(stream, metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    # The ids of matplotlib are hashes of coordinates with all digits, the last of which
    # is not reproducible after the layout's solver. Numbers in order of appearance are.
    order = {
        old: f"{name}-{number}"
        for number, old in enumerate(re.findall(r'\bid="([^"]*)"', text))
    }
    text = re.sub(
        r'(\bid="|url\(#|href="#)([^")]*)', lambda at: at[1] + order[at[2]], text
    )
    # A hundredth of a point is a thirtieth of a pixel. More digits would be half of the
    # text, and they differ in the last place between processors.
    text = _PLACES.sub(
        lambda place: re.sub(r"-?\d+\.\d{3,}", _rounded, place.group()), text
    )
    text = re.sub(r"\s*\n\s*", "\n", text)
    opening = f'<svg role="img" aria-label="{html.escape(description)}" '
    return opening + text[len("<svg") :].strip()
