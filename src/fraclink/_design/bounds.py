"""Bounds beside crossover and margin, the higher modes of the link, and the nearest feasible request.

On a uniform clamped beam with a payload the estimate of the tip answers the motor with

    Θ̂t/Θm = 1 - Σ share_i s²/(s² + ω_i² D_i(s)),   share_i = Γi² ω_i²/c,

where D is the damping law of the link model: s^(2-λ), or 1 + μ s^α/ω₀². For a massless link the sum has one
term, of share one, and is the G of the design. A second mode that was identified takes the place of the
beam's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, NoReturn

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.beam import Beam
from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop
from fraclink._arm.rig import Rig
from fraclink._design.specification import Requirement, Specification
from fraclink._validate import checked_between
from fraclink.errors import InfeasibleError

if TYPE_CHECKING:
    from fraclink._design.procedure import Solution, Task

__all__ = [
    "MODE_LIMIT",
    "HigherModes",
    "bound_requirements",
    "boundary",
    "higher_modes",
    "mode_requirements",
    "reach",
    "refuse",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Attempt = Callable[["Task"], "tuple[Solution, int] | None"]
Figure = Callable[["Task", Controller], float]

MODE_LIMIT = 0.5  # of the loop gain: 6 dB below the one at which phase alone would decide
ASSUMED_RATIO = 0.02  # of a model without damping, whose modes would be infinitely high
_MODES = 3  # the fourth mode of the paper's arm lies beyond the Nyquist frequency, where the hold ends it
_MODE_PAYLOADS = (
    3  # the gain of a mode changes by 3 % over a range of two: its ends and the middle are plenty
)
_WIDEST = 0.035  # so that the points of a mode that is damped away do not reach down to the first mode
_POINTS = np.sinh(np.linspace(-3.0, 3.0, 61))  # of ln ω in damping ratios: closest at the peak
_TURNS = 12


# ---- a bound as a boundary --------------------------------------------------------------------------------


def boundary(
    feasible: Callable[[float], bool], good: float, bad: float, *, halvings: int = 30, log: bool = True
) -> float:
    """Return the feasible value nearest to `bad`: the edge between `good` and `bad`, to 2^-`halvings`.

    What is feasible or not has no value whose root could be sought, so the interval is halved, in ln of the
    value unless `log` is off. The value returned was itself found feasible.
    """
    for _ in range(halvings):
        middle = math.sqrt(good * bad) if log else 0.5 * (good + bad)
        good, bad = (middle, bad) if feasible(middle) else (good, middle)
    return good


# ---- bounds -----------------------------------------------------------------------------------------------


def _worst(task: Task, controller: Controller) -> tuple[tuple[float, float], tuple[float, float]]:
    """((Ms, its ω₀), (noise gain, its ω₀)) over the payload range."""
    found = task.loop(controller).achieved(np.geomspace(task.low, task.high, 9), task.rig.period)
    pairs = []
    for values in (found.sensitivity_peak, found.noise_gain):
        at = int(np.argmax(values))
        pairs.append((float(values[at]), float(found.natural_frequency[at])))
    return pairs[0], pairs[1]


def _mode_gain(task: Task, controller: Controller) -> float:
    loop = task.full_loop(controller)
    modes = higher_modes(task.model, task.rig, loop, task.payloads)
    assert modes is not None  # noqa: S101  # a link with one mode was refused with the bound
    return float(np.max(modes.gains(loop)))


def bound_requirements(
    task: Task, controller: Controller, spec: Specification, slowest: float
) -> tuple[Requirement, ...]:
    """Return a requirement for each bound; `slowest` is the smallest crossover of the range [rad/s]."""
    found: list[Requirement] = []
    if spec.max_sensitivity is not None or spec.noise_gain is not None:
        (peak, at_peak), (noise, at_noise) = _worst(task, controller)
        where = task.model.payload_at
        if spec.max_sensitivity is not None:
            bound = spec.max_sensitivity
            found.append(Requirement.at_most("sensitivity peak", bound, peak, "", where(at_peak)))
        if spec.noise_gain is not None:
            found.append(Requirement.at_most("noise gain", spec.noise_gain, noise, "", where(at_noise)))
    if spec.settling_time is not None:
        time = 2.0 * math.pi / slowest if slowest else math.inf
        found.append(Requirement.at_most("settling time", spec.settling_time, time, "s", task.payloads[1]))
    if spec.mode_gain is not None:
        loop = task.full_loop(controller)
        modes = higher_modes(task.model, task.rig, loop, task.payloads)
        assert modes is not None  # noqa: S101  # a link with one mode was refused with the bound
        found += [item for _, item in mode_requirements(modes, loop, spec.mode_gain)]
    return tuple(found)


def reach(task: Task, spec: Specification, attempt: Attempt) -> Task:
    """Return the task changed so that the bounds are kept: more filter for noise and modes, margin for Ms.

    Raises InfeasibleError naming the bound that no filter or margin reaches.
    """

    def measured(figure: Figure) -> Callable[[Task], float]:
        def worst(changed: Task) -> float:
            found = attempt(changed)
            return math.inf if found is None else figure(changed, changed.controller(*found))

        return worst

    peak = measured(lambda changed, controller: _worst(changed, controller)[0][0])
    bounds = (
        ("noise_gain", spec.noise_gain, measured(lambda changed, found: _worst(changed, found)[1][0])),
        ("mode_gain", spec.mode_gain, measured(_mode_gain)),
    )
    for turn in range(_TURNS):
        before = task
        # More filter costs margin, more margin costs noise: after the first turn each asks for a little more
        # than its bound, so that both are kept after few.
        share = 1.0 if turn == 0 else 1.0 - 2e-3
        if spec.max_sensitivity is not None and spec.phase_margin is None:
            task = _raise_margin(task, spec.max_sensitivity, share, peak)
        for name, bound, worst in bounds:
            if bound is not None and spec.filter_time is None and task.inside:
                task = _raise_filter(task, name, bound, share, worst)
        if task == before:
            break
    return task


def _raise_margin(task: Task, asked: float, share: float, worst: Callable[[Task], float]) -> Task:
    """The smallest phase margin whose sensitivity peak is within `asked`."""
    if worst(task) <= asked:
        return task
    bound, bad, least = 1.0 + (asked - 1.0) * share, task.phase_margin, math.inf
    for margin in map(float, np.linspace(task.phase_margin, 0.9 * math.pi, 40)):
        found = worst(replace(task, phase_margin=margin))
        least = min(least, found)
        if found <= bound:
            break
        bad = margin
    else:
        raise InfeasibleError(
            "sensitivity peak",
            f"no phase margin at {task.gain_crossover:.6g} rad/s brings Ms to {asked:g}",
            {"max_sensitivity": 1.0001 * least} if math.isfinite(least) else None,
        )
    if margin > bad:
        margin = boundary(
            lambda value: worst(replace(task, phase_margin=value)) <= bound, margin, bad, log=False
        )
    return replace(task, phase_margin=margin)


def _raise_filter(task: Task, name: str, bound: float, share: float, worst: Callable[[Task], float]) -> Task:
    """The rule's filter where it is enough, else the shortest that keeps the figure `name` within `bound`.

    Where n is free, the n is taken whose filter lags least at the crossover asked for.
    """
    ruled = worst(task)
    if ruled <= bound:
        return task
    orders = (1, 2) if task.filter_order is None else (task.filter_order,)
    tried = [_shortest(replace(task, filter_order=n), bound * share, worst) for n in orders]
    made = [found for found, _ in tried if found is not None]
    if not made:
        least = min([ruled, *(value for _, value in tried)])
        words = name.replace("_", " ")
        raise InfeasibleError(
            words,
            f"no filter keeps the {words} within {bound:g} at this crossover and margin",
            {name: 1.0001 * least} if math.isfinite(least) else None,
        )
    return min(made, key=_lag)


def _lag(task: Task) -> float:
    time, order = task.filter_time or 0.0, task.filter_order or 1
    return order * math.atan(time * task.gain_crossover)


def _shortest(task: Task, bound: float, worst: Callable[[Task], float]) -> tuple[Task | None, float]:
    """(the task with the shortest δ within `bound`, None where there is none; the least that was seen)."""
    bad, least = task.filter_time or 1e-5, math.inf
    for time in map(float, np.geomspace(max(1e-4, 1.001 * bad), 1.0, 40)):
        found = worst(replace(task, filter_time=time))
        least = min(least, found)
        if found <= bound:
            best = boundary(lambda value: worst(replace(task, filter_time=value)) <= bound, time, bad)
            return replace(task, filter_time=best), least
        bad = time
    return None, least


# ---- the nearest feasible request -------------------------------------------------------------------------


def refuse(task: Task, attempt: Attempt, found: tuple[Solution, ...], fastest: float) -> NoReturn:
    """Raise InfeasibleError with the binding condition and the nearest feasible request.

    `found` are the solutions of the two equations, admissible or not; `fastest` [rad/s] is the crossover
    that the motor loop and the sampling admit at most.
    """
    top = 0.999 * (fastest if task.inside else 1e4)
    start = min(task.low ** (2.0 / task.model.order), top) / 3.0
    margin = _nearest(task, "phase_margin", np.linspace(0.01, math.pi - 0.01, 80), attempt)
    crossover = _nearest(task, "gain_crossover", np.geomspace(start, top, 60), attempt)
    condition, reason = _reason(task, found)
    parts, nearest, change = [reason], {}, math.inf
    asked = {"phase_margin": task.phase_margin, "gain_crossover": task.gain_crossover}
    if margin is not None:
        word = "largest" if margin < task.phase_margin else "smallest"
        degrees = math.degrees(margin)
        parts.append(f"at {task.gain_crossover:.6g} rad/s the {word} phase margin is {degrees:.4g}°")
        change = abs(math.log(margin / task.phase_margin))
        nearest = asked | {"phase_margin": margin}
    if crossover is not None:
        word = "highest" if crossover < task.gain_crossover else "lowest"
        degrees = math.degrees(task.phase_margin)
        parts.append(f"with {degrees:.4g}° the {word} gain crossover is {crossover:.6g} rad/s")
        if abs(math.log(crossover / task.gain_crossover)) < change:
            nearest = asked | {"gain_crossover": crossover}
    raise InfeasibleError(condition, "; ".join(parts), nearest)


def _nearest(task: Task, field: str, values: Real, attempt: Attempt) -> float | None:
    """The feasible value of one field closest to the one asked for: a scan, then the boundary."""
    asked = float(getattr(task, field))

    def feasible(value: float) -> bool:
        if field == "phase_margin":
            return attempt(replace(task, phase_margin=value)) is not None
        return attempt(replace(task, gain_crossover=value)) is not None

    for value in sorted(map(float, values), key=lambda v: abs(math.log(v / asked))):
        if feasible(value):
            # To about 1e-8 and not to the last bit: what is offered must pass when it is typed in again.
            return boundary(feasible, value, asked, halvings=20)
    return None


def _reason(task: Task, found: tuple[Solution, ...]) -> tuple[str, str]:
    """(condition, sentence) of the bound that is hit."""
    if not found:
        where = "below the Nyquist frequency " if task.inside else ""
        return "phase margin unreachable", f"no ω̄_c {where}solves equation (55) for this phase margin"
    best = min(found, key=lambda s: abs(s.order - 1.0))
    violated = best.violated(task.model.order)
    if violated is None:
        return (
            "phase margin at the other gain crossing",
            f"β = {best.order:.6g} solves (55), but where |L| rises through one the loop passes -1 closer",
        )
    if "peak" not in violated:
        return f"phase margin unreachable ({violated})", f"equation (55) asks for β = {best.order:.6g}"
    needed = Loop.ideal(task.model).sufficient(task.low)
    return violated, (
        f"ω_c = {task.gain_crossover:.6g} rad/s lies left of the peak of |L|, where the margins fall the "
        f"other way; condition (39) asks for more than {needed:.6g} rad/s"
    )


# ---- higher modes -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HigherModes:
    """Where modes 2 and 3 of a link lie, and what the loop there is without Ĉ.

    One row for each payload and mode: ``number`` (K,), ``payload`` (K,) [kg], ``frequency`` (K, N) [rad/s] as
    the computer sees it, ``level`` (K, N), ln|hold · M · Θ̂t/Θm|.
    """

    number: NDArray[np.int64]
    payload: Real
    frequency: Real
    level: Real

    def gains(self, loop: Loop) -> Real:
        """Return the largest loop gain of each row with the Ĉ of `loop`, shape (K,)."""
        return np.asarray(np.max(np.exp(loop.outer_log(self.frequency).real + self.level), axis=1))


@lru_cache(maxsize=64)
def _shape(beam: Beam) -> tuple[Real, Real]:
    """(ω_i, Γi² ω_i²) of the clamped beam; asked for again by every request for one rig."""
    modes = beam.modes(_MODES)
    return modes.frequencies, modes.participation * modes.curvature


def higher_modes(
    model: LinkModel,
    rig: Rig,
    loop: Loop,
    payloads: tuple[float, float],
    *,
    damping_ratio: float | None = None,
) -> HigherModes | None:
    """Return the higher modes of the link over `payloads` [kg], None where neither rig nor model knows one.

    Parameters
    ----------
    model
        its second mode, where it was identified; its damping law for the modes of the rig's beam.
    rig
        length, stiffness and mass of the link; control period.
    loop
        the loop whose motor loop and gauge stand around the link.
    payloads
        (lightest, heaviest) [kg], > 0.
    damping_ratio
        of the beam's modes, 0 < ζ < 1, instead of the model's law; 0.02 where the model has no damping.
    """
    if rig.link.mass <= 0.0 and model.second_mode is None:
        return None
    if damping_ratio is not None:
        damping_ratio = checked_between("mode_damping", damping_ratio, 0.0, 0.999, open_low=True)
    elif model.order == 2.0 and model.damping == 0.0:
        damping_ratio = ASSUMED_RATIO
    rows: list[tuple[int, float, Real, Real]] = []
    for payload in map(float, np.unique(np.geomspace(*payloads, _MODE_PAYLOADS))):
        if model.second_mode is not None:
            width = min(model.second_mode.damping_ratio, _WIDEST)
            w = model.second_mode.frequency * np.exp(width * _POINTS)
            link = model.at_payload(payload).natural_frequency if model.payload else model.natural_frequency
            rows.append((2, payload, w, loop.link_log(w, link).real))
        if rig.link.mass > 0.0:
            rows += _beam_modes(model, rig, payload, damping_ratio)
    number, masses, frequencies, answers = zip(*rows, strict=True)
    w = np.array(frequencies)
    level = _rest(loop, w, rig.period) + np.array(answers)
    return HigherModes(np.array(number), np.array(masses), _seen(w, rig.period), level)


def _beam_modes(
    model: LinkModel, rig: Rig, payload: float, ratio: float | None
) -> list[tuple[int, float, Real, Real]]:
    """(number, payload, ω, ln|Θ̂t/Θm|) of the beam's modes that nobody identified."""
    frequencies, sizes = _shape(Beam.from_rig(rig, payload=payload))
    found = []
    for i in range(1 if model.second_mode is None else 2, frequencies.size):
        w = _around(model, float(frequencies[i]), ratio)
        s = np.asarray(1j * w, dtype=np.complex128)
        answer = np.ones(s.shape, dtype=np.complex128)
        for frequency, share in zip(frequencies, sizes / model.stiffness, strict=True):
            answer -= share * s**2 / (s**2 + frequency**2 * _law(model, s, float(frequency), ratio))
        found.append((i + 1, payload, w, np.log(np.abs(answer))))
    return found


def _law(model: LinkModel, s: Complex, frequency: float, ratio: float | None) -> Complex:
    """D_i(s) of the mode at `frequency` [rad/s]."""
    if ratio is not None:
        return np.asarray(1.0 + 2.0 * ratio * s / frequency)
    if model.order < 2.0:
        return np.asarray(np.exp((2.0 - model.order) * np.log(s)))
    turned = np.exp(model.damping_order * np.log(s))
    return np.asarray(1.0 + model.damping / model.natural_frequency**2 * turned)


def _around(model: LinkModel, frequency: float, ratio: float | None) -> Real:
    """Frequencies about the peak of a mode: a power law moves it, by 25 % for λ = 1.92."""
    peak = frequency
    for _ in range(30):  # ω² = ω_i² Re D(jω), a contraction as Re D grows by less than ω^1
        law = complex(_law(model, np.asarray(1j * peak), frequency, ratio))
        peak = frequency * math.sqrt(max(law.real, 0.25))
    law = complex(_law(model, np.asarray(1j * peak), frequency, ratio))
    width = min(max(0.5 * abs(math.atan2(law.imag, law.real)), 1e-3), _WIDEST)
    return np.asarray(peak * np.exp(width * _POINTS))


def _seen(w: Real, period: float) -> Real:
    """Where the computer sees ω: beyond the Nyquist frequency it is folded back."""
    nyquist = math.pi / period
    return np.maximum(np.abs(np.remainder(w + nyquist, 2.0 * nyquist) - nyquist), 1e-3 * nyquist)


def _rest(loop: Loop, w: Real, period: float) -> Real:
    """ln|hold · M|; beyond the Nyquist frequency M is taken there, where it is larger."""
    half = 0.5 * period * w
    motor = loop.motor_log(np.minimum(w, math.pi / period)).real
    return np.asarray(np.log(np.abs(np.sin(half)) / half + 1e-300) + motor)


def mode_requirements(modes: HigherModes, loop: Loop, limit: float) -> tuple[tuple[int, Requirement], ...]:
    """Return (number, the worst loop gain against `limit`) of each higher mode."""
    gains = modes.gains(loop)
    found = []
    for number in map(int, np.unique(modes.number)):
        rows = np.flatnonzero(modes.number == number)
        worst = rows[int(np.argmax(gains[rows]))]
        name, payload = f"loop gain at mode {number}", float(modes.payload[worst])
        found.append((number, Requirement.at_most(name, limit, float(gains[worst]), "", payload)))
    return tuple(found)
