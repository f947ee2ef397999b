"""A rigid arm on springs whose deflection is measured by an encoder, from log to move."""

from __future__ import annotations

import math

import numpy as np
import pytest

import fraclink as fl
from fracsys import s, time_response


@pytest.mark.slow
def test_from_two_encoders_to_a_move() -> None:
    rig = fl.Rig.named("flexible-joint")
    assert rig.model is not None
    count, step = 4000, 2 * math.pi / 4096
    rng = np.random.default_rng(4)
    move = 0.3 * np.repeat(rng.choice([-1, 1], count // 100), 100)
    move[:100] = 0.0
    angle = time_response(1 / (0.02 * s + 1) ** 2, move, rig.period).output
    # The load on its own, J θ̈ + μ J (θ̇ − θ̇m) = c (θm − θ), without a formula for
    # links.
    load = (1.3 * s + 1.3 / 0.0213 / 0.298**2) / (
        s**2 + 1.3 * s + 1.3 / 0.0213 / 0.298**2
    )
    tip = time_response(load, angle, rig.period, hold="first").output
    log = fl.Experiment(
        period=rig.period,
        motor_angle=step * np.round(angle / step),
        output=step * np.round((angle - tip) / step),
        output_kind="deflection",
        payload=0.0213,
    )
    fit = fl.identify(log, "D-IOM", stiffness=rig.link.stiffness)
    assert fit.passed
    assert fit.model.order == 2.0
    assert fit.model.natural_frequency**2 == pytest.approx(
        1.3 / 0.0213 / 0.298**2, rel=2e-3
    )
    design = fl.design(fit, rig)
    run = fl.simulate(design, fl.smooth_step(1.0, duration=0.5))
    assert run.verdict.passed
    assert run.metrics.settling_time < 0.6
