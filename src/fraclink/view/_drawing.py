"""Drawings as SVG that fits any width, in the colours of the surrounding page or in
their own.

Horizontal positions are fractions of the width, vertical ones are in dots, so that text
and strokes keep their size on a telephone, on a screen and on paper. Curves lie in a
box of 4000 by 2000 steps that is stretched to the panel. The same values give the same
bytes.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, singledispatch
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import isotonic_regression

from fraclink._files import write_text
from fraclink.errors import FieldError
from fraclink.view._marks import (
    ACROSS,
    DOWN,
    Band,
    Curve,
    Frame,
    Layers,
    Mark,
    escaped,
    reach,
)
from fraclink.view._pages import DARK, LIGHT, literal, template_text
from fraclink.view._scales import Scale

if TYPE_CHECKING:
    from functools import _SingleDispatchCallable

__all__ = ["Figure", "Panel", "figure_of", "save_svg", "stand_alone"]

WIDTH = 860.0  # width in dots of a separate drawing: the text width of the report
_LETTER = 6.7  # average width in dots of a letter of 12 dots in a system typeface
_ROW = 15.0  # dots between two lines of text


# --- panels and figures -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Panel:
    """The drawing over one vertical scale, with its label above it.

    scale: the vertical scale; by default it covers everything drawn.
    """

    label: str
    marks: Sequence[Mark]
    height: float = 150.0
    scale: Scale | None = None

    @property
    def y(self) -> Scale:
        """The vertical scale."""
        values = (value for mark in self.marks for value in reach(mark)[1])
        return self.scale or Scale.around(*values)

    def lines(self) -> list[tuple[str, str, ArrayLike, ArrayLike]]:
        """Name, role and coordinates of its lines, for a page that draws them itself."""
        lines: list[tuple[str, str, ArrayLike, ArrayLike]] = []
        for mark in self.marks:
            match mark:
                case Curve():
                    measured = mark.weight in ("wide", "dots")
                    role = "measured" if measured else "predicted"
                    name = mark.name or ("log" if measured else self.label)
                    lines.append((name, role, mark.x, mark.y))
                case Band():
                    lines.append(("band, low", "reference", mark.x, mark.low))
                    lines.append(("band, high", "reference", mark.x, mark.high))
        return lines


@dataclass(frozen=True)
class Figure:
    """Stacked panels with a common horizontal scale.

    name: unique on its page. description: text for readers who cannot see it. link:
    figures of one link share their cursor. scale: the horizontal scale; by default it
    covers exactly what is drawn, and is logarithmic if `log`. left: dots for the
    vertical scale's texts.
    """

    name: str
    description: str
    panels: Sequence[Panel]
    xlabel: str = ""
    link: str = ""
    scale: Scale | None = None
    log: bool = False
    left: float = 46.0
    rigid: bool = False  # the same scale in both directions: a plane

    @property
    def x(self) -> Scale:
        """The horizontal scale."""
        marks = (mark for panel in self.panels for mark in panel.marks)
        places = (place for mark in marks for place in reach(mark)[0])
        return self.scale or Scale.around(*places, room=0.0, log=self.log)

    def inline(self) -> str:
        """The drawing as an element of a page with `figure.css`."""
        if self.rigid:
            # A plane must keep its proportions, so it has a viewBox like a file; the
            # page already provides style and background.
            text = re.sub(
                r"<style>.*?</style><rect[^>]*/>", "", self.alone(), flags=re.DOTALL
            )
            return text.replace(' role="img"', f' id="fig-{self.name}" role="img"', 1)
        body, height, right = self._body()
        # The script for the pointer converts dots back to values with these ends;
        # nine digits are finer than the dots of a screen at any zoom.
        scale = f"{self.x.low:.9g} {self.x.high:.9g}{' log' if self.x.log else ''}"
        data = f'data-x="{scale}" data-link="{escaped(self.link or self.name)}"'
        style = f"height:{height:g}px;padding:0 {right:g}px 0 {self.left:g}px"
        label = f'aria-label="{escaped(self.description)}"'
        return f'<svg class="fl" id="fig-{self.name}" role="img" {label} {data} style="{style}">{body}</svg>'

    def alone(self) -> str:
        """The drawing as a file or for a notebook cell: with its own style, in both
        themes.
        """
        body, height, right = self._body()
        # Both axes of a rigid figure have the same scale, so it is as wide as high.
        across = self.panels[0].height if self.rigid else WIDTH - self.left - right
        inner = f'x="{self.left:g}" y="10" width="{across:g}" height="{height:g}"'
        nested = f'<svg {inner} overflow="visible">{body}</svg>'
        return stand_alone(
            nested, self.left + across + right, height + 20, self.description
        )

    def save(self, path: Path | str) -> None:
        """Write the drawing to an SVG file, as `save_svg` does."""
        save_svg(self.alone(), path)

    def _body(self) -> tuple[str, float, float]:
        """Elements, height and the right margin in dots."""
        parts, top, names = [], 24.0, [0]
        for panel in self.panels:
            frame = Frame(self.x, panel.y, top, panel.height, self.left)
            layers = [mark.drawn(frame) for mark in panel.marks]
            parts.append(_panel(panel, frame, layers, last=panel is self.panels[-1]))
            names += [len(name) for layer in layers for _, name, _ in layer.ends]
            # 34 dots between panels: the label above the next panel, and the ends of
            # this one's scale.
            top += panel.height + 34.0
        bottom = top - 34.0
        if self.xlabel:
            parts.append(
                f'<text class="axis" x="50%" y="{bottom + 36:g}" text-anchor="middle">'
                f"{escaped(self.xlabel)}</text>"
            )
        bottom += 44.0 if self.xlabel else 24.0
        # Names at the ends of lines stand outside the panel, after a key of 29 dots;
        # without names the text of the last tick still needs half its width.
        right = 14.0 if max(names) == 0 else 38.0 + _LETTER * max(names)
        return "".join(parts), bottom, right


def _no_figure(result: Any) -> Figure | str | None:
    return None


# The drawing of a result, by its class; None if it has none.
figure_of: _SingleDispatchCallable[Figure | str | None] = singledispatch(_no_figure)


def save_svg(text: str, path: Path | str) -> None:
    """Write a drawing to a file, completely or not at all; FieldError for a file of
    another kind.
    """
    # No program could open an SVG file named .png or .pdf: rejected before anything is
    # written.
    if Path(path).suffix.lower() not in ("", ".svg"):
        raise FieldError(
            "path",
            str(path),
            "a file of another kind",
            ".svg",
            "end its name in .svg; browsers and Inkscape turn it into other kinds",
        )
    write_text(path, text + "\n")


def _panel(panel: Panel, frame: Frame, layers: Sequence[Layers], *, last: bool) -> str:
    bottom = round(frame.top + frame.height, 1)
    lines, texts = [], []
    # One tick per 34 dots, twice the height of a line of text; even a low panel gets
    # four.
    for value, text in frame.y.marks(max(4, int(frame.height / 34))):
        y = frame.down(value)
        lines.append(f'<line class="grid" x2="100%" y1="{y}" y2="{y}"/>')
        texts.append(
            f'<text x="-6" y="{round(y + 4, 1)}" text-anchor="end">{escaped(text)}</text>'
        )
    # About nine: 40 dots for the text of a tick, at most seven characters, and the same
    # space between two of them.
    for k, (value, text) in enumerate(frame.x.marks(9)):
        x = frame.across(value)
        lines.append(
            f'<line class="grid" x1="{x}" x2="{x}" y1="{frame.top}" y2="{bottom}"/>'
        )
        if last:
            # On a narrow screen the style sheet hides every second label, since a page
            # without a script cannot place new ticks.
            alternate = ' class="alt"' if k % 2 else ""
            texts.append(
                f'<text{alternate} x="{x}" y="{bottom + 17}" text-anchor="middle">{escaped(text)}</text>'
            )
    scale = f"{frame.y.low:.9g} {frame.y.high:.9g}{' log' if frame.y.log else ''}"
    place = f'y="{frame.top}" width="100%" height="{frame.height}"'
    view = f'viewBox="0 0 {ACROSS} {DOWN}" preserveAspectRatio="none"'
    box = f'<svg class="box" {place} {view} data-y="{scale}">'
    # A zone lies below the grid, so that values can be read in it. Bands and bars lie
    # in the stretched box with the curves; they only tint the grid.
    shaded = "".join(layer.below for layer in layers if layer.below.startswith("<rect"))
    curves = "".join(
        layer.below for layer in layers if not layer.below.startswith("<rect")
    )
    curves += "".join(layer.curves for layer in layers)
    above = "".join(layer.above for layer in layers)
    frame_line = f'<line class="base" x2="100%" y1="{bottom}" y2="{bottom}"/>'
    place = f'x="{4 - min(frame.left, 46.0):g}" y="{frame.top - 8}"'
    label = (
        f'<text class="label" {place}>{escaped(panel.label)}</text>'
        if panel.label
        else ""
    )
    ends = _ends([end for layer in layers for end in layer.ends], frame)
    return "".join(
        [shaded, *lines, *texts, box, curves, "</svg>", frame_line, above, ends, label]
    )


def _ends(ends: Sequence[tuple[float, str, str]], frame: Frame) -> str:
    """Names at the right ends of their lines, moved apart until they do not overlap."""
    if not ends:
        return ""
    # Lines that end at the same place keep the order in which they were drawn.
    placed = sorted(ends, key=lambda end: round(end[0] / 8))
    # With the rows subtracted, the places need only keep their order: isotonic
    # regression gives the nearest places in that order, and clipping keeps them inside
    # the panel.
    rows = _ROW * np.arange(len(placed))
    low, high = frame.top + 5, frame.top + frame.height - 2 - rows[-1]
    order = isotonic_regression(np.array([end[0] for end in placed]) - rows).x
    places = rows + np.clip(order, low, max(low, high))
    parts = []
    for y, (_, name, style) in zip(places, placed, strict=True):
        sides = 'x1="14.4" x2="14.5"' if "dots" in style else 'x1="5" x2="24"'
        key = f'<line class="{style}" {sides} y1="{y:.1f}" y2="{y:.1f}"/>'
        parts.append(
            f'{key}<text class="name" x="29" y="{y + 4:.1f}">{escaped(name)}</text>'
        )
    return f'<svg x="100%" overflow="visible">{"".join(parts)}</svg>'


# --- a drawing without a page -----------------------------------------------------------------------------


@cache
def _own_style() -> str:
    """The style of a file: literal colours, first the light ones, then the dark ones."""
    rules = re.sub(r"/\*.*?\*/", "", template_text("figure.css"), flags=re.DOTALL)
    rules = re.sub(r"@media[^{]*\{(?:[^{}]*\{[^{}]*\})*\s*\}", "", rules)
    rules = "\n".join(line for line in rules.splitlines() if line.strip())
    dark = "\n".join(
        rule for rule in re.findall(r"[^{}]+\{[^}]*\}", rules) if "var(--" in rule
    )
    # Literal colours: `var(--…)` of a page does not apply inside an image file or a
    # notebook cell.
    return f"{literal(rules, LIGHT)}\n@media (prefers-color-scheme: dark) {{ {literal(dark, DARK).strip()} }}"


def stand_alone(body: str, width: float, height: float, description: str) -> str:
    """Elements as a separate SVG of `width` by `height` dots with its own background."""
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="fl alone" role="img" width="{width:g}" '
        f'height="{height:g}" viewBox="0 0 {width:g} {height:g}" aria-label="{escaped(description)}">'
    )
    return f'{head}<style>{_own_style()}</style><rect class="ground" width="100%" height="100%"/>{body}</svg>'
