"""The commissioning test of the gauge's wiring: how far the motor must turn, and the
result.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink.errors import FieldError
from law_bench import PERIOD, law

QUARTER = 0.14  # [s], a quarter of the vibration period of the link at 11 rad/s
NOISE = 0.01  # [N·m], for the paper's gauge


def log(
    angle: float, *, duration: float = QUARTER, gain: float = 1.0, seed: int = 0
) -> NDArray[np.float64]:
    """Motor angle and gauge of an undamped link whose motor turns by `angle` [rad];
    shape (2, N).
    """
    made = law()
    time = PERIOD * np.arange(round(duration / PERIOD) + 1)
    motor = fl.smooth_step(angle, duration).angle(time)
    # Exact for a motor angle held over steps of a tenth of a period: each step rotates
    # the state about it.
    fine = fl.smooth_step(angle, duration).angle(
        np.arange(len(time) * 10) * PERIOD / 10
    )
    turn = 11.0 * PERIOD / 10
    cosine, sine, tips, tip, speed = np.cos(turn), np.sin(turn), [], 0.0, 0.0
    for k, held in enumerate(fine):
        if k % 10 == 0:
            tips.append(tip)
        tip, speed = (
            held + (tip - held) * cosine + speed * sine,
            speed * cosine - (tip - held) * sine,
        )
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(time))
    return np.array([motor, gain * made.stiffness * (motor - np.array(tips)) + noise])


def angle_in(made: fl.Law, duration: float) -> float:
    """The angle needed for a decision in `duration` [s]: the sum of squared steps is
    the same.
    """
    return made.wiring_angle * float(np.sqrt(duration / made.wiring_time))


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize(
    ("gain", "answer"),
    [
        (1.0, "none"),
        (-1.0, "gauge reversed"),
        (-0.5, "gauge reversed"),
        (0.0, "gauge dead"),
    ],
)
def test_a_motor_that_turns_far_enough_tells_the_wiring(
    precision: str, gain: float, answer: str
) -> None:
    made = law(precision)
    for seed in range(20):
        assert (
            made.check_wiring(
                *log(1.05 * angle_in(made, QUARTER), gain=gain, seed=seed)
            )
            == answer
        )


@pytest.mark.parametrize("duration", [0.06, QUARTER])
def test_the_angle_is_the_least_that_is_enough(duration: float) -> None:
    made = law()
    needed = angle_in(made, duration)
    assert (
        made.check_wiring(*log(0.97 * needed, duration=duration)) == "not moved enough"
    )
    assert (
        made.check_wiring(*log(1.03 * needed, duration=duration)) != "not moved enough"
    )


def test_the_paper_s_gauge_asks_for_a_quarter_of_a_radian() -> None:
    assert law().wiring_angle == pytest.approx(0.26, abs=0.01)
    # without noise: 0.1 rad in 0.1 s
    assert law(equipped=False).wiring_angle == pytest.approx(0.0946, abs=0.001)


def test_bad_logs_are_named() -> None:
    with pytest.raises(FieldError, match="torque"):
        law().check_wiring([0.0, 0.1], [0.0])
