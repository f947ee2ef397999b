"""Simulate the arm under its law: the C code of the law around the model of the link,
or around the twin.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.beam import model_at
from fraclink._arm.link import LinkModel
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.reference import SETTLE, Reference, sampled
from fraclink._arm.rig import Gauge, Rig
from fraclink._law import Law
from fraclink._law.design import Design
from fraclink._law.discretization import check_rigs_period
from fraclink._law.estimator import PayloadEstimator
from fraclink._simulate.arm import Twin
from fraclink._simulate.estimates import (
    ESTIMATED,
    estimate_findings,
    estimate_signals,
    estimated_over,
    estimator_for,
)
from fraclink._simulate.events import (
    FAULT_BITS,
    FAULTS,
    Event,
    SensorFault,
    fault_rows,
    given_payload,
)
from fraclink._simulate.kernel import (
    LumpedArms,
    run_lumped,
    shared_rig,
)
from fraclink._simulate.links import link_weights
from fraclink._simulate.on_twin import checked_motor_loop, on_twin
from fraclink._simulate.run import Run, judged_run
from fraclink.errors import FieldError, required
from fraclink.findings import Finding
from fracsys.checks import Between, Real, Seed, above, checked

__all__ = ["link_at", "model_run", "simulate"]

Part = TypeVar("Part", Twin, Gauge, MotorLoop)
Torque = Annotated[float, Between(-1e6, 1e6, "N·m")]


@checked
def simulate(
    design: Design | Law,
    reference: Reference,
    *,
    rig: Rig | None = None,
    model: LinkModel | None = None,
    arm: Twin | None = None,
    payload: Annotated[float, Between(1e-9, 1e9, "kg")] | None = None,
    told: Annotated[float, Between(0.0, 1e9, "kg")]
    | bool
    | Literal["estimated"]
    | PayloadEstimator = False,
    duration: Annotated[float, above(0.0, 1e300, "s")] | None = None,
    events: Iterable[Event] = (),
    gauge_offset: Torque | None = None,
    noise: Annotated[float, Between(0.0, 1e6, "N·m")] | None = None,
    seed: Seed = 0,
    delay_samples: Annotated[int, Between(0, 100, "periods")] | None = None,
) -> Run:
    """Run the shipped law on an arm and return its signals, metrics and verdict.

    The law is law.c itself, compiled in. The arm is the model, whose link is exact and
    massless (see `fraclink._simulate.kernel`), or with `arm` the twin, whose link has
    mass and several modes. The law's PID drives the motor of the model through its
    voltage, with friction, stiction and saturation; the coupling torque is taken as
    compensated without error, as the paper assumes. Where the law has no motor loop,
    the motor follows M(s) = 1/(1 + s/p)² (21). The identified delay and gain of the
    gauge and a second mode are simulated, too.

    Parameters
    ----------
    design
        a design, which brings its rig, its model and its law, or a law, with `rig` and
        `model` or with `arm`.
    reference
        of the tip, e.g. `smooth_step`, or two arrays (time [s], angle [rad]) for the
        spline through them.
    rig
        motor, encoder and gauge; its period must be the law's.
    model
        the link that is simulated; it need not be the one the law was designed for.
    arm
        the arm with distributed mass that is simulated in place of the model.
    payload
        mass at the tip [kg]; the model's, or the twin's, where it is left out. ω₀
        shifts like that of the rig's beam, by eq. (5) if the link has no mass.
    told
        payload that the law is given as its input: True for the arm's own, also where
        an event changes it, a number [kg] for one that may be wrong, False or 0 for
        none. With a payload, the law scales its feed-forward and corrects the tip towards
        the reference as delayed by its motor loop. "estimated": the output of the
        design's payload estimator while the arm moves; a `PayloadEstimator`: the output
        of that one.
    duration
        time to simulate [s], at most 2 000 000 periods; 5 s after the reference's end
        where it is left out, long enough to see a vibration grow.
    events
        `SensorFault`, and for the twin also `PayloadChange`, `TipPulse`, `Obstacle`,
        `Restart`.
    gauge_offset, noise
        of the gauge [N·m]; the rig's where they are left out. The model's offset
        appears in the second period, as the law takes the first reading as zero.
    seed
        of the noise. A seed gives the same noise on every machine.
    delay_samples
        periods between a sample and its effect; the rig's where it is left out.

    Raises
    ------
    FieldError
        a value out of its range, periods that differ, an option that this arm does not
        have. SizeError for more than 2 000 000 samples.

    References
    ----------
    Benftima et al. (2023), figures 7 and 8, with (22) corrected.

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0,
    ...                    phase_margin=fl.deg(50))
    >>> run = fl.simulate(design, fl.smooth_step(1.0, duration=0.5), payload=0.02, noise=0.0)
    >>> run.verdict.passed, run.metrics.settling_time < 1.0
    (True, True)
    """
    law, events = design.law() if isinstance(design, Design) else design, tuple(events)
    estimator = estimator_for(design, told)
    length = reference.duration + SETTLE if duration is None else duration
    Between(law.period, math.inf, "s").check("duration", length)
    own_gauge: dict[str, Any] = {"offset": gauge_offset, "noise": noise}
    if arm is not None:
        twin = arm if payload is None else arm.with_payload(payload)
        gauge = _changed(twin.gauge, **own_gauge)
        twin = _changed(twin, gauge=gauge, voltage_delay=delay_samples)
        return on_twin(twin, law, reference, length, events, seed, told, estimator)
    # The massless model has no modes for another payload and no tip to push; only its
    # sensors can fail.
    faults = tuple(event for event in events if isinstance(event, SensorFault))
    if len(faults) < len(events):
        raise FieldError(
            "events",
            "given",
            "not an option of this arm",
            "SensorFault",
            "give arm=Twin.from_rig(rig): only the twin has other events",
        )
    if isinstance(design, Design):
        rig, model = rig or design.rig, model or design.model
    own = required(
        "rig",
        rig,
        "the rig of the arm",
        "give rig= (and model=), arm=, or a design in place of the law",
    )
    link = required(
        "model",
        model or own.model,
        "the model of the link",
        "give model=fit.model, or a rig with a model",
    )
    check_rigs_period(law, own)
    if payload is not None:
        link = link_at(link, own, payload)
    # A law without a motor loop outputs a motor angle: it is run with the M(s) for
    # which it was designed.
    kind = "ideal"
    if law.motor_loop is not None:
        kind, law = "sampled", checked_motor_loop(law)
    own = replace(
        own,
        gauge=_changed(own.gauge, **own_gauge),
        motor_loop=_changed(own.motor_loop, delay_samples=delay_samples),
    )
    about = {
        "arm": "model",
        "rig": own.name,
        "law_sha256": law.digest,
        "motor_loop": kind,
        "gauge_delay": link.gauge_lag,
        "gauge_gain": link.gauge_gain,
        "gauge_offset": own.gauge.offset,
        "gauge_noise": own.gauge.noise,
        "seed": seed,
        "delay_samples": own.motor_loop.delay_samples,
        "payload_given": ESTIMATED if estimator else given_payload(told, link.payload),
    }
    about |= {"events": "; ".join(map(repr, faults))} if faults else {}
    return _on_model(law, link, own, reference, length, about, faults, estimator)


def _changed(part: Part, **values: Any) -> Part:
    """Return the part with the stated values."""
    return replace(part, **{k: v for k, v in values.items() if v is not None})


# --- the model ------------------------------------------------------------------------


def link_at(link: LinkModel, rig: Rig, payload: float) -> LinkModel:
    """Return the link at a payload [kg], its ω₀ shifted like that of the rig's beam; if
    the link's own payload is unknown, with ω₀ of the rig, eq. (5).
    """
    if link.payload is not None:
        return link if payload == link.payload else model_at(link, rig, payload)
    # Without the payload of the log, ω₀ cannot be converted by (5); the rig's stiffness
    # and length give one.
    return replace(
        link, natural_frequency=rig.natural_frequency(payload), payload=payload
    )


def _on_model(
    law: Law,
    link: LinkModel,
    rig: Rig,
    reference: Reference,
    length: float,
    about: Mapping[str, Any],
    faults: tuple[SensorFault, ...],
    estimator: PayloadEstimator | None,
) -> Run:
    path = sampled(reference, law.period, length)
    count = path.shape[1]
    delay = Between(0.0, 100.0, "periods").check(
        "gauge_delay", about["gauge_delay"] / law.period
    )
    values = {
        "stiffness": link.stiffness,
        "noise": about["gauge_noise"],
        "gauge_delay": delay,
        "payload_given": 0.0 if estimator else about["payload_given"],
    }
    same = ("gauge_offset", "gauge_gain", "delay_samples")
    as_is = ("motor_gain", "viscous_friction", "coulomb_torque", "amplitude")
    values |= {name: float(about[name]) for name in same} | dict.fromkeys(as_is, 1.0)
    arm = LumpedArms.of(
        rig,
        link_weights(link, law.period, max(length, 2 * law.period)),
        np.array([about["seed"]], np.uint64),
        **{name: np.array([value]) for name, value in values.items()},
    )
    rig_constants = shared_rig(rig, law, start=float(path[0, 0]))
    broken = fault_rows(faults, law.period, count) if faults else None
    rows = run_lumped(
        law,
        rig_constants,
        arm,
        path[None, [0, 2]],
        np.zeros(1, np.int32),
        faults=broken,
        estimator=estimator,
    )
    return model_run(
        law,
        link,
        {name: values[0] for name, values in rows.items()} | {"reference": path[0]},
        # A run cut off before its reference rests is judged by its last tenth.
        ended=min(reference.duration, (count - 1) * law.period),
        about=about,
        estimator=estimator,
        faults=broken,
    )


def model_run(
    law: Law,
    link: LinkModel,
    signals: Mapping[str, NDArray[Any]],
    *,
    ended: float,
    about: Mapping[str, Any],
    growth: float | None = None,
    estimator: PayloadEstimator | None = None,
    faults: Real | None = None,
) -> Run:
    """Return the run of one arm from the signals of `run_lumped` and the reference."""
    extras: dict[str, Real] | None = None
    findings: tuple[Finding, ...] = ()
    if estimator is not None:
        angle, torque = signals["motor_angle_measured"], signals["torque_measured"]
        missed = np.zeros(angle.size) if faults is None else faults[:, FAULT_BITS]
        active = (missed.astype(int) & FAULTS["tick missed"][0]) == 0
        estimates = estimated_over(
            estimator,
            estimator.initial_state(),
            angle,
            torque,
            np.arange(angle.size),
            active,
        )
        findings = estimate_findings(estimator, estimates, law.period)
        extras = estimate_signals(estimates)
    return judged_run(
        signals,
        payload=math.nan if link.payload is None else link.payload,
        period=law.period,
        ended=ended,
        vibration_period=link.vibration_period,
        about=about,
        findings=findings,
        extras=extras,
        growth=growth,
    )
