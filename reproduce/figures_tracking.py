"""Figs. 11 to 16: moves for four interpretations of the controllers, with offset and
noise of the gauge.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fraclink._simulate import Run
from reproduce import designs
from reproduce.figures import WIDTH, Picture
from reproduce.loops import sampled
from reproduce.matplotlib_svg import BLUE, GREY, ORANGE, figure, svg
from reproduce.runs import OFFSET, move, tracking_pairs

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["tracking_pictures"]

_FIGURES = ((11, 0.030), (12, 0.040), (13, 0.020), (15, 0.016), (16, 0.008))
_CAPTION = (
    "A move of 1 rad in 1 s at {grams:g} g with a gauge offset of 0.05 N·m and the rig's gauge noise of "
    "{noise:g} N·m, simulated on the fractional link (λ = 1.92, c = 1.56 N·m) with M(s), 4 ms and one sample "
    "of delay. {end}"
)
_TITLES = {"in the loop": "in the loop (fraclink's own)"}


def tracking_pictures() -> list[Picture]:
    """The tip's tracking at 30, 40, 20, 16 and 8 g, and the gauge with its offset."""
    pictures = [_tracking(number, payload) for number, payload in _FIGURES]
    return [*pictures[:3], _gauge(), *pictures[3:]]


def _draw(axes: Axes, run: Run, line: str, color: str, style: object) -> None:
    # After the law has tripped, the arm is no longer controlled: the rest is not
    # tracking.
    alive = np.cumsum(run.mode != 1) == 0
    axes.plot(
        run.time[alive], run.tip_angle[alive], color=color, linestyle=style, label=line
    )
    if not alive.all():
        axes.plot(
            run.time[alive][-1],
            run.tip_angle[alive][-1],
            "x",
            color=color,
            markersize=7,
        )


def _tracking(number: int, payload: float) -> Picture:
    loops, moves = [], []
    with figure(WIDTH, 5.0) as drawing:
        panels = drawing.subplots(2, 2, sharex=True, sharey=True)
        for axes, pair in zip(panels.flat, tracking_pairs(), strict=True):
            for line, controller, color, style in (
                ("C'", pair.integer, ORANGE, (0, (4, 1.5))),
                ("C", pair.fractional, BLUE, "-"),
            ):
                run = move(controller, payload)
                _draw(axes, run, line, color, style)
                loop, reason = sampled(controller, payload), run.verdict.reason
                if not loop.stable:
                    loops.append(f"{pair.name}, {line}")
                elif reason.startswith(
                    "unstable"
                ):  # close enough to −1 that noise makes it oscillate
                    reason = f"noise, at a margin of {loop.margin:.1f}°:{reason.removeprefix('unstable:')}"
                if not run.verdict.passed:
                    moves.append(f"{pair.name}, {line}: {reason}")
            axes.plot(
                run.time,
                run.reference,
                color=GREY,
                linewidth=0.8,
                linestyle=(0, (1, 1)),
            )
            axes.set(
                title=_TITLES.get(pair.name, pair.name), xlim=(0, 5), ylim=(-0.1, 1.6)
            )
        for axes in panels[-1]:
            axes.set_xlabel("time [s]")
        drawing.supylabel("tip angle θt [rad]", fontsize=8.5)
        panels[0, 0].legend(loc="lower right")
        text = svg(
            drawing, f"fig{number}", f"Figure {number}: tracking at {1e3 * payload:g} g"
        )
    return Picture(
        f"fig{number}.svg",
        f"Fig. {number}: tracking at {1e3 * payload:g} g",
        _CAPTION.format(
            grams=1e3 * payload, noise=designs.rig().gauge.noise, end=_end(loops, moves)
        ),
        text,
    )


def _end(loops: list[str], moves: list[str]) -> str:
    """State what a plot of five seconds may hide: unstable loops and failed moves."""
    flag = (
        f"**Unstable loops**: {'; '.join(loops)}."
        if loops
        else "All eight loops are stable."
    )
    held = (
        f" Moves that fail: {'; '.join(moves)}." if moves else " All eight moves pass."
    )
    return (
        flag
        + held
        + (" ×: the law trips." if "trips" in held or "tripped" in held else "")
    )


def _gauge() -> Picture:
    run = move(designs.in_loop().fractional, 0.030)
    with figure(WIDTH, 2.4) as drawing:
        axes = drawing.subplots()
        axes.plot(
            run.time, run.torque_measured, color=GREY, linewidth=0.7, label="gauge"
        )
        axes.plot(run.time, run.torque, color=BLUE, label="true torque")
        axes.axhline(OFFSET, color=ORANGE, linewidth=0.8, label="offset")
        axes.set(xlabel="time [s]", ylabel="torque Γ [N·m]", xlim=(0, 5))
        axes.legend(ncols=3, loc="upper right")
        text = svg(drawing, "fig14", "Figure 14: the gauge during a move")
    left = 1e3 * abs(float(run.tip_angle[-1] - run.reference[-1]))
    caption = (
        "The move of Fig. 11 with fraclink's own in-loop controller, a stable loop, and gauge noise of "
        f"{designs.rig().gauge.noise:g} N·m: the gauge keeps its offset, the tip ends {left:.2f} mrad from "
        "its reference."
    )
    return Picture("fig14.svg", "Fig. 14: the gauge, with an offset", caption, text)
