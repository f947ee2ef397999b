"""The distance of a loop from −1, and the Nyquist criterion, on a swept response."""

from __future__ import annotations

import cmath
import math

import numpy as np

from fracsys._loops import FAINT, SampledLoop
from fracsys._sweep import TURN, modulus_slope, valleys, zeros_of
from fracsys.checks import Complex, Real


def modulus_margin(loop: SampledLoop, x: Real, values: Complex) -> tuple[float, float]:
    """inf |1 + L| and its frequency [rad/s], 0 or inf if it is approached but not
    reached.
    """
    distance = np.abs(1 + values)
    distance[np.isnan(distance)] = math.inf
    best = int(np.argmin(distance))
    smallest, at = float(distance[best]), float(x[best])
    # The sweep lets 1 + L change by up to its own size between neighbours; the distance
    # to −1 may be smaller between them than at either.
    brackets = [
        (float(x[i - 1]), float(x[i + 1])) for i in valleys(distance, spare=3.0)
    ]
    for place, value in zeros_of(loop, modulus_slope, brackets):
        if abs(1 + value) <= smallest:
            smallest, at = abs(1 + value), place
    frequency = math.exp(at)
    # A distance that decreases towards an end of the axis has its infimum there, not at
    # a finite frequency.
    for limit, place in zip(loop.ends, (0.0, math.inf), strict=True):
        if abs(1 + limit) < smallest:
            smallest, frequency = abs(1 + limit), place
    return smallest, frequency


# --- The Nyquist criterion on a swept response, with indentations around poles on the axis ------------


def unstable_closed_loop_poles(
    loop: SampledLoop, x: Real, values: Complex, *, open_loop: int, ends_real: bool
) -> int | None:
    """Poles of 1/(1 + L) with Re s > 0, by the change of arg(1 + L); None if it is not
    a whole number.

    Half the contour suffices, L being real on the positive real axis: from there along
    a small arc to jω_low, up the axis (passing its poles on the right), and along a
    large arc back. On the way up the axis the right half plane lies to the right, so
    the change is −π (Z − P). A sampled loop (`ends_real`) is real at the Nyquist
    frequency and needs no second arc.
    """
    ahead = 1 + values
    steps = np.angle(ahead[1:] / ahead[:-1])
    modulus = np.abs(values)
    # A pole lies in an interval in which the phase turns further than a sweep allows,
    # between two values as far above 1 as faint ones are below.
    jumps = np.abs(steps) > TURN
    jumps &= np.minimum(modulus[1:], modulus[:-1]) > 1.0 / FAINT
    # Passing a simple pole on the axis on its right turns L by −π along an arc of
    # infinite radius.
    steps[jumps] -= np.where(steps[jumps] > 0, math.tau, 0.0)
    change = float(steps.sum()) + _arc(
        complex(values[0]), loop.slope(x[:1]).real.item()
    )
    if not ends_real or abs(values[-1]) < 1:
        change -= _arc(complex(values[-1]), loop.slope(x[-1:]).real.item())
    turns = -change / math.pi
    # The arcs at both ends assume the leading power alone. Where the turns do not close
    # to a whole number, that power does not dominate yet, and any count would be a
    # guess.
    if not math.isfinite(turns) or abs(turns - round(turns)) > 0.2:
        return None
    return open_loop + round(turns)


def _arc(value: complex, slope: float) -> float:
    """Change of arg(1 + L) from the positive real axis to jω along |s| = ω, where L ≈ c
    s^slope.
    """
    phase = cmath.phase(value)
    # Near the origin 1 + L stays in the right half plane, so the principal argument is
    # the change along the arc.
    if abs(value) < 1:
        return cmath.phase(1 + value)
    # On the positive real axis arg L is a multiple of π: the one nearest to phase −
    # slope π/2 gives the change more exactly than slope π/2 itself.
    change = phase - math.pi * round((phase - 0.5 * math.pi * slope) / math.pi)
    return change + cmath.phase(1 + 1 / value)
