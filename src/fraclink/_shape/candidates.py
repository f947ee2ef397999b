"""What a shaped move is measured against: the quintic and the input shapers, each at its best.

All are given the same loop, payloads and limits as the linear programme. The quintic is tried at every
duration, a shaper at every duration of the quintic that it shapes and around the link's frequency, since
feedback moves the vibration away from there. The one that settles first within the limits is kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel
from fraclink._arm.reference import Reference, smooth_step
from fraclink._arm.shapers import SHAPERS, Shaped, Shaper, shaper_impulses
from fraclink._shape.programme import MoveBounds
from fraclink._shape.responses import Responses

__all__ = ["Candidate", "candidates", "settling"]

Real = NDArray[np.float64]

_DURATIONS = np.geomspace(0.15, 4.0, 40)  # of the quintic, over the link's vibration period
_FREQUENCIES = np.linspace(0.7, 1.6, 10)  # of the shaper's mode, over the link's


@dataclass(frozen=True)
class Candidate:
    """A reference, how it was made, what the linear loop promises, and the time that it took to find [s].

    Promised is when the tip of the worst payload has settled [s], along a path its largest distance [rad].
    """

    name: str
    reference: Reference
    predicted: float
    computing_time: float = math.nan


def settling(tip: Real, move: float, band: float, period: float) -> float:
    """Return when every row of `tip`, (payloads, N), stays within `band` of `move` [rad]; inf for never."""
    outside = np.any(np.abs(tip - move) > band, axis=0)
    if outside[-1]:
        return math.inf
    return period * (len(outside) - int(np.argmax(outside[::-1]))) if outside.any() else 0.0


def _kept(loops: Responses, bounds: MoveBounds, reference: Reference) -> bool:
    time = loops.period * np.arange(loops.length)
    if np.abs(reference.velocity(time)).max() > bounds.velocity:
        return False
    if np.abs(reference.acceleration(time)).max() > bounds.acceleration:
        return False
    peaks = np.abs(loops.to(reference, tuple(bounds.signals))).max(axis=(0, 2))
    return bool(np.all(peaks <= list(bounds.signals.values())))


def _tried(kind: Shaper | None, move: float, link: LinkModel) -> Iterator[tuple[str, Reference]]:
    pole = link.pole
    frequency, ratio = abs(pole), -pole.real / abs(pole)
    vibration = 2 * math.pi / abs(pole.imag)
    for duration in (_DURATIONS * vibration).tolist():
        base = smooth_step(move, duration)
        if kind is None:
            yield f"quintic of {duration:.2f} s", base
            continue
        for factor in _FREQUENCIES.tolist():
            times, sizes = shaper_impulses(kind, factor * frequency, ratio)
            name = f"{kind} at {factor * frequency:.1f} rad/s on a quintic of {duration:.2f} s"
            yield name, Shaped(base, tuple(times.tolist()), tuple(sizes.tolist()))


def candidates(
    loops: Responses, move: float, band: float, bounds: MoveBounds, link: LinkModel
) -> tuple[Candidate, ...]:
    """Return the best quintic, ZV, ZVD and EI for a move [rad]; none of a kind that keeps no bound."""
    found = []
    for kind in (None, *SHAPERS):
        best: Candidate | None = None
        began = perf_counter()
        for name, reference in _tried(kind, move, link):
            time = settling(loops.to(reference, ("tip",))[:, 0], move, band, loops.period)
            if (best is None or time < best.predicted) and _kept(loops, bounds, reference):
                best = Candidate(name, reference, time)
        found += [] if best is None else [replace(best, computing_time=perf_counter() - began)]
    return tuple(found)
