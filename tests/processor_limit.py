"""A bound on the processor time of a call, which does not depend on the load of the
machine.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["processor_limit"]


@contextmanager
def processor_limit(seconds: float) -> Iterator[None]:
    """Fail the enclosed code when this process has used `seconds` of processor time;
    waiting does not count.
    """

    def exceeded(number: int, frame: FrameType | None) -> None:
        raise AssertionError(f"more than {seconds} s of processor time")

    before = signal.signal(signal.SIGVTALRM, exceeded)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)
