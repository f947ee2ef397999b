"""What each fault does to a run, and what is measured of it: rows, values and limits
written out by hand.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fraclink.trials import _fault_arm as fault_arm
from fraclink.trials import _fault_sensors as fault_sensors
from fraclink.trials._endurance import Upset, _bits
from fraclink.trials._fault_checks import (
    Check,
    Evidence,
    bounded,
    final,
    flagged,
    limit_cycle,
    only,
    peak,
    peak_over_best,
    peak_ratio,
    reacts,
    settled,
    shared_checks,
)
from fraclink.trials._fault_trial import (
    REALS,
    WORDS,
    Case,
    Phase,
    TrialSignals,
)

IDLE, RUN, DEGRADED, HOLD, OFF = range(5)
BAD_ENCODER, BAD_GAUGE = 5, 6  # reasons of law.h
STARTED = 128
PERIOD = 0.004
COUNT = 1000
NAN = math.nan

Real = NDArray[np.float64]


def signals(**own: Any) -> TrialSignals:
    """A run of COUNT periods in mode run at zero, but for what is given; a number
    stands for all periods.
    """
    reals = (
        "wanted",
        "tip",
        "motor",
        "torque",
        "encoder",
        "gauge",
        "command",
        "voltage",
        "asked",
    )
    whole = dict.fromkeys(reals, 0.0) | {"mode": RUN, "reason": 0, "flags": 0} | own
    kinds: dict[str, Any] = dict.fromkeys(("mode", "reason", "flags"), np.uint32)
    made = {
        name: np.array(np.broadcast_to(value, COUNT), dtype=kinds.get(name, float))
        for name, value in whole.items()
        if name not in ("finished", "law_state")
    }
    rest: dict[str, Any] = {
        "law_state": own.get("law_state", b""),
        "finished": own.get("finished", True),
    }
    return TrialSignals(time=PERIOD * np.arange(COUNT), **made, **rest)


def evidence(
    faulty: TrialSignals,
    clean: TrialSignals | None = None,
    *,
    row: int = 400,
    severity: int = 1,
    phase: Phase = "mid",
    marks: Any = (),
    best: TrialSignals | None = None,
    detail: str = "",
    law: Any = None,
    bench: Any = None,
) -> Evidence:
    marked = np.zeros(
        COUNT + 5, dtype=bool
    )  # a run that was cut is shorter than its trial
    marked[list(marks)] = True
    own: Any = law or SimpleNamespace(period=PERIOD)
    case = Case("F01", severity, 0.03, phase, 1)
    return Evidence(
        bench, case, own, row, marked, faulty, clean or signals(), detail, best
    )


def at(value: float, *rows: int, otherwise: float = 0.0) -> Real:
    """One value in some periods, and another in all that are left."""
    made = np.full(COUNT, otherwise)
    made[list(rows)] = value
    return made


def behind(row: int, value: float, before: float = 0.0) -> Real:
    """`before` up to a period, and `value` from it on."""
    return np.where(np.arange(COUNT) < row, before, value)


# ── one requirement
# ─────────────────────────────────────────────────────────────────────────────────────────


def test_a_check_passes_up_to_its_limit_and_not_without_a_number() -> None:
    assert (
        Check.at_most("x", 2.0, 2.0).passed
        and not Check.at_most("x", math.nextafter(2.0, 3.0), 2.0).passed
    )
    assert not Check.at_most("x", NAN, 2.0).passed
    assert str(Check.at_most("peak [rad]", 0.5, 0.4)) == "peak [rad]: 0.5 (limit 0.4)"


@pytest.mark.parametrize(
    ("mode", "reason", "words", "measured"),
    [
        (
            behind(419, OFF, RUN),
            BAD_ENCODER,
            "",
            20.0,
        ),  # the fault's own period counts as 1
        (behind(420, OFF, RUN), BAD_ENCODER, "", 21.0),
        (np.full(COUNT, RUN), BAD_ENCODER, " (never)", math.inf),
        (behind(410, HOLD, RUN), BAD_ENCODER, " (went hold)", math.inf),
        (behind(410, OFF, RUN), BAD_GAUGE, " (for gauge)", math.inf),
        (at(OFF, 410, 411, otherwise=RUN), BAD_ENCODER, " (did not latch)", math.inf),
    ],
)
def test_a_reaction_is_in_time_for_its_reason_and_lasts(
    mode: Real, reason: int, words: str, measured: float
) -> None:
    found = reacts(OFF, 20, BAD_ENCODER)(evidence(signals(mode=mode, reason=reason)))
    assert found == Check(
        f"periods until off{words}", measured, 20.0, passed=measured <= 20
    )


def test_a_reaction_for_any_reason_and_one_before_the_fault() -> None:
    early = evidence(signals(mode=behind(390, OFF, RUN), reason=BAD_GAUGE))
    assert early.reacted == 1 and reacts(OFF, 1)(early).passed
    assert evidence(signals()).reacted == -1
    assert evidence(signals(mode=behind(999, OFF, RUN), reason=BAD_GAUGE)).end == (
        "off",
        "gauge",
    )


def test_other_modes_are_counted_from_the_period_in_which_the_law_started() -> None:
    mode, flags = at(IDLE, 0, 1, 2, otherwise=RUN), at(STARTED, 3)
    assert only(RUN)(evidence(signals(mode=mode, flags=flags))).measured == 0
    assert only(RUN)(evidence(signals(mode=mode, flags=at(STARTED, 1)))).measured == 2
    assert only(RUN, IDLE)(evidence(signals(mode=mode, flags=at(STARTED, 1)))).passed
    assert not only(RUN)(evidence(signals(mode=at(OFF, 999, otherwise=RUN)))).passed


def test_every_marked_period_carries_its_flag_and_a_fault_that_never_came_fails() -> (
    None
):
    check = flagged(2, "gauge")
    assert check(evidence(signals(flags=at(6, 5, 6)), marks=(5, 6))).passed
    found = check(evidence(signals(flags=at(6, 5) + at(4, 6, 7)), marks=(5, 6, 7)))
    assert (found.name, found.measured, found.passed) == (
        "bad periods without the gauge flag",
        2.0,
        False,
    )
    assert check(evidence(signals(flags=2))).measured == 1.0
    assert check(
        evidence(signals(flags=at(2, 5)), marks=(5, COUNT + 2))
    ).passed  # the run was cut before


def test_peaks_are_compared_with_the_clean_run_or_with_a_law_that_knew() -> None:
    faulty, clean = signals(tip=at(-0.33, 500)), signals(tip=at(0.3, 2))
    e = evidence(faulty, clean)
    assert (e.peak, e.clean_peak) == (0.33, 0.3)
    assert (
        peak_ratio(1.1)(e).measured == pytest.approx(1.1) and peak_ratio(1.11)(e).passed
    )
    assert not peak_ratio(1.09)(e).passed
    for best, limit in ((None, 0.3), (0.2, 0.3), (-0.5, 0.5)):
        run = None if best is None else signals(tip=at(best, 7))
        found = peak_over_best(1.1)(evidence(faulty, clean, best=run))
        assert (found.measured, found.limit) == pytest.approx((0.33, 1.1 * limit))


def test_a_drive_that_is_cut_is_asked_how_far_the_tip_ran_on() -> None:
    """The reference stays where the move wanted it; the tip was at 0.1 rad and came to
    −0.15 rad.
    """
    run = signals(wanted=1.0, tip=behind(450, -0.15, 0.1))
    error = peak(0.4, phases=("mid",))(evidence(run))
    travel = peak(0.4, phases=("mid",))(evidence(run, phase="start"))
    assert (error.name, error.measured) == ("peak tip error [rad]", pytest.approx(1.15))
    assert (travel.name, travel.measured) == (
        "tip travel after the fault [rad]",
        pytest.approx(0.25),
    )
    assert peak(1.2)(evidence(run, phase="rest")).measured == pytest.approx(1.15)


def test_what_is_final_is_the_mean_of_the_last_second() -> None:
    e = evidence(
        signals(tip=behind(750, -0.03, 5.0) + 0.02 * (-1.0) ** np.arange(COUNT))
    )
    assert e.final == pytest.approx(0.03) == final(0.02)(e).measured
    assert not final(0.02)(e).passed and final(0.031)(e).passed


def test_a_run_that_was_cut_is_bounded_by_nothing() -> None:
    assert bounded(0.1)(evidence(signals(tip=at(0.1, 3)))).passed
    assert (
        bounded(0.1)(evidence(signals(tip=at(0.1, 3), finished=False))).measured
        == math.inf
    )
    assert settled(1.0)(evidence(signals(finished=False))).measured == math.inf


def test_recovery_ends_with_the_last_period_far_from_reference_and_clean_run() -> None:
    astray = signals(tip=at(0.021, 649), wanted=0.0)
    assert settled(1.0)(evidence(astray)) == Check(
        "recovery [s]", pytest.approx(1.0), 1.0, passed=True
    )
    assert not settled(1.0)(evidence(signals(tip=at(0.021, 650)))).passed
    assert settled(1.0)(evidence(signals(tip=at(0.02, 990)))).measured == 0.0
    assert (
        settled(1.0)(evidence(signals(tip=at(0.5, 399)))).measured == 0.0
    )  # before the fault
    # The move itself has an error of its own: near the clean run is near enough.
    assert settled(1.0)(evidence(astray, signals(tip=at(0.03, 649)))).measured == 0.0
    assert settled(1.0, band=0.03)(evidence(astray)).measured == 0.0


def test_a_limit_cycle_is_half_the_swing_of_the_last_two_seconds() -> None:
    tip = behind(500, 0.3, 9.0) + np.where(np.arange(COUNT) % 2, 0.002, -0.004)
    assert limit_cycle(2e-3)(evidence(signals(tip=tip))).measured == pytest.approx(
        0.003
    )


def judged(
    precision: str = "double", volts: float | None = 10.0, **own: Any
) -> list[Check]:
    limits = SimpleNamespace(motor_limit=2.0, motor_step=0.1)
    drive = None if volts is None else SimpleNamespace(voltage_limit=volts)
    law = SimpleNamespace(
        period=PERIOD, precision=precision, limits=limits, drive=drive
    )
    return list(shared_checks(evidence(signals(**own), law=law)))


def test_the_shared_criteria_at_their_limits() -> None:
    assert [check.limit for check in judged()] == pytest.approx([0.0, 2.0, 10.0, 0.1])
    assert [check.limit for check in judged(volts=None)][2] == math.inf
    assert judged()[1].limit == 2.0 * (1 + 1e-12) and judged("single")[
        1
    ].limit == 2.0 * (1 + 1e-6)
    assert judged()[3].limit == pytest.approx(0.1 + 1.1e-12, abs=1e-15)
    assert judged("single")[3].limit == pytest.approx(0.1 + 1.1e-6, abs=1e-12)
    lost = judged(command=at(NAN, 3), asked=at(math.inf, 8), voltage=at(NAN, 9))
    assert (
        lost[0].measured == 3.0 and not lost[0].passed and lost[3].measured == math.inf
    )
    assert judged(command=behind(500, -2.5))[1].measured == 2.5
    assert (
        judged(asked=at(-10.5, 9))[2].measured == 10.5
        and judged(voltage=at(-10.5, 9))[2].measured == 0.0
    )


def test_a_law_that_starts_anew_may_begin_anywhere() -> None:
    step = behind(500, 0.7)
    assert judged(command=step)[3].measured == pytest.approx(0.7)
    assert judged(command=step, flags=at(STARTED, 500))[3].measured == 0.0
    assert judged(command=step, flags=at(STARTED, 499))[3].measured == pytest.approx(
        0.7
    )


# ── what only one fault is measured by
# ──────────────────────────────────────────────────────────────────────


def test_a_held_motor_reference_does_not_move_after_the_reaction() -> None:
    mode = behind(405, OFF, RUN)
    moving = signals(mode=mode, command=np.minimum(np.arange(COUNT), 405.0))
    assert fault_sensors.held(evidence(moving)).passed
    later = signals(mode=mode, command=np.minimum(np.arange(COUNT), 407.0))
    assert fault_sensors.held(evidence(later)).measured == 2.0
    assert fault_sensors.held(evidence(signals())).measured == math.inf


def test_settling_is_counted_from_the_beginning_of_the_move() -> None:
    """The last period outside of 20 mrad is 2 s after the start of a move that begins
    at 1 s.
    """
    slow, quick = (
        signals(tip=at(0.03, 500) + at(0.02, 900)),
        signals(tip=at(-0.03, 450)),
    )
    assert fault_sensors.settling(evidence(slow, quick)).measured == pytest.approx(
        1.0 / 0.8
    )
    assert fault_sensors.settling(evidence(quick, quick)).limit == 1.02


def test_the_command_may_be_as_noisy_as_the_sensitivity_says() -> None:
    rng = np.random.default_rng(3)
    flat = SimpleNamespace(
        period=PERIOD,
        stiffness=1.5,
        frequency_response=lambda w: np.full(w.shape, 3.0 - 4j),
    )
    bench = SimpleNamespace(modulus_margin=0.8)
    command = behind(500, 0.0, 70.0) + 0.01 * rng.standard_normal(COUNT)
    found = fault_sensors.noise_bound(
        evidence(signals(command=command), law=flat, bench=bench, severity=2)
    )
    assert found.limit == pytest.approx(0.05 / 1.5 * 5.0 / 0.8)
    assert found.measured == pytest.approx(np.std(command[500:]))
    seen: list[Real] = []
    flat.frequency_response = lambda w: (seen.append(w), np.ones(w.shape))[1]  # type: ignore[func-returns-value]
    fault_sensors.noise_bound(evidence(signals(), law=flat, bench=bench))
    grid = (
        seen[0] * PERIOD / math.pi
    )  # the mean over the band up to Nyquist, by its middles
    assert (
        grid == pytest.approx((np.arange(grid.size) + 0.5) / grid.size, rel=1e-12)
        and grid.size >= 1000
    )


@pytest.mark.parametrize(("severity", "counts"), [(1, 8000), (2, 4000), (3, 2000)])
def test_a_coarse_encoder_may_be_wrong_by_a_count(severity: int, counts: int) -> None:
    found = fault_sensors.one_count(evidence(signals(tip=1e-3), severity=severity))
    assert (found.measured, found.limit) == pytest.approx((1e-3, 2 * math.pi / counts))


def test_jitter_may_cost_what_two_instants_are_apart_at_full_speed() -> None:
    clean = signals(
        wanted=0.5 * PERIOD * np.minimum(np.arange(COUNT), 600), tip=0.1
    )  # 0.5 rad/s at most
    found = fault_sensors.jitter_peak(evidence(signals(tip=0.2), clean))
    assert found.measured == pytest.approx(0.2)
    assert found.limit == pytest.approx(
        1.02 * np.abs(clean.error).max() + 2 * 0.5 * 1e-3
    )


@pytest.mark.parametrize(("severity", "periods"), [(1, 1), (2, 3), (3, 5)])
def test_a_gap_may_cost_what_the_motor_went_astray_in_it(
    severity: int, periods: int
) -> None:
    motor = at(-0.02, 400 + periods) + at(7.0, 399 + periods, 401 + periods)
    e = evidence(
        signals(motor=motor, tip=0.3), signals(motor=0.01, tip=0.2), severity=severity
    )
    assert fault_sensors.gap_peak(e).limit == pytest.approx(1.1 * 0.2 + 0.03)


@pytest.mark.parametrize(("severity", "periods"), [(1, 8), (2, 12), (3, 25)])
def test_a_law_that_was_not_called_is_off_at_its_first_call(
    severity: int, periods: int
) -> None:
    def calls(row: int, mode: int = OFF, reason: int = 9) -> float:
        run = signals(mode=behind(row, mode, RUN), reason=reason)
        return fault_sensors.off_at_once(evidence(run, severity=severity)).measured

    assert calls(400 + periods) == 1.0 and calls(401 + periods) == 2.0
    assert calls(400 + periods, mode=HOLD) == calls(400 + periods, reason=5) == math.inf
    never = fault_sensors.off_at_once(evidence(signals(reason=9), severity=severity))
    assert never.measured == math.inf and never.limit == 1.0


def test_overshoot_is_a_part_of_the_jump() -> None:
    run = signals(wanted=1.25, tip=at(1.30, 600, otherwise=1.0))
    for severity, jump in ((1, 0.25), (2, 0.5), (3, 1.0)):
        found = fault_sensors.overshoot(evidence(run, severity=severity))
        assert (found.measured, found.limit) == pytest.approx((0.05 / jump, 0.2))
    assert (
        fault_sensors.overshoot(evidence(signals(wanted=1.25, tip=1.0))).measured == 0.0
    )


def test_a_move_back_settles_over_that_of_a_law_that_was_never_asked_for_more() -> None:
    """From 12.2 s on, in a band of 15 mrad; the period after the last one outside
    counts.
    """
    slow = SimpleNamespace(period=0.02)  # 1000 periods are 20 s
    late, knew = (
        signals(tip=at(0.016, 659) + at(0.015, 900)),
        signals(tip=at(-0.016, 649)),
    )
    found = fault_sensors.recovery(evidence(late, best=knew, law=slow))
    assert (found.measured, found.limit) == pytest.approx((1.0 / 0.8, 1.2))


def test_a_law_that_refuses_its_block_says_why_in_every_period() -> None:
    check = fault_arm.refused(1, 2, 3)
    assert check(evidence(signals(mode=IDLE, reason=2), severity=2)).passed
    found = check(
        evidence(signals(mode=IDLE, reason=at(1, 7, 8, otherwise=3)), severity=3)
    )
    assert (found.name, found.measured) == ("periods not refused for reason 3", 2.0)
    assert (
        check(
            evidence(signals(mode=at(RUN, 7, otherwise=IDLE), reason=3), severity=3)
        ).measured
        == 1.0
    )


def test_a_law_that_is_not_started_gives_nothing() -> None:
    run = signals(command=at(-0.5, 7), asked=at(2.0, 900))
    assert fault_arm.silent(evidence(run)).measured == 2.0
    assert fault_arm.silent(evidence(run, marks=(6, 7))).measured == 0.5
    assert fault_arm.silent(evidence(run, marks=(6, 8))).passed


def test_a_restart_begins_where_the_motor_is() -> None:
    law = SimpleNamespace(period=PERIOD, limits=SimpleNamespace(motor_step=0.1))
    run = signals(command=at(0.7, 400, 425), encoder=at(0.75, 400) + at(0.5, 425))
    marks = np.zeros(COUNT, dtype=bool)
    marks[[400, 425]] = True
    found = fault_arm.bumpless(replace(evidence(run, law=law), marks=marks))
    assert (found.measured, found.limit) == pytest.approx((0.2, 0.1))


def test_a_blind_law_is_idle_in_every_marked_period() -> None:
    run = signals(mode=at(IDLE, 0, 1, otherwise=RUN))
    assert fault_arm.idle(evidence(run, marks=(0, 1))).passed
    assert fault_arm.idle(evidence(run, marks=(0, 1, 2, 3))).measured == 2.0


@pytest.mark.parametrize(("answer", "reversed_passes", "clean_passes"), [
    ("gauge reversed", True, False), ("none", False, True), ("gauge dead", False, False),
])  # fmt: skip
def test_the_wiring_test_refuses_what_is_reversed_and_nothing_else(
    answer: str, reversed_passes: bool, clean_passes: bool
) -> None:
    law = SimpleNamespace(period=PERIOD, check_wiring=lambda encoder, gauge: answer)
    e = evidence(signals(), law=law)
    assert fault_arm.wiring_answer(e).passed == reversed_passes
    assert fault_arm.wiring_clean(e).passed == clean_passes
    assert (
        answer in fault_arm.wiring_answer(e).name
        and answer in fault_arm.wiring_clean(e).name
    )


def test_exchanged_sensors_are_switched_off_or_do_no_harm_while_they_are_credible() -> (
    None
):
    off = signals(mode=behind(600, OFF, RUN), reason=BAD_ENCODER, tip=2.0)
    assert fault_arm.swap_reaction(evidence(off)).passed
    for_a_while = fault_arm.swap_reaction(
        evidence(signals(tip=at(0.29, 500)), detail="for a while")
    )
    assert (
        for_a_while.passed
        and for_a_while.limit == 0.3
        and "credible" in for_a_while.name
    )
    assert not fault_arm.swap_reaction(evidence(signals(tip=at(0.31, 500)))).passed
    assert not fault_arm.swap_reaction(evidence(signals(), detail="for ever")).passed


def test_a_blow_is_recovered_from_and_a_stop_is_held_for_its_torque() -> None:
    law = SimpleNamespace(period=PERIOD, limits=SimpleNamespace(torque_trip=1.5))
    blow = signals(tip=at(0.1, 500))
    assert (
        fault_arm.hit_reaction(evidence(blow, law=law, severity=2)).name
        == "recovery [s]"
    )
    blocked = signals(mode=behind(500, HOLD, RUN), reason=10, torque=at(-1.25, 480))
    found = fault_arm.hit_reaction(evidence(blocked, law=law, severity=3))
    assert (
        found.passed
        and found.name == "periods until hold; torque reached 1.25 of 1.5 N·m"
    )
    assert not fault_arm.hit_reaction(evidence(blow, law=law, severity=3)).passed


@pytest.mark.parametrize(
    ("severity", "share", "stiffness"),
    [(1, 0.5, 10.0), (2, 1.0, 10.0), (3, 2.0, 10.0), (3, 2.0, 1e4)],
)
def test_friction_that_is_not_compensated_may_hold_the_motor(
    severity: int, share: float, stiffness: float
) -> None:
    drive = SimpleNamespace(
        coulomb_voltage=0.3, loop=SimpleNamespace(stiffness=stiffness)
    )
    law = SimpleNamespace(period=PERIOD, drive=drive)
    found = fault_arm.hunting(
        evidence(signals(tip=at(0.01, 990)), law=law, severity=severity)
    )
    assert (found.measured, found.limit) == pytest.approx(
        (0.005, max(2e-3, share * 0.3 / stiffness))
    )


def test_a_bit_may_be_flipped_where_the_tip_stays_or_the_drive_is_off_at_once() -> None:
    assert Upset("mode", 0, 0.3, 0).passed and not Upset("mode", 0, 0.31, 0).passed
    assert Upset("mode", 0, 9.0, 1).passed and Upset("mode", 0, 9.0, 10).passed
    assert (
        not Upset("mode", 0, 9.0, 11).passed
        and not Upset("mode", 0, math.inf, 0).passed
    )


@pytest.mark.parametrize("width", [4, 8])
def test_every_bit_of_the_memory_is_named_once_and_in_order(width: int) -> None:
    found = list(_bits(width))
    assert [place for *_, place in found] == list(
        range(32 * len(WORDS) + 8 * width * len(REALS))
    )
    assert [bit for name, bit, _ in found if name == "tick"] == list(range(32))
    assert [bit for name, bit, _ in found if name == "fade"] == list(range(8 * width))
    assert {name for name, *_ in found} == {*WORDS, *REALS}
