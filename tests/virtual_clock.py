"""A clock on which no load of the machine makes anybody late."""

from __future__ import annotations

import itertools
import threading
from multiprocessing.connection import Connection

STALL = 120.0  # [s] of real time: another thread forgot to leave


class VirtualClock:
    """Stands still until each of its `threads` sleeps in it, goes on to the earliest
    wake-up, and lets that one thread run.

    Threads take turns in an order that does not depend on the load, their work takes no
    time, and a minute of sleep passes at once.
    """

    def __init__(self, threads: int = 1) -> None:
        self._changed = threading.Condition()
        self._threads, self._now = threads, 0
        self._order = itertools.count()  # decides between equal times
        self._asleep: set[tuple[int, int]] = set()
        self.stalled = False

    @property
    def now(self) -> float:
        """Its time [s]."""
        return 1e-9 * self.now_ns()

    def now_ns(self) -> int:
        """Its time [ns]."""
        with self._changed:
            return self._now

    def sleep(self, seconds: float) -> None:
        """Sleep for some time."""
        self.sleep_until(self.now_ns() + round(1e9 * seconds))

    def sleep_until(self, time_ns: int) -> None:
        """Sleep until a time [ns]."""
        with self._changed:
            me = time_ns, next(self._order)
            self._asleep.add(me)
            self._pass_on()
            while me in self._asleep and not self.stalled:
                # No thread may hang because of an error in another: time runs then, and
                # the test fails.
                self.stalled = not self._changed.wait(STALL) and me in self._asleep
            if me in self._asleep:
                self._wake(me)

    def leave(self) -> None:
        """The others go on without the calling thread, which will not sleep any more."""
        with self._changed:
            self._threads -= 1
            self._pass_on()

    def _pass_on(self) -> None:
        if self._asleep and len(self._asleep) >= self._threads:
            self._wake(min(self._asleep))

    def _wake(self, sleeper: tuple[int, int]) -> None:
        self._asleep.remove(sleeper)
        self._now = max(self._now, sleeper[0])
        self._changed.notify_all()

    def serve(self, peer: Connection) -> threading.Thread:
        """Take turns for a `RemoteClock` in another process, until that ends."""

        def turns() -> None:
            try:
                while (time_ns := peer.recv()) != "left":
                    if time_ns is not None:
                        self.sleep_until(time_ns)
                    peer.send(self.now_ns())
            except (EOFError, OSError):
                return  # it was killed
            self.leave()

        thread = threading.Thread(target=turns, daemon=True)
        thread.start()
        return thread


class RemoteClock:
    """The clock of another process, over a connection to it."""

    def __init__(self, file: int) -> None:
        self._way = Connection(file)

    def now_ns(self) -> int:
        """Its time [ns]."""
        self._way.send(None)
        return int(self._way.recv())

    def sleep_until(self, time_ns: int) -> None:
        """Sleep until a time [ns]."""
        self._way.send(time_ns)
        self._way.recv()

    def leave(self) -> None:
        """The others go on without this process."""
        self._way.send("left")
