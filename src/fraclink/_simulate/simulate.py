"""Simulate the arm under its law: the law's own C code, an exact link, the motor and its sensors."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from fraclink import _kernels
from fraclink._arm.link import LinkModel
from fraclink._arm.reference import Reference, checked_reference, sampled
from fraclink._arm.rig import Rig
from fraclink._law import Law, equip
from fraclink._law.discretize import check_rigs_period
from fraclink._simulate.metrics import judge, measure
from fraclink._simulate.plant import link_weights
from fraclink._simulate.run import Run, Settings
from fraclink._validate import checked_choice, checked_noun, checked_number, checked_whole
from fraclink.errors import FieldError

__all__ = ["judged", "simulate"]

Inner = Literal["ideal", "sampled"]

SETTLE = 5.0  # [s] simulated after the reference has come to rest: 30 periods of the paper's slowest link
SUBSTEPS = 10  # friction steps in a period: a stop is placed to 0.4 ms at 4 ms


def simulate(
    rig: Rig,
    model: LinkModel,
    law: Law,
    reference: Reference,
    *,
    payload: float | None = None,
    duration: float | None = None,
    inner: Inner = "ideal",
    gauge_offset: float | None = None,
    noise: float | None = None,
    seed: int = 0,
    delay_samples: int | None = None,
    substeps: int = SUBSTEPS,
    compensation: Literal["ideal", "measured"] = "ideal",
) -> Run:
    """Simulate the closed loop at the law's period and return its signals, metrics and verdict.

    The law is law.c itself, compiled in. The link is exact (see `fraclink._simulate.plant`).

    Parameters
    ----------
    rig : Rig
        Motor, encoder and gauge; its period must be the law's.
    model : LinkModel
        The link that is simulated; it need not be the one the law was designed for.
    law : Law
        From `Controller.discretize`. Without an inner loop it gets the rig's for ``inner="sampled"``.
    reference : Reference
        Of the tip, e.g. `smooth_step`.
    payload : float, optional
        Mass at the tip [kg], > 0; the model's own where it is left out. ω₀ scales as sqrt(1/payload) (5).
    duration : float, optional
        Time to simulate [s]; 5 s after the reference's end where it is left out.
    inner : {"ideal", "sampled"}
        "ideal": the motor follows M(s) = 1/(1 + s/p)² (21). "sampled": the law's PID drives the motor through
        its voltage, with Coulomb friction, stiction and saturation; the coupling torque is taken as
        compensated without error, as the paper assumes.
    gauge_offset : float, optional
        Offset of the gauge [N·m], the rig's where it is left out. It appears in the second period: a law that
        starts with it would not see it at all.
    noise : float, optional
        Standard deviation of a gauge sample [N·m], ≥ 0; the rig's where it is left out.
    seed : int
        Of the noise; 0 ... 2⁶⁴ − 1. A seed gives the same noise on every machine.
    delay_samples : int, optional
        Periods between a sample and its effect, 0 ... 100; the rig's where it is left out.
    substeps : int
        Friction steps in a period, 1 ... 1000.
    compensation : {"ideal", "measured"}
        "ideal": the coupling torque is compensated without error, as the paper assumes. "measured", for
        ``inner="sampled"``: it acts on the motor, and the law compensates the gauge's reading, late;
        a gauge offset then turns the motor too.

    Raises
    ------
    FieldError
        A value out of its range, or periods that differ. SizeError for more than 2 000 000 samples.

    Source: control scheme of Benftima et al. 2023, figures 7 and 8, with (22) corrected.

    >>> import fraclink as fl
    >>> from fraclink._arm.controller import Controller
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = Controller(gain=0.069876, order=0.612197, link=rig.model).discretize(rig.period)
    >>> run = simulate(rig, rig.model, law, fl.smooth_step(1.0, 0.5), payload=0.02, noise=0.0)
    >>> run.verdict.passed, run.metrics.settling_time < 1.0
    (True, True)
    """
    checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")
    checked_noun("model", model, LinkModel, remedy="fit.model, or rig.model")
    checked_noun("law", law, Law, remedy="controller.discretize(rig.period) makes one")
    checked_reference(reference)
    link = _at_payload(model, rig, payload)
    law = _fitting(law, rig, model, inner)
    ended = reference.duration
    length = ended + SETTLE if duration is None else _number("duration", duration, "s", law.period, 1e300)
    count = math.floor(length / law.period * (1 + 1e-12)) + 1
    path = sampled(reference, law.period, count)
    if not np.all(np.isfinite(path)):
        raise FieldError("reference", "NaN", "not finite", allowed="finite", remedy="check the reference")
    settings = Settings(
        rig=rig.name,
        law_sha256=law.digest,
        payload=link.payload,
        inner=inner,
        gauge_offset=rig.gauge.offset
        if gauge_offset is None
        else _number("gauge_offset", gauge_offset, "N·m", -1e6, 1e6),
        noise=rig.gauge.noise if noise is None else _number("noise", noise, "N·m", 0.0, 1e6),
        seed=checked_whole("seed", seed, 0, 2**64 - 1),
        delay_samples=rig.inner.delay_samples
        if delay_samples is None
        else checked_whole("delay_samples", delay_samples, 0, 100),
        substeps=checked_whole("substeps", substeps, 1, 1000),
        compensation=_compensation(compensation, inner),
    )
    signals = np.empty((7, count))
    marks = np.empty((3, count), dtype=np.uint32)
    weights = link_weights(link, law.period, max(length, 2 * law.period))
    _kernels.loop_run(
        law.block,
        law.precision == "single",
        _loop_rig(rig, law, settings, float(path[0, 0]), link.stiffness),
        link.stiffness,
        weights.first,
        weights.decay,
        weights.weight,
        np.ascontiguousarray(weights.pair.real),
        np.ascontiguousarray(weights.pair.imag),
        np.ascontiguousarray(weights.pair_weight.real),
        np.ascontiguousarray(weights.pair_weight.imag),
        path,
        signals,
        marks,
    )
    return judged(law, link, path[0], signals, marks, settings, min(ended, (count - 1) * law.period))


def judged(
    law: Law,
    link: LinkModel,
    reference: np.ndarray,
    signals: np.ndarray,
    marks: np.ndarray,
    settings: Settings,
    ended: float,
) -> Run:
    """Return a run from what the kernel wrote: its signals (7, N) and marks (3, N), measured and judged."""
    tip, motor, motor_reference, torque, measured, voltage, estimate = signals
    flags, mode, reason = marks
    time = law.period * np.arange(len(tip), dtype=np.float64)
    vibration = 2 * math.pi / max(abs(link.pole.imag), 1e-3)
    saturated = (flags & 64) != 0
    metrics = measure(
        time, reference, tip, motor_reference, voltage, saturated, ended=ended, vibration_period=vibration
    )
    verdict = judge(metrics, time, reference, tip, mode, reason, ended=ended, vibration_period=vibration)
    return Run(
        time=time,
        reference=reference,
        tip_angle=tip,
        motor_angle=motor,
        motor_reference=motor_reference,
        torque=torque,
        torque_measured=measured,
        voltage=voltage,
        tip_estimate=estimate,
        flags=flags,
        mode=mode,
        reason=reason,
        metrics=metrics,
        verdict=verdict,
        settings=settings,
    )


def _at_payload(model: LinkModel, rig: Rig, payload: float | None) -> LinkModel:
    if payload is None:
        return model
    mass = _number("payload", payload, "kg", 1e-9, 1e9)
    if mass == model.payload:
        return model
    if model.payload is not None:
        return model.at_payload(mass)
    return replace(model, natural_frequency=rig.natural_frequency(mass), payload=mass)


def _fitting(law: Law, rig: Rig, model: LinkModel, inner: str) -> Law:
    checked_choice("inner", inner, ("ideal", "sampled"), remedy='"ideal" is M(s) of (21)')
    check_rigs_period(law, rig)
    return equip(law, rig, model) if inner == "sampled" and law.drive is None else law


def _loop_rig(rig: Rig, law: Law, settings: Settings, start: float, stiffness: float) -> _kernels.LoopRig:
    motor = rig.motor
    return _kernels.LoopRig(
        sampled=settings.inner == "sampled",
        substeps=settings.substeps,
        delay=settings.delay_samples,
        period=law.period,
        pole=law.inner_pole,
        gain=motor.gain,
        decay=motor.decay,
        friction=motor.coulomb_torque / (motor.inertia * motor.gear_ratio),
        coupling=stiffness / (motor.gear_ratio**2 * motor.inertia)
        if settings.compensation == "measured"
        else 0.0,
        encoder=rig.encoder.resolution,
        offset=settings.gauge_offset,
        noise=settings.noise,
        limit=rig.gauge.limit,
        quantum=rig.gauge.quantum,
        start=start,
        seed=settings.seed,
    )


def _compensation(value: str, inner: str) -> str:
    if checked_choice("compensation", value, ("ideal", "measured")) == "measured" and inner != "sampled":
        raise FieldError(
            "compensation",
            value,
            'given without inner="sampled"',
            allowed="ideal",
            remedy="the ideal inner loop M(s) has no coupling torque to compensate",
        )
    return value


def _number(field: str, value: object, unit: str, low: float, high: float) -> float:
    return checked_number(
        field, value, allowed=f"{low:g} to {high:g} {unit}", holds=lambda x: low <= x <= high
    )
