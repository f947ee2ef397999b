"""The pieces of a tuning by themselves, each against what was put into its record."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fraclink import _kernels
from fraclink.errors import FieldError
from fraclink.lab._connections import Callback
from fraclink.lab._line import open_line
from fraclink.lab._tune_doublets import motor_of_doublets
from fraclink.lab._tune_guard import Record
from fraclink.lab._tune_motion import burst, random_moves, random_steps
from fraclink.lab._tune_moves import FirstMove
from fraclink.lab._tune_wiring import (
    _PULSE,
)
from tuned_arms import PERIOD

if not _kernels.REALTIME:
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)


# --- the wiring ------------------------------------------------------------------------------------------


FINE, LOSS = 100, 10.0  # steps of integration in a period, ν/J [1/s]
HALF = round(_PULSE / PERIOD)


def test_a_record_without_a_doublet_shows_no_sign() -> None:
    still = Record(PERIOD, np.full(200, 1.0), np.zeros(200), np.zeros(200))
    gain, error, _, _ = motor_of_doublets(still, HALF)
    assert gain == 0.0 and error == math.inf


def test_a_silent_arm_is_waited_for_as_long_as_was_said() -> None:
    """Behind a clock of its own: a period is over when it was asked for."""
    reads = []

    def read() -> None:
        reads.append(1)

    with (
        pytest.raises(FieldError, match=r"silent: no sample in 0\.5 s"),
        open_line(Callback(read, lambda _: None), 0.01, patience=0.5, clock="none"),
    ):
        pass
    assert 50 <= len(reads) <= 5000


# --- motions ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 5])
def test_random_moves_keep_reach_and_speed_and_end_at_rest(seed: int) -> None:
    path = random_moves(0.4, 2.0, 6.0, 0.002, seed=seed)
    angle, acceleration = path
    assert np.abs(angle).max() <= 0.4 + 1e-12
    speed = np.diff(angle) / 0.002
    assert 0.9 < np.abs(speed).max() <= 2.0 + 1e-9
    assert (
        angle[0] == angle[-1] == 0.0
        and not angle[-150:].any()
        and not acceleration[-150:].any()
    )
    assert angle.min() < -0.12 and angle.max() > 0.12  # both sides
    second = np.diff(angle, 2) / 0.002**2
    inside = np.abs(second - acceleration[1:-1]) < 0.05 * np.abs(acceleration).max()
    assert np.mean(inside) > 0.95  # but where one move follows another
    assert 6.0 < angle.size * 0.002 < 9.0
    assert np.array_equal(path, random_moves(0.4, 2.0, 6.0, 0.002, seed=seed))
    assert not np.array_equal(path, random_moves(0.4, 2.0, 6.0, 0.002, seed=seed + 1))


def test_random_steps_hold_two_levels_behind_smooth_edges() -> None:
    angle, acceleration = random_steps(0.3, 0.2, 0.05, 16, 0.002)
    assert (
        not angle[:100].any()
        and not angle[-150:].any()
        and not acceleration[-150:].any()
    )
    held = angle[100:-150].reshape(-1, 100)
    assert (
        len(held) == 17
        and set(np.round(held[:-1, -1], 9)) == {0.3, -0.3}
        and held[-1, -1] == pytest.approx(0, abs=1e-9)
    )
    assert np.ptp(held[:, 26:], axis=1).max() < 1e-9  # the edge takes 50 ms
    assert np.abs(np.diff(angle)).max() <= 1.875 * 0.6 / 0.05 * 0.002 * 1.001
    edge = 1 + int(np.flatnonzero(np.diff(held[:-1, -1]))[0])
    second = np.diff(held[edge], 2)[:20] / 0.002**2
    np.testing.assert_allclose(
        second, acceleration[100:-150].reshape(-1, 100)[edge, 1:21], rtol=0.1, atol=30.0
    )


def test_a_burst_changes_sign_at_random_and_ends_with_a_rest() -> None:
    made = burst(1.5, 0.02, 4.0, 0.004)
    assert set(np.unique(made[:-50])) == {-1.5, 1.5} and not made[-50:].any()
    assert made.size == 1000 + 50
    runs = made[:-50].reshape(-1, 5)
    assert np.ptp(runs, axis=1).max() == 0.0  # held for five periods
    signs = np.sign(runs[:, 0])
    assert abs(signs.mean()) < 0.2 and 0.3 < np.mean(signs[1:] != signs[:-1]) < 0.7


def test_a_move_says_how_far_in_what_time_and_with_what() -> None:
    move = FirstMove(math.radians(20), 0.5, 0.61, 0.7234, 0, 0, 0, 0, 0, 0, 0, 0.03)
    assert (
        str(move)
        == "20° in 0.5 s with 30 g: promised 0.61 s, measured 0.72 s: not kept"
    )
    assert " with " not in str(replace(move, payload=0.0))


# --- the link --------------------------------------------------------------------------------------------
