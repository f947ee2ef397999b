"""Equations and search behind `tune_pid`: gains from margins, remaining parameters from
the least ITAE.

With s^(-λ) and s^μ/(1 + T_f s)^n as given functions C is linear in its gains. L(jω_c) =
e^(j(φ_m − π)) are two real equations, the slope of arg L at ω_c is a third: three gains
follow from one linear system for each (λ, μ). The rest, the two orders and possibly
slope and ω_c, is searched on a grid and then by the Nelder-Mead method.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from fraclink._arm.fractional_pid import FractionalPid
from fraclink.errors import FraclinkError
from fracsys._fractional import FractionalTransferFunction
from fracsys._stability import poles
from fracsys._sweep import bracketed_roots
from fracsys.checks import Complex, Mask, Real

__all__ = ["Candidates", "PidProblem", "best_of", "itae", "searched"]

Span = tuple[float, float]

FILTER = 20.0  # 1/(ω_c T_f): the filter costs the derivative 3° at the crossover
# Points of the scan in ω: eighty per decade and those about the modes. On three plants
# the margins of 600 candidates differ by at most 2e-3 rad from those of a scan forty
# times as dense, Ms by 3 %. This is enough to rank candidates; the margins of an
# accepted one are computed again by root finding.
_POINTS = 480
_REACH = 1e3  # factor on either side of the crossover
# Samples of the error in the search: frequencies up to 80 times the crossover. With 512
# samples a plant with an integrator gets another candidate than with 16 384; with 1024
# it is the same one on the three plants tried, although the ITAE of a candidate near
# its margin is 9 % off.
_SAMPLES = 1024
# Damping of the Fourier series: the wrap-around is multiplied by 1e-5. A larger factor
# would amplify the truncation error of the series: with 1e8, candidates near their
# margin are wrong by a factor of three.
_DAMPING = math.log(1e5)
_TOLERANCE = 3e-4  # [rad] largest difference between scan and root
_ROOM = 1.002  # margin between the scan's value of a bound and the exact one
# points along each side of the grid: λ, μ, slope, ln ω_c; fewer orders if the slope is
# free as well
_GRID, _WITH_SLOPE = (21, 21, 1, 24), (11, 11, 10, 24)
# candidates scanned together: a thousand would take 100 MB and more time
_TOGETHER = 128


@dataclass(frozen=True)
class Candidates:
    """Controllers whose loop crosses |L| = 1 at ω_c with the requested margin."""

    gains: Real  # shape (M, 3): k_p, k_i, k_d
    places: Real  # shape (M, 4): λ, μ, d arg L/d ln ω at ω_c, ln ω_c
    filter_time: Real  # shape (M,)

    @property
    def count(self) -> int:
        """M."""
        return len(self.places)

    @property
    def crossover(self) -> Real:
        """ω_c of each [rad/s]."""
        return np.exp(self.places[:, 3])

    def __getitem__(self, chosen: Mask | NDArray[np.intp]) -> Candidates:
        return Candidates(
            self.gains[chosen], self.places[chosen], self.filter_time[chosen]
        )

    def measured(self, figure: Callable[[Candidates], NDArray[np.generic]]) -> Real:
        """A figure of each candidate, `_TOGETHER` at a time."""
        parts = np.split(np.arange(self.count), range(_TOGETHER, self.count, _TOGETHER))
        return np.concatenate([figure(self[part]) for part in parts])

    def response(self, s: Complex) -> Complex:
        """C at points `s` of the right half-plane, shape (M, K)."""
        lam, mu = self.places[:, :1], self.places[:, 1:2]
        parts = _parts(s[None, :], lam, mu, self.filter_time[:, None])
        kp, ki, kd = (self.gains[:, k, None] for k in range(3))
        return np.asarray(kp + ki * parts[1] + kd * parts[2])

    def controller(self, place: int) -> FractionalPid:
        """The controller with the given index; a part with gain 0 has order 1."""
        kp, ki, kd = (float(x) for x in self.gains[place])
        lam, mu = (float(x) for x in self.places[place, :2])
        return FractionalPid(
            kp,
            integral=ki,
            integral_order=lam if ki else 1.0,
            derivative=kd,
            derivative_order=mu if kd else 1.0,
            filter_time=float(self.filter_time[place]) if kd else 0.0,
        )


@dataclass(frozen=True)
class PidProblem:
    """The request, and the plant with the delay of the sampling.

    `spans` are the ranges of λ, μ, the slope of arg L over ln ω at ω_c, and ln ω_c;
    equal ends mean a given value.
    """

    plant: FractionalTransferFunction
    phase_margin: float
    integral: bool
    derivative: bool
    flat: bool
    gain_margin: float | None
    max_sensitivity: float | None
    spans: tuple[Span, ...]
    filter_time: float | None

    @property
    def has_order_for_phase(self) -> bool:
        """Whether, with two gains, the order is left to make the phase flat."""
        return self.flat and not (self.integral and self.derivative)

    @cached_property
    def integrators(self) -> float:
        """Order of the plant's pole at the origin; negative for a zero."""
        return self.plant.denominator[-1].order - self.plant.numerator[-1].order

    @cached_property
    def scan(self) -> Real:
        """Frequencies of the scan [rad/s], dense about the plant's own modes."""
        low, high = np.exp(self.spans[3]) * [1.0 / _REACH, _REACH]
        w = [np.geomspace(low, high, _POINTS)]
        try:
            # A lightly damped mode is narrower than the scan's steps of 3 %, so a loop
            # gain that rises above 1 there would be missed. Six modes: the controller
            # affects the lowest ones.
            modes = np.abs([pole for pole in poles(self.plant) if abs(pole.imag) > 0])
        except FraclinkError:  # delays in the denominator: infinitely many poles
            modes = np.empty(0)
        for mode in modes[(modes > low) & (modes < high)][:6]:
            near = 1.0 + np.geomspace(1e-4, 0.3, 16)
            w += [mode * near, mode / near]
        return np.unique(np.concatenate(w))

    def solved(self, places: Real) -> Candidates:
        """The candidates at these places, each with its slope; gains are NaN where the
        equations have no solution.
        """
        lam, mu, slope = places[:, :3].T
        w = np.exp(places[:, 3])
        lag = np.full_like(w, self.filter_time or 0.0)
        if self.filter_time is None:
            lag = 1.0 / (FILTER * w)
        parts = np.stack(_parts(1j * w, lam, mu, lag), axis=1)
        turn = 1j * lag * w / (1.0 + 1j * lag * w)
        # d/d ln ω of the three parts
        slopes = np.stack([0.0 * w, -lam, mu - np.ceil(mu) * turn], axis=1) * parts
        at, rise = _plant_at(self.plant, w)
        target = np.exp(1j * (self.phase_margin - math.pi)) / at
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
        parameters = np.column_stack([lam, mu, own, places[:, 3]])
        return Candidates(gains, parameters, lag)

    def admitted(self, found: Candidates) -> Candidates:
        """The candidates without negative gains whose closed loop is stable and meets
        every bound on the scan.
        """
        # Candidates with negative gains are dropped rather than clipped to 0: clipped,
        # the controller no longer crosses at ω_c with the margin.
        positive = np.all(found.gains >= 0.0, axis=1) & np.any(
            found.gains > 0.0, axis=1
        )
        found = found[positive]
        return found[found.measured(self._keeps).astype(bool)]

    def _keeps(self, found: Candidates) -> Mask:
        loop = found.response(np.asarray(1j * self.scan)) * self._scanned
        with np.errstate(all="ignore"):
            integral = np.where(found.gains[:, 1] > 0.0, found.places[:, 0], 0.0)
            origin = np.maximum(self.integrators + integral, 0.0)
            good = _stable(loop, origin)
            good &= _least_margin(loop) >= self.phase_margin - _TOLERANCE
            if self.gain_margin is not None:
                # The minima of the scan are only as accurate as its steps, so the
                # bounds are tightened by `_ROOM`; the exact evaluation of the result
                # then confirms them.
                good &= _least_gain_margin(loop) >= self.gain_margin * _ROOM
            if self.max_sensitivity is not None:
                distance = np.min(np.abs(1.0 + loop), axis=1)
                good &= distance >= _ROOM / self.max_sensitivity
        return good

    @cached_property
    def _scanned(self) -> Complex:
        return np.asarray(self.plant(1j * self.scan))


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
    step = 1e-5
    up, down = plant(1j * w * math.exp(step)), plant(1j * w * math.exp(-step))
    return np.asarray(plant(1j * w)), np.asarray(np.angle(up / down) / (2.0 * step))


def _stable(loop: Complex, origin: Real) -> Mask:
    """Whether 1 + L turns exactly as its pole at the origin requires (there is no pole
    elsewhere).

    Near the origin 1 + L ~ s^(-q) has the phase −qπ/2; from there to ω → ∞ it must turn
    back to that of 1 + L(∞), on the principal sheet.
    """
    locus = 1.0 + loop
    first = -0.5 * math.pi * origin
    start = first + np.angle(locus[:, 0] * np.exp(-1j * first))
    end = start + np.angle(locus[:, 1:] / locus[:, :-1]).sum(axis=1)
    # Turns differ by 2π; a limit of one radian separates them, whatever the scan misses
    # between two points.
    return np.asarray(np.abs(end - np.angle(locus[:, -1])) < 1.0)


def _least_margin(loop: Complex) -> Real:
    """Smallest |phase margin| over the gain crossings of each row, π if there is none."""
    level = np.log(np.abs(loop))
    # Linear interpolation between two points in ln ω: root finding for some thousand
    # candidates would take a hundred times as long.
    crosses = (level[:, :-1] > 0.0) != (level[:, 1:] > 0.0)
    share = level[:, :-1] / (level[:, :-1] - level[:, 1:])
    angle = np.angle(-loop[:, :-1]) + share * np.angle(loop[:, 1:] / loop[:, :-1])
    return np.asarray(np.min(np.where(crosses, np.abs(angle), math.pi), axis=1))


def _least_gain_margin(loop: Complex) -> Real:
    """Smallest factor by which the gain may rise or fall before the loop passes −1."""
    turns = np.angle(-loop)
    # A change of sign by more than π is the phase wrap at ±180° as seen from −1, on the
    # far side, and not a crossing.
    passes = (turns[:, :-1] * turns[:, 1:] < 0.0) & (
        np.abs(turns[:, 1:] - turns[:, :-1]) < math.pi
    )
    level = np.abs(np.log(np.abs(loop)))
    share = turns[:, :-1] / (turns[:, :-1] - turns[:, 1:])
    at = level[:, :-1] + share * (level[:, 1:] - level[:, :-1])
    # e^300: a loop that never passes −1 tolerates any gain.
    return np.asarray(np.exp(np.min(np.where(passes, at, 300.0), axis=1)))


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

    def figure(part: Candidates) -> Real:
        rate = part.crossover[:, None]
        with np.errstate(all="ignore"):
            # E(s) = 1/(s (1 + L)) in closed form for any L: delays and fractional
            # orders need no model, and one FFT serves all candidates.
            image = 1.0 / (s * (1.0 + part.response(s) * plant))
            series = np.fft.irfft(image - 1.0 / (s + rate), n=samples, axis=1)
        # The sum of irfft runs over s and its conjugate, and is divided by the number
        # of samples.
        error = series[:, : time.size] * np.exp(shift * time) * samples / (
            2.0 * horizon
        ) + np.exp(-rate * time)
        return np.asarray(np.trapezoid(time * np.abs(error), time, axis=1))

    return found.measured(figure)


def searched(problem: PidProblem, *, every: int = 1) -> Candidates:
    """All candidates of the grid that meet the request, with every `every`-th
    crossover.
    """
    # 21 × 21 orders, or 11 × 11 with ten slopes each: some thousand linear systems of
    # three equations, a few milliseconds.
    low, high = problem.spans[2]
    counts = _GRID if low == high else _WITH_SLOPE
    axes = [
        np.linspace(*span, count) if span[0] < span[1] else np.array(span[:1])
        for span, count in zip(problem.spans, counts, strict=True)
    ]
    axes[3] = axes[3][::every]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    places = grid.reshape(-1, 4)
    if problem.has_order_for_phase:
        places = _flat(problem, grid, 0 if problem.integral else 1)
    return problem.admitted(problem.solved(places))


def _flat(problem: PidProblem, grid: Real, axis: int) -> Real:
    """The points between two grid points along one order at which the phase is flat."""
    lines = np.moveaxis(grid, axis, 0).reshape(grid.shape[axis], -1, 4)
    slope = problem.solved(lines.reshape(-1, 4)).places[:, 2].reshape(lines.shape[:2])
    before, line = np.nonzero(slope[:-1] * slope[1:] < 0.0)
    places = lines[before, line].copy()

    def slope_of(order: Real) -> Real:
        places[:, axis] = order
        return problem.solved(places).places[:, 2]

    ends = lines[before, line, axis], lines[before + 1, line, axis]
    places[:, axis] = bracketed_roots(slope_of, *ends)
    return places


def best_of(problem: PidProblem, found: Candidates, horizon: float) -> Candidates:
    """The candidate with the least ITAE, from the grid by the Nelder-Mead method."""
    best = found[[int(np.argmin(itae(problem, found, horizon)))]]  # type: ignore[index]
    varied = [low < high for low, high in problem.spans]
    if problem.has_order_for_phase or not any(varied):
        return best

    def made(values: Real) -> Candidates:
        places = best.places.copy()
        places[0, varied] = values
        # Four decimals: the fifth does not change ITAE, and terms of L whose orders
        # differ only there could not be separated by any root finder.
        places[0, :2] = np.round(places[0, :2], 4)
        return problem.admitted(problem.solved(places))

    def cost(values: Real) -> float:
        candidate = made(values)
        return (
            float(itae(problem, candidate, horizon)[0]) if candidate.count else math.inf
        )

    begin = best.places[0, varied]
    # About one grid step in the orders, and 6 % in ω_c, whose grid step is 35 %: the
    # simplex starts inside the best cell. SciPy's default start, 5 % of each value, is
    # zero where a slope is 0.
    steps = np.diag(np.array([0.04, 0.04, 0.05, 0.06])[varied])
    result = minimize(
        cost,
        begin,
        method="Nelder-Mead",
        bounds=[span for span, free in zip(problem.spans, varied, strict=True) if free],
        options={
            "initial_simplex": np.vstack([begin, begin + steps]),
            "maxfev": 200,
            "xatol": 1e-4,
        },
    )
    improved = made(result.x)
    return improved if improved.count else best
