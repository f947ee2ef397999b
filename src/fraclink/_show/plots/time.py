"""Step responses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from fraclink._show.plots.curves import labelled, pyplot
from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.loops import FractionalLoop
from fraclink._systems.response import step_response
from fraclink._systems.stability import poles
from fraclink.errors import FieldError

__all__ = ["step"]

_POINTS = 1000
_TIMES = 8.0  # time constants of the slowest pole: what is left of it is 3e-4


def step(
    *systems: FractionalTransferFunction,
    duration: float | None = None,
    ax: Any = None,
    labels: Sequence[str] | None = None,
    **style: Any,
) -> Any:
    """Draw exact responses to a unit step from rest.

    Parameters
    ----------
    *systems : FractionalTransferFunction
        Proper.
    duration : float, optional
        Length of the time axis [s], > 0; without it eight time constants of the slowest pole.
    ax : Axes, optional
    labels : sequence of str, optional
        One for each system, shown in a legend.
    **style
        Passed to `Axes.plot`.

    Returns
    -------
    Axes

    Examples
    --------
    >>> from fraclink._systems.fractional import s
    >>> axis = step(100 / (s**1.92 + 100), duration=2.0)
    >>> axis.get_xlabel()
    'time [s]'
    """
    named = labelled(systems, labels)
    if duration is None:
        duration = max(_duration(system) for system in systems)
    if not (math.isfinite(duration) and duration > 0):
        raise FieldError(
            "duration", duration, "not a length of time", allowed="> 0 s", remedy="give the seconds to show"
        )
    if ax is None:
        _, ax = pyplot().subplots(layout="constrained")
    time = np.linspace(0.0, duration, _POINTS)
    for system, label in named:
        ax.plot(time, step_response(system, time).output, label=label, **style)
    ax.set(xlabel="time [s]", ylabel="step response", xlim=(0, duration))
    ax.grid(True, color="0.9")
    if labels is not None:
        ax.legend(loc="best", fontsize="small")
    return ax


def _duration(system: FractionalTransferFunction) -> float:
    """Eight time constants of the slowest stable pole; of the lowest corner where there is none."""
    delay = max(t.delay for t in system.numerator)
    if not any(t.delay for t in system.denominator):
        rates = -poles(system).real
        if np.any(rates > 0):
            return float(_TIMES / rates[rates > 0].min()) + 2 * delay
    low, _ = FractionalLoop.of(system, None).span
    return _TIMES / math.exp(low) + 2 * delay
