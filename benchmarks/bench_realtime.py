"""Real time on this machine: the loop with its law next to a bare clock_nanosleep loop.

Loop and bare loop alternate in one run, with the same priority, timer slack and locked
memory, on an idle machine and next to two computing processes; every figure is over all
rounds. Times are wall-clock times: on a busy or virtual machine the tail is due to the
machine, which the bare loop shows.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

import fraclink as fl
from fraclink import Callback, Law, _kernels
from fraclink.extend import equip, geared
from fraclink.lab import measure_wake_ups, run_realtime
from harness import line, sizes

RIG = geared(fl.Rig.named("paper-2023"))
PRIORITY = 80


def law_at(period: float) -> Law:
    """The paper's design on the geared arm, with its motor loop."""
    assert RIG.model is not None
    controller = fl.Controller(
        derivative_gain=0.069876, derivative_order=0.612197, link=RIG.model
    )
    law = fl.discretize(controller, period, order=5)
    return equip(law, replace(RIG, period=period), RIG.model)


def quantiles(values: np.ndarray) -> str:
    """Median, 99.9 % and largest."""
    parts = 1e6 * np.quantile(values, (0.5, 0.999, 1.0))
    return "/".join(f"{part:.1f}" for part in parts) + " µs"


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Let `count` processes compute while the block runs."""
    words = [sys.executable, "-c", "while True: pass"]
    loops = [subprocess.Popen(words) for _ in range(count)]  # noqa: S603
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def jitter(period: float, seconds: float, rounds: int, busy: int) -> None:
    """Latency of the loop and of the bare one, measured in turns, while `busy` processes
    compute.
    """
    law, arm = law_at(period), Callback(lambda: (0.0, 0.0), lambda command: None)
    runs, bare = [], []
    options = {"duration": seconds, "priority": PRIORITY}
    with busy_loops(busy):
        for _ in range(rounds):
            bare.append(measure_wake_ups(period, step=period, **options).latency)
            runs.append(run_realtime(law, fl.extend.hold(0.0), arm, **options))
    loop, peer = np.concatenate([run.latency for run in runs]), np.concatenate(bare)
    name = f"{1e3 * period:g} ms, {'busy' if busy else 'quiet'}: "
    granted = f"{runs[0].scheduling}, memory {runs[0].memory}"
    late = [np.count_nonzero(values > period) for values in (loop, peer)]
    ratio = float(np.median(loop) / np.median(peer))
    work = quantiles(np.concatenate([run.work for run in runs]))
    line(f"{name}latency of a bare loop", quantiles(peer), "printed", note=granted)
    line(f"{name}latency of the loop with its law", quantiles(loop), "printed")
    line(f"{name}loop / bare, median", f"{ratio:.2f}", "<= 1.5", ratio <= 1.5)
    line(f"{name}work: read, law, write", work, "printed")
    line(f"{name}late by a period, loop and bare", f"{late[0]}, {late[1]}", "0, 0")
    same = all(run.first_difference is None for run in runs)
    line(f"{name}records replay to the last bit", str(same), "True", same)


def main() -> None:
    given = sizes(__doc__, milliseconds=(2000, 50), rounds=(3, 1))
    if not _kernels.REALTIME:
        line("the real-time loop", "not on this system", "Linux")
        return
    for busy in (0, 2):
        for period in (0.004, 0.001):
            jitter(period, 1e-3 * given.milliseconds, given.rounds, busy)


if __name__ == "__main__":
    main()
