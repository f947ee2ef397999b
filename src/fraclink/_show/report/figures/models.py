"""The models over the measured output, and what they leave over."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from fraclink._show.report.figures.drawing import FULL_WIDTH, envelope
from fraclink._show.report.figures.log import OUTPUT_LABEL
from fraclink._show.report.svg import GREY, INK, LEVELS, figure, svg

if TYPE_CHECKING:
    from fraclink._identify import Fit

__all__ = ["models_figure"]

_LARGE = 4.0  # a residual so many times the smallest gets a scale of its own: else the others are flat lines
_DETAIL = 0.18  # share of the log that the upper panel shows: the whole would be a band of ink


def models_figure(fits: Mapping[str, Fit]) -> str:
    """Draw a detail of the measured output under the models, and every model's residual."""
    some = next(iter(fits.values()))
    time, measured = some.period * np.arange(some.samples), some.predicted + some.residual
    with figure(FULL_WIDTH, 2.4 + 0.8 * len(fits)) as drawing:
        panels = drawing.subplots(1 + len(fits), 1, gridspec_kw={"height_ratios": [2.8] + [1] * len(fits)})
        detail, rows = panels[0], panels[1:]
        part = slice(0, max(2, int(_DETAIL * some.samples)))
        detail.plot(time[part], measured[part], color=GREY, linewidth=2.6, alpha=0.5, label="measured")
        for color, (name, fit) in zip(LEVELS, fits.items(), strict=False):
            detail.plot(time[part], fit.predicted[part], color=color, linewidth=0.9, label=name)
        detail.set_ylabel(OUTPUT_LABEL[some.output_kind])
        detail.set_xlim(time[0], time[part][-1])
        detail.legend(ncols=1 + len(fits), loc="lower left")
        sizes = [1.1 * float(np.abs(fit.residual).max()) or 1.0 for fit in fits.values()]
        common = max(size for size in sizes if size <= _LARGE * min(sizes))
        for color, row, (name, fit) in zip(LEVELS, rows, fits.items(), strict=False):
            row.plot(*envelope(time, fit.residual), color=color, linewidth=0.5)
            own = 1.1 * float(np.abs(fit.residual).max())
            size = common if own <= common else own
            row.set_ylim(-size, size)
            row.set_xlim(time[0], time[-1])
            row.set_ylabel(name)
            row.axvline(time[fit.fitted_samples - 1], color=INK, linewidth=0.8, linestyle=(0, (2, 2)))
            row.tick_params(labelbottom=row is rows[-1])
        rows[-1].set_xlabel("time [s]; residuals measured − model, held out right of the dashed line")
        drawing.align_ylabels()
        return svg(drawing, "models", "The models over the measured output, and their residuals")
