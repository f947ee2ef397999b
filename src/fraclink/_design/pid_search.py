"""Equations and search behind `tune_pid`: gains from margins, and what is free from the
least ITAE.

With s^(-λ) and s^μ/(1 + T_f s)^n as given functions C is linear in its gains. L(jω_c) =
e^(j(φ_m − π)) are two real equations, the slope of arg L at ω_c is a third: three gains
follow by one linear solution for each (λ, μ). What is left, the two orders and perhaps
ω_c, is searched on a grid and then by Nelder and Mead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from fraclink._arm.fractional_pid import FractionalPid, pid_parts
from fraclink.errors import FraclinkError
from fracsys._fractional import FractionalTransferFunction
from fracsys._stability import poles

__all__ = ["Candidates", "PidProblem", "best_of", "crossover_grid", "itae", "searched"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Eighty points a decade and those about the modes: on three plants the margins of 600
# candidates are 2e-3 rad at most off those of a scan forty times as dense, Ms 3 %. That
# ranks them; what is accepted is measured anew. of the scan in ω; margins are found
# again by root finding once the search is over
_POINTS = 480
_REACH = 1e3  # either side of the crossover
# At 512 samples the least ITAE of a plant with an integrator is another candidate's
# than at 16 384, at 1024 it is the same on the three plants tried, although a candidate
# near its margin is 9 % off.
_SAMPLES = 1024  # of the error in the search: frequencies to 80 times the crossover
# A larger factor multiplies what the truncated series leaves out: with 1e8 candidates
# near their margin come out wrong by a factor of three.
_DAMPING = math.log(1e5)  # of the Fourier series: what wraps around counts 1e-5
_TOLERANCE = 3e-4  # [rad] between scan and root
_ROOM = 1.002  # between the scan's value of a bound and the true one
_ORDERS, _FEWER = 21, 11  # a side of the grid; fewer where the slope is free, too
_SLOPES = (
    -1.5,
    -1.0,
    -0.7,
    -0.5,
    -0.35,
    -0.2,
    -0.1,
    0.0,
    0.1,
    0.25,
)  # of arg L over ln ω, where it is free
_CROSSOVERS = 24
_TOGETHER = 128  # candidates on the scan at once: a thousand take 100 MB, and more time
_REFUSED = 1e300  # finite: the simplex subtracts its values


@dataclass(frozen=True)
class Candidates:
    """Controllers that cross one at ω_c with the margin that was asked for; arrays of
    shape (M,).
    """

    gains: Real  # shape (M, 3): k_p, k_i, k_d
    integral_order: Real
    derivative_order: Real
    slope: Real
    crossover: Real
    filter_time: Real

    @property
    def count(self) -> int:
        """M."""
        return int(self.crossover.size)

    def __getitem__(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Candidates:
        return Candidates(
            self.gains[chosen],
            self.integral_order[chosen],
            self.derivative_order[chosen],
            self.slope[chosen],
            self.crossover[chosen],
            self.filter_time[chosen],
        )

    def split(self) -> list[Candidates]:
        """The same candidates, `_TOGETHER` at a time."""
        return [
            self[np.arange(k, min(k + _TOGETHER, self.count))]
            for k in range(0, self.count, _TOGETHER)
        ]

    def response(self, s: Complex) -> Complex:
        """C at points `s` of the right half-plane, shape (M, K)."""
        log = np.log(s)[None, :]
        lam, mu, lag = (
            x[:, None]
            for x in (self.integral_order, self.derivative_order, self.filter_time)
        )
        fast = np.exp(mu * log) / (1.0 + lag * s[None, :]) ** np.ceil(mu)
        kp, ki, kd = (self.gains[:, k, None] for k in range(3))
        return np.asarray(kp + ki * np.exp(-lam * log) + kd * fast)

    def controller(self, place: int) -> FractionalPid:
        """The controller at one place; a part with the gain 0 has the order 1."""
        kp, ki, kd = (float(x) for x in self.gains[place])
        return FractionalPid(
            kp,
            integral=ki,
            integral_order=float(self.integral_order[place]) if ki else 1.0,
            derivative=kd,
            derivative_order=float(self.derivative_order[place]) if kd else 1.0,
            filter_time=float(self.filter_time[place]) if kd else 0.0,
        )


@dataclass(frozen=True)
class PidProblem:
    """What is asked for, and the plant with the delay of the sampling.

    `integral_orders` and `derivative_orders` are ranges; equal ends are an order that
    is given. `filter_ratio` is 1/(ω_c T_f) where `filter_time` is None.
    """

    plant: FractionalTransferFunction
    phase_margin: float
    integral: bool
    derivative: bool
    flat: bool
    gain_margin: float | None
    max_sensitivity: float | None
    integral_orders: tuple[float, float]
    derivative_orders: tuple[float, float]
    filter_time: float | None
    filter_ratio: float
    crossovers: tuple[float, float]

    @cached_property
    def integrators(self) -> float:
        """Order of the plant's pole at the origin; negative for a zero."""
        return self.plant.denominator[-1].order - self.plant.numerator[-1].order

    @cached_property
    def scan(self) -> Real:
        """Frequencies of the scan [rad/s], dense about the plant's own modes."""
        low, high = self.crossovers[0] / _REACH, self.crossovers[1] * _REACH
        w = [np.geomspace(low, high, _POINTS)]
        try:
            # A lightly damped mode is narrower than the scan's steps of 3 %, and a loop
            # gain that rises to one there and falls again would be missed. Six modes:
            # the lowest are the ones that a controller reaches.
            modes = np.abs([pole for pole in poles(self.plant) if abs(pole.imag) > 0])
        except FraclinkError:  # delays in the denominator: no finite list of poles
            modes = np.empty(0)
        for mode in modes[(modes > low) & (modes < high)][:6]:
            near = 1.0 + np.geomspace(1e-4, 0.3, 16)
            w += [mode * near, mode / near]
        return np.unique(np.concatenate(w))

    @cached_property
    def scanned(self) -> Complex:
        """The plant on the scan."""
        return np.asarray(self.plant(1j * self.scan))

    def lag(self, crossover: Real) -> Real:
        """T_f for each crossover."""
        own = 1.0 / (self.filter_ratio * crossover)
        return (
            own
            if self.filter_time is None
            else np.full_like(crossover, self.filter_time)
        )

    def solved(self, lam: Real, mu: Real, slope: Real, crossover: Real) -> Candidates:
        """The candidates with these orders, slopes and crossovers whose gains are not
        negative.
        """
        parts, slopes = _parts(lam, mu, crossover, self.lag(crossover))
        at, turn = _plant_at(self.plant, crossover)
        wanted = np.exp(1j * (self.phase_margin - math.pi)) / at
        used = [0, *([1] if self.integral else []), *([2] if self.derivative else [])]
        rows = [parts[:, used].real, parts[:, used].imag]
        right = [wanted.real, wanted.imag]
        if len(used) == 3:
            rows.append((slopes[:, used] / wanted[:, None]).imag)
            right.append(slope - turn)
        with np.errstate(all="ignore"):
            matrix, wished = np.stack(rows, axis=1), np.stack(right, axis=1)[..., None]
            # λ = μ, or an order that makes two parts parallel at ω_c: no gains follow,
            # and numpy would refuse the whole stack for one of them.
            regular = np.abs(np.linalg.det(matrix)) > 1e-200
            found = np.zeros((crossover.size, len(used)))
            found[regular] = np.linalg.solve(matrix[regular], wished[regular])[..., 0]
        gains = np.zeros((crossover.size, 3))
        gains[:, used] = found
        # The slope of the whole curve, given or not: `_made_flat` looks for its change
        # of sign along the orders.
        own = ((gains * slopes).sum(axis=1) / wanted).imag + turn
        made = Candidates(gains, lam, mu, own, crossover, self.lag(crossover))
        # Negative gains are dropped rather than clipped to 0: clipped, the controller
        # no longer crosses at ω_c with the margin.
        return made[
            regular
            & np.all(np.isfinite(gains) & (gains >= 0.0), axis=1)
            & np.any(gains > 0.0, axis=1)
        ]

    def admitted(self, found: Candidates) -> Candidates:
        """Those whose closed loop is stable, and that keep every bound, on the scan."""
        if found.count > _TOGETHER:
            return _joined([self.admitted(part) for part in found.split()])
        if not found.count:
            return found
        loop = found.response(np.asarray(1j * self.scan)) * self.scanned[None, :]
        with np.errstate(all="ignore"):
            good = _stable(loop, self._origin(found)) & (
                _least_margin(loop) >= self.phase_margin - _TOLERANCE
            )
            if self.gain_margin is not None:
                # The scan's minima are no better than its steps, so the bounds are
                # asked for with `_ROOM` to spare, and the exact engine, which judges
                # the result, finds them kept.
                good &= _least_gain_margin(loop) >= self.gain_margin * _ROOM
            if self.max_sensitivity is not None:
                good &= (
                    np.min(np.abs(1.0 + loop), axis=1) >= _ROOM / self.max_sensitivity
                )
        return found[good]

    def _origin(self, found: Candidates) -> Real:
        """Order of L's pole at the origin."""
        integral = np.where(found.gains[:, 1] > 0.0, found.integral_order, 0.0)
        return np.asarray(np.maximum(self.integrators + integral, 0.0))


def _parts(lam: Real, mu: Real, w: Real, lag: Real) -> tuple[Complex, Complex]:
    """The three functions at ω, shape (M, 3), and their derivatives over ln ω."""
    parts = np.stack(pid_parts(w, lam, mu, lag), axis=1)
    turn = 1j * lag * w / (1.0 + 1j * lag * w)
    slopes = np.stack(
        [
            np.zeros_like(parts[:, 0]),
            -lam * parts[:, 1],
            (mu - np.ceil(mu) * turn) * parts[:, 2],
        ],
        1,
    )
    return parts, slopes


def _plant_at(plant: FractionalTransferFunction, w: Real) -> tuple[Complex, Real]:
    """P(jω), and the slope of its phase over ln ω: a central difference, exact to
    1e-10.
    """
    step = 1e-5
    up, down = plant(1j * w * math.exp(step)), plant(1j * w * math.exp(-step))
    return np.asarray(plant(1j * w)), np.asarray(np.angle(up / down) / (2.0 * step))


def _stable(loop: Complex, origin: Real) -> NDArray[np.bool_]:
    """Whether 1 + L turns by as much as its pole at the origin asks for, and no more
    (no pole elsewhere).

    Near the origin 1 + L ~ s^(-q) has the phase −qπ/2; from there to ω → ∞ it must turn
    back to that of 1 + L(∞), on the principal sheet.
    """
    turned = 1.0 + loop
    first = -0.5 * math.pi * origin
    start = first + np.angle(turned[:, 0] * np.exp(-1j * first))
    end = start + np.angle(turned[:, 1:] / turned[:, :-1]).sum(axis=1)
    # Turns differ by 2π; one radian tells them apart whatever the scan loses between
    # two points.
    return np.asarray(np.abs(end - np.angle(turned[:, -1])) < 1.0)


def _least_margin(loop: Complex) -> Real:
    """Smallest |phase margin| over the gain crossings of each row, π where there is
    none.
    """
    level = np.log(np.abs(loop))
    # By the straight line between two points in ln ω: a root search for every one of
    # some thousand candidates would take a hundred times as long.
    crosses = (level[:, :-1] > 0.0) != (level[:, 1:] > 0.0)
    share = level[:, :-1] / (level[:, :-1] - level[:, 1:])
    angle = np.angle(-loop[:, :-1]) + share * np.angle(loop[:, 1:] / loop[:, :-1])
    return np.asarray(np.min(np.where(crosses, np.abs(angle), math.pi), axis=1))


def _least_gain_margin(loop: Complex) -> Real:
    """Smallest factor by which the gain may change, up or down, before the loop passes
    −1.
    """
    turns = np.angle(-loop)
    # A change of sign by more than π is the phase wrapping at ±180° from −1, on the far
    # side: no crossing.
    passes = (turns[:, :-1] * turns[:, 1:] < 0.0) & (
        np.abs(turns[:, 1:] - turns[:, :-1]) < math.pi
    )
    level = np.abs(np.log(np.abs(loop)))
    share = turns[:, :-1] / (turns[:, :-1] - turns[:, 1:])
    at = level[:, :-1] + share * (level[:, 1:] - level[:, :-1])
    # e^300: a loop that never passes −1 bears any gain.
    return np.asarray(np.exp(np.min(np.where(passes, at, 300.0), axis=1)))


def itae(
    problem: PidProblem, found: Candidates, horizon: float, samples: int = _SAMPLES
) -> Real:
    """∫ t |e| dt over [0, horizon] of the error after a unit step of the reference, for
    each candidate.

    e is the Fourier series of Dubner and Abate on Re s = ln(1e5)/(2 horizon). 1/(s +
    ω_c) is taken out, so that the jump at t = 0 does not ring.
    """
    if found.count > _TOGETHER:
        return np.concatenate(
            [itae(problem, part, horizon, samples) for part in found.split()]
        )
    shift = _DAMPING / (2.0 * horizon)
    s = np.asarray(
        shift + 1j * math.pi / horizon * np.arange(samples // 2 + 1),
        dtype=np.complex128,
    )
    with np.errstate(all="ignore"):
        # E(s) = 1/(s (1 + L)), in closed form for any L: delays and orders need no
        # model, and all candidates go through one FFT.
        image = 1.0 / (s * (1.0 + found.response(s) * problem.plant(s)[None, :]))
        rate = found.crossover[:, None]
        series = np.fft.irfft(image - 1.0 / (s + rate), n=samples, axis=1)
    # irfft's sum runs over s and its conjugate, and is divided by the number of samples
    time = 2.0 * horizon / samples * np.arange(samples // 2 + 1)
    error = series[:, : time.size] * np.exp(shift * time) * samples / (
        2.0 * horizon
    ) + np.exp(-rate * time)
    return np.asarray(np.trapezoid(time * np.abs(error), time, axis=1))


def searched(problem: PidProblem, crossovers: Sequence[float]) -> Candidates:
    """Every candidate of the grid that keeps what is asked for."""
    both = problem.integral and problem.derivative
    # 21 × 21 orders, or 11 × 11 with ten slopes each: some thousand linear systems of
    # three, a few milliseconds.
    count = _FEWER if both and not problem.flat else _ORDERS
    lam = _range(problem.integral_orders, problem.integral, count)
    mu = _range(problem.derivative_orders, problem.derivative, count)
    slopes = np.array([0.0] if problem.flat or not both else _SLOPES)
    grid = [x.ravel() for x in np.meshgrid(lam, mu, slopes, indexing="ij")]
    found = []
    for crossover in crossovers:
        made = problem.solved(
            grid[0], grid[1], grid[2], np.full(grid[0].size, crossover)
        )
        if problem.flat and not both:
            made = _made_flat(problem, made)
        found.append(problem.admitted(made))
    return _joined(found)


def _range(ends: tuple[float, float], used: bool, count: int) -> Real:
    if not used or ends[0] == ends[1]:
        return np.array([ends[0] if used else 1.0])
    return np.linspace(*ends, count)


def _made_flat(problem: PidProblem, found: Candidates) -> Candidates:
    """Between two candidates whose slopes have opposite signs, the one whose phase is
    flat.
    """
    orders = found.integral_order if problem.integral else found.derivative_order
    chosen = []
    # Candidates with a negative gain were left out, so neighbours in the list may be
    # far apart in their order: halving ends with no candidate there, and the pair is
    # given up.
    for k in np.flatnonzero(found.slope[:-1] * found.slope[1:] < 0.0):
        low, high = orders[k], orders[k + 1]
        for _ in range(40):  # halving: an order is known to 1e-13 then
            middle = 0.5 * (low + high)
            made = _alone(problem, middle, found.crossover[k])
            if not made.count:
                break
            low, high = (
                (middle, high)
                if made.slope[0] * found.slope[k] > 0.0
                else (low, middle)
            )
        else:
            chosen.append(made)
    return _joined(chosen) if chosen else found[np.zeros(found.count, dtype=bool)]


def _alone(problem: PidProblem, order: float, crossover: float) -> Candidates:
    one = np.ones(1)
    lam, mu = (one * order, one) if problem.integral else (one, one * order)
    return problem.solved(lam, mu, 0.0 * one, one * crossover)


def _joined(parts: Sequence[Candidates]) -> Candidates:
    names = (
        "gains",
        "integral_order",
        "derivative_order",
        "slope",
        "crossover",
        "filter_time",
    )
    return Candidates(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in names)
    )


def best_of(
    problem: PidProblem, found: Candidates, horizon: float, *, free: bool
) -> Candidates:
    """The candidate of least ITAE, from the grid on by Nelder and Mead; `free`: ω_c is
    varied, too.
    """
    value = itae(problem, found, horizon)
    place = int(np.argmin(value))
    first, best = found[np.array([place])], float(value[place])
    both = problem.integral and problem.derivative
    start = [
        first.integral_order[0],
        first.derivative_order[0],
        first.slope[0],
        math.log(first.crossover[0]),
    ]
    spans = (problem.integral_orders, problem.derivative_orders)
    varied = [
        problem.integral and spans[0][0] < spans[0][1],
        problem.derivative and spans[1][0] < spans[1][1],
    ]
    if problem.flat and not both:
        varied = [False, False]  # the order is what makes the phase flat
    varied += [both and not problem.flat, free and (both or not problem.flat)]
    if not any(varied):
        return first
    kept: list[tuple[float, Candidates]] = [(best, first)]

    def cost(changed: Real) -> float:
        values = np.array(start)
        values[varied] = changed
        within = all(
            low <= x <= high
            for x, (low, high), on in zip(values, spans, varied, strict=False)
            if on
        )
        low, high = problem.crossovers
        # A wall instead of a penalty: outside the range there may be no controller
        # whose ITAE could be asked.
        if not within or not low <= math.exp(values[3]) <= high:
            return _REFUSED
        made = problem.admitted(
            problem.solved(values[:1], values[1:2], values[2:3], np.exp(values[3:]))
        )
        if not made.count:
            return _REFUSED
        # The cost is ITAE with what is inadmissible cut out, so the simplex may end on
        # a value that was refused: the best admitted one is kept beside it.
        result = float(itae(problem, made, horizon)[0])
        if result < kept[0][0]:
            kept[0] = (result, made)
        return result

    begin = np.array(start)[varied]
    # About the grid's step in the orders, and 6 % in ω_c, whose grid has steps of 35 %:
    # the simplex begins inside the cell that won. SciPy's own start, 5 % of each value,
    # is none where a slope is 0.
    simplex = np.vstack(
        [begin, begin + np.diag(np.array([0.04, 0.04, 0.05, 0.06])[varied])]
    )
    options = {"initial_simplex": simplex, "maxfev": 200, "xatol": 1e-4}
    minimize(cost, begin, method="Nelder-Mead", options=options)
    return _rounded(problem, kept[0][1])


def _rounded(problem: PidProblem, best: Candidates) -> Candidates:
    """The same with orders of four decimals, where the gains for these keep everything,
    too.

    ITAE does not see the fifth; and L has terms whose orders would differ in it alone,
    which no root finder tells apart.
    """
    values = (
        np.round(best.integral_order, 4),
        np.round(best.derivative_order, 4),
        best.slope,
    )
    made = problem.admitted(problem.solved(*values, best.crossover))
    return made if made.count else best


def crossover_grid(problem: PidProblem) -> Real:
    """Crossovers that are tried where none is given."""
    return np.geomspace(*problem.crossovers, _CROSSOVERS)
