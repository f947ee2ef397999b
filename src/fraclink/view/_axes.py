"""Axes of matplotlib in fraclink's colours, and the grid on which a response drawn in
them looks smooth.
"""

from __future__ import annotations

import html
import io
import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._files import atomic_write
from fraclink.errors import FieldError, MissingExtraError
from fraclink.view._pages import DARK, LIGHT, colours
from fraclink.view._pages import LINES as LINE_NUMBERS
from fracsys._loops import SampledLoop, as_loop
from fracsys._sweep import frequency_grid, refined

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "BLUE",
    "FAINT",
    "GREEN",
    "GREY",
    "INK",
    "LEVELS",
    "LINES",
    "ORANGE",
    "VIOLET",
]
__all__ += [
    "LoopCurve",
    "figure",
    "finish",
    "labelled",
    "load_matplotlib",
    "new_axes",
    "sample",
]
__all__ += ["save_figure", "svg", "theme_on", "tint"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_LIGHT = colours()
INK, GREY, FAINT = _LIGHT["ink"], _LIGHT["quiet"], _LIGHT["rule"]
LEVELS = BLUE, ORANGE, GREEN, VIOLET = tuple(
    _LIGHT[f"line-{line}"] for line in LINE_NUMBERS
)
_DASHES: tuple[Any, ...] = ("-", (0, (7, 3)), (0, (3, 2.5)), (0, (9, 3, 2, 3)))
LINES: tuple[dict[str, Any], ...] = tuple(
    {"color": color, "linestyle": style}
    for color, style in zip(LEVELS, _DASHES, strict=True)
)


def load_matplotlib() -> Any:
    """Return matplotlib with the parts that draw without a display; it takes a third of
    a second to import.

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
    "text.parse_math": False,  # a `$` in a file's name is a dollar, not a formula
    "svg.fonttype": "path",
    "svg.hashsalt": "fraclink",
    "path.simplify_threshold": 0.2,
}


def theme_on(background: Any) -> int:
    """The theme whose lines stand out on a background: dark below half of the full
    brightness.

    >>> theme_on("white"), theme_on("#131920")
    (0, 1)
    """
    from matplotlib.colors import to_rgba

    # A transparent background shows the page's, which is white more often than not.
    *colour, opacity = to_rgba(background)
    return DARK if opacity and sum(colour) < 1.5 else LIGHT


def tint(ax: Any, name: str) -> str:
    """A colour of the palette by its name, for the background of some axes."""
    return colours(theme_on(ax.get_facecolor()))[name]


@contextmanager
def figure(width: float, height: float) -> Iterator[Figure]:
    """Yield an empty figure of `width` × `height` inches in the report's style."""
    mpl = load_matplotlib()
    # `layout` is solved when the figure is drawn, and `svg` draws it inside of the same
    # style.
    with mpl.rc_context(_STYLE):
        yield mpl.figure.Figure(figsize=(width, height), layout="constrained")


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
    stream, mpl = io.StringIO(), load_matplotlib()
    with mpl.rc_context(_STYLE):
        canvas = mpl.backends.backend_svg.FigureCanvasSVG(drawing)
        canvas.print_svg(stream, metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    # matplotlib's ids are hashes of coordinates in all their digits, and the layout's
    # solver does not find the last one twice alike; numbers in the order of the page
    # are the same every time.
    order = {
        old: f"{name}-{number}"
        for number, old in enumerate(re.findall(r'\bid="([^"]*)"', text))
    }
    text = re.sub(
        r'(\bid="|url\(#|href="#)([^")]*)', lambda at: at[1] + order[at[2]], text
    )
    # A hundredth of a point is a thirtieth of a screen's dot; more digits are half of
    # the text, and they differ in the last place between processors.
    text = _PLACES.sub(
        lambda place: re.sub(r"-?\d+\.\d{3,}", _rounded, place.group()), text
    )
    text = re.sub(r"\s*\n\s*", "\n", text)
    opening = f'<svg role="img" aria-label="{html.escape(description)}" '
    return opening + text[len("<svg") :].strip()


def save_figure(
    path: Path | str,
    draw: Callable[[Figure], object],
    *,
    size: tuple[float, float] = (7.5, 5.0),
) -> None:
    """Let `draw` fill a figure of `size` [inches] and write it as the suffix says (SVG
    without one).

    Raises MissingExtraError where matplotlib is not installed.
    """
    mpl = load_matplotlib()
    kind = Path(path).suffix.lstrip(".").lower() or "svg"
    # Without a date and with ids that do not change a second run writes the same file.
    # Pixels at 110 per inch: what a page of 7.5 inches needs on a screen of usual
    # density.
    extra = {"metadata": {"Date": None}} if kind == "svg" else {"dpi": 110}
    with mpl.rc_context({"svg.hashsalt": "fraclink"}):
        drawing = mpl.figure.Figure(figsize=size, layout="constrained")
        mpl.backends.backend_agg.FigureCanvasAgg(drawing)
        draw(drawing)
        with atomic_write(path, "wb") as stream:
            drawing.savefig(stream, format=kind, **extra)


# --- responses on a grid that looks smooth, their phase on the right sheet ---------------------------------


def new_axes(rows: int = 1) -> Any:
    """New axes, one or one for each row; matplotlib.pyplot is imported when the first
    plot is drawn.
    """
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise MissingExtraError("matplotlib", "report") from error
    # Not by a context of rcParams: in a notebook the first figure chooses the backend,
    # which sets parameters of its own, and leaving the context would undo them.
    axes = pyplot.subplots(rows, 1, sharex=True, layout="constrained")[1]
    for ax in np.atleast_1d(axes):
        known = colours(theme_on(ax.get_facecolor()))
        lines = [known[f"line-{line}"] for line in LINE_NUMBERS]
        ax.set_prop_cycle(color=lines, linestyle=list(_DASHES))
    return axes


def finish(ax: Any, labels: Sequence[str] | None) -> Any:
    """Give axes their grid, and a legend where the curves have labels; return them."""
    ax.grid(True, color=tint(ax, "faint"))
    if labels is not None:
        ax.legend(loc="best", fontsize="small")
    return ax


@dataclass(frozen=True)
class LoopCurve:
    """A response L(jω) at frequencies ω [rad/s]."""

    frequency: Real
    values: Complex

    @property
    def decibels(self) -> Real:
        """20 lg |L|."""
        with np.errstate(divide="ignore"):
            return np.asarray(20 * np.log10(np.abs(self.values)))

    @property
    def phase(self) -> Real:
        """arg L [rad], continuous; it starts within π of the low-frequency slope times
        π/2.
        """
        turns = np.angle(self.values[1:] / self.values[:-1])
        # Across a pole of the axis the phase falls by π, whichever sign rounding gave
        # the jump.
        size = np.abs(self.values)
        # 2.8 rad between two neighbours of a refined grid is no curve but a jump by ±π;
        # it counts as a pole's only where both sides are large, for at a zero of the
        # axis the phase rises.
        over = (turns > 2.8) & (np.minimum(size[1:], size[:-1]) > np.median(size))
        turns[over] -= 2 * math.pi
        first = float(np.angle(self.values[0]))
        # Bode's relation for a minimum-phase loop: phase = 90° times the slope. It
        # picks the multiple of 360°, which the angle alone leaves open: k/s³ starts at
        # −270° and not at +90°.
        x = np.log(self.frequency[:2])
        slope = float(np.diff(np.log(size[:2]))[0] / (x[1] - x[0]))
        if math.isfinite(slope):
            first += (
                2 * math.pi * round((0.5 * math.pi * slope - first) / (2 * math.pi))
            )
        return np.concatenate([[first], first + np.cumsum(turns)])


def sample(
    system: Any,
    frequency: ArrayLike | None,
    limit: float | None,
    drawn: Callable[[LoopCurve], tuple[Real, Real]] | None = None,
) -> LoopCurve:
    """The response on `frequency` [rad/s], or on its own grid refined until `drawn`
    looks smooth.
    """
    loop = as_loop(system, limit)
    if frequency is not None:
        w = np.asarray(frequency, dtype=float).reshape(-1)
        if (
            w.size < 3
            or not np.all(np.isfinite(w))
            or np.any(w <= 0)
            or np.any(np.diff(w) <= 0)
        ):
            raise FieldError(
                "frequency",
                frequency,
                "not a grid of frequencies",
                allowed="three or more rising values > 0 rad/s",
                remedy="numpy.geomspace(0.1, 100.0, 300), or None for an automatic grid",
            )
        return _evaluated(loop, np.log(w))
    x = np.log(frequency_grid(system, limit=limit))
    if drawn is not None:
        x = refined(lambda at: drawn(_evaluated(loop, at)), x)
    return _evaluated(loop, x)


def _evaluated(loop: SampledLoop, x: Real) -> LoopCurve:
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        values = loop(x)
    # No value beside a pole says where the curve goes, and an infinite one would scale
    # the axis away. A pole or zero hit exactly is drawn as a gap in nothing: its
    # neighbours are 1e-9 beside it.
    usual = np.isfinite(values) & (values != 0)
    return LoopCurve(np.exp(x), np.where(usual, values, math.nan))


def labelled(
    systems: Sequence[Any], labels: Sequence[str] | None
) -> list[tuple[Any, str | None]]:
    """Systems with their labels."""
    if not systems:
        raise FieldError(
            "systems",
            "none",
            "empty",
            allowed="one system or more",
            remedy="pass a loop",
        )
    if labels is not None and len(labels) != len(systems):
        raise FieldError(
            "labels",
            list(labels),
            f"{len(labels)} labels for {len(systems)} systems",
            allowed="one label for each system",
            remedy="give as many labels as systems",
        )
    return [
        (system, None if labels is None else labels[i])
        for i, system in enumerate(systems)
    ]
