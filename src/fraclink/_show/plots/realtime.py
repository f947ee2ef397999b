"""The times of a run in real time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from fraclink._show.plots.curves import pyplot

if TYPE_CHECKING:
    from fraclink._realtime import RealtimeRun

__all__ = ["latency"]

_BINS = 80  # over some four decades: a factor of 1.12 each
_LEAST = 1e-7  # [s]: below, a monotonic clock read twice says nothing


def latency(run: RealtimeRun, *, ax: Any = None) -> Any:
    """Draw how late the loop woke up and how long its work took, as histograms on logarithmic axes.

    What counts is the tail: one late period in a thousand is a bar of its own. The period is a dashed line;
    latency and work together must stay left of it.

    Parameters
    ----------
    run : RealtimeRun
        From `fraclink._realtime.run_realtime`.
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> import fraclink as fl
    >>> from fraclink._realtime import Callback, run_realtime
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.Controller(gain=0.069876, order=0.612197, link=rig.model).discretize(rig.period, order=4)
    >>> at_rest = Callback(read=lambda: (0.0, 0.0), write=lambda command: None)
    >>> run = run_realtime(law, fl.hold(0.0), at_rest, duration=0.04, priority=0, lock_memory=False)
    >>> latency(run).get_xlabel()
    'time [µs]'
    """
    if ax is None:
        _, ax = pyplot().subplots(layout="constrained")
    longest = max(run.period, *(float(np.max(x, initial=0.0)) for x in (run.latency, run.work)))
    bins = 1e6 * np.geomspace(_LEAST, 2 * longest, _BINS)
    for label, values in (("latency of the wake-up", run.latency), ("work of the period", run.work)):
        ax.hist(1e6 * np.maximum(values, _LEAST), bins=bins, label=label, alpha=0.8)
    ax.axvline(1e6 * run.period, color="0.3", linestyle="--", linewidth=1.0, label="period")
    ax.set(xscale="log", yscale="log", xlabel="time [µs]", ylabel="periods")
    ax.set_ylim(0.5, 10 ** math.ceil(math.log10(max(len(run.latency), 1)) + 0.1))
    ax.legend(loc="best", fontsize="small")
    return ax
