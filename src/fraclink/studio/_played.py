"""Runs computed in Python for the arm in the page: a held tip, a payload lost in a
move, a case of the fault campaign.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np

from fraclink._arm.reference import smooth_step
from fraclink._simulate import Obstacle, PayloadChange, Run, Twin, simulate
from fraclink._simulate.engine import LONGEST
from fraclink.studio._messages import Reply, held
from fraclink.studio._session import Session, Verb
from fraclink.trials._fault_trial import Bench, Case
from fraclink.trials._faults import fault_named, observe
from fraclink.view._arm_box import assumed_mass
from fracsys.checks import Between, rule

__all__ = ["PLAY_VERBS"]

_NUMBERS = ("payload", "move", "time", "half", "duration", "noise", "offset", "delay")


def _play(session: Session, given: Mapping[str, Any]) -> Reply:
    """Run the page's move on the twin, with a hand holding the tip or a payload lost
    during the move.
    """
    design, law = session.shippable()
    payload, move, time, half, duration, noise, offset, delay = (
        _number(given, name) for name in _NUMBERS
    )
    # what the page's engine can show
    longest = Between(0.0, law.period * LONGEST, "s", remedy="take a shorter run")
    longest.check("duration", duration)
    reference = smooth_step(move, time).then(
        smooth_step(-move, time, start=half - time)
    )
    events, sentence = _events(given, reference.angle)
    arm = Twin.from_rig(design.rig, model=design.model, link_mass=assumed_mass(design))
    run = simulate(
        law, reference, arm=arm, duration=duration, noise=noise, gauge_offset=offset, payload=payload,
        told=given.get("told") is True, delay_samples=round(delay), events=events,
    )  # fmt: skip
    # Modes 0 and 1 are idle and run: a higher one is a reaction of the law.
    after = "" if run.mode.max() <= 1 else " The law changed its mode."
    return _reply(f"On the twin: {sentence}.{after}", run, math.degrees(move))


def _events(
    given: Mapping[str, Any], angle: Callable[[Any], Any]
) -> tuple[list[Obstacle | PayloadChange], str]:
    hold, throw = given.get("hold"), given.get("throw")
    events: list[Obstacle | PayloadChange] = []
    sentences = []
    if isinstance(hold, Mapping):
        begin, until, place = (
            _number(hold, name) for name in ("begin", "until", "angle")
        )
        # A hand stops the arm in its motion: the obstacle is on the side to which the
        # reference is about to move; at the grip itself the reference may still be
        # where the tip is.
        after = begin + _number(given, "time")
        side: Literal[1, -1] = 1 if angle(after) >= place else -1
        # A release in the same frame would leave no duration: it counts as a touch of a
        # millisecond.
        events.append(Obstacle(begin, max(until, begin + 1e-3), place, side))
        sentences.append(
            f"the tip held at {math.degrees(place):.3g}° from {begin:.2f} s on"
        )
    if isinstance(throw, Mapping):
        when, payload = _number(throw, "time"), _number(throw, "payload")
        events.append(PayloadChange(when, payload))
        sentences.append(
            f"the payload falls to {1e3 * payload:.3g} g at {when:.2f} s, and the law is not told"
        )
    return events, "; ".join(sentences) or "the move without events"


def _fault(session: Session, given: Mapping[str, Any]) -> Reply:
    """Run one case of the fault campaign again, with the same law and noise."""
    design, _ = session.shippable()
    payload, severity = _number(given, "payload"), _number(given, "severity")
    case = Case(
        str(given.get("fault")),
        round(severity),
        payload,
        given.get("phase"),  # type: ignore[arg-type]
        1,
    )
    fault = fault_named(case.fault)
    # Seed 1, as in the campaign of this page.
    run = observe(Bench.of(design), case).faulty
    sentence = (
        f"{fault.number}, severity {case.severity}, {1e3 * payload:g} g: {fault.title}. "
        f"Required: {fault.required}"
    )
    return _reply(sentence, run, math.degrees(1.0))


def _reply(said: str, run: Run, move: float) -> Reply:
    """The run, with non-finite values, such as readings changed by a fault, replaced by
    the previous value.
    """
    curves = {
        "reference": run.reference, "tip": run.tip_angle, "motor": run.motor_angle, "torque": run.torque,
        "gauge": run.torque_measured, "voltage": run.voltage, "mode": run.mode, "reason": run.reason,
    }  # fmt: skip
    clean = {
        name: held(np.asarray(values, float), 1e6) for name, values in curves.items()
    }
    return Reply({"said": said, "payload": run.payload, "move": move}, clean)


def _number(given: Mapping[str, Any], name: str) -> float:
    return float(rule(float).check(name, given.get(name)))


PLAY_VERBS: dict[str, Verb] = {
    "play": _play,
    "fault": _fault,
}
