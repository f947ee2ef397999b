"""The map of what can be asked for: crossover against phase margin, with noise and settling."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._design.measure import noise_points
from fraclink._design.procedure import specification
from fraclink._design.request import check_arm, check_request, checked_axis
from fraclink._design.solve import MARGIN_SHARE, Specification
from fraclink._validate import checked_between, checked_whole
from fraclink.errors import SizeError

if TYPE_CHECKING:
    from fraclink._arm.link import LinkModel
    from fraclink._arm.rig import Rig

__all__ = ["FeasibilityMap", "feasibility_map"]

Real = NDArray[np.float64]
_POINTS = 320  # trial values of ω̄_c; a root is then closed in on by secant steps
_CELLS = 1_000_000


@dataclass(frozen=True)
class FeasibilityMap:
    """Arrays of shape (len(phase_margin), len(gain_crossover)); NaN where no admissible controller exists.

    ``gain`` k_d, ``order`` β, ``upper`` ω̄_c [rad/s], ``filter_time`` δ [s], ``settling_time`` 2π/ω_c [s] and
    ``noise_gain`` at the lightest payload.
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


def _axis(field: str, values: ArrayLike, unit: str) -> Real:
    axis = checked_axis(field, values)
    for value in axis:
        checked_between(field, float(value), 0.0, 1e6, unit, open_low=True)
    return axis


def feasibility_map(
    model: LinkModel,
    rig: Rig,
    *,
    gain_crossovers: ArrayLike,
    phase_margins: ArrayLike,
    payloads: tuple[float, float] | None = None,
    natural_frequencies: tuple[float, float] | None = None,
    margins: str = "loop",
    filter_time: float | None = None,
    filter_order: int = 1,
    inner: str = "ideal",
    placement: str = "tustin",
) -> FeasibilityMap:
    """Solve the closed procedure for every pair of crossover [rad/s] and phase margin [rad] at once.

    The options are those of `design`, with one n for the whole map. Each cell satisfies (54), (55) and the
    exact condition of Theorem 1, and keeps the margin where |L| rises through one, too, at both ends of the
    range.

    Raises FieldError, or SizeError beyond a million cells.

    >>> import fraclink as fl
    >>> from fraclink._design.feasibility import feasibility_map
    >>> rig = fl.Rig.named("paper-2023")
    >>> axes = {"gain_crossovers": [9.0, 12.0], "phase_margins": [fl.deg(50)]}
    >>> found = feasibility_map(rig.model, rig, **axes, filter_time=0.0)
    >>> found.feasible.tolist(), round(float(found.order[0, 1]), 4)
    ([[False, True]], 0.6122)
    """
    check_arm(model, rig)
    checked_whole("filter_order", filter_order, 1, 2)
    crossovers = _axis("gain_crossovers", gain_crossovers, "rad/s")
    angles = _axis("phase_margins", phase_margins, "rad")
    if crossovers.size * angles.size > _CELLS:
        raise SizeError(
            "gain_crossovers",
            crossovers.size * angles.size,
            "too many cells",
            allowed=f"at most {_CELLS}",
            remedy="take fewer values",
        )
    request = check_request(
        model,
        rig,
        payloads=payloads,
        natural_frequencies=natural_frequencies,
        gain_crossover=float(crossovers.min()),
        phase_margin=float(angles.max()),
        margins=margins,
        filter_time=filter_time,
        filter_order=filter_order,
        inner=inner,
        placement=placement,
    )
    spec = specification(request, filter_order)
    shape = (angles.size, crossovers.size)
    order, upper, time = (np.full(shape, np.nan) for _ in range(3))
    chi = np.full(shape, np.nan)
    for row, angle in enumerate(angles):
        solved = _row(replace(spec, phase_margin=float(angle)), crossovers, request.model.order)
        order[row], upper[row], time[row], chi[row] = solved
    gain = chi / crossovers**order
    cells = _Cells(spec, gain, order, time)
    kept = np.minimum(cells.rising(spec.low, crossovers), cells.rising(spec.high, upper)) >= angles[:, None]
    order, upper, time, gain = (np.where(kept, v, np.nan) for v in (order, upper, time, gain))
    settling = np.where(np.isfinite(order), 2.0 * math.pi / crossovers, np.nan)
    noise = _noise(spec, gain, order, time, request.period)
    return FeasibilityMap(crossovers, angles, gain, order, upper, time, settling, noise)


@dataclass(frozen=True)
class _Cells:
    """The loops of all cells; NaN where a cell is infeasible."""

    spec: Specification
    gain: Real
    order: Real
    time: Real

    def log(self, frequency: Real, natural_frequency: float) -> NDArray[np.complex128]:
        """ln L of every cell at its own frequency [rad/s]."""
        value = self.spec.bare.log(frequency, natural_frequency) + np.log(self.gain)
        value = value + self.order * (np.log(frequency) + 0.5j * math.pi)
        if self.spec.rule:
            value = value - self.spec.bare.filter_order * np.log(1.0 + 1j * self.time * frequency)
        return np.asarray(value)

    def rising(self, natural_frequency: float, falling: Real) -> Real:
        """Phase margin where |L| rises through one, below the `falling` crossing [rad/s]; NaN where NaN.

        The phase there is positive, so the margin is what is left to π.
        """
        peak = np.broadcast_to(self.spec.bare.peak(natural_frequency), self.order.shape)
        with np.errstate(invalid="ignore", over="ignore"):
            above = np.log(falling * np.ones(self.order.shape)) - 1e-6
            peaked = self.log(peak, natural_frequency).real > 0.0
            high = np.where(peaked, np.minimum(np.log(peak), above), above)
            # Below the resonance |G| is at most its value at the peak: |L| < 1 there for certain.
            loudest = self.spec.bare.level(peak, natural_frequency)
            low = np.minimum(-(np.log(self.gain) + np.maximum(loudest, 0.0)) / self.order, high) - 1.0
            low = np.maximum(low, -300.0)
            for _ in range(50):
                middle = 0.5 * (low + high)
                loud = self.log(np.exp(middle), natural_frequency).real > 0.0
                low, high = np.where(loud, low, middle), np.where(loud, middle, high)
            return np.asarray(math.pi - np.abs(self.log(np.exp(high), natural_frequency).imag))


def _row(spec: Specification, crossovers: Real, link_order: float) -> tuple[Real, Real, Real, Real]:
    """(β, ω̄_c, δ, χ) for one margin and every crossover: the lowest admissible root of each."""
    top = min(spec.highest, 50.0 * float(crossovers.max()) * (spec.high / spec.low) ** 2)
    grid = np.geomspace(0.9 * float(crossovers.min()), top, _POINTS)
    residual, beta, _, _ = _terms(spec, grid[None, :], crossovers[:, None])
    inside = (grid[None, :] >= 0.9 * crossovers[:, None]) & (beta > 0.0) & (beta < min(link_order, 2.0))
    change = (residual[:, :-1] > 0.0) & (residual[:, 1:] <= 0.0) & inside[:, :-1]
    # |L| falls through one: the residual goes from plus to minus, which is the exact condition at ω̄_c.
    found = change.any(axis=1)
    at = np.argmax(change, axis=1)
    low, high = grid[at], grid[at + 1]
    for _ in range(40):
        middle = np.sqrt(low * high)
        positive = _terms(spec, middle, crossovers)[0] > 0.0
        low, high = np.where(positive, middle, low), np.where(positive, high, middle)
    upper = np.sqrt(low * high)
    _, beta, chi, time = _terms(spec, upper, crossovers)
    at_low = spec.bare.slope(crossovers, spec.low).real + beta - _filter_slope(spec, time, crossovers)
    good = found & (at_low < 0.0) & (beta > 0.0) & (beta < min(link_order, 2.0))
    return tuple(np.where(good, v, np.nan) for v in (beta, upper, time, chi))  # type: ignore[return-value]


def _terms(spec: Specification, upper: Real, crossovers: Real) -> tuple[Real, Real, Real, Real]:
    """(residual of (55), β, χ, δ) at trial values of ω̄_c; the arguments broadcast."""
    n = spec.bare.filter_order
    at_low, at_high = spec.bare.log(crossovers, spec.low), spec.bare.log(upper, spec.high)
    time = np.full(np.shape(upper), spec.bare.filter_time)
    if spec.rule:
        time = math.tan(MARGIN_SHARE * spec.phase_margin / n) / upper
        at_low = at_low - n * np.log(1.0 + 1j * time * crossovers)
        at_high = at_high - n * np.log(1.0 + 1j * time * upper)
    beta = 2.0 / math.pi * (spec.phase_margin - math.pi - at_high.imag)
    residual = -at_low.real + beta * np.log(upper / crossovers) + at_high.real
    return residual, beta, np.exp(-at_low.real), np.asarray(time)


def _filter_slope(spec: Specification, time: Real, frequency: Real) -> Real:
    if not spec.rule:
        return np.zeros(np.shape(frequency))
    square = (time * frequency) ** 2
    return np.asarray(spec.bare.filter_order * square / (1.0 + square))


def _noise(spec: Specification, gain: Real, order: Real, time: Real, period: float) -> Real:
    """Noise gain of every feasible cell at the lightest payload; all cells share one set of frequencies."""
    w, weights = noise_points(spec.bare, spec.high, period)
    rest = np.exp(replace(spec.bare, filter_time=0.0).log(w, spec.high))
    noise = np.full(order.shape, np.nan)
    n = spec.bare.filter_order
    for row in range(order.shape[0]):
        good = np.isfinite(order[row])
        k, beta, delta = (v[row, good][:, None] for v in (gain, order, time))
        outer = k * np.exp(beta * (np.log(w) + 0.5j * math.pi)) / (1.0 + 1j * delta * w) ** n
        noise[row, good] = np.sqrt(np.sum(np.abs(outer / (1.0 + outer * rest)) ** 2 * weights, axis=1))
    return noise
