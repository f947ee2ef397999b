"""The models over the measured output, and what they leave over."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fraclink.report.figures.drawing import FULL_WIDTH, envelope
from fraclink.report.figures.log import OUTPUT_LABEL
from fraclink.report.svg import GREY, INK, LEVELS, figure, svg

if TYPE_CHECKING:
    from fraclink.experiment import Experiment
    from fraclink.identify import Comparison

__all__ = ["models_figure"]

_DETAIL = 0.18  # share of the log that the upper panel shows: the whole would be a band of ink


def models_figure(log: Experiment, comparison: Comparison) -> str:
    """Draw a detail of the measured output under the four models, and every model's residual."""
    fits = comparison.fits
    with figure(FULL_WIDTH, 5.6) as drawing:
        panels = drawing.subplots(1 + len(fits), 1, gridspec_kw={"height_ratios": [2.6] + [1] * len(fits)})
        detail, rows = panels[0], panels[1:]
        last = max(2, int(_DETAIL * len(log.time)))
        time = log.time[:last]
        detail.plot(time, log.output[:last], color=GREY, linewidth=2.4, alpha=0.55, label="measured")
        for color, (name, fit) in zip(LEVELS, fits.items(), strict=False):
            detail.plot(time, fit.predicted[:last], color=color, linewidth=0.9, label=name)
        detail.set_ylabel(OUTPUT_LABEL[log.output_kind])
        detail.set_xlim(time[0], time[-1])
        detail.legend(ncols=1 + len(fits), loc="upper right")
        size = 1.1 * max(float(abs(fit.residual).max()) for fit in fits.values())
        for color, row, (name, fit) in zip(LEVELS, rows, fits.items(), strict=False):
            row.plot(*envelope(log.time, fit.residual), color=color, linewidth=0.5)
            row.set_ylim(-size, size)
            row.set_xlim(log.time[0], log.time[-1])
            row.set_ylabel(name)
            row.axvline(log.time[fit.fitted_samples - 1], color=INK, linewidth=0.8, linestyle=(0, (2, 2)))
            row.tick_params(labelbottom=row is rows[-1])
        rows[-1].set_xlabel("time [s]; residuals measured − model, held out right of the dashed line")
        drawing.align_ylabels()
        return svg(drawing, "models", "The four models over the measured output, and their residuals")
