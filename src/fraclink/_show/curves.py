"""What the frequency plots draw: a response on a grid that looks smooth, its phase on the right sheet."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._show.axes import cycle, tint
from fraclink._systems.loops import SampledLoop, as_loop
from fraclink._systems.sweep import frequency_grid, refined
from fraclink.errors import FieldError, MissingExtraError

__all__ = ["LoopCurve", "finish", "labelled", "new_axes", "sample"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


def new_axes(rows: int = 1) -> Any:
    """New axes, one or one for each row; matplotlib.pyplot is imported when the first plot is drawn."""
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise MissingExtraError("matplotlib", "report") from error
    with pyplot.rc_context(cycle()):
        return pyplot.subplots(rows, 1, sharex=True, layout="constrained")[1]


def finish(ax: Any, labels: Sequence[str] | None) -> Any:
    """Give axes their grid, and a legend where the curves have labels; return them."""
    ax.grid(True, color=tint(ax, "faint"))
    if labels is not None:
        ax.legend(loc="best", fontsize="small")
    return ax


@dataclass(frozen=True)
class LoopCurve:
    """A response L(jω) at frequencies ω [rad/s]."""

    frequency: Real
    values: Complex

    @property
    def decibels(self) -> Real:
        """20 lg |L|."""
        with np.errstate(divide="ignore"):
            return np.asarray(20 * np.log10(np.abs(self.values)))

    @property
    def phase(self) -> Real:
        """arg L [rad], continuous; it starts within π of the low-frequency slope times π/2."""
        turns = np.angle(self.values[1:] / self.values[:-1])
        # Across a pole of the axis the phase falls by π, whichever sign rounding gave the jump.
        size = np.abs(self.values)
        over = (turns > 2.8) & (np.minimum(size[1:], size[:-1]) > np.median(size))
        turns[over] -= 2 * math.pi
        first = float(np.angle(self.values[0]))
        x = np.log(self.frequency[:2])
        slope = float(np.diff(np.log(size[:2]))[0] / (x[1] - x[0]))
        if math.isfinite(slope):
            first += 2 * math.pi * round((0.5 * math.pi * slope - first) / (2 * math.pi))
        return np.concatenate([[first], first + np.cumsum(turns)])


def sample(
    system: Any,
    frequency: ArrayLike | None,
    limit: float | None,
    drawn: Callable[[LoopCurve], tuple[Real, Real]] | None = None,
) -> LoopCurve:
    """The response on `frequency` [rad/s], or on its own grid refined until `drawn` looks smooth."""
    loop = as_loop(system, limit)
    if frequency is not None:
        w = np.asarray(frequency, dtype=float).reshape(-1)
        if w.size < 3 or not np.all(np.isfinite(w)) or np.any(w <= 0) or np.any(np.diff(w) <= 0):
            raise FieldError(
                "frequency",
                frequency,
                "not a grid of frequencies",
                allowed="three or more rising values > 0 rad/s",
                remedy="numpy.geomspace(0.1, 100.0, 300), or None for an automatic grid",
            )
        return _evaluated(loop, np.log(w))
    x = np.log(frequency_grid(system, limit=limit))
    if drawn is not None:
        x = refined(lambda at: drawn(_evaluated(loop, at)), x)
    return _evaluated(loop, x)


def _evaluated(loop: SampledLoop, x: Real) -> LoopCurve:
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        values = loop(x)
    # A pole or zero hit exactly is drawn as a gap in nothing: its neighbours are 1e-9 beside it.
    usual = np.isfinite(values) & (values != 0)
    return LoopCurve(np.exp(x), np.where(usual, values, math.nan))


def labelled(systems: Sequence[Any], labels: Sequence[str] | None) -> list[tuple[Any, str | None]]:
    """Systems with their labels."""
    if not systems:
        raise FieldError("systems", "none", "empty", allowed="one system or more", remedy="pass a loop")
    if labels is not None and len(labels) != len(systems):
        raise FieldError(
            "labels",
            list(labels),
            f"{len(labels)} labels for {len(systems)} systems",
            allowed="one label for each system",
            remedy="give as many labels as systems",
        )
    return [(system, None if labels is None else labels[i]) for i, system in enumerate(systems)]
