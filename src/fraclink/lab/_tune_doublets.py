"""The motor from its response to doublets of voltage: the first guess of K/J, before
any loop is closed.

    θ'' = A (V(t − τ) − f sign θ') − B θ' + Γ/J

within each doublet, from rest. The link's torque Γ is as measured: a link that still
swings from the doublet before turns the motor as far as the voltage does. Coulomb
friction f [V] acts against the motion and holds the motor where it has stopped. With a
model in which it keeps its sign, A came out a third too small for small motions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.linalg import solve_banded

from fraclink.lab._tune_guard import Record, largest
from fracsys.checks import Real

__all__ = ["PULSE", "edges_of", "motor_of_doublets"]


# [s] of each half of a doublet: shorter than a quarter of the vibration period of any
# laboratory arm. No delay is longer, from a voltage to the motion or from the motion to
# the gauge.
PULSE = 0.04
# B [1/s]: a doublet of 80 ms cannot separate it from friction. Geared laboratory motors
# have 5 to 20, which changes A by a tenth; with 0 here, the delay of a motor with 20
# comes out half a period short.
_DECAY = 10.0
# parts of a period for the integration of a motion with friction; delays are multiples
# of two parts
_PARTS = 4
# Friction as a fraction of the doublets' voltage, in steps of one hundredth: half a
# step changes K/J by half a per cent. At 1 nothing would move.
_FRICTIONS = np.linspace(0.0, 0.95, 96)


def motor_of_doublets(
    record: Record, half: int, gauge_delay: float
) -> tuple[float, float, float]:
    """Return A [rad/(s²·V)], its standard error and the delay [s], from doublets of
    `half` periods in each direction, with a torque that is `gauge_delay` [s] late.
    """
    period, most = record.period, largest(record.voltage)
    shape, edges = _shape(half, period) * most, edges_of(record)
    late = round(gauge_delay / period)
    torque = np.append(record.torque[late:], np.full(late, record.torque[-1]))
    torque = torque - np.mean(torque)
    best = (np.inf, 0.0, np.inf, 0.0)
    # Half periods, since hold and amplifier do not add up to a whole number of periods.
    for halves in range(round(2 * PULSE / period) + 1):
        length = 2 * half + halves // 2
        begins = edges[edges + length <= record.angle.size]
        if not begins.size:
            continue
        window = begins[:, np.newaxis] + np.arange(length)
        signs = np.sign(record.voltage[begins])[:, np.newaxis]
        motions = record.angle[window] - record.angle[begins - 1, np.newaxis]
        motions, swings = signs * motions, signs * _swing(torque[window], period)
        steps = np.maximum(_PARTS * np.arange(length) - halves * _PARTS // 2, 0)
        ways = shape[:, steps]
        # Σ(motion − A · way − swing/J)² over all doublets, from sums of squares.
        own = begins.size * np.einsum("ij,ij->i", ways, ways)
        # A dead gauge shows no swing.
        other = float(np.sum(swings**2)) or 1.0
        both = ways @ np.sum(swings, axis=0)
        seen, pulled = ways @ np.sum(motions, axis=0), float(np.sum(swings * motions))
        apart = own * other - both**2
        gains = (other * seen - both * pulled) / apart
        masses = (own * pulled - both * seen) / apart
        cost = float(np.sum(motions**2)) - gains * seen - masses * pulled
        k = np.argmin(cost)
        # Errors of neighbouring samples are correlated: a doublet counts as one
        # observation.
        scatter = max(cost[k], 0.0) / begins.size
        error = float(np.sqrt(scatter * other / apart[k]))
        # Per sample, since a longer delay leads to a longer window and would otherwise
        # always have a larger cost.
        each = float(cost[k]) / (begins.size * length)
        if each < best[0]:
            best = (
                each,
                float(gains[k]),
                error,
                0.5 * halves * period,
            )
    return best[1:]


def _swing(torque: Real, period: float) -> Real:
    """Angle, from rest, for J = 1 and one row of torques."""
    # v[k] − exp(−DT) v[k−1] = T τ[k]. scipy.signal has such a filter, but its import
    # takes half a second.
    speed = solve_banded(
        (1, 0),
        np.outer([1.0, -np.exp(-_DECAY * period)], np.ones_like(torque[0])),
        period * torque.T,
    )
    return np.cumsum(speed, axis=0).T * period


def edges_of(record: Record) -> NDArray[np.intp]:
    """The periods in which a voltage begins after a rest."""
    active = record.voltage != 0
    return np.flatnonzero(active[1:] & ~active[:-1]) + 1


def _shape(half: int, period: float) -> Real:
    """Angle for A = 1 and a doublet of 1 V, one row per friction value, in parts of a
    period.
    """
    step, speed = period / _PARTS, np.zeros(_FRICTIONS.size)
    speeds = [speed]
    for part in range(2 * half * _PARTS):
        voltage = 1.0 if part < half * _PARTS else -1.0
        # At rest friction acts against the voltage, up to its limit.
        against = np.where(speed != 0.0, np.sign(speed), np.sign(voltage))
        new = speed + step * (voltage - _FRICTIONS * against - _DECAY * speed)
        speed = np.where(new * speed < 0.0, 0.0, new)  # it stops before it reverses
        speeds.append(speed)
    return cumulative_trapezoid(speeds, dx=step, axis=0, initial=0.0).T
