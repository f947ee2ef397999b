"""The closed procedure (54)–(57): a task, the two equations in ω̄_c and β, and their
admissible solution.

Magnitude at the heaviest payload gives ``k_d = χ/ω_c^β`` (54). The phase of (55) is
linear in β and gives ``β(ω̄_c) = (2/π)(φ_m - π - arg R(jω̄_c) B(jω̄_c; ω̄₀))``; its
magnitude then leaves one equation in ω̄_c alone. R is what stands in the loop beside Ĉ
and the link: one in the paper's reading; filter, M(s), hold and delay in the loop's. B
is the link as encoder and gauge show it, with the gauge's delay, gain and second mode.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.box import Arm
from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop, with_payload, worst_margins
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.rig import Rig
from fraclink._law.design import Specification
from fraclink.errors import FieldError
from fracsys._sweep import bracketed_roots

__all__ = [
    "MARGIN_SHARE",
    "ClosedForm",
    "Task",
    "attempt",
    "candidates",
    "check_bandwidth",
    "check_modes",
    "equation",
    "range_of",
    "reason",
    "task_of",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
MARGIN_SHARE = 0.1  # of the phase margin, what the filter may cost (section 6, step 5)
_GRID = 240  # trial values of ω̄_c, among which a change of sign is looked for
_AIMS = (
    8  # rounds in which a design for a late gauge aims higher than asked, see `attempt`
)


# ---- the task ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Task:
    """A specification on one arm, every number settled; frequencies in rad/s, angles in
    radians, seconds.
    """

    model: LinkModel  # with a known payload
    rig: Rig
    motor_loop: MotorLoop
    low: float  # ω₀ of the heaviest payload
    high: float  # ω₀ of the lightest payload
    payloads: tuple[float, float]  # kg, (lightest, heaviest)
    gain_crossover: float
    phase_margin: float
    margins: str
    filter_time: float | None  # None: the rule's
    filter_order: int | None
    # true over assumed, for what is achieved; the equations know no other motor
    motor_ratio: float = 1.0

    @property
    def inside(self) -> bool:
        """Whether filter, motor loop, hold, delays and gauge stand inside (55)."""
        return self.margins == "loop"

    def bare(self, order: int) -> Loop:
        """The loop with gain 1 and β = 0, and a given filter of order `order`: R·B."""
        if not self.inside:
            return replace(Loop.ideal(self.model), filter_order=order)
        loop = Loop.around(self.model, self.motor_loop, self.rig.motor, self.rig.period)
        return replace(loop, filter_time=self.filter_time or 0.0, filter_order=order)

    def loop(self, controller: Controller) -> Loop:
        """The loop that the margins are asked of."""
        if self.inside:
            return self.full_loop(controller)
        return Loop.ideal(self.model).with_controller(controller.without_filter())

    def full_loop(self, controller: Controller) -> Loop:
        """The loop that runs."""
        return Arm(self.model, self.motor_ratio).loop(controller, self.rig)

    def controller(self, solution: ClosedForm, order: int) -> Controller:
        """The controller of a solution; the paper's reading gets its filter afterwards."""
        time = solution.filter_time
        if not self.inside:
            time = (
                _filter_afterwards(self, solution, order)
                if self.filter_time is None
                else self.filter_time
            )
        return Controller(
            gain=solution.gain,
            order=solution.order,
            filter_time=time,
            filter_order=order,
            link=self.model.at_payload(self.rig.payloads.nominal),
            inner=self.motor_loop,
            period=self.rig.period,
        )


def task_of(model: LinkModel, rig: Rig, spec: Specification) -> Task:
    """Return the specification on this arm; FieldError for what contradicts it or is
    missing.
    """
    link = with_payload(model, rig)
    check_modes(link, rig, spec)
    low, high, payloads = range_of(link, rig, spec)
    crossover, margin = _crossover(spec), _margin(spec)
    if spec.margins == "loop":
        check_bandwidth(crossover, rig)
    settings = rig.motor_loop
    motor_loop = MotorLoop(
        settings.pole, int(settings.delay_samples), spec.inner, spec.placement
    )
    # Here and not at the first loop: a search for the nearest request must not meet a
    # FieldError in its midst.
    if spec.inner == "sampled":
        motor_loop.sampled(
            rig.motor, rig.period
        )  # refused at once where its poles cannot be placed
    return Task(
        model=link,
        rig=rig,
        motor_loop=motor_loop,
        low=low,
        high=high,
        payloads=payloads,
        gain_crossover=crossover,
        phase_margin=margin,
        margins=spec.margins,
        filter_time=spec.filter_time,
        filter_order=spec.filter_order,
    )


def check_modes(link: LinkModel, rig: Rig, spec: Specification) -> None:
    """FieldError for a bound on modes that a massless link does not have."""
    if rig.link.mass <= 0.0 and link.second_mode is None and spec.mode_gain is not None:
        raise FieldError(
            "mode_gain",
            spec.mode_gain,
            "asked for on a massless link, which has one mode",
            allowed="a rig that states the mass of its link, or a model that knows its second mode",
            remedy="state mass_kg in [link] (--link-mass on the command line)",
        )


def range_of(
    link: LinkModel, rig: Rig, spec: Specification
) -> tuple[float, float, tuple[float, float]]:
    """(ω₀ low, ω₀ high, payloads) from whichever of the two was given; else the rig's
    own payloads.
    """
    if spec.natural_frequencies is not None:
        if spec.payloads is not None:
            raise FieldError(
                "natural_frequencies",
                spec.natural_frequencies,
                "given beside payloads",
                allowed="one of the two",
                remedy="leave one out",
            )
        low, high = spec.natural_frequencies
        return low, high, (link.payload_at(high), link.payload_at(low))
    light, heavy = spec.payloads or (rig.payloads.low, rig.payloads.high)
    low, high = (link.at_payload(mass).natural_frequency for mass in (heavy, light))
    return low, high, (light, heavy)


def _crossover(spec: Specification) -> float:
    """The crossover asked for; ``2π/t_s`` (section 6) where only a settling time is."""
    if spec.gain_crossover is not None:
        return spec.gain_crossover
    if spec.settling_time is not None:
        return 2.0 * math.pi / spec.settling_time
    remedy = "give it, or a settling_time"
    raise FieldError(
        "gain_crossover", None, "missing", allowed="> 0 rad/s", remedy=remedy
    )


def _margin(spec: Specification) -> float:
    """The margin asked for; where only Ms is, the least that it allows, ``2 asin(1/(2
    Ms))``.
    """
    if spec.phase_margin is not None:
        return spec.phase_margin
    if spec.max_sensitivity is not None:
        return 2.0 * math.asin(0.5 / spec.max_sensitivity)
    remedy = "give it, or a max_sensitivity"
    raise FieldError("phase_margin", None, "missing", allowed="> 0 rad", remedy=remedy)


def check_bandwidth(crossover: float, rig: Rig) -> None:
    """Above Nyquist nothing crosses; above the motor loop's pole its own lag alone
    exceeds 90°.
    """
    limits = (
        (
            math.pi / rig.period,
            "above the Nyquist frequency",
            "ask for a slower loop or sample faster",
        ),
        (
            rig.motor_loop.pole,
            "above the motor loop's bandwidth",
            "ask for a slower loop or a faster motor loop",
        ),
    )
    for limit, problem, remedy in limits:
        if crossover >= limit:
            raise FieldError(
                "gain_crossover",
                crossover,
                problem,
                allowed=f"< {limit:.6g} rad/s",
                remedy=remedy,
            )


# ---- the equations ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ClosedForm:
    """One solution of (54), (55), whether or not it is admissible."""

    order: float  # β
    gain: float  # k_d
    upper: float  # ω̄_c [rad/s]
    chi: float
    filter_time: float
    slope_low: (
        float  # d ln|L| / d ln ω at (ω₀ low, ω_c): negative means right of the peak
    )
    slope_high: float  # the same at (ω₀ high, ω̄_c)

    def violated(self, link_order: float) -> str | None:
        """Name the first condition of Theorem 1 that fails, None where all are met.

        Right of the peak of |L| is the exact condition: the denominator of (49) is
        minus the slope times a positive factor, so its sign is what makes ω_c rise and
        φ_m fall with ω₀. (39) is only sufficient.
        """
        # β < λ is a condition of Theorem 1, and β < 2 what a controller may have: with
        # λ = 2 they are one.
        limit = min(link_order, 2.0)
        if self.order <= 0.0:
            return "β > 0"
        if self.order >= limit:
            return "β < λ" if link_order < 2.0 else "β < 2"
        if self.slope_low >= 0.0:
            return "gain crossover right of the peak at the heaviest payload"
        if self.slope_high >= 0.0:
            return "gain crossover right of the peak at the lightest payload"
        return None


def equation(
    bare: Loop,
    high: float,
    upper: Real,
    low: tuple[Real | float, Complex],
    margin: float,
    *,
    rule: bool,
) -> tuple[Real, Real, Real, Real]:
    """(residual of the magnitude of (55), β, ln χ, δ) at trial values of ω̄_c; the
    arguments broadcast.

    `low` is (ω_c, ln of `bare` there at the heaviest payload), the same for all trials.
    With `rule` the filter inside is the one that lags by a tenth of φ_m at ω̄_c,
    n·atan(δ ω̄_c) = φ_m/10.
    """
    n, (crossover, at_low), at_high = bare.filter_order, low, bare.log(upper, high)
    time = np.full(np.shape(upper), bare.filter_time)
    if rule:
        time = np.asarray(math.tan(MARGIN_SHARE * margin / n) / upper)
        # The rule's δ depends on the trial ω̄_c, so its filter is added here and not in
        # `bare`.
        at_low = at_low - n * np.log(1.0 + 1j * time * crossover)
        at_high = at_high - n * np.log(1.0 + 1j * time * upper)
    # arg L = −π + φ_m at ω̄_c, and arg (jω)^β is βπ/2 at every ω: linear in β, no
    # branch to choose, as `bare.log` has the unwrapped phase.
    beta = 2.0 / math.pi * (margin - math.pi - at_high.imag)
    chi = -at_low.real
    # ln|L(jω̄_c)| with k_d from (54): ln χ + β ln(ω̄_c/ω_c) + ln|R B|. Its zero is the
    # second crossing.
    residual = chi + beta * (np.log(upper) - np.log(crossover)) + at_high.real
    return np.asarray(residual), np.asarray(beta), np.asarray(chi), time


def solutions(
    task: Task, order: int, *, admissible: bool = False
) -> Iterator[ClosedForm]:
    """Yield every solution of (54), (55) with ω̄_c above 0.9 ω_c, lowest ω̄_c first.

    One by one: the first is the admissible one as a rule, and the others then cost
    nothing. With `admissible` those are left out whose β is beyond one of its bounds on
    both sides of the solution.
    """
    bare, crossover = task.bare(order), task.gain_crossover
    rule = task.inside and task.filter_time is None
    low = crossover, bare.log(crossover, task.low)

    def terms(upper: Real) -> tuple[Real, Real, Real, Real]:
        return equation(bare, task.high, upper, low, task.phase_margin, rule=rule)

    # Far above the mode |L| ∝ ω₀² ω^(β−λ), so between the payloads the crossing moves
    # by (ω̄₀/ω₀)^(2/(λ−β)): the square of the ratio for λ − β = 1. The factor 50 leaves
    # room for flatter slopes.
    top = min(bare.highest, 50.0 * crossover * (task.high / task.low) ** 2)
    grid = np.geomspace(0.9 * crossover, max(top, 1.1 * crossover), _GRID)
    residual, orders = terms(grid)[:2]
    crossed = (residual[:-1] > 0.0) != (residual[1:] > 0.0)
    if admissible:
        limit = min(task.model.order, 2.0)
        crossed &= np.maximum(orders[:-1], orders[1:]) > 0.0
        crossed &= np.minimum(orders[:-1], orders[1:]) < limit
    for i in np.nonzero(crossed)[0]:
        upper = bracketed_roots(lambda x: terms(x)[0], grid[i], grid[i + 1])
        _, beta, log_chi, time = (float(x) for x in terms(upper))
        loop = replace(bare, order=beta, filter_time=time)
        yield ClosedForm(
            order=beta,
            gain=math.exp(log_chi) / crossover**beta,
            upper=float(upper),
            chi=math.exp(log_chi),
            filter_time=time,
            slope_low=float(loop.slope(crossover, task.low).real),
            slope_high=float(loop.slope(upper, task.high).real),
        )


def attempt(task: Task) -> tuple[ClosedForm, int] | None:
    """The admissible solution of a task and its n, None where there is none.

    Theorem 1 puts the worst crossover and the worst margin at the ends of the range for
    the link G. A late gauge, its gain or a second mode may put them inside: the
    equations then aim as much higher as was missing, until what is achieved is what was
    asked.
    """
    aim, last = task, math.inf
    for _ in range(1 if task.model.exact_gauge or not task.inside else _AIMS):
        # Of the first solution that crosses at all, in the order of preference: n = 1,
        # lowest ω̄_c.
        shortfall: tuple[float, float] | None = None
        for order in (task.filter_order,) if task.filter_order else (1, 2):
            for solution in solutions(aim, order, admissible=True):
                if not _admissible(task, solution, order):
                    continue
                crossover, margin = _achieved(aim, solution, order)
                # A solution meets its own equations to rounding only.
                if crossover >= task.gain_crossover * (
                    1.0 - 1e-9
                ) and margin >= task.phase_margin * (1.0 - 1e-9):
                    return solution, order
                if crossover > 0.0 and margin > 0.0 and shortfall is None:
                    shortfall = (
                        task.gain_crossover / crossover,
                        task.phase_margin - margin,
                    )
        # A round that leaves more than 70 % of what was missing will not arrive in
        # _AIMS rounds (0.7⁸ = 6 %).
        if shortfall is None or max(shortfall[0] - 1.0, shortfall[1]) > 0.7 * last:
            return None  # nothing near, or what is missing does not shrink
        last = max(shortfall[0] - 1.0, shortfall[1])
        # 2 % more than was missing: the worst payload moves with the aim, and to fall
        # short costs a round.
        wider = aim.phase_margin + 1.02 * max(shortfall[1], 0.0)
        aim = replace(
            aim,
            gain_crossover=aim.gain_crossover * max(shortfall[0], 1.0),
            phase_margin=wider,
        )
        if aim.phase_margin >= math.pi or aim.gain_crossover >= aim.bare(1).highest:
            return None
    return None


def _admissible(task: Task, solution: ClosedForm, order: int) -> bool:
    # With n = 1 and β ≥ 1 the noise gain of Ĉ would grow without bound: the next n is
    # taken instead.
    proper = task.filter_order is not None or order == 2 or solution.order < 1.0
    return proper and solution.violated(task.model.order) is None


def _achieved(task: Task, solution: ClosedForm, order: int) -> tuple[float, float]:
    """(worst crossover, worst margin) over every payload and every crossing: (55) sees
    one of each only.
    """
    loop = replace(
        task.bare(order),
        gain=solution.gain,
        order=solution.order,
        filter_time=solution.filter_time,
    )
    (crossover, _), (margin, _) = worst_margins(loop, task.low, task.high)
    return crossover, margin


def candidates(task: Task) -> tuple[ClosedForm, ...]:
    """Every solution of the two equations, admissible or not: what a refusal is
    explained from.
    """
    return tuple(solutions(task, task.filter_order or 1))


def reason(task: Task, found: tuple[ClosedForm, ...]) -> tuple[str, str]:
    """Return (condition, sentence) of the bound that a task without a solution hits."""
    if not found:
        where = "below the Nyquist frequency " if task.inside else ""
        return (
            "phase margin unreachable",
            f"no ω̄_c {where}solves equation (55) for this phase margin",
        )
    # Of several inadmissible solutions the one in the middle of 0 < β < 2 is the
    # closest to being one.
    best = min(found, key=lambda s: abs(s.order - 1.0))
    violated = best.violated(task.model.order)
    if violated is None:
        return (
            "phase margin at the other gain crossing",
            f"β = {best.order:.6g} solves (55), but where |L| rises through one the loop passes -1 closer",
        )
    if "peak" not in violated:
        return (
            f"phase margin unreachable ({violated})",
            f"equation (55) asks for β = {best.order:.6g}",
        )
    needed = Loop.ideal(task.model).sufficient(task.low)
    return violated, (
        f"ω_c = {task.gain_crossover:.6g} rad/s lies left of the peak of |L|, where the margins fall the "
        f"other way; condition (39) asks for more than {needed:.6g} rad/s"
    )


def _filter_afterwards(task: Task, solution: ClosedForm, n: int) -> float:
    """δ [s] with which the filtered loop keeps exactly 90 % of the margin at the
    lightest payload.

    The crossing moves down with the filter; both move together: δ(ω) follows from the
    phase, and the magnitude is one equation in ω (eq. (57) and the criterion after it).
    """
    kept = (1.0 - MARGIN_SHARE) * task.phase_margin
    loop = replace(task.bare(n), gain=solution.gain, order=solution.order)

    def lag(frequency: Real) -> Real:
        return np.asarray(loop.log(frequency, task.high).imag + math.pi - kept)

    def level(frequency: Real) -> Real:
        # Clipped: beyond a quarter turn per pole no filter takes that much.
        turned = np.clip(lag(frequency) / n, 0.0, 0.45 * math.pi)
        return np.asarray(
            loop.log(frequency, task.high).real + n * np.log(np.cos(turned))
        )

    # Below ω̄_c the unfiltered loop lags less and is louder: walk down until the filter
    # can take enough of it. Steps of 1 %, down to 13 % of ω̄_c: no filter of a tenth of
    # the margin moves the crossing that far.
    steps: Real = solution.upper * np.power(0.99, np.arange(1.0, 201.0))
    enough = (lag(steps) >= 0.45 * math.pi * n) | (level(steps) > 0.0)
    low = steps[int(np.argmax(enough))] if enough.any() else steps[-1]
    crossing = bracketed_roots(level, low, solution.upper)
    return math.tan(float(lag(crossing)) / n) / float(crossing)
