"""Every gain and phase crossing of a loop, its margins and its distance to −1."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink.stability.loops import as_loop
from fraclink.stability.polish import polish_minimum, polish_roots
from fraclink.stability.sweep import Loop, Response, sweep

if TYPE_CHECKING:
    from fraclink.fractional import FractionalTransferFunction

__all__ = ["GainCrossing", "Margins", "PhaseCrossing", "margins"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


@dataclass(frozen=True)
class GainCrossing:
    """Where |L(jω)| = 1: frequency [rad/s], phase margin [rad] in (−π, π], delay margin [s]."""

    frequency: float
    phase_margin: float
    delay_margin: float


@dataclass(frozen=True)
class PhaseCrossing:
    """Where arg L(jω) = −π (mod 2π): frequency [rad/s] and gain margin 1/|L| [1]."""

    frequency: float
    gain_margin: float


@dataclass(frozen=True)
class Margins:
    """All crossings of a loop, sorted by frequency, and its modulus margin min |1 + L(jω)|.

    `stable` says whether the closed loop 1/(1 + L) is stable; it is None where that was not decided.
    """

    gain_crossings: tuple[GainCrossing, ...]
    phase_crossings: tuple[PhaseCrossing, ...]
    modulus_margin: float
    modulus_frequency: float
    stable: bool | None = None

    @property
    def critical(self) -> GainCrossing | None:
        """The gain crossing with the smallest |phase margin|, None if |L| never is 1."""
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
        """Smallest delay [s] that brings a crossing to −1; inf if there is none."""
        return min((c.delay_margin for c in self.gain_crossings), default=math.inf)

    @property
    def gain_margin(self) -> float:
        """The gain margin nearest to 1 on a logarithmic scale; inf if there is no phase crossing."""
        values = (c.gain_margin for c in self.phase_crossings)
        return min(values, key=lambda g: abs(math.log(g)) if 0 < g < math.inf else math.inf, default=math.inf)

    @property
    def sensitivity_peak(self) -> float:
        """Ms = max |1/(1 + L)| = 1/modulus margin [1]."""
        return math.inf if self.modulus_margin == 0 else 1.0 / self.modulus_margin


def margins(
    loop: FractionalTransferFunction | Response | object,
    *,
    limit: float | None = None,
    unstable_poles: int | None = None,
) -> Margins:
    """Return every gain crossing, phase crossing and the modulus margin of an open loop L.

    |L(jω)| = 1 gives gain crossings, arg L(jω) = −π phase crossings, min |1 + L(jω)| the modulus margin.

    Parameters
    ----------
    loop : FractionalTransferFunction, python-control system or callable
        L(s) under unity negative feedback. A callable takes an array of s = jω (complex, shape (n,)) and
        returns an array of the same shape.
    limit : float, optional
        Highest frequency [rad/s], > 0; the Nyquist frequency for a sampled loop.
    unstable_poles : int, optional
        Number of poles of L with Re s > 0, which a callable cannot tell. Given, the encirclements of −1
        decide `stable`.

    >>> from fraclink.stability import margins
    >>> m = margins(lambda s: 4 / (s * (s + 1) * (s + 2)))
    >>> print(f"{m.gain_crossover:.6f} rad/s {m.gain_margin:.6f}")
    1.143203 rad/s 1.500000
    """
    known = as_loop(loop, limit)
    x, values = sweep(known)
    gain, phase = _crossings(known, x, values)
    modulus, at = polish_minimum(known, lambda v: np.abs(1 + v), x, values)
    return Margins(gain, phase, modulus, at, None)


def _crossings(
    loop: Loop, x: Real, values: Complex
) -> tuple[tuple[GainCrossing, ...], tuple[PhaseCrossing, ...]]:
    with np.errstate(divide="ignore"):
        level = np.log(np.abs(values))
    turn = np.angle(-values)
    gains = _sign_changes(level)
    turns = _sign_changes(turn)
    turns = turns[np.abs(turn[turns] - turn[turns + 1]) < math.pi / 2]
    brackets = np.concatenate([gains, turns])
    split = len(gains)
    kind = np.arange(len(brackets)) < split

    def height(v: Complex) -> Real:
        return np.where(kind, np.log(np.abs(v)), np.angle(-v))

    if not brackets.size:
        return (), ()
    roots = polish_roots(loop, height, x[brackets], x[brackets + 1], values[brackets], values[brackets + 1])
    at = loop(roots)
    frequency = np.exp(roots)
    gain = tuple(
        GainCrossing(float(w), float(m), float((m % (2 * math.pi)) / w))
        for w, m in zip(frequency[:split], np.angle(-at[:split]), strict=True)
    )
    phase = tuple(
        PhaseCrossing(float(w), float(1 / abs(v))) for w, v in zip(frequency[split:], at[split:], strict=True)
    )
    return gain, phase


def _sign_changes(y: Real) -> NDArray[np.intp]:
    positive = y > 0
    return np.flatnonzero(positive[1:] != positive[:-1])
