"""What else could be asked for: the feasibility map."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop, noise_points
from fraclink._arm.rig import Rig
from fraclink._design.assess import axis_of
from fraclink._design.equations import equation, task_of
from fraclink._display import displayed
from fraclink._law.design import Specification
from fraclink.errors import SizeError
from fracsys._sweep import bracketed_roots
from fracsys.checks import Between, Frequency, PhaseMargin, checked
from fracsys.checks.equality import compared

__all__ = [
    "FeasibilityMap",
    "feasibility_map",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
_POINTS = (
    320  # trial values of ω̄_c of a map; a root is then closed in on by secant steps
)
_CELLS = 1_000_000
# [rad] of ln ω: below the falling crossing, so that it is not taken for the rising one
_MARGINAL = 1e-6


# ---- the same distance from -1 for all --------------------------------------------------------------------


# ---- the map of what can be asked for ---------------------------------------------------------------------


@displayed
@compared
@dataclass(frozen=True, eq=False)
class FeasibilityMap:
    """Arrays of shape (len(phase_margin), len(gain_crossover)); NaN where no admissible
    controller exists.

    ``gain`` k_d, ``order`` β, ``upper`` ω̄_c [rad/s], ``filter_time`` δ [s],
    ``settling_time`` 2π/ω_c [s] and ``noise_gain`` at the lightest payload.
    """

    gain_crossover: Real
    phase_margin: Real
    gain: Real
    order: Real
    upper: Real
    filter_time: Real
    settling_time: Real
    noise_gain: Real

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Where an admissible controller exists."""
        return np.isfinite(self.order)


@checked
def feasibility_map(
    model: LinkModel,
    rig: Rig,
    *,
    gain_crossovers: ArrayLike,
    phase_margins: ArrayLike,
    filter_order: Annotated[int, Between(1, 2)] = 1,
    payloads: tuple[float, float] | None = None,
    natural_frequencies: tuple[float, float] | None = None,
    margins: Literal["loop", "ideal"] = "loop",
    filter_time: float | None = None,
    inner: Literal["ideal", "sampled"] = "ideal",
    placement: Literal["tustin", "direct"] = "tustin",
) -> FeasibilityMap:
    """Solve the closed procedure for every pair of crossover [rad/s] and phase margin
    [rad] at once.

    The options are those of `design`, with one n for the whole map. Each cell satisfies
    (54), (55) and the exact condition of Theorem 1, and keeps the margin where |L|
    rises through one, too, at both ends of the range.

    Raises FieldError, or SizeError beyond a million cells.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> axes = {"gain_crossovers": [9.0, 12.0], "phase_margins": [fl.deg(50)]}
    >>> found = feasibility_map(rig.model, rig, **axes, filter_time=0.0)
    >>> found.feasible.tolist(), round(float(found.order[0, 1]), 4)
    ([[False, True]], 0.6122)
    """
    crossovers = axis_of("gain_crossovers", gain_crossovers, Frequency)
    angles = axis_of("phase_margins", phase_margins, PhaseMargin)
    if crossovers.size * angles.size > _CELLS:
        count = crossovers.size * angles.size
        allowed, remedy = f"at most {_CELLS}", "take fewer values"
        raise SizeError(
            "gain_crossovers", count, "too many cells", allowed=allowed, remedy=remedy
        )
    spec = Specification(
        # One task for all cells: the easiest crossover, so that the bandwidth is
        # refused only where no cell has it. The equations then take each cell's own
        # pair.
        gain_crossover=float(crossovers.min()),
        phase_margin=float(angles.max()),
        filter_order=filter_order,
        payloads=payloads,
        natural_frequencies=natural_frequencies,
        margins=margins,
        filter_time=filter_time,
        inner=inner,
        placement=placement,
    )
    task = task_of(model, rig, spec)
    cells = _Cells(
        task.bare(filter_order),
        (task.low, task.high),
        task.inside and filter_time is None,
    )
    rows = [cells.row(crossovers, float(angle)) for angle in angles]
    order, upper, time, chi = (np.array(column) for column in zip(*rows, strict=True))
    gain = chi / crossovers**order
    rising = [
        cells.rising((gain, order, time), w0, falling)
        for w0, falling in (
            (task.low, np.broadcast_to(crossovers, order.shape)),
            (task.high, upper),
        )
    ]
    # Only the two ends of the range are asked. The falling crossing's margin is (55)
    # itself there; that no payload between is worse is what a test compares cell by
    # cell with `design`, which asks over the whole range.
    kept = np.minimum(*rising) >= angles[:, None]
    order, upper, time, gain = (
        np.where(kept, v, np.nan) for v in (order, upper, time, gain)
    )
    settling = np.where(np.isfinite(order), 2.0 * math.pi / crossovers, np.nan)
    noise = cells.noise((gain, order, time), task.high, rig.period)
    return FeasibilityMap(crossovers, angles, gain, order, upper, time, settling, noise)


@dataclass(frozen=True)
class _Cells:
    """The equations of a map: the loop beside Ĉ, the ends of the range, whether the
    filter is the rule's.
    """

    bare: Loop
    ends: tuple[float, float]
    rule: bool

    def row(self, crossovers: Real, margin: float) -> tuple[Real, Real, Real, Real]:
        """(β, ω̄_c, δ, χ) for one margin and every crossover: the lowest admissible
        root of each.
        """
        low, high = self.ends
        limit = min(self.bare.link_order, 2.0)

        def terms(upper: Real, crossover: Real) -> tuple[Real, Real, Real, Real]:
            at_low = self.bare.log(crossover, low)
            return equation(
                self.bare, high, upper, (crossover, at_low), margin, rule=self.rule
            )

        top = min(self.bare.highest, 50.0 * float(crossovers.max()) * (high / low) ** 2)
        grid = np.geomspace(0.9 * float(crossovers.min()), top, _POINTS)
        residual, beta, _, _ = terms(grid[None, :], crossovers[:, None])
        # The same lower end, 0.9 ω_c, as `solutions`: a map and a single design must
        # not differ in what they look at.
        inside = (
            (grid[None, :] >= 0.9 * crossovers[:, None]) & (beta > 0.0) & (beta < limit)
        )
        # |L| falls through one: the residual goes from plus to minus, which is the
        # exact condition at ω̄_c.
        change = (residual[:, :-1] > 0.0) & (residual[:, 1:] <= 0.0) & inside[:, :-1]
        # The lowest root, as `attempt` takes the first admissible one; a row without
        # any is masked behind.
        at = np.argmax(change, axis=1)
        upper = bracketed_roots(
            lambda x: terms(x, crossovers)[0], grid[at], grid[at + 1]
        )
        _, beta, chi, time = terms(upper, crossovers)
        slope = self.bare.slope(crossovers, low).real + beta
        if self.rule:
            square = (time * crossovers) ** 2
            slope = slope - self.bare.filter_order * square / (1.0 + square)
        good = change.any(axis=1) & (slope < 0.0) & (beta > 0.0) & (beta < limit)
        order, place, delta, level = (
            np.where(good, v, np.nan) for v in (beta, upper, time, np.exp(chi))
        )
        return order, place, delta, level

    def _log(
        self, cells: tuple[Real, Real, Real], frequency: Real, natural_frequency: float
    ) -> Complex:
        """ln L of every cell at its own frequency [rad/s]."""
        gain, order, time = cells
        value = self.bare.log(frequency, natural_frequency) + np.log(gain)
        value = value + order * (np.log(frequency) + 0.5j * math.pi)
        if self.rule:
            value = value - self.bare.filter_order * np.log(1.0 + 1j * time * frequency)
        return np.asarray(value)

    def rising(
        self, cells: tuple[Real, Real, Real], natural_frequency: float, falling: Real
    ) -> Real:
        """Phase margin where |L| rises through one, below the `falling` crossing
        [rad/s]; NaN where NaN.

        The phase there is positive, so the margin is what is left to π.
        """
        gain, order, _ = cells
        peak = np.broadcast_to(self.bare.peak(natural_frequency), order.shape)
        with np.errstate(invalid="ignore", over="ignore"):
            above = np.log(falling) - _MARGINAL
            peaked = self._log(cells, peak, natural_frequency).real > 0.0
            high = np.where(peaked, np.minimum(np.log(peak), above), above)
            # Below the resonance |G| is at most its value at the peak: |L| < 1 there
            # for certain.
            loudest = self.bare.level(peak, natural_frequency)
            low = (
                np.minimum(-(np.log(gain) + np.maximum(loudest, 0.0)) / order, high)
                - 1.0
            )
            low = np.maximum(low, -300.0)
            place = bracketed_roots(
                lambda x: self._log(cells, np.exp(x), natural_frequency).real, low, high
            )
            return np.asarray(
                math.pi
                - np.abs(self._log(cells, np.exp(place), natural_frequency).imag)
            )

    def noise(
        self, cells: tuple[Real, Real, Real], natural_frequency: float, period: float
    ) -> Real:
        """Noise gain of every feasible cell at one ω₀; all cells share one set of
        frequencies.
        """
        w, weights = noise_points(self.bare, natural_frequency, period)
        # The filter's lag differs from cell to cell and is multiplied with Ĉ below:
        # here it would count twice.
        rest = replace(self.bare, filter_time=0.0)(w, natural_frequency)
        found, n = np.full(cells[1].shape, np.nan), self.bare.filter_order
        for row in range(len(found)):
            good = np.isfinite(cells[1][row])
            gain, order, time = (v[row, good][:, None] for v in cells)
            outer = (
                gain
                * np.exp(order * (np.log(w) + 0.5j * math.pi))
                / (1.0 + 1j * time * w) ** n
            )
            found[row, good] = np.sqrt(
                np.sum(np.abs(outer / (1.0 + outer * rest)) ** 2 * weights, axis=1)
            )
        return found
