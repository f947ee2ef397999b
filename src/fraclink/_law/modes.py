"""The loop at the higher modes of the link.

The strain gauge responds to them clearly. Their level is that of the sampled plant with
its first aliases, which double it near the Nyquist frequency. A second mode that was
identified replaces that of the beam.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.beam import (
    Beam,
    assumed_ratio,
    material_law,
    modal_shares,
    modes_of,
    unmodelled_modes,
)
from fraclink._arm.box import Arm
from fraclink._arm.link import LinkModel
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.rig import Rig
from fraclink._law.requirement import Requirement
from fracsys.checks import Complex, Real, above

__all__ = [
    "MODE_LIMIT",
    "MODE_POINTS",
    "PHASE_DOUBT",
    "HigherModes",
    "higher_modes",
    "mode_requirements",
]


# Limit of the loop gain towards -1: the distance that it leaves is one over the customary
# sensitivity peak of 2.
MODE_LIMIT = 0.5
# Possible phase error at a mode that was not identified: 29°, the phase margin that such
# a loop has elsewhere.
PHASE_DOUBT = 2.0 * math.asin(0.5 * MODE_LIMIT)
# so that the points of a strongly damped mode do not extend down to the first mode
_WIDEST = 0.035
# points in ln ω as multiples of the damping ratio, densest at the peak
_POINTS = np.sinh(np.linspace(-3.0, 3.0, 61))
MODE_POINTS = _POINTS.size


@dataclass(frozen=True)
class HigherModes:
    """Frequencies of modes 2 and 3 of a link, and the loop without Ĉ there.

    One row for each payload and mode: ``number`` (K,), ``payload`` (K,) [kg],
    ``frequency`` (K, N) [rad/s] as the computer sees it, ``level`` (K, N), ln of the
    sampled plant, whose imaginary part is NaN where the phase does not count.
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

    def gains(self, response: Callable[[Real], Complex]) -> Real:
        """Return the loop gain of each row towards -1 with Ĉ(jω) of a controller or of
        its law, shape (K,).
        """
        log = np.log(response(self.frequency)) + self.level
        peak = np.argmax(log.real, axis=1)[:, np.newaxis]
        return _gain_towards(np.take_along_axis(log, peak, axis=1)[:, 0])


def _gain_towards(peak: Complex) -> Real:
    """The part of a mode's loop gain that points to -1, from ln L at its peak.

    About a lightly damped mode L runs round a circle through 0 and its peak L_p, whose
    distance to -1 is |1 + L_p/2| - |L_p|/2. One minus that is |L_p| where it points to
    -1, or where its phase does not count, and less elsewhere.
    """
    radius = 0.5 * np.exp(peak.real)
    angle = np.remainder(peak.imag + math.pi, math.tau) - math.pi
    turned = np.abs(angle) + PHASE_DOUBT
    towards = 1.0 + radius - np.abs(1.0 + radius * np.exp(1j * turned))
    return np.where(turned < math.pi, towards, 2.0 * radius)


def higher_modes(
    arm: Arm,
    rig: Rig,
    settings: MotorLoop,
    payloads: Iterable[float],
    *,
    damping_ratio: float | None = None,
) -> HigherModes | None:
    """Return the higher modes of the link over `payloads` [kg], None if neither rig nor
    model has one.

    Parameters
    ----------
    arm
        the link with its second mode, where it was identified, its gauge and its motor;
        its damping law also holds for the rig's beam.
    rig
        length, stiffness and mass of the link; motor and control period.
    settings
        the motor loop.
    payloads
        [kg], > 0.
    damping_ratio
        of the beam's modes, 0 < ζ < 1, instead of the model's law; 0.02 where the model
        has no damping.
    """
    model = arm.model
    if rig.link.mass <= 0.0 and model.second_mode is None:
        return None
    if damping_ratio is not None:
        damping_ratio = above(0.0, 0.999).check("damping_ratio", damping_ratio)
    rows: list[tuple[int, float, Real, Complex]] = []
    nyquist = math.pi / rig.period
    for payload in payloads:
        link = model.at_payload(payload) if model.payload else model
        higher = unmodelled_modes(link, rig, payload, damping_ratio)
        whole = replace(arm, model=link).plant(settings, rig, rig.period, higher=higher)
        for mode, w in _about_modes(link, rig, payload, damping_ratio):
            seen = _seen(w, rig.period)
            # A mode beyond the Nyquist frequency may fold back to where the loop
            # crosses: there, only its own part counts.
            lower = replace(link, second_mode=None) if mode == 2 else link
            without = replace(arm, model=lower).plant(settings, rig, rig.period)
            rest = np.where(w > nyquist, without(seen, aliases=1), 0.0)
            level = np.log(whole(seen, aliases=1) - rest)
            rows.append((mode, payload, w, level))
    number, masses, frequencies, levels = map(np.array, zip(*rows, strict=True))
    # With an identified second mode the phase of the modes above it counts, up to the
    # Nyquist frequency; the second mode itself is bounded in gain, whatever its phase.
    known = (number[:, np.newaxis] > 2) & (frequencies < nyquist)
    known &= model.second_mode is not None
    levels.imag[~known] = math.nan
    return HigherModes(number, masses, _seen(frequencies, rig.period), levels)


def _about_modes(
    model: LinkModel, rig: Rig, payload: float, damping_ratio: float | None
) -> Iterator[tuple[int, Real]]:
    """(number, frequencies about its peak) of each higher mode of the link."""
    if model.second_mode is not None:
        width = min(model.second_mode.damping_ratio, _WIDEST)
        yield 2, model.second_mode.frequency * np.exp(width * _POINTS)
    if rig.link.mass > 0.0:
        # A fractional or viscous damping law damps the higher modes like the first.
        # Without one their peaks would be infinite, and no filter would suffice.
        ratio = damping_ratio or assumed_ratio(model)
        frequencies, _ = modal_shares(Beam.from_rig(rig, payload=payload))
        for i in range(modes_of(model), frequencies.size):
            yield i + 1, _around(model, float(frequencies[i]), ratio)


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


def mode_requirements(
    modes: HigherModes, response: Callable[[Real], Complex], limit: float
) -> tuple[Requirement, ...]:
    """Return the worst loop gain towards -1 of each higher mode, against `limit`."""
    gains = modes.gains(response)
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
