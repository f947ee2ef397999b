"""The identification kernel against an independent solution, and its derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from fraclink import Experiment, LinkModel, identify
from fraclink.extend import simulated_torque
from fracsys import time_response
from identify_cases import PERIOD, TRUTH, smooth_pulse

LINKS = [
    TRUTH,
    LinkModel(1.56, 10.0),
    LinkModel(1.56, 10.2, damping=1.3),
    LinkModel(1.56, 10.5, damping=1.37, damping_order=0.9),
    LinkModel(1.56, 9.0, damping=0.8, damping_order=1.5),
    LinkModel(1.0, 4.0, order=1.4),
]


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("link", LINKS, ids=lambda link: link.structure)
def test_prediction_is_the_exact_response(link: LinkModel, hold: str) -> None:
    angle = smooth_pulse(PERIOD * np.arange(3000))
    exact = time_response(link.torque(), angle, PERIOD, hold=hold).output
    found = simulated_torque(link, angle, PERIOD, hold=hold)  # type: ignore[arg-type]
    assert np.max(np.abs(found - exact)) < 3e-7 * link.stiffness


def test_delay_of_whole_and_broken_samples() -> None:
    fine = PERIOD / 8
    angle = smooth_pulse(fine * np.arange(16000), rise=0.2)
    whole = simulated_torque(TRUTH, angle, fine)
    for steps in (1, 3, 8, 13):
        late = simulated_torque(TRUTH, angle, fine, delay=steps * fine)
        assert np.max(np.abs(late[steps:] - whole[:-steps])) < 1e-9
    # Between samples the input is linear: the same as in a fine log that is linear
    # there.
    coarse = angle[::8]
    straight = np.interp(
        fine * np.arange(coarse.size * 8 - 7), PERIOD * np.arange(coarse.size), coarse
    )
    reference = simulated_torque(TRUTH, straight, fine, hold="first")
    for steps in (1, 3, 5):
        late = simulated_torque(TRUTH, coarse, PERIOD, delay=steps * fine, hold="first")
        assert (
            np.max(np.abs(late[1:] - reference[8 - steps :: 8][: late.size - 1])) < 1e-8
        )


def test_a_negative_delay_looks_ahead() -> None:
    angle = smooth_pulse(PERIOD * np.arange(2000))
    early = simulated_torque(TRUTH, angle, PERIOD, delay=-5 * PERIOD)
    assert np.allclose(
        early[:-5], simulated_torque(TRUTH, angle, PERIOD)[5:], atol=1e-9
    )


def test_hold_is_seen_in_the_angle() -> None:
    time = PERIOD * np.arange(2000)
    angles = {
        "first": (smooth_pulse(time), np.round(smooth_pulse(time) * 300) / 300),
        "zero": (np.where((time > 1) & (time < 5), 1.0, 0.0),),
    }
    for hold, shapes in angles.items():
        for angle in shapes:
            torque = simulated_torque(TRUTH, angle, PERIOD)
            log = Experiment(PERIOD, angle, torque)
            assert identify(log, "UD-FOM", details=False).hold == hold
