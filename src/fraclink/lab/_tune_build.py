"""From what was measured to a law: the rig as it was found, the design over the box,
the certificate.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fraclink._arm.box import ParameterBox
from fraclink._arm.link import LinkModel
from fraclink._arm.reference import hold, smooth_step
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
from fraclink._law import Law
from fraclink._simulate.arm import Twin, damping_of
from fraclink._simulate.simulate import simulate
from fraclink.errors import FieldError, InfeasibleError
from fraclink.lab._tune_guard import PLANNED, MotionLimits
from fraclink.lab._tune_link import LinkResult
from fraclink.lab._tune_wiring import Wiring

__all__ = [
    "Built",
    "build_law",
    "built_laws",
    "link_twins",
    "measured_rig",
    "planned_move",
]

# Loop gain at a second mode that was measured: below one over the whole box no phase of
# the mode matters, and the proof holds the mode besides.
_MODE_GAIN = 0.95
# What a second mode may differ by from where a burst showed it a minute ago, relative:
# with the payload it moves by 3 %. The 5 and 20 % of an arm that nobody has measured so
# cost a heavy link its law.
_MODE_FREQUENCY, _MODE_SIZE = 0.03, 0.10
# What an arm that was measured a minute ago may differ by until `watch` says so; the
# fit's own intervals are added. A quarter of what a rig file allows an arm that nobody
# has looked at for a year costs less margin.
_DRIFT = StatedTolerances(
    natural_frequency=0.015,
    order=0.01,
    gauge_gain=0.03,
    gauge_delay=0.001,
    motor_pole=0.05,
)
# Part of the voltage limit that the gauge's noise may take at rest: at 0.2 its peaks
# reach the limit, and a loop that saturates has no margin.
_NOISE, _AT_REST = 0.12, 1.5  # [s]
_MOVE, _PERIODS = 0.3, 1.2  # [rad], periods of the heaviest payload's vibration
# of every limit, in the model's move with the gauge's noise: the guard ends the rest at
# 0.8
_WITHIN = 0.6
_LONGEST = 0.9  # of the limit of the angle: the rest is for the overshoot that passes
# Mass of a uniform link over the tuning's payload that a burst without a second mode
# leaves open. A beam clamped at one end moves like 0.243 of its mass at the tip.
_LINK_MASSES, _AT_TIP = (0.0, 0.1, 0.25), 0.243
_LIGHTEST, _HEAVIEST = 0.01, 3.0
# ω₂ goes nearly with one over the root of the mass: each step leaves a tenth of an
# error
_STEPS = 4
_FULL_TURN = 2 * math.pi
_COUNTED = (
    2e-2  # [rad]: a smaller step of the encoder is a count, a larger one a motion
)


@dataclass(frozen=True)
class Built:
    """What came of a model: design, law, certificate, the fastest move (amplitude [rad],
    duration [s]) within the limits, and why not where there is none.
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
        """Whether the design keeps its requirements over the box and the proof holds."""
        return not self.reasons


def measured_rig(
    wiring: Wiring,
    link: LinkResult,
    limits: MotionLimits,
    payloads: tuple[float, float],
    payload: float,
    period: float,
    *,
    stated: Rig | None,
    name: str,
) -> Rig:
    """The rig as it was measured, at the gear's output and in the gauge's units.

    The length is the one with which ω₀² = c/(mL²) (5) holds; what no motion shows, and
    what a design shall reach, is as stated.
    """
    fit, motor = link.fit, link.motor.fit
    assert motor.inertia is not None  # the link's stage gives it  # noqa: S101
    inertia, model = motor.inertia, fit.model
    length = math.sqrt(model.stiffness / (payload * model.natural_frequency**2))
    # The smallest step seen in a record, where it is small enough to be a count.
    counts = (
        round(_FULL_TURN / wiring.encoder_step)
        if 0 < wiring.encoder_step < _COUNTED
        else None
    )
    rig = Rig(
        name=name,
        motor=Motor(
            inertia=inertia,
            viscous_friction=motor.decay * inertia,
            torque_constant=motor.gain * inertia,
            coulomb_torque=(motor.coulomb_voltage + motor.dead_zone)
            * motor.gain
            * inertia,
            voltage_limit=limits.voltage,
        ),
        link=Link(
            length=length,
            flexural_rigidity=model.stiffness * length / 3,
            stiffness=model.stiffness,
        ),
        payloads=Payloads(low=payloads[0], high=payloads[1], nominal=payload),
        period=period,
        encoder=Encoder(counts_per_revolution=counts),
        gauge=Gauge(noise=wiring.gauge_noise),
        motor_loop=link.motor.loop,
        # The limits of the tuning are those of the law: its moves are as fast for their
        # speed as the default ones.
        moves=Moves(
            angle=limits.angle,
            velocity=limits.speed,
            acceleration=Moves.acceleration / Moves.velocity * limits.speed,
            torque=limits.torque,
        ),
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


def build_law(rig: Rig, link: LinkResult, limits: MotionLimits) -> Built:
    """The first of `built_laws`."""
    return next(built_laws(rig, link, limits))


def built_laws(rig: Rig, link: LinkResult, limits: MotionLimits) -> Iterator[Built]:
    """Laws with a design over the box of what the fit leaves open, a proof, and moves
    on links with mass.

    The preferred one first; each is made when it is asked for. Where there is none, why
    the first one is none.
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
    refused: Built | None = None
    any_passed, reasons = False, list[str]()
    for made, words in _designs(rig, late_free(fit.model), reasons):
        built = _proved(rig, made.doubted(fit.findings), words, limits)
        any_passed |= built.passed
        if built.passed:
            yield built
        else:
            refused = refused or built
    if not any_passed:
        yield refused or Built(rig, None, None, None, tuple(reasons))


def _designs(
    rig: Rig, model: LinkModel, reasons: list[str]
) -> Iterator[tuple[Design, tuple[str, ...]]]:
    """The designs that keep their requirements over the box, the preferred one first:
    what the rig asks for, the fastest, and the one with the largest margin at its
    speed. Why there is none goes to `reasons`.
    """
    mode = model.second_mode
    box = ParameterBox.of(model, rig)
    if mode is not None:
        box = replace(
            box,
            mode_frequency=_about(mode.frequency, _MODE_FREQUENCY),
            mode_gain=_about(mode.gain, _MODE_SIZE),
        )
    options: dict[str, Any] = {
        "mode_gain": None if mode is None else _MODE_GAIN,
        "inner": "sampled",
        "placement": "direct",
        "box": box,
        "nearest": False,
        "law": True,
    }
    asked: tuple[str, ...] = ()
    if rig.design is not None:
        try:
            yield design_for(rig, model, **options)
            asked = ("what the rig asks for has no law that passes; instead:",)
        except InfeasibleError as error:
            asked = (f"what the rig asks for is not feasible ({error}); instead:",)
    try:
        fastest = design(model, rig, **options)
        yield fastest, (*asked, *_words(fastest))
        speed = fastest.gain_crossover
        made = design(model, rig, **options, gain_crossover=speed, goal="margin")
        yield made, (*asked, *_words(made))
    except InfeasibleError as error:
        reasons.append(f"requirements over the box: {error}")


def _words(made: Design) -> tuple[str, ...]:
    margin = min(
        math.degrees(item.achieved)
        for item in made.requirements
        if item.name == "phase margin"
    )
    gain = max(
        (item.achieved for item in made.requirements if "mode" in item.name),
        default=0.0,
    )
    words = (
        f"gain crossover {made.gain_crossover:.3g} rad/s and phase margin {margin:.3g}°, which the whole "
        "box keeps",
    )
    return (
        (*words, f"loop gain of {gain:.2g} at most at the second mode")
        if gain > 0.0
        else words
    )


def _proved(
    rig: Rig, design: Design, words: tuple[str, ...], limits: MotionLimits
) -> Built:
    """The law of a design, its proof, and its moves on the model and on heavier links."""
    reasons = tuple(str(item) for item in design.requirements if not item.passed)
    reasons += tuple(str(item) for item in design.doubts)
    if reasons:
        return Built(rig, design, None, None, reasons)
    law = design.law()
    share = _noise(design, law)
    if share > _NOISE:
        reasons = (
            f"noise of the gauge: at rest it takes {100 * share:.0f} % of the voltage limit; the gauge is "
            f"{1e3 * design.model.gauge_delay:.3g} ms late, with {rig.gauge.noise:.2g} N·m of noise",
        )
    reasons = reasons or _moves_fail(design, law, limits)
    move = None if reasons else planned_move(design, law, limits)
    if not reasons and move is None:
        reasons = ("no move passes in the simulation within 60 % of the limits",)
    if reasons:
        return Built(rig, design, law, None, reasons)
    try:
        certificate = certify(design, law=law)
    except (
        FieldError
    ) as error:  # the derived limits leave the correction no room: nothing to prove
        return Built(rig, design, law, None, (str(error),))
    if not certificate.passed:
        reasons = (certificate.verdict,)
    words = (
        *words,
        f"at rest the gauge's noise takes {100 * share:.2g} % of the voltage limit",
    )
    return Built(rig, design, law, certificate, reasons, words, move)


def _noise(made: Design, law: Law) -> float:
    """Standard deviation of the voltage at rest, with the gauge's noise, over the
    limit.
    """
    run = simulate(
        law,
        hold(0.0),
        rig=made.rig,
        model=made.model,
        payload=made.model.payload,
        duration=_AT_REST,
        compensation="measured",
    )
    return (
        float(np.std(run.voltage[run.voltage.size // 3 :]))
        / made.rig.motor.voltage_limit
    )


def _moves_fail(made: Design, law: Law, limits: MotionLimits) -> tuple[str, ...]:
    """What is wrong with moves of both ends of the payloads, with noise, on links with
    mass: a gentle one, and one over the planned part of the speed that nearly reaches
    the limit of the angle.
    """
    heavy = made.model.at_payload(made.payloads[1])
    swing = _PERIODS * 2.0 * math.pi / abs(heavy.pole)
    far = _LONGEST * limits.angle
    long = max(1.875 * far / (PLANNED * limits.speed), swing)
    moves = ((min(_MOVE, far), swing), (far, long))
    for twin, (angle, duration), payload in itertools.product(
        link_twins(made), moves, made.payloads
    ):
        move = smooth_step(angle, duration)
        run = simulate(law, move, arm=twin, payload=payload, told=True)
        if not run.verdict.passed:
            mass = 1e3 * twin.beam.link_mass
            return (
                f"a move of {math.degrees(angle):.3g}° in {duration:.2g} s with {1e3 * payload:.3g} g on a "
                f"link of {mass:.2g} g fails in the simulation: {run.verdict.reason}",
            )
    return ()


def planned_move(
    design: Design, law: Law, limits: MotionLimits
) -> tuple[float, float] | None:
    """Amplitude [rad] and duration [s] of the fastest quintic move within the limits,
    with every payload; None where none passes.

    Looked at with the link's own second mode, and the gauge's noise: what the lightest
    makes may trip the heaviest.
    """
    amplitude = PLANNED * limits.angle
    # Begins where the reference alone takes four fifths of the planned speed: what the
    # link adds is looked at below.
    duration = max(1.875 * amplitude / (0.8 * PLANNED * limits.speed), 0.2)
    twin = link_twins(design)[-1]
    for _ in range(20):
        move = smooth_step(amplitude, duration)
        runs = [
            simulate(law, move, arm=twin, payload=payload, told=True)
            for payload in design.payloads
        ]
        angles = [run.motor_angle_measured for run in runs]
        speed = max(
            float(np.max(np.abs(angle[4:] - angle[:-4]))) for angle in angles
        ) / (4 * law.period)
        parts = (
            speed / limits.speed,
            max(float(np.max(np.abs(run.torque_measured))) for run in runs)
            / limits.torque,
            max(float(np.max(np.abs(angle))) for angle in angles) / limits.angle,
        )
        if max(parts) <= _WITHIN and all(run.verdict.passed for run in runs):
            return amplitude, duration
        # An angle that is too large does not get smaller by moving slowly; speed and
        # torque do.
        if parts[2] == max(parts) and parts[2] > _WITHIN:
            amplitude *= 0.9
        else:
            duration *= 1.15
    return None


def link_twins(made: Design) -> tuple[Twin, ...]:
    """The arm with the measured ω₀, its link without a mass and with what the second
    mode leaves open.
    """
    mode = made.model.second_mode
    ratios = _LINK_MASSES if mode is None else (0.0, _mass_ratio(made, mode.frequency))
    return tuple(_with_link(made, ratio) for ratio in ratios)


def _mass_ratio(made: Design, frequency: float) -> float:
    """Mass of the link over the payload with which a uniform beam has its second mode
    at `frequency` [rad/s].

    A power law moves a mode of ω to ω √(Re (jω)^(2 - λ)).
    """
    missing = 2.0 - made.model.order
    wanted = frequency / math.sqrt(
        frequency**missing * math.cos(0.5 * math.pi * missing)
    )
    ratio = 0.5
    for _ in range(_STEPS):
        second = float(_with_link(made, ratio).beam.modes(2).frequencies[1])
        ratio = min(max(ratio * (second / wanted) ** 2, _LIGHTEST), _HEAVIEST)
    return ratio


def _with_link(made: Design, ratio: float) -> Twin:
    rig, model = made.rig, made.model
    payload = model.payload
    assert payload is not None  # the tuning's own  # noqa: S101
    mass = ratio * payload
    length = rig.link.length * math.sqrt(payload / (payload + _AT_TIP * mass))
    flexural = model.stiffness * length / 3
    link = Link(
        length=length, flexural_rigidity=flexural, stiffness=model.stiffness, mass=mass
    )
    arm = replace(rig, link=link)
    return Twin.from_rig(arm, model=model, payload=payload, damping=damping_of(model))


def _about(value: float, share: float) -> tuple[float, float]:
    return value * (1.0 - share), value * (1.0 + share)


def late_free(model: LinkModel) -> LinkModel:
    """The model without a gauge that leads by less than its standard error: a delay
    below zero is none.
    """
    return model if model.gauge_delay >= 0 else replace(model, gauge_delay=0.0)
