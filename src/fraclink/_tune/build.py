"""From what was measured to a law: the rig as it was found, the design over the box, the certificate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fraclink._arm.link import LinkModel
from fraclink._arm.reference import hold, smooth_step
from fraclink._arm.rig import Encoder, Gauge, Link, Motor, Payloads, Rig, StatedTolerances
from fraclink._certify import Certificate, certify
from fraclink._design import Design, design
from fraclink._design.completed import design_for
from fraclink._law import Law
from fraclink._simulate.simulate import simulate
from fraclink._tune.guard import MotionLimits
from fraclink._tune.link import LinkResult
from fraclink._tune.wiring import Wiring
from fraclink.errors import InfeasibleError

__all__ = ["Built", "build_law", "measured_rig"]

# Crossover over the torque resonance of the heaviest payload (below 1 nothing crosses right of the peak), and
# the phase margin [°] that the whole box keeps, some 8° less than the model's own. Each step up in either is
# paid for with β, and so with noise: on the paper's arm 1.1 takes three times the voltage of 1.05.
_WANTED = ((1.05, 32.0), (1.05, 28.0), (1.02, 28.0), (1.05, 25.0), (1.1, 25.0))
# What an arm that was measured a minute ago may differ by until `watch` says so; the fit's own intervals are
# added. A quarter of what a rig file allows an arm that nobody has looked at for a year costs less margin.
_DRIFT = StatedTolerances(
    natural_frequency=0.015, order=0.01, gauge_gain=0.03, gauge_delay=0.001, motor_pole=0.05
)
# Part of the voltage limit that the gauge's noise may take at rest without a further look: at 0.2 its peaks
# reach the limit, and a loop that saturates has no margin.
_NOISE, _AT_REST = 0.12, 1.5  # [s]
_MOVE, _PERIODS = 0.3, 1.2  # [rad], periods of the heaviest payload's vibration
_FULL_TURN = 2 * math.pi
_COUNTED = 2e-2  # [rad]: a smaller step of the encoder is a count, a larger one a motion


@dataclass(frozen=True)
class Built:
    """What came of a model: design, law, certificate, and why not where there is none."""

    rig: Rig
    design: Design | None
    law: Law | None
    certificate: Certificate | None
    reasons: tuple[str, ...]
    assumptions: tuple[str, ...] = ()

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

    The length is the one with which ω₀² = c/(mL²) (5) holds; what no motion shows, and what a design shall
    reach, is as stated.
    """
    fit, motor = link.fit, link.motor.fit
    assert motor.inertia is not None  # noqa: S101  # the link's stage gives it
    inertia, model = motor.inertia, fit.model
    length = math.sqrt(model.stiffness / (payload * model.natural_frequency**2))
    counts = round(_FULL_TURN / wiring.encoder_step) if 0 < wiring.encoder_step < _COUNTED else None
    rig = Rig(
        name=name,
        motor=Motor(
            inertia=inertia,
            viscous_friction=motor.decay * inertia,
            torque_constant=motor.gain * inertia,
            coulomb_torque=(motor.coulomb_voltage + motor.dead_zone) * motor.gain * inertia,
            voltage_limit=limits.voltage,
        ),
        link=Link(length=length, flexural_rigidity=model.stiffness * length / 3, stiffness=model.stiffness),
        payloads=Payloads(low=payloads[0], high=payloads[1], nominal=payload),
        period=period,
        encoder=Encoder(counts_per_revolution=counts),
        gauge=Gauge(noise=wiring.gauge_noise),
        motor_loop=link.motor.loop,
        tolerances=_DRIFT,
        assumptions=("measured by fraclink tune; torques and inertia are in the gauge's units",),
        source="fraclink tune",
    )
    if stated is None:
        return rig
    gauge = replace(stated.gauge, noise=wiring.gauge_noise)
    return replace(rig, name=stated.name, gauge=gauge, design=stated.design)


def build_law(rig: Rig, link: LinkResult) -> Built:
    """Design over the box of what the fit leaves open, and prove it."""
    fit = link.fit
    if not fit.passed:
        gates = "; ".join(f"{item.code}: {item.message}" for item in fit.findings if item.severity == "error")
        return Built(rig, None, None, None, (f"the model failed a gate: {gates}",))
    model = late_free(fit.model)
    try:
        design, assumed = _designed(rig, model)
    except InfeasibleError as error:
        return Built(rig, None, None, None, (str(error),))
    design = design.doubted(fit.findings).with_law()
    if not design.has_law:
        return Built(rig, design, None, None, tuple(map(str, design.doubts)), assumed)
    law = design.law()
    certificate = certify(design, law=law)
    reasons = tuple(str(item) for item in design.requirements if not item.passed)
    reasons += tuple(str(item) for item in design.doubts)
    if not certificate.passed:
        reasons += (certificate.verdict,)
    return Built(rig, design, law, certificate, reasons, assumed)


def _designed(rig: Rig, model: LinkModel) -> tuple[Design, tuple[str, ...]]:
    """The design with the largest usual margin that the whole box keeps, in the loop that is shipped, too."""
    if rig.design is not None:
        return design_for(rig, model, box=True)
    heavy = model.at_payload(rig.payloads.high)
    resonance = heavy.torque_resonance or heavy.natural_frequency ** (2.0 / heavy.order)
    quietest: tuple[float, Design] | None = None
    for ratio, degrees in _WANTED:
        made = _asked(model, rig, ratio * resonance, degrees)
        if made is None or not made.passed or not made.with_law().passed:
            continue
        share = _noise(made)
        if quietest is None or share < quietest[0]:
            quietest = share, made
        if share <= _NOISE:
            break
    if quietest is not None:
        share, made = quietest
        why = "" if share <= _NOISE else _why_moves_fail(made, resonance)
        if not why:
            degrees = math.degrees(made.phase_margin)
            sentence = (
                f"gain crossover {made.gain_crossover:.3g} rad/s and phase margin {degrees:.3g}°, which the "
                f"whole box keeps; at rest the gauge's noise takes {100 * share:.2g} % of the voltage limit"
            )
            return made, (sentence,)
        raise InfeasibleError(
            "noise of the gauge",
            f"the quietest law that the box admits takes {100 * share:.0f} % of the voltage limit at rest, "
            f"and its moves fail on the model: {why}; the gauge is {1e3 * model.gauge_delay:.3g} ms late, "
            f"with {rig.gauge.noise:.2g} N·m of noise: a faster or quieter one, or a narrower range of "
            "payloads, helps",
            {},
        )
    raise InfeasibleError(
        "requirements over the box",
        f"no law keeps a phase margin of {_WANTED[-1][1]:g}° right of the resonance for every arm that the "
        f"measurement leaves open (gauge delay {1e3 * model.gauge_delay:.3g} ms, payloads "
        f"{1e3 * rig.payloads.low:.3g} to {1e3 * rig.payloads.high:.3g} g"
        + (f", second mode at {model.second_mode.frequency:.3g} rad/s" if model.second_mode else "")
        + ")",
        {},
    )


def _noise(made: Design) -> float:
    """Standard deviation of the voltage at rest, with the gauge's noise, over the limit."""
    run = simulate(
        made.law(),
        hold(0.0),
        rig=made.rig,
        model=made.model,
        payload=made.model.payload,
        duration=_AT_REST,
        compensation="measured",
    )
    return float(np.std(run.voltage[run.voltage.size // 3 :])) / made.rig.motor.voltage_limit


def _why_moves_fail(made: Design, resonance: float) -> str:
    """What is wrong with gentle moves of the model with the gauge's noise, at both ends of the payloads."""
    move = smooth_step(_MOVE, _PERIODS * 2.0 * math.pi / resonance)
    for payload in made.payloads:
        run = simulate(
            made.law(),
            move,
            rig=made.rig,
            model=made.model,
            payload=payload,
            told=True,
            compensation="measured",
        )
        if not run.verdict.passed:
            return run.verdict.reason
    return ""


def _asked(model: LinkModel, rig: Rig, crossover: float, degrees: float) -> Design | None:
    try:
        return design(
            model,
            rig,
            gain_crossover=crossover,
            phase_margin=math.radians(degrees),
            # Two poles, whatever β is: a loop gain that stays level up to half the sampling rate comes close
            # to -1 there.
            filter_order=2,
            inner="sampled",
            placement="direct",
            box=True,
            nearest=False,
        )
    except InfeasibleError:
        return None


def late_free(model: LinkModel) -> LinkModel:
    """The model without a gauge that leads by less than its standard error: a delay below zero is none."""
    return model if model.gauge_delay >= 0 else replace(model, gauge_delay=0.0)
