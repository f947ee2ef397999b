"""Real time on this machine: the loop beside a bare clock_nanosleep loop, and what each
way to an arm costs.

    python benchmarks/bench_realtime.py [--seconds 2] [--rounds 3]

Loop and bare loop take turns in one run, with the same priority, timer slack and locked
memory, on a machine that is left alone and beside two processes that compute; every
figure is over all rounds. Every line: what was measured | value | wanted | error beside
it. Times are wall-clock: on a busy or a virtual machine the tail is the machine's,
which is why the bare loop stands beside it.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

import fraclink as fl
from fraclink import _kernels
from fraclink._export import export_io
from fraclink._law import Law, equip
from fraclink._realtime import (
    Callback,
    Connection,
    Library,
    RealtimeRun,
    SharedMemory,
    Udp,
    measure_wake_ups,
    run_realtime,
    serve_arm,
)
from fraclink._simulate import Twin, geared

RIG = geared(fl.Rig.named("paper-2023"))
PRIORITY = 80
PORT = 50_231
EDGES = (1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)  # [s] of the histogram


def line(what: str, value: str, wanted: str, error: str = "") -> None:
    """Print one figure."""
    print(f"{what} | {value} | {wanted} | {error}", flush=True)


def law_at(period: float) -> Law:
    """Return the paper's design on the geared arm, with its motor loop."""
    assert RIG.model is not None
    controller = fl.Controller(gain=0.069876, order=0.612197, link=RIG.model)
    return equip(
        fl.discretize(controller, period, order=5),
        replace(RIG, period=period),
        RIG.model,
    )


def board(folder: Path) -> Connection:
    """Return the template's board in C, or two functions of Python where no compiler is
    there.
    """
    compiler = shutil.which("cc")
    if compiler is None:
        return still()
    export_io(folder)
    command = [
        compiler,
        "-std=c99",
        "-O2",
        "-shared",
        "-fPIC",
        "my_board.c",
        "-o",
        "my_board.so",
    ]
    subprocess.run(command, cwd=folder, check=True)  # noqa: S603
    return Library(folder / "my_board.so")


def still() -> Callback:
    """Return an arm that stands still, in Python."""
    return Callback(lambda: (0.0, 0.0), lambda command: None)


def told(values: np.ndarray) -> str:
    """Median, 99.9 % and largest, in microseconds."""
    parts = (
        float(np.median(values)),
        float(np.quantile(values, 0.999)),
        float(values.max()),
    )
    return "/".join(f"{1e6 * part:.1f}" for part in parts) + " µs"


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Let `count` processes compute beside the block."""
    loops = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in range(count)
    ]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def histogram(latency: np.ndarray) -> str:
    """Wake-ups by how late they came: a power of ten in two bars."""
    counts, _ = np.histogram(latency, (0.0, *EDGES, np.inf))
    names = [f"< {time_text(edge)}" for edge in EDGES] + [f">= {time_text(EDGES[-1])}"]
    return ", ".join(
        f"{name}: {count}" for name, count in zip(names, counts, strict=True) if count
    )


def time_text(seconds: float) -> str:
    return f"{1e3 * seconds:g} ms" if seconds >= 1e-3 else f"{1e6 * seconds:g} µs"


def jitter(
    period: float, seconds: float, rounds: int, way: Connection, busy: int
) -> None:
    """Latency of the loop and of the bare one, in turns, beside `busy` processes that
    compute.
    """
    law = law_at(period)
    runs: list[RealtimeRun] = []
    bare: list[np.ndarray] = []
    with busy_loops(busy):
        for _ in range(rounds):
            awake = measure_wake_ups(
                period, duration=seconds, step=period, priority=PRIORITY
            )
            bare.append(awake.latency)
            runs.append(
                run_realtime(
                    law, fl.hold(0.0), way, duration=seconds, priority=PRIORITY
                )
            )
    loop, peer = np.concatenate([run.latency for run in runs]), np.concatenate(bare)
    granted = f"{runs[0].scheduling}, memory {runs[0].memory}"
    name = f"{1e3 * period:g} ms, {busy} busy: "
    line(
        f"{name}bare clock_nanosleep, median/99.9 %/largest",
        told(peer),
        "printed",
        granted,
    )
    line(f"{name}loop with law, latency", told(loop), "printed", f"{len(loop)} periods")
    line(f"{name}histogram of the bare loop", histogram(peer), "printed")
    line(f"{name}histogram of the loop with law", histogram(loop), "printed")
    ratio = float(np.median(loop) / np.median(peer))
    line(
        f"{name}median latency, loop / bare",
        f"{ratio:.2f}",
        "<= 1.5",
        "same run, in turns",
    )
    work = np.concatenate([run.work for run in runs])
    line(
        f"{name}work: read, law, write",
        told(work),
        "printed",
        str(way).partition(":")[0],
    )
    late = [np.count_nonzero(values > period) for values in (loop, peer)]
    overruns = sum(run.overruns for run in runs)
    line(
        f"{name}wake-ups later than a period, loop and bare",
        f"{late[0]}, {late[1]}",
        "0, 0",
    )
    line(
        f"{name}overruns",
        str(overruns),
        "0",
        f"{sum(run.missed for run in runs)} periods missed",
    )
    same = all(run.first_difference is None for run in runs)
    line(
        f"{name}records that replay to the last bit",
        "all" if same else "not all",
        "all",
    )


def ways(seconds: float, way: Connection) -> None:
    """What a period costs by each way to the arm, at 4 ms."""
    law, twin = law_at(0.004), Twin.from_rig(RIG, link_mass=0.00735)
    direct = run_realtime(law, fl.hold(0.0), way, duration=seconds)
    line("work by " + str(way).partition(":")[0], told(direct.work), "printed")
    for connection in (
        SharedMemory("bench"),
        Udp("127.0.0.1", PORT),
        Udp("127.0.0.1", PORT, key=bytes(32)),
    ):
        arm = threading.Thread(
            target=serve_arm, args=(twin, connection, 0.004), kwargs={"once": True}
        )
        arm.start()
        run = run_realtime(law, fl.smooth_step(0.5, 0.5), connection, duration=seconds)
        arm.join()
        kind = str(connection).partition(":")[0]
        kind += " with a key" if getattr(connection, "key", None) else ""
        lost = f"{run.lost_samples} samples lost in {len(run.tick)} periods"
        line(f"work by {kind}", told(run.work), "printed", lost)
    idle = run_realtime(law, fl.hold(0.0), still(), duration=seconds)
    line(
        "work by two functions of Python",
        told(idle.work),
        "printed",
        "interpreter idle",
    )
    busy, end = threading.Event(), threading.Event()

    def hold_the_interpreter() -> None:
        busy.set()
        while not end.is_set():
            sum(range(10_000))

    rival = threading.Thread(target=hold_the_interpreter)
    rival.start()
    busy.wait()
    contested = run_realtime(law, fl.hold(0.0), still(), duration=seconds)
    end.set()
    rival.join()
    line(
        "the same beside a busy thread of Python",
        told(contested.work),
        "printed",
        f"{contested.overruns} overruns, stopped: {contested.stopped}",
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    if not _kernels.REALTIME:
        line("the real-time loop", "not on this system", "Linux")
        return
    with tempfile.TemporaryDirectory() as folder:
        way = board(Path(folder))
        for busy in (0, 2):
            for period in (0.004, 0.001):
                jitter(period, given.seconds, given.rounds, way, busy)
        ways(given.seconds, way)


if __name__ == "__main__":
    main()
