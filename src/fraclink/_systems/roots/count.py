"""How many zeros: the argument principle on strips and boxes of the log-plane."""

from __future__ import annotations

import numpy as np

from fraclink._systems.roots.exponential import ExponentialSum
from fraclink.errors import NotConvergedError

__all__ = ["count_box", "count_strip"]


def _whole(turns: float) -> int:
    if abs(turns - round(turns)) > 1e-3:
        raise NotConvergedError(
            "winding number",
            reached=turns,
            wanted=round(turns),
            remedy="the coefficients differ by too many orders of magnitude; scale s",
        )
    return round(turns)


def count_strip(sum_: ExponentialSum, height: float) -> int:
    """Number of zeros with |Im z| < `height`, multiplicities and conjugates counted.

    D is real on the real axis, so half the contour suffices: right side up, top line back, left side down.
    """
    low, high = sum_.bounds
    # Ten pieces are right for three terms; the walk halves those that are too long.
    top = np.linspace(high, low, 11) + 1j * height
    start = np.concatenate([[high], top])
    end = np.concatenate([top, [low]])
    return _whole(sum_.phase_change(start.astype(complex), end.astype(complex)) / np.pi)


def count_box(sum_: ExponentialSum, low: complex, high: complex) -> int:
    """Number of zeros in the open rectangle with the corners `low` (left, below) and `high`."""
    corners = np.array([low, complex(high.real, low.imag), high, complex(low.real, high.imag), low])
    start, end = corners[:-1], corners[1:]
    pieces = np.linspace(0, 1, 5)
    path = start[:, None] + pieces * (end - start)[:, None]
    return _whole(sum_.phase_change(path[:, :-1].ravel(), path[:, 1:].ravel()) / (2 * np.pi))
