"""The paper's arm as seen by a tuning: simulated, guarded, and measured stage by stage."""

from __future__ import annotations

from functools import partial
from importlib.util import module_from_spec, spec_from_file_location
from typing import Any

import fraclink as fl
from fraclink import Callback
from fraclink.lab import Wiring
from fraclink.lab._line import open_line
from fraclink.lab._tune_guard import Guard
from fraclink.lab._tune_link import tune_link
from fraclink.lab._tune_motor import tune_motor
from fraclink.lab._tune_wiring import check_wiring
from shared_data import shared_data

RIG = fl.Rig.named("paper-2023-geared")
PERIOD = RIG.period
LIMITS = fl.MotionLimits(angle=0.6, speed=4.0, torque=2.0, voltage=10.0)
Stages = tuple[fl.lab.SimulatedArm, Guard, Wiring, Any, Any]


def arm(seed: int = 0, payload: float | None = None) -> fl.lab.SimulatedArm:
    """The paper's arm, or one with another payload."""
    return fl.lab.SimulatedArm(
        fl.Twin.from_rig(RIG, payload=payload), PERIOD, seed=seed
    )


def guarded(
    connection: Callback | fl.lab.Udp,
    limits: fl.MotionLimits = LIMITS,
    *,
    period: float | None = PERIOD,
    clock: Any = "none",
) -> Guard:
    return Guard(partial(open_line, connection, period, clock=clock), limits)


def staged(made: fl.lab.SimulatedArm | None = None) -> Stages:
    """Wiring, motor and link of the paper's arm or of another one, half a second of
    computation; the arm and its guard are released.
    """
    made = made or arm(seed=1)
    guard = guarded(made.callback)
    wiring = check_wiring(guard, RIG)
    guard.learn(wiring.gain, wiring.delay)
    motor = tune_motor(guard, wiring)
    guard.learn(motor.fit.gain, motor.fit.delay)
    link = tune_link(guard, wiring, motor, 0.030)
    guard.release()
    return made, guard, wiring, motor, link


def outside_arm(**changes: Any) -> Any:
    """An arm that fraclink did not write, or a skipped test."""
    spec = spec_from_file_location("arm", shared_data("..", "arms", "arm.py"))
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Arm(**changes)
