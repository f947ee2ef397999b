"""Axes of matplotlib in fraclink's colours: for `fraclink.plots`, and for the paper's figures."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fraclink._files import atomic_write
from fraclink._show.palette import DARK, LIGHT, colours
from fraclink._show.palette import LINES as LINE_NUMBERS
from fraclink.errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["BLUE", "FAINT", "GREEN", "GREY", "INK", "LEVELS", "LINES", "ORANGE", "VIOLET"]
__all__ += ["cycle", "figure", "load_matplotlib", "save_figure", "svg", "theme_on", "tint"]

_LIGHT = colours()
INK, GREY, FAINT = _LIGHT["ink"], _LIGHT["quiet"], _LIGHT["rule"]
LEVELS = BLUE, ORANGE, GREEN, VIOLET = tuple(_LIGHT[f"line-{line}"] for line in LINE_NUMBERS)
_DASHES: tuple[Any, ...] = ("-", (0, (7, 3)), (0, (3, 2.5)), (0, (9, 3, 2, 3)))
LINES: tuple[dict[str, Any], ...] = tuple(
    {"color": color, "linestyle": style} for color, style in zip(LEVELS, _DASHES, strict=True)
)


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


def theme_on(background: Any) -> int:
    """The theme whose lines stand out on a background: dark below half of the full brightness.

    >>> theme_on("white"), theme_on("#131920")
    (0, 1)
    """
    from matplotlib.colors import to_rgba

    *colour, opacity = to_rgba(background)
    return DARK if opacity and sum(colour) < 1.5 else LIGHT


def cycle() -> dict[Any, Any]:
    """What gives the lines of new axes fraclink's colours and dashes, light or dark as the axes are."""
    mpl = load_matplotlib()
    known = colours(theme_on(mpl.rcParams["axes.facecolor"]))
    lines = [known[f"line-{line}"] for line in LINE_NUMBERS]
    return {"axes.prop_cycle": mpl.cycler(color=lines) + mpl.cycler(linestyle=list(_DASHES))}


def tint(ax: Any, name: str) -> str:
    """A colour of the palette by its name, for the background of some axes."""
    return colours(theme_on(ax.get_facecolor()))[name]


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
