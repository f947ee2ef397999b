"""The line to an arm and the guard on it, period by period, against an arm of a few
lines on a made clock.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import _kernels
from fraclink.errors import FieldError
from fraclink.lab._connections import Callback, Command
from fraclink.lab._line import (
    ArmLine,
    ArmLost,
    Reading,
    Stopped,
    _first_sample,
    _noted_signals,
    open_line,
)
from fraclink.lab._machine import (
    VirtualClock,
    WakeUps,
    granted,
    granted_priority,
    measure_wake_ups,
    period_ns,
)
from fraclink.lab._tune_guard import Guard, LimitReached

if not _kernels.REALTIME:
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

PERIOD = 0.01
Sample = tuple[int, float, float]


@dataclass
class Clock:
    """Time that passes while somebody sleeps."""

    now: float = 100.0
    slept: list[float] = field(default_factory=list)

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


@dataclass
class Way:
    """An arm whose samples are listed by the time from which each can be read."""

    clock: Clock
    samples: list[tuple[float, Sample | None]]
    clocked: bool = True
    taken: int = 0
    written: list[tuple[Any, ...]] = field(default_factory=list)

    def read(self) -> Sample | None:
        if self.samples and self.clock.now >= self.samples[0][0]:
            self.taken += 1
            return self.samples.pop(0)[1]
        return None

    def write(self, *values: Any) -> bool:
        self.written.append(values)
        return True


def line(way: Way) -> ArmLine:
    return ArmLine(way, PERIOD, way.clock, threading.Event())


# --- an arm with a clock of its own ----------------------------------------------------------------------


def test_the_next_sample_is_looked_for_sixteen_times_a_period() -> None:
    clock = Clock(100.0)
    way = Way(clock, [(100.0072, (0, 0.5, 0.25))])
    arm = line(way)
    assert arm.exchange(1.5) == Reading(0.5, 0.25, 1)
    assert way.written == [(0.0, 1.5, 1, 1, 0, 0)]
    assert (
        set(clock.slept) == {PERIOD / 16} and len(clock.slept) == 12
    )  # 12/16 of a period are 7.5 ms
    way.samples = [(clock.now, (0, math.nan, 0.0)), (clock.now, (0, 0.6, 0.3))]
    assert arm.exchange(-1.0).angle == 0.6  # what is no number is no sample
    assert way.written[-1] == (0.0, -1.0, 2, 1, 0, 0)


def test_the_samples_own_numbers_say_how_many_were_missed() -> None:
    clock = Clock()
    way = Way(clock, [(0.0, (0, 0.1, 0.0))], taken=2**32 - 2)
    arm = line(way)
    assert arm.exchange(0.0).periods == 1
    way.samples, way.taken = (
        [(0.0, (0, 0.4, 0.0))],
        2,
    )  # the newest of a few, and the count began anew
    assert arm.exchange(0.0).periods == 4
    way.samples, way.taken = (
        [(0.0, (0, 0.4, 0.0))],
        2,
    )  # nothing newer: one has passed all the same
    assert arm.exchange(0.0).periods == 1


def test_an_arm_that_is_silent_for_five_periods_is_lost() -> None:
    clock = Clock(100.0)
    with pytest.raises(ArmLost, match="no sample in 5 periods"):
        line(Way(clock, [])).exchange(0.0)
    assert clock.now - 100.0 == pytest.approx(5 * 1.5 * PERIOD, rel=0.06)
    late = Way(clock := Clock(100.0), [(100.0 + 7.2 * PERIOD, (0, 0.1, 0.0))])
    assert line(late).exchange(0.0).angle == 0.1


def test_a_stop_is_sent_three_times_a_period_apart() -> None:
    way = Way(Clock(100.0), [(0.0, (0, 0.1, 0.0))])
    arm = line(way)
    arm.exchange(2.0)
    way.clock.slept.clear()
    arm.stop()
    assert way.written[1:] == [(0.0, 0.0, tick, 4, 0, 0) for tick in (2, 3, 4)]
    assert way.clock.slept == [PERIOD] * 3
    board = Way(Clock(), [], clocked=False)  # what is called has it at once
    line(board).stop()
    assert board.written == [(0.0, 0.0, 1, 4, 0, 0)] and board.clock.slept == []


# --- an arm without one ----------------------------------------------------------------------------------


def test_a_board_is_read_on_deadlines() -> None:
    clock = Clock(100.0)
    way = Way(clock, [(0.0, (0, 0.1 * k, 0.0)) for k in range(9)], clocked=False)
    arm = line(way)
    arm.exchange(0.0)
    assert clock.now == pytest.approx(100.01)
    clock.now += 0.004  # what is computed is part of the period
    arm.exchange(0.0)
    assert clock.now == pytest.approx(100.02) and clock.slept[-1] == pytest.approx(
        0.006
    )
    clock.now += 0.025  # two deadlines have gone by: they are not made up for
    arm.exchange(0.0)
    assert clock.now == pytest.approx(100.045) and len(clock.slept) == 2
    arm.exchange(0.0)
    assert clock.now == pytest.approx(100.045)  # the deadline that is due now
    arm.exchange(0.0)
    assert clock.now == pytest.approx(100.055)


def test_lost_samples_of_a_board_are_periods() -> None:
    none = (0.0, None)
    way = Way(
        Clock(100.0),
        [none, (0.0, (0, math.nan, 0.0)), (0.0, (0, 0.3, 0.1))],
        clocked=False,
    )
    assert line(way).exchange(0.0) == Reading(0.3, 0.1, 3)
    way = Way(Clock(100.0), [none] * 4 + [(0.0, (0, 0.3, 0.1))], clocked=False)
    assert line(way).exchange(0.0).periods == 5
    with pytest.raises(ArmLost):
        line(
            Way(Clock(100.0), [none] * 5 + [(0.0, (0, 0.3, 0.1))], clocked=False)
        ).exchange(0.0)


def test_a_signal_ends_the_exchange_before_anything_is_sent() -> None:
    way = Way(Clock(), [(0.0, (0, 0.1, 0.0))])
    noted = threading.Event()
    noted.set()
    with pytest.raises(Stopped, match="stopped by a signal; the drive is off"):
        ArmLine(way, PERIOD, way.clock, noted).exchange(5.0)
    assert way.written == []


# --- opening ---------------------------------------------------------------------------------------------


def first(
    way: Way,
    period: float | None = PERIOD,
    *,
    patience: float = 0.1,
    noted: bool = False,
) -> Sample:
    event = threading.Event()
    if noted:
        event.set()
    return _first_sample(
        way, Callback(lambda: None, print), period, patience, way.clock, event
    )


def test_the_first_sample_is_asked_for_and_its_period_compared() -> None:
    way = Way(Clock(100.0), [(100.003, (10_000_000, 0.2, 0.1))])
    assert first(way) == (10_000_000, 0.2, 0.1)
    assert set(way.written) == {(0.0, 0.0, 0, 0, 0, 0)}  # idle: nothing moves
    assert set(way.clock.slept) == {PERIOD / 16}
    way = Way(Clock(100.0), [(100.003, (10_000_000, 0.2, 0.1))])
    assert first(way, None)[0] == 10_000_000  # it states its own
    assert set(way.clock.slept) == {0.004 / 16}
    for stated, period, said in (
        (20_000_000, PERIOD, r"period: not the arm's \(got 0\.01\); expected 0\.02 s"),
        (0, None, r"Give --period-ms"),
    ):
        with pytest.raises(FieldError, match=said):
            first(Way(Clock(), [(0.0, (stated, 0.2, 0.1))]), period)
    assert (
        first(Way(Clock(), [(0.0, (0, 0.2, 0.1))]))[0] == 0
    )  # a board that states none is believed
    way = Way(Clock(100.0), [])
    with pytest.raises(FieldError, match=r"silent: no sample in 0\.1 s"):
        first(way)
    assert way.clock.now - 100.0 == pytest.approx(0.1, abs=PERIOD / 8)
    with pytest.raises(Stopped):
        first(Way(Clock(), []), noted=True)


def test_signals_are_noted_and_given_back() -> None:
    """Whatever would end or stop the process, as in `run_realtime`: an arm is tuned by
    the same rules.
    """
    names = (
        "SIGINT",
        "SIGTERM",
        "SIGHUP",
        "SIGQUIT",
        "SIGTSTP",
        "SIGUSR1",
        "SIGALRM",
        "SIGXCPU",
    )
    numbers = [signal.Signals[name] for name in names]
    # One that is ignored stays so, as SIGINT is where a shell runs the tests in the
    # background.
    usual = [signal.signal(number, signal.SIG_DFL) for number in numbers]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    before = [signal.getsignal(number) for number in numbers]

    def noted_here() -> None:
        for number in numbers:
            with _noted_signals() as noted:
                assert not noted.is_set()
                signal.raise_signal(number)
                seen.append(noted.is_set())

    seen: list[bool] = []
    try:
        noted_here()
        thread = threading.Thread(
            target=noted_here
        )  # as in a notebook, where Python delivers no signals
        thread.start()
        thread.join()
        assert seen == [True] * 2 * len(names)
        assert [signal.getsignal(number) for number in numbers] == before
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        for number, handler in zip(numbers, usual, strict=True):
            signal.signal(number, handler)


def test_however_a_line_ends_a_stop_is_sent() -> None:
    sent: list[Command] = []
    with (
        pytest.raises(ZeroDivisionError),
        open_line(Callback(lambda: (0.1, 0.2), sent.append), PERIOD, clock="none") as (
            arm,
            reading,
        ),
    ):
        assert reading == Reading(0.1, 0.2, 1) and arm.period == PERIOD
        arm.exchange(3.0)
        raise ZeroDivisionError
    assert [(command.voltage, command.mode, command.tick) for command in sent] == [
        (3.0, 1, 1),
        (0.0, 4, 2),
    ]


# --- the machine -----------------------------------------------------------------------------------------


def test_a_period_is_kept_where_one_wake_up_in_a_hundred_is_late() -> None:
    latency = np.full(100, 20e-6)
    latency[0] = 0.0041
    awake = WakeUps(latency, 0.004, "SCHED_FIFO 80", "locked")
    assert awake.late == 0.01 and awake.kept
    awake.check()
    at_most = (
        "wake-ups 61 µs late on average, 4.1 ms at most (SCHED_FIFO 80, memory locked)"
    )
    assert str(awake) == f"{at_most}: 4 ms can be kept"
    latency[1] = 0.0041
    assert not awake.kept and str(awake).endswith(
        ": 4 ms cannot be kept, 2 % came later than that"
    )
    latency[:2] = 0.004  # as late as a period is not later
    assert awake.late == 0.0
    latency[:3] = 0.1
    with pytest.raises(
        FieldError, match=r"3 % of its wake-ups come later .*expected at most 1 %"
    ):
        awake.check()
    near = WakeUps(np.array([1e-3, 0.998e-3]), 0.004, "", "")
    assert str(near).startswith("wake-ups 999 µs late on average, 1.0 ms at most")


@pytest.mark.parametrize(
    ("period", "options", "count", "step"),
    [
        (0.001, {}, 500, 1_000_000),
        (0.01, {}, 250, 2_000_000),  # a longer sleep tells no more of a wake-up
        (0.01, {"step": 0.005, "duration": 0.1}, 20, 5_000_000),
        (0.5, {"step": 0.5, "duration": 0.02}, 1, 500_000_000),
    ],
)
def test_wake_ups_are_measured_for_half_a_second(
    monkeypatch: pytest.MonkeyPatch,
    period: float,
    options: dict[str, Any],
    count: int,
    step: int,
) -> None:
    asked: list[tuple[Any, ...]] = []

    def bare(latency: Any, *rest: Any) -> dict[str, float]:
        asked.append((len(latency), *rest))
        latency[:] = 1e-5
        return {
            "count": len(latency) - stopped,
            "priority_error": errno.EPERM,
            "memory_error": errno.ENOMEM,
        }

    monkeypatch.setattr(_kernels, "realtime_bare", bare)
    stopped = 0
    clock = VirtualClock(1)
    found = measure_wake_ups(period, clock=clock, **options)
    assert asked[0] == (count, step, 80, True, clock)
    assert (found.period, len(found.latency)) == (period, count)
    assert (
        found.scheduling == "refused (Operation not permitted)"
        and found.memory == "refused (Cannot allocate memory)"
    )
    stopped = 1
    with pytest.raises(KeyboardInterrupt):
        measure_wake_ups(period, clock=clock, **options)


def test_what_was_granted_is_said_in_words() -> None:
    fine = {"priority_error": 0, "memory_error": 0}
    assert granted(fine, 42, True) == ("SCHED_FIFO 42", "locked")
    assert granted(fine, 0, False) == ("ordinary, as asked", "not locked, as asked")
    assert granted_priority(0, errno.EPERM) == "ordinary, as asked"
    assert (period_ns(5e-5), period_ns(1.0), period_ns(0.0033333333)) == (
        50_000,
        1_000_000_000,
        3_333_333,
    )
    for period in (4.9e-5, 1.01):
        with pytest.raises(FieldError, match="period"):
            period_ns(period)


# --- the guard -------------------------------------------------------------------------------------------


LIMITS = fl.MotionLimits(angle=1.0, speed=10.0, torque=2.0, voltage=5.0)


STILL = Reading(0.0, 0.0, 1)


@dataclass
class Arm:
    """A line whose next reading is the next of a list, or stays."""

    readings: list[Reading] = field(default_factory=list)
    period: float = PERIOD
    sent: list[float] = field(default_factory=list)
    last: Reading = STILL
    opened: int = 0
    closed: int = 0

    def exchange(self, voltage: float) -> Reading:
        self.sent.append(voltage)
        self.last = (
            self.readings.pop(0) if self.readings else self.last._replace(periods=1)
        )
        return self.last

    @contextlib.contextmanager
    def open(self) -> Iterator[tuple[Any, Reading]]:
        self.opened += 1
        try:
            yield self, self.last
        finally:
            self.closed += 1

    def guard(self, limits: fl.MotionLimits = LIMITS) -> Guard:
        return Guard(self.open, limits)


def angles(*values: float) -> list[Reading]:
    return [Reading(value, 0.0, 1) for value in values]


def test_a_guard_opens_once_counts_from_the_start_and_closes() -> None:
    arm = Arm(last=Reading(0.3, 0.5, 1))
    guard = arm.guard()
    assert (guard.origin, guard.offset, guard.period, guard.count, guard.lost) == (
        0.3,
        0.5,
        PERIOD,
        0,
        0,
    )
    arm.readings = [Reading(0.31, 0.7, 1), Reading(0.32, 0.6, 1)]
    guard.step(1.0)
    assert guard.angle == pytest.approx(0.01) and guard.torque == pytest.approx(0.2)
    guard.step(-9.0)
    assert (
        guard.count == 2 and arm.opened == 1 and arm.sent == [1.0, -5.0]
    )  # clipped to the limit
    record = guard.record()
    assert record.voltage.tolist() == [1.0, -5.0]
    assert record.angle == pytest.approx(
        [0.0, 0.01]
    ) and record.torque == pytest.approx([0.0, 0.2])
    assert (
        record.duration == pytest.approx(2 * PERIOD) and guard.record(1).angle.size == 1
    )
    guard.release()
    guard.release()
    assert arm.closed == 1
    guard.step(math.nan)  # opens anew, and sends nothing that is no number
    assert arm.opened == 2 and arm.sent[-1] == 0.0


def test_a_stretch_without_samples_is_a_line_and_its_speed_that_of_all_its_periods() -> (
    None
):
    arm = Arm()
    guard = arm.guard()
    guard.step(1.0)
    arm.readings = [Reading(0.03, 0.3, 3)]
    guard.step(2.0)
    record = guard.record()
    assert record.voltage.tolist() == [1.0, 2.0, 2.0, 2.0] and guard.lost == 2
    assert record.angle == pytest.approx(
        [0.0, 0.0, 0.01, 0.02]
    ) and record.torque == pytest.approx([0, 0, 0.1, 0.2])
    assert guard.speed == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("readings", "limit"),
    [
        (angles(0.0, 0.02, 0.04, 0.06), ""),
        ([Reading(0.0, 1.59, 1)], ""),
        (
            [Reading(0.0, -1.61, 1)],
            "torque: -1.61 N·m is about to exceed the limit of 2 N·m",
        ),
        (angles(0.0, 0.094), ""),
        (angles(0.0, 0.096), "speed: 9.6 rad/s"),
        (angles(*np.arange(0.0, 0.9, 0.005)), "angle"),
        ([Reading(math.nan, 0.0, 1)], "angle"),
        ([Reading(0.0, math.nan, 1)], "torque"),
    ],
)
def test_a_limit_is_kept_before_it_is_reached(
    readings: list[Reading], limit: str
) -> None:
    """At 0.8 of angle and torque, at 0.95 of the speed; the angle is the one at which
    the arm would rest.
    """
    arm = Arm(readings=[Reading(0.0, 9.0, 1)] * 2)
    guard = arm.guard()
    for _ in range(3):
        guard.step(
            0.0
        )  # an arm that nobody has moved breaks no limit, whatever its sensors show
    arm.readings = list(readings)
    with (
        pytest.raises(LimitReached, match=limit) if limit else contextlib.nullcontext()
    ):
        for k in range(len(readings) + 1):
            guard.step(0.0 if k else 0.1)
    if limit == "angle" and len(readings) > 1:
        # 0.5 rad/s for two periods and 50 ms of coasting: 35 mrad before 0.8 rad
        assert guard.angle == pytest.approx(0.8 - 0.5 * (0.05 + 2 * PERIOD), abs=0.0051)


def test_an_encoders_noise_is_allowed_for_and_no_more() -> None:
    """Six standard deviations of the difference of two readings: 6 √2 · 1 mrad / 10 ms
    = 0.85 rad/s.
    """
    for step, stops in ((0.1030, False), (0.1045, True)):
        guard = Arm(readings=angles(step)).guard()
        guard.allow(1e-3)
        assert guard.shake == pytest.approx(0.8485, rel=1e-3)
        guard.limits = replace(LIMITS, angle=100.0)
        with (
            pytest.raises(LimitReached, match="speed")
            if stops
            else contextlib.nullcontext()
        ):
            guard.step(0.1)
            guard.step(0.1)


def test_no_voltage_drives_the_motor_beyond_four_fifths_of_the_speed() -> None:
    """K/J = 100 rad/(s²·V): a volt adds 1 rad/s a period; with a delay of two, what was
    sent counts.
    """
    arm = Arm(readings=angles(0.0, 0.0, 0.0, 0.0))
    guard = arm.guard(replace(LIMITS, angle=100.0))
    guard.learn(100.0, 2 * PERIOD)
    sent = [guard.step(5.0) and arm.sent[-1] for _ in range(3)]
    assert sent == [
        5.0,
        3.0,
        0.0,
    ]  # 8 rad/s on their way: no more, but the other way is free
    guard.step(-5.0)
    assert arm.sent[-1] == -5.0
    slow = Arm(readings=angles(0.0)).guard(replace(LIMITS, angle=100.0))
    slow.learn(
        100.0, 1.05 * PERIOD
    )  # one period, and what a clock of a tenth more may be
    assert slow._sent.maxlen == 2
    slow.learn(100.0, 1.2 * PERIOD)
    assert slow._sent.maxlen == 3
    slow.learn(100.0, 0.0)
    assert slow._sent.maxlen == 2


def test_the_speed_is_that_of_now_and_not_of_half_a_period_ago() -> None:
    arm = Arm(readings=angles(0.01, 0.02))
    guard = arm.guard()
    guard.learn(100.0, PERIOD)
    for _ in range(2):
        guard.step(2.0)
    # 1 rad/s between the samples; the voltage that acted last, 2 V, added half of its 2
    # rad/s since
    assert guard.speed == pytest.approx(1.0 + 0.5 * 2.0)


def test_rest_and_quiet_last_as_long_as_said() -> None:
    arm = Arm()
    guard = arm.guard()
    guard.rest(0.105)
    assert guard.count == 11 and set(arm.sent) == {0.0}
    guard.quiet(0.01, 3.0)  # nothing rings: 0.6 s are looked at
    assert guard.count == 11 + 60
    noise = [Reading(0.0, 0.02 * (-1) ** k, 1) for k in range(1000)]
    arm.readings = list(noise)
    guard.quiet(0.01, 1.2)  # as long as was said, in looks of 0.15 s
    assert guard.count == 71 + 120
    arm.readings = noise[
        :75
    ]  # then it rests, and is looked at until the ringing has left the window
    guard.quiet(0.01, 3.0)
    assert guard.count == 191 + 75 + 60


def test_an_open_line_asks_for_the_priority_of_the_real_time_loop() -> None:
    seen: list[int] = []

    def read() -> tuple[float, float]:
        seen.append(os.sched_getscheduler(0))
        return 0.0, 0.0

    board = Callback(read, lambda _: None)
    before = os.sched_getscheduler(0)
    with open_line(board, PERIOD) as (line, _):
        line.exchange(0.0)
    granted = measure_wake_ups(PERIOD, duration=0.02).scheduling.startswith("SCHED")
    assert seen[-1] == (os.SCHED_FIFO if granted else before)
    assert os.sched_getscheduler(0) == before
