"""A run of the twin: law.c itself around the arm with distributed mass, in segments
between changes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from fraclink._arm.reference import Reference
from fraclink._law import Law
from fraclink._law.estimator import Estimates, PayloadEstimator
from fraclink._simulate.arm import Twin
from fraclink._simulate.estimates import (
    ESTIMATED,
    estimate_findings,
    estimate_signals,
)
from fraclink._simulate.events import (
    PAYLOAD,
    REFERENCE,
    Action,
    Event,
    actions_of,
    given_payload,
    healthy_inputs,
)
from fraclink._simulate.kernel import RECORD, ArmState
from fraclink._simulate.run import Run, judged_run
from fraclink.errors import FieldError
from fraclink.findings import Finding
from fracsys.checks import Real

__all__ = ["acted", "checked_motor_loop", "on_twin", "twin_run"]


def checked_motor_loop(law: Law) -> Law:
    """Return the law if it has a motor loop at its own period; FieldError otherwise."""
    if law.motor_loop is None:
        raise FieldError(
            "law.motor_loop",
            None,
            "missing: the law gives a motor angle, and this arm's motor takes a voltage",
            "a law with a motor loop",
            "simulate fraclink.extend.equip(law, rig, model)",
        )
    # Both are recursions of their own period: at another period the poles would move
    # without notice.
    if not math.isclose(law.motor_loop.pid.period, law.period, rel_tol=1e-9):
        raise FieldError(
            "period",
            law.period,
            "not the motor loop's",
            f"{law.motor_loop.pid.period} s",
            "discretise controller and motor loop at one period",
        )
    return law


def on_twin(
    twin: Twin,
    law: Law,
    reference: Reference,
    length: float,
    events: tuple[Event, ...],
    seed: int,
    told: bool | float | str | PayloadEstimator,
    estimator: PayloadEstimator | None,
) -> Run:
    law = checked_motor_loop(law)
    inputs = healthy_inputs(
        twin.gauge, reference, law.period, length, np.random.default_rng(seed)
    )
    state = ArmState(
        twin, law.period, law.initial_state(), start_angle=float(inputs[0, REFERENCE])
    )
    actions = actions_of(events, law.period, inputs)
    given = "the arm's own" if told is True else given_payload(told, None)
    estimates: list[Estimates] = []

    def period(first: int, last: int) -> Real:
        if estimator is None:
            # Between two actions the payload is constant; `told` = True follows it.
            inputs[first:last, PAYLOAD] = given_payload(told, state.twin.beam.payload)
        part, rows = state.estimating(law, inputs[first:last], estimator, first)
        estimates.extend(rows)
        return part

    record, payloads = acted(state, len(inputs), actions, period)
    return twin_run(
        record,
        payloads,
        twin,
        law.period,
        finished=len(record) == len(inputs),
        ended=reference.duration,
        about={
            "law_sha256": law.digest,
            "seed": seed,
            "motor_loop": "sampled",
            "damping": twin.damping.label,
            "link_mass": twin.beam.link_mass,
            "payload": twin.beam.payload,
            "payload_given": ESTIMATED if estimator else given,
            "events": "; ".join(map(repr, events)),
        },
        findings=twin.findings,
        estimates=None
        if estimator is None
        else (estimator, Estimates(*map(np.concatenate, zip(*estimates, strict=True)))),
    )


def acted(
    arm: ArmState,
    count: int,
    actions: Mapping[int, Sequence[Action]],
    run: Callable[[int, int], Real],
) -> tuple[Real, Real]:
    """Run `count` periods by `run` (first, last), in segments that end before the
    periods with actions; return the record and the payload [kg] of each period.
    """
    records, payloads = [], []
    edges = sorted({0, count, *(row for row in actions if row < count)})
    for first, last in pairwise(edges):
        for act in actions.get(first, ()):
            act(arm)
        records.append(run(first, last))
        payloads.append(np.full(len(records[-1]), arm.twin.beam.payload))
        # The arm has exceeded all bounds; a continuation would be meaningless.
        if len(records[-1]) < last - first:
            break
    return np.vstack(records), np.concatenate(payloads)


def twin_run(
    record: Real,
    payload: Real,
    twin: Twin,
    period: float,
    *,
    finished: bool,
    ended: float,
    about: Mapping[str, Any],
    findings: tuple[Finding, ...] = (),
    estimates: tuple[PayloadEstimator, Estimates] | None = None,
) -> Run:
    """Return the run from the record of `ArmState.run`: columns `RECORD`, and the
    payload [kg].
    """
    columns = {
        name: np.ascontiguousarray(column)
        for name, column in zip(RECORD, record.T, strict=True)
    }
    columns |= {
        name: columns[name].astype(np.uint32) for name in ("mode", "reason", "flags")
    }
    # Signals that only a twin has are kept apart from those that all runs share.
    extras = {
        name: columns.pop(name)
        for name in ("motor_velocity", "contact_force", "voltage_asked")
    }
    if estimates is not None:
        extras |= estimate_signals(estimates[1])
        findings += estimate_findings(*estimates, period)
    return judged_run(
        columns,
        payload=float(payload[0]),
        period=period,
        ended=ended,
        vibration_period=twin.vibration_period,
        about={"arm": "twin", **about},
        findings=findings,
        extras=extras | {"payload": payload},
        finished=finished,
    )
