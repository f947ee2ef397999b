"""The link as seen by encoder and gauge together: B, its logarithm, magnitude and slope
over frequency.

The controller reads the tip from two sensors, ``θte = θm − g e^{−τ_g s} Γ/c``, and
``Γ/c = θm (1 − G)``. So

    θte/θm = B(s) = 1 − g e^{−τ_g s} (1 − G(s) + H(s)),

with G = (μ s^α + ω₀²)/(s^λ + μ s^α + ω₀²) the tip of the massless link, H its second
mode where one is known, g and τ_g the gain and the delay of the gauge. With g = 1, τ_g
= 0 and no second mode B is G.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from fraclink._arm.link import SecondMode
from fracsys.checks import Complex, Real

__all__ = ["GaugedLink"]


@dataclass(frozen=True)
class GaugedLink:
    """``B(jω; ω₀)``, vectorised over frequency and over links that differ in ω₀.

    Parameters
    ----------
    link_order, loss, damping_order
        λ, η = μ/ω₀² and α of the link; η is the material's and the same for every ω₀.
    gauge_delay, gauge_gain, second_mode
        τ_g [s], g, and the second mode, as in `LinkModel`.

    Examples
    --------
    >>> link = GaugedLink(link_order=1.92, gauge_delay=0.02)
    >>> round(float(np.exp(link.link_log(30.0, 11.0).real)), 4)
    0.6574
    """

    link_order: float = 2.0
    loss: float = 0.0
    damping_order: float = 1.0
    gauge_delay: float = 0.0
    gauge_gain: float = 1.0
    second_mode: SecondMode | None = None

    @property
    def exact_gauge(self) -> bool:
        """Whether B is G: no gauge delay, unit gauge gain, no second mode."""
        return (
            self.gauge_delay == 0.0
            and self.gauge_gain == 1.0
            and self.second_mode is None
        )

    def link_log(self, frequency: ArrayLike, natural_frequency: ArrayLike) -> Complex:
        """Return ln B(jω) of the link as seen by encoder and gauge together."""
        ln_w = np.log(np.asarray(frequency))
        inertia, elastic = self._link_terms(ln_w, natural_frequency)
        if not self.exact_gauge:
            return self._gauge_log(np.exp(ln_w), natural_frequency)
        # log1p: far below the resonance ln G is −s^λ/ω₀², which 1 + s^λ/ω₀² would round
        # away.
        if not self.loss:
            return -np.log1p(inertia)
        return np.log(elastic) - np.log(inertia + elastic)

    def _link_terms(
        self, ln_w: Real, natural_frequency: ArrayLike
    ) -> tuple[Complex, Complex]:
        """(jω)^λ and μ (jω)^α + ω₀² as shares of ω₀², in the upper half plane, so that
        principal logarithms stay continuous.
        """
        inertia = np.exp(self.link_order * ln_w) * np.exp(
            0.5j * np.pi * self.link_order
        )
        drag = np.exp(self.damping_order * ln_w) * np.exp(
            0.5j * np.pi * self.damping_order
        )
        return inertia / np.square(natural_frequency), 1.0 + self.loss * drag

    def denominator(
        self, frequency: ArrayLike, natural_frequency: ArrayLike
    ) -> Complex:
        """Return the product of the denominators of G and H at jω, over ω₀²: B times
        this has no pole.
        """
        w = np.asarray(frequency)
        inertia, elastic = self._link_terms(np.log(w), natural_frequency)
        mode = self.second_mode
        return (inertia + elastic) * (1.0 if mode is None else mode.denominator(1j * w))

    def parts(
        self, w: Real, natural_frequency: ArrayLike
    ) -> tuple[Complex, Real, Real]:
        """Return (B, |X|, unwrapped arg X) for X = g e^{-jωτ_g} Γ/(c θm), B = 1 − X.

        Γ/(c θm) lies in the upper half plane, as every mode of a link does at its root,
        so its own principal phase is continuous and the delay adds a straight line.
        """
        s = 1j * w
        inertia, elastic = self._link_terms(np.log(w), natural_frequency)
        whole = inertia + elastic
        # 1 − g e^{-τs} by expm1: at low frequencies B must not lose digits to a delay
        # of microseconds.
        lag = np.expm1(-self.gauge_delay * s)
        # One fraction: far above the resonance X is close to 1, and 1 − X would cancel.
        bracket = (
            elastic + inertia * ((1.0 - self.gauge_gain) - self.gauge_gain * lag)
        ) / whole
        torque = inertia / whole
        if self.second_mode is not None:
            mode = self.second_mode.response(s)
            torque = torque + mode
            bracket = bracket - self.gauge_gain * (1.0 + lag) * mode
        angle = (
            np.angle(torque)
            - self.gauge_delay * w
            + (math.pi if self.gauge_gain < 0.0 else 0.0)
        )
        return (
            bracket,
            np.abs(self.gauge_gain * torque),
            angle,
        )

    def _gauge_log(self, w: Real, natural_frequency: ArrayLike) -> Complex:
        """ln B with its unwrapped phase.

        Where |X| <= 1, B = 1 − X lies in the right half plane. Where |X| > 1, B
        encircles the origin together with X: arg B = arg X − π + arg(1 − 1/X), and the
        last term stays within ±π/2 again. The whole turns of arg X at the entry to and
        the exit from such an interval join the pieces.
        """
        w, frequency = np.broadcast_arrays(w, np.asarray(natural_frequency, float))
        bracket, _, angle = self.parts(w, frequency)
        phase, outside = np.angle(bracket), np.zeros(w.shape, bool)
        turns = np.zeros(w.shape)
        for value in np.unique(frequency):
            row = frequency == value
            for place, whole, entry in _unit_gains(self._alone, float(value)):
                past = row & (w > place)
                outside[past] = entry
                turns[past] += -whole if entry else whole
        with np.errstate(divide="ignore"):
            size = np.log(np.abs(bracket))
        # arg(1 − 1/X) from −B·X̄, which needs no division by X near zero.
        beyond = angle - math.pi + np.angle(-bracket * np.conj(1.0 - bracket))
        phase = np.where(outside, beyond, phase) + math.tau * turns
        return size + 1j * phase

    def turns(self, low: float, high: float, each: float) -> Real:
        """Return frequencies from `low` to `high` with `each` points per half turn of
        the delay's phase; |B| repeats after a whole turn.
        """
        count = int(each * abs(self.gauge_delay) * (high - low) / math.pi) + 2
        # 20 000 points: a delay of seconds, far beyond that of any gauge, must not fill
        # the memory.
        return np.linspace(low, high, min(count, 20_000))

    def about_mode(self, count: int) -> Real:
        """Return `count` frequencies about the second mode, or none if it is not known."""
        if self.second_mode is None:
            return np.empty(0)
        return self.second_mode.about(count)

    @cached_property
    def _alone(self) -> GaugedLink:
        """The link without the fields of a subclass: loops that differ only in Ĉ share
        its cached results.
        """
        return GaugedLink(*(getattr(self, field.name) for field in fields(GaugedLink)))

    def mode_band(self, natural_frequency: ArrayLike) -> tuple[Real, Real]:
        """Return the ends of the band about the second mode, from the geometric mean of
        both modes to as far above; (∞, ∞) if no second mode is known.
        """
        if self.second_mode is None:
            never = np.full(np.shape(natural_frequency), math.inf)
            return never, never
        mode = self.second_mode.frequency
        apart = np.sqrt(np.maximum(mode / self.peak(natural_frequency), 1.0))
        return mode / apart, mode * apart

    def peak(self, natural_frequency: ArrayLike) -> Real:
        """Return the resonance of the undamped structure, ``(-ω₀² cos(πλ/2))^(1/λ)``
        (eq. (14)) [rad/s].
        """
        square = np.square(np.asarray(natural_frequency, float))
        return (-square * math.cos(0.5 * math.pi * self.link_order)) ** (
            1.0 / self.link_order
        )

    def sufficient(self, natural_frequency: float) -> float:
        """Return the bound of condition (39), ``(-ω₀²/cos(πλ/2))^(1/λ)`` [rad/s]:
        sufficient only.
        """
        cosine = -math.cos(0.5 * math.pi * self.link_order)
        return float((natural_frequency**2 / cosine) ** (1.0 / self.link_order))


@lru_cache(maxsize=4096)  # a design evaluates the same few links repeatedly
def _unit_gains(
    link: GaugedLink, natural_frequency: float
) -> tuple[tuple[float, int, bool], ...]:
    """(ω, whole turns of arg X, whether |X| rises) of every crossing |X| = 1,
    ascending.

    The delay turns X without changing its modulus, so a scan about the modes finds all
    crossings.
    """
    # Seven decades about the resonance, with points whose distance to it shrinks
    # geometrically on both sides: |X| of a lightly damped link is steepest there, and a
    # crossing between two grid points would be lost.
    near = np.geomspace(1e-6, 0.3, 24)
    shape = np.concatenate(
        [np.geomspace(1e-3, 1e4, 200), 1.0 + near, 1.0 / (1.0 + near)]
    )
    grid = float(link.peak(natural_frequency)) * shape
    grid = np.concatenate([grid, link.about_mode(97)])
    grid = np.unique(grid)
    level = np.log(link.parts(grid, natural_frequency)[1])
    crossings = []
    for i in np.flatnonzero((level[:-1] > 0.0) != (level[1:] > 0.0)):
        # One secant step in ln ω: the crossing only decides on which branch of the
        # phase a point lies.
        share = level[i] / (level[i] - level[i + 1])
        place = float(grid[i] * (grid[i + 1] / grid[i]) ** share)
        angle = float(link.parts(np.asarray(place), natural_frequency)[2])
        crossings.append(
            (place, math.floor(angle / math.tau), bool(level[i + 1] > 0.0))
        )
    return tuple(crossings)
