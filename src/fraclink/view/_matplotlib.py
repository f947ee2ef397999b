"""A drawing of fraclink in matplotlib axes, for the user's own figures."""

from __future__ import annotations

from typing import Any

import numpy as np

from fraclink.errors import FieldError, MissingExtraError
from fraclink.view._drawing import Figure
from fraclink.view._marks import Curve
from fraclink.view._pages import DARK, DASHES, LIGHT, colours
from fraclink.view._scales import Scale

__all__ = ["on_axes"]


def on_axes(figure: Figure, ax: Any = None, **style: Any) -> Any:
    """Draw the curves of `figure` into axes, one for each panel, by default new ones,
    and return the axes.

    `style` applies to the curves, as in `Axes.plot`. Existing curves in the axes remain
    in view.
    """
    axes = _axes(figure, ax)
    for panel, one in zip(figure.panels, axes, strict=True):
        limits = one.axis() if one.has_data() else None
        for curve in panel.marks:
            if isinstance(curve, Curve):
                one.plot(curve.x, curve.y, **_look(one, curve) | style)
        _scaled(one, "x", figure.x, limits and limits[:2])
        _scaled(one, "y", panel.y, limits and limits[2:])
        one.set_ylabel(panel.label)
        one.grid(True, color=_colour(one, "faint"))
        one.set_axisbelow(True)
        if one.get_legend_handles_labels()[1]:
            one.legend(loc="best", fontsize="small")
    axes[-1].set_xlabel(figure.xlabel)
    return axes


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
    axes = np.asarray(ax, object).reshape(-1)
    if axes.size != count:
        raise FieldError(
            "ax",
            axes.size,
            f"not {count} axes",
            ", ".join(panel.label for panel in figure.panels),
            f"plt.subplots({count}, 1)",
        )
    return axes


def _colour(ax: Any, name: str) -> str:
    """A colour of the palette in the theme with better contrast on these axes."""
    from matplotlib.colors import to_rgba

    # A transparent background shows that of the page, which is usually white.
    *colour, opacity = to_rgba(ax.get_facecolor())
    return colours(DARK if opacity and sum(colour) < 1.5 else LIGHT)[name]


def _look(ax: Any, curve: Curve) -> dict[str, Any]:
    dashes = [float(size) for size in DASHES[curve.line].split()]
    return {
        "color": _colour(ax, f"line-{curve.line}"),
        "linestyle": (0, dashes or None),
        "label": curve.name or None,
    }


def _scaled(ax: Any, name: str, scale: Scale, held: tuple[float, float] | None) -> None:
    """Set an axis to a scale, wide enough to show its earlier content, too."""
    ends = scale.low, scale.high
    if held is not None:
        ends = min(*ends, *held), max(*ends, *held)
    getattr(ax, f"set_{name}scale")("log" if scale.log else "linear")
    getattr(ax, f"set_{name}lim")(ends)
    if scale.ticks is not None:
        places, texts = zip(*scale.ticks, strict=True)
        getattr(ax, f"set_{name}ticks")(places, texts)
