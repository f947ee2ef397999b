"""One run of a fault as a picture: tip, motor and gauge beside the clean run, and what the law did."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fraclink._campaign.faults import Bench, Evidence, Outcome, fault_named, observe
from fraclink._law import MODES
from fraclink._show.drawing import save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_outcome"]

_CLEAN, _FAULTY, _WANTED, _EVENT = "#9aa7ad", "#1f6f8b", "#444444", "#c0392b"


def draw_outcome(bench: Bench, outcome: Outcome, path: Path | str) -> None:
    """Run a case again and draw it; the kind of file follows the name (SVG, PNG, PDF).

    Raises MissingExtraError where matplotlib is not installed.
    """
    e = observe(bench, outcome.case, bench.law.in_precision("double"))
    title = f"{outcome.name}: {fault_named(outcome.case.fault).title}"
    verdict = str(outcome.failed[0]) if outcome.failed else "passed"

    def draw(drawing: Figure) -> None:
        axes = drawing.subplots(4, 1, sharex=True, height_ratios=(3, 2, 2, 1))
        for axis, panel in zip(axes, (_tip, _motor, _gauge, _mode), strict=True):
            panel(axis, e)
            axis.axvline(e.row * e.law.period, color=_EVENT, linewidth=0.8, linestyle=":")
            axis.spines[["top", "right"]].set_visible(False)
            axis.tick_params(labelsize=8)
        axes[-1].set_xlabel("time [s]")
        drawing.suptitle(f"{title}\n{verdict}", fontsize=10)

    save_figure(path, draw, size=(8.0, 7.2))


def _tip(axis: Axes, e: Evidence) -> None:
    axis.plot(e.clean.time, e.clean.tip, color=_CLEAN, label="tip, clean")
    axis.plot(e.faulty.time, e.faulty.tip, color=_FAULTY, label="tip, faulty")
    axis.plot(e.faulty.time, e.faulty.wanted, color=_WANTED, linewidth=0.8, linestyle="--", label="reference")
    axis.set_ylabel("angle [rad]", fontsize=8)
    axis.legend(fontsize=8, frameon=False, loc="best")


def _motor(axis: Axes, e: Evidence) -> None:
    axis.plot(e.faulty.time, e.faulty.motor, color=_CLEAN, label="motor, true")
    axis.plot(e.faulty.time, e.faulty.encoder, color=_EVENT, linewidth=0.6, label="encoder")
    axis.plot(e.faulty.time, e.faulty.command, color=_FAULTY, linewidth=0.8, label="motor reference")
    low, high = float(e.faulty.motor.min()), float(e.faulty.motor.max())
    edge = 0.2 * max(high - low, 0.5)
    axis.set_ylim(low - edge, high + edge)  # an encoder in degrees would flatten everything else
    axis.set_ylabel("motor [rad]", fontsize=8)
    axis.legend(fontsize=8, frameon=False, loc="best")


def _gauge(axis: Axes, e: Evidence) -> None:
    axis.plot(e.faulty.time, e.faulty.gauge, color=_EVENT, linewidth=0.6, label="gauge")
    axis.plot(e.faulty.time, e.faulty.torque, color=_CLEAN, label="torque, true")
    axis.set_ylabel("torque [N·m]", fontsize=8)
    axis.legend(fontsize=8, frameon=False, loc="best")


def _mode(axis: Axes, e: Evidence) -> None:
    axis.step(e.faulty.time, e.faulty.mode, where="post", color=_FAULTY)
    axis.set_yticks(range(len(MODES)), MODES)
    axis.set_ylim(-0.4, len(MODES) - 0.6)
