"""Figs. 7 and 8 as drawings: the inner and the outer loop, with the corrected law (22)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from reproduce.figures import WIDTH, Picture
from reproduce.matplotlib_svg import BLUE, GREY, INK, figure, svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["loop_drawings"]


@dataclass(frozen=True)
class _Board:
    """Boxes, sums and arrows on a grid in inches."""

    axes: Axes

    def box(
        self, x: float, y: float, width: float, text: str, color: str = INK
    ) -> None:
        """A box with its centre at (x, y), half an inch high."""
        from matplotlib.patches import Rectangle

        place = Rectangle(
            (x - width / 2, y - 0.25),
            width,
            0.5,
            fill=False,
            edgecolor=color,
            linewidth=1.1,
        )
        self.axes.add_patch(place)
        self.axes.text(x, y, text, ha="center", va="center", fontsize=8.5, color=color)

    def sum(self, x: float, y: float, *signs: tuple[float, float, str]) -> None:
        """A circle where signals are added, with (dx, dy, sign) next to it."""
        self.axes.plot(
            x,
            y,
            "o",
            markersize=11,
            markerfacecolor="none",
            markeredgecolor=INK,
            markeredgewidth=1.1,
        )
        for dx, dy, sign in signs:
            self.axes.text(x + dx, y + dy, sign, ha="center", va="center", fontsize=8.5)

    def arrow(self, *points: tuple[float, float], color: str = INK) -> None:
        """A line through the points with an arrowhead at its end."""
        xs, ys = zip(*points, strict=True)
        self.axes.plot(xs[:-1], ys[:-1], color=color, linewidth=1.0)
        self.axes.annotate(
            "",
            points[-1],
            xytext=points[-2],
            arrowprops={
                "arrowstyle": "-|>",
                "color": color,
                "linewidth": 1.0,
                "shrinkA": 0,
                "shrinkB": 0,
            },
        )

    def name(self, x: float, y: float, text: str, color: str = INK) -> None:
        """The name of a signal."""
        self.axes.text(x, y, text, ha="center", va="bottom", fontsize=8.5, color=color)

    def node(self, x: float, y: float) -> None:
        """A point where a signal branches."""
        self.axes.plot(x, y, "o", markersize=3, color=INK)


def _inner(board: _Board) -> None:
    board.name(0.35, 1.56, "θm*")
    board.arrow((0.1, 1.5), (0.8, 1.5))
    board.sum(0.9, 1.5, (-0.13, 0.16, "+"), (0.16, -0.2, "−"))
    board.arrow((1.0, 1.5), (1.45, 1.5))
    board.box(2.35, 1.5, 1.8, "C_m1 = (a2 s² + a1 s + a0)\n/ (s (s + c))", BLUE)
    board.arrow((3.25, 1.5), (3.7, 1.5))
    board.sum(3.8, 1.5, (-0.13, 0.16, "+"), (0.16, -0.2, "−"))
    board.arrow((3.9, 1.5), (4.5, 1.5))
    board.name(4.2, 1.56, "u'")
    board.sum(4.6, 1.5, (-0.13, 0.16, "+"), (0.16, 0.2, "+"))
    board.arrow((4.6, 2.2), (4.6, 1.6), color=GREY)
    board.name(4.6, 2.22, "compensation of friction and Γ", GREY)
    board.arrow((4.7, 1.5), (5.3, 1.5))
    board.name(5.0, 1.56, "V")
    board.box(6.2, 1.5, 1.8, "motor\nA / (s (s + B))")
    board.arrow((7.1, 1.5), (8.4, 1.5))
    board.name(8.1, 1.56, "θm")
    board.node(7.6, 1.5)
    board.arrow((7.6, 1.5), (7.6, 0.7), (6.75, 0.7))
    board.box(5.6, 0.7, 2.3, "C_m2 = (b1 s + b0) / (s + c)", BLUE)
    board.arrow((4.45, 0.7), (3.8, 0.7), (3.8, 1.4))
    board.node(7.6, 0.7)
    board.arrow((7.6, 0.7), (7.6, 0.2), (0.9, 0.2), (0.9, 1.4))


def _outer(board: _Board) -> None:
    board.name(0.3, 2.06, "θt*")
    board.arrow((0.05, 2.0), (0.75, 2.0))
    board.node(0.55, 2.0)
    board.sum(0.85, 2.0, (-0.13, 0.16, "+"), (0.16, -0.2, "−"))
    board.arrow((0.95, 2.0), (1.35, 2.0))
    board.box(1.85, 2.0, 1.0, "C = 1 + Ĉ", BLUE)
    board.arrow((2.35, 2.0), (3.0, 2.0))
    board.arrow((0.55, 2.0), (0.55, 2.75), (1.35, 2.75))
    board.box(1.85, 2.75, 1.0, "s^λ / ϖ²", BLUE)
    board.arrow((2.35, 2.75), (3.1, 2.75), (3.1, 2.1))
    board.sum(3.1, 2.0, (-0.15, 0.16, "+"), (0.16, 0.2, "+"), (0.16, -0.2, "+"))
    board.arrow((3.2, 2.0), (3.9, 2.0))
    board.name(3.55, 2.06, "θm*")
    board.box(4.5, 2.0, 1.2, "inner loop\nM(s)")
    board.arrow((5.1, 2.0), (5.95, 2.0))
    board.name(5.35, 2.06, "θm")
    board.node(5.6, 2.0)
    board.box(6.55, 2.0, 1.2, "link\nϖ² / (s^λ + ϖ²)")
    board.arrow((7.15, 2.0), (8.45, 2.0))
    board.name(8.2, 2.06, "θt")
    board.arrow((6.55, 1.75), (6.55, 1.2))
    board.name(6.72, 1.42, "Γ")
    board.box(6.55, 0.95, 0.9, "1 / c")
    board.arrow((6.1, 0.95), (5.7, 0.95))
    board.sum(5.6, 0.95, (0.17, -0.17, "−"), (0.16, 0.2, "+"))
    board.arrow((5.6, 2.0), (5.6, 1.05))
    board.arrow((5.5, 0.95), (4.6, 0.95))
    board.sum(4.5, 0.95, (0.17, 0.17, "+"), (0.16, -0.22, "+"))
    board.arrow((4.5, 0.2), (4.5, 0.85), color=GREY)
    board.name(5.5, 0.2, "d = −d'/c, offset and noise", GREY)
    board.arrow((4.4, 0.95), (0.85, 0.95), (0.85, 1.9))
    board.name(2.1, 1.0, "θtᵉ")
    board.node(3.1, 0.95)
    board.arrow((3.1, 0.95), (3.1, 1.9))


def loop_drawings() -> list[Picture]:
    """Fig. 7, the inner loop, and Fig. 8, the outer loop."""
    rows = (
        (
            7,
            "the inner loop",
            _inner,
            2.6,
            "Two PIDs with a filter, (19) and (20), around the motor (1): M(s) of (21).",
        ),
        (
            8,
            "the outer loop",
            _outer,
            3.2,
            "With (22) corrected, s^λ/ϖ² for s^λ and θtᵉ added; the loop is then Ĉ·G·M, as (24) has it.",
        ),
    )
    return [_drawn(*row) for row in rows]


def _drawn(
    number: int, name: str, draw: Callable[[_Board], None], height: float, caption: str
) -> Picture:
    with figure(WIDTH, height) as drawing:
        axes = drawing.subplots()
        axes.set(xlim=(0, WIDTH), ylim=(0, height), facecolor="none")
        axes.set_axis_off()
        axes.set_aspect("equal")
        draw(_Board(axes))
        text = svg(drawing, f"fig{number:02d}", f"Figure {number}: {name}")
    return Picture(f"fig{number:02d}.svg", f"Fig. {number}: {name}", caption, text)
