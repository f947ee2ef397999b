"""What `margins` returns."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["GainCrossing", "Margins", "PhaseCrossing"]

_SHOWN = 8


@dataclass(frozen=True)
class GainCrossing:
    """Where |L(jω)| = 1.

    Attributes
    ----------
    frequency : float
        ω [rad/s].
    phase_margin : float
        arg L(jω) + π [rad], in (−π, π].
    delay_margin : float
        Smallest added delay [s] that turns L(jω) to −1.
    """

    frequency: float
    phase_margin: float
    delay_margin: float


@dataclass(frozen=True)
class PhaseCrossing:
    """Where L(jω) is real and negative: frequency [rad/s] and gain margin 1/|L(jω)| [1]."""

    frequency: float
    gain_margin: float


@dataclass(frozen=True)
class Margins:
    """All crossings of a loop, sorted by frequency, and its modulus margin min |1 + L(jω)|.

    The modulus margin is an infimum: where |1 + L| only approaches it, its frequency is 0 or inf.
    `stable` says whether the closed loop 1/(1 + L) is stable; it is None where that was not decided.
    Margins other than the modulus margin say little about a closed loop that is not stable. Printed, it is
    a table.
    """

    gain_crossings: tuple[GainCrossing, ...]
    phase_crossings: tuple[PhaseCrossing, ...]
    modulus_margin: float
    modulus_frequency: float
    stable: bool | None = None

    def __str__(self) -> str:
        """A line for each crossing (the first eight of a kind), the modulus margin and the verdict."""
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
        hidden = sum(max(0, len(c) - _SHOWN) for c in (self.gain_crossings, self.phase_crossings))
        lines += [f"… and {hidden} crossings more"] if hidden else []
        lines.append(
            f"nearest to −1   {self.modulus_frequency:12.6g} rad/s  distance     {self.modulus_margin:9.4g}"
        )
        known = {True: "stable", False: "not stable", None: "not decided: give unstable_poles"}
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
        """The gain margin nearest to 1 on a logarithmic scale; inf if there is no phase crossing."""
        values = [c.gain_margin for c in self.phase_crossings if 0 < c.gain_margin < math.inf]
        return min(values, key=lambda g: abs(math.log(g)), default=math.inf)

    @property
    def sensitivity_peak(self) -> float:
        """Ms = max |1/(1 + L)| [1], the inverse of the modulus margin."""
        return math.inf if self.modulus_margin == 0 else 1.0 / self.modulus_margin
