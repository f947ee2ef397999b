"""A tournament as a picture: one row a rival, one column a figure, a dot for what it reached."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from fraclink._show.drawing import Figure, Panel, beside, save_svg
from fraclink._show.marks import Frame, escaped
from fraclink._show.scales import Scale

if TYPE_CHECKING:
    from fraclink._campaign.tournament import Standing, Tournament

__all__ = ["draw_rivals", "rivals_figure"]

# Attribute, title, factor, and the left end of a logarithmic scale: what is below counts as that.
_COLUMNS = (
    ("settling_time", "settling [s]", 1.0, 0.0),
    ("worst_settling", "worst payload [s]", 1.0, 0.0),
    ("residual_vibration", "vibration [mrad]", 1e3, 0.1),
    ("offset_error", "by offset [mrad]", 1e3, 0.001),
    ("motor_reference_noise", "noise [mrad]", 1e3, 0.1),
    ("mode_gain", "gain at mode 2", 1.0, 0.001),
)
_ROW, _NAMES, _WIDE = 24.0, 190.0, 128.0  # dots of a row, of the names, of a column
_END = 1.6  # of the largest value: room for its dot


def rivals_figure(result: Tournament) -> str:
    """Draw a dot for every rival and figure, in the order of the table; left is better throughout."""
    columns = []
    for column, (attribute, title, factor, left) in enumerate(_COLUMNS):
        values = [factor * float(getattr(standing, attribute)) for standing in result.standings]
        finite = [value for value in values if math.isfinite(value)] or [1.0]
        x = Scale(left, _END * max(*finite, 10 * left), log=True) if left else Scale(0.0, 1.1 * max(finite))
        rows = _rows(result.standings, values, x, names=not column)
        panel = Panel(title, Scale(0.0, 1.0, ticks=()), (), _ROW * len(values), rows)
        room = _NAMES if not column else 12.0
        width = room + _WIDE
        columns.append(Figure(attribute, title, x, (panel,), left=room, width=width, ticks=3))
    return beside(columns, "What each rival reached in six figures; left is better")


def draw_rivals(result: Tournament, path: Path | str) -> None:
    """Write `rivals_figure` to an SVG file."""
    save_svg(rivals_figure(result), path)


def _rows(
    standings: tuple[Standing, ...], values: list[float], x: Scale, *, names: bool
) -> Callable[[Frame], str]:
    def draw(frame: Frame) -> str:
        parts = []
        for row, (standing, value) in enumerate(zip(standings, values, strict=True)):
            y = frame.top + _ROW * (row + 0.5)
            ours = standing.name.startswith("fraclink")
            parts.append(f'<line class="grid" x2="100%" y1="{y}" y2="{y}"/>')
            if names:
                style = "label" if ours else "name"
                text = standing.name + ("" if standing.sound else " ✗")
                parts.append(
                    f'<text class="{style}" x="-10" y="{y + 4}" text-anchor="end">{escaped(text)}</text>'
                )
            if not math.isfinite(value):
                parts.append(
                    f'<text class="name" x="100%" dx="-4" y="{y + 4}" text-anchor="end">never</text>'
                )
                continue
            at = frame.across(max(value, x.low))
            if standing.sound:
                parts.append(
                    f'<circle class="f{1 if ours else 2}" cx="{at}" cy="{y}" r="{6 if ours else 4.5}"/>'
                )
            else:  # unstable, or only held by friction or a limit: no figure counts
                cross = '<path class="c0 cross" d="M-4-4l8 8m0-8l-8 8"/>'
                parts.append(f'<svg x="{at}" y="{y}" overflow="visible">{cross}</svg>')
        return "".join(parts)

    return draw
