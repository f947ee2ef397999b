"""A drawing of fraclink in matplotlib axes, for the user's own figures."""

from __future__ import annotations

from typing import Any

import numpy as np

from fraclink.errors import FieldError, MissingExtraError
from fraclink.view._drawing import Figure
from fraclink.view._marks import (
    Across,
    Band,
    Bars,
    Box,
    Cells,
    Curve,
    Dots,
    Mark,
    Point,
    Upright,
    Zone,
)
from fraclink.view._pages import DARK, LIGHT, colours
from fraclink.view._scales import Scale

__all__ = ["on_axes"]

# Dash patterns of the lines 0 to 4, in units of their width.
_DASHES: tuple[Any, ...] = ("-", "-", (0, (5, 2)), (0, (2, 1.5)), (0, (6, 2, 1.5, 2)))
_WIDTHS = {"": 1.3, "thin": 0.7, "wide": 2.6, "fill": 0.0}
_SIGNS = {"dot": "o", "cross": "x", "ring": "o"}


def on_axes(figure: Figure, ax: Any = None, **style: Any) -> Any:
    """Draw the panels of `figure` into axes, new ones without `ax`, and return them.

    `style` applies to its named curves, as in `Axes.plot`. Existing curves in the axes
    remain in view.
    """
    axes = _axes(figure, ax)
    for panel, one in zip(figure.panels, axes, strict=True):
        limits = one.axis() if one.has_data() else None
        has_names = False
        for mark in panel.marks:
            has_names |= _drawn(one, mark, style)
        _scaled(one, "x", figure.x, limits and limits[:2])
        _scaled(one, "y", panel.y, limits and limits[2:])
        one.set_ylabel(panel.label)
        one.grid(True, color=_colour(one, "faint"))
        one.set_axisbelow(True)
        if has_names:
            one.legend(loc="best", fontsize="small")
        if figure.rigid:
            one.set_aspect("equal")
    axes[-1].set_xlabel(figure.xlabel)
    return axes if len(axes) > 1 else axes[0]


def _axes(figure: Figure, ax: Any) -> Any:
    count = len(figure.panels)
    if ax is None:
        try:
            from matplotlib import pyplot
        except ImportError as error:
            raise MissingExtraError("matplotlib", "report") from error
        # Without an rcParams context: in a notebook the first figure selects the
        # backend, which sets parameters of its own, and leaving the context would reset
        # them.
        ax = pyplot.subplots(count, 1, sharex=True, layout="constrained")[1]
    axes = np.asarray(ax, dtype=object).reshape(-1)
    if axes.size != count:
        raise FieldError(
            "ax",
            axes.size,
            f"not {count} axes",
            allowed=", ".join(panel.label for panel in figure.panels),
            remedy=f"plt.subplots({count}, 1)",
        )
    return axes


def _colour(ax: Any, name: str) -> str:
    """A colour of the palette in the theme with better contrast on these axes."""
    from matplotlib.colors import to_rgba

    # A transparent background shows that of the page, which is usually white.
    *colour, opacity = to_rgba(ax.get_facecolor())
    return colours(DARK if opacity and sum(colour) < 1.5 else LIGHT)[name]


def _line(ax: Any, line: int) -> str:
    return _colour(ax, f"line-{line}" if line else "ink")


def _drawn(ax: Any, mark: Mark, style: dict[str, Any]) -> bool:
    """Draw one mark; return whether the legend includes it."""
    match mark:
        case Curve(weight="fill"):
            ax.fill(mark.x, mark.y, color=_line(ax, mark.line), alpha=0.22, zorder=1)
        case Curve():
            x, y = np.broadcast_arrays(np.asarray(mark.x), np.asarray(mark.y))
            own = {
                "color": _line(ax, mark.line),
                "linestyle": "--" if mark.dashed else _DASHES[mark.line],
                "linewidth": _WIDTHS[mark.weight],
                "label": mark.name or None,
            }
            ax.plot(x, y, **(own | style if mark.weight == "" else own))
            return bool(mark.name)
        case Dots():
            ax.plot(mark.x, mark.y, ".", color=_line(ax, mark.line), label=mark.name)
            return bool(mark.name)
        case Band():
            color = _line(ax, mark.line)
            ax.fill_between(mark.x, mark.low, mark.high, color=color, alpha=0.22)
        case Bars():
            ax.stairs(
                mark.heights,
                mark.edges,
                baseline=mark.base,
                fill=True,
                color=_line(ax, mark.line),
                alpha=0.8,
                label=mark.name,
            )
            return bool(mark.name)
        case Box():
            size = mark.right - mark.left
            ax.barh(
                0.5 * (mark.low + mark.high),
                size,
                mark.high - mark.low,
                mark.left,
                color=_line(ax, mark.line),
            )
        case Cells():
            ax.pcolormesh(mark.across, mark.up, mark.levels)
        case Zone(lying=True):
            ax.axhspan(mark.low, mark.high, color=_colour(ax, "zone"), zorder=0)
        case Zone():
            ax.axvspan(mark.low, mark.high, color=_colour(ax, "zone"), zorder=0)
        case Across():
            dash = "--" if mark.limit else "-"
            quiet = _colour(ax, "quiet")
            ax.axhline(mark.value, color=quiet, linewidth=0.8, linestyle=dash)
        case Upright():
            quiet = _colour(ax, "quiet")
            ax.axvline(mark.value, color=quiet, linewidth=0.8, linestyle="--")
            top = ax.get_xaxis_transform()
            if mark.text:
                ax.text(
                    mark.value, 0.98, mark.text, transform=top, va="top", fontsize=8
                )
        case Point():
            color, size = _line(ax, mark.line), 8 if mark.sign == "cross" else 4
            if mark.sign:
                ax.plot(mark.x, mark.y, _SIGNS[mark.sign], color=color, markersize=size)
            if mark.text:
                ax.annotate(
                    mark.text,
                    (mark.x, mark.y),
                    (5, 3),
                    textcoords="offset points",
                    fontsize=8,
                    color=_colour(ax, "quiet"),
                    annotation_clip=True,
                )
    return False


def _scaled(ax: Any, name: str, scale: Scale, held: tuple[float, float] | None) -> None:
    """The ends of an axis, wide enough for its earlier content."""
    ends = scale.low, scale.high
    if held is not None:
        ends = min(*ends, *held), max(*ends, *held)
    getattr(ax, f"set_{name}scale")("log" if scale.log else "linear")
    getattr(ax, f"set_{name}lim")(ends)
    if scale.ticks is not None:
        places, texts = zip(*scale.ticks, strict=True)
        getattr(ax, f"set_{name}ticks")(places, texts)
