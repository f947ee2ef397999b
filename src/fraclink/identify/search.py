"""The way to the best fit of a structure, with no guess asked: a scan, then Levenberg–Marquardt."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fraclink._kernels import FitProblem
from fraclink.errors import NotConvergedError
from fraclink.identify.problem import Window
from fraclink.identify.shape import ALPHA_LIMITS, FREE, ORDER_LIMITS, Shape, mask_of, undamped_as_damped

__all__ = ["Search", "Solution"]

_SCAN_ORDER = 1.85  # wide enough a resonance (ζ = 0.13) that neighbours of the grid see the true one
_SCAN_STEP = 0.15  # in ln Ω
_ITERATIONS = 80
# Delays that are tried as starts, as parts of the vibration's period: a fit creeps over ± 0.15 by itself.
_DELAY_STARTS = (0.0, 0.12, 0.24)
_DELAY_LIMITS = (-0.12, 0.35)


@dataclass(frozen=True, eq=False)
class Solution:
    """The least-squares point of one structure: coordinates, linear parameters, Gram matrix there."""

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
    def at_bound(self) -> tuple[int, ...]:
        """Free coordinates that ended on a limit."""
        near = 1e-7 * (self.upper - self.lower)
        return tuple(
            i
            for i in self.free
            if self.shape[i] <= self.lower[i] + near[i] or self.shape[i] >= self.upper[i] - near[i]
        )


@dataclass(eq=False)
class Search:
    """Fits of one window; every structure's start is taken from those found before.

    `fixed` may hold "gain", "offset", "delay" and model coordinates "order", "damping_order".
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
        """A point near the resonance: the guess that was given, or the best of the scan."""
        if self._seed is None:
            self._seed = self.start if self.start is not None else self._scan()
        return self._seed

    @property
    def wave(self) -> float:
        """The vibration's period at the seed [s]."""
        return 2 * math.pi / math.exp(self.seed[1])

    @property
    def kernel(self) -> FitProblem:
        """The kernel on a grid for this resonance; a guess may be three times too high."""
        if self._kernel is None:
            resonance = math.exp(self.seed[1]) / (1 if self.start is None else 3)
            self._kernel = self.window.kernel(resonance, longest_delay=self.longest_delay)
        return self._kernel

    @property
    def longest_delay(self) -> float:
        """The largest delay [s] that the kernel must be able to apply."""
        fixed = abs(self.fixed.get("delay", 0.0))
        span = self.window.samples * self.window.period
        return max(fixed, min(0.36 * self.wave * (1 if self.start is None else 3), span))

    def _scan(self) -> Shape:
        low, high = (math.log(x) for x in self.window.frequency_limits)
        points = max(int((high - low) / _SCAN_STEP), 8)
        order = self.fixed.get("order", _SCAN_ORDER)
        delay = self.fixed.get("delay", 0.0)
        rows = np.array([[order, x, 0.0, 1.0, delay] for x in np.linspace(low, high, points)])
        kernel = self.window.kernel(math.exp(low), longest_delay=abs(delay), coarse=True)
        costs = kernel.costs(rows, self.gain, self.offset)
        self._evaluations += points
        best: Shape = rows[int(np.argmin(costs))]
        return best

    def limits(self, name: str) -> tuple[Shape, Shape]:
        """Lower and upper limits of the coordinates for a structure."""
        low, high = (math.log(x) for x in self.window.frequency_limits)
        shortest = max(_DELAY_LIMITS[0] * self.wave, -0.9 * self.longest_delay)
        longest = min(_DELAY_LIMITS[1] * self.wave, 0.97 * self.longest_delay)
        lower = np.array([ORDER_LIMITS[0], low - 0.5, 0.0, ALPHA_LIMITS[0], shortest])
        upper = np.array([ORDER_LIMITS[1], high + 0.3, 0.9, ALPHA_LIMITS[1], longest])
        return lower, upper

    def free(self, name: str) -> tuple[int, ...]:
        """Free coordinates of a structure, the delay included unless it is fixed."""
        names = {0: "order", 3: "damping_order"}
        own = tuple(i for i in FREE[name] if names.get(i, "") not in self.fixed)
        return own if "delay" in self.fixed else (*own, 4)

    def solve(self, name: str) -> Solution:
        """The best fit of a structure; found once."""
        if name not in self.solutions:
            rows = list(self._starts(name))
            self.solutions[name] = self._best(name, rows)
        return self.solutions[name]

    def refine(self, name: str, shape: Shape) -> Solution:
        """Fit from one start, without remembering it."""
        return self._best(name, [shape])

    def _best(self, name: str, rows: list[Shape]) -> Solution:
        free = self.free(name)
        lower, upper = self.limits(name)
        starts = np.array(rows)
        if "delay" in self.fixed:
            starts[:, 4] = self.fixed["delay"]
        starts[:, list(free)] = np.clip(starts[:, list(free)], lower[list(free)], upper[list(free)])
        status, shape, gain, offset, cost, evaluations, gram = self.kernel.solve(
            starts, mask_of(free), lower, upper, self.gain, self.offset, _ITERATIONS
        )
        if status == 3:
            raise NotConvergedError(
                f"the fit of {name}", reached=math.inf, wanted=0.0, remedy="examine the log with diagnose"
            )
        return Solution(
            name, free, shape, gain, offset, cost, gram, lower, upper, status, evaluations + self._evaluations
        )

    def _starts(self, name: str) -> Iterable[Shape]:
        seed = self.seed
        if name == "UD-FOM":
            yield from self._with_delays([self.fixed.get("order", min(seed[0], 1.95)), seed[1], 0.0, 1.0])
            return
        fractional = self.solve("UD-FOM").shape
        ratio = max(-math.cos(math.pi / fractional[0]), 1e-4)
        if name == "D-IOM":
            yield np.array([2.0, fractional[1], ratio, 1.0, fractional[4]])
            yield from self._with_delays([2.0, fractional[1], max(ratio, 0.02), 1.0])
        elif name == "UD-IOM":
            yield from self._undamped(fractional)
        else:
            yield from self._damped(fractional, ratio)

    def _with_delays(self, front: list[float]) -> Iterable[Shape]:
        if "delay" in self.fixed:
            yield np.array([*front, self.fixed["delay"]])
            return
        yield np.array([*front, self.seed[4]])
        if self.start is None:
            for part in _DELAY_STARTS[1:]:
                yield np.array([*front, part * self.wave])

    def _undamped(self, near: Shape) -> Iterable[Shape]:
        # Without damping the phase must fit over the whole log: a dip of the cost every π/T, each is tried.
        spacing = min(math.pi / (self.window.samples * self.window.period * math.exp(near[1])), 0.1)
        reach = min(math.ceil(0.15 / spacing), 60)
        offsets = near[1] + spacing * np.arange(-reach, reach + 1)
        rows = np.array([[2.0, x, 0.0, 1.0, delay] for x in offsets for delay in {near[4], 0.0}])
        costs = self.kernel.costs(rows, self.gain, self.offset)
        yield from rows[np.argsort(costs)[:3]]

    def _damped(self, fractional: Shape, ratio: float) -> Iterable[Shape]:
        # Nested structures first: a step never raises the cost, so D-FOM is never worse than either.
        if "damping_order" not in self.fixed:
            yield self.solve("D-IOM").shape
            yield undamped_as_damped(fractional)
            others: tuple[float, ...] = (0.4, 1.5)
        else:
            others = (self.fixed["damping_order"],)
        for other in others:
            most = math.tan(other * math.pi / 2) / 2 if other < 1 else 0.9
            yield np.array([2.0, fractional[1], min(ratio, 0.9 * most), other, fractional[4]])
