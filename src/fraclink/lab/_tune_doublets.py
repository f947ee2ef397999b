"""The motor as doublets of voltage show it: the first guess of K/J, before any loop is
closed.

    θ'' = A (V(t − τ) − f sign θ') − B θ'

within each doublet, from rest. Coulomb friction f [V] brakes the motor against its
motion and holds it where it has stopped: taken for a force that keeps its sign, it
stops a motor on the model's way that the real one has not gone, and A of small motions
came out a third too small.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fraclink.lab._tune_guard import Record

__all__ = ["edges_of", "motor_of_doublets"]

Real = NDArray[np.float64]

_LATEST = 0.0401  # [s]
# B [1/s]: a doublet of 80 ms does not tell it from friction. A geared motor of a
# laboratory has 5 to 20, which moves A by a tenth; with 0 the delay comes out half a
# period short.
_DECAY = 10.0
# of a period, in which a motion under friction is added up; delays are whole numbers of
# two
_PARTS = 4
# A hundredth of the voltage apart: half a step is half a per cent of K/J. At 1 nothing
# would move.
_FRICTIONS = np.linspace(0.0, 0.95, 96)  # of the doublets' voltage


def motor_of_doublets(record: Record, half: int) -> tuple[float, float, float, float]:
    """(A [rad/(s²·V)], its standard error, friction [V], delay [s]); doublets of `half`
    periods each way.
    """
    period, most = record.period, float(np.max(np.abs(record.voltage)))
    shape, edges = _shape(half, period) * most, edges_of(record)
    best = (np.inf, 0.0, np.inf, 0.0, 0.0)
    # Half periods, as hold and amplifier add up to no whole number of them.
    for halves in range(round(2 * _LATEST / period) + 1):
        length = 2 * half + halves // 2
        begins = edges[edges + length <= record.angle.size]
        if not begins.size:
            continue
        signs = np.sign(record.voltage[begins])[:, np.newaxis]
        angles = record.angle[begins[:, np.newaxis] + np.arange(length)]
        motions = signs * (angles - record.angle[begins - 1, np.newaxis])
        late = np.maximum(_PARTS * np.arange(length) - halves * _PARTS // 2, 0)
        ways = shape[:, late]
        size = np.einsum("ij,ij->i", ways, ways)
        gains = ways @ np.sum(motions, axis=0) / (begins.size * size)
        # Σ(motion − gain · way)² over all doublets, in squares of sums.
        cost = float(np.sum(motions**2)) - begins.size * gains**2 * size
        k = int(np.argmin(cost))
        # Errors of neighbours are alike: a doublet counts as one observation.
        error = float(
            np.sqrt(max(cost[k], 0.0) / begins.size / (begins.size * size[k]))
        )
        # Per sample, as a longer delay looks at a longer stretch and would otherwise
        # always cost more.
        each = float(cost[k]) / (begins.size * length)
        if each < best[0]:
            best = (
                each,
                float(gains[k]),
                error,
                most * float(_FRICTIONS[k]),
                0.5 * halves * period,
            )
    return best[1], best[2], best[3], best[4]


def edges_of(record: Record) -> NDArray[np.intp]:
    """The periods in which a voltage begins after a rest."""
    driven = record.voltage != 0
    return np.flatnonzero(driven[1:] & ~driven[:-1]) + 1


def _shape(half: int, period: float) -> Real:
    """Angle of A = 1 under a doublet of 1 V, one row for each friction, in parts of a
    period.
    """
    step, angle, speed = (
        period / _PARTS,
        np.zeros(_FRICTIONS.size),
        np.zeros(_FRICTIONS.size),
    )
    rows = [angle]
    for part in range(2 * half * _PARTS):
        voltage = 1.0 if part < half * _PARTS else -1.0
        # At rest friction is against the voltage, and holds up to its size.
        against = np.where(speed != 0.0, np.sign(speed), np.sign(voltage))
        new = speed + step * (voltage - _FRICTIONS * against - _DECAY * speed)
        new = np.where(new * speed < 0.0, 0.0, new)  # it stops before it turns round
        angle = angle + 0.5 * step * (speed + new)
        speed = new
        rows.append(angle)
    return np.array(rows).T
