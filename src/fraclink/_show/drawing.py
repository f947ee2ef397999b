"""How fraclink draws: one palette, one style of axes, SVG that comes out the same byte for byte."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fraclink._files import atomic_write
from fraclink.errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["BLUE", "FAINT", "FULL_WIDTH", "GREEN", "GREY", "INK", "LEVELS", "LINES", "ORANGE", "VIOLET"]
__all__ += ["envelope", "figure", "load_matplotlib", "save_figure", "svg"]

INK, GREY, FAINT = "#1f2430", "#7b8494", "#d9dde4"
# Okabe and Ito (2008): distinct with every common colour blindness. In grey print, and where curves lie on
# one another, the dashes tell them apart.
BLUE, ORANGE, GREEN, VIOLET = "#0072b2", "#d55e00", "#009e73", "#cc79a7"
LEVELS = (BLUE, ORANGE, GREEN, VIOLET)
LINES: tuple[dict[str, Any], ...] = tuple(
    {"color": color, "linestyle": style}
    for color, style in zip(LEVELS, ("-", (0, (6, 2)), (0, (2, 1.5)), (0, (6, 2, 1, 2))), strict=True)
)
FAILED = "#a8321f"


def load_matplotlib() -> Any:
    """Return matplotlib with the parts that draw without a display; it takes a third of a second to import.

    Raises MissingExtraError where it is not installed.
    """
    try:
        import matplotlib.backends.backend_agg
        import matplotlib.backends.backend_svg
        import matplotlib.figure
        import matplotlib.ticker
    except ModuleNotFoundError as error:
        raise MissingExtraError("matplotlib", "report") from error
    return matplotlib


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
    mpl = load_matplotlib()
    with mpl.rc_context(_STYLE):
        yield mpl.figure.Figure(figsize=(width, height), layout="constrained")


_PLACES = re.compile(r'\b(?:d|x|y|x1|x2|y1|y2|width|height|viewBox|points)="[^"]*"|\btranslate\([^)]*\)')


def _rounded(number: re.Match[str]) -> str:
    return f"{float(number.group()):.2f}".rstrip("0").rstrip(".")


def svg(drawing: Figure, name: str, description: str) -> str:
    """Return `drawing` as an inline SVG element whose ids begin with `name`.

    Several SVGs share one page, and matplotlib names its clip paths and glyphs alike in each of them.
    """
    stream, mpl = io.StringIO(), load_matplotlib()
    with mpl.rc_context(_STYLE):
        canvas = mpl.backends.backend_svg.FigureCanvasSVG(drawing)
        canvas.print_svg(stream, metadata={"Date": None, "Creator": None})
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
    opening = f'<svg role="img" aria-label="{html.escape(description)}" '
    return opening + text[len("<svg") :].strip()


FULL_WIDTH = 8.6  # inches: the text's width on the page at 96 dots an inch
_POINTS = 900  # twice this many points for a line; the page shows about 800 dots

Real = NDArray[np.float64]


def envelope(time: NDArray[Any], values: NDArray[Any], points: int = _POINTS) -> tuple[Real, Real]:
    """Return a record thinned to its smallest and largest value in each of `points` stretches.

    No peak is lost, and 100 000 samples draw as fast as 2 000.

    >>> t, y = envelope(np.arange(10_000.0), np.sin(np.arange(10_000.0)), 50)
    >>> len(t), bool(y.max() > 0.999)
    (100, True)
    """
    count = len(values)
    if count <= 2 * points:
        return time, values
    edges = np.linspace(0, count, points + 1).astype(int)[:-1]
    low, high = np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)
    rising = values[edges] <= (low + high) / 2
    first, second = np.where(rising, low, high), np.where(rising, high, low)
    middle = np.append(edges[1:], count)
    half = (edges + middle) // 2
    return np.column_stack([time[edges], time[half]]).ravel(), np.column_stack([first, second]).ravel()


def save_figure(
    path: Path | str, draw: Callable[[Figure], object], *, size: tuple[float, float] = (7.5, 5.0)
) -> None:
    """Let `draw` fill a figure of `size` [inches] and write it as the suffix says (SVG without one).

    Raises MissingExtraError where matplotlib is not installed.
    """
    mpl = load_matplotlib()
    kind = Path(path).suffix.lstrip(".").lower() or "svg"
    # Without a date and with ids that do not change a second run writes the same file.
    extra = {"metadata": {"Date": None}} if kind == "svg" else {"dpi": 110}
    with mpl.rc_context({"svg.hashsalt": "fraclink"}):
        drawing = mpl.figure.Figure(figsize=size, layout="constrained")
        mpl.backends.backend_agg.FigureCanvasAgg(drawing)
        draw(drawing)
        with atomic_write(path, "wb") as stream:
            drawing.savefig(stream, format=kind, **extra)
