"""Real-time properties of the machine: punctual wake-ups, priority, locked memory."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from fraclink import _kernels
from fraclink.errors import FieldError
from fraclink.extend import LOST_SHARE
from fracsys.checks import Between, Real, checked
from fracsys.checks.equality import compared

__all__ = [
    "PRIORITY",
    "Priority",
    "Spread",
    "WakeUps",
    "check_machine",
    "granted",
    "measure_wake_ups",
    "period_ns",
    "signals_held",
]


# above the kernel's interrupt threads (50), below the threads that keep the machine
# alive (99)
PRIORITY = 80
Priority = Annotated[int, Between(0, 99, remedy="0 asks for no real-time priority")]
# A desktop computer cannot keep a period below 50 µs; a period above 1 s does not need
# real time.
PERIOD = Between(
    5e-5, 1.0, "s", remedy="design for another period, or run the law on a board"
)
# Longest time between two wake-ups [s]: their lateness hardly depends on the time
# slept.
_STEP = 0.002


class Spread(NamedTuple):
    """Smallest value, mean, 99.9 % quantile and largest value."""

    least: float
    mean: float
    high: float
    most: float

    @staticmethod
    def of(values: Real) -> Spread:
        """Return the spread of (N,) values; NaN where there are none."""
        if not values.size:
            return Spread(*[float("nan")] * 4)
        return Spread(
            float(values.min()),
            float(values.mean()),
            # "higher": a measured quantile instead of an interpolated one
            float(np.quantile(values, 0.999, method="higher")),
            float(values.max()),
        )


@compared
@dataclass(frozen=True, eq=False)
class WakeUps:
    """How late this machine woke a loop that only sleeps: `latency` [s] of every wake-up,
    shape (N,).

    period: the requested one [s]; scheduling, memory: what the machine granted.

    >>> awake = WakeUps(np.array([5e-5, 9e-5, 3e-3]), 0.004, "SCHED_FIFO 80", "locked")
    >>> print(awake)
    wake-ups 1.0 ms late on average, 3.0 ms at most (SCHED_FIFO 80, memory locked): 4 ms can be kept
    >>> awake.kept
    True
    """

    latency: Real
    period: float
    scheduling: str
    memory: str

    @property
    def late(self) -> float:
        """Share of the wake-ups that came later than a whole period."""
        return float(np.mean(self.latency > self.period))

    @property
    def kept(self) -> bool:
        """Whether the period can be kept: at most 1 % of the wake-ups were later than a
        period.
        """
        return self.late <= LOST_SHARE

    def __str__(self) -> str:
        spread = Spread.of(self.latency)
        times = f"wake-ups {_time(spread.mean)} late on average, {_time(spread.most)} at most"
        verdict = (
            "can be kept"
            if self.kept
            else f"cannot be kept, {100 * self.late:.2g} % came later than that"
        )
        return f"{times} ({self.scheduling}, memory {self.memory}): {1e3 * self.period:g} ms {verdict}"

    def check(self) -> None:
        """Raise FieldError where the machine does not keep the period."""
        if not self.kept:
            raise FieldError(
                "period",
                self.period,
                f"not kept by this machine: {100 * self.late:.2g} % of its wake-ups come later than that",
                f"at most {100 * LOST_SHARE:g} %",
                "grant SCHED_FIFO (rtprio), end other programs, or design for a longer period",
            )


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.1f} ms" if seconds >= 1e-3 else f"{1e6 * seconds:.0f} µs"


@checked
def measure_wake_ups(
    period: float,
    *,
    duration: Annotated[float, Between(0.01, 3600.0, "s")] = 0.5,
    step: Annotated[float, PERIOD] | None = None,
    priority: Priority = PRIORITY,
    lock_memory: bool = True,
    clock: Any = None,
) -> WakeUps:
    """Sleep and wake up for `duration` as the real-time loop does, and return how late
    this machine was.

    Parameters
    ----------
    period
        that is to be kept [s], 50 µs to 1 s.
    duration
        [s]; half a second is an unnoticeable delay before a move.
    step
        between two wake-ups [s]; default: the period, 2 ms at most.
    priority, lock_memory, clock
        as for `run_realtime`.

    Raises
    ------
    FieldError
        A value out of its range, a system other than Linux.
    KeyboardInterrupt
        A signal that would have ended the run.
    """
    check_machine()
    period_ns(period)
    # At least 250 wake-ups in half a second: at 20 ms there would be only 25, and a
    # share of 1 % could not be detected.
    sleep = min(period, _STEP) if step is None else step
    latency = np.zeros(max(1, round(duration / sleep)))
    outcome = _kernels.realtime_bare(
        latency,
        period_ns(sleep),
        priority,
        lock_memory,
        _kernels.RealtimeClock(clock),
    )
    # The kernel left the loop early, which only happens on a signal.
    if int(outcome["count"]) < len(latency):
        raise KeyboardInterrupt
    return WakeUps(latency, period, *granted(outcome, priority, lock_memory))


def check_machine() -> None:
    """Raise FieldError if this system has no real-time loop."""
    if not _kernels.REALTIME:
        raise FieldError(
            "system",
            sys.platform,
            "without clock_nanosleep, mlockall and SCHED_FIFO",
            "Linux",
            "export the law with `fraclink export c` and run it on the board",
        )


def period_ns(period: float) -> int:
    """Return a period [s] in nanoseconds; FieldError outside 50 µs to 1 s.

    >>> period_ns(0.004)
    4000000
    """
    return round(1e9 * PERIOD.check("period", period))


@contextlib.contextmanager
def real_time() -> Iterator[None]:
    """Run the block under SCHED_FIFO with its memory locked, if the machine grants it.
    Where it does not, `WakeUps.check` refuses a machine that misses the period.
    """
    before = _kernels.realtime_prepare(PRIORITY, 1)
    try:
        yield
    finally:
        _kernels.realtime_relax(before)


@contextlib.contextmanager
def signals_held() -> Iterator[threading.Event]:
    """Hold every signal that would end or stop the process until the block ends, in any
    thread.

    A signal received meanwhile is raised at the end, unless the block has set the yielded
    event because it already obeyed. A closed terminal sends two signals some
    milliseconds apart, and users press Ctrl-C repeatedly.
    """
    check_machine()
    obeyed = threading.Event()
    _kernels.realtime_watch_signals()
    try:
        yield obeyed
    finally:
        _kernels.realtime_release_signals()
        # Read after the release, which keeps the number: a signal between the two would
        # otherwise be lost.
        number = _kernels.realtime_signalled()
    # Not after an exception, which already ends what the signal would have ended.
    if number and not obeyed.is_set():
        signal.raise_signal(number)


def granted(
    outcome: dict[str, float], priority: int, lock_memory: bool = False
) -> tuple[str, str]:
    """Return in words whether SCHED_FIFO and locked memory were granted."""

    # Requested separately: a container often grants one and not the other, and the user
    # must know which.
    def answer(what: str, error: float) -> str:
        return f"refused ({os.strerror(int(error))})" if error else what

    return (
        answer(f"SCHED_FIFO {priority}", outcome["priority_error"])
        if priority
        else "ordinary, as asked",
        answer("locked", outcome["memory_error"])
        if lock_memory
        else "not locked, as asked",
    )
