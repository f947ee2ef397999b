"""From measurements to a law: the rig as measured, the design over the box, the
certificate.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from fraclink._arm.beam import Beam
from fraclink._arm.box import ParameterBox
from fraclink._arm.link import LinkModel
from fraclink._arm.reference import smooth_step
from fraclink._arm.rig import (
    Encoder,
    Gauge,
    Link,
    Motor,
    Moves,
    Payloads,
    Rig,
    StatedTolerances,
)
from fraclink._certify import Certificate, certify
from fraclink._design import Design, design
from fraclink._design.completed import design_for
from fraclink._identify import MotorFit
from fraclink._law import Law
from fraclink._simulate.arm import Twin, damping_of
from fraclink._simulate.run import Run
from fraclink._simulate.simulate import simulate
from fraclink.errors import FieldError, FraclinkError, InfeasibleError
from fraclink.lab._tune_guard import PLANNED, MotionLimits, largest
from fraclink.lab._tune_judged import judged, settling_band
from fraclink.lab._tune_link import LinkResult
from fraclink.lab._tune_motor import MotorResult
from fraclink.lab._tune_wiring import Wiring
from fracsys.checks import Real

__all__ = [
    "Built",
    "agree",
    "built_laws",
    "measured_rig",
    "planned_move",
    "twins_of",
]

# Relative uncertainty of a second mode measured with a burst a minute ago; the payload
# shifts it by 3 %. The 5 and 20 % assumed for an unmeasured arm would leave a heavy
# link without a law.
_MODE_FREQUENCY, _MODE_SIZE = 0.03, 0.10
# Drift allowed for an arm measured a minute ago, until `watch` reports a change; the
# intervals of the fit are added. It is less than the defaults of a rig file, except in
# ω₀, and costs less margin.
_DRIFT = StatedTolerances(
    natural_frequency=0.015,
    order=0.01,
    gauge_gain=0.03,
    gauge_delay=0.001,
    motor_pole=0.05,
)
# tolerance of a settling time: a share of it, or [s] for the effect of one noisy sample
_AGREEMENT, _LEAST = 0.10, 0.05
_LONGEST = 0.9  # share of the angle limit; the rest is for the allowed overshoot
_UNSEEN_LINK = "with the heaviest link whose second mode would not have shown: a quieter gauge, which shows it, helps"
_RESTED = 60.0  # [s] of rest in which the slips of a motor that sticks show
# Mass of the link relative to the payload: a lighter link has no effect, a much heavier
# one has hardly any tip motion; one without a visible second mode is at most as heavy
# as its payload.
_LIGHTEST, _HEAVIEST, _UNSEEN = 1e-3, 10.0, 1.0


@dataclass(frozen=True)
class Built:
    """The results from a model: design, law, certificate, the fastest move (amplitude
    [rad], duration [s]) within the limits, and the reasons for a missing part.
    """

    rig: Rig
    design: Design | None
    law: Law | None
    certificate: Certificate | None
    reasons: tuple[str, ...]
    assumptions: tuple[str, ...] = ()
    move: tuple[float, float] | None = None

    @property
    def passed(self) -> bool:
        """Whether the design meets its requirements over the box and the proof
        succeeded.
        """
        return not self.reasons


def measured_rig(
    wiring: Wiring,
    link: LinkResult,
    limits: MotionLimits,
    payloads: tuple[float, float],
    payload: float,
    period: float,
    *,
    centre: float,
    rest_torque: float,
    stated: Rig | None,
    name: str,
) -> Rig:
    """The rig as measured, at the gear's output and in the gauge's units; `centre` is
    the encoder's reading in the middle of the limits [rad], `rest_torque` the gauge's
    at rest [N·m].

    The link's mass is that of a uniform beam with its second mode, or the stated one if
    no mode was seen, and the length satisfies ω₀² = c/(mL²) (5), with the link's share
    in m. Values that motion does not show, and the goals of a design, are as stated.
    """
    fit, motor = link.fit, link.motor.fit
    if motor.inertia is None:
        raise FraclinkError(
            "the motion of the motor does not show the link's torque, and thus not its own inertia: a shorter "
            "period, or limits that allow faster moves, help"
        )
    inertia, model = motor.inertia, fit.model
    mass = _shown_mass(model, payload)
    if not mass and stated is not None:
        mass = stated.link.mass
    # The smallest step in a record in which the motor moved by several of them.
    counts = (
        round(math.tau / wiring.encoder_step) if wiring.encoder_step > 0.0 else None
    )
    rig = Rig(
        name=name,
        motor=Motor(
            inertia=inertia,
            viscous_friction=motor.decay * inertia,
            torque_constant=motor.gain * inertia,
            # The friction compensated by the law: no more than there is everywhere.
            coulomb_torque=link.motor.compensation * motor.gain * inertia,
            voltage_limit=limits.voltage,
        ),
        link=_bar(model, payload, mass),
        payloads=Payloads(low=payloads[0], high=payloads[1], nominal=payload),
        period=period,
        encoder=Encoder(counts_per_revolution=counts),
        gauge=Gauge(noise=wiring.gauge_noise),
        motor_loop=link.motor.loop,
        moves=replace(_moves(motor, limits), centre=centre, rest_torque=rest_torque),
        tolerances=_DRIFT,
        assumptions=(
            "measured by fraclink tune; torques and inertia are in the gauge's units",
        ),
        source="fraclink tune",
    )
    if stated is None:
        return rig
    gauge = replace(stated.gauge, noise=wiring.gauge_noise)
    return replace(rig, name=stated.name, gauge=gauge, design=stated.design)


def _moves(motor: MotorFit, limits: MotionLimits) -> Moves:
    """The largest moves of the law: those of the limits, as far as the weakest motor of
    the box can make them.

    The acceleration is in the same ratio to the speed as in the default moves. A
    motor gives its largest power at half its no-load speed; a faster move would leave
    it less to accelerate with.
    """
    volts = limits.voltage - motor.coulomb_voltage
    half = 0.5 * (1.0 - _DRIFT.motor_pole) * motor.gain * volts
    # a drive without damping has no no-load speed
    speed = limits.speed * half / max(motor.decay * limits.speed, half)
    ratio = Moves.acceleration / Moves.velocity
    return Moves(
        angle=limits.angle,
        velocity=speed,
        acceleration=min(ratio * speed, 2.0 * half - motor.decay * speed),
        torque=limits.torque,
    )


def built_laws(rig: Rig, link: LinkResult, limits: MotionLimits) -> Iterator[Built]:
    """Laws with a design over the box of the fit, a proof, and moves on links with
    mass.

    The preferred one comes first, and each is computed on demand. If none passes, the
    first one is yielded with the reasons why it failed.
    """
    fit = link.fit
    if not fit.passed:
        gates = "; ".join(
            f"{item.code}: {item.message}"
            for item in fit.findings
            if item.severity == "error"
        )
        yield Built(rig, None, None, None, (f"the model failed a gate: {gates}",))
        return
    # A gauge that leads by less than its standard error has no delay.
    model = replace(fit.model, gauge_delay=fit.model.gauge_lag)
    results: list[Built] = []
    try:
        for each in _rigs(rig, model):
            for candidate, words in _designs(each, model):
                result = _proved(
                    each, candidate.doubted(fit.findings), words, limits, link.motor
                )
                results.append(result)
                if result.passed:
                    yield result
            if any(result.passed for result in results):
                return
    # The link may have either mass: if a design is infeasible for one, the other is not
    # tried.
    except InfeasibleError as error:
        reason = f"requirements over the box: {error}"
        results.append(Built(rig, None, None, None, (reason,)))
    if not any(result.passed for result in results):
        yield results[0]


def _rigs(rig: Rig, model: LinkModel) -> tuple[Rig, ...]:
    """The rig as measured; and without a visible second mode, also with the heaviest
    link whose mode would be invisible.
    """
    if rig.link.mass > 0.0:
        return (rig,)
    assert model.payload is not None  # the tuning's own  # noqa: S101
    top = model.unseen_up_to or math.pi / rig.period
    ratio = _mass_ratio(lambda w, size: w[0] / w[1] - model.resonance / top)
    mass = min(ratio, _UNSEEN) * model.payload
    words = f"a link of {1e3 * mass:.2g} g, the heaviest whose second mode would not have shown"
    return rig, replace(
        rig,
        link=_bar(model, model.payload, mass),
        assumptions=(*rig.assumptions, words),
    )


def _designs(rig: Rig, model: LinkModel) -> Iterator[tuple[Design, tuple[str, ...]]]:
    """The designs that meet their requirements over the box, the preferred one first:
    the one requested by the rig, the fastest, and the one with the largest margin at
    the same speed; InfeasibleError if there is no fastest one.
    """
    mode = model.second_mode
    box = ParameterBox.of(model, rig)
    if mode is not None:
        box = replace(
            box,
            mode_frequency=(
                mode.frequency * (1.0 - _MODE_FREQUENCY),
                mode.frequency * (1.0 + _MODE_FREQUENCY),
            ),
            mode_gain=(
                mode.gain * (1.0 - _MODE_SIZE),
                mode.gain * (1.0 + _MODE_SIZE),
            ),
        )
    options: dict[str, Any] = {"box": box, "nearest": False}
    preamble: tuple[str, ...] = ()
    if rig.design is not None:
        try:
            yield design_for(rig, model, **options)
            preamble = ("what the rig asks for has no law that passes; instead:",)
        except InfeasibleError as error:
            preamble = (f"what the rig asks for is not feasible ({error}); instead:",)
    fastest = design(model, rig, **options)
    yield fastest, (*preamble, fastest.sentence)
    options |= {"gain_crossover": fastest.gain_crossover, "goal": "margin"}
    with contextlib.suppress(InfeasibleError):
        candidate = design(model, rig, **options)
        yield candidate, (*preamble, candidate.sentence)


def _proved(
    rig: Rig,
    design: Design,
    words: tuple[str, ...],
    limits: MotionLimits,
    motor: MotorResult,
) -> Built:
    """The law of a design, its proof, and its moves on the model and on heavier links."""
    reasons = tuple(map(str, (*design.missed, *design.doubts)))
    if reasons:
        return Built(rig, design, None, None, reasons)
    law = design.law()
    move, reason = planned_move(design, law, limits, motor)
    if reason:
        return Built(rig, design, law, None, (reason,))
    try:
        certificate = certify(design, law=law)
    except (
        FieldError
        # the derived limits leave no range for the correction: nothing to prove
    ) as error:
        return Built(rig, design, law, None, (str(error),))
    if not certificate.passed:
        reasons = (certificate.verdict,)
    return Built(rig, design, law, certificate, reasons, words, move)


def planned_move(
    design: Design, law: Law, limits: MotionLimits, motor: MotorResult
) -> tuple[tuple[float, float] | None, str]:
    """Amplitude [rad] and duration [s] of the quintic move within the limits whose
    longest settling time over the payloads is shortest; None and a reason if none
    passes.

    Simulated with the extreme payloads and the tuning's own, with the link's own second
    mode and the gauge's noise, and judged as the arm's own moves will be; a move at the
    same speed that nearly reaches the angle limit has to pass as well.
    """
    best, least, reason = None, math.inf, ""
    amplitude, longer = PLANNED * _LONGEST * limits.angle, 1.0 / PLANNED
    twins = twins_of(design, motor)
    # Narrower by the tolerance of a promise: a vibration that is larger than the
    # model's by that much must not settle any later.
    band = (1.0 - _AGREEMENT) * settling_band(amplitude, design)
    # The first reference takes four fifths of the planned speed.
    shortest = 1.875 * amplitude / (0.8 * PLANNED * limits.speed)
    for duration in (shortest * 1.15 ** np.arange(20)).tolist():
        runs = _simulated(law, design, twins, amplitude, duration)
        far = _simulated(law, design, twins, longer * amplitude, longer * duration)
        settling = max(
            judged(
                run.motor_angle_measured, run.torque_measured, band, duration, design
            )[0]
            for run in runs
        )
        reason = _objection(runs, far, limits, law.period)
        if not reason and settling < least:
            best, least = (amplitude, duration), settling
        # A slower move may settle sooner, since a motor at its voltage limit leaves a
        # vibration behind; but no move settles before its reference ends.
        if duration >= least:
            break
    if best is None:
        return None, f"no move passes in the simulation: {reason}"
    rests = _simulated(law, design, twins, *best, until=best[1] + _RESTED)
    swing = max(0.5 * float(np.ptp(run.tip_angle[run.time > least])) for run in rests)
    if swing > band:
        # A vibration may grow so slowly that the move alone does not show it.
        if reason := _first_failure(rests, lambda run: run.metrics.growth > 0.0):
            return None, f"no move passes in the simulation: {reason}"
        return None, (
            f"the motor hunts in the simulation: it slides at {motor.friction:.2g} V and breaks away at "
            f"{motor.breakaway:.2g} V, which lets the tip swing by ±{math.degrees(swing):.2g}°, "
            f"where ±{math.degrees(band):.2g}° is allowed; less friction helps"
        )
    return best, ""


def _simulated(
    law: Law,
    design: Design,
    twins: Sequence[Twin],
    amplitude: float,
    duration: float,
    until: float | None = None,
) -> list[Run]:
    """A move of every twin with either extreme payload and the measured one, and the
    rest after it `until` [s].
    """
    low, high = design.payloads
    return [
        simulate(
            law,
            smooth_step(amplitude, duration),
            arm=twin,
            payload=payload,
            told=True,
            duration=until,
        )
        for twin in twins
        for payload in (low, design.model.payload, high)
    ]


def _objection(
    runs: list[Run], far: list[Run], limits: MotionLimits, period: float
) -> str:
    """Why a move cannot be promised, "" if it can; `far` are the runs that nearly reach
    the angle limit.
    """
    # Over four periods: one count of an encoder in a single period is a high speed.
    speed = max(
        largest(run.motor_angle_measured[4:] - run.motor_angle_measured[:-4])
        / (4 * period)
        for run in runs
    )
    torque = max(largest(run.torque_measured) for run in runs)
    times = [run.metrics.settling_time for run in runs]
    for group in (runs, far):
        if reason := _first_failure(group, lambda run: not run.verdict.passed):
            return reason
    if speed > PLANNED * limits.speed or torque > PLANNED * limits.torque:
        return f"it takes more than {100 * PLANNED:g} % of the limits"
    # The first and the last twin with the same payload.
    if not all(map(agree, times[-3:], times[:3])):
        return f"its settling time would differ {_UNSEEN_LINK}"
    return ""


def _first_failure(runs: list[Run], failed: Callable[[Run], bool]) -> str:
    """Why the first run that fails does so; "" if none fails."""
    for number, run in enumerate(runs):
        if failed(run):
            # The first three are of the arm as it was measured.
            unseen = "" if number < 3 else f", {_UNSEEN_LINK}"
            return run.verdict.reason + unseen
    return ""


def twins_of(made: Design, measured: MotorResult) -> tuple[Twin, ...]:
    """The arm as measured, with all of its friction; and without a visible second mode,
    also with the heaviest link whose mode would be invisible.
    """
    model = made.model
    damping, mode = damping_of(model), model.second_mode
    if mode is not None:  # ζ = ηω/2
        damping = replace(damping, higher=2.0 * mode.damping_ratio / mode.frequency)
    # The law compensates less friction than there is.
    motor = replace(
        made.rig.motor,
        coulomb_torque=measured.friction * made.rig.motor.torque_constant,
    )
    # Stiction that the record does not show is assumed to be the usual one.
    stiction = max(measured.breakaway / max(measured.friction, 1e-12), Twin.stiction)
    return tuple(
        replace(
            Twin.from_rig(replace(rig, motor=motor), damping=damping, model=model),
            stiction=stiction,
        )
        for rig in _rigs(made.rig, model)
    )


def _shown_mass(model: LinkModel, payload: float) -> float:
    """Mass [kg] of a uniform link with the second mode of the model; 0 if it has none.

    It follows from the shares of the modes in the hub's motion (gain over frequency
    squared), since an extended payload shifts ω₂ by more than the mass of the link
    does.
    """
    mode = model.second_mode
    if mode is None:
        return 0.0
    share = mode.gain * (model.resonance / mode.frequency) ** 2
    return payload * _mass_ratio(
        lambda w, size: size[1] / size[0] * (w[0] / w[1]) ** 2 - share
    )


def _mass_ratio(excess: Callable[[Real, Real], float]) -> float:
    """Ratio of the mass of a uniform link to its payload at which a function of the
    frequencies and sizes of its modes, increasing with the ratio, is zero.
    """

    def at(log_ratio: float) -> float:
        modes = Beam(1.0, 1.0, math.exp(log_ratio), 1.0).modes(2)
        return float(
            excess(modes.frequencies, (modes.participation * modes.frequencies) ** 2)
        )

    low, high = math.log(_LIGHTEST), math.log(_HEAVIEST)
    if at(low) > 0.0:
        return _LIGHTEST
    return _HEAVIEST if at(high) < 0.0 else math.exp(brentq(at, low, high))


def _bar(model: LinkModel, payload: float, mass: float) -> Link:
    """The uniform link of this mass [kg] with the stiffness and ω₀ of the model."""
    unit = Link(length=1.0, stiffness=model.stiffness, mass=mass)
    tip = payload + unit.tip_mass
    length = math.sqrt(model.stiffness / tip) / model.natural_frequency
    return replace(unit, length=length, flexural_rigidity=model.stiffness * length / 3)


def agree(measured: float, promised: float) -> bool:
    """Whether a settling time [s] agrees with the promise within 10 % or 50 ms."""
    return abs(measured - promised) <= max(_AGREEMENT * promised, _LEAST)
