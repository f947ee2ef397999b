"""The loop: controller, motor loop, hold, computation delay, and the link as seen by
the gauge.

    L = k_d s^β/(1 + δs)^n · M(s) e^{−τs} · B(s),    B = 1 − g e^{−τ_g s} (1 − G(s) + H(s)),

M is the motor loop, τ half a period of hold and the computation delay, and B the link
with the gauge's delay and gain and its second mode (`fraclink._arm.gauged_link`).

`Loop` is its logarithm with the true, unwrapped phase. Every factor is continuous in ω,
so neither a crossing nor an encirclement can be lost to a phase that jumps by 2π. Many
frequencies and many links (ω₀, and so payloads) are evaluated at once.
`fraclink._arm.sampled` has the exactly sampled plant of this loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.gauged_link import GaugedLink
from fraclink._arm.link import LinkModel
from fraclink._arm.motor import MotorConstants
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.notch import Notch
from fracsys._margins import Margins, margins
from fracsys._sweep import bracketed_roots
from fracsys.checks import Complex, Mask, Real

if TYPE_CHECKING:
    from fraclink._arm.controller import Controller
    from fraclink._arm.rig import Rig

__all__ = [
    "Crossings",
    "Loop",
    "noise_points",
    "with_payload",
]


# Points and weights of a panel of the noise integral. On nine designs the error of the
# noise gain is at most 0.9 %; with three points it is 9 %, with two 27 %.
_GAUSS = np.polynomial.legendre.leggauss(6)
_PANELS = np.geomspace(0.25, 8.0, 26)  # their edges, as multiples of the resonance
_STEP = 1e-5  # step in ln ω of a central difference: the cube root of the precision


def with_payload(model: LinkModel, rig: Rig) -> LinkModel:
    """Return the model with a known payload: its own, else ω₀ of eq. (5) at the rig's
    nominal payload.
    """
    if model.payload is not None:
        return model
    nominal, own = rig.payloads.nominal, rig.natural_frequency(rig.payloads.nominal)
    # The interval of the replaced ω₀ is dropped: a box would extend from there to the
    # rig's ω₀.
    intervals = tuple(row for row in model.intervals if row[0] != "natural_frequency")
    return replace(model, natural_frequency=own, payload=nominal, intervals=intervals)


@dataclass(frozen=True)
class Crossings:
    """Every gain crossing of loops that differ in ω₀ only; arrays of equal length, one
    entry per crossing.

    ``row`` is the index of ω₀, ``frequency`` in rad/s, ``phase`` the unwrapped phase of
    L [rad], ``slope`` the slope of ln|L| over ln ω: negative means that L falls below
    one.
    """

    row: NDArray[np.int64]
    frequency: Real
    phase: Real
    slope: Real

    @property
    def phase_margin(self) -> Real:
        """Angle of -L at each crossing, in (-π, π] [rad]."""
        return -np.remainder(-(self.phase + np.pi) + np.pi, 2 * np.pi) + np.pi


@dataclass(frozen=True)
class Loop(GaugedLink):
    """``L(jω; ω₀) = k (jω)^β / (1 + jδω)^n · e^{-jωτ} / (1 + jωε)² · B(jω; ω₀)``.

    Parameters
    ----------
    gain, order, filter_time, filter_order, notch
        k_d, β, δ [s], n and the notch of the controller; gain 1 and order 0 leave Ĉ out.
    link_order, loss, damping_order, gauge_delay, gauge_gain, second_mode
        the link and its gauge, as in `GaugedLink`.
    lag
        ε = 1/p of the motor loop M(s) [s], zero for an ideal motor.
    delay
        τ [s]: computation delay and half a period of hold.
    correction
        logarithm of the ratio of the sampled motor loop to M(s) with the delay, a
        function of ω, or None.
    highest
        frequency [rad/s] at which the search for crossings ends: the Nyquist frequency
        of a sampled controller.
    """

    gain: float = 1.0
    order: float = 0.0
    filter_time: float = 0.0
    filter_order: int = 1
    notch: Notch | None = None
    lag: float = 0.0
    delay: float = 0.0
    correction: Callable[[Real], Complex] | None = None
    highest: float = math.inf

    @staticmethod
    def around(
        model: LinkModel,
        motor_loop: MotorLoop,
        motor: MotorConstants,
        period: float,
        *,
        ratio: float = 1.0,
    ) -> Loop:
        """Return the loop without Ĉ, for a controller that runs at `period` [s].

        `ratio` is true over stated: the motor's gain or, if its loop is ideal, the pole
        of that loop.
        """
        correction = motor_loop.correction(motor, period, ratio=ratio)
        return replace(
            Loop.ideal(model),
            # The sampled PID was placed for the motor that the rig states, and runs on
            # the true one: its pole stays, and the correction holds the ratio.
            lag=1.0 / motor_loop.pole / (ratio if correction is None else 1.0),
            delay=(motor_loop.delay_samples + 0.5) * period,
            gauge_delay=model.gauge_delay,
            gauge_gain=model.gauge_gain,
            second_mode=model.second_mode,
            correction=correction,
            highest=math.pi / period,
        )

    @staticmethod
    def ideal(model: LinkModel) -> Loop:
        """Return G alone, as in the paper: no motor loop, no delay, an exact gauge."""
        return Loop(
            link_order=model.order,
            loss=model.loss,
            damping_order=model.damping_order,
        )

    @staticmethod
    def of(
        controller: Controller, model: LinkModel, rig: Rig, *, ratio: float = 1.0
    ) -> Loop:
        """Return the loop that runs: `controller` on `model`, with the rig's motor loop
        and period; `ratio` as in `around`.

        The controller's own motor loop and period take precedence over the rig's.
        """
        settings = controller.motor_loop or MotorLoop(
            rig.motor_loop.pole, rig.motor_loop.delay_samples
        )
        period = rig.period if controller.period is None else controller.period
        bare = Loop.around(model, settings, rig.motor, period, ratio=ratio)
        return bare.with_controller(controller)

    def with_controller(self, controller: Controller) -> Loop:
        """Return the loop with Ĉ of `controller`, its filter included."""
        return replace(
            self,
            gain=controller.derivative_gain,
            order=controller.derivative_order,
            filter_time=controller.filter_time,
            filter_order=controller.filter_order,
            notch=controller.notch,
        )

    def outer_log(self, frequency: ArrayLike) -> Complex:
        """Return ln Ĉ(jω)."""
        w = np.asarray(frequency)
        value = math.log(self.gain) + self.order * (np.log(w) + 0.5j * math.pi)
        if self.filter_time:
            value = value - self.filter_order * np.log(1.0 + 1j * self.filter_time * w)
        if self.notch is not None:
            value = value + self.notch.log(w)
        return value

    def motor_log(self, frequency: ArrayLike) -> Complex:
        """Return ln(M e^{-τs}) at jω: motor loop, hold and computation delay."""
        w = np.asarray(frequency)
        value = -1j * self.delay * w
        if self.lag:
            value = value - 2.0 * np.log1p(1j * self.lag * w)
        if self.correction is not None:
            value = value + self.correction(w)
        return value

    def log(self, frequency: ArrayLike, natural_frequency: ArrayLike) -> Complex:
        """Return ln L(jω) with the unwrapped phase as its imaginary part; the arguments
        broadcast.
        """
        return (
            self.outer_log(frequency)
            + self.link_log(frequency, natural_frequency)
            + self.motor_log(frequency)
        )

    def __call__(self, frequency: ArrayLike, natural_frequency: ArrayLike) -> Complex:
        """Return L(jω); a complex ω with a positive real part gives L(s) off the axis,
        at s = jω.
        """
        w = np.asarray(frequency)
        bracket, _, _ = self.parts(w, natural_frequency)
        return np.exp(self.outer_log(w) + self.motor_log(w)) * bracket

    def level(self, frequency: ArrayLike, natural_frequency: ArrayLike) -> Real:
        """Return ln|L(jω)|, the real part of `log`, without unwrapping the phase."""
        if self.exact_gauge:
            return self.log(frequency, natural_frequency).real
        # exp(log ω) as in `link_log`, so that both agree to the last bit.
        link, _, _ = self.parts(np.exp(np.log(frequency)), natural_frequency)
        with np.errstate(divide="ignore"):
            return (
                self.outer_log(frequency).real
                + np.log(np.abs(link))
                + self.motor_log(frequency).real
            )

    def log_and_slope(
        self, frequency: ArrayLike, natural_frequency: ArrayLike
    ) -> tuple[Complex, Complex]:
        """Return ln L(jω) as `log` does, and d ln L / d ln ω: real part the slope of
        the gain, imaginary part that of the phase.
        """
        # A central difference over such a small step is exact to 1e-9, and one formula
        # serves every factor of L.
        around = np.multiply.outer(np.exp([0.0, _STEP, -_STEP]), frequency)
        value, up, down = self.log(around, natural_frequency)
        return value, (up - down) / (2.0 * _STEP)

    def slope(self, frequency: ArrayLike, natural_frequency: ArrayLike) -> Complex:
        """Return d ln L / d ln ω."""
        return self.log_and_slope(frequency, natural_frequency)[1]

    def crossings(self, natural_frequency: ArrayLike) -> Crossings:
        """Return every crossing of |L| = 1 below `highest` for each ω₀ of the array."""
        w0 = np.atleast_1d(np.asarray(natural_frequency, float))
        w = self._grid(w0)
        level = self.level(w, w0[:, None])
        row, column = np.nonzero((level[:, :-1] > 0.0) != (level[:, 1:] > 0.0))
        frequency = np.exp(
            bracketed_roots(
                lambda x: self.level(np.exp(x), w0[row]),
                np.log(w[row, column]),
                np.log(w[row, column + 1]),
            )
        )
        value, slope = self.log_and_slope(frequency, w0[row])
        return Crossings(row, frequency, value.imag, slope.real)

    def _grid(self, w0: Real) -> Real:
        """One row of frequencies per ω₀: all at which |L| may be one, and the mode
        itself from both sides.

        A sharp peak of |L| lies within one per cent of the mode of G, so the points
        that cluster there keep a narrow peak from falling between two points.
        """
        mode = self.peak(w0)
        near = 1.0 + np.geomspace(1e-6, 0.2, 16)
        low, high = 1e-4, 1e4
        if self.order > 0.0:
            # Up to a quarter of the mode |L| < 2 k ω^β, far above it at most k ω₀²
            # ω^(β-λ): all crossings of |L| = 1 lie between the crossings of these
            # bounds.
            first = -math.log(2.0 * self.gain) / self.order
            low = min(
                0.25, math.exp(min(max(first, -300.0), 300.0)) / float(mode.max())
            )
        if self.order < self.link_order and not self.loss:
            reach = (math.log(self.gain) + 2.0 * np.log(w0)) / (
                self.link_order - self.order
            )
            high = max(
                high, float(np.max(2.0 * np.exp(np.minimum(reach, 300.0)) / mode))
            )
        decades = math.log10(high / low)
        shape = np.unique(
            np.concatenate(
                [
                    np.geomspace(low, high, int(15 * decades) + 1),
                    near,
                    1.0 / near,
                    [1.0],
                ]
            )
        )
        parts = [mode[:, None] * shape, self._top(w0)[:, None]]
        if not self.exact_gauge:
            points = self._gauge_points(w0)
            parts.append(np.broadcast_to(points, (w0.size, points.size)))
        grid = np.minimum(np.sort(np.concatenate(parts, axis=1), axis=1), self.highest)
        # the points of a row beyond `highest` all coincide with it
        count = int(np.sum(np.any(grid < self.highest, axis=0))) + 1
        return grid[:, :count]

    def _gauge_points(self, w0: Real) -> Real:
        """Frequencies at which a late gauge or a second mode bends |B| faster than the
        grid of G follows.

        A delay makes |B| oscillate with the period 2π/τ_g in ω, up to the highest
        frequency where |L| can reach one.
        """
        mode = self.peak(w0)
        points = [mode[:1], self.about_mode(65)]
        if self.gauge_delay:
            low, high = (
                0.25 * float(mode.min()),
                min(self.highest, 1e3 * float(mode.max())),
            )
            scan = np.geomspace(low, high, 80)
            # Away from the resonances |X| stays below |g| (2 + the share of mode 2); the
            # grid of G and the points about mode 2 cover the resonances themselves.
            most = 1.0 + abs(self.gauge_gain) * (
                2.0 + (self.second_mode.gain if self.second_mode else 0.0)
            )
            loud = (self.outer_log(scan) + self.motor_log(scan)).real + math.log(
                most
            ) > 0.0
            top = float(scan[loud][-1]) if loud.any() else 4.0 * float(mode.max())
            points.append(self.turns(low, max(top, 1.01 * low), 6.0))
        return np.concatenate(points)

    def _top(self, w0: Real) -> Real:
        """Peak of |Ĉ G|, where the denominator of (49) vanishes: a quadratic in ω^λ.

        As a grid point it keeps a peak just above one from falling between its
        neighbours.
        """
        if not 0.0 < self.order < self.link_order:
            return self.peak(w0)
        rest, cosine = (
            self.link_order - self.order,
            math.cos(0.5 * math.pi * self.link_order),
        )
        half = 0.5 * (rest - self.order) * cosine
        root = (-half + math.sqrt(half * half + rest * self.order)) / rest
        return (root * w0**2) ** (1.0 / self.link_order)

    def margins(self, natural_frequency: ArrayLike) -> tuple[Real, Real]:
        """Return (upper gain crossover, signed phase margin) for each ω₀.

        If |L| only exceeds one in a peak at the second mode, the crossings there are not
        the loop's crossover, but their margins count like any other's.

        The margin is the smallest over all crossings, negative where the closed loop is
        unstable; without a crossing it counts as π and the crossover as 0. L is
        open-loop stable, so the loop is stable where -1 is not encircled: |L| > 1
        between a rising and the next falling crossing, and inside, each time the
        unwrapped phase passes -π (mod 2π), the curve passes left of -1.
        """
        w0 = np.atleast_1d(np.asarray(natural_frequency, float))
        crossings = self.crossings(w0)
        crossover, margin = np.zeros(w0.size), np.full(w0.size, math.pi)
        first = ~self._at_mode(crossings, w0)
        np.maximum.at(crossover, crossings.row[first], crossings.frequency[first])
        np.minimum.at(margin, crossings.row, np.abs(crossings.phase_margin))
        # Clockwise encirclements of -1 for each ω₀.
        turns = crossings.phase / math.tau + 0.5
        encirclements = np.zeros(w0.size)
        passed = np.where(crossings.slope > 0.0, np.floor(turns), -np.floor(turns))
        np.add.at(encirclements, crossings.row, passed)
        return crossover, np.where(encirclements == 0.0, margin, -margin)

    def _at_mode(self, crossings: Crossings, w0: Real) -> Mask:
        """Flags of the crossings that belong to the resonance of the second mode."""
        low, high = self.mode_band(w0)
        near = (crossings.frequency > low[crossings.row]) & (
            crossings.frequency < high[crossings.row]
        )
        rows, first = np.unique(crossings.row[near], return_index=True)
        alone = np.zeros(w0.size, bool)
        alone[rows] = crossings.slope[near][first] > 0.0
        return near & alone[crossings.row]

    def margins_at(self, natural_frequency: float) -> Margins:
        """Return every crossing and margin at one ω₀, from the general engine
        `fracsys.margins`.
        """
        limit = self.highest if math.isfinite(self.highest) else None
        return margins(
            lambda s: self(np.imag(s), natural_frequency), limit=limit, unstable_poles=0
        )

    def noise_gain(self, natural_frequency: ArrayLike, period: float) -> Real:
        """Return the noise gain for each ω₀, ``(∫₀^{ωN} |Ĉ/(1+L)|² dω / ωN)^½`` (30),
        ωN = π/`period`.

        It is the RMS of the motor reference over the RMS of white gauge noise, both as
        angles: the torque noise is divided by the stiffness.
        """
        w0 = np.atleast_1d(np.asarray(natural_frequency, float))
        w, weights = noise_points(self, w0, period)
        gain = np.exp(self.outer_log(w).real) / np.abs(1.0 + self(w, w0[:, None]))
        return np.asarray(np.sqrt(np.sum(gain**2 * weights, axis=1)))


def noise_points(
    loop: Loop, natural_frequencies: Real, period: float
) -> tuple[Real, Real]:
    """Frequencies and weights of the mean over [0, π/Ts] in `Loop.noise_gain`, one row
    for each ω₀.

    Six Gauss points on panels that shrink towards the mode, where |1 + L| changes
    fastest.
    """
    nyquist = math.pi / period
    modes = loop.peak(natural_frequencies)[:, None]
    common = [np.array([0.0, nyquist]), loop.about_mode(17)]
    if loop.gauge_delay:
        # |1 + L| oscillates with the delay up to the Nyquist frequency. Without these
        # panels the noise gain of a loop without a filter and with a gauge 20 ms late is
        # 0.8 % off.
        common.append(loop.turns(0.0, nyquist, 2.0)[1:])
    edges = np.concatenate([modes * _PANELS, modes * 0.0 + np.concatenate(common)], 1)
    # panels beyond the Nyquist frequency have no width there
    edges = np.sort(np.minimum(edges, nyquist), axis=1)
    half = 0.5 * np.diff(edges)[..., None]
    points, weights = edges[:, :-1, None] + half * (1.0 + _GAUSS[0]), half * _GAUSS[1]
    return points.reshape(modes.size, -1), weights.reshape(modes.size, -1) / nyquist
