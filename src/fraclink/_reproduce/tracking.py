"""Figs. 11 to 16: moves with the printed, the corrected and the in-loop controllers, side by side."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from fraclink._reproduce import designs
from fraclink._reproduce.pictures import WIDTH, Picture, controllers
from fraclink._show.report.svg import BLUE, GREY, ORANGE, figure, svg

if TYPE_CHECKING:
    from fraclink._law import Law
    from fraclink._simulate import Run

__all__ = ["tracking_pictures"]

_OFFSET = 0.05  # N·m: the paper prints none; Fig. 14 shows a small one
_FIGURES = ((11, 0.030), (12, 0.040), (13, 0.020), (15, 0.016), (16, 0.008))
_CAPTION = (
    "A move of 1 rad in 1 s at {grams:g} g with a gauge offset of 0.05 N·m, simulated on the fractional link "
    "(λ = 1.92, c = 1.56 N·m) with M(s), 4 ms and one sample of delay. {end}"
)


@cache
def _laws() -> dict[tuple[str, str], Law]:
    period = designs.rig().period
    return {(pair, line): controller.discretize(period) for pair, line, controller in controllers()}


def _run(law: Law, payload: float, noise: float = 0.0) -> Run:
    from fraclink._arm.reference import smooth_step
    from fraclink._simulate import simulate

    return simulate(
        designs.rig(),
        designs.link(0.030),
        law,
        smooth_step(1.0, duration=1.0),
        payload=payload,
        duration=5.0,
        noise=noise,
        gauge_offset=_OFFSET,
        seed=1,
    )


def tracking_pictures() -> list[Picture]:
    """The tip's tracking at 30, 40, 20, 16 and 8 g, and the gauge with its offset."""
    pictures = [_tracking(number, payload) for number, payload in _FIGURES]
    return [*pictures[:3], _gauge(), *pictures[3:]]


def _tracking(number: int, payload: float) -> Picture:
    laws = _laws()
    ends = []
    with figure(WIDTH, 3.1) as drawing:
        panels = drawing.subplots(1, 3, sharey=True)
        for axes, name in zip(panels, dict.fromkeys(pair for pair, _ in laws), strict=True):
            for line, color, style in (("C'", ORANGE, (0, (4, 1.5))), ("C", BLUE, "-")):
                run = _run(laws[name, line], payload)
                # A tripped law leaves the arm to itself: what follows is no tracking.
                alive = np.cumsum(run.mode != 1) == 0
                axes.plot(run.time[alive], run.tip_angle[alive], color=color, linestyle=style, label=line)
                if not alive.all():
                    axes.plot(run.time[alive][-1], run.tip_angle[alive][-1], "x", color=color, markersize=7)
                if not run.verdict.passed:
                    ends.append(f"{name}, {line}: {run.verdict.reason}.")
            axes.plot(run.time, run.reference, color=GREY, linewidth=0.8, linestyle=(0, (1, 1)))
            axes.set(title=name, xlabel="time [s]", xlim=(0, 5), ylim=(-0.1, 1.6))
        panels[0].set_ylabel("tip angle θt [rad]")
        panels[-1].legend(loc="lower right")
        text = svg(drawing, f"fig{number}", f"Figure {number}: tracking at {1e3 * payload:g} g")
    end = "All six hold." if not ends else " ".join(ends)
    return Picture(
        f"fig{number}.svg",
        f"Fig. {number}: tracking at {1e3 * payload:g} g",
        _CAPTION.format(grams=1e3 * payload, end=end) + (" ×: the law trips." if "trips" in end else ""),
        text,
    )


def _gauge() -> Picture:
    run = _run(_laws()["in the loop", "C"], 0.030, noise=designs.rig().gauge.noise)
    with figure(WIDTH, 2.4) as drawing:
        axes = drawing.subplots()
        axes.plot(run.time, run.torque_measured, color=GREY, linewidth=0.7, label="gauge")
        axes.plot(run.time, run.torque, color=BLUE, label="true torque")
        axes.axhline(_OFFSET, color=ORANGE, linewidth=0.8, label="offset")
        axes.set(xlabel="time [s]", ylabel="torque Γ [N·m]", xlim=(0, 5))
        axes.legend(ncols=3, loc="upper right")
        text = svg(drawing, "fig14", "Figure 14: the gauge during a move")
    left = 1e3 * abs(float(run.tip_angle[-1] - run.reference[-1]))
    caption = (
        "The move of Fig. 11 with the in-loop controller and gauge noise of "
        f"{designs.rig().gauge.noise:g} N·m: "
        f"the gauge keeps its offset, the tip ends {left:.2f} mrad from its reference."
    )
    return Picture("fig14.svg", "Fig. 14: the gauge, with an offset", caption, text)
