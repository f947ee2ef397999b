"""The residual vibration of a design, against the explicit loop and against the move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fraclink as fl

RIG = fl.Rig.named("paper-2023-geared")
LINK = RIG.model
assert LINK is not None
ROW = "damping ratio of the vibration"


def made_for(
    model: fl.LinkModel, crossover: float, margin: float, payload: float
) -> fl.Design:
    """A design for one payload."""
    return fl.design(
        model,
        RIG,
        gain_crossover=crossover,
        phase_margin=fl.deg(margin),
        payloads=(payload, payload),
        motor_loop="ideal",
        placement="tustin",
        law=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 0.02])
@pytest.mark.parametrize("payload", [0.02, 0.04])
def test_damping_is_that_of_a_root_of_the_loop_written_out(
    delay: float, payload: float
) -> None:
    model = replace(LINK, gauge_delay=delay)
    resonance = RIG.natural_frequency(payload) ** (2.0 / LINK.order)
    design = made_for(model, 1.08 * resonance, 40.0, payload)
    (row,) = (one for one in design.requirements if one.name == ROW)
    c, w0 = design.controller, design.natural_frequency(payload)

    def least(ratio: float) -> float:
        """The smallest |1 + L(s)| over vibrations with one damping ratio."""
        angle = np.exp(1j * (0.5 * np.pi + np.arcsin(ratio)))
        s = resonance * np.geomspace(0.3, 4.0, 200_001) * angle
        correction = (
            c.derivative_gain
            * s**c.derivative_order
            / (1 + c.filter_time * s) ** c.filter_order
        )
        if c.notch is not None:
            w, poles, zeros = c.notch.frequency, c.notch.poles, c.notch.zeros
            correction *= (s**2 + 2 * zeros * w * s + w**2) / (
                s**2 + 2 * poles * w * s + w**2
            )
        motor = np.exp(-1.5 * RIG.period * s) / (1 + s / design.motor_loop.pole) ** 2
        torque = s**model.order / (s**model.order + w0**2)
        return float(
            np.abs(1 + correction * motor * (1 - np.exp(-delay * s) * torque)).min()
        )

    assert least(row.achieved) < 1e-4
    for share in (0.3, 0.6, 0.9, 0.99, 1.01):
        assert least(share * row.achieved) > 1e-3


@pytest.mark.slow
def test_a_move_dies_as_fast_as_the_damping_says() -> None:
    model = replace(
        LINK, order=1.97, payload=0.03, natural_frequency=RIG.natural_frequency(0.03)
    )
    design = made_for(model, 10.5, 35.0, 0.04)
    (row,) = (one for one in design.requirements if one.name == ROW)
    rig = replace(
        RIG,
        gauge=replace(RIG.gauge, noise=0.0),
        motor=replace(RIG.motor, coulomb_torque=0.0),
    )
    quiet = replace(
        design,
        rig=replace(rig, encoder=replace(rig.encoder, counts_per_revolution=None)),
    )
    run = fl.simulate(quiet, fl.smooth_step(0.2, duration=0.5), payload=0.04)
    size, time = np.abs(run.tip_angle - 0.2), run.time
    early, late = (size[(time > t) & (time < t + 0.6)].max() for t in (0.8, 2.0))
    resonance = RIG.natural_frequency(0.04) ** (2.0 / 1.97)
    # The sampled PID takes the place of M(s), and the frequency of the root is close to
    # the resonance, within ten or twenty per cent.
    assert np.log(early / late) / 1.2 == pytest.approx(
        row.achieved * resonance, rel=0.35
    )
