"""Equations and search behind `tune_pid`: gains from margins, remaining parameters from
the least ITAE.

With s^(-λ) and s^μ/(1 + T_f s)^n as given functions C is linear in its gains. L(jω_c) =
e^(j(φ_m − π)) are two real equations, the slope of arg L at ω_c is a third: three gains
follow from one linear system for each (λ, μ). The rest, the two orders and possibly
slope and ω_c, is left to differential evolution, which needs no start and crosses the
gaps between the ranges in which a loop is stable.

Source: Storn and Price, J. Global Optimization 11 (1997) 341–359.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import differential_evolution

from fraclink._arm.fractional_pid import FractionalPid
from fracsys._fractional import FractionalTransferFunction
from fracsys._loops import as_loop
from fracsys._precision import DIFFERENCE_STEP
from fracsys._sweep import bracketed_roots
from fracsys.checks import Complex, Mask, Real

__all__ = ["Candidates", "PidProblem", "best_of", "itae"]

Span = tuple[float, float]

FILTER = 20.0  # 1/(ω_c T_f): the filter costs the derivative 3° at the crossover
# Points of the scan in ω: eighty per decade about a given ω_c, and those about the
# modes. Against a scan forty times as dense, 95 % of the stable candidates on four plants
# are off by less than 5e-4 rad in the margin and 1e-3 in Ms, the worst by 0.2 rad and
# 15 %. This is enough to rank candidates; the margins of an accepted one are computed
# again by root finding.
_POINTS = 480
REACH = 1e3  # factor on either side of the crossover
# Samples of the error in the search: frequencies up to 40 times the crossover. With 512
# samples a plant with an integrator gets a different candidate than with 16 384; with
# 1024 the three plants tried get the same ones, although the ITAE of a candidate near
# instability is 9 % off.
_SAMPLES = 1024
# Damping of the Fourier series: the wrap-around is multiplied by 1e-5. A larger factor
# would amplify the truncation error of the series: with 1e8, candidates near
# instability are wrong by a factor of three.
_DAMPING = math.log(1e5)
_TOLERANCE = 3e-4  # [rad] largest difference between scan and root
_ROOM = 1.002  # margin between the scan's value of a bound and the exact one
OFFER = math.radians(2.5)  # steps of an offered phase margin


@dataclass(frozen=True)
class Candidates:
    """Controllers whose loop crosses |L| = 1 at ω_c with the requested margin."""

    gains: Real  # shape (M, 3): k_p, k_i, k_d
    places: Real  # shape (M, 5): λ, μ, d arg L/d ln ω at ω_c, ln ω_c, φ_m
    filter_time: Real  # shape (M,)

    @property
    def crossover(self) -> Real:
        """ω_c of each [rad/s]."""
        return np.exp(self.places[:, 3])

    def __getitem__(self, chosen: Mask) -> Candidates:
        return Candidates(
            self.gains[chosen], self.places[chosen], self.filter_time[chosen]
        )

    def response(self, s: Complex) -> Complex:
        """C at points `s` of the right half-plane, shape (M, K)."""
        lam, mu = self.places[:, :1], self.places[:, 1:2]
        parts = _parts(s[None, :], lam, mu, self.filter_time[:, None])
        kp, ki, kd = (self.gains[:, k, None] for k in range(3))
        return kp + ki * parts[1] + kd * parts[2]

    @property
    def controller(self) -> FractionalPid:
        """The first one; a part with gain 0 has order 1."""
        kp, ki, kd = (float(x) for x in self.gains[0])
        lam, mu = (float(x) for x in self.places[0, :2])
        return FractionalPid(
            kp,
            integral=ki,
            integral_order=lam if ki else 1.0,
            derivative=kd,
            derivative_order=mu if kd else 1.0,
            filter_time=float(self.filter_time[0]) if kd else 0.0,
        )


@dataclass(frozen=True)
class PidProblem:
    """The request, and the plant with the delay of the sampling.

    `spans` are the ranges of λ, μ, the slope of arg L over ln ω at ω_c, ln ω_c and φ_m;
    equal ends mean a given value.
    """

    plant: FractionalTransferFunction
    integral: bool
    derivative: bool
    flat: bool
    gain_margin: float | None
    max_sensitivity: float | None
    spans: tuple[Span, ...]
    filter_time: float | None

    @cached_property
    def integrators(self) -> float:
        """Order of the plant's pole at the origin; negative for a zero."""
        return self.plant.denominator[-1].order - self.plant.numerator[-1].order

    @cached_property
    def scan(self) -> Real:
        """Frequencies of the scan [rad/s], dense about the plant's own modes."""
        low, high = np.exp(self.spans[3]) * [1.0 / REACH, REACH]
        # A lightly damped mode is narrower than the scan's steps of 3 %, so a loop gain
        # that rises above 1 there would be missed.
        modes = np.exp(as_loop(self.plant, None).seeds)
        w = np.union1d(np.geomspace(low, high, _POINTS), modes)
        return w[(w >= low) & (w <= high)]

    def solved(self, places: Real) -> Candidates:
        """The candidates at these places, with a flat phase if an order is free for it;
        gains are NaN where the equations have no solution.
        """
        places = places.copy()
        # Four decimals: the fifth does not change ITAE, and terms of L whose orders
        # differ only there could not be separated by any root finder.
        places[:, :2] = np.round(places[:, :2], 4)
        low, high = self.spans[4]
        if low < high:  # an offered margin is a multiple of `OFFER`
            places[:, 4] = OFFER * np.round(places[:, 4] / OFFER)
        if not self.flat or (self.integral and self.derivative):
            return self._at(places)
        # with two gains, the order is left to make the phase flat
        axis = 0 if self.integral else 1

        def slope_of(order: Real) -> Real:
            places[:, axis] = order
            return self._at(places).places[:, 2]

        # the change of sign that is nearest to the order of a place
        wanted, orders = places[:, axis].copy(), np.linspace(*self.spans[axis], 21)
        slope = np.array([slope_of(order) for order in orders])
        distance = np.abs(orders[:-1, None] - wanted)
        distance[slope[:-1] * slope[1:] >= 0.0] = math.inf
        cell = np.argmin(distance, axis=0)
        places[:, axis] = bracketed_roots(slope_of, orders[cell], orders[cell + 1])
        return self._at(places)

    def _at(self, places: Real) -> Candidates:
        """The candidates with exactly these parameters, each with its slope."""
        lam, mu, slope, _, margin = places.T
        w = np.exp(places[:, 3])
        lag = np.full_like(w, self.filter_time or 0.0)
        if self.filter_time is None:
            lag = 1.0 / (FILTER * w)
        parts = np.stack(_parts(1j * w, lam, mu, lag), axis=1)
        turn = 1j * lag * w / (1.0 + 1j * lag * w)
        # d/d ln ω of the three parts
        slopes = np.stack([0.0 * w, -lam, mu - np.ceil(mu) * turn], axis=1) * parts
        at, rise = _plant_at(self.plant, w)
        target = np.exp(1j * (margin - math.pi)) / at
        rows = [parts.real, parts.imag, (slopes / target[:, None]).imag]
        right = np.stack([target.real, target.imag, slope - rise], axis=1)
        columns = [True, self.integral, self.derivative]
        count = sum(columns)
        matrix = np.stack(rows, axis=1)[:, :count, columns]
        gains = np.zeros((len(w), 3))
        gains[:, columns] = (np.linalg.pinv(matrix) @ right[:, :count, None])[..., 0]
        # λ = μ, or an order that makes two parts parallel at ω_c: the system has no
        # solution.
        off = np.abs((gains * parts).sum(axis=1) - target) > 1e-9 * np.abs(target)
        gains[off] = math.nan
        own = ((gains * slopes).sum(axis=1) / target).imag + rise
        parameters = np.column_stack([lam, mu, own, places[:, 3], margin])
        return Candidates(gains, parameters, lag)

    def missed(self, found: Candidates) -> Real:
        """By how much each candidate misses the request on the scan: gains that are not
        negative, a stable closed loop, a flat phase, and every bound; 0 where it is met.
        """
        loop = found.response(np.asarray(1j * self.scan)) * self._scanned
        # Candidates with negative gains are dropped rather than clipped to 0: clipped,
        # the controller no longer crosses at ω_c with the margin.
        shares = found.gains / np.abs(found.gains).sum(axis=1, keepdims=True)
        with np.errstate(all="ignore"):
            integral = np.where(found.gains[:, 1] > 0.0, found.places[:, 0], 0.0)
            origin = np.maximum(self.integrators + integral, 0.0)
            margin, gain_margin = _least_margins(loop)
            slacks = [
                *shares.T,
                # Turns differ by 2π; a limit of one radian separates them, whatever
                # the scan misses between two points.
                1.0 - _turn_beyond(loop, origin),
                margin - found.places[:, 4] + _TOLERANCE,
            ]
            if self.flat:
                slacks.append(DIFFERENCE_STEP - np.abs(found.places[:, 2]))
            # The minima of the scan are only as accurate as its steps, so the bounds
            # are tightened by `_ROOM`; the exact evaluation of the result then
            # confirms them.
            if self.gain_margin is not None:
                slacks.append(gain_margin - math.log(self.gain_margin * _ROOM))
            if self.max_sensitivity is not None:
                distance = np.min(np.abs(1.0 + loop), axis=1)
                slacks.append(distance - _ROOM / self.max_sensitivity)
            missed = np.maximum(-np.array(slacks), 0.0).sum(axis=0)
        # without gains there is no loop: it counts as missing by more than any other
        return np.nan_to_num(missed, nan=1e3, posinf=1e3)

    @cached_property
    def _scanned(self) -> Complex:
        return self.plant(1j * self.scan)


def _parts(
    s: Complex, lam: Real, mu: Real, lag: Real
) -> tuple[Complex, Complex, Complex]:
    """1, s^(−λ) and s^μ/(1 + T_f s)^n; the arguments are broadcast."""
    log = np.log(s)
    slow = np.exp(-lam * log)
    return np.ones_like(slow), slow, np.exp(mu * log) / (1.0 + lag * s) ** np.ceil(mu)


def _plant_at(plant: FractionalTransferFunction, w: Real) -> tuple[Complex, Real]:
    """P(jω), and the slope of its phase over ln ω: a central difference, exact to
    1e-10.
    """
    step = math.exp(DIFFERENCE_STEP)
    turn = np.angle(plant(1j * w * step) / plant(1j * w / step))
    return plant(1j * w), turn / (2.0 * DIFFERENCE_STEP)


def _turn_beyond(loop: Complex, origin: Real) -> Real:
    """By how much the turn of 1 + L differs from what its pole at the origin requires
    (none lies in Re s > 0): 0 for a stable closed loop [rad].

    Near the origin 1 + L ~ s^(-q) has the phase −qπ/2; from there to ω → ∞ it must turn
    back to the phase of 1 + L(∞), on the principal sheet.
    """
    locus = 1.0 + loop
    first = -0.5 * math.pi * origin
    start = first + np.angle(locus[:, 0] * np.exp(-1j * first))
    end = start + np.angle(locus[:, 1:] / locus[:, :-1]).sum(axis=1)
    return np.abs(end - np.angle(locus[:, -1]))


def _least_margins(loop: Complex) -> tuple[Real, Real]:
    """Smallest |phase margin| [rad] over the gain crossings of each row, and smallest
    |ln gain margin| over its phase crossings.
    """
    level, turn = np.log(np.abs(loop)), np.angle(-loop)
    rise, change = np.diff(level), np.diff(turn)
    # the short way round: the phase wrap lies on the far side of −1
    change -= math.tau * np.round(change / math.tau)
    # Linear interpolation between two points in ln ω: root finding for thousands of
    # candidates would take a hundred times as long.
    across, down = -level[:, :-1] / rise, -turn[:, :-1] / change
    margin = np.abs(turn[:, :-1] + across * change)
    gain = np.abs(level[:, :-1] + down * rise)
    return (
        np.min(margin, axis=1, initial=math.pi, where=(across >= 0) & (across < 1)),
        # A loop that never passes −1 tolerates any gain.
        np.min(gain, axis=1, initial=math.inf, where=(down >= 0) & (down < 1)),
    )


def itae(
    problem: PidProblem, found: Candidates, horizon: float, samples: int = _SAMPLES
) -> Real:
    """∫ t |e| dt over [0, horizon] of the error after a unit step of the reference, for
    each candidate.

    e is the Fourier series of Dubner and Abate on Re s = ln(1e5)/(2 horizon). 1/(s +
    ω_c) is subtracted, so that the jump at t = 0 causes no ringing.
    """
    shift = _DAMPING / (2.0 * horizon)
    s = np.asarray(shift + 1j * math.pi / horizon * np.arange(samples // 2 + 1))
    plant = problem.plant(s)
    time = 2.0 * horizon / samples * np.arange(samples // 2 + 1)

    rate = found.crossover[:, None]
    with np.errstate(all="ignore"):
        # E(s) = 1/(s (1 + L)) in closed form for any L: delays and fractional orders
        # need no model, and one FFT serves all candidates.
        image = 1.0 / (s * (1.0 + found.response(s) * plant))
        series = np.fft.irfft(image - 1.0 / (s + rate), n=samples, axis=1)
    # The sum of irfft runs over s and its conjugate, and is divided by the number of
    # samples.
    error = series[:, : time.size] * np.exp(shift * time) * samples / (
        2.0 * horizon
    ) + np.exp(-rate * time)
    return np.trapezoid(time * np.abs(error), time, axis=1)


def best_of(
    problem: PidProblem, merit: Callable[[Candidates], Real]
) -> Candidates | None:
    """The candidate of the largest merit > 0 among those that meet the request; None
    where none does.
    """

    def energy(values: Real) -> Real:
        found = problem.solved(values.T)
        missed = problem.missed(found)
        kept = missed == 0.0
        missed[kept] = -merit(found[kept])
        return missed

    result = differential_evolution(
        energy,
        problem.spans,
        vectorized=True,
        updating="deferred",
        polish=False,
        init="sobol",
        tol=1e-4,
        rng=0,
    )
    return problem.solved(result.x[None]) if result.fun < 0.0 else None
