"""The guards of the law, one fault at a time, on realistic signals (reaction classes of
the fault catalogue).
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink._law import MODES, REASONS
from law_bench import closed_loop, law, run, signals

PRECISIONS = ("double", "single")
ENCODER, GAUGE, REFERENCE, MISSED, REPEATED = 1, 2, 4, 8, 16
LIMITED, SATURATED, STARTED, RESIDUAL = 32, 64, 128, 256
RINGING = 1024
ALL = 2**32 - 1
COUNT = 400
# law_state of law.h: fourteen words, then reals, of which the first twenty are modes;
# the last of the following three is the motor reference.
WORDS, FORWARD_MODE, MODES_HELD = 14, 8, 20
MOTOR_REFERENCE = MODES_HELD + len(("error", "reference", "motor_reference")) - 1


def quiet(count: int = COUNT) -> NDArray[np.float64]:
    """An arm at rest at 0.3 rad, with a gauge that reads a small constant."""
    rows = np.zeros((5, count))
    rows[0] = rows[2] = 0.3
    rows[3] = 0.02
    return rows


def ended(outputs: Any) -> tuple[str, str]:
    return MODES[outputs.mode[-1]], REASONS[outputs.reason[-1]]


@pytest.mark.parametrize("precision", PRECISIONS)
def test_clean_signals_raise_nothing(precision: str) -> None:
    rows = quiet(100_000)
    rows[3] += 0.01 * np.random.default_rng(5).standard_normal(100_000)
    outputs = run(law(precision), rows)
    assert outputs.flags[0] == STARTED
    assert not np.any(outputs.flags[1:] & (ALL ^ LIMITED))
    assert np.all(outputs.mode == 1)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 50.0, 0.3 + 2 * np.pi])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_three_bad_encoder_samples_are_ridden_through(
    precision: str, bad: float
) -> None:
    rows = quiet()
    clean = run(law(precision), rows)
    rows[2, 100:103] = bad
    outputs = run(law(precision), rows)
    assert np.flatnonzero(outputs.flags & ENCODER).tolist() == [100, 101, 102]
    np.testing.assert_array_equal(outputs.voltage, clean.voltage)
    assert ended(outputs) == ("run", "none")


@pytest.mark.parametrize("bad", [np.nan, np.inf, 57.3 * 0.3])
def test_a_lost_encoder_switches_the_drive_off(bad: float) -> None:
    rows = quiet()
    rows[2, 100:] = bad
    outputs = run(law(), rows)
    assert ended(outputs) == ("off", "encoder")
    assert int(np.argmax(outputs.mode == 4)) == 104
    assert np.all(outputs.voltage[104:] == 0)
    assert np.all(outputs.motor_reference[104:] == outputs.motor_reference[104])


def test_a_trip_stays_when_the_fault_is_gone() -> None:
    rows = quiet()
    rows[2, 100:110] = np.nan
    assert ended(run(law(), rows)) == ("off", "encoder")


@pytest.mark.parametrize("bad", [np.nan, np.inf, 4.1, 3.0])
def test_single_bad_gauge_samples_are_ridden_through(bad: float) -> None:
    rows = quiet()
    clean = run(law(), rows)
    rows[3, 100:103] = bad
    outputs = run(law(), rows)
    assert np.flatnonzero(outputs.flags & GAUGE).tolist() == [100, 101, 102]
    np.testing.assert_array_equal(outputs.motor_reference, clean.motor_reference)
    assert ended(outputs) == ("run", "none")


MOVE = signals(1500)
START = 90  # a fault in the middle of the move


def test_the_closed_loop_without_a_fault_is_clean() -> None:
    tip, outputs = closed_loop(law(), MOVE)
    assert not np.any(outputs.flags[1:] & (ALL ^ LIMITED ^ SATURATED))
    assert ended(outputs) == ("run", "none")
    assert abs(tip[-1] - 1.0) < 5e-3


def test_a_gauge_that_is_lost_from_the_start_has_as_many_periods_as_later() -> None:
    rows = quiet()
    rows[3] = np.nan
    outputs = run(law(), rows)
    assert ended(outputs) == ("degraded", "gauge")
    assert int(np.argmax(outputs.mode == 2)) == law().limits.bad_limit - 1


@pytest.mark.parametrize("bad", [np.nan, 4.1, 3.9])
def test_a_lost_gauge_degrades_to_feed_forward(bad: float) -> None:
    tip, outputs = closed_loop(
        law(), MOVE, lambda k, a, t: (a, bad if k >= START else t)
    )
    assert ended(outputs) == ("degraded", "gauge")
    assert int(np.argmax(outputs.mode == 2)) == START + 4
    # the correction has been faded out after 50 periods: the feed-forward alone ends
    # exactly at the reference
    assert outputs.motor_reference[-1] == pytest.approx(1.0, abs=1e-3)
    assert np.abs(tip - MOVE[0]).max() < 0.25


def test_a_faded_correction_is_exactly_gone() -> None:
    tips = [
        closed_loop(
            law(), MOVE, lambda k, a, t: (a, np.nan if k >= START else t), frequency=w
        )[1]
        for w in (9.0, 14.0)
    ]
    later = START + 4 + 50
    np.testing.assert_array_equal(
        tips[0].motor_reference[later:], tips[1].motor_reference[later:]
    )


def test_a_stuck_gauge_is_seen_in_a_move_and_not_at_rest() -> None:
    stuck: list[float] = []

    def freeze(k: int, angle: float, torque: float) -> tuple[float, float]:
        stuck.append(torque if k <= START else stuck[-1])
        return angle, stuck[-1]

    tip, outputs = closed_loop(law(), MOVE, freeze)
    assert ended(outputs) == ("degraded", "gauge stuck")
    assert np.abs(tip - MOVE[0]).max() < 0.25
    assert ended(run(law(), quiet(100_000))) == ("run", "none")


def test_a_stuck_encoder_switches_the_drive_off_within_20_samples() -> None:
    stuck: list[float] = []

    def freeze(k: int, angle: float, torque: float) -> tuple[float, float]:
        stuck.append(angle if k <= START else stuck[-1])
        return stuck[-1], torque

    _, outputs = closed_loop(law(), MOVE, freeze)
    assert ended(outputs) == ("off", "motor away from its model")
    assert int(np.argmax(outputs.mode == 4)) - START <= 20
    assert ended(run(law(), quiet(100_000))) == ("run", "none")


def test_an_encoder_in_degrees_or_swapped_channels_switch_the_drive_off() -> None:
    _, outputs = closed_loop(law(), MOVE, lambda k, a, t: (57.3 * a, t))
    assert ended(outputs)[0] == "off"
    _, outputs = closed_loop(law(), MOVE, lambda k, a, t: (t, a))
    assert ended(outputs)[0] == "off"


def test_gauge_spikes_are_rejected() -> None:
    spikes = np.random.default_rng(2).random(MOVE.shape[1]) < 0.01
    clean, _ = closed_loop(law(), MOVE)
    tip, outputs = closed_loop(law(), MOVE, lambda k, a, t: (a, t + 3.0 * spikes[k]))
    assert ended(outputs) == ("run", "none")
    assert np.abs(tip - MOVE[0]).max() < 1.05 * np.abs(clean - MOVE[0]).max()
    assert abs(tip[-1] - 1.0) < 5e-3


@pytest.mark.parametrize("lost", [1, 3])
def test_lost_samples_of_both_sensors_are_ridden_through(lost: int) -> None:
    clean, _ = closed_loop(law(), MOVE)
    tip, outputs = closed_loop(
        law(),
        MOVE,
        lambda k, a, t: (np.nan, np.nan) if START <= k < START + lost else (a, t),
    )
    assert ended(outputs) == ("run", "none")
    assert np.abs(tip - MOVE[0]).max() < 1.1 * np.abs(clean - MOVE[0]).max()


def test_a_blocked_link_holds() -> None:
    _, outputs = closed_loop(
        law(), quiet(1000), lambda k, a, t: (a, t + 0.02 * np.clip(k - 200, 0, 125))
    )
    assert ended(outputs) == ("hold", "link overloaded")
    held = outputs.mode == 3
    assert np.ptp(outputs.motor_reference[held]) == 0


@pytest.mark.parametrize("stops", [False, True])
def test_a_vibration_that_goes_on_is_flagged_until_it_ends_and_stops_where_asked(
    stops: bool,
) -> None:
    limits = replace(law().limits, stop_ringing=stops)
    half = limits.block_limit / 1.5  # [periods] of the link
    k = np.arange(round(70 * half))
    swing = 2.0 * limits.swing_angle * law().stiffness * np.sin(np.pi * k / half)
    rows = quiet(k.size)
    rows[3] += np.where(k < 40 * half, swing, 0.0)
    outputs = run(replace(law(), limits=limits), rows)
    flagged = np.flatnonzero(outputs.flags & RINGING)
    assert 8 * half < flagged[0] < 10 * half
    if stops:
        assert ended(outputs) == ("hold", "tip vibrates")
    else:
        assert np.all(np.diff(flagged) == 1) and 40 < flagged[-1] / half < 56
        assert ended(outputs) == ("run", "none")
    decaying = quiet(k.size)
    decaying[3] += swing * np.exp(-k / (3 * half))
    outputs = run(replace(law(), limits=limits), decaying)
    assert not np.any(outputs.flags & RINGING) and ended(outputs) == ("run", "none")


@pytest.mark.parametrize("bad", [np.nan, np.inf, 100.0])
def test_an_unusable_reference_is_held(bad: float) -> None:
    rows = quiet()
    rows[0, 100:] = bad
    outputs = run(law(), rows)
    assert np.all(outputs.flags[100:] & REFERENCE)
    assert np.all(np.abs(outputs.motor_reference - 0.3) < 1e-12)


def test_an_unusable_acceleration_counts_as_zero() -> None:
    rows = quiet()
    rows[1, 100:] = np.nan
    outputs = run(law(), rows)
    assert np.all(np.abs(outputs.motor_reference - 0.3) < 1e-12)


def test_a_far_reference_is_approached_at_the_largest_speed() -> None:
    rows = quiet(1000)
    rows[0] = 3.3
    outputs = run(law(equipped=False), rows)
    made = law(equipped=False)
    steps = np.diff(outputs.motor_reference)
    assert np.all(np.abs(steps) <= made.limits.motor_step * (1 + 1e-12))
    assert abs(outputs.motor_reference[0] - 0.3) <= made.limits.motor_step
    assert outputs.flags[1] & REFERENCE


@pytest.mark.parametrize("precision", PRECISIONS)
def test_missed_periods_are_ridden_through_up_to_five(precision: str) -> None:
    rows = quiet()
    for missed, end in ((5, ("run", "none")), (6, ("off", "missed periods"))):
        ticks = np.arange(1, COUNT + 1)
        ticks[200:] += missed
        outputs = run(law(precision), rows, ticks=ticks)
        assert outputs.flags[200] & MISSED
        assert ended(outputs) == end


@pytest.mark.parametrize("jump", [0, -1, -100, 2**31 + 5])
def test_a_repeated_or_backward_period_does_nothing(jump: int) -> None:
    rows = signals(COUNT)
    ticks = np.arange(1, COUNT + 1)
    once = run(law(), np.delete(rows, 201, axis=1), ticks=np.delete(ticks, 200))
    ticks = np.concatenate([ticks[:201], ticks[200:-1]])
    ticks[201] = ticks[200] + jump
    outputs = run(law(), rows, ticks=ticks)
    assert outputs.flags[201] == REPEATED
    assert outputs.motor_reference[201] == outputs.motor_reference[200]
    np.testing.assert_array_equal(
        outputs.motor_reference[202:], once.motor_reference[201:]
    )


@pytest.mark.parametrize("step", [0, -1, -5])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_clock_that_stands_or_runs_backwards_switches_the_drive_off(
    precision: str, step: int
) -> None:
    """The law tolerates as many repeated calls as missed periods; the next one latches."""
    made, rows = law(precision), quiet()
    ticks = np.arange(1, COUNT + 1)
    ticks[200:] = 200 + step * np.arange(1, COUNT - 199)
    outputs = run(made, rows, ticks=ticks)
    allowed = made.limits.missed_limit
    assert np.all(outputs.mode[: 200 + allowed] == 1)
    assert np.all(outputs.voltage[1 : 200 + allowed] != 0)
    assert np.all(outputs.mode[200 + allowed :] == 4)
    assert np.all(outputs.voltage[200 + allowed :] == 0)
    assert ended(outputs) == ("off", "missed periods")


def test_a_caller_that_calls_twice_in_every_period_is_ridden_through() -> None:
    rows = quiet()
    rows[0] += 0.05 * np.sin(0.05 * np.arange(COUNT))
    rows[3] += 0.01 * (-1.0) ** np.arange(COUNT)
    once = run(law(), rows)
    twice = run(
        law(), np.repeat(rows, 2, axis=1), ticks=np.repeat(np.arange(1, COUNT + 1), 2)
    )
    np.testing.assert_array_equal(twice.motor_reference[::2], once.motor_reference)
    assert np.all(twice.mode[::2] == once.mode)
    assert once.mode[100] == 1


def test_a_clock_that_was_set_back_is_followed_at_once_and_one_that_runs_backwards_is_not() -> (
    None
):
    rows = quiet()
    rows[0] += 0.05 * np.sin(0.05 * np.arange(COUNT))
    back = np.arange(1, COUNT + 1)
    back[200:] -= 3
    once = run(law(), rows, ticks=back)
    assert np.flatnonzero(once.flags & REPEATED).tolist() == [200]
    assert np.all(once.mode == 1) and not np.any(once.flags & MISSED)
    assert (
        once.motor_reference[200]
        == once.motor_reference[199]
        != once.motor_reference[201]
    )
    backwards = run(law(), rows, ticks=1000 - np.arange(COUNT))
    assert np.all(backwards.mode[1:6] == 1) and np.all(backwards.mode[6:] == 4)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_motor_whose_encoder_is_lost_goes_on_as_its_model_does(
    precision: str,
) -> None:
    """Four lost samples at full speed, during which the motor turns by 0.03 rad."""
    made, move = law(precision), fl.smooth_step(1.0, 1.2, 0.1)
    time = made.period * np.arange(COUNT)
    rows = np.array([move.angle(time), move.acceleration(time)])
    lost = range(172, 176)
    clean, _ = closed_loop(made, rows)
    tips, outputs = closed_loop(
        made, rows, lambda k, angle, torque: (np.nan if k in lost else angle, torque)
    )
    assert np.flatnonzero(outputs.flags & ENCODER).tolist() == list(lost)
    assert set(outputs.mode) == {1}
    assert np.abs(tips - clean).max() < 0.002


def flipped(state: bytes, word: int, bit: int) -> bytes:
    """The state with one bit of its 32-bit words flipped: 0 stamp, 1 mode, 2 reason, 3
    tick ...
    """
    damaged = bytearray(state)
    damaged[4 * word + bit // 8] ^= 1 << (bit % 8)
    return bytes(damaged)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_no_flipped_bit_of_a_word_freezes_the_law(precision: str) -> None:
    """Ten periods later the law is off, or its command follows the reference again."""
    made, rows = law(precision), quiet(120)
    rows[0, 100:] += 0.001 * np.arange(20)
    state, _ = made.run(made.initial_state(), *rows[:, :100])
    _, clean = made.run(state, *rows[:, 100:120], first_tick=101)
    assert clean.motor_reference[-1] > 0.31 and clean.mode[10] == 1
    for word in range(12):
        for bit in range(32):
            _, outputs = made.run(
                flipped(state, word, bit), *rows[:, 100:120], first_tick=101
            )
            moved = (
                np.abs(outputs.motor_reference[10:] - clean.motor_reference[10:])
                < 0.005
            )
            assert outputs.mode[10] == 4 or np.all(moved), (word, bit)


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("mode", [2, 3, 4])
def test_no_flipped_bit_starts_a_tripped_drive(precision: str, mode: int) -> None:
    """No flip of a single bit of the memory leads back to a less severe mode, nor do
    flips of two bits of stamp and mode.
    """
    made, rows = law(precision), quiet(104)
    state, _ = made.run(made.initial_state(), *rows[:, :100])
    tripped = state[:4] + bytes([mode]) * 4 + state[8:]
    _, outputs = made.run(tripped, *rows[:, 100:], first_tick=101)
    assert np.all(outputs.mode == mode)
    once = [(bit,) for bit in range(8 * len(state))]
    for bits in (*once, *itertools.combinations(range(64), 2)):
        damaged = tripped
        for bit in bits:
            damaged = flipped(damaged, bit // 32, bit % 32)
        _, outputs = made.run(damaged, *rows[:, 100:], first_tick=101)
        assert np.all(outputs.mode >= mode), bits


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("mode", [1, 2, 3])
def test_memory_that_the_last_period_did_not_leave_begins_anew_in_its_mode(
    precision: str, mode: int
) -> None:
    """The motor reference restarts at the position of the motor, whatever the memory
    contains, and no mode is left.
    """
    made, rows = law(precision), quiet(140)
    state, _ = made.run(made.initial_state(), *rows[:, :130])
    damaged = bytearray(state[:4] + bytes([mode]) * 4 + state[8:])
    width = 4 if precision == "single" else 8
    place = 4 * WORDS + width * MOTOR_REFERENCE
    damaged[place + width - 2] ^= 1 << 6
    _, outputs = made.run(bytes(damaged), *rows[:, 130:], first_tick=131)
    assert outputs.flags[0] & STARTED and not np.any(outputs.flags[1:] & STARTED)
    np.testing.assert_allclose(outputs.motor_reference, 0.3, atol=1e-6)
    assert set(outputs.mode) == {mode}


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("mode", [0, FORWARD_MODE])
def test_a_mode_that_no_input_explains_begins_anew_though_the_sum_is_right(
    precision: str, mode: int
) -> None:
    """Two errors that cancel in the sum of the memory: the arm still stands."""
    made, rows = law(precision), np.zeros((5, 40))
    state, _ = made.run(made.initial_state(), *rows[:, :10])
    reals = np.frombuffer(
        state[4 * WORDS :], np.float32 if precision == "single" else np.float64
    ).copy()
    reals[[mode, -1]] += 2.0**13
    damaged = state[: 4 * WORDS] + reals.tobytes()
    _, outputs = made.run(damaged, *rows[:, 10:], first_tick=11)
    assert not np.any(outputs.flags & STARTED)
    np.testing.assert_allclose(outputs.motor_reference[3:], 0.0, atol=1e-6)


def test_a_flipped_bit_of_the_mode_does_not_stop_a_drive_that_runs() -> None:
    made, rows = law(), quiet()
    state, _ = made.run(made.initial_state(), *rows[:, :100])
    _, clean = made.run(state, *rows[:, 100:], first_tick=101)
    assert np.all(clean.mode == 1)
    for bit in range(32):
        _, outputs = made.run(flipped(state, 1, bit), *rows[:, 100:], first_tick=101)
        np.testing.assert_array_equal(outputs.motor_reference, clean.motor_reference)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_nothing_that_has_died_away_is_left_as_a_denormal_number(
    precision: str,
) -> None:
    """This includes a complex pair, of which either half would restore the other one."""
    made, rows = law(precision), quiet(60_000)
    turning = made.correction._replace(
        pair_poles=(-0.8054407 + 0.5280959j,), pair_gains=(0.02 - 0.03j,)
    )
    made = replace(made, correction=turning)
    rows[3, :50] += 0.05
    state, outputs = made.run(made.initial_state(), *rows)
    real = np.float32 if precision == "single" else np.float64
    reals = np.frombuffer(state, dtype=np.uint8)[4 * WORDS :].view(real)
    assert np.all(outputs.mode == 1)
    assert not np.any((reals != 0) & (np.abs(reals) < np.finfo(reals.dtype).tiny))
    assert not np.any(reals[:MODES_HELD])


def test_the_period_counter_may_wrap_around() -> None:
    rows = signals(COUNT)
    plain = run(law(), rows)
    wrapped = run(law(), rows, first_tick=2**32 - 50)
    np.testing.assert_array_equal(plain.motor_reference, wrapped.motor_reference)
    assert not np.any(wrapped.flags & (MISSED | REPEATED))


def test_a_start_without_an_encoder_waits() -> None:
    rows = quiet()
    rows[2, :50] = np.nan
    outputs = run(law(), rows)
    assert np.all(outputs.mode[:50] == 0)
    assert np.all(outputs.voltage[:50] == 0)
    assert outputs.flags[50] & STARTED
    assert outputs.motor_reference[50] == pytest.approx(0.3)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_start_in_motion_has_no_bump(precision: str) -> None:
    rows = signals(1000)[:, 90:]  # in the middle of the move
    outputs = run(law(precision), rows)
    made = law(precision)
    assert abs(outputs.motor_reference[0] - rows[2, 0]) <= made.limits.motor_step
    assert abs(outputs.voltage[0]) < 1.0


@pytest.mark.parametrize("fill", [0x00, 0xFF, 0x7F])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_wiped_state_starts_anew_at_once(precision: str, fill: int) -> None:
    made, rows = law(precision), quiet()
    state, _ = made.run(made.initial_state(), *rows)
    _, outputs = made.run(bytes([fill]) * len(state), *rows)
    assert np.all(np.isfinite(outputs.motor_reference))
    assert outputs.flags[0] & STARTED
    np.testing.assert_allclose(outputs.motor_reference, 0.3, atol=1e-6)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_any_flipped_bit_of_the_state_leaves_the_output_in_its_limits(
    precision: str,
) -> None:
    made, rows = law(precision), signals(300)
    state, _ = made.run(made.initial_state(), *rows[:, :100])
    limit = made.limits.motor_limit * (1 + 1e-6)
    for bit in range(0, 8 * len(state), 3):
        damaged = bytearray(state)
        damaged[bit // 8] ^= 1 << (bit % 8)
        _, outputs = made.run(bytes(damaged), *rows[:, 100:], first_tick=101)
        assert np.all(np.abs(outputs.motor_reference) <= limit)
        assert np.all(np.abs(outputs.voltage) <= 10.0)


@pytest.mark.parametrize(
    ("offset", "reason"),
    [(0, 1), (4, 2), (8, 2), (12, 3), (16, 3), (20, 3), (48, 3), (100, 3), (-1, 3)],
)
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_damaged_block_refuses_to_start(
    precision: str, offset: int, reason: int
) -> None:
    from fraclink import _kernels

    made = law(precision)
    damaged = bytearray(made.block)
    damaged[offset] ^= 4
    state, found = _kernels.law_init(bytes(damaged), precision == "single")
    assert found == reason
    outputs, marks = np.empty((5, 50)), np.empty((3, 50), dtype=np.uint32)
    _kernels.law_run(
        bytes(damaged),
        state,
        np.arange(1, 51, dtype=np.uint32),
        quiet(50),
        outputs,
        marks,
        precision == "single",
    )
    assert np.all(marks[0] == 0)
    assert np.all(marks[1] == reason)
    assert np.all(outputs[:2] == 0)


def test_saturation_does_not_wind_up() -> None:
    after = []
    for saturated in (1500, 4500):
        rows = quiet(saturated + 200)
        # the motor lags and cannot catch up: the integral reaches the limit in 5 s
        rows[2, 5:] = 0.3 - 0.05
        rows[2, saturated:] = 0.3 + 0.05
        outputs = run(law(), rows)
        assert outputs.voltage[saturated - 1] == 10.0
        assert outputs.flags[saturated - 1] & SATURATED
        after.append(outputs.voltage[saturated:])
    # an integral that continued would add 6 V in 12 s
    np.testing.assert_allclose(after[0], after[1], atol=0.01)


def test_no_reversal_of_the_reference_fills_the_states_of_the_feed_forward() -> None:
    made = law()
    poles = np.array([pole.real for pole in made.feedforward.poles])
    assert np.all((poles > 0.0) & (poles < 1.0))
    # at the full acceleration from one full speed to the other, in any rhythm
    draw, largest = np.random.default_rng(3), 0.0
    limits, most = made.limits, made.limits.acceleration_limit * made.period
    speed = limits.motor_step / (3.0 * made.period)
    for longest in (5, 50, 500):
        state, at = np.zeros(poles.size), 0.0
        for _ in range(20):
            goal = speed * draw.choice([-1.0, 1.0])
            for _ in range(draw.integers(1, longest)):
                change = np.clip(goal - at, -most, most)
                at += change
                state = poles * state + change / made.period
                largest = max(largest, float(np.max(np.abs(state))))
    assert 0.4 < largest / limits.forward_limit < 0.68
