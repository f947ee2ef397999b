"""What else could be asked for, and what else could be built: the feasibility map,
rivals at one Ms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop, noise_points
from fraclink._arm.rig import Rig
from fraclink._design.assess import PRINTED, axis_of, match_at
from fraclink._design.equations import equation, task_of
from fraclink._law.design import Design, Specification
from fraclink._systems.sweep import bracketed_roots
from fraclink._validate import Between, Frequency, PhaseMargin, checked
from fraclink._validate.display import displayed
from fraclink._validate.equality import compared
from fraclink.errors import InfeasibleError, SizeError

__all__ = [
    "Alternative",
    "FeasibilityMap",
    "compare_at_equal_sensitivity",
    "feasibility_map",
    "scale_to_sensitivity",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
PeakBound = Annotated[float, Between(1.0, 100.0, low_open=True)]
# Ms and noise are smooth over ω₀; nine links, as for the requirements of a design, so
# that two figures of one controller agree.
_PAYLOADS = 9
_POINTS = (
    320  # trial values of ω̄_c of a map; a root is then closed in on by secant steps
)
_CELLS = 1_000_000
# [rad] of ln ω: below the falling crossing, so that it is not taken for the rising one
_MARGINAL = 1e-6


# ---- the same distance from -1 for all --------------------------------------------------------------------


@dataclass(frozen=True)
class Alternative:
    """A controller and its worst values over the payload range of a design, on the loop
    that runs.
    """

    name: str
    controller: Controller
    stable: bool
    sensitivity_peak: float
    gain_crossover: float  # smallest upper crossover [rad/s]
    phase_margin: float  # smallest [rad]
    noise_gain: float
    settling_time: float  # 2π/gain_crossover [s]


def compare_at_equal_sensitivity(
    design: Design, *, max_sensitivity: float
) -> tuple[Alternative, ...]:
    """Rate C, C', PD and the best β at one worst Ms, and the paper's printed
    controllers as they are.

    C' has the order of the integer-model design matched to the design at the nominal
    payload (eq. (42) with λ = 2); PD is β = 1. Each gets the largest gain that the
    bound on Ms allows, with the design's own filter. For matched designs the published
    advantage of the fractional model vanishes; this shows by how much.
    """
    own = design.controller
    w0 = design.natural_frequency(design.rig.payloads.nominal)
    found = design.ideal_loop.crossings(w0)
    upper = int(np.argmax(found.frequency))
    crossover = float(found.frequency[upper])
    # The angle itself, 0 to 360°: a margin above 180° must not come as a negative one,
    # which asks for another β.
    margin = float(np.remainder(found.phase_margin[upper], 2.0 * math.pi))
    matched = match_at(
        replace(design.model, order=2.0, damping=0.0), w0, crossover, margin
    )
    entries = [
        ("C, fractional model", own.order),
        ("C', integer model", matched.order),
        ("PD", 1.0),
    ]
    rivals = []
    for name, order in entries:
        # From the same |Ĉ| at the crossover: the factor on the gain that is then sought
        # lies between 0.01 and 100.
        start = _start(own, order, crossover)
        rivals.append(
            _rate(design, name, scale_to_sensitivity(design, start, max_sensitivity))
        )
    rivals.append(_best_order(design, max_sensitivity))
    rivals += [
        _rate(design, f"printed {name}", printed) for name, printed in PRINTED.items()
    ]
    return tuple(rivals)


def _loop_of(design: Design, controller: Controller) -> Loop:
    """The design's loop with another controller."""
    return design.full_loop.with_controller(controller)


def _rate(design: Design, name: str, controller: Controller) -> Alternative:
    w0 = np.geomspace(*design.natural_frequencies, _PAYLOADS)
    got = _loop_of(design, controller).achieved(w0, design.rig.period)
    stable = bool(np.all(got.phase_margin > 0.0))
    slowest = float(np.min(got.gain_crossover))
    return Alternative(
        name=name,
        controller=controller,
        stable=stable,
        sensitivity_peak=float(np.max(got.sensitivity_peak)),
        gain_crossover=slowest,
        phase_margin=float(np.min(got.phase_margin)),
        # Of an unstable loop the integral is finite, and says nothing: no stationary
        # noise exists there.
        noise_gain=float(np.max(got.noise_gain)) if stable else math.inf,
        settling_time=2.0 * math.pi / slowest if slowest else math.inf,
    )


@checked
def scale_to_sensitivity(
    design: Design, controller: Controller, max_sensitivity: PeakBound
) -> Controller:
    """Return the controller with the largest gain whose worst Ms over the payloads is
    `max_sensitivity` > 1.

    Raises InfeasibleError where no gain reaches it.
    """
    bound = max_sensitivity
    loop, w0 = (
        _loop_of(design, controller),
        np.geomspace(*design.natural_frequencies, _PAYLOADS),
    )
    # Steps of 4 %: Ms need not grow with the gain, so that the root is sought beside
    # the last one that keeps it.
    ratios = np.geomspace(1e-2, 1e2, 240)
    kept = _rough_peaks(loop, w0, ratios) <= bound
    if not kept.any():
        raise InfeasibleError(
            "sensitivity peak",
            f"no gain brings Ms to {bound:g} with β = {controller.order:g}",
        )

    def excess(ratio: float) -> float:
        return (
            float(np.max(replace(loop, gain=ratio * loop.gain).sensitivity_peak(w0)))
            - bound
        )

    last = int(np.nonzero(kept)[0][-1])
    # A step to either side: the grid's peaks are a per cent low, and the true one may
    # already exceed the bound at the last that kept it.
    good, bad = (
        float(ratios[max(last - 1, 0)]),
        float(ratios[min(last + 1, ratios.size - 1)]),
    )
    if excess(bad) > 0.0:
        good = float(brentq(excess, good, bad, xtol=1e-11 * good, rtol=1e-11))
    return replace(controller, gain=good * controller.gain)


def _rough_peaks(loop: Loop, w0: Real, ratios: Real) -> Real:
    """Worst Ms for each factor on the gain, on a grid; infinite from the first factor
    that is unstable on.

    L is linear in the gain and keeps its phase: -1 is passed where |L| at the phase
    crossing reaches one.
    """
    w = np.minimum(loop.peak(w0)[:, None] * np.geomspace(0.2, 60.0, 400), loop.highest)
    log = loop.log(w, w0[:, None])
    value, beyond = np.exp(log), log.imag <= -math.pi
    # The initial value stands for a phase that never reaches −180°: no gain makes that
    # loop unstable.
    crossing = float(np.max(np.abs(value), where=beyond, initial=1e-300))
    peaks = np.array([float(np.max(1.0 / np.abs(1.0 + r * value))) for r in ratios])
    return np.where(ratios * crossing < 1.0, peaks, math.inf)


def _start(own: Controller, order: float, frequency: float) -> Controller:
    """The design's controller with another β and the same gain at `frequency` [rad/s]."""
    # As `design` chooses n: a single pole behind s^β, β >= 1, leaves Ĉ and its noise
    # rising (32).
    n = max(own.filter_order, 2 if order >= 1.0 and own.filter_time else 1)
    return replace(
        own,
        order=order,
        gain=own.gain * frequency ** (own.order - order),
        filter_order=n,
    )


def _best_order(design: Design, max_sensitivity: float) -> Alternative:
    """The β, with the design's own filter, that crosses highest for the worst payload
    at this Ms.
    """
    best: Alternative | None = None
    # Three rounds of seven, each a third as wide: β to 0.013 with 21 fits, where its
    # crossover is flat.
    centre, width = design.controller.order, 0.35
    for _ in range(3):
        for order in map(float, centre + width * np.linspace(-1.0, 1.0, 7)):
            # Theorem 1 needs β < λ, and β → 0 is a constant Ĉ, whose C(0) is not 1.
            if not 0.05 < order < min(design.model.order, 1.95):
                continue
            start = _start(design.controller, order, design.gain_crossover_upper)
            try:
                rival = _rate(
                    design,
                    "best β",
                    scale_to_sensitivity(design, start, max_sensitivity),
                )
            except InfeasibleError:
                continue
            if best is None or rival.gain_crossover > best.gain_crossover:
                best = rival
        centre = best.controller.order if best is not None else centre
        width /= 3.0
    if best is None:
        raise InfeasibleError(
            "sensitivity peak", f"no order β brings Ms to {max_sensitivity:g}"
        )
    return best


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
