"""Run the law in real time."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.reference import Reference, sampled
from fraclink._files import check_ending, output_path
from fraclink._law import Law
from fraclink._law.estimator import PayloadEstimator
from fraclink._simulate.estimates import estimator_for
from fraclink.errors import FieldError
from fraclink.lab._connections import Connection, controller_end, silent
from fraclink.lab._machine import (
    PRIORITY,
    Priority,
    check_machine,
    granted,
    period_ns,
    signals_held,
)
from fraclink.lab._run import (
    MARKS,
    SIGNALS,
    STOPS,
    RealtimeRun,
    first_difference,
    saved,
)
from fracsys.checks import Between, above, checked

__all__ = ["run_realtime"]


@checked
def run_realtime(
    law: Law,
    reference: Reference,
    connection: Connection,
    *,
    duration: Annotated[float, above(0.0, 1e300, "s")] | None = None,
    out: Path | None = None,
    payload: Annotated[float, Between(0.0, 1e9, "kg")] = 0.0,
    estimator: PayloadEstimator | None = None,
    patience: Annotated[float, Between(0.0, 3600.0, "s")] = 5.0,
    priority: Priority = PRIORITY,
    lock_memory: bool = True,
    allowed_overruns: Annotated[int, Between(0, 2**31)] = 0,
    clock: Any = None,
) -> RealtimeRun:
    """Run `law` on an arm in real time and return the record of every period.

    At the deadlines t₀ + kT of the monotonic clock the loop takes the newest sample,
    runs law.c and sends the command. t₀ lies half a period after the first sample. The
    law reads a missing sample as NaN and a missed period as a jump of its tick; its
    guards decide, and trip if the arm stays silent. The last command to the arm is
    always a stop (voltage 0, mode 4), whatever ended the run: its time, the law, an
    exception, any signal that can be caught, a crash of the process (except with a key
    or a `Callback`). After SIGKILL, SIGSTOP or a loss of power the watchdog of the
    board must switch the drive off. Signals are held until the record is complete; one
    that arrives after the loop's end is delivered then.

    Parameters
    ----------
    law
        from `Design.law`, at the period of the arm, 50 µs to 1 s. With a motor loop it
        gives a voltage.
    reference
        of the tip, relative to where the arm stands, e.g. `smooth_step`.
    connection
        how the arm is reached.
    duration
        time to run [s]; default: until 5 s after the reference's end.
    out
        file for the record (NPZ). A path that cannot be written is refused before the
        arm moves; if writing fails afterwards, the record goes to the folder of
        temporary files or the home folder (`RealtimeRun.saved`).
    payload
        payload that the law is given [kg]; 0 for none.
    estimator
        from `Design.estimator`: the law is given its estimate while the arm moves,
        instead of `payload`.
    patience
        time to wait for the first sample [s].
    priority
        SCHED_FIFO priority; 0 asks for none. If it is refused, the result says so, and
        the run continues.
    lock_memory
        whether to keep the process in memory (mlockall) while the loop runs.
    allowed_overruns
        largest number of overruns with which the run passes.
    clock
        of a test, with `now_ns()` and `sleep_until(ns)`; default: the machine's.

    Raises
    ------
    FieldError
        A value out of its range, an arm that does not answer or runs at another period,
        an estimator for another period, a path where the record cannot be written, an
        operating system other than Linux.
    SizeError
        More than 2 000 000 periods.

    Notes
    -----
    Source: the manual pages clock_nanosleep(2), mlockall(2), sched(7) and signal(7).

    Examples
    --------
    >>> import fraclink as fl
    >>> from fraclink.lab._connections import Callback
    >>> from fraclink.lab._loop import run_realtime
    >>> rig = fl.Rig.named("paper-2023")
    >>> controller = fl.Controller(derivative_gain=0.069876, derivative_order=0.612197, link=rig.model)
    >>> law = fl.discretize(controller, rig.period, order=4)
    >>> given = []
    >>> at_rest = Callback(read=lambda: (0.2, 0.0), write=given.append)
    >>> run = run_realtime(law, fl.extend.hold(0.0), at_rest, duration=0.04, priority=0, lock_memory=False)
    >>> run.stopped, round(float(run.motor_reference[-1]), 6), run.first_difference, given[-1].mode
    ('finished', 0.2, None, 4)
    """
    check_machine()
    if out is not None:
        check_ending(RealtimeRun, output_path(out, force=True))
    # The law would silently use one of them, and the motion would not show which.
    if estimator is not None and payload:
        raise FieldError(
            "payload",
            payload,
            "given beside an estimator",
            "payload or estimator",
            "leave one of them out",
        )
    if estimator is not None:
        estimator = estimator_for(law, estimator)
    nanoseconds = period_ns(law.period)
    if duration is not None:
        Between(law.period, 1e300, "s").check("duration", duration)
    path = sampled(reference, law.period, duration)
    with contextlib.ExitStack() as stack:
        with controller_end(connection) as arm:
            obeyed = stack.enter_context(signals_held())
            outcome, record, marks = _kernels.realtime_run(
                arm,
                law.block,
                law.initial_state(),
                law.precision == "single",
                # Angle and acceleration: the law does not use the velocity.
                np.ascontiguousarray(path[[0, 2]]),
                payload,
                b"" if estimator is None else estimator.block,
                b"" if estimator is None else estimator.initial_state(),
                nanoseconds,
                round(1e9 * patience),
                priority,
                lock_memory,
                _kernels.RealtimeClock(clock),
            )
        if STOPS[int(outcome["stop"])] == "signal":
            obeyed.set()
        # A run that never began is an error; a run that began has a record, however it
        # ended.
        _check_answer(outcome, connection, law.period, patience)
        columns: dict[str, NDArray[Any]] = {
            name: record[:, i].copy() for i, name in enumerate(SIGNALS)
        }
        columns |= {name: marks[:, i].copy() for i, name in enumerate(MARKS)}
        scheduling, memory = granted(outcome, priority, lock_memory)
        run = RealtimeRun(
            **columns,  # type: ignore[arg-type]  # by name
            period=law.period,
            law_sha256=law.digest,
            connection=str(connection),
            stopped=STOPS[int(outcome["stop"])],
            lost_commands=int(outcome["lost"]),
            scheduling=scheduling,
            memory=memory,
            origin=float(outcome["origin"]),
            # Replayed immediately, while the same law is in memory: a bit flip must not
            # pass unnoticed.
            first_difference=first_difference(law, columns),
            allowed_overruns=allowed_overruns,
            planned=path.shape[1],
            estimator=estimator,
        )
        return run if out is None else replace(run, saved=str(saved(run, out)))


def _check_answer(
    outcome: dict[str, float], connection: Connection, period: float, patience: float
) -> None:
    stop = STOPS[int(outcome["stop"])]
    if stop == "no sample":
        raise silent(connection, patience)
    if stop == "other period":
        raise FieldError(
            "period",
            period,
            "not the arm's",
            f"{1e-9 * outcome['period_ns']:g} s",
            "run the arm at the law's period, or design for the arm's",
        )
