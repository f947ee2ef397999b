"""The open loop a design is asked for, as its complex logarithm with the true, unwrapped phase.

``ln L = ln k + β ln(jω) - n ln(1 + jδω) - 2 ln(1 + jω/p) - jωτ + ln G(jω)``, each term continuous in ω, so
that neither a crossing nor an encirclement can be lost to a phase that jumps by 2π.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.controller import Lead

__all__ = ["Crossings", "OpenLoop"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Crossings:
    """Every gain crossing of loops that differ in ω₀ only; arrays of equal length, one entry a crossing.

    ``row`` is the index of ω₀, ``frequency`` in rad/s, ``phase`` the unwrapped phase of L [rad], ``slope``
    the slope of ln|L| over ln ω: negative means that L falls below one.
    """

    row: NDArray[np.int64]
    frequency: Real
    phase: Real
    slope: Real

    @property
    def phase_margin(self) -> Real:
        """Angle of -L at each crossing, in (-π, π] [rad]."""
        return np.asarray(-np.remainder(-(self.phase + np.pi) + np.pi, 2 * np.pi) + np.pi)


@dataclass(frozen=True)
class OpenLoop:
    """``L(jω; ω₀) = k (jω)^β / (1 + jδω)^n · e^{-jωτ} / (1 + jωε)² · G(jω; ω₀)``.

    ``lag`` is ε = 1/p of the motor loop M(s), zero for the ideal one; ``delay`` is τ [s]; a ``lead`` is a
    further factor.
    ``G = (μ s^α + ω₀²)/(s^λ + μ s^α + ω₀²)``. ``correction(ω)`` is the logarithm of what the sampled
    motor loop makes of M(s) and the delay, where it is known.
    """

    gain: float
    order: float
    link_order: float
    damping: float = 0.0
    damping_order: float = 1.0
    filter_time: float = 0.0
    filter_order: int = 1
    lag: float = 0.0
    delay: float = 0.0
    correction: Callable[[Real], Complex] | None = None
    lead: Lead | None = None

    def log(self, frequency: ArrayLike, natural_frequency: ArrayLike) -> Complex:
        """Return ln L(jω) with the unwrapped phase as its imaginary part; the arguments broadcast."""
        w = np.asarray(frequency, dtype=float)
        value = self.outer_log(w) + self._log_link(np.log(w), natural_frequency)
        if self.lag:
            value = value - 2.0 * np.log(1.0 + 1j * self.lag * w)
        if self.correction is not None:
            value = value + self.correction(w)
        return np.asarray(value - 1j * self.delay * w, dtype=np.complex128)

    def level(self, frequency: ArrayLike, natural_frequency: ArrayLike) -> Real:
        """Return ln|L(jω)|: the real part of `log` in real arithmetic, for scans of many points."""
        w = np.asarray(frequency, dtype=float)
        ln_w, spring = np.log(w), np.square(np.asarray(natural_frequency, dtype=float))
        inertia, turn = np.exp(self.link_order * ln_w), 0.5 * math.pi * self.link_order
        real, imaginary = spring + inertia * math.cos(turn), inertia * math.sin(turn)
        value = math.log(self.gain) + self.order * ln_w + np.log(spring)
        if self.damping:
            drag = self.damping * np.exp(self.damping_order * ln_w)
            along, across = (f(0.5 * math.pi * self.damping_order) for f in (math.cos, math.sin))
            value = value - np.log(spring) + 0.5 * np.log((spring + drag * along) ** 2 + (drag * across) ** 2)
            real, imaginary = real + drag * along, imaginary + drag * across
        value = value - 0.5 * np.log(real * real + imaginary * imaginary)
        for time, power in ((self.filter_time, self.filter_order), (self.lag, 2)):
            if time:
                value = value - 0.5 * power * np.log1p((time * w) ** 2)
        if self.lead is not None:
            value = value + self.lead.log(w).real
        if self.correction is not None:
            value = value + self.correction(w).real
        return np.asarray(value)

    def _link_terms(self, ln_w: Real, natural_frequency: ArrayLike) -> tuple[Complex, Complex, Complex]:
        """(jω)^λ, μ (jω)^α and ω₀²: upper half plane all of them, so principal logarithms stay continuous."""
        inertia = np.exp(self.link_order * ln_w) * np.exp(0.5j * np.pi * self.link_order)
        drag = self.damping * np.exp(self.damping_order * ln_w) * np.exp(0.5j * np.pi * self.damping_order)
        return inertia, drag, np.square(np.asarray(natural_frequency, dtype=np.complex128))

    def _log_link(self, ln_w: Real, natural_frequency: ArrayLike) -> Complex:
        inertia, drag, spring = self._link_terms(ln_w, natural_frequency)
        if not self.damping:
            return np.asarray(-np.log1p(inertia / spring), dtype=np.complex128)
        return np.asarray(np.log(drag + spring) - np.log(inertia + drag + spring), dtype=np.complex128)

    def slope(self, frequency: ArrayLike, natural_frequency: ArrayLike) -> Complex:
        """Return d ln L / d ln ω: real part the slope of the gain, imaginary part that of the phase."""
        w = np.asarray(frequency, dtype=float)
        inertia, drag, spring = self._link_terms(np.log(w), natural_frequency)
        bottom = inertia + drag + spring
        value = (
            self.order
            - (self.link_order * inertia + self.damping_order * drag) / bottom
            - 1j * self.delay * w
        )
        if self.damping:
            value = value + self.damping_order * drag / (drag + spring)
        for time, power in ((self.filter_time, self.filter_order), (self.lag, 2)):
            if time:
                value = value - power * 1j * time * w / (1.0 + 1j * time * w)
        for factor in (self.correction, None if self.lead is None else self.lead.log):
            if factor is None:
                continue
            step = (
                1e-5  # of ln ω: the central difference is then good to 1e-10, ample for Newton and for signs
            )
            up, down = factor(w * math.exp(step)), factor(w * math.exp(-step))
            value = value + (up - down) / (2.0 * step)
        return np.asarray(value, dtype=np.complex128)

    def link(self) -> OpenLoop:
        """Return the link alone, G: nothing else of the loop."""
        return OpenLoop(1.0, 0.0, self.link_order, self.damping, self.damping_order)

    def outer_log(self, frequency: ArrayLike) -> Complex:
        """Return ln Ĉ(jω) alone, as the loop has it: without its filter in the paper's reading."""
        w = np.asarray(frequency, dtype=float)
        value = math.log(self.gain) + self.order * (np.log(w) + 0.5j * np.pi)
        if self.filter_time:
            value = value - self.filter_order * np.log(1.0 + 1j * self.filter_time * w)
        if self.lead is not None:
            value = value + self.lead.log(w)
        return np.asarray(value, dtype=np.complex128)

    def __call__(self, frequency: ArrayLike, natural_frequency: ArrayLike) -> Complex:
        """Return L(jω)."""
        return np.asarray(np.exp(self.log(frequency, natural_frequency)), dtype=np.complex128)

    def peak(self, natural_frequency: ArrayLike) -> Real:
        """Return the resonance of the undamped structure, ``(-ω₀² cos(πλ/2))^(1/λ)`` (eq. (14)) [rad/s]."""
        squared = np.square(np.asarray(natural_frequency, dtype=float))
        return np.asarray((-squared * math.cos(0.5 * math.pi * self.link_order)) ** (1.0 / self.link_order))

    def sufficient(self, natural_frequency: float) -> float:
        """Return the bound of condition (39), ``(-ω₀²/cos(πλ/2))^(1/λ)`` [rad/s]: sufficient only."""
        cosine = -math.cos(0.5 * math.pi * self.link_order)
        return float((natural_frequency**2 / cosine) ** (1.0 / self.link_order))

    def crossings(self, natural_frequency: ArrayLike, *, highest: float = math.inf) -> Crossings:
        """Return every crossing of |L| = 1 below `highest` [rad/s] for each ω₀ of the array."""
        pi = np.atleast_1d(np.asarray(natural_frequency, dtype=float))
        w = self._grid(pi, highest)
        level = self.level(w, pi[:, None])
        row, column = np.nonzero((level[:, :-1] > 0.0) != (level[:, 1:] > 0.0))
        frequency = self._polish(w[row, column], w[row, column + 1], level[row, column], pi[row])
        value = self.log(frequency, pi[row])
        return Crossings(row, frequency, value.imag, self.slope(frequency, pi[row]).real)

    def _grid(self, pi: Real, highest: float) -> Real:
        """One row of frequencies a ω₀: eight decades around the mode, and the mode itself from both sides.

        Between two crossings the peak of |L| lies within a per cent of the mode of G when it is sharp, so the
        points that cluster there are what keeps a narrow peak from hiding between two points.
        """
        mode = self.peak(pi)
        # A lead changes the level by no more than its gain at high frequency, (a/b)^ν, up or down.
        spread = 0.0
        if self.lead is not None:
            spread = self.lead.order * abs(math.log(self.lead.zero_time / self.lead.pole_time))
        near = 1.0 + np.geomspace(1e-6, 0.2, 16)
        low, high = 1e-4, 1e4
        if self.order > 0.0:
            # Far below the mode |L| = k ω^β, far above at most k ω₀² ω^(β-λ): they cross one where these do.
            first = math.exp(min(max(-(math.log(self.gain) + spread) / self.order, -300.0), 300.0))
            low = min(low, float(np.min(0.5 * first / mode)))
        if self.order < self.link_order and not self.damping:
            reach = (math.log(self.gain) + spread + 2.0 * np.log(pi)) / (self.link_order - self.order)
            high = max(high, float(np.max(2.0 * np.exp(np.minimum(reach, 300.0)) / mode)))
        decades = math.log10(high / low)
        shape = np.unique(
            np.concatenate([np.geomspace(low, high, int(15 * decades) + 1), near, 1.0 / near, [1.0]])
        )
        grid = np.concatenate([mode[:, None] * shape, self._top(pi)[:, None]], axis=1)
        grid = np.minimum(np.sort(grid, axis=1), highest)
        needed = int(np.sum(np.any(grid < highest, axis=0))) + 1  # past it every row stands at `highest`
        return np.asarray(grid[:, :needed])

    def _top(self, pi: Real) -> Real:
        """Peak of |Ĉ G|, where the denominator of (49) vanishes: a quadratic in ω^λ.

        As a point of the grid it keeps a peak that only just exceeds one from hiding between its neighbours.
        """
        if not 0.0 < self.order < self.link_order:
            return self.peak(pi)
        rest, cosine = self.link_order - self.order, math.cos(0.5 * math.pi * self.link_order)
        half = 0.5 * (rest - self.order) * cosine
        root = (-half + math.sqrt(half * half + rest * self.order)) / rest
        return np.asarray((root * pi**2) ** (1.0 / self.link_order))

    def _polish(self, low: Real, high: Real, level: Real, pi: Real) -> Real:
        """Newton in ln ω, kept inside its bracket by bisection; converges quadratically in 4 to 6 rounds."""
        a, b, above = np.log(low), np.log(high), level > 0.0
        x = 0.5 * (a + b)
        for _ in range(50):
            w = np.exp(x)
            value = self.level(w, pi)
            a, b = np.where((value > 0.0) == above, x, a), np.where((value > 0.0) == above, b, x)
            step = -value / self.slope(w, pi).real
            new = x + step
            new = np.where((new >= a) & (new <= b), new, 0.5 * (a + b))
            done = np.all(np.abs(new - x) <= 1e-15 * (1.0 + np.abs(x)))
            x = new
            if done:
                break
        return np.exp(x)

    def encirclements(self, natural_frequency: float, *, highest: float = math.inf) -> int:
        """Return how often -1 is encircled clockwise by L(jω), ω from 0 up: the closed loop is stable at 0.

        |L| > 1 between an upward and the next downward crossing; inside, each time the unwrapped phase passes
        -π (mod 2π) the curve passes left of -1. L is open-loop stable, so zero means closed-loop stable.
        """
        found = self.crossings(natural_frequency, highest=highest)
        turns = np.floor((found.phase + np.pi) / (2.0 * np.pi))
        return int(np.sum(np.where(found.slope > 0.0, turns, -turns)))
