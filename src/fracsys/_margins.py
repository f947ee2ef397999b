"""Every gain and phase crossing of a loop, its modulus margin, and the Nyquist
criterion.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, cast

import numpy as np
from numpy.typing import NDArray

from fracsys._fractional import FractionalTransferFunction
from fracsys._loops import FractionalLoop, SampledLoop, as_loop
from fracsys._stability import is_stable
from fracsys._sweep import (
    Tendency,
    gain_level,
    gain_slope,
    modulus_slope,
    phase_level,
    phase_slope,
    sweep,
    valleys,
    zero_of,
)
from fracsys._terms import Complexes, Reals
from fracsys.checks import Between, checked
from fracsys.errors import FieldError

Mask = NDArray[np.bool_]

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
        lines += [f"… and {hidden} crossings more"] if hidden else []
        lines.append(
            f"nearest to −1   {self.modulus_frequency:12.6g} rad/s  distance     {self.modulus_margin:9.4g}"
        )
        known = {
            True: "stable",
            False: "not stable",
            None: "not decided: give unstable_poles",
        }
        return "\n".join([*lines, f"closed loop     {known[self.stable]}"])

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
        # Nearest to 1 and not least: a conditionally stable loop is as close to its end
        # when its gain falls.
        values = [
            c.gain_margin for c in self.phase_crossings if 0 < c.gain_margin < math.inf
        ]
        return min(values, key=lambda g: abs(math.log(g)), default=math.inf)

    @property
    def sensitivity_peak(self) -> float:
        """Ms = max |1/(1 + L)| [1], the inverse of the modulus margin."""
        return math.inf if self.modulus_margin == 0 else 1.0 / self.modulus_margin


# --- Every gain and phase crossing of a loop, its margins and its distance to −1 ----------------------

_ON_AXIS = 1e-12  # a modulus margin of zero is a closed-loop pole on the axis


@checked
def margins(
    loop: FractionalTransferFunction | Callable[[Complexes], Complexes],
    *,
    limit: Annotated[float, Between(0.0, unit="rad/s", low_open=True)] | None = None,
    unstable_poles: Annotated[int, Between(0, 1000)] | None = None,
) -> Margins:
    """Return every gain crossing, phase crossing and the modulus margin of an open loop
    L.

    |L(jω)| = 1 gives the gain crossings, arg L(jω) = −π the phase crossings, min |1 + L(jω)| the modulus
    margin. There is no grid to choose: the response is followed until neither ln L nor 1 + L moves far
    between neighbours, and every crossing is polished to rounding. A delay makes countless phase crossings:
    with one (and for a callable, which may hide one) those below −60 dB are left out, or, where the loop
    rolls off too slowly for that, those below −6 dB at worst.

    Parameters
    ----------
    loop
        L under unity negative feedback. A callable takes s = jω (complex, shape (n,))
        and returns L(s) of the same shape; it is looked at from 1e-6 to 1e6 rad/s. A
        python-control system is a callable; if it is sampled it is evaluated on the
        unit circle up to its Nyquist frequency. Frequency response data are used in
        their own range, straight in a Bode plot from point to point.
    limit
        Highest frequency [rad/s], > 0; the Nyquist frequency of a sampled loop.
    unstable_poles
        Number of poles of L with Re s > 0, conjugates counted, which a callable cannot
        tell. With it (or for a transfer function, which knows) the encirclements of −1
        decide `stable`.


    Raises
    ------
    FieldError
        `limit` ≤ 0, a response that is not a number, a callable of another shape, a
        response that turns more often than can be followed (a delay without roll-off:
        give `limit`).

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
    known = as_loop(loop, limit)
    if unstable_poles is None and isinstance(known, FractionalLoop):
        unstable_poles = known.unstable_poles
    # Poles and zeros on the axis are infinities here and not faults.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        x, values, quiet = sweep(known)
        gain, phase = crossings(known, x, values, quiet)
        modulus, at = modulus_margin(known, x, values)
        stable = None
        if modulus < _ON_AXIS:
            stable = False
        # The swept part of the curve shows no encirclement beyond the limit: the
        # verdict is that of the whole loop.
        elif limit is not None and isinstance(known, FractionalLoop):
            stable = _beyond_limit(
                cast(FractionalTransferFunction, getattr(loop, "fractional", loop))
            )
        elif unstable_poles is not None:
            left = unstable_closed_loop_poles(
                known, x, values, open_loop=unstable_poles, ends_real=limit is not None
            )
            stable = None if left is None else left == 0
    return Margins(gain, phase, modulus, at, stable)


def _beyond_limit(system: FractionalTransferFunction) -> bool | None:
    """The verdict where `limit` hides a part of the Nyquist curve, which may encircle
    −1 there.
    """
    try:
        return is_stable(system.feedback()).stable
    except FieldError:
        return None


# --- Brackets of every crossing and of the modulus margin, from a swept response ----------------------

Bracket = tuple[float, float]  # ln ω at both ends

# rad: a phase of −180° at every frequency (1/s²) crosses nothing; this is its rounding
_FLAT = 1e-12


def crossings(
    loop: SampledLoop, x: Reals, values: Complexes, quiet: float
) -> tuple[tuple[GainCrossing, ...], tuple[PhaseCrossing, ...]]:
    """Every gain crossing and every phase crossing where |L| > `quiet`, polished."""
    level, turn = np.log(np.abs(values)), np.angle(-values)
    turn[np.abs(turn) < _FLAT] = 0.0
    gain = []
    for bracket in _brackets(loop, gain_level, x, level, np.isfinite(level)):
        root, value = zero_of(loop, gain_level, *bracket)
        frequency, margin = math.exp(root), cmath.phase(-value)
        # A delay turns L clockwise only. Where the margin is negative it has to
        # go on to −1 the long way round.
        gain.append(
            GainCrossing(frequency, margin, (margin % (2 * math.pi)) / frequency)
        )
    phase = []
    for bracket in _brackets(
        loop, phase_level, x, turn, _followed(loop, x, values, turn, quiet)
    ):
        root, value = zero_of(loop, phase_level, *bracket)
        phase.append(PhaseCrossing(math.exp(root), 1 / abs(value)))
    return tuple(gain), tuple(phase)


def _followed(
    loop: SampledLoop, x: Reals, values: Complexes, turn: Reals, quiet: float
) -> NDArray[np.bool_]:
    """Points near the negative real axis whose phase was followed there."""
    # The phase of −L jumps by 2π on the positive real axis: a change of sign there
    # is no crossing of the negative.
    near = np.abs(turn) < 0.5 * math.pi
    if quiet:
        near &= (np.abs(values) > quiet) | (x <= loop.follow)
    return near


def _brackets(
    loop: SampledLoop, level: Tendency, x: Reals, y: Reals, usable: Mask
) -> list[Bracket]:
    """Changes of sign, and the pairs of them that hide around an extreme that almost
    touches zero.
    """
    place = np.flatnonzero(usable & (y != 0))
    here = y[place]
    if here.size < 2:
        return []
    # One zero between two signs is a root that a point of the grid hit; a run of them
    # is a flat response.
    gap = np.diff(place)
    whole = (gap == 1) | ((gap == 2) & usable[np.minimum(place[:-1] + 1, len(x) - 1)])
    change = np.flatnonzero(((here[1:] > 0) != (here[:-1] > 0)) & whole)
    found = [(float(x[place[i]]), float(x[place[i + 1]])) for i in change]
    for i in _near_touches(place, here):
        found += _hidden(loop, level, float(x[place[i - 1]]), float(x[place[i + 1]]))
    return sorted(found)


def _hidden(loop: SampledLoop, level: Tendency, a: float, b: float) -> list[Bracket]:
    """The two brackets that an extreme between a and b makes where it passes zero."""
    # The extreme itself decides: two crossings 1e-5 apart lie between two points of any
    # grid.
    x, value = zero_of(loop, gain_slope if level is gain_level else phase_slope, a, b)
    passed = level(value, 0j) * level(*loop.point(a)) < 0
    return [(a, x), (x, b)] if passed else []


def _near_touches(place: Index, y: Reals) -> list[int]:
    """Indices of extremes nearer to zero than the steps beside them, with neighbours of
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


def modulus_margin(
    loop: SampledLoop, x: Reals, values: Complexes
) -> tuple[float, float]:
    """inf |1 + L| and its frequency [rad/s], 0 or inf where it is approached and not
    reached.
    """
    distance = np.abs(1 + values)
    distance[np.isnan(distance)] = math.inf
    best = int(np.argmin(distance))
    smallest, at = float(distance[best]), float(x[best])
    # The sweep lets 1 + L move by its own size from point to point: part of that may
    # still be lost.
    for i in valleys(distance, spare=3.0):
        place, value = zero_of(loop, modulus_slope, float(x[i - 1]), float(x[i + 1]))
        if abs(1 + value) <= smallest:
            smallest, at = abs(1 + value), place
    frequency = math.exp(at)
    # A distance that falls towards an end of the axis has its infimum there and nowhere
    # on the way.
    for limit, place in zip(loop.ends, (0.0, math.inf), strict=True):
        if abs(1 + limit) < smallest:
            smallest, frequency = abs(1 + limit), place
    return smallest, frequency


# --- The Nyquist criterion on a swept response, with indentations around poles of the axis ------------

# |L| on both sides of an interval that turned by more than half a radian: a pole lies
# between them.
_BESIDE_POLE = 1e3


def unstable_closed_loop_poles(
    loop: SampledLoop, x: Reals, values: Complexes, *, open_loop: int, ends_real: bool
) -> int | None:
    """Poles of 1/(1 + L) with Re s > 0, by the change of arg(1 + L); None where it is
    not a whole number.

    Half the contour suffices, L being real on the positive real axis: from there along
    a small arc to jω_low, up the axis (passing its poles on the right), and along a
    large arc back. Up the axis the right half plane lies to the right, so that the
    change is −π (Z − P). A sampled loop (`ends_real`) is real at the Nyquist frequency
    and needs no second arc.
    """
    ahead = 1 + values
    steps = np.angle(ahead[1:] / ahead[:-1])
    modulus = np.abs(values)
    jumps = (np.abs(steps) > 0.5) & (
        np.minimum(modulus[1:], modulus[:-1]) > _BESIDE_POLE
    )
    # Passing a simple pole of the axis on its right turns L by −π along an arc of
    # infinite radius.
    steps[jumps] -= np.where(steps[jumps] > 0, 2 * math.pi, 0.0)
    change = float(steps.sum()) + _arc(
        complex(values[0]), loop.point(float(x[0]))[1].real
    )
    if not ends_real or abs(values[-1]) < 1:
        change -= _arc(complex(values[-1]), loop.point(float(x[-1]))[1].real)
    turns = -change / math.pi
    # The arcs at both ends are those of the leading power alone. Where they do not
    # close to a whole number it is not yet the leading one there, and any count would
    # be a guess.
    if not math.isfinite(turns) or abs(turns - round(turns)) > 0.2:
        return None
    return open_loop + round(turns)


def _arc(value: complex, slope: float) -> float:
    """Change of arg(1 + L) from the positive real axis to jω along |s| = ω, where L ≈ c
    s^slope.
    """
    phase = cmath.phase(value)
    # Beside the origin 1 + L stays in the right half plane: the principal
    # argument is the change along the arc.
    if abs(value) < 1:
        return cmath.phase(1 + value)
    # L starts at a multiple of π and turns by slope π/2, which the phase itself says
    # more exactly.
    turned = phase - math.pi * round((phase - 0.5 * math.pi * slope) / math.pi)
    return turned + cmath.phase(1 + 1 / value)
