"""Step-by-step access to an arm, for Python loops that decide on the next command from
the latest sample.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from fraclink import _kernels
from fraclink._law import MODES
from fraclink._law.limits import Limits
from fraclink.errors import FieldError, FraclinkError
from fraclink.lab._connections import Connection, controller_end, silent
from fraclink.lab._machine import check_machine, period_ns, real_time

__all__ = ["ArmLine", "ArmLost", "Reading", "Stopped", "open_line"]

_LOOKS = 16  # polls per period: the time of arrival is known to 6 % of a period
_STOPS = 3  # stop messages sent, since one may get lost


class Stopped(FraclinkError):
    """A signal requested the end; the drive is off."""

    def __init__(self) -> None:
        super().__init__("stopped by a signal; the drive is off")


class ArmLost(FraclinkError):
    """The arm sends no more samples; a stop was sent."""

    def __init__(self, periods: int) -> None:
        super().__init__(
            f"no sample in {periods} periods: the link to the arm is lost; a stop was sent"
        )


class Reading(NamedTuple):
    """One sample: motor angle [rad], torque [N·m], and the periods since the previous
    one (1: none lost).
    """

    angle: float
    torque: float
    periods: int


class ArmLine:
    """An open connection to an arm; `exchange` sends a voltage and returns the next
    sample.

    An arm with a clock of its own (udp, serial) sets the pace; a callback is read on
    deadlines of `clock`.
    """

    def __init__(self, way: Any, period: float, clock: Any) -> None:
        self.period = period
        self._way, self._clock = way, clock
        self._tick = 0
        # A board without a clock starts at its first read, so the next one is due a
        # period later.
        self._due = clock.now + period
        self._seen = way.taken if way.clocked else 0
        self._last = clock.now

    def exchange(self, voltage: float) -> Reading:
        """Send a voltage [V] and return the next sample.

        Raises `Stopped` after a signal, `ArmLost` if no sample came for five periods.
        An arm with its own clock numbers its samples: if this process missed some, the
        newest one shows how many.
        """
        if _kernels.realtime_signalled():
            raise Stopped
        self._tick += 1
        # Mode 1, "run"; an arm controlled by voltages ignores the motor reference.
        self._way.write(0.0, voltage, self._tick, 1, 0, 0)
        periods, sample = 0, None
        while sample is None:
            periods += 1
            if periods > Limits.missed_limit:
                raise ArmLost(Limits.missed_limit)
            sample = self._awaited() if self._way.clocked else self._on_time()
        if self._way.clocked:
            # The sample's own number counts, not the number of polls: a process that
            # was suspended receives the newest sample at once, and the motion since
            # then would be taken for that of one period. The number has 32 bits.
            before, self._seen = self._seen, self._way.taken
            periods = max((self._seen - before) % 2**32, 1)
        return Reading(sample[1], sample[2], periods)

    def _awaited(self) -> tuple[int, float, float] | None:
        """The next sample from an arm that sends them; None if none came within 1.5
        periods.
        """
        # A sample up to half a period late is jitter; later, it is closer to the next
        # one and counts as lost.
        last = self._clock.now + 1.5 * self.period
        while (sample := _sample(self._way)) is None:
            if self._clock.now > last:
                return None
            self._clock.sleep(self.period / _LOOKS)
        return sample

    def _on_time(self) -> tuple[int, float, float] | None:
        # Absolute deadlines: sleeping for one period each time would lengthen every
        # period by the computing time.
        wait = self._due - self._clock.now
        if wait > 0:
            self._clock.sleep(wait)
        # Missed deadlines are dropped. Making up for them would cause a burst of reads,
        # each taken for a period of motion.
        self._due = max(self._due + self.period, self._clock.now)
        return _sample(self._way)

    def stop(self) -> None:
        """Switch the drive off."""
        # Datagrams can be lost, function calls cannot.
        for _ in range(_STOPS if self._way.clocked else 1):
            self._tick += 1
            self._way.write(0.0, 0.0, self._tick, MODES.index("off"), 0, 0)
            if self._way.clocked:
                self._clock.sleep(self.period)


class _NoClock:
    """The clock of an arm in this process that has none: a period is over when the next
    one is requested.
    """

    now = 0.0

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@contextlib.contextmanager
def open_line(
    connection: Connection,
    period: float | None,
    *,
    patience: float = 5.0,
    clock: Any = None,
) -> Iterator[tuple[ArmLine, Reading]]:
    """Open the connection to an arm; yields the line and the first sample. A stop is
    sent however the block ends.

    `period` [s] may be None for an arm that states its own; FieldError if neither
    states it, or if they differ. `clock` may be a test's, or "none" for an arm in
    this process that only advances when called.
    """
    check_machine()
    time = _NoClock() if clock == "none" else _kernels.RealtimeClock(clock)
    with contextlib.ExitStack() as stack:
        # Every signal that would end or stop the process is only recorded, in any
        # thread. This uses the signal handling of the loop, since Python's
        # `signal.signal` only works in the main thread, while a notebook or a server
        # runs this in a worker thread. Stop signals are included, because a process
        # suspended by Ctrl-Z no longer controls the arm.
        _kernels.realtime_watch_signals()
        stack.callback(_kernels.realtime_release_signals)
        if clock is None:
            stack.enter_context(real_time())
        way = stack.enter_context(controller_end(connection))
        first = _first_sample(way, connection, period, patience, time)
        line = ArmLine(way, 1e-9 * first[0] if first[0] else period or 0.0, time)
        try:
            yield line, Reading(first[1], first[2], 1)
        finally:
            line.stop()


def _sample(way: Any) -> tuple[int, float, float] | None:
    """The sample that has come; None if there is none, or one without an angle."""
    sample: tuple[int, float, float] | None = way.read()
    return None if sample is None or not math.isfinite(sample[1]) else sample


def _first_sample(
    way: Any,
    connection: Connection,
    period: float | None,
    patience: float,
    clock: Any,
) -> tuple[int, float, float]:
    last, look = clock.now + patience, (period or 0.004) / _LOOKS
    while (sample := _sample(way)) is None:
        if _kernels.realtime_signalled():
            raise Stopped
        # idle: from this message an arm learns where to send its samples
        way.write(0.0, 0.0, 0, 0, 0, 0)
        if clock.now > last:
            raise silent(connection, patience)
        clock.sleep(look)
    if period is None and not sample[0]:
        raise FieldError(
            "period",
            None,
            "not stated by this board",
            "the board's sampling period [s]",
            "give --period-ms",
        )
    # Compared in whole nanoseconds as in the message, since 1/300 s has no exact value.
    if period is not None and sample[0] and period_ns(period) != sample[0]:
        raise FieldError(
            "period",
            period,
            "not the arm's",
            f"{1e-9 * sample[0]:g} s",
            "leave it out: this arm states its own",
        )
    return sample
