"""The simulated moves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from fraclink._show.report.figures.drawing import FULL_WIDTH, envelope, grams
from fraclink._show.report.svg import GREY, LEVELS, figure, svg

if TYPE_CHECKING:
    from fraclink._simulate import Run

__all__ = ["moves_figure"]


def moves_figure(runs: Sequence[Run]) -> str:
    """Draw the tip's tracking, its error, the measured torque and the motor's voltage for every payload."""
    with figure(FULL_WIDTH, 6.2) as drawing:
        tip, error, torque, voltage = drawing.subplots(
            4, 1, sharex=True, gridspec_kw={"height_ratios": [2.2, 1.2, 1, 1]}
        )
        tip.plot(
            *envelope(runs[0].time, runs[0].reference), color=GREY, linestyle=(0, (4, 2)), label="reference"
        )
        for color, run in zip(LEVELS, runs, strict=False):
            tip.plot(*envelope(run.time, run.tip_angle), color=color, label=grams(run.payload))
            error.plot(*envelope(run.time, 1e3 * (run.tip_angle - run.reference)), color=color, linewidth=0.9)
            torque.plot(*envelope(run.time, run.torque_measured), color=color, linewidth=0.7)
            voltage.plot(*envelope(run.time, run.voltage), color=color, linewidth=0.7)
        tip.set_ylabel("tip angle θt [rad]")
        error.set_ylabel("tip error [mrad]")
        torque.set_ylabel("gauge Γ [N·m]")
        voltage.set_ylabel("motor [V]")
        voltage.set_xlabel("time [s]")
        voltage.set_xlim(runs[0].time[0], runs[0].time[-1])
        tip.legend(loc="lower right", ncols=4)
        drawing.align_ylabels()
        return svg(drawing, "moves", "Tip angle, tip error, torque and voltage of the simulated moves")
