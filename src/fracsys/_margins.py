"""Every gain and phase crossing of a loop, its modulus margin, and the Nyquist
criterion.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from fracsys._fractional import FractionalTransferFunction
from fracsys._loops import SampledLoop, as_loop
from fracsys._nyquist import modulus_margin, unstable_closed_loop_poles
from fracsys._precision import RESOLUTION
from fracsys._stability import is_stable
from fracsys._sweep import (
    Tendency,
    gain_level,
    gain_slope,
    phase_level,
    phase_slope,
    sweep,
    zeros_of,
)
from fracsys.checks import Between, Complex, Mask, Real, above, checked
from fracsys.errors import FieldError

Index = NDArray[np.intp]


_SHOWN = 8


@dataclass(frozen=True)
class GainCrossing:
    """Where |L(jω)| = 1.

    Attributes
    ----------
    frequency
        ω [rad/s].
    phase_margin
        arg L(jω) + π [rad], in (−π, π].
    delay_margin
        Smallest added delay [s] that turns L(jω) to −1.
    """

    frequency: float
    phase_margin: float
    delay_margin: float


@dataclass(frozen=True)
class PhaseCrossing:
    """Where L(jω) is real and negative: frequency [rad/s] and gain margin 1/|L(jω)|
    [1].
    """

    frequency: float
    gain_margin: float


@dataclass(frozen=True)
class Margins:
    """All crossings of a loop, sorted by frequency, and its modulus margin min |1 +
    L(jω)|.

    The modulus margin is an infimum: where |1 + L| only approaches it, its frequency is
    0 or inf. `stable` says whether the closed loop 1/(1 + L) is stable; it is None
    where that was not decided. Margins other than the modulus margin say little about a
    closed loop that is not stable. Printed, it is a table.
    """

    gain_crossings: tuple[GainCrossing, ...]
    phase_crossings: tuple[PhaseCrossing, ...]
    modulus_margin: float
    modulus_frequency: float
    stable: bool | None = None

    def __str__(self) -> str:
        """A line for each crossing (the first eight of a kind), the modulus margin and
        the verdict.
        """
        lines = [
            f"gain crossing   {c.frequency:12.6g} rad/s  phase margin {math.degrees(c.phase_margin):8.3f}°"
            f"  delay margin {c.delay_margin:.4g} s"
            for c in self.gain_crossings[:_SHOWN]
        ]
        lines += [
            f"phase crossing  {c.frequency:12.6g} rad/s  gain margin  {c.gain_margin:9.4g}"
            f"  ({20 * math.log10(c.gain_margin):.2f} dB)"
            for c in self.phase_crossings[:_SHOWN]
        ]
        hidden = sum(
            max(0, len(c) - _SHOWN) for c in (self.gain_crossings, self.phase_crossings)
        )
        lines += [f"… and {hidden} more crossings"] if hidden else []
        lines.append(
            f"nearest to −1   {self.modulus_frequency:12.6g} rad/s  distance     {self.modulus_margin:9.4g}"
        )
        verdicts = {
            True: "stable",
            False: "not stable",
            None: "not decided: give unstable_poles",
        }
        return "\n".join([*lines, f"closed loop     {verdicts[self.stable]}"])

    @property
    def critical(self) -> GainCrossing | None:
        """The gain crossing with the smallest |phase margin|; None if |L| is 1 nowhere."""
        return min(self.gain_crossings, key=lambda c: abs(c.phase_margin), default=None)

    @property
    def gain_crossover(self) -> float:
        """Frequency of the critical gain crossing [rad/s]; nan if there is none."""
        return math.nan if self.critical is None else self.critical.frequency

    @property
    def phase_margin(self) -> float:
        """Phase margin of the critical gain crossing [rad]; inf if there is none."""
        return math.inf if self.critical is None else self.critical.phase_margin

    @property
    def delay_margin(self) -> float:
        """Smallest added delay [s] that brings L(jω) to −1; inf if there is none."""
        return min((c.delay_margin for c in self.gain_crossings), default=math.inf)

    @property
    def gain_margin(self) -> float:
        """The gain margin nearest to 1 on a logarithmic scale; inf if there is no phase
        crossing.
        """
        # Nearest to 1, not smallest: a conditionally stable loop may be as close to
        # instability when its gain falls.
        values = [
            c.gain_margin for c in self.phase_crossings if 0 < c.gain_margin < math.inf
        ]
        return min(values, key=lambda g: abs(math.log(g)), default=math.inf)

    @property
    def sensitivity_peak(self) -> float:
        """Ms = max |1/(1 + L)| [1], the inverse of the modulus margin."""
        return math.inf if self.modulus_margin == 0 else 1.0 / self.modulus_margin


# --- Every gain and phase crossing of a loop, its margins and its distance to −1 ----------------------


@checked
def margins(
    loop: FractionalTransferFunction | Callable[[Complex], Complex],
    *,
    limit: Annotated[float, above(0.0, unit="rad/s")] | None = None,
    unstable_poles: Annotated[int, Between(0, 1000)] | None = None,
) -> Margins:
    """Return every gain crossing, phase crossing and the modulus margin of an open loop
    L.

    |L(jω)| = 1 gives the gain crossings, arg L(jω) = −π the phase crossings, min |1 +
    L(jω)| the modulus margin. There is no grid to choose: it is refined until neither
    ln L nor 1 + L changes much between neighbours, and every crossing is polished to
    rounding. A delay makes countless phase crossings: with a delay (and for a callable,
    which may hide one) those below −60 dB are left out, or, where the loop rolls off
    too slowly for that, those below −6 dB at worst.

    Parameters
    ----------
    loop
        L under unity negative feedback. A callable takes s = jω (complex, shape (n,))
        and returns L(s) of the same shape; it is evaluated from 1e-6 to 1e6 rad/s. A
        python-control system is a callable; if it is sampled it is evaluated on the
        unit circle up to its Nyquist frequency.
    limit
        Highest frequency [rad/s], > 0; by default, for a sampled loop, its Nyquist
        frequency.
    unstable_poles
        Number of poles of L with Re s > 0, conjugates counted, which a callable cannot
        tell. With it the encirclements of −1 decide `stable`; for a transfer function
        it is computed.


    Raises
    ------
    FieldError
        `limit` ≤ 0, a response that is not a number, a callable that returns another
        shape, a response that turns more often than can be followed (a delay without
        roll-off: give `limit`).

    References
    ----------
    Nyquist (1932); modulus margin as in Åström and Hägglund, Advanced PID Control,
    section 4.6.

    Examples
    --------
    >>> m = margins(lambda s: 4 / (s * (s + 1) * (s + 2)), unstable_poles=0)
    >>> print(f"{m.gain_crossover:.6f} rad/s, {m.phase_margin:.6f} rad, {m.gain_margin:.6f}, {m.stable}")
    1.143203 rad/s, 0.199404 rad, 1.500000, True
    """
    sampled = as_loop(loop, limit)
    if unstable_poles is None:
        unstable_poles = sampled.unstable_poles
    # Poles and zeros on the axis give infinities here, which are not errors.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        x, values, quiet = sweep(sampled)
        gain, phase = crossings(sampled, x, values, quiet)
        modulus, at = modulus_margin(sampled, x, values)
        stable = None
        if modulus < RESOLUTION:  # a closed-loop pole on the axis
            stable = False
        # The swept part of the curve cannot show an encirclement beyond the limit; the
        # verdict comes from the whole loop.
        elif limit is not None and sampled.system is not None:
            stable = _beyond_limit(sampled.system)
        elif unstable_poles is not None:
            unstable = unstable_closed_loop_poles(
                sampled,
                x,
                values,
                open_loop=unstable_poles,
                ends_real=limit is not None,
            )
            stable = None if unstable is None else unstable == 0
    return Margins(gain, phase, modulus, at, stable)


def _beyond_limit(system: FractionalTransferFunction) -> bool | None:
    """The verdict where `limit` cuts off a part of the Nyquist curve that may encircle
    −1.
    """
    try:
        return is_stable(system.feedback()).stable
    except FieldError:
        return None


# --- Brackets of every crossing and of the modulus margin, from a swept response ----------------------

Bracket = tuple[float, float]  # ln ω at both ends


def crossings(
    loop: SampledLoop, x: Real, values: Complex, quiet: float
) -> tuple[tuple[GainCrossing, ...], tuple[PhaseCrossing, ...]]:
    """Every gain crossing and every phase crossing where |L| > `quiet`, polished."""
    level, turn = np.log(np.abs(values)), np.angle(-values)
    # A phase of −180° at every frequency (1/s²) has no crossing, only rounding.
    turn[np.abs(turn) < RESOLUTION] = 0.0
    gain = []
    brackets = _brackets(loop, gain_level, x, level, np.isfinite(level))
    for root, value in zeros_of(loop, gain_level, brackets):
        frequency, margin = math.exp(root), cmath.phase(-value)
        # A delay turns L clockwise only: where the margin is negative, L must go the
        # long way round to reach −1.
        gain.append(GainCrossing(frequency, margin, (margin % math.tau) / frequency))
    usable = _followed(loop, x, values, turn, quiet)
    brackets = _brackets(loop, phase_level, x, turn, usable)
    phase = [
        PhaseCrossing(math.exp(root), 1 / abs(value))
        for root, value in zeros_of(loop, phase_level, brackets)
    ]
    return tuple(gain), tuple(phase)


def _followed(
    loop: SampledLoop, x: Real, values: Complex, turn: Real, quiet: float
) -> Mask:
    """Points near the negative real axis in the range where the phase was followed."""
    # The phase of −L jumps by 2π on the positive real axis; a change of sign there is
    # no phase crossing.
    near = np.abs(turn) < 0.5 * math.pi
    if quiet:
        near &= (np.abs(values) > quiet) | (x <= loop.follow)
    return near


def _brackets(
    loop: SampledLoop, level: Tendency, x: Real, y: Real, usable: Mask
) -> list[Bracket]:
    """Brackets of the changes of sign, including pairs that lie on either side of an
    extreme close to zero.
    """
    place = np.flatnonzero(usable & (y != 0))
    here = y[place]
    if here.size < 2:
        return []
    # A single zero between two signs is a root that a grid point hit; a run of zeros is
    # a flat response.
    gap = np.diff(place)
    whole = (gap == 1) | ((gap == 2) & usable[np.minimum(place[:-1] + 1, len(x) - 1)])
    change = np.flatnonzero(((here[1:] > 0) != (here[:-1] > 0)) & whole)
    brackets = [(float(x[place[i]]), float(x[place[i + 1]])) for i in change]
    # The extreme value itself decides: two crossings 1e-5 apart can lie between two
    # points of any grid.
    slope = gain_slope if level is gain_level else phase_slope
    near = [
        (float(x[place[i - 1]]), float(x[place[i + 1]]))
        for i in _near_touches(place, here)
    ]
    for (a, b), (at, _) in zip(near, zeros_of(loop, slope, near), strict=True):
        beside, here = level(loop, np.array([a, at]))
        if beside * here < 0:
            brackets += [(a, at), (at, b)]
    return sorted(brackets)


def _near_touches(place: Index, y: Real) -> list[int]:
    """Indices of extremes closer to zero than the steps to their neighbours, which have
    the same sign.
    """
    size, step = np.abs(y), np.abs(np.diff(y))
    inner = size[1:-1]
    close = (
        (inner <= size[:-2])
        & (inner <= size[2:])
        & (inner < np.maximum(step[:-1], step[1:]))
    )
    if not close.any():
        return []
    same = (
        (y[:-2] * y[1:-1] > 0) & (y[1:-1] * y[2:] > 0) & (place[2:] - place[:-2] == 2)
    )
    return (np.flatnonzero(same & close) + 1).tolist()
