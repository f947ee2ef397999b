"""The vibration that a closed loop leaves: how fast it dies, from the roots of 1 + L(s) beside the axis.

A phase margin bounds what the loop does where |L| is one. A crossover at the resonance can keep it and leave
the resonance as undamped as it was, or less damped: the moves of such a design ring.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.loop import Loop
from fraclink.findings import Finding

__all__ = ["Vibration", "ringing", "vibration"]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

# Of its own periods, until a vibration has fallen to 2 %: what takes longer is seen as ringing. A link of
# order 1.95 without a controller takes fifteen, one of order 1.85 five: -cos(π/λ) is its damping ratio.
_PERIODS = 10
_BAND = (0.3, 4.0)  # of the resonance: farther out a root belongs to the motor loop or to the gauge's delay
_STEPS = 40  # of Newton's method; from a minimum of |1 + L| it needs five to eight


@dataclass(frozen=True)
class Vibration:
    """A root pair of 1 + L(s): frequency |s| [rad/s] and damping ratio -Re s/|s|."""

    frequency: float
    damping_ratio: float

    @property
    def periods(self) -> float:
        """Its own periods until it has fallen to 2 %, ``ln 50 √(1 − ζ²)/(2πζ)``; infinite where it grows."""
        ratio = self.damping_ratio
        return (
            math.log(50.0) * math.sqrt(1.0 - ratio**2) / (2.0 * math.pi * ratio) if ratio > 0.0 else math.inf
        )

    @property
    def time(self) -> float:
        """Seconds until it has fallen to 2 %, ``ln 50/(ζ|s|)``."""
        rate = self.damping_ratio * self.frequency
        return math.log(50.0) / rate if rate > 0.0 else math.inf


def vibration(loop: Loop, natural_frequency: float) -> Vibration | None:
    """Return the least damped vibration near the link's own resonance; None where there is none.

    Newton's method on ``1 + L(s) = 0`` from every minimum of |1 + L| on the axis about the resonance. A well
    damped loop may have no root there: its response does not oscillate.
    """
    mode = float(loop.peak(natural_frequency))
    w = np.minimum(mode * np.geomspace(*_BAND, 160), loop.highest)
    distance = np.abs(1.0 + loop(w, natural_frequency))
    inner = np.flatnonzero((distance[1:-1] <= distance[:-2]) & (distance[1:-1] <= distance[2:])) + 1
    roots = _roots(loop, w[inner].astype(complex), natural_frequency)
    # ω = s/j: the decay rate is Im ω.
    found = [Vibration(float(abs(root)), float(root.imag / abs(root))) for root in roots]
    low, high = _BAND[0] * mode, _BAND[1] * mode
    near = [one for one in found if low < one.frequency < high]
    return min(near, key=lambda one: one.damping_ratio, default=None)


def _roots(loop: Loop, w: Complex, natural_frequency: float) -> Complex:
    """Roots of 1 + L at complex ω, by Newton's method with a central difference; those that converged."""
    for _ in range(_STEPS):
        step = 1e-6 * np.abs(w)
        value = 1.0 + loop(w, natural_frequency)
        slope = (loop(w + step, natural_frequency) - loop(w - step, natural_frequency)) / (2.0 * step)
        change = value / slope
        # A step of at most a tenth keeps ω in the right half plane, where the principal powers are L's own.
        w = w - change * np.minimum(1.0, 0.1 * np.abs(w) / np.maximum(np.abs(change), 1e-300))
    kept = (np.abs(1.0 + loop(w, natural_frequency)) < 1e-8) & (w.real > 0.0)
    return np.asarray(w[kept])


def ringing(loop: Loop, ends: Mapping[float, float], *, whose: str = "") -> tuple[Finding, ...]:
    """Return W409 where a move leaves a vibration that takes more than ten of its periods to fall to 2 %.

    `ends` has payload [kg] to ω₀ [s^(-λ/2)]; damping is smallest at one end of a range of payloads.
    `whose` says in the sentence whose moves they are, where it is not the model's.
    """
    found = {payload: vibration(loop, w0) for payload, w0 in ends.items()}
    slow = {payload: one for payload, one in found.items() if one is not None and one.periods > _PERIODS}
    if not slow:
        return ()
    payload, worst = min(slow.items(), key=lambda item: item[1].damping_ratio)
    return (
        Finding(
            "W409",
            "error",
            f"moves{whose} ring: the residual vibration falls to 2 % only after {worst.time:.3g} s, "
            f"more than {_PERIODS} of its periods",
            {"damping_ratio": worst.damping_ratio, "frequency": worst.frequency, "payload_kg": payload},
            "a gain crossover farther above the resonance, or a larger phase margin, damps it",
        ),
    )
