"""What a user asks of a finished design: where the phase goes, how margins move, what it tolerates.

Also the map of what can be asked for, the comparison at one distance from -1, and the closed-loop poles.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop, noise_points
from fraclink._arm.rig import Rig
from fraclink._design.bounds import MODE_LIMIT, higher_modes, mode_requirements
from fraclink._design.procedure import equation, task_of
from fraclink._design.specification import Design, Requirement, Specification
from fraclink._systems.brackets import bracketed_roots
from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._validate import (
    Between,
    Payload,
    checked_between,
    checked_choice,
    checked_noun,
    checked_series,
    checked_whole,
)
from fraclink.errors import FieldError, InfeasibleError, SizeError

__all__ = [
    "PRINTED",
    "FeasibilityMap",
    "MarginCurve",
    "PhaseShare",
    "Rival",
    "Tolerances",
    "VibrationMode",
    "closed_loop",
    "closed_loop_poles",
    "compare_at_equal_sensitivity",
    "feasibility_map",
    "margin_curve",
    "match_at",
    "matched_in",
    "mode_gains",
    "phase_budget",
    "scale_to_sensitivity",
    "spillover",
    "tolerances",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

# (58) from the fractional model and (59) from the integer one, as section 7.1 prints them.
PRINTED: dict[str, Controller] = {
    "(58)": Controller(gain=0.148, order=0.65, filter_time=0.16, filter_order=2),
    "(59)": Controller(gain=0.241, order=0.65, filter_time=0.16, filter_order=2),
}
_PAYLOADS = 9
_POINTS = 320  # trial values of ω̄_c of a map; a root is then closed in on by secant steps
_CELLS = 1_000_000
_MARGINAL = 1e-6  # [rad] of ln ω: below the falling crossing, so that it is not taken for the rising one


# ---- one design -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PhaseShare:
    """The phase [rad] that one element gives at the gain crossover; negative is lag."""

    element: str
    phase: float


def phase_budget(design: Design, payload: float) -> tuple[PhaseShare, ...]:
    """Return what each element of the loop gives at the upper gain crossover, at `payload` [kg] > 0.

    The shares and the 180° of feedback add up to the phase margin of the loop with everything inside.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.0}
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), **wanted)
    >>> shares = phase_budget(design, 0.020)
    >>> print(f"{sum(share.phase for share in shares) + 3.141592653589793:.4f}")
    0.8727
    """
    loop = _checked(design).full_loop
    w0 = design.natural_frequency(payload)
    crossings = loop.crossings(w0).frequency
    if crossings.size == 0:
        allowed, remedy = "a payload at which |L| crosses one", "give the mass in kg"
        raise FieldError("payload", payload, "without a gain crossover", allowed=allowed, remedy=remedy)
    w = float(np.max(crossings))
    hold = 0.5 * design.rig.period
    tip = float(replace(loop, gauge_delay=0.0, gauge_gain=1.0, second_mode=None).link_log(w, w0).imag)
    gauge = float(loop.link_log(w, w0).imag) - tip
    return (
        PhaseShare("link", tip),
        *(() if loop.exact_gauge else (PhaseShare("gauge and second mode", gauge),)),
        PhaseShare("derivative", 0.5 * math.pi * loop.order),
        PhaseShare("filter", -loop.filter_order * math.atan(loop.filter_time * w)),
        PhaseShare("motor loop", float(loop.motor_log(w).imag) + loop.delay * w),
        PhaseShare("hold", -hold * w),
        PhaseShare("computation delay", -(loop.delay - hold) * w),
    )


def _checked(design: Design) -> Design:
    return checked_noun("design", design, Design, remedy="fl.design makes one")


@dataclass(frozen=True)
class MarginCurve:
    """Margins against payload (Fig. 10): arrays of shape (N,) in kg, rad/s, rad and 1.

    ``phase_margin`` is the smallest over all gain crossings, below zero where the loop is unstable.
    """

    kind: str
    payload: Real
    gain_crossover: Real
    phase_margin: Real
    modulus_margin: Real


def margin_curve(design: Design, payloads: ArrayLike, *, kind: str = "loop") -> MarginCurve:
    """Return the margins of a design against payload (Fig. 10).

    Parameters
    ----------
    design
        the design.
    payloads
        masses at the tip [kg], > 0, shape (N,).
    kind
        "ideal" (the paper's L), "motor" (its LM, with M(s) and the filter), "loop" (hold and delay too) or
        "sampled" (the law that is shipped, in the exactly sampled loop).
    """
    whole, masses = _checked(design).full_loop, _axis("payloads", payloads, Payload)
    checked_choice("kind", kind, ("ideal", "motor", "loop", "sampled"), remedy="say 'loop'")
    if kind == "sampled":
        found = [design.sampled_at(float(m)) for m in masses]
        sign = np.where([bool(f.stable) for f in found], 1.0, -1.0)
        return MarginCurve(
            kind,
            masses,
            np.array([f.gain_crossover for f in found]),
            sign * np.array([abs(f.phase_margin) for f in found]),
            np.array([f.modulus_margin for f in found]),
        )
    loops = {
        "ideal": replace(design.ideal_loop, highest=whole.highest),
        "motor": replace(
            whole, delay=0.0, correction=None, gauge_delay=0.0, gauge_gain=1.0, second_mode=None
        ),
        "loop": whole,
    }
    w0 = np.array([design.natural_frequency(float(m)) for m in masses])
    got = loops[kind].achieved(w0, design.rig.period)
    return MarginCurve(kind, masses, got.gain_crossover, got.phase_margin, 1.0 / got.sensitivity_peak)


def _axis(field: str, values: ArrayLike, annotation: object) -> Real:
    """One number or a list of them as an array of shape (N,), N > 0, each in the range of its annotation."""
    single = isinstance(values, int | float | np.number) and not isinstance(values, bool)
    axis = checked_series(field, [values] if single else values, remedy="give one axis of numbers")
    if axis.size == 0:
        raise FieldError(field, 0, "without values", allowed="one or more", remedy="give numbers")
    (bounds,) = (item for item in getattr(annotation, "__metadata__", ()) if isinstance(item, Between))
    for value in axis:
        bounds.check(field, float(value))
    return axis


@dataclass(frozen=True)
class Tolerances:
    """How far one thing may be wrong before the loop is unstable at some payload of the design.

    ``delay`` [s] more than assumed; ``payload_low`` and ``payload_high`` [kg], the lightest and heaviest
    stable payload (0 and infinity where there is no limit within a factor of 49); ``stiffness_low`` and
    ``stiffness_high``, true over assumed stiffness; ``motor_pole`` [rad/s], the slowest motor loop.
    """

    delay: float
    payload_low: float
    payload_high: float
    stiffness_low: float
    stiffness_high: float
    motor_pole: float


def tolerances(design: Design) -> Tolerances:
    """Return how much delay, payload, stiffness and motor-pole error the loop that runs tolerates."""
    loop = _checked(design).full_loop
    low, high = design.natural_frequencies
    grid = np.geomspace(low, high, _PAYLOADS)
    found = loop.crossings(grid)
    falling = found.slope < 0.0
    delay = float(np.min(np.remainder(found.phase_margin[falling], 2 * math.pi) / found.frequency[falling]))

    def margin(changed: Loop, w0: Real | float) -> float:
        return float(np.min(changed.margins(w0)[1]))

    def stiff(ratio: float) -> float:
        # θte = θm − Γ/c with the assumed c: a stiffer link moves the mode and shows in the gauge as gain.
        changed = replace(loop, gauge_gain=ratio * loop.gauge_gain)
        return margin(changed, grid[[0, 4, 8]] * math.sqrt(ratio))

    light = _edge(lambda w0: margin(loop, w0), high, 7.0 * high)
    heavy = _edge(lambda w0: margin(loop, w0), low, low / 7.0)
    slow = None
    if loop.lag:
        slow = _edge(lambda p: margin(replace(loop, lag=1.0 / p), grid), 1.0 / loop.lag, 0.02 / loop.lag)
    soft, hard = _edge(stiff, 1.0, 0.05), _edge(stiff, 1.0, 20.0)
    return Tolerances(
        delay=delay,
        payload_low=design.payload(light) if light else 0.0,
        payload_high=design.payload(heavy) if heavy else math.inf,
        stiffness_low=soft or 0.0,
        stiffness_high=hard or math.inf,
        motor_pole=slow or 0.0,
    )


def _edge(margin: Callable[[float], float], start: float, end: float) -> float | None:
    """Where between `start` (stable) and `end` the signed margin first reaches zero; None where never."""
    from scipy.optimize import brentq

    steps = [float(x) for x in np.geomspace(start, end, 60)]
    for good, bad in itertools.pairwise(steps):
        if margin(bad) <= 0.0:
            return float(brentq(margin, good, bad, xtol=1e-12 * abs(start), rtol=1e-12))
    return None


@dataclass(frozen=True)
class VibrationMode:
    """A higher mode of a distributed link: ω_i [rad/s], damping ratio, static share in the tip estimate."""

    frequency: float
    damping_ratio: float
    share: float = 1.0


def spillover(
    design: Design, modes: Sequence[VibrationMode], *, limit: float = MODE_LIMIT
) -> tuple[Requirement, ...]:
    """Return the loop gain at each higher mode against `limit`: below one it cannot be destabilised by phase.

    A mode adds ``share/(1 - (ω/ω_i)² + 2jζω/ω_i)`` to the tip estimate, ``share/(2ζ)`` at its peak; the loop
    gain there is ``|Ĉ M| share/(2ζ)``.
    """
    loop = _checked(design).full_loop
    checked_between("limit", limit, 0.0, 1e3, "", open_low=True)
    found = []
    for number, mode in enumerate(modes, start=2):
        w = checked_between("mode.frequency", mode.frequency, 0.0, 1e6, "rad/s", open_low=True)
        zeta = checked_between("mode.damping_ratio", mode.damping_ratio, 0.0, 1.0, "", open_low=True)
        rest = math.exp(float((loop.outer_log(w) + loop.motor_log(w)).real))
        value = rest * abs(mode.share) / (2.0 * zeta)
        found.append(Requirement.at_most(f"loop gain at mode {number}", limit, value, "", design.payloads[0]))
    return tuple(found)


def mode_gains(
    design: Design, *, limit: float = MODE_LIMIT, damping_ratio: float | None = None
) -> tuple[Requirement, ...]:
    """Return the loop gain at the link's higher modes against `limit`; empty where none is known.

    Below one a mode cannot be destabilised, whatever its phase. The modes are those of the rig's link mass
    (``[link] mass_kg``), with the model's damping unless `damping_ratio` is given, and the second mode that
    was identified.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> rig = replace(rig, link=replace(rig.link, mass=0.00735))
    >>> design = fl.design(rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50))
    >>> second, third = mode_gains(design)
    >>> second.passed, 1.3 < second.achieved < 1.6
    (False, True)
    """
    checked_limit = checked_between("limit", limit, 0.0, 1e3, open_low=True)
    loop = _checked(design).full_loop
    modes = higher_modes(design.model, design.rig, loop, design.payloads, damping_ratio=damping_ratio)
    return () if modes is None else tuple(item for _, item in mode_requirements(modes, loop, checked_limit))


# ---- poles ------------------------------------------------------------------------------------------------


def closed_loop(
    controller: Controller, link: LinkModel, *, inner_pole: float | None = None
) -> FractionalTransferFunction:
    """Return ``T = L/(1 + L)``, ``L = Ĉ M G`` (eq. (25)); M = 1 without `inner_pole` [rad/s].

    Hold and delay are left out: with them the loop has infinitely many poles.
    """
    from fraclink._systems.fractional import s

    open_loop = controller.correction() * link.tip()
    if inner_pole is not None:
        open_loop = open_loop / (1.0 + s / inner_pole) ** 2
    return open_loop.feedback()


def closed_loop_poles(controller: Controller, link: LinkModel, *, inner_pole: float | None = None) -> Complex:
    """Return the poles of the closed loop on the principal sheet, rightmost first [rad/s].

    Examples
    --------
    The paper's controller (58) on the paper's link at 30 g, with its motor loop, is unstable:

    >>> link = LinkModel(stiffness=1.56, natural_frequency=11.547, order=1.92)
    >>> pole = closed_loop_poles(PRINTED["(58)"], link, inner_pole=80.0)[0]
    >>> print(f"{pole.real:+.3f} ± {abs(pole.imag):.2f}j")
    +0.106 ± 12.89j
    """
    from fraclink._systems.stability import poles

    found = poles(closed_loop(controller, link, inner_pole=inner_pole))
    return np.asarray(found[np.argsort(-found.real)], dtype=np.complex128)


def match_at(
    model: LinkModel, natural_frequency: float, gain_crossover: float, phase_margin: float
) -> Controller:
    """Return the unfiltered controller that has this crossover and margin at one ω₀ (eq. (42)): C'.

    One complex equation in k_d and β; `gain_crossover` [rad/s], `phase_margin` [rad].

    >>> link = LinkModel(stiffness=1.56, natural_frequency=11.54, order=2.0)
    >>> matched = match_at(link, 11.54, 20.865280, 1.2346783)
    >>> print(f"{matched.order:.6f} {matched.gain:.6f}")
    0.786021 0.208339
    """
    return matched_in(Loop.ideal(model), natural_frequency, gain_crossover, phase_margin)


def matched_in(
    beside: Loop, natural_frequency: float, gain_crossover: float, phase_margin: float
) -> Controller:
    """Return the same for any loop without its Ĉ: what stands beside k_d s^β."""
    value = complex(beside.log(gain_crossover, natural_frequency))
    order = 2.0 / math.pi * (phase_margin - math.pi - value.imag)
    return Controller(gain=math.exp(-value.real) / gain_crossover**order, order=order)


# ---- the same distance from -1 for all --------------------------------------------------------------------


@dataclass(frozen=True)
class Rival:
    """A controller and its worst values over the payload range of a design, on the loop that runs."""

    name: str
    controller: Controller
    stable: bool
    sensitivity_peak: float
    gain_crossover: float  # smallest upper crossover [rad/s]
    phase_margin: float  # smallest [rad]
    noise_gain: float
    settling_time: float  # 2π/gain_crossover [s]


def compare_at_equal_sensitivity(design: Design, *, max_sensitivity: float) -> tuple[Rival, ...]:
    """Rate C, C', PD and the best β at one worst Ms, and the paper's printed controllers as they are.

    C' has the order of the integer-model design matched to the design at the nominal payload (eq. (42) with
    λ = 2); PD is β = 1. Each gets the largest gain that the bound on Ms allows, with the design's own filter.
    For matched designs the published advantage of the fractional model vanishes; this shows by how much.
    """
    own = design.controller
    w0 = design.natural_frequency(design.rig.payloads.nominal)
    found = design.ideal_loop.crossings(w0)
    upper = int(np.argmax(found.frequency))
    crossover = float(found.frequency[upper])
    margin = float(np.remainder(found.phase_margin[upper], 2.0 * math.pi))
    matched = match_at(replace(design.model, order=2.0, damping=0.0), w0, crossover, margin)
    entries = [("C, fractional model", own.order), ("C', integer model", matched.order), ("PD", 1.0)]
    rivals = []
    for name, order in entries:
        start = _start(own, order, crossover)
        rivals.append(_rate(design, name, scale_to_sensitivity(design, start, max_sensitivity)))
    rivals.append(_best_order(design, max_sensitivity))
    rivals += [_rate(design, f"printed {name}", printed) for name, printed in PRINTED.items()]
    return tuple(rivals)


def _loop_of(design: Design, controller: Controller) -> Loop:
    """The design's loop with another controller."""
    return design.full_loop.with_controller(controller)


def _rate(design: Design, name: str, controller: Controller) -> Rival:
    w0 = np.geomspace(*design.natural_frequencies, _PAYLOADS)
    got = _loop_of(design, controller).achieved(w0, design.rig.period)
    stable = bool(np.all(got.phase_margin > 0.0))
    slowest = float(np.min(got.gain_crossover))
    return Rival(
        name=name,
        controller=controller,
        stable=stable,
        sensitivity_peak=float(np.max(got.sensitivity_peak)),
        gain_crossover=slowest,
        phase_margin=float(np.min(got.phase_margin)),
        noise_gain=float(np.max(got.noise_gain)) if stable else math.inf,
        settling_time=2.0 * math.pi / slowest if slowest else math.inf,
    )


def scale_to_sensitivity(design: Design, controller: Controller, max_sensitivity: float) -> Controller:
    """Return the controller with the largest gain whose worst Ms over the payloads is `max_sensitivity` > 1.

    Raises InfeasibleError where no gain reaches it.
    """
    from scipy.optimize import brentq

    bound = checked_between("max_sensitivity", max_sensitivity, 1.0, 100.0, "", open_low=True)
    loop, w0 = _loop_of(design, controller), np.geomspace(*design.natural_frequencies, _PAYLOADS)
    ratios = np.geomspace(1e-2, 1e2, 240)
    kept = _rough_peaks(loop, w0, ratios) <= bound
    if not kept.any():
        raise InfeasibleError(
            "sensitivity peak", f"no gain brings Ms to {bound:g} with β = {controller.order:g}"
        )

    def excess(ratio: float) -> float:
        return float(np.max(replace(loop, gain=ratio * loop.gain).sensitivity_peak(w0))) - bound

    last = int(np.nonzero(kept)[0][-1])
    good, bad = float(ratios[max(last - 1, 0)]), float(ratios[min(last + 1, ratios.size - 1)])
    if excess(bad) > 0.0:
        good = float(brentq(excess, good, bad, xtol=1e-11 * good, rtol=1e-11))
    return replace(controller, gain=good * controller.gain)


def _rough_peaks(loop: Loop, w0: Real, ratios: Real) -> Real:
    """Worst Ms for each factor on the gain, on a grid; infinite from the first factor that is unstable on.

    L is linear in the gain and keeps its phase: -1 is passed where |L| at the phase crossing reaches one.
    """
    w = np.minimum(loop.peak(w0)[:, None] * np.geomspace(0.2, 60.0, 400), loop.highest)
    log = loop.log(w, w0[:, None])
    value, beyond = np.exp(log), log.imag <= -math.pi
    crossing = float(np.max(np.abs(value), where=beyond, initial=1e-300))
    peaks = np.array([float(np.max(1.0 / np.abs(1.0 + r * value))) for r in ratios])
    return np.where(ratios * crossing < 1.0, peaks, math.inf)


def _start(own: Controller, order: float, frequency: float) -> Controller:
    """The design's controller with another β and the same gain at `frequency` [rad/s]."""
    n = max(own.filter_order, 2 if order >= 1.0 and own.filter_time else 1)
    return replace(own, order=order, gain=own.gain * frequency ** (own.order - order), filter_order=n)


def _best_order(design: Design, max_sensitivity: float) -> Rival:
    """The β, with the design's own filter, that crosses highest for the worst payload at this Ms."""
    best: Rival | None = None
    centre, width = design.controller.order, 0.35
    for _ in range(3):
        for order in map(float, centre + width * np.linspace(-1.0, 1.0, 7)):
            if not 0.05 < order < min(design.model.order, 1.95):
                continue
            start = _start(design.controller, order, design.gain_crossover_upper)
            try:
                rival = _rate(design, "best β", scale_to_sensitivity(design, start, max_sensitivity))
            except InfeasibleError:
                continue
            if best is None or rival.gain_crossover > best.gain_crossover:
                best = rival
        centre = best.controller.order if best is not None else centre
        width /= 3.0
    if best is None:
        raise InfeasibleError("sensitivity peak", f"no order β brings Ms to {max_sensitivity:g}")
    return best


# ---- the map of what can be asked for ---------------------------------------------------------------------


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


def feasibility_map(
    model: LinkModel,
    rig: Rig,
    *,
    gain_crossovers: ArrayLike,
    phase_margins: ArrayLike,
    filter_order: int = 1,
    payloads: tuple[float, float] | None = None,
    natural_frequencies: tuple[float, float] | None = None,
    margins: str = "loop",
    filter_time: float | None = None,
    inner: str = "ideal",
    placement: str = "tustin",
) -> FeasibilityMap:
    """Solve the closed procedure for every pair of crossover [rad/s] and phase margin [rad] at once.

    The options are those of `design`, with one n for the whole map. Each cell satisfies (54), (55) and the
    exact condition of Theorem 1, and keeps the margin where |L| rises through one, too, at both ends of the
    range.

    Raises FieldError, or SizeError beyond a million cells.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> axes = {"gain_crossovers": [9.0, 12.0], "phase_margins": [fl.deg(50)]}
    >>> found = feasibility_map(rig.model, rig, **axes, filter_time=0.0)
    >>> found.feasible.tolist(), round(float(found.order[0, 1]), 4)
    ([[False, True]], 0.6122)
    """
    checked_noun("model", model, LinkModel, remedy="fit.model, or rig.model")
    checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")
    checked_whole("filter_order", filter_order, 1, 2)
    crossovers = _axis("gain_crossovers", gain_crossovers, Payload)
    angles = _axis("phase_margins", phase_margins, Payload)
    if crossovers.size * angles.size > _CELLS:
        cells = crossovers.size * angles.size
        allowed, remedy = f"at most {_CELLS}", "take fewer values"
        raise SizeError("gain_crossovers", cells, "too many cells", allowed=allowed, remedy=remedy)
    spec = Specification(
        gain_crossover=float(crossovers.min()),
        phase_margin=float(angles.max()),
        filter_order=filter_order,
        payloads=payloads,
        natural_frequencies=natural_frequencies,
        margins=margins,  # type: ignore[arg-type]  # checked by Specification
        filter_time=filter_time,
        inner=inner,  # type: ignore[arg-type]
        placement=placement,  # type: ignore[arg-type]
    )
    task = task_of(model, rig, spec)
    cells = _Cells(task.bare(filter_order), (task.low, task.high), task.inside and filter_time is None)
    rows = [cells.row(crossovers, float(angle)) for angle in angles]
    order, upper, time, chi = (np.array(column) for column in zip(*rows, strict=True))
    gain = chi / crossovers**order
    rising = [
        cells.rising((gain, order, time), w0, falling)
        for w0, falling in ((task.low, np.broadcast_to(crossovers, order.shape)), (task.high, upper))
    ]
    kept = np.minimum(*rising) >= angles[:, None]
    order, upper, time, gain = (np.where(kept, v, np.nan) for v in (order, upper, time, gain))
    settling = np.where(np.isfinite(order), 2.0 * math.pi / crossovers, np.nan)
    noise = cells.noise((gain, order, time), task.high, rig.period)
    return FeasibilityMap(crossovers, angles, gain, order, upper, time, settling, noise)


@dataclass(frozen=True)
class _Cells:
    """The equations of a map: the loop beside Ĉ, the ends of the range, whether the filter is the rule's."""

    bare: Loop
    ends: tuple[float, float]
    rule: bool

    def row(self, crossovers: Real, margin: float) -> tuple[Real, Real, Real, Real]:
        """(β, ω̄_c, δ, χ) for one margin and every crossover: the lowest admissible root of each."""
        low, high = self.ends
        limit = min(self.bare.link_order, 2.0)

        def terms(upper: Real, crossover: Real) -> tuple[Real, Real, Real, Real]:
            return equation(self.bare, self.ends, upper, crossover, margin, rule=self.rule)

        top = min(self.bare.highest, 50.0 * float(crossovers.max()) * (high / low) ** 2)
        grid = np.geomspace(0.9 * float(crossovers.min()), top, _POINTS)
        residual, beta, _, _ = terms(grid[None, :], crossovers[:, None])
        inside = (grid[None, :] >= 0.9 * crossovers[:, None]) & (beta > 0.0) & (beta < limit)
        # |L| falls through one: the residual goes from plus to minus, which is the exact condition at ω̄_c.
        change = (residual[:, :-1] > 0.0) & (residual[:, 1:] <= 0.0) & inside[:, :-1]
        at = np.argmax(change, axis=1)
        upper = bracketed_roots(lambda x: terms(x, crossovers)[0], grid[at], grid[at + 1])
        _, beta, chi, time = terms(upper, crossovers)
        slope = self.bare.slope(crossovers, low).real + beta
        if self.rule:
            square = (time * crossovers) ** 2
            slope = slope - self.bare.filter_order * square / (1.0 + square)
        good = change.any(axis=1) & (slope < 0.0) & (beta > 0.0) & (beta < limit)
        order, place, delta, level = (np.where(good, v, np.nan) for v in (beta, upper, time, np.exp(chi)))
        return order, place, delta, level

    def _log(self, cells: tuple[Real, Real, Real], frequency: Real, natural_frequency: float) -> Complex:
        """ln L of every cell at its own frequency [rad/s]."""
        gain, order, time = cells
        value = self.bare.log(frequency, natural_frequency) + np.log(gain)
        value = value + order * (np.log(frequency) + 0.5j * math.pi)
        if self.rule:
            value = value - self.bare.filter_order * np.log(1.0 + 1j * time * frequency)
        return np.asarray(value)

    def rising(self, cells: tuple[Real, Real, Real], natural_frequency: float, falling: Real) -> Real:
        """Phase margin where |L| rises through one, below the `falling` crossing [rad/s]; NaN where NaN.

        The phase there is positive, so the margin is what is left to π.
        """
        gain, order, _ = cells
        peak = np.broadcast_to(self.bare.peak(natural_frequency), order.shape)
        with np.errstate(invalid="ignore", over="ignore"):
            above = np.log(falling) - _MARGINAL
            peaked = self._log(cells, peak, natural_frequency).real > 0.0
            high = np.where(peaked, np.minimum(np.log(peak), above), above)
            # Below the resonance |G| is at most its value at the peak: |L| < 1 there for certain.
            loudest = self.bare.level(peak, natural_frequency)
            low = np.minimum(-(np.log(gain) + np.maximum(loudest, 0.0)) / order, high) - 1.0
            low = np.maximum(low, -300.0)
            place = bracketed_roots(lambda x: self._log(cells, np.exp(x), natural_frequency).real, low, high)
            return np.asarray(math.pi - np.abs(self._log(cells, np.exp(place), natural_frequency).imag))

    def noise(self, cells: tuple[Real, Real, Real], natural_frequency: float, period: float) -> Real:
        """Noise gain of every feasible cell at one ω₀; all cells share one set of frequencies."""
        w, weights = noise_points(self.bare, natural_frequency, period)
        rest = replace(self.bare, filter_time=0.0)(w, natural_frequency)
        found, n = np.full(cells[1].shape, np.nan), self.bare.filter_order
        for row in range(found.shape[0]):
            good = np.isfinite(cells[1][row])
            gain, order, time = (v[row, good][:, None] for v in cells)
            outer = gain * np.exp(order * (np.log(w) + 0.5j * math.pi)) / (1.0 + 1j * time * w) ** n
            found[row, good] = np.sqrt(np.sum(np.abs(outer / (1.0 + outer * rest)) ** 2 * weights, axis=1))
        return found
