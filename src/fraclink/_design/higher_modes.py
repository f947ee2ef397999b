"""The second and third mode of a link with mass, which no design sees and the strain gauge sees well.

On a uniform clamped beam with a payload the estimate of the tip answers the motor with

    Θ̂t/Θm = 1 - Σ share_i s²/(s² + ω_i² D_i(s)),   share_i = Γi² ω_i²/c,

where D is the damping law of the link model: s^(2-λ), or 1 + μ s^α/ω₀². For a massless link the sum has one
term, of share one, and is the G of the design.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink._design.loop import OpenLoop
from fraclink._design.plan import Design, Requirement, open_loop
from fraclink._validate import checked_between

if TYPE_CHECKING:
    from fraclink._arm.beam import Beam
    from fraclink._arm.link import LinkModel
    from fraclink._arm.rig import Rig

__all__ = ["LIMIT", "HigherModes", "higher_modes", "mode_gains", "spillover_requirements"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

LIMIT = 0.5  # of the loop gain: 6 dB below the one at which phase alone would decide
ASSUMED_RATIO = 0.02  # of a model without damping, whose modes would be infinitely high
_MODES = 3  # the fourth mode of the paper's arm lies beyond the Nyquist frequency, where the hold ends it
_PAYLOADS = 3  # the gain of a mode changes by 3 % over a range of two: its ends and the middle are plenty
_WIDEST = 0.035  # so that the points of a mode that is damped away do not reach down to the first mode
_POINTS = np.sinh(np.linspace(-3.0, 3.0, 61))  # of ln ω in damping ratios: closest at the peak


@dataclass(frozen=True)
class HigherModes:
    """Where modes 2 and 3 of a link lie, and what the loop there is without Ĉ.

    One row for each payload and mode: ``number`` (K,), ``payload`` (K,) [kg], ``frequency`` (K, N) [rad/s] as
    the computer sees it, ``level`` (K, N), ln|hold · M · Θ̂t/Θm|.
    """

    number: NDArray[np.int64]
    payload: Real
    frequency: Real
    level: Real

    def gains(self, loop: OpenLoop) -> Real:
        """Return the largest loop gain of each row with the Ĉ of `loop`, shape (K,)."""
        return np.asarray(np.max(np.exp(loop.outer_log(self.frequency).real + self.level), axis=1))


@lru_cache(maxsize=64)
def _shape(beam: Beam) -> tuple[Real, Real]:
    """(ω_i, Γi² ω_i²) of the clamped beam; asked for again by every request for one rig."""
    modes = beam.modes(_MODES)
    return modes.frequencies, modes.participation * modes.curvature


def higher_modes(
    model: LinkModel,
    rig: Rig,
    loop: OpenLoop,
    payloads: tuple[float, float],
    *,
    damping_ratio: float | None = None,
) -> HigherModes | None:
    """Return modes 2 and 3 of the rig's link over `payloads` [kg], None where the link has no mass.

    Parameters
    ----------
    model
        its damping law is taken for every mode.
    rig
        length, stiffness and mass of the link; control period.
    loop
        the loop whose motor loop stands before the link.
    payloads
        (lightest, heaviest) [kg], > 0.
    damping_ratio
        of modes 2 and 3, 0 < ζ < 1, instead of the model's law; 0.02 where the model has no damping.
    """
    from fraclink._arm.beam import Beam

    if rig.link.mass <= 0.0:
        return None
    if damping_ratio is not None:
        damping_ratio = checked_between("mode_damping", damping_ratio, 0.0, 0.999, open_low=True)
    elif model.order == 2.0 and model.damping == 0.0:
        damping_ratio = ASSUMED_RATIO
    number, masses, rows, levels = [], [], [], []
    for payload in np.unique(np.geomspace(*payloads, _PAYLOADS)):
        frequencies, sizes = _shape(Beam.from_rig(rig, payload=float(payload)))
        for i in range(1, frequencies.size):
            w = _around(model, float(frequencies[i]), damping_ratio)
            answer = _estimate(
                model,
                frequencies,
                sizes / model.stiffness,
                np.asarray(1j * w, dtype=np.complex128),
                damping_ratio,
            )
            number.append(i + 1)
            masses.append(float(payload))
            rows.append(_seen(w, rig.period))
            levels.append(_rest(loop, w, rig.period) + np.log(np.abs(answer)))
    return HigherModes(np.array(number), np.array(masses), np.array(rows), np.array(levels))


def _law(model: LinkModel, s: Complex, frequency: float, ratio: float | None) -> Complex:
    """D_i(s) of the mode at `frequency` [rad/s]."""
    if ratio is not None:
        return np.asarray(1.0 + 2.0 * ratio * s / frequency)
    if model.order < 2.0:
        return np.asarray(np.exp((2.0 - model.order) * np.log(s)))
    turned = np.exp(model.damping_order * np.log(s))
    return np.asarray(1.0 + model.damping / model.natural_frequency**2 * turned)


def _around(model: LinkModel, frequency: float, ratio: float | None) -> Real:
    """Frequencies about the peak of a mode: a power law moves it, by 25 % for λ = 1.92."""
    peak = frequency
    for _ in range(30):  # ω² = ω_i² Re D(jω), a contraction as Re D grows by less than ω^1
        peak = frequency * math.sqrt(
            max(complex(_law(model, np.asarray(1j * peak), frequency, ratio)).real, 0.25)
        )
    law = complex(_law(model, np.asarray(1j * peak), frequency, ratio))
    width = min(max(0.5 * abs(math.atan2(law.imag, law.real)), 1e-3), _WIDEST)
    return np.asarray(peak * np.exp(width * _POINTS))


def _estimate(model: LinkModel, frequencies: Real, shares: Real, s: Complex, ratio: float | None) -> Complex:
    """Θ̂t/Θm at s."""
    answer = np.ones(s.shape, dtype=np.complex128)
    for frequency, share in zip(frequencies, shares, strict=True):
        answer -= share * s**2 / (s**2 + frequency**2 * _law(model, s, float(frequency), ratio))
    return answer


def _seen(w: Real, period: float) -> Real:
    """Where the computer sees ω: beyond the Nyquist frequency it is folded back."""
    nyquist = math.pi / period
    return np.maximum(np.abs(np.remainder(w + nyquist, 2.0 * nyquist) - nyquist), 1e-3 * nyquist)


def _rest(loop: OpenLoop, w: Real, period: float) -> Real:
    """ln|hold · M|; beyond the Nyquist frequency M is taken there, where it is larger."""
    half = 0.5 * period * w
    inside = np.minimum(w, math.pi / period)
    motor = np.zeros_like(w)
    if loop.lag:
        motor -= np.log1p((loop.lag * inside) ** 2)
    if loop.correction is not None:
        motor += loop.correction(inside).real
    return np.asarray(np.log(np.abs(np.sin(half)) / half + 1e-300) + motor)


def spillover_requirements(modes: HigherModes, loop: OpenLoop, limit: float) -> tuple[Requirement, ...]:
    """Return the worst loop gain at each higher mode against `limit`."""
    gains = modes.gains(loop)
    found = []
    for number in np.unique(modes.number):
        rows = np.flatnonzero(modes.number == number)
        worst = rows[int(np.argmax(gains[rows]))]
        name, payload = f"loop gain at mode {number}", float(modes.payload[worst])
        found.append(Requirement.at_most(name, limit, float(gains[worst]), "", payload))
    return tuple(found)


def mode_gains(
    design: Design, *, limit: float = LIMIT, damping_ratio: float | None = None
) -> tuple[Requirement, ...]:
    """Return the loop gain at modes 2 and 3 of the rig's link against `limit`; empty for a massless link.

    Below one a mode cannot be destabilised, whatever its phase. The link's mass is the rig's
    (``[link] mass_kg``), its damping the model's unless `damping_ratio` is given.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import fraclink as fl
    >>> from fraclink._design.higher_modes import mode_gains
    >>> rig = fl.Rig.named("paper-2023")
    >>> rig = replace(rig, link=replace(rig.link, mass=0.00735))
    >>> design = fl.design(rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50))
    >>> second, third = mode_gains(design)
    >>> second.passed, 1.3 < second.achieved < 1.6
    (False, True)
    """
    checked = checked_between("limit", limit, 0.0, 1e3, open_low=True)
    loop = open_loop(design.controller, design.model, design.rig, margins="loop")
    modes = higher_modes(design.model, design.rig, loop, design.payloads, damping_ratio=damping_ratio)
    return () if modes is None else spillover_requirements(modes, loop, checked)
