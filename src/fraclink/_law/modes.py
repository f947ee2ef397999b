"""The loop at the higher modes of the link.

The strain gauge responds to them clearly. On a uniform clamped beam with a payload the
response of the tip estimate to the motor is

    Θ̂t/Θm = 1 - Σ share_i s²/(s² + ω_i² D_i(s)),   share_i = Γi² ω_i²/c,

where D is the damping law of the link model: s^(2-λ), or 1 + μ s^α/ω₀². For a massless
link the sum has one term, of share one, and is the G of the design. A second mode that
was identified takes the place of the beam's.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.beam import Beam, assumed_ratio, material_law, modal_shares, modes_of
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop
from fraclink._arm.rig import Rig
from fraclink._law.requirement import Requirement
from fracsys.checks import Between, Complex, Real

__all__ = [
    "MODE_LIMIT",
    "MODE_POINTS",
    "HigherModes",
    "gain_towards",
    "higher_modes",
    "mode_requirements",
]


# of the loop gain towards -1: the rest of the distance to it is one over the customary
# sensitivity peak of 2
MODE_LIMIT = 0.5
# so that the points of a strongly damped mode do not extend down to the first mode
_WIDEST = 0.035
# points in ln ω as multiples of the damping ratio, densest at the peak
_POINTS = np.sinh(np.linspace(-3.0, 3.0, 61))
MODE_POINTS = _POINTS.size


@dataclass(frozen=True)
class HigherModes:
    """Frequencies of modes 2 and 3 of a link, and the loop without Ĉ there.

    One row for each payload and mode: ``number`` (K,), ``payload`` (K,) [kg],
    ``frequency`` (K, N) [rad/s] as the computer sees it, ``level`` (K, N), ln(hold · M
    · Θ̂t/Θm), whose imaginary part is NaN where the phase does not count.
    """

    number: NDArray[np.int64]
    payload: Real
    frequency: Real
    level: Complex

    def above(self, number: int) -> HigherModes:
        """Return the modes above a given number."""
        above = self.number > number
        return HigherModes(
            *(getattr(self, part.name)[above] for part in fields(HigherModes))
        )

    def gains(self, loop: Loop) -> Real:
        """Return the loop gain of each row towards -1 with the Ĉ of `loop`, shape (K,)."""
        log = loop.outer_log(self.frequency) + self.level
        peak = np.argmax(log.real, axis=1)[:, np.newaxis]
        return gain_towards(np.take_along_axis(log, peak, axis=1)[:, 0])[0]


def gain_towards(peak: Complex) -> tuple[Real, Real, Real]:
    """Return the part of a mode's loop gain that points to -1, from ln L at its peak,
    and its derivatives by the real and the imaginary part.

    About a lightly damped mode L runs round a circle through 0 and its peak L_p, whose
    distance to -1 is |1 + L_p/2| - |L_p|/2. One minus that is |L_p| where it points to
    -1, or where its phase does not count, and less elsewhere.
    """
    radius = 0.5 * np.exp(peak.real)
    angle = np.remainder(peak.imag + math.pi, 2.0 * math.pi) - math.pi
    # The phase at a mode that was not identified may be off by what such a loop stands
    # elsewhere: its phase margin of 29°.
    turned = np.abs(angle) + 2.0 * math.asin(0.5 * MODE_LIMIT)
    known = turned < math.pi
    turned = np.where(known, turned, math.pi)
    apart = np.maximum(np.abs(1.0 + radius * np.exp(1j * turned)), np.finfo(float).eps)
    by_gain = radius * (1.0 - (np.cos(turned) + radius) / apart)
    by_phase = np.where(known, radius * np.sin(turned) / apart * np.sign(angle), 0.0)
    return (
        np.where(known, 1.0 + radius - apart, 2.0 * radius),
        np.where(known, by_gain, 2.0 * radius),
        by_phase,
    )


def higher_modes(
    model: LinkModel,
    rig: Rig,
    loop: Loop,
    payloads: Iterable[float],
    *,
    damping_ratio: float | None = None,
) -> HigherModes | None:
    """Return the higher modes of the link over `payloads` [kg], None if neither rig nor
    model has one.

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
        [kg], > 0.
    damping_ratio
        of the beam's modes, 0 < ζ < 1, instead of the model's law; 0.02 where the model
        has no damping.
    """
    if rig.link.mass <= 0.0 and model.second_mode is None:
        return None
    if damping_ratio is not None:
        damping_ratio = Between(0.0, 0.999, low_open=True).check(
            "damping_ratio", damping_ratio
        )
    else:
        # A fractional or viscous damping law damps the higher modes like the first.
        # Without one their peaks would be infinite, and no filter would suffice.
        damping_ratio = assumed_ratio(model)
    rows: list[tuple[int, float, Real, Complex]] = []
    for payload in payloads:
        if model.second_mode is not None:
            width = min(model.second_mode.damping_ratio, _WIDEST)
            w = model.second_mode.frequency * np.exp(width * _POINTS)
            link = (
                model.at_payload(payload).natural_frequency
                if model.payload
                else model.natural_frequency
            )
            rows.append((2, payload, w, loop.link_log(w, link)))
        if rig.link.mass > 0.0:
            rows += _beam_modes(model, rig, payload, damping_ratio)
    number, masses, frequencies, answers = zip(*rows, strict=True)
    w = np.array(frequencies)
    level = _rest(loop, w, rig.period) + np.array(answers)
    # The phase counts where the beam was measured, by its second mode, up to the Nyquist
    # frequency; the bound on that mode itself is one on its gain, whatever its phase.
    known = (np.array(number)[:, np.newaxis] > 2) & (w < math.pi / rig.period)
    known &= model.second_mode is not None
    level.imag[~known] = math.nan
    return HigherModes(np.array(number), np.array(masses), _seen(w, rig.period), level)


def _beam_modes(
    model: LinkModel, rig: Rig, payload: float, ratio: float | None
) -> list[tuple[int, float, Real, Complex]]:
    """(number, payload, ω, ln Θ̂t/Θm) of the modes of the beam that were not
    identified.
    """
    frequencies, sizes = modal_shares(Beam.from_rig(rig, payload=payload))
    modes = []
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
        # The whole sum instead of the mode's own term: the gauge also shows the tails
        # of the neighbouring modes, which add to it or subtract from it.
        modes.append((i + 1, payload, w, np.log(answer) - s * model.gauge_delay))
    return modes


def _around(model: LinkModel, frequency: float, ratio: float | None) -> Real:
    """Frequencies about the peak of a mode, which a power law shifts by 25 % for λ =
    1.92.
    """
    peak = frequency
    # ω² = ω_i² Re D(jω): a contraction, since Re D grows more slowly than ω
    for _ in range(30):
        law = complex(material_law(model, np.asarray(1j * peak), frequency, ratio))
        peak = frequency * math.sqrt(max(law.real, 0.25))
    law = complex(material_law(model, np.asarray(1j * peak), frequency, ratio))
    # arg D is 2ζ for small ζ. The lower bound keeps points on both sides of a peak that
    # the iteration above has determined to three digits only, which happens for α near
    # 2.
    width = min(max(0.5 * abs(math.atan2(law.imag, law.real)), 1e-3), _WIDEST)
    return peak * np.exp(width * _POINTS)


def _seen(w: Real, period: float) -> Real:
    """The frequency at which the computer sees ω: folded back beyond the Nyquist
    frequency.
    """
    nyquist = math.pi / period
    return np.maximum(
        np.abs(np.remainder(w + nyquist, 2.0 * nyquist) - nyquist), 1e-3 * nyquist
    )


def _rest(loop: Loop, w: Real, period: float) -> Complex:
    """ln(hold · M); beyond the Nyquist frequency M is taken at that frequency, where it
    is larger.
    """
    half = 0.5 * period * w
    motor = loop.motor_log(np.minimum(w, math.pi / period))
    return np.log(np.abs(np.sin(half)) / half + 1e-300) + motor


def mode_requirements(
    modes: HigherModes, loop: Loop, limit: float
) -> tuple[Requirement, ...]:
    """Return the worst loop gain towards -1 of each higher mode, against `limit`."""
    gains = modes.gains(loop)
    result = []
    for number in np.unique(modes.number):
        rows = np.flatnonzero(modes.number == number)
        worst = rows[int(np.argmax(gains[rows]))]
        result.append(
            Requirement(
                f"loop gain at mode {number}",
                limit,
                float(gains[worst]),
                "",
                float(modes.payload[worst]),
                "at most",
            )
        )
    return tuple(result)
