"""Search for the best fit of a structure without a first guess: a scan over all
frequencies and delays that the log can show, then Levenberg–Marquardt from its valleys.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from fraclink._arm.link import FRACTIONAL, STRUCTURES
from fraclink._identify.problem import CLEARLY_LESS, FIRST_STEPS, at_limits
from fraclink._identify.shape import (
    ALPHA_LIMITS,
    COORDINATE,
    DIGITS,
    ORDER_LIMITS,
    Window,
    columns_of,
    embedded,
    largest_ratio,
    lowest_valleys,
    mask_of,
    special_cases,
)
from fraclink._kernels import FitProblem
from fraclink.errors import NotConvergedError
from fracsys._precision import BLUR, ROUNDS
from fracsys.checks import Real

if TYPE_CHECKING:
    from fraclink._identify.uncertainty import Covariance

_SCAN_ORDER = 1.85  # of the links of the scan: ζ = 0.13
# Range of the delay as fractions of the vibration period. Less than a half in all, since
# a delay by half a period changes the sign: up to an eighth for an angle that is late, the
# rest for a late gauge.
_DELAY_LIMITS = (-0.12, 0.35)
_VALLEYS = (
    2  # valleys of the broad scan: the lowest may not belong to a narrow resonance
)
# ζ, each a third of the previous one, for the vibration that continues from before a
# cut; steps in ln Ω of a fifth of ζ, since with gain and phase free at the cut a valley
# is only a fifth as wide as the resonance.
_SHARP, _SHARP_VALLEYS = (0.024, 0.008, 0.0027), 8


@dataclass(frozen=True, eq=False)
class Solution:
    """The least-squares solution of one structure: coordinates and linear parameters.

    `gram` is the Gram matrix of [measured, response, constant, derivatives along the
    free coordinates]; `rivals` are the ends of descents in other valleys, best first.
    """

    structure: str
    free: tuple[int, ...]
    shape: Real
    gain: float
    offset: float
    cost: float
    lower: Real
    upper: Real
    converged: bool
    gram: Real
    rivals: tuple[Solution, ...] = ()

    @property
    def resonance(self) -> float:
        """Ω [rad/s]."""
        return math.exp(self.shape[1])

    @property
    def on_edge(self) -> bool:
        """Whether fractional damping ended on ω₀ = 0, where it is an undamped link with
        λ = 2 − α.
        """
        other = float(self.shape[3])
        return (
            3 in self.free
            and other < 1
            and self.shape[2] >= (1 - BLUR) * largest_ratio(other)
        )

    @cached_property
    def at_bound(self) -> tuple[int, ...]:
        """Free coordinates that ended on a limit."""
        ended = at_limits(self.shape, self.lower, self.upper)
        return tuple(i for i in self.free if ended[i])


@dataclass(eq=False)
class Search:
    """Fits of one window; every structure starts from the fits found before.

    `fixed` may hold "gain", "offset", "delay" and model coordinates "order",
    "damping_order"; `start` is a guess, tried in addition to the scan.
    """

    window: Window
    fixed: Mapping[str, float]
    start: Real | None = None
    solutions: dict[str, Solution] = field(default_factory=dict)
    # by the number of samples in an average: see `averages`
    kernels: dict[int, tuple[FitProblem, float]] = field(default_factory=dict)
    # of solutions, with and without the residual's colour: see `link_covariance`
    covariances: dict[tuple[Solution, bool], tuple[Covariance, float]] = field(
        default_factory=dict
    )

    @property
    def known(self) -> tuple[float, float]:
        """Gain and offset, each NaN if it is free."""
        return self.fixed.get("gain", math.nan), self.fixed.get("offset", math.nan)

    @cached_property
    def _range(self) -> tuple[float, float]:
        """Smallest and largest ln Ω, slightly beyond what the log can show, so that a
        resonance at the end is not at a limit.
        """
        low, high = self.window.frequency_limits
        return math.log(low) - 0.5, math.log(high) + 0.3

    @cached_property
    def kernel(self) -> FitProblem:
        """The kernel for all frequencies and delays within reach of the search."""
        return self.kernel_of(self.window)

    def kernel_of(self, window: Window, digits: float = DIGITS) -> FitProblem:
        """The same kernel for another stretch of the log."""
        lowest = math.exp(self._range[0])
        # Slightly more than a fit may use (`_DELAY_LIMITS`).
        longest = max(0.36 * 2 * math.pi / lowest, abs(self.fixed.get("delay", 0.0)))
        span = self.window.samples * self.window.period
        return window.kernel(lowest, longest_delay=min(longest, span), digits=digits)

    def averages(self, width: int) -> tuple[FitProblem, float]:
        """The kernel on averages of `width` samples, a power of two, and the power of the
        averaged output about its mean.
        """
        if width not in self.kernels:
            coarse = self.window
            for _ in range(width.bit_length() - 1):
                coarse = coarse.halved
            centred = coarse.output - coarse.output.mean()
            power = max(float(centred @ centred), 1e-300)
            # Half of the digits: the first step on all samples doubles them.
            self.kernels[width] = self.kernel_of(coarse, DIGITS / 2), power
        return self.kernels[width]

    def _shares(self, links: Real) -> Real:
        """Shares (K,) of the power that links leave unexplained, each on averages that
        still show its resonance.
        """
        shares, widths = np.empty(len(links)), self.window.widths(np.exp(links[:, 1]))
        for width in {*widths.tolist()}:
            (kernel, power), own = self.averages(width), widths == width
            shares[own] = kernel.costs(links[own], *self.known) / power
        return shares

    # --- starts

    def _links(self, places: Real, order: float, parts: Real | float = 0.0) -> Real:
        """Undamped links (K, 5) at given ln Ω, each with a fraction of its period as
        delay.
        """
        delays = self.fixed.get("delay", parts * math.tau * np.exp(-places))
        links = np.empty((max(places.size, np.size(delays)), 5))
        links[:] = self.fixed.get("order", order), 0.0, 0.0, 1.0, 0.0
        links[:, 1], links[:, 4] = places, delays
        return links

    @cached_property
    def _scanned(self) -> list[Real]:
        """Undamped links as starts (K, 5): every valley of a scan over frequencies with
        each delay, the guess, and the vibrations after a cut.
        """
        low, high = self._range
        # 2ζ: the width of a resonance at half its power.
        step = -2 * math.cos(math.pi / _SCAN_ORDER)
        grid = np.linspace(low, high, max(int((high - low) / step), 8))
        shares = self._shares(self._links(grid, _SCAN_ORDER))
        # A delay of a quarter of the vibration period turns the torque into a velocity:
        # λ and the delay compensate each other on a smooth move. A descent covers an
        # eighth of a period to either side, which is half of the range of the delay.
        parts = np.linspace(*_DELAY_LIMITS, 5)[1::2]
        starts = [
            self._links(grid[[valley]], _SCAN_ORDER, parts)
            for valley in lowest_valleys(shares, _VALLEYS)
        ]
        if self.start is not None:
            order, place, *_, delay = self.start
            # Not at 2: on the limit the slope in λ may point outwards, and the descent
            # would never leave it.
            order = self.fixed.get("order", min(order, 1.95))
            starts.append(np.array([[order, place, 0.0, 1.0, delay]]))
        if self.window.input.size > self.window.samples:
            starts += self._sharp()
        return starts

    def _sharp(self) -> list[Real]:
        """Starts for a cut log, in which a lightly damped link still swings from all
        earlier motion, while the broad resonances of the scan have decayed.
        """
        low, high = (math.log(x) for x in self.window.frequency_limits)
        bands, width = self._ringing()
        starts: list[Real] = []
        for ratio in _SHARP:
            order = math.pi / math.acos(-ratio)
            places = np.arange(low, high, ratio / 5)
            apart = np.abs(np.exp(places)[:, None] - bands).min(axis=1)
            rows = self._links(places[apart <= width], order)
            starts += [*rows[lowest_valleys(self._shares(rows), _SHARP_VALLEYS), None]]
        return starts

    def _ringing(self) -> tuple[Real, float]:
        """Frequencies (K,) [rad/s] of the vibration after a cut and their spacing:
        those that explain the log with any state of the link at the cut.
        """
        own = self.window
        inside = replace(own, input=own.input[-own.samples :])
        low, high = own.frequency_limits
        # Within the log, two vibrations can be separated if their phases part by a
        # quarter of a turn.
        spacing = math.pi / (2 * own.samples * own.period)
        kernel = inside.kernel(low, longest_delay=0.0)
        time = own.period * np.arange(own.samples)
        ratio = _SHARP[1]
        order, costs = math.pi / math.acos(-ratio), []
        frequencies = np.arange(low, high, spacing)
        for frequency in frequencies.tolist():
            shape = np.array([order, math.log(frequency), 0.0, 1.0, 0.0])
            state = np.exp((1j - ratio) * frequency * time)
            response = columns_of(kernel, shape)[0]
            columns = np.stack([response, state.real, state.imag, np.ones(time.size)])
            basis = np.linalg.qr(columns.T)[0]
            costs.append(own.output @ own.output - np.sum((own.output @ basis) ** 2))
        # A frequency that leaves clearly more than the best one is no vibration of this log.
        worth = CLEARLY_LESS * np.array(costs) <= min(costs)
        return frequencies[worth], spacing

    # --- descents

    def free(self, name: str) -> tuple[int, ...]:
        """Free coordinates of a structure, the delay included unless it is fixed."""
        own = {*STRUCTURES[name].free, "delay"} - {*self.fixed}
        return tuple(sorted(COORDINATE[parameter] for parameter in own))

    def _delays(self, row: Real) -> tuple[float, float]:
        """Range of the delay for a row [s]."""
        shortest, longest = (x * 2 * math.pi * math.exp(-row[1]) for x in _DELAY_LIMITS)
        span = self.window.samples * self.window.period
        return max(shortest, -0.9 * span), min(longest, 0.97 * span)

    def solve(self, name: str) -> Solution:
        """The best fit of a structure; cached."""
        if name not in self.solutions:
            ends = (
                self._vibrations
                if name == FRACTIONAL
                else self._ends(name, self._starts(name))
            )
            special = [self._descended(name, row) for row in self._special(name)]
            solution, *rivals = self._valleys([*ends, *special])
            if "delay" not in self.fixed:
                solution = self._between_samples(solution)
            self.solutions[name] = replace(solution, rivals=tuple(rivals))
        return self.solutions[name]

    @cached_property
    def _vibrations(self) -> list[Solution]:
        """The valleys of the undamped fractional link, which fits any ring-down: the
        only one that needs a scan.
        """
        return self._valleys(self._ends(FRACTIONAL, self._scanned))

    def _ends(self, name: str, starts: Iterable[Real]) -> list[Solution]:
        """The ends of descents from starts (K, 5), one resonance each; only those that
        after their first steps explain the log nearly as well as the best are continued.
        """
        first: list[Solution] = []
        for rows in starts:
            first += self._valleys(
                [self._descended(name, row, first=True) for row in rows]
            )
        # On averages that show all of them, so that their costs are comparable.
        shapes = np.array([end.shape for end in first])
        width = int(self.window.widths(np.exp(shapes[:, 1])).min())
        kernel = self.averages(width)[0]
        costs = kernel.costs(shapes, *self.known).tolist()
        if not math.isfinite(min(costs)):
            raise NotConvergedError(
                f"the fit of {name}",
                reached=math.inf,
                wanted=0.0,
                remedy="examine the log with diagnose",
            )
        first = [
            replace(end, cost=cost) for end, cost in zip(first, costs, strict=True)
        ]
        return [self._descended(name, end.shape) for end in self._valleys(first)]

    def _valleys(self, ends: Sequence[Solution]) -> list[Solution]:
        """The lowest end, and the ends in other valleys that explain the log nearly as
        well, best first.
        """
        # Two vibrations can be separated if their phases part by a quarter of a turn
        # over all the motion of the link.
        turn = math.pi / (2 * self.window.input.size * self.window.period)
        lowest, *others = sorted(ends, key=lambda each: each.cost)
        distinct = [lowest]
        for end in others:
            apart = (abs(end.resonance - other.resonance) > turn for other in distinct)
            if CLEARLY_LESS * end.cost <= lowest.cost and all(apart):
                distinct.append(end)
        return distinct

    def _descended(
        self,
        name: str,
        row: Real,
        delays: tuple[float, float] | None = None,
        *,
        first: bool = False,
    ) -> Solution:
        """The end of the kernel's descent from a row, with the delay in a range; if
        `first`, after its first steps only, on averages of samples. The cost is
        infinite if there is no response.
        """
        # Room for a descent to twice the resonance that it begins at.
        width = int(self.window.widths(2 * np.exp(row[1]))) if first else 1
        shortest, longest = delays or self._delays(row)
        low, high = self._range
        lower = np.array([ORDER_LIMITS[0], low, 0.0, ALPHA_LIMITS[0], shortest])
        # ζ up to the kernel's FIT_RATIO_MOST: beyond it there is no vibration.
        upper = np.array([ORDER_LIMITS[1], high, 0.9, ALPHA_LIMITS[1], longest])
        if "damping_order" in STRUCTURES[name].free:
            # An undamped link with λ near 1 vibrates far below the modulus of its
            # poles, and hardly at all.
            lower[1], upper[2] = lower[1] - 3.0, 50.0
        free = list(self.free(name))
        start = row.copy()
        start[4] = self.fixed.get("delay", row[4])
        start[free] = np.clip(start[free], lower[free], upper[free])
        kernel = self.averages(width)[0] if first else self.kernel
        converged, shape, gain, offset, cost, gram = kernel.solve(
            start,
            mask_of(free),
            lower,
            upper,
            *self.known,
            # Enough even for an undamped link on a damped log, whose error falls by
            # a third per step.
            FIRST_STEPS if first else ROUNDS,
        )
        return Solution(
            name,
            tuple(free),
            shape,
            gain,
            offset,
            cost,
            lower,
            upper,
            converged,
            gram,
        )

    def _between_samples(self, found: Solution) -> Solution:
        """The best of a fit and of the fits in the sampling intervals about its delay.

        A held input jumps, and so does the torque: as a function of the delay the cost
        jumps wherever a sample passes a jump, and is smooth only from a sample
        (included) back to the previous one. Linear interpolation averages the noise of
        two samples, most effectively half-way between them, so a rough angle favours
        every half sample of delay. Such a gain within a sample does not show which
        channel is delayed: for a rough angle a delay is negative only beyond one and a
        half samples.
        """
        period, name, shape = self.window.period, found.structure, found.shape[:4]
        held = self.window.hold == "zero"
        if not held and not self.window.is_rough:
            return found
        shortest, longest = self._delays(found.shape)
        first = math.floor(found.shape[4] / period)
        starts = [
            (
                (k - 0.5) * period,
                (max((k - 1 + 1e-6) * period, shortest), min(k * period, longest)),
            )
            for k in range(first, first + 3)
        ]
        ends = [
            self._descended(name, np.append(shape, delay), limits)
            for delay, limits in starts
            if limits[0] <= limits[1]
        ]
        best = min([found, *ends], key=lambda each: each.cost)
        if not held and -1.5 * period < best.shape[4] < 0:
            start = np.append(shape, 0.5 * period)
            return self._descended(name, start, (0.0, longest))
        return best

    def _special(self, name: str) -> Iterator[Real]:
        """The fits of a structure's special cases as starts: a step never raises the
        cost, so that the structure's own fit is never worse.

        The undamped link of integer order is among them only where a vibration outlasts
        the log: its search takes longest, as it tries every valley of the phase over
        the whole log.
        """
        if {"order", "damping_order"} & {*self.fixed}:
            return
        span = self.window.samples * self.window.period
        decays = [
            -math.cos(math.pi / found.shape[0]) * found.resonance * span
            for found in self._vibrations
        ]
        for special in special_cases(name):
            if {"order", "damping"} & {*STRUCTURES[special].free} or min(
                decays
            ) < math.pi:
                yield embedded(self.solve(special).shape, name)

    def _starts(self, name: str) -> Iterator[Real]:
        """Starts (K, 5) of one resonance each in the valleys of the vibrations."""
        vibrations = [found.shape for found in self._vibrations]
        if STRUCTURES[name].free == ("natural_frequency",):
            for vibration in vibrations:
                yield from self._undamped(vibration)
            return
        other = self.fixed.get("damping_order", 1.0)
        for order, place, *_, delay in vibrations:
            # The pole of s^λ + ω₀² has the argument π/λ: the undamped link of order λ
            # decays like one with ζ = −cos(π/λ).
            ratio = max(-math.cos(math.pi / order), 1e-3)
            damped = min(ratio, 0.9 * largest_ratio(other))
            yield np.array([[2.0, place, damped, other, delay]])

    def _undamped(self, near: Real) -> Iterator[Real]:
        # Without damping the phase must fit over the whole log: the cost has a minimum
        # every π/T, and each one is tried.
        spacing = min(
            math.pi / (self.window.samples * self.window.period * math.exp(near[1])),
            0.1,
        )
        reach = min(math.ceil(0.15 / spacing), 60)
        offsets = near[1] + spacing * np.arange(-reach, reach + 1)
        rows = np.array(
            [[2.0, x, 0.0, 1.0, delay] for x in offsets for delay in {near[4], 0.0}]
        )
        yield from rows[np.argsort(self._shares(rows))[:3], None]
