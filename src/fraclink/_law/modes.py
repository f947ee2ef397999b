"""What the link's modes do to a closed loop: how fast the first dies, whether the
higher ones stay small.

A phase margin bounds what the loop does where |L| is one. A crossover at the resonance
can keep it and leave the resonance as undamped as it was, or less damped: the moves of
such a design ring. `vibration` finds the roots of 1 + L(s) beside the axis.

The closed procedure does not see the higher modes, and the strain gauge sees them well.
On a uniform clamped beam with a payload the estimate of the tip answers the motor with

    Θ̂t/Θm = 1 - Σ share_i s²/(s² + ω_i² D_i(s)),   share_i = Γi² ω_i²/c,

where D is the damping law of the link model: s^(2-λ), or 1 + μ s^α/ω₀². For a massless
link the sum has one term, of share one, and is the G of the design. A second mode that
was identified takes the place of the beam's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.beam import Beam, assumed_ratio, material_law, modal_shares, modes_of
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop
from fraclink._arm.rig import Rig
from fraclink._law.requirement import Requirement
from fraclink.findings import Finding
from fracsys.checks import checked_between

__all__ = [
    "MODE_LIMIT",
    "MODE_POINTS",
    "HigherModes",
    "Vibration",
    "higher_modes",
    "mode_requirements",
    "ringing",
    "vibration",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

# ---- the vibration that a move leaves -----------------------------------------------------------------

# Of its own periods, until a vibration has fallen to 2 %: what takes longer is seen as
# ringing. A link of order 1.95 without a controller takes fifteen, one of order 1.85
# five: -cos(π/λ) is its damping ratio.
_PERIODS = 10
_BAND = (
    0.3,
    4.0,
)  # of the resonance: farther out a root belongs to the motor loop or to the gauge's delay
_STEPS = (
    40  # of Newton's method at most; from a minimum of |1 + L| it needs five to eight
)
_STILL = 1e-13  # of ω: a step of rounding errors, behind which no other follows


@dataclass(frozen=True)
class Vibration:
    """A root pair of 1 + L(s): frequency |s| [rad/s] and damping ratio -Re s/|s|."""

    frequency: float
    damping_ratio: float

    @property
    def periods(self) -> float:
        """Its own periods until it has fallen to 2 %, ``ln 50 √(1 − ζ²)/(2πζ)``;
        infinite where it grows.
        """
        ratio = self.damping_ratio
        return (
            math.log(50.0) * math.sqrt(1.0 - ratio**2) / (2.0 * math.pi * ratio)
            if ratio > 0.0
            else math.inf
        )

    @property
    def time(self) -> float:
        """Seconds until it has fallen to 2 %, ``ln 50/(ζ|s|)``."""
        rate = self.damping_ratio * self.frequency
        return math.log(50.0) / rate if rate > 0.0 else math.inf


def vibration(loop: Loop, natural_frequency: float) -> Vibration | None:
    """Return the least damped vibration near the link's own resonance; None where there
    is none.

    Newton's method on ``1 + L(s) = 0`` from every minimum of |1 + L| on the axis about
    the resonance. A well damped loop may have no root there: its response does not
    oscillate.
    """
    mode = float(loop.peak(natural_frequency))
    w = np.minimum(mode * np.geomspace(*_BAND, 160), loop.highest)
    # A root beside the axis dents |1 + L| on it, so every dent is a start. The open
    # loop's own pole would be one only where the correction is weak.
    distance = np.abs(1.0 + loop(w, natural_frequency))
    inner = (
        np.flatnonzero(
            (distance[1:-1] <= distance[:-2]) & (distance[1:-1] <= distance[2:])
        )
        + 1
    )
    # A weak loop about a sharp resonance moves the link's own pole by less than a dent
    # shows.
    starts = np.append(w[inner], mode)
    roots = _roots(loop, starts.astype(complex), natural_frequency)
    # ω = s/j: the decay rate is Im ω.
    found = [
        Vibration(float(abs(root)), float(root.imag / abs(root))) for root in roots
    ]
    low, high = _BAND[0] * mode, _BAND[1] * mode
    near = [one for one in found if low < one.frequency < high]
    return min(near, key=lambda one: one.damping_ratio, default=None)


def _roots(loop: Loop, w: Complex, natural_frequency: float) -> Complex:
    """Roots of 1 + L at complex ω, by Newton's method on 1 + 1/L with a central
    difference; those that converged.

    1/L is nearly a parabola about a resonance, where L has a pole beside the root.
    """
    for _ in range(_STEPS):
        step = 1e-6 * np.abs(w)
        # One call for all three: a drag in the studio waits for it, and most of a call
        # is its overhead.
        value, above, below = loop(np.stack([w, w + step, w - step]), natural_frequency)
        change = (1.0 + 1.0 / value) * (2.0 * step) / (1.0 / above - 1.0 / below)
        # A step of at most a tenth keeps ω in the right half plane, where the principal
        # powers are L's own.
        w = w - change * np.minimum(
            1.0, 0.1 * np.abs(w) / np.maximum(np.abs(change), 1e-300)
        )
        if np.all(np.abs(change) <= _STILL * np.abs(w)):
            break
    kept = (np.abs(1.0 + loop(w, natural_frequency)) < 1e-8) & (w.real > 0.0)
    # In the right half plane of ω, the upper of s: the other of the pair is its mirror
    # image.
    return np.asarray(w[kept])


def ringing(
    loop: Loop, ends: Mapping[float, float], *, whose: str = ""
) -> tuple[Finding, ...]:
    """Return W409 where a move leaves a vibration that takes more than ten of its
    periods to fall to 2 %.

    `ends` has payload [kg] to ω₀ [s^(-λ/2)]; damping is smallest at one end of a range
    of payloads. `whose` says in the sentence whose moves they are, where it is not the
    model's.
    """
    found = {payload: vibration(loop, w0) for payload, w0 in ends.items()}
    slow = {
        payload: one
        for payload, one in found.items()
        if one is not None and one.periods > _PERIODS
    }
    if not slow:
        return ()
    # The least damped is the one that a user sees longest, and the finding names one
    # payload.
    payload, worst = min(slow.items(), key=lambda item: item[1].damping_ratio)
    return (
        Finding(
            "W409",
            "error",
            f"moves{whose} ring: the residual vibration falls to 2 % only after {worst.time:.3g} s, "
            f"more than {_PERIODS} of its periods",
            {
                "damping_ratio": worst.damping_ratio,
                "frequency": worst.frequency,
                "payload_kg": payload,
            },
            "a gain crossover farther above the resonance, or a larger phase margin, damps it",
        ),
    )


# ---- modes 2 and 3 ------------------------------------------------------------------------------------

MODE_LIMIT = (
    0.5  # of the loop gain: 6 dB below the one at which phase alone would decide
)
# The gain of a mode changes by 3 % over a range of two: its ends and the middle are
# plenty.
_MODE_PAYLOADS = 3
# so that the points of a mode that is damped away do not reach down to the first mode
_WIDEST = 0.035
_POINTS = np.sinh(
    np.linspace(-3.0, 3.0, 61)
)  # of ln ω in damping ratios: closest at the peak
MODE_POINTS = _POINTS.size


@dataclass(frozen=True)
class HigherModes:
    """Where modes 2 and 3 of a link lie, and what the loop there is without Ĉ.

    One row for each payload and mode: ``number`` (K,), ``payload`` (K,) [kg],
    ``frequency`` (K, N) [rad/s] as the computer sees it, ``level`` (K, N), ln|hold · M
    · Θ̂t/Θm|.
    """

    number: NDArray[np.int64]
    payload: Real
    frequency: Real
    level: Real

    def gains(self, loop: Loop) -> Real:
        """Return the largest loop gain of each row with the Ĉ of `loop`, shape (K,)."""
        return np.asarray(
            np.max(np.exp(loop.outer_log(self.frequency).real + self.level), axis=1)
        )


def higher_modes(
    model: LinkModel,
    rig: Rig,
    loop: Loop,
    payloads: tuple[float, float],
    *,
    damping_ratio: float | None = None,
) -> HigherModes | None:
    """Return the higher modes of the link over `payloads` [kg], None where neither rig
    nor model knows one.

    Parameters
    ----------
    model
        its second mode, where it was identified; its damping law for the modes of the
        rig's beam.
    rig
        length, stiffness and mass of the link; control period.
    loop
        the loop whose motor loop and gauge stand around the link.
    payloads
        (lightest, heaviest) [kg], > 0.
    damping_ratio
        of the beam's modes, 0 < ζ < 1, instead of the model's law; 0.02 where the model
        has no damping.
    """
    if rig.link.mass <= 0.0 and model.second_mode is None:
        return None
    if damping_ratio is not None:
        damping_ratio = checked_between(
            "mode_damping", damping_ratio, 0.0, 0.999, open_low=True
        )
    else:
        # A fractional or viscous law damps the higher modes as it does the first;
        # without one they would be infinitely high, and no filter would do.
        damping_ratio = assumed_ratio(model)
    rows: list[tuple[int, float, Real, Real]] = []
    for payload in np.geomspace(*payloads, _MODE_PAYLOADS).tolist():
        if model.second_mode is not None:
            width = min(model.second_mode.damping_ratio, _WIDEST)
            w = model.second_mode.frequency * np.exp(width * _POINTS)
            link = (
                model.at_payload(payload).natural_frequency
                if model.payload
                else model.natural_frequency
            )
            rows.append((2, payload, w, loop.link_log(w, link).real))
        if rig.link.mass > 0.0:
            rows += _beam_modes(model, rig, payload, damping_ratio)
    number, masses, frequencies, answers = zip(*rows, strict=True)
    w = np.array(frequencies)
    level = _rest(loop, w, rig.period) + np.array(answers)
    return HigherModes(np.array(number), np.array(masses), _seen(w, rig.period), level)


def _beam_modes(
    model: LinkModel, rig: Rig, payload: float, ratio: float | None
) -> list[tuple[int, float, Real, Real]]:
    """(number, payload, ω, ln|Θ̂t/Θm|) of the beam's modes that were not identified."""
    frequencies, sizes = modal_shares(Beam.from_rig(rig, payload=payload))
    found = []
    for i in range(modes_of(model), frequencies.size):
        w = _around(model, float(frequencies[i]), ratio)
        s = np.asarray(1j * w, dtype=np.complex128)
        answer = np.ones(s.shape, dtype=np.complex128)
        for frequency, share in zip(frequencies, sizes / model.stiffness, strict=True):
            answer -= (
                share
                * s**2
                / (
                    s**2
                    + frequency**2 * material_law(model, s, float(frequency), ratio)
                )
            )
        # The whole sum and not the mode's own term: the tails of its neighbours, with
        # it or against it, are part of what the gauge shows there.
        found.append((i + 1, payload, w, np.log(np.abs(answer))))
    return found


def _around(model: LinkModel, frequency: float, ratio: float | None) -> Real:
    """Frequencies about the peak of a mode: a power law moves it, by 25 % for λ = 1.92."""
    peak = frequency
    for _ in range(
        30
    ):  # ω² = ω_i² Re D(jω), a contraction as Re D grows by less than ω^1
        law = complex(material_law(model, np.asarray(1j * peak), frequency, ratio))
        peak = frequency * math.sqrt(max(law.real, 0.25))
    law = complex(material_law(model, np.asarray(1j * peak), frequency, ratio))
    # arg D is 2ζ for a small ζ. The floor keeps points on either side of a peak that
    # the iteration above has placed to three digits only, as it may for α near 2.
    width = min(max(0.5 * abs(math.atan2(law.imag, law.real)), 1e-3), _WIDEST)
    return np.asarray(peak * np.exp(width * _POINTS))


def _seen(w: Real, period: float) -> Real:
    """Where the computer sees ω: beyond the Nyquist frequency it is folded back."""
    nyquist = math.pi / period
    return np.maximum(
        np.abs(np.remainder(w + nyquist, 2.0 * nyquist) - nyquist), 1e-3 * nyquist
    )


def _rest(loop: Loop, w: Real, period: float) -> Real:
    """ln|hold · M|; beyond the Nyquist frequency M is taken there, where it is larger."""
    half = 0.5 * period * w
    motor = loop.motor_log(np.minimum(w, math.pi / period)).real
    return np.asarray(np.log(np.abs(np.sin(half)) / half + 1e-300) + motor)


def mode_requirements(
    modes: HigherModes, loop: Loop, limit: float
) -> tuple[tuple[int, Requirement], ...]:
    """Return (number, the worst loop gain against `limit`) of each higher mode."""
    gains = modes.gains(loop)
    found = []
    for number in map(int, np.unique(modes.number)):
        rows = np.flatnonzero(modes.number == number)
        worst = rows[int(np.argmax(gains[rows]))]
        name, payload = f"loop gain at mode {number}", float(modes.payload[worst])
        found.append(
            (number, Requirement.at_most(name, limit, float(gains[worst]), "", payload))
        )
    return tuple(found)
