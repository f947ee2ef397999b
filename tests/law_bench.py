"""Laws and signals shared by the tests of the law, its export and the simulation."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fraclink as fl
from fraclink import Law
from fraclink.extend import LawInputs, equip

PERIOD = 0.004
DESIGN = (
    0.069876,
    0.612197,
)  # default design of issue 2: c 1.56, 20-40 g, 12 rad/s, 50 degrees, no filter


def default_controller() -> fl.Controller:
    gain, order = DESIGN
    return fl.Controller(
        derivative_gain=gain,
        derivative_order=order,
        link=fl.Rig.named("paper-2023").model,
    )


def documented_design(rig: fl.Rig, **more: Any) -> fl.Design:
    """The design of the documentation, with more stated or without a filter."""
    assert rig.model is not None
    wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50)} | more
    return fl.design(rig.model, rig, payloads=(0.02, 0.04), **wanted)


@functools.cache
def law(precision: str = "double", *, equipped: bool = True) -> Law:
    rig = fl.Rig.named("paper-2023")
    made = fl.discretize(default_controller(), PERIOD)
    if equipped:
        made = equip(made, rig, rig.model)
    return made.in_precision(precision)  # type: ignore[arg-type]


def with_pair(precision: str = "double") -> Law:
    """The default law with a complex pair added by hand: not every fit has one, and
    every line must be covered.
    """
    made = law(precision)
    paired = made.correction._replace(
        pair_poles=(0.93 + 0.06j,), pair_gains=(0.02 - 0.03j,)
    )
    return replace(made, correction=paired)


def signals(count: int, *, seed: int = 1) -> NDArray[np.float64]:
    """Reference, acceleration, motor angle and torque of a move with noise; shape (4,
    count).
    """
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(count)
    move = fl.smooth_step(1.0, 0.5, 0.2)
    angle = move.angle(time - 0.03) + 1e-3 * rng.standard_normal(count)
    torque = 1.56 * 0.1 * np.sin(11 * time) + 0.01 * rng.standard_normal(count)
    return np.array([move.angle(time), move.acceleration(time), angle, torque])


Disturb = Callable[[int, float, float], tuple[float, float]]


def closed_loop(
    made: Law,
    rows: NDArray[np.float64],
    disturb: Disturb = lambda k, angle, torque: (angle, torque),
    *,
    frequency: float = 11.0,
) -> tuple[NDArray[np.float64], Any]:
    """Run the law on an undamped link (λ = 2) with M(s); return the tip angle and the
    law's outputs.

    Written independently of the package's simulation. The drive stops at once in mode "off".
    """
    pole, near = 1 - np.exp(-80.0 * PERIOD), 0.0
    motor, tip, speed = 0.0, 0.0, 0.0
    cosine, sine = np.cos(frequency * PERIOD), np.sin(frequency * PERIOD)
    state, command, tips, log = made.initial_state(), 0.0, [], []
    for k in range(rows.shape[1]):
        angle, torque = disturb(k, motor, made.stiffness * (motor - tip))
        state, out = made.step(
            state, LawInputs(rows[0, k], rows[1, k], angle, torque), tick=k + 1
        )
        tips.append(tip)
        log.append(out)
        if out.mode < 4:
            motor += pole * (near - motor)
            near += pole * (command - near)
            command = out.motor_reference
        away = tip - motor
        tip, speed = (
            motor + away * cosine + speed * sine / frequency,
            speed * cosine - away * frequency * sine,
        )
    return np.array(tips), type(out)(*map(np.array, zip(*log, strict=True)))


def run(made: Law, rows: NDArray[np.float64], **options: object) -> Any:
    return made.run(made.initial_state(), *rows, **options)[1]  # type: ignore[arg-type]
