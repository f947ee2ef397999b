"""Marks of a drawing: curves, dots, bands, bars, cells, zones, levels and points, each
as SVG in its panel.
"""

from __future__ import annotations

import html
import re
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink.view._scales import Scale, envelope

__all__ = [
    "ACROSS",
    "DOWN",
    "Across",
    "Band",
    "Curve",
    "Frame",
    "Layers",
    "Mark",
    "Point",
]
__all__ += ["Upright", "Zone", "escaped", "percent", "reach"]


# Size in steps of the box of the curves, which is stretched to its panel. Integers make
# a path half as long as decimals would. A step is a fifth of a dot at a text width of
# 860: finer than a stroke, even at a zoom of four.
ACROSS, DOWN = (
    4000,
    2000,
)


def escaped(text: object) -> str:
    """`text` escaped for an element or an attribute."""
    return html.escape(str(text))


def percent(share: float) -> str:
    """A horizontal position as a percentage of the width."""
    return f"{100 * share:.2f}".rstrip("0").rstrip(".") + "%"


@dataclass(frozen=True)
class Frame:
    """The frame of a panel: its scales, and its upper edge and height in dots."""

    x: Scale
    y: Scale
    top: float
    height: float
    left: float = 46.0

    def across(self, value: float) -> str:
        """The horizontal position of a value."""
        return percent(float(self.x.share(value)))

    def down(self, value: float) -> float:
        """The vertical position of a value in dots, inside the panel."""
        share = float(np.clip(np.nan_to_num(self.y.share(value), nan=0.0), 0.0, 1.0))
        return round(self.top + self.height * (1.0 - share), 1)

    def path(self, x: ArrayLike, y: ArrayLike, *, dots: bool = False) -> str:
        """A line through points, or a dot at each; non-finite values are gaps."""
        with np.errstate(invalid="ignore"):
            # A scalar represents a horizontal or vertical line: Curve(w, 0.0) needs no
            # array.
            a, b = np.broadcast_arrays(
                ACROSS * self.x.share(x), DOWN * (1.0 - self.y.share(y))
            )
        good = np.isfinite(a) & np.isfinite(b)
        # A value far outside is clipped at one panel size beyond the edge: the slope at
        # the edge hardly changes, and a pole does not put numbers of a hundred digits
        # into the page.
        at = np.rint(np.clip(np.nan_to_num(a), -ACROSS, 2 * ACROSS)).astype(int)
        down = np.rint(np.clip(np.nan_to_num(b), -DOWN, 2 * DOWN)).astype(int)
        if dots:
            return "".join(
                f"M{p} {q}h0" for p, q, fine in zip(at, down, good, strict=True) if fine
            )
        parts, last = [], None
        for p, q, fine in zip(at.tolist(), down.tolist(), good.tolist(), strict=True):
            if not fine:
                last = None
            elif last is None:
                parts.append(f"M{p} {q}l")
                last = (p, q)
            # A step of zero is omitted: all points of a record at rest coincide.
            elif (p, q) != last:
                parts.append(f"{p - last[0]} {q - last[1]} ")
                last = (p, q)
        # A minus separates numbers as well as a space does, which saves 5 % of the
        # drawing of a log.
        return "".join(parts).replace(" -", "-").rstrip()


@dataclass(frozen=True)
class Layers:
    """The layers of a mark in a panel: below, among and above the curves; and the label
    at its end.
    """

    below: str = ""
    curves: str = ""
    above: str = ""
    ends: tuple[tuple[float, str, str], ...] = ()


@dataclass(frozen=True)
class Curve:
    """A line of the palette through points, or a dot at each, with its name at its
    right end.
    """

    x: ArrayLike
    y: ArrayLike
    line: int = 1
    name: str = ""
    weight: Literal["", "thin", "wide", "fill", "dots"] = ""
    dashed: bool = False  # otherwise according to its line

    def drawn(self, frame: Frame) -> Layers:
        """The line, and the position of its name."""
        dots = self.weight == "dots"
        dash = "" if dots else " w" if self.dashed else f" d{self.line}"
        style = f"c{self.line}{dash} {self.weight}".strip()
        if self.weight == "fill":
            # A disk or a corridor has no end for a name and must not cover the curves:
            # it lies below them.
            return Layers(
                below=f'<path class="b{self.line}" d="{frame.path(self.x, self.y)}z"/>'
            )
        values = np.asarray(self.y, float).ravel()
        across = frame.x.share(np.broadcast_to(self.x, values.shape))
        # A name is placed where its line leaves the panel, since the line is cut off
        # beyond the right edge.
        visible = values[np.isfinite(values) & (across <= 1.0 + 1e-9)]
        attribute = f' data-name="{escaped(self.name)}"' if self.name else ""
        ends = (
            ((frame.down(float(visible[-1])), self.name, style),)
            if self.name and visible.size
            else ()
        )
        # Strokes of zero length with round ends stay round in a stretched box.
        path = frame.path(self.x, self.y, dots=dots)
        return Layers(
            curves=f'<path class="{style}"{attribute} d="{path}"/>', ends=ends
        )


def record(
    time: NDArray[Any],
    values: NDArray[Any],
    line: int = 1,
    name: str = "",
    weight: Literal["", "thin", "wide"] = "",
    *,
    dashed: bool = False,
) -> Curve:
    """Return a line through a record, thinned without the loss of a peak."""
    return Curve(*envelope(time, values), line, name, weight, dashed)


@dataclass(frozen=True)
class Band:
    """The area between two lines: an uncertainty."""

    x: ArrayLike
    low: ArrayLike
    high: ArrayLike
    line: int = 1

    def drawn(self, frame: Frame) -> Layers:
        """A closed path along the upper edge and back along the lower one."""
        x, low, high = (np.asarray(v, float) for v in (self.x, self.low, self.high))
        x, low, high = np.broadcast_arrays(x, low, high)
        there, back = frame.path(x, high), frame.path(x[::-1], low[::-1])
        # Both edges are joined into one area; two subpaths would be two slivers.
        back = re.sub(r"^M", "L", back)
        return Layers(
            below=f'<path class="b{self.line}" d="{there}{back}z"/>' if there else ""
        )


@dataclass(frozen=True)
class Zone:
    """A shaded range of the horizontal scale, or with `lying` of the vertical one."""

    low: float
    high: float
    lying: bool = False

    def drawn(self, frame: Frame) -> Layers:
        """A rectangle over the whole panel."""
        if self.lying:
            top, bottom = frame.down(self.high), frame.down(self.low)
            place = f'x="0" width="100%" y="{top}" height="{round(bottom - top, 1)}"'
        else:
            left, right = (
                float(np.clip(frame.x.share(v), 0, 1)) for v in (self.low, self.high)
            )
            place = f'x="{percent(left)}" width="{percent(right - left)}" y="{frame.top}" height="{frame.height}"'
        return Layers(below=f'<rect class="zone" {place}/>')


@dataclass(frozen=True)
class Across:
    """A level over the whole width, dashed if it is a `limit`, with a label above its
    left end.
    """

    value: float
    text: str = ""
    limit: bool = True

    def drawn(self, frame: Frame) -> Layers:
        """A line and its text."""
        y = frame.down(self.value)
        line = f'<line class="{"limit" if self.limit else "zero"}" x2="100%" y1="{y}" y2="{y}"/>'
        text = (
            f'<text class="halo" x="4" y="{y - 4}">{escaped(self.text)}</text>'
            if self.text
            else ""
        )
        return Layers(above=line + text)


@dataclass(frozen=True)
class Upright:
    """A vertical line over the whole height, with a label at its upper end."""

    value: float
    text: str = ""

    def drawn(self, frame: Frame) -> Layers:
        """A line and its text, on the side with more room."""
        left = float(frame.x.share(self.value)) > 0.5
        x, bottom = frame.across(self.value), frame.top + frame.height
        line = f'<line class="limit" x1="{x}" x2="{x}" y1="{frame.top}" y2="{bottom}"/>'
        side = 'text-anchor="end" dx="-4"' if left else 'dx="4"'
        text = f'<text class="halo" x="{x}" y="{frame.top + 11}" {side}>{escaped(self.text)}</text>'
        return Layers(above=line + (text if self.text else ""))


@dataclass(frozen=True)
class Point:
    """A point with a sign, "dot", "cross" or none, and a label: above it on the side with
    more room, or `beside` it on the right.
    """

    x: float
    y: float
    text: str = ""
    line: int = 0
    sign: str = "dot"
    beside: bool = False

    def drawn(self, frame: Frame) -> Layers:
        """The sign in its own coordinates in dots, so that it keeps its shape."""
        x, y = frame.across(self.x), frame.down(self.y)
        shapes = {
            "": "",
            "dot": f'<circle class="f{self.line}" r="4"/>',
            "cross": f'<path class="c{self.line} cross" d="M-6-6l12 12m0-12l-12 12"/>',
        }
        # The width of a text is unknown, since the reader chooses the typeface: the
        # side with more room rarely makes it run out of the drawing.
        left = not self.beside and float(frame.x.share(self.x)) > 0.5
        side = 'text-anchor="end" x="-9"' if left else 'x="9"'
        text = (
            f'<text class="halo name" {side} y="{4 if self.beside else -5}">{escaped(self.text)}</text>'
            if self.text
            else ""
        )
        return Layers(
            above=f'<svg x="{x}" y="{y}" overflow="visible">{shapes[self.sign]}{text}</svg>'
        )


Mark = Curve | Band | Zone | Across | Upright | Point


def reach(mark: Mark) -> tuple[tuple[ArrayLike, ...], tuple[ArrayLike, ...]]:
    """Return the values that a mark must show on the horizontal and the vertical scale."""
    match mark:
        case Curve() | Point():
            return (mark.x,), (mark.y,)
        case Band():
            return (mark.x,), (mark.low, mark.high)
        case Across():
            return (), (mark.value,)
    return (), ()
