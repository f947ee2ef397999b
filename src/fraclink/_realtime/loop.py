"""Run the law in real time."""

from __future__ import annotations

import math
import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.reference import Reference, checked_reference, sampled
from fraclink._law import Law
from fraclink._realtime.connections import Connection, check_connection
from fraclink._realtime.run import MARKS, SIGNALS, STOPS, RealtimeRun, first_difference
from fraclink._validate import checked_between, checked_noun, checked_number, checked_whole
from fraclink.errors import FieldError

__all__ = ["PRIORITY", "check_machine", "granted_priority", "period_ns", "run_realtime"]

SETTLE = 3.0  # [s] after the reference has come to rest, as on the twin
PRIORITY = 80  # above the kernel's interrupt threads (50), below what keeps the machine alive (99)
_SHORTEST, _LONGEST = 5e-5, 1.0  # [s]


def run_realtime(
    law: Law,
    reference: Reference,
    connection: Connection,
    *,
    duration: float | None = None,
    relative: bool = True,
    patience: float = 5.0,
    priority: int = PRIORITY,
    lock_memory: bool = True,
    allowed_overruns: int = 0,
) -> RealtimeRun:
    """Run `law` on an arm in real time and return the record of every period.

    At the deadlines t₀ + kT of the monotonic clock the loop takes the newest sample, runs law.c and gives the
    command. t₀ lies half a period after the first sample. A sample that did not come is NaN for the law, a
    missed period a jump of its tick: the law's guards decide, and trip where the arm stays silent. The last
    thing the arm gets is always a stop (voltage 0, motor reference held, mode 4), whatever ended the run: its
    time, SIGINT, SIGTERM or SIGHUP, the law, an exception of a callback. Only a kill leaves the arm without
    it; then the arm's own watchdog must act.

    Parameters
    ----------
    law : Law
        From `Design.law`, at the period [s] of the arm, 50 µs to 1 s. With a motor loop it gives a voltage.
    reference : Reference
        Of the tip, e.g. `smooth_step`.
    connection : Udp, SharedMemory, Library or Callback
        The way to the arm.
    duration : float, optional
        [s]; 3 s after the reference's end where it is left out.
    relative : bool
        Whether the reference counts from where the arm stands; else it is the absolute angle, and an arm
        that stands elsewhere goes there first, at the law's largest speed.
    patience : float
        For the first sample [s], 0 to 3600.
    priority : int
        Of SCHED_FIFO, 1 to 99; 0 asks for none. What is refused stands in the result, and the run goes on.
    lock_memory : bool
        Whether to keep the process in memory (mlockall) while the loop runs.
    allowed_overruns : int
        Up to which the run holds.

    Raises
    ------
    FieldError
        A value out of its range, an arm that does not answer or runs at another period, a library that does
        not fit, another system than Linux. SizeError for more than 2 000 000 periods.

    Source: the manual pages clock_nanosleep(2), mlockall(2) and sched(7).

    >>> import fraclink as fl
    >>> from fraclink._realtime import Callback, run_realtime
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.Controller(gain=0.069876, order=0.612197, link=rig.model).discretize(rig.period, order=4)
    >>> given = []
    >>> at_rest = Callback(read=lambda: (0.2, 0.0), write=given.append)
    >>> run = run_realtime(law, fl.hold(0.0), at_rest, duration=0.04, priority=0, lock_memory=False)
    >>> run.stopped, float(run.motor_reference[-1]), run.first_difference, given[-1].mode
    ('finished', 0.2, None, 4)
    """
    check_machine()
    checked_noun("law", law, Law, remedy="plan.law() makes one")
    checked_reference(reference)
    check_connection(connection)
    nanoseconds = period_ns(law.period)
    length = reference.duration + SETTLE if duration is None else duration
    # The periods must be a number before they can be found too many.
    length = checked_between("duration", length, law.period, 1e300, "s")
    checked_number("patience", patience, allowed="0 to 3600 s", holds=lambda x: 0 <= x <= 3600)
    checked_whole("priority", priority, 0, 99)
    checked_whole("allowed_overruns", allowed_overruns, 0, 2**31)
    path = sampled(reference, law.period, math.floor(length / law.period * (1 + 1e-12)) + 1)
    if not np.all(np.isfinite(path)):
        raise FieldError("reference", "NaN", "not finite", allowed="finite", remedy="check the reference")
    count = path.shape[1]
    # Written and not only claimed, so that no page of the record is missing when its period comes.
    record = np.full((count, _kernels.REALTIME_COLUMNS), np.nan)
    marks = np.full((count, _kernels.REALTIME_MARKS), 0, dtype=np.uint32)
    from fraclink._realtime.opening import controller_end  # locks of files are Unix's

    with controller_end(connection, patience) as way:
        told = _kernels.realtime_run(
            way,
            law.block,
            law.initial_state(),
            law.precision == "single",
            np.ascontiguousarray(path[[0, 2]]),
            record,
            marks,
            nanoseconds,
            round(1e9 * patience),
            relative,
            priority,
            lock_memory,
        )
    _check_answer(told, connection, law.period, patience)
    return _gathered(law, connection, told, record, marks, priority, lock_memory, allowed_overruns)


def check_machine() -> None:
    """Raise FieldError where this system has no real-time loop."""
    if not _kernels.REALTIME:
        raise FieldError(
            "system",
            sys.platform,
            "without clock_nanosleep, mlockall and SCHED_FIFO",
            allowed="Linux",
            remedy="export the law with `fraclink export c` and run it on the board",
        )


def period_ns(period: float) -> int:
    """Return a period [s] in nanoseconds; FieldError outside 50 µs to 1 s.

    >>> period_ns(0.004)
    4000000
    """
    checked_number(
        "period",
        period,
        allowed=f"{_SHORTEST:g} to {_LONGEST:g} s",
        remedy="a desktop's loop is neither faster nor worth its priority when it is slower",
        holds=lambda x: _SHORTEST <= x <= _LONGEST,
    )
    return round(1e9 * period)


def _check_answer(told: dict[str, float], connection: Connection, period: float, patience: float) -> None:
    stop = STOPS[int(told["stop"])]
    if stop == "no sample":
        raise FieldError(
            "io",
            str(connection),
            f"silent: no sample in {patience:g} s",
            allowed="an arm that answers",
            remedy="start the arm first (`fraclink serve-arm`), or check the board",
        )
    if stop == "other period":
        raise FieldError(
            "period",
            period,
            "not the arm's",
            allowed=f"{1e-9 * told['period_ns']:g} s",
            remedy="run the arm at the law's period, or design for the arm's",
        )


def granted_priority(priority: int, refused: int) -> str:
    """Return in words what came of asking for SCHED_FIFO; `refused` is the errno, 0 where it was granted.

    >>> granted_priority(80, 0), granted_priority(80, 1)
    ('SCHED_FIFO 80', 'refused (Operation not permitted)')
    """
    return _granted(f"SCHED_FIFO {priority}", refused) if priority else "ordinary, as asked"


def _granted(what: str, refused: int) -> str:
    return what if refused == 0 else f"refused ({os.strerror(refused)})"


def _gathered(
    law: Law,
    connection: Connection,
    told: dict[str, float],
    record: NDArray[np.float64],
    marks: NDArray[np.uint32],
    priority: int,
    lock_memory: bool,
    allowed_overruns: int,
) -> RealtimeRun:
    count = int(told["count"])
    columns: dict[str, NDArray[Any]] = {name: record[:count, i].copy() for i, name in enumerate(SIGNALS)}
    columns |= {name: marks[:count, i].copy() for i, name in enumerate(MARKS)}
    parts: dict[str, Any] = dict(columns)
    return RealtimeRun(
        **parts,
        period=law.period,
        law_sha256=law.digest,
        connection=str(connection),
        stopped=STOPS[int(told["stop"])],
        lost_commands=int(told["lost"]),
        scheduling=granted_priority(priority, int(told["priority_error"])),
        memory=_granted("locked", int(told["memory_error"])) if lock_memory else "not locked, as asked",
        origin=float(told["origin"]),
        first_difference=first_difference(law, columns),
        allowed_overruns=allowed_overruns,
    )
