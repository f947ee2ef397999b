"""Figures of campaigns: how metrics are spread, where runs fail, and the design map on the twin."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._campaign import Summary
from fraclink._show.report.figures.drawing import FULL_WIDTH
from fraclink._show.report.svg import BLUE, INK, ORANGE, figure, svg

__all__ = ["SHOWN", "drivers_figure", "failures_figure", "spread_figure"]

# Metric, title, factor to the shown unit.
SHOWN = (
    ("settling_time", "settling time [s]", 1.0),
    ("overshoot", "overshoot [%]", 100.0),
    ("residual_vibration", "residual vibration [mrad]", 1e3),
    ("peak_tip_error", "largest tip error [mrad]", 1e3),
    ("peak_voltage", "largest voltage [V]", 1.0),
    ("motor_reference_noise", "motor reference noise [mrad]", 1e3),
)
_FAILED = "#a8321f"


def spread_figure(values: dict[str, NDArray[Any]]) -> str:
    """Histograms of the metrics in SHOWN with their median and 95 % quantile."""
    with figure(FULL_WIDTH, 4.2) as drawing:
        for axes, (name, title, factor) in zip(drawing.subplots(2, 3).flat, SHOWN, strict=True):
            column = factor * np.asarray(values[name], dtype=float)
            finite = column[np.isfinite(column)]
            if finite.size:
                top = float(np.quantile(finite, 0.999))
                low = float(finite.min())
                axes.hist(np.clip(finite, low, top), bins=60, color=BLUE, alpha=0.75, linewidth=0)
                for share, colour in ((0.5, INK), (0.95, ORANGE)):
                    axes.axvline(
                        float(np.quantile(finite, share)),
                        color=colour,
                        label=f"{100 * share:g} % of the finite",
                    )
            missing = len(column) - len(finite)
            axes.set_title(title)
            if missing:
                text = f"never: {100 * missing / len(column):.3g} %"
                axes.text(0.98, 0.95, text, ha="right", va="top", color=_FAILED, transform=axes.transAxes)
            axes.set_yticks([])
        drawing.axes[1].legend(loc="upper right")
        return svg(drawing, "spread", "Histograms of the metrics of all runs")


def failures_figure(
    across: NDArray[Any], up: NDArray[Any], failed: NDArray[Any], names: tuple[str, str]
) -> str:
    """Share of runs that fail over two drawn parameters, whose axes `names` title."""
    runs, edges_x, edges_y = np.histogram2d(across, up, bins=14)
    bad, _, _ = np.histogram2d(across[failed], up[failed], bins=(edges_x, edges_y))
    with np.errstate(invalid="ignore"):
        share = np.where(runs > 0, 100.0 * bad / runs, np.nan)
    with figure(0.62 * FULL_WIDTH, 3.4) as drawing:
        axes = drawing.subplots()
        axes.grid(visible=False)
        top = max(1.0, float(np.nanmax(share)))
        mesh = _cells(axes, share.T, "OrRd", 0.0, top, edges=(edges_x, edges_y))
        _bar(drawing, mesh, axes, "runs that do not hold [%]")
        axes.set_xlabel(names[0])
        axes.set_ylabel(names[1])
        return svg(drawing, "failures", "Share of failing runs over two parameters")


def _cells(axes: Any, values: Any, colours: str, low: float, top: float, *, edges: Any = None) -> Any:
    """Coloured rectangles: an image is a picture inside the SVG, which the page refuses."""
    from matplotlib import colormaps

    table = np.asarray(values, dtype=float)
    x, y = edges or (np.arange(table.shape[1] + 1) - 0.5, np.arange(table.shape[0] + 1) - 0.5)
    return axes.pcolormesh(x, y, table, cmap=colormaps[colours].resampled(24), vmin=low, vmax=top)


def _bar(drawing: Any, mesh: Any, axes: Any, label: str) -> None:
    bar = drawing.colorbar(mesh, ax=axes)
    bar.solids.set_rasterized(False)
    bar.set_label(label)


def drivers_figure(summary: Summary) -> str:
    """Spearman's rank correlation of every metric with every parameter as a table in colours."""
    metrics = [m for m in summary.metrics if m.name != "saturated"]
    names = sorted({p for p, _ in metrics[0].drivers})
    table = np.array([[dict(m.drivers)[p] for p in names] for m in metrics])
    with figure(FULL_WIDTH, 3.4) as drawing:
        axes = drawing.subplots()
        axes.grid(visible=False)
        image = _cells(axes, table, "RdBu_r", -1.0, 1.0)
        axes.invert_yaxis()
        axes.set_xticks(range(len(names)), [n.replace("_", " ") for n in names], rotation=30, ha="right")
        axes.set_yticks(range(len(metrics)), [m.name.replace("_", " ") for m in metrics])
        for (row, column), value in np.ndenumerate(table):
            if abs(value) >= 0.05:
                colour = "white" if abs(value) > 0.6 else INK
                axes.text(column, row, f"{value:+.2f}", ha="center", va="center", color=colour, fontsize=7)
        _bar(drawing, image, axes, "rank correlation")
        return svg(drawing, "drivers", "Rank correlation of metrics with parameters")
