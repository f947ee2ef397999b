"""The way to the best fit of a structure, with no guess asked: a scan, then
Levenberg–Marquardt.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import FRACTIONAL, STRUCTURES, structure
from fraclink._identify.shape import (
    ALPHA_LIMITS,
    ORDER_LIMITS,
    Shape,
    Window,
    columns_of,
    delayed,
    embedded,
    free_coordinates,
    largest_ratio,
    lowest_valleys,
    mask_of,
    special_cases,
    undamped_as_damped,
)
from fraclink._kernels import FitProblem
from fraclink.errors import NotConvergedError

# ζ = 0.13 and a step in ln Ω: neighbours on the grid overlap. Of 160 simulated logs,
# half of them with more noise than torque, 16 fits end in another valley; with steps of
# 0.5 it is 23, with a sharper resonance (1.97) 24.
_SWEEP_ORDER, _SWEEP_STEP = 1.85, 0.2
_SCAN_ORDER = 1.92  # ζ = 0.065, for the places between them
# ζ, each a third of the one before, for what rings on from before a cut; steps in ln Ω
# of a fifth of it, as gain and phase at the cut leave a fifth of the resonance's width.
_SHARP, _SHARP_VALLEYS = (0.024, 0.008, 0.0027), 3
_REMEMBERED = 20_000  # samples before the cut; ζ = 0.0027 forgets in 180 periods
_ITERATIONS = 200  # an undamped link on a damped log converges by a third a step
# Delays that are tried as starts, as parts of the vibration's period: a fit creeps over
# ± 0.15 by itself. Either of them alone, or neither, loses 3 more of those 160 logs.
_DELAY_STARTS = (0.12, 0.24)
_DELAY_LIMITS = (-0.12, 0.35)
# Delays of other valleys, as parts of the period: on a smooth move λ and the delay
# trade, and a fit in the valley of the one never sees the other. With the delay held a
# few steps tell what is worth a fit: on a log with a resonance the cost is a hundred
# times the least one there.
_DELAY_VALLEYS, _DELAY_NEAR = (0.0, 0.08, 0.2), 0.04
_HELD_ITERATIONS, _WORTH = 5, 4.0
_PLACES = 9  # over the range of frequencies, where a first fit has failed


@dataclass(frozen=True, eq=False)
class Solution:
    """The least-squares point of one structure: coordinates, linear parameters, Gram
    matrix there.

    `evaluations`: passes over the data that the search had taken by then.
    """

    structure: str
    free: tuple[int, ...]
    shape: Shape
    gain: float
    offset: float
    cost: float
    gram: NDArray[np.float64]
    lower: Shape
    upper: Shape
    status: int
    evaluations: int

    @property
    def on_edge(self) -> bool:
        """Whether fractional damping ended on ω₀ = 0, where it is an undamped link with
        λ = 2 − α.
        """
        other = float(self.shape[3])
        return (
            3 in self.free
            and other < 1
            and self.shape[2] >= (1 - 1e-7) * largest_ratio(other)
        )

    @property
    def at_bound(self) -> tuple[int, ...]:
        """Free coordinates that ended on a limit."""
        near = 1e-7 * (self.upper - self.lower)
        return tuple(
            i
            for i in self.free
            if self.shape[i] <= self.lower[i] + near[i]
            or self.shape[i] >= self.upper[i] - near[i]
        )


@dataclass(eq=False)
class Search:
    """Fits of one window; every structure's start is taken from those found before.

    `fixed` may hold "gain", "offset", "delay" and model coordinates "order",
    "damping_order".
    """

    window: Window
    fixed: Mapping[str, float]
    start: Shape | None = None
    solutions: dict[str, Solution] = field(default_factory=dict)
    _kernel: FitProblem | None = None
    _seed: Shape | None = None
    _evaluations: int = 0

    @property
    def gain(self) -> float:
        """The gain where it is fixed, NaN where it is free."""
        return self.fixed.get("gain", math.nan)

    @property
    def offset(self) -> float:
        """The offset where it is fixed, NaN where it is free."""
        return self.fixed.get("offset", math.nan)

    @property
    def seed(self) -> Shape:
        """A point near the resonance: the best of the scan, or the guess that was given
        if it is better.

        With a free gain a fit from a bad guess ends beside the optimum in one of five
        cases, with the sign of the gain reversed; from the scan it does not. With a
        known gain any guess leads there (2000 of 2000 with ω₀ up to three times off),
        and the scan is saved.
        """
        if self._seed is None:
            self._seed = (
                self.start
                if self.start is not None and "gain" in self.fixed
                else self._scan()
            )
        return self._seed

    @property
    def wave(self) -> float:
        """The vibration's period at the seed [s]."""
        return 2 * math.pi / math.exp(self.seed[1])

    @property
    def kernel(self) -> FitProblem:
        """The kernel on a grid for this resonance; a guess may be three times too high."""
        if self._kernel is None:
            self._kernel = self.window.kernel(
                self.lowest, longest_delay=self.longest_delay
            )
        return self._kernel

    @property
    def lowest(self) -> float:
        """The lowest resonance [rad/s] the grid of rates must serve: a guess may be
        three times too high.
        """
        return math.exp(self.seed[1]) / (3 if self.seed is self.start else 1)

    @property
    def longest_delay(self) -> float:
        """The largest delay [s] that the kernel must be able to apply."""
        fixed = abs(self.fixed.get("delay", 0.0))
        span = self.window.samples * self.window.period
        # A hair more than a fit may use (`_DELAY_LIMITS`), three times that where the
        # seed is a guess.
        return max(
            fixed, min(0.36 * self.wave * (3 if self.seed is self.start else 1), span)
        )

    def _scan(self) -> Shape:
        """Sweep ln Ω with a broad resonance, then its neighbourhood with a narrower
        one, then delays.
        """
        low, high = (math.log(x) for x in self.window.frequency_limits)
        delay = self.fixed.get("delay", 0.0)
        points = max(int((high - low) / _SWEEP_STEP), 8)
        kernel = self.window.kernel(
            math.exp(low), longest_delay=abs(delay), coarse=True
        )
        broad, costs = self._tried(
            kernel, np.linspace(low, high, points), _SWEEP_ORDER, delay
        )
        # Two: the lowest of a broad resonance need not be the lowest of a narrow one,
        # as in 3 of those 160 logs.
        near = broad[lowest_valleys(costs, 2)]
        fine = (
            near[:, 1:2] + _SWEEP_STEP * np.array([-0.4, -0.2, 0.0, 0.2, 0.4])
        ).ravel()
        narrow, costs = self._tried(kernel, fine, _SCAN_ORDER, delay)
        if self.start is not None:
            narrow = np.concatenate([narrow, self.start[None, :]])
            costs = self._costs(kernel, narrow)
        best: Shape = narrow[int(np.argmin(costs))]
        if "delay" in self.fixed:
            return best
        # A delay of a quarter of the vibration turns the torque into a velocity: the
        # scan without it then finds the right frequency with the wrong phase, or
        # another frequency.
        late = np.concatenate([delayed(near, part) for part in _DELAY_STARTS])
        kernel = self.window.kernel(
            math.exp(low), longest_delay=float(np.max(late[:, 4])), coarse=True
        )
        late_costs = self._costs(kernel, late)
        least = int(np.argmin(late_costs))
        return (
            best
            if float(np.min(costs)) <= late_costs[least]
            else np.asarray(late[least])
        )

    def _tried(
        self,
        kernel: FitProblem,
        places: NDArray[np.float64],
        order: float,
        delay: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        order = self.fixed.get("order", order)
        rows = np.array([[order, x, 0.0, 1.0, delay] for x in places])
        return rows, self._costs(kernel, rows)

    def _costs(
        self, kernel: FitProblem, rows: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        self._evaluations += len(rows)
        return kernel.costs(rows, self.gain, self.offset)

    def limits(self, *, may_lead: bool) -> tuple[Shape, Shape]:
        """Lower and upper limits of the coordinates; `may_lead` admits a delay below
        zero.
        """
        low, high = (math.log(x) for x in self.window.frequency_limits)
        shortest = (
            max(_DELAY_LIMITS[0] * self.wave, -0.9 * self.longest_delay)
            if may_lead
            else 0.0
        )
        longest = min(_DELAY_LIMITS[1] * self.wave, 0.97 * self.longest_delay)
        lower = np.array([ORDER_LIMITS[0], low - 0.5, 0.0, ALPHA_LIMITS[0], shortest])
        # ζ up to the kernel's FIT_RATIO_MOST: beyond it there is no vibration.
        upper = np.array([ORDER_LIMITS[1], high + 0.3, 0.9, ALPHA_LIMITS[1], longest])
        return lower, upper

    def free(self, name: str) -> tuple[int, ...]:
        """Free coordinates of a structure, the delay included unless it is fixed."""
        names = {0: "order", 3: "damping_order"}
        own = tuple(
            i for i in free_coordinates(name) if names.get(i, "") not in self.fixed
        )
        return own if "delay" in self.fixed else (*own, 4)

    def solve(self, name: str) -> Solution:
        """The best fit of a structure; found once."""
        if name not in self.solutions:
            found = self._best(name, list(self._starts(name)))
            if name == FRACTIONAL:
                # The other structures start from it, and in its valley.
                found = self._over_the_valleys(found)
            if "delay" not in self.fixed:
                if self.window.hold == "zero":
                    found = self._over_the_jumps(found)
                elif self.window.is_rough:
                    found = self._over_the_kinks(found)
            # The best one need not be the last one: what was tried after it was work,
            # too.
            self.solutions[name] = replace(found, evaluations=self._evaluations)
        return self.solutions[name]

    def _over_the_valleys(self, found: Solution) -> Solution:
        """The best of a fit and of those from other delays, other vibrations of a cut
        log, and other frequencies where it ended at a limit.
        """
        if "delay" not in self.fixed:
            found = self._over_the_delays(found)
        if self.window.angle.size > self.window.samples:
            found = self._from_places(found, self._sharp())
        if {0, 1} & {*found.at_bound} or (
            4 in found.at_bound and found.shape[4] != 0.0
        ):
            found = self._from_other_valleys(found)
        return found

    def _from_other_valleys(self, found: Solution) -> Solution:
        """The best of a fit that ended at a limit of λ, ω₀ or the delay, and of fits
        from elsewhere.

        On a noisy log of little motion the scan may take a rate far above the resonance
        for it. The limits of the delay and the kernel's rates are made for the seed:
        each place is a seed of its own.
        """
        low, high = (math.log(x) for x in self.window.frequency_limits)
        places = np.linspace(low, high, _PLACES)
        # λ where it is not free is the structure's own: a link of order 2 begun at 1.92
        # would keep that.
        order = _SCAN_ORDER if 0 in found.free else float(found.shape[0])
        rows = [np.array([order, x, 0.0, 1.0, 0.0]) for x in places]
        return self._from_places(found, [found.shape, *rows])

    def _sharp(self) -> list[Shape]:
        """Places to begin at on a cut log, where a lightly damped link swings by all
        that went before: the scan's broad resonances have forgotten it by then.
        """
        low, high = (math.log(x) for x in self.window.frequency_limits)
        delay = self.fixed.get("delay", 0.0)
        # What such links remember; of a longer history every place would cost
        # milliseconds.
        near = replace(
            self.window, angle=self.window.angle[-(self.window.samples + _REMEMBERED) :]
        )
        kernel = near.kernel(math.exp(low), longest_delay=abs(delay), coarse=True)
        bands, width = self._ringing()
        rows: list[Shape] = []
        # Each is a seed of its own: the best one of so coarse a row need not be of the
        # best valley.
        for ratio in _SHARP:
            order = math.pi / math.acos(-ratio)
            places = np.arange(low, high, ratio / 5)
            apart = np.abs(np.exp(places)[:, None] - bands).min(axis=1)
            tried, costs = self._tried(kernel, places[apart <= width], order, delay)
            rows.extend(tried[lowest_valleys(costs, _SHARP_VALLEYS)])
        return rows

    def _ringing(self) -> tuple[NDArray[np.float64], float]:
        """Frequencies (K,) [rad/s] of the vibration behind a cut, and how far they lie
        apart: those that explain the log with any state of the link at the cut.
        """
        own = self.window
        inside = replace(own, angle=own.angle[-own.samples :])
        low, high = own.frequency_limits
        # Within the log two vibrations are told apart by half a turn.
        spacing = math.pi / (2 * own.samples * own.period)
        kernel = inside.kernel(low, longest_delay=0.0, coarse=True)
        time = own.period * np.arange(own.samples)
        ratio = _SHARP[1]
        order, costs = math.pi / math.acos(-ratio), []
        frequencies = np.arange(low, high, spacing)
        for frequency in frequencies.tolist():
            shape = np.array([order, math.log(frequency), 0.0, 1.0, 0.0])
            state = np.exp((1j - ratio) * frequency * time)
            moved = columns_of(kernel, shape)[0]
            columns = np.stack([moved, state.real, state.imag, np.ones(time.size)])
            basis = np.linalg.qr(columns.T)[0]
            costs.append(own.output @ own.output - np.sum((own.output @ basis) ** 2))
        self._evaluations += len(costs)
        return frequencies[np.array(costs) <= _WORTH * min(costs)], spacing

    def _from_places(self, found: Solution, rows: Iterable[Shape]) -> Solution:
        """The best of a fit and of those from other places."""
        kept = self.seed, self._kernel
        for row in rows:
            self._seed, self._kernel = row, None
            other = self._best(found.structure, [row])
            if other.cost < found.cost * (1 - 1e-9):
                found, kept = other, (self._seed, self._kernel)
                self.solutions.clear()
        self._seed, self._kernel = kept
        return found

    def reconcile(self) -> None:
        """Fit a structure again from a special case of it that did better.

        On a log without a clear resonance a scan may end in another valley for each
        structure; a structure that is worse than its own special case would be the
        search's fault.
        """
        for name, special in (
            (row, other) for row in STRUCTURES for other in special_cases(row)
        ):
            inner, outer = self.solve(special), self.solve(name)
            if outer.cost > inner.cost * (1 + 1e-9) and not {
                "order",
                "damping_order",
            } & set(self.fixed):
                again = self._best(name, [embedded(inner.shape, name)], may_lead=True)
                self.solutions[name] = min((outer, again), key=lambda s: s.cost)

    def _over_the_delays(self, found: Solution) -> Solution:
        """The best of a fit and of two from other delays: those that are lowest with
        the delay held.
        """
        held = mask_of(tuple(i for i in found.free if i != 4))
        rows = []
        for delay in (part * self.wave for part in _DELAY_VALLEYS):
            if abs(delay - found.shape[4]) < _DELAY_NEAR * self.wave:
                continue
            start = found.shape.copy()
            start[4] = min(delay, found.upper[4])
            status, shape, _, _, cost, evaluations, _ = self.kernel.solve(
                start[None, :],
                held,
                found.lower,
                found.upper,
                self.gain,
                self.offset,
                _HELD_ITERATIONS,
            )
            self._evaluations += evaluations
            if status != 3 and cost < _WORTH * found.cost:
                rows.append((cost, tuple(shape.tolist())))
        if not rows:
            return found
        other = self._best(
            found.structure, [np.array(shape) for _, shape in sorted(rows)[:2]]
        )
        return other if other.cost < found.cost * (1 - 1e-9) else found

    def _over_the_jumps(self, found: Solution) -> Solution:
        """Fits within the two nearest sampling intervals of delay.

        A held input jumps, and so does the torque: as a function of the delay the cost
        jumps wherever a sample passes a jump, and is smooth only from a sample
        (included) back to the one before.
        """
        period, best = self.window.period, found
        for whole in {
            math.floor(found.shape[4] / period),
            math.ceil(found.shape[4] / period - 1e-9),
        }:
            start = found.shape.copy()
            start[4] = whole * period
            shortest, longest = found.lower[4], found.upper[4]
            inside = (
                max((whole - 1 + 1e-6) * period, shortest),
                min(whole * period, longest),
            )
            if inside[0] >= inside[1]:
                continue
            best = min(
                (best, self._best(found.structure, [start], delays=inside)),
                key=lambda s: s.cost,
            )
        return best

    def _over_the_kinks(self, found: Solution) -> Solution:
        """Fits from the neighbouring half samples of delay, and from delays that are
        truly negative.

        A straight line averages the noise of two samples, most of it half-way between
        them, so that a rough angle rewards every half sample of delay. Within a sample
        such a gain says nothing on which channel is later: the delay is then not let
        below zero (see `limits`).
        """
        rows = []
        # 0.6 of a sample is just over the crest that half a sample makes; 2.5 is far
        # beyond the one sample within which a lead says nothing.
        for shift in (-0.6, 0.6, -2.5):
            rows.append(found.shape.copy())
            rows[-1][4] += shift * self.window.period
        best = min((found, self._best(found.structure, rows[:2])), key=lambda s: s.cost)
        early = self._best(found.structure, rows[2:], may_lead=True)
        leads = early.shape[4] < -1.5 * self.window.period and early.cost < best.cost
        return early if leads else best

    def _best(
        self,
        name: str,
        rows: list[Shape],
        *,
        may_lead: bool | None = None,
        delays: tuple[float, float] | None = None,
    ) -> Solution:
        free = self.free(name)
        lower, upper = self.limits(
            may_lead=not self.window.is_rough if may_lead is None else may_lead
        )
        if "damping_order" in structure(name).free:
            # As an undamped link with λ near 1 it vibrates far below its poles'
            # modulus, and hardly at all.
            lower[1], upper[2] = lower[1] - 3.0, 50.0
        if delays is not None:
            lower[4], upper[4] = delays
        starts = np.array(rows)
        if "delay" in self.fixed:
            starts[:, 4] = self.fixed["delay"]
        starts[:, list(free)] = np.clip(
            starts[:, list(free)], lower[list(free)], upper[list(free)]
        )
        status, shape, gain, offset, cost, evaluations, gram = self.kernel.solve(
            starts, mask_of(free), lower, upper, self.gain, self.offset, _ITERATIONS
        )
        self._evaluations += evaluations
        if status == 3:
            raise NotConvergedError(
                f"the fit of {name}",
                reached=math.inf,
                wanted=0.0,
                remedy="examine the log with diagnose",
            )
        return Solution(
            name,
            free,
            shape,
            gain,
            offset,
            cost,
            gram,
            lower,
            upper,
            status,
            self._evaluations,
        )

    def _starts(self, name: str) -> Iterable[Shape]:
        """Points to start from; only the undamped fractional link, which fits any
        ring-down, needs a scan.
        """
        free = set(structure(name).free)
        if name == FRACTIONAL:
            # Not at 2: on the limit the slope in λ may point outwards, and the descent
            # would never leave it.
            order = self.fixed.get("order", min(self.seed[0], 1.95))
            yield np.array([order, self.seed[1], 0.0, 1.0, self.seed[4]])
            return
        fractional = self.solve(FRACTIONAL).shape
        # The pole of s^λ + ω₀² lies at the angle π/λ: its damping ratio is −cos(π/λ).
        ratio = max(-math.cos(math.pi / fractional[0]), 1e-4)
        if "damping_order" in free:
            yield from self._damped(name, fractional, ratio)
        elif "order" in free:
            yield from (self.solve(special).shape for special in special_cases(name))
        elif "damping" in free:
            # The undamped link of order λ decays as one with ζ = −cos(π/λ): a start
            # beside the optimum.
            yield np.array([2.0, fractional[1], max(ratio, 1e-3), 1.0, fractional[4]])
        else:
            yield from self._undamped(fractional)

    def _undamped(self, near: Shape) -> Iterable[Shape]:
        # Without damping the phase must fit over the whole log: a dip of the cost every
        # π/T, each is tried.
        spacing = min(
            math.pi / (self.window.samples * self.window.period * math.exp(near[1])),
            0.1,
        )
        reach = min(math.ceil(0.15 / spacing), 60)
        offsets = near[1] + spacing * np.arange(-reach, reach + 1)
        rows = np.array(
            [[2.0, x, 0.0, 1.0, delay] for x in offsets for delay in {near[4], 0.0}]
        )
        costs = self._costs(self.kernel, rows)
        yield from rows[np.argsort(costs)[:3]]

    def _damped(self, name: str, fractional: Shape, ratio: float) -> Iterable[Shape]:
        # Special cases first: a step never raises the cost, so the fit is never worse
        # than any of them.
        others: tuple[float, ...] = (0.4, 1.5)
        if "damping_order" in self.fixed:
            others = (self.fixed["damping_order"],)
        else:
            damped = (
                other
                for other in special_cases(name)
                if "damping" in structure(other).free
            )
            yield from (self.solve(other).shape for other in damped)
            yield undamped_as_damped(fractional)
        for other in others:
            yield np.array(
                [
                    2.0,
                    fractional[1],
                    min(ratio, 0.9 * largest_ratio(other)),
                    other,
                    fractional[4],
                ]
            )
