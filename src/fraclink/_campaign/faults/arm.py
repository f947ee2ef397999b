"""F16 and F35–F43: wrong wiring and units, the arm, its surroundings and its motor."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fraclink._arm.reference import smooth_step
from fraclink._campaign.faults import evidence as need
from fraclink._campaign.faults.evidence import HOLD, OFF, RUN, Evidence
from fraclink._campaign.faults.inject import SWAPPED, add_fault, members
from fraclink._campaign.faults.nouns import Check, Fault
from fraclink._campaign.faults.trial import Trial
from fraclink._law import Modes
from fraclink._law.discretize import drive_for
from fraclink._simulate.kernel import (
    ENCODER_ERROR,
    ENCODER_GAIN,
    GAUGE_ERROR,
    GAUGE_GAIN,
    TIP_FORCE,
    ArmState,
)

__all__ = ["ARM"]

BAD_ENCODER, RESIDUAL, OVERLOAD = 5, 8, 10  # reasons of law.h
MOVE_BEGINS = 1.0  # [s]
# The paper's gauge, with a noise of 0.01 N·m, asks for 0.24 rad in this time (`Law.wiring_angle`).
SELF_TEST = smooth_step(0.35, duration=0.12, start=0.1)
ANY = 10**6  # periods: the catalogue states no number


def _self_test(trial: Trial) -> None:
    """The commissioning move: motor loop alone, without correction and compensation by the gauge."""
    drive = trial.law.drive
    assert drive is not None  # noqa: S101  # a bench gives every law a motor loop
    trial.use(
        replace(
            trial.law,
            correction=Modes(0.0),
            feedforward=Modes(0.0),
            drive=replace(drive, torque_voltage=0.0),
        )
    )


def _reversed(trial: Trial) -> None:
    trial.inputs[:, GAUGE_GAIN] = trial.pick(-1.0, -1.0, -0.5)
    trial.inputs[:, GAUGE_ERROR] += trial.pick(0.0, 0.1, 0.1)


def _wiring_answer(e: Evidence) -> Check:
    answer = e.law.check_wiring(e.faulty.encoder, e.faulty.gauge)
    return Check.at_most(f"wiring test failed to refuse (it says: {answer})", answer != "gauge reversed", 0)


def _wiring_clean(e: Evidence) -> Check:
    answer = e.law.check_wiring(e.clean.encoder, e.clean.gauge)
    return Check.at_most(f"wiring test refused a good gauge (it says: {answer})", answer != "none", 0)


def _from_the_move(trial: Trial) -> None:
    """Count from the beginning of the move: at zero angle the fault does not show."""
    if trial.case.phase == "whole":
        trial.row = round(MOVE_BEGINS / trial.period)


def _degrees(trial: Trial) -> None:
    trial.inputs[trial.row :, ENCODER_GAIN] = trial.pick(10.0, 180 / math.pi, 1800 / math.pi)
    _from_the_move(trial)


def _wrapped(trial: Trial) -> None:
    trial.inputs[trial.row :, ENCODER_ERROR] += trial.pick(
        2 * math.pi, -2 * math.pi, 2**16 * 2 * math.pi / 1e5
    )


def _swapped(trial: Trial) -> None:
    rows = slice(trial.row, None)
    if trial.case.phase != "whole":
        rows = trial.rows(trial.pick(0.25, 0.5, 1e6))
    add_fault(trial, rows, SWAPPED)
    _from_the_move(trial)


def _other_payload(trial: Trial) -> None:
    trial.twin = trial.bench.twin.with_payload(trial.case.payload * trial.pick(1.0, 0.8, 0.4))


def _payload_peak(e: Evidence) -> Check:
    payload = e.case.payload * (1.0, 0.8, 0.4)[e.case.severity - 1]
    low, _, high = e.bench.payloads
    if low <= payload * (1 + 1e-9) and payload <= high:
        return need.peak_ratio(1.2)(e)
    return need.bounded(0.1)(e)  # outside the design: bounded, with the limit of a lost payload


def _payload_changes(trial: Trial) -> None:
    payload = trial.case.payload
    after = trial.pick(0.5 * payload, 0.2 * payload, payload)
    if trial.severity == 3:
        trial.twin = trial.bench.twin.with_payload(0.2 * payload)

    def action(arm: ArmState) -> None:
        arm.change_payload(after)

    trial.at(trial.row, action)


def _hit(trial: Trial) -> None:
    if trial.severity < 3:
        trial.inputs[trial.rows(0.02), TIP_FORCE] += trial.pick(0.1, 0.25, 0.0)
        return
    angle = float(trial.wanted[trial.row]) + 0.05

    def wall(arm: ArmState) -> None:
        arm.obstacle[:] = (angle, 500.0, 2.0, arm.twin.beam.length, 1.0)

    trial.at(trial.row, wall)


def _hit_reaction(e: Evidence) -> Check:
    if e.case.severity < 3:
        return need.settled(1.0)(e)
    check = need.reacts(HOLD, ANY, OVERLOAD)(e)
    felt = float(np.abs(e.faulty.torque).max())
    return replace(
        check, name=f"{check.name}; torque reached {felt:.3g} of {e.law.limits.torque_trip:.3g} N·m"
    )


def _sticky(trial: Trial) -> None:
    factor = trial.pick(1.5, 2.0, 3.0)

    def action(arm: ArmState) -> None:
        arm.rig[5:7] *= factor

    trial.at(0, action)


def _slow_motor(trial: Trial) -> None:
    pole = trial.law.inner_pole * trial.pick(0.8, 0.65, 0.5)
    trial.use(replace(trial.law, drive=drive_for(trial.bench.rig, pole)))


def _quiet(e: Evidence) -> Check:
    """Denormal numbers in the law's memory after long quiet; they would make every period slower."""
    count = round((60.0, 600.0, 3600.0)[e.case.severity - 1] / e.law.period)
    angle, torque = float(e.faulty.encoder[-1]), float(e.faulty.gauge[-1])
    still = np.full(count, angle)
    state, outputs = e.law.run(
        e.faulty.law_state,
        still,
        np.zeros(count),
        still,
        np.full(count, torque),
        first_tick=len(e.faulty.time) + 1,
    )
    size = 4 if e.law.precision == "single" else 8
    reals = members(np.frombuffer(state, dtype=np.uint8), size)
    tiny = float(np.finfo(np.float32 if size == 4 else np.float64).tiny)
    left = np.count_nonzero((reals != 0) & (np.abs(reals) < tiny)) + np.count_nonzero(outputs.mode != RUN)
    return Check.at_most("denormals left in the state", int(left), 0)


ENCODER_FAULT = (need.reacts(OFF, 20, BAD_ENCODER, RESIDUAL), need.only(RUN, OFF))

ARM: tuple[Fault, ...] = (
    Fault(
        "F16",
        "gauge sign reversed",
        "gauge gain -1; -1 with 0.1 N·m offset; -0.5 with 0.1 N·m offset",
        "found by the commissioning self-test before enabling; a good gauge passes it",
        ("gain -1", "gain -1, offset", "gain -0.5, offset"),
        "-",
        _reversed,
        (_wiring_answer, _wiring_clean),
        phases=("whole",),
        duration=1.0,
        reference=SELF_TEST,
        prepare=_self_test,
        note="the self-test must be run: law_step alone does not refuse",
    ),
    Fault(
        "F35",
        "encoder in the wrong unit",
        "angle x 10, x 57.3 (degrees), x 573",
        "D within 20 samples",
        ("x 10", "x 57.3", "x 573"),
        "D",
        _degrees,
        ENCODER_FAULT,
        phases=("whole", "start", "mid", "rest"),
        note="from the first sample on: counted from the beginning of the move",
    ),
    Fault(
        "F36",
        "encoder wraps or overflows",
        "angle + 2π, - 2π, + 2^16 counts",
        "D within 20 samples",
        ("+ 2π", "- 2π", "+ 65536 counts"),
        "D",
        _wrapped,
        ENCODER_FAULT,
    ),
    Fault(
        "F37",
        "encoder and gauge swapped",
        "channels exchanged for 0.25 s, 0.5 s, ever; or from the first sample on",
        "D",
        ("0.25 s", "0.5 s", "for ever"),
        "D",
        _swapped,
        (need.reacts(OFF, ANY, BAD_ENCODER, RESIDUAL), need.only(RUN, OFF)),
        phases=("whole", "start", "mid", "rest"),
        note="from the first sample on: counted from the beginning of the move",
    ),
    Fault(
        "F38",
        "another payload",
        "payload x 1, x 0.8, x 0.4",
        "in the design's range: peak <= 1.2 x nominal; outside: bounded (<= 0.1 rad), no trip",
        ("x 1", "x 0.8", "x 0.4"),
        "A",
        _other_payload,
        (need.only(RUN), _payload_peak, need.final(0.02)),
        phases=("whole",),
        nominal=True,
    ),
    Fault(
        "F39",
        "payload lost or picked up in a move",
        "x 0.5, x 0.2, from x 0.2 to x 1",
        "stable, peak <= 0.1 rad",
        ("half lost", "x 0.2 left", "picked up"),
        "A",
        _payload_changes,
        (need.only(RUN), need.bounded(0.1), need.final(0.02)),
    ),
    Fault(
        "F40",
        "tip hit or blocked",
        "0.1 N and 0.25 N on the tip for 20 ms; a stop 0.05 rad ahead for ever",
        "pulse: settled in 1 s; blocked: C by the torque limit",
        ("0.1 N", "0.25 N", "blocked"),
        "C",
        _hit,
        (_hit_reaction, need.only(RUN, HOLD)),
        skips=frozenset({(3, "rest")}),  # a stop ahead of an arm that stands still blocks nothing
    ),
    Fault(
        "F41",
        "more friction than compensated",
        "Coulomb friction and stiction x 1.5, x 2, x 3",
        "no limit cycle > 2e-3 rad",
        ("x 1.5", "x 2", "x 3"),
        "A",
        _sticky,
        (need.only(RUN), need.limit_cycle(2e-3)),
        phases=("whole",),
        note="a dead zone in the amplifier acts as friction does; it is not injected on its own",
    ),
    Fault(
        "F42",
        "inner loop slower than designed",
        "inner pole x 0.8, x 0.65, x 0.5",
        "stable: no trip, final <= 0.02 rad",
        ("x 0.8", "x 0.65", "x 0.5"),
        "A",
        _slow_motor,
        (need.only(RUN), need.bounded(0.2), need.final(0.02)),
        phases=("whole",),
    ),
    Fault(
        "F43",
        "quiet for an hour",
        "constant inputs for 1 min, 10 min, 1 h",
        "no denormals left, no trip",
        ("1 min", "10 min", "1 h"),
        "A",
        lambda trial: None,
        (need.only(RUN), _quiet),
        phases=("whole",),
        duration=4.0,
    ),
)
