"""The link to an arm and its guard, period by period, with a minimal arm on a simulated
clock.
"""

from __future__ import annotations

import contextlib
import math
import signal
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import Callback
from fraclink.errors import FraclinkError
from fraclink.lab._line import (
    ArmLine,
    Reading,
    open_line,
)
from fraclink.lab._tune_guard import Guard

if sys.platform != "linux":
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

PERIOD = 0.01
Sample = tuple[int, float, float]


@dataclass
class Clock:
    """Time that advances while a thread sleeps."""

    now: float = 100.0
    slept: list[float] = field(default_factory=list)

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


@dataclass
class Way:
    """An arm whose samples are listed with the times from which they can be read."""

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
    return ArmLine(way, PERIOD, way.clock)


# --- an arm with a clock of its own ----------------------------------------------------------------------


def test_the_samples_own_numbers_say_how_many_were_missed() -> None:
    clock = Clock()
    way = Way(clock, [(0.0, (0, 0.1, 0.0))], taken=2**32 - 2)
    arm = line(way)
    assert arm.exchange(0.0).periods == 1
    # the newest of several, and the count starts again
    way.samples, way.taken = (
        [(0.0, (0, 0.4, 0.0))],
        2,
    )
    assert arm.exchange(0.0).periods == 4
    # nothing newer: one period has passed anyway
    way.samples, way.taken = (
        [(0.0, (0, 0.4, 0.0))],
        2,
    )
    assert arm.exchange(0.0).periods == 1


def test_an_arm_that_is_silent_for_five_periods_is_lost() -> None:
    clock = Clock(100.0)
    with pytest.raises(FraclinkError, match="no sample in 5 periods"):
        line(Way(clock, [])).exchange(0.0)
    assert clock.now - 100.0 == pytest.approx(5 * 1.5 * PERIOD, rel=0.06)
    late = Way(clock := Clock(100.0), [(100.0 + 7.2 * PERIOD, (0, 0.1, 0.0))])
    assert line(late).exchange(0.0).angle == 0.1


# --- opening ---------------------------------------------------------------------------------------------


def test_signals_are_noted_and_given_back() -> None:
    """All signals that would end or stop the process, as in `run_realtime`: the same
    rules apply to tuning.
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
    # A signal that is ignored stays ignored, like SIGINT when a shell runs the tests in
    # the background.
    usual = [signal.signal(number, signal.SIG_DFL) for number in numbers]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    before = [signal.getsignal(number) for number in numbers]

    def noted_here() -> None:
        for number in numbers:
            arm_end = Callback(lambda: (0.1, 0.2), sent.append)
            with open_line(arm_end, PERIOD, clock="none") as (arm, _):
                arm.exchange(3.0)
                signal.raise_signal(number)
                with pytest.raises(FraclinkError, match="stopped by a signal"):
                    arm.exchange(5.0)

    sent: list[Any] = []
    try:
        noted_here()
        # as in a notebook, where Python delivers no signals
        thread = threading.Thread(target=noted_here)
        thread.start()
        thread.join()
        # nothing is sent after the signal but the stop
        voltages = [command.voltage for command in sent if command.mode]
        assert voltages == [3.0, 0.0] * 2 * len(names)
        assert [signal.getsignal(number) for number in numbers] == before
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        for number, handler in zip(numbers, usual, strict=True):
            signal.signal(number, handler)


def test_however_a_line_ends_a_stop_is_sent() -> None:
    sent: list[Any] = []
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


# --- the guard -------------------------------------------------------------------------------------------


LIMITS = fl.MotionLimits(angle=1.0, speed=10.0, torque=2.0, voltage=5.0)


STILL = Reading(0.0, 0.0, 1)


@dataclass
class Arm:
    """A link whose next reading is the next one in a list, or the last one again."""

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
    """At 0.8 of angle and torque, and 0.95 of the speed; the angle is the one at which
    the arm would come to rest.
    """
    arm = Arm(readings=[Reading(0.0, 9.0, 1)] * 2)
    guard = arm.guard()
    for _ in range(3):
        # an arm that has not been moved violates no limit, whatever its sensors read
        guard.step(0.0)
    arm.readings = list(readings)
    with (
        pytest.raises(FraclinkError, match=limit) if limit else contextlib.nullcontext()
    ):
        for k in range(len(readings) + 1):
            guard.step(0.0 if k else 0.1)
    if limit == "angle" and len(readings) > 1:
        # 0.5 rad/s for two periods and 50 ms of coasting: 35 mrad before 0.8 rad
        assert guard.angle == pytest.approx(0.8 - 0.5 * (0.05 + 2 * PERIOD), abs=0.0051)


def test_no_voltage_drives_the_motor_beyond_four_fifths_of_the_speed() -> None:
    """K/J = 100 rad/(s²·V): one volt adds 1 rad/s per period; with a delay of two
    periods, voltages already sent are taken into account.
    """
    arm = Arm(readings=angles(0.0, 0.0, 0.0, 0.0))
    guard = arm.guard(replace(LIMITS, angle=100.0))
    guard.learn(100.0, 2 * PERIOD)
    sent = [guard.step(5.0) and arm.sent[-1] for _ in range(3)]
    # 8 rad/s is about to be reached: no more in this direction, but the other is free
    assert sent == [
        5.0,
        3.0,
        0.0,
    ]
    guard.step(-5.0)
    assert arm.sent[-1] == -5.0
    slow = Arm(readings=angles(0.0)).guard(replace(LIMITS, angle=100.0))
    # one period, with the tolerance of a tenth for the clock
    slow.learn(100.0, 1.05 * PERIOD)
    assert slow._sent.maxlen == 2
    slow.learn(100.0, 1.2 * PERIOD)
    assert slow._sent.maxlen == 3
    slow.learn(100.0, 0.0)
    assert slow._sent.maxlen == 2
