"""A loop over a box of uncertain parameters: a search for its worst point."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from fraclink._arm.loop import Loop

__all__ = ["worst_over_box"]

_INTERIOR = 200  # random points of a box beside its corners
# The parameters that a box may vary, and how each changes a loop; ω₀ is scaled by the caller.
_VARIED: dict[str, Callable[[Loop, float], Loop]] = {
    "order": lambda loop, x: replace(loop, link_order=x),
    "damping": lambda loop, x: replace(loop, damping=x),
    "damping_order": lambda loop, x: replace(loop, damping_order=x),
    "gauge_delay": lambda loop, x: replace(loop, gauge_delay=x),
    "gauge_gain": lambda loop, x: replace(loop, gauge_gain=x),
    "pole": lambda loop, x: replace(loop, lag=1.0 / x),
    "delay": lambda loop, x: replace(loop, delay=x),
    "natural_frequency_ratio": lambda loop, x: loop,
}


def worst_over_box(
    loop: Loop,
    low: float,
    high: float,
    box: Mapping[str, tuple[float, float]],
    *,
    seed: int = 0,
) -> tuple[float, dict[str, float]]:
    """Return the smallest signed |1 + L| over a box of parameters, and the point that has it.

    Every corner of the box and 200 random points inside, with ω₀ from `low` to `high`; unstable points count
    as negative. A search and no proof: `certify` encloses the same box.

    Parameters
    ----------
    loop
        the nominal loop.
    low, high
        range of ω₀ [s^(-λ/2)].
    box
        (low, high) of "order", "damping", "damping_order", "gauge_delay" [s], "gauge_gain", "pole" [rad/s],
        "delay" [s] (the whole τ) or "natural_frequency_ratio" (true over nominal ω₀).

    Raises
    ------
    KeyError
        a parameter of another name.
    """
    names = tuple(box)
    ends = np.array([box[name] for name in names], dtype=float).reshape(len(names), 2)
    corners = np.array(np.meshgrid(*ends, indexing="ij")).reshape(len(names), -1).T
    inside = ends[:, 0] + np.random.default_rng(seed).random((_INTERIOR, len(names))) * np.diff(ends).T
    worst, place = math.inf, dict.fromkeys(names, math.nan)
    w0 = np.geomspace(low, high, 5)
    # The worst is at a corner as a rule, since the margins are monotone in most of these; the points inside
    # are there for the parameters in which they are not, such as a gauge delay beside a second mode.
    for point in np.concatenate([corners, inside]) if names else corners:
        varied, values = loop, dict(zip(names, map(float, point), strict=True))
        for name, value in values.items():
            varied = _VARIED[name](varied, value)
        links = w0 * values.get("natural_frequency_ratio", 1.0)
        distance = 1.0 / varied.sensitivity_peak(links)
        # |1 + L| is a distance and positive on the unstable side as well: its sign comes from the margins.
        signed = float(np.min(np.where(varied.margins(links)[1] > 0.0, distance, -distance)))
        if signed < worst:
            worst, place = signed, values
    return worst, place
