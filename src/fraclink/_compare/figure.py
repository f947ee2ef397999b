"""The tournament as a picture: one row a rival, one column a figure."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from fraclink._files import atomic_write
from fraclink.errors import MissingExtraError

if TYPE_CHECKING:
    from fraclink._compare.tournament import Tournament

__all__ = ["draw"]

# Attribute, title, factor, logarithmic axis with its left end.
_PANELS = (
    ("settling_time", "settling [s]", 1.0, None),
    ("worst_settling", "settling, worst payload [s]", 1.0, None),
    ("residual_vibration", "residual vibration [mrad]", 1e3, 0.1),
    ("offset_error", "tip error by 0.05 N·m offset [mrad]", 1e3, 0.001),
    ("motor_reference_noise", "motor reference noise [mrad]", 1e3, 0.1),
    ("mode_gain", "loop gain at mode 2", 1.0, 0.001),
)
_OURS, _RIVAL, _FAILED = "#1f6f8b", "#b9c4c9", "#c0392b"


def draw(result: Tournament, path: Path | str) -> None:
    """Draw bars for every rival and figure; a red cross where a figure is infinite.

    Raises MissingExtraError where matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise MissingExtraError("matplotlib", "report") from error
    names = [s.name for s in result.standings]
    rows = list(range(len(names)))
    figure = Figure(figsize=(13.0, 0.34 * len(names) + 1.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(_PANELS), sharey=True)
    for axis, (attribute, title, factor, left) in zip(axes, _PANELS, strict=True):
        values = [factor * float(getattr(s, attribute)) for s in result.standings]
        finite = [0.0 if math.isinf(v) else v for v in values]
        colours = [_OURS if name.startswith("fraclink") else _RIVAL for name in names]
        if left is not None:
            axis.set_xscale("log")
            finite = [max(v, left) for v in finite]
            axis.set_xlim(left, 2.0 * max(*finite, 10.0 * left))
        axis.barh(rows, finite, color=colours)
        for row, value in enumerate(values):
            if math.isinf(value):
                axis.text(
                    0.03, row, "never", color=_FAILED, va="center", transform=axis.get_yaxis_transform()
                )
        axis.set_title(title, fontsize=8)
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_yticks(rows, names)
    axes[0].invert_yaxis()
    kind = Path(path).suffix.lstrip(".").lower() or "svg"
    with atomic_write(path, "wb") as stream:
        # Without a date and with fixed ids the same result gives the same bytes.
        figure.savefig(
            stream, format=kind, **({"metadata": {"Date": None}} if kind == "svg" else {"dpi": 110})
        )
