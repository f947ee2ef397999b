"""Metrics and verdicts on signals whose values are known by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fraclink._simulate.metrics import (
    Signals,
    judge,
    measure,
)

PERIOD, ENDED, VIBRATION = 0.01, 1.0, 0.5
TIME = PERIOD * np.arange(601)
REFERENCE = np.clip(TIME / ENDED, 0.0, 1.0)
RUNNING = np.ones(TIME.size, dtype=np.uint32)
NO_REASON = np.zeros(TIME.size, dtype=np.uint32)


def signals(
    tip: np.ndarray,
    *,
    motor_reference: np.ndarray | None = None,
    voltage: np.ndarray | None = None,
    saturated: np.ndarray | None = None,
    mode: np.ndarray = RUNNING,
) -> Signals:
    nothing = np.zeros_like(TIME)
    flags = 64 * np.asarray(
        nothing if saturated is None else saturated, dtype=np.uint32
    )
    rows = (
        REFERENCE,
        tip,
        nothing if motor_reference is None else motor_reference,
        nothing if voltage is None else voltage,
        flags,
        mode,
        NO_REASON,
    )
    return Signals(
        *(row[None, :] for row in rows),
        period=PERIOD,
        ended=np.array([ENDED]),
        vibration_period=np.array([VIBRATION]),
    )


def measured(tip: np.ndarray, **changes: np.ndarray) -> Any:
    return measure(signals(tip, **changes))


def judged(tip: np.ndarray, **changes: np.ndarray) -> Any:
    block = signals(tip, **changes)
    return judge(block, measure(block))


def vibrating(amplitude: np.ndarray | float) -> np.ndarray:
    return np.asarray(REFERENCE + amplitude * np.sin(2 * math.pi * TIME / VIBRATION))


def test_the_tip_settles_with_its_last_sample_outside_the_band() -> None:
    tip = REFERENCE.copy()
    tip[300] = 1.021  # 2.1 % of the move
    tip[400] = 1.019
    assert measured(tip).settling_time == pytest.approx(TIME[301])
    tip[-1] = 0.9
    assert measured(tip).settling_time == math.inf


def test_a_vibration_is_unstable_where_it_grows_and_only_after_the_move() -> None:
    growing = judged(vibrating(0.02 * np.exp(0.5 * (TIME - ENDED))))
    assert not growing.passed
    assert "0.5" in growing.reason
    # Large while the arm moves, small afterwards: what happened before the end of the
    # move is no growth.
    assert judged(vibrating(np.where(TIME < ENDED, 0.3, 0.001))).passed


def test_a_vibration_that_grows_fails_while_it_is_still_within_the_band() -> None:
    """Settled by its size but unstable by its growth: a vibration that is still small
    will become destructive.
    """
    tip = vibrating(0.004 * np.exp(0.2 * (TIME - ENDED)))
    assert measured(tip).settling_time < 1.5
    verdict = judged(tip)
    assert (
        not verdict.passed
        and verdict.reason == "unstable: the vibration grows at 0.2 1/s"
    )
    assert measured(
        vibrating(0.004 * np.exp(-0.2 * (TIME - ENDED)))
    ).growth == pytest.approx(-0.2, rel=1e-3)


@pytest.mark.slow
def test_a_vibration_that_noise_drives_does_not_grow() -> None:
    """A resonance excited by noise has a fluctuating envelope, which rises as often as
    it falls.
    """
    pole = np.exp((-1.0 + 2j * math.pi / VIBRATION) * PERIOD)
    rng = np.random.default_rng(5)
    wrong = 0
    for _ in range(500):
        state, ringing = 0j, np.empty_like(TIME)
        for k, push in enumerate(rng.standard_normal(TIME.size)):
            state = pole * state + push
            ringing[k] = 1e-3 * state.real
        wrong += measured(REFERENCE + ringing).growth > 0.0
    assert wrong == 0


def test_a_vibration_that_lasts_without_growing_has_not_settled() -> None:
    # Small until a period after the move, then slowly decaying: across this step it
    # would seem to grow.
    dying = 0.1 * np.exp(-0.05 * TIME)
    verdict = judged(vibrating(np.where(TIME < ENDED + VIBRATION, 0.001, dying)))
    assert not verdict.passed
    assert verdict.reason.startswith("not settled; the tip is still 0.07")


def test_a_tip_that_is_held_back_by_the_limit_is_called_saturated() -> None:
    tip = 0.5 * REFERENCE
    for share, word in ((0.3, "saturated"), (0.1, "not settled")):
        verdict = judged(tip, saturated=TIME / TIME[-1] < share)
        assert verdict.reason.startswith(word)


def test_a_voltage_at_its_limit_behind_the_move_does_not_pass_however_still_the_tip() -> (
    None
):
    # An unstable loop above the modes of the link: the limit keeps it bounded, and the
    # tip moves by less than 2 %.
    for share, passed in ((0.0, True), (0.05, True), (0.5, False)):
        at_limit = (np.arange(TIME.size) % 20 < 20 * share) & (TIME > ENDED)
        verdict = judged(REFERENCE, saturated=at_limit)
        assert verdict.passed == passed
    assert verdict.reason == (
        "the voltage does not come to rest: it is at its limit in 50 % of the periods after the move"
    )


@pytest.mark.parametrize(("ended", "passed"), [(5.41, False), (5.42, True)])
def test_a_voltage_at_its_limit_counts_once_the_reference_rests(
    ended: float, passed: bool
) -> None:
    """The last tenth of 601 periods begins at 5.41 s: a reference that is at rest from
    then on is at rest in all of it.
    """
    at_limit = np.arange(TIME.size) % 2 == 0
    block = replace(signals(REFERENCE, saturated=at_limit), ended=np.array([ended]))
    assert judge(block, measure(block)).passed is passed


def test_a_trip_names_mode_reason_and_time() -> None:
    mode = RUNNING.copy()
    mode[250:] = 4
    verdict = judged(np.where(TIME < 2.5, REFERENCE, 0.0), mode=mode)
    assert not verdict.passed
    assert verdict.reason.startswith("tripped: the law goes to off")
    assert verdict.reason.endswith("at 2.5 s")


def test_an_unstable_run_says_when_the_law_trips_and_a_tip_that_is_no_number_is_unstable() -> (
    None
):
    mode = RUNNING.copy()
    mode[550:] = 4
    growing = vibrating(0.02 * np.exp(0.5 * (TIME - ENDED)))
    assert (
        judged(growing, mode=mode).reason
        == "unstable: the vibration grows at 0.5 1/s; the law trips at 5.5 s"
    )
    assert judged(growing).reason == "unstable: the vibration grows at 0.5 1/s"
    lost = REFERENCE.copy()
    lost[500:] = math.nan
    with np.errstate(invalid="ignore"):
        assert judged(lost).reason.startswith("unstable")


@pytest.mark.slow
def test_the_verdict_says_how_far_away_the_tip_still_is_and_when() -> None:
    tip = REFERENCE - 0.25 * (TIME > 5.9)
    assert judged(tip).reason == "not settled; the tip is still 0.25 rad away at 6 s"
    verdict = judged(REFERENCE)
    assert verdict.passed and verdict.reason.startswith("settled in 0.")
