"""The log as it was recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fraclink._show.report.figures.drawing import FULL_WIDTH, envelope
from fraclink._show.report.svg import BLUE, INK, figure, svg

if TYPE_CHECKING:
    from fraclink._arm.experiment import Experiment

__all__ = ["OUTPUT_LABEL", "log_figure"]

OUTPUT_LABEL = {"torque": "base torque Γ [N·m]", "deflection": "deflection θm − θt [rad]"}


def log_figure(log: Experiment) -> str:
    """Draw motor angle and output against time."""
    with figure(FULL_WIDTH, 3.4) as drawing:
        above, below = drawing.subplots(2, 1, sharex=True)
        above.plot(*envelope(log.time, log.motor_angle), color=INK, linewidth=0.9)
        above.set_ylabel("motor angle θm [rad]")
        below.plot(*envelope(log.time, log.output), color=BLUE, linewidth=0.8)
        below.set_ylabel(OUTPUT_LABEL[log.output_kind])
        below.set_xlabel("time [s]")
        below.set_xlim(log.time[0], log.time[-1])
        drawing.align_ylabels()
        return svg(drawing, "log", "The recorded motor angle and output against time")
