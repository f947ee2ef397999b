"""Real time on this machine: the loop with its law next to a bare clock_nanosleep loop.

Loop and bare loop alternate in one run, with the same priority, timer slack and locked
memory, on an idle machine and next to two computing processes; every figure is over all
rounds. Times are wall-clock times: on a busy or virtual machine the tail is due to the
machine, which the bare loop shows.

Then the serial line: the same loop and a served arm at the two ends of a pseudo-terminal,
which carries bytes at once whatever its speed, and the exported firmware of an arm with
damaged commands: bits flipped, bytes lost, bytes added.
"""

from __future__ import annotations

import ctypes
import io
import queue
import struct
import subprocess
import sys
import tempfile
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np

import fraclink as fl
from fraclink import Callback, Law, _kernels
from fraclink.extend import equip, geared
from fraclink.lab import (
    RealtimeRun,
    Serial,
    measure_wake_ups,
    parse_connection,
    run_realtime,
    serve_arm,
)
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


def serial_line(period: float, seconds: float) -> None:
    """Frames lost between the loop and an arm behind a pseudo-terminal."""
    twin = fl.Twin.from_rig(replace(RIG, period=period))
    names: queue.Queue[str] = queue.Queue()
    # A run ends where the machine stands still for six periods; another one follows.
    arm = threading.Thread(
        target=serve_arm,
        args=(twin, Serial("pty"), period),
        kwargs={"duration": 1.2 * seconds + 5.0, "begin": names.put},
        daemon=True,
    )
    arm.start()
    name = names.get(timeout=30.0).removeprefix("arm at ")
    way = parse_connection(f"{name}@1000000")
    runs, periods = list[RealtimeRun](), 0
    while periods * period < seconds and arm.is_alive():
        left = seconds - periods * period
        run = run_realtime(law_at(period), fl.extend.hold(0.0), way, duration=left)
        runs.append(run)
        periods += run.latency.size + run.missed
    lost = sum(run.lost_samples + run.lost_commands for run in runs)
    missed = sum(run.missed for run in runs)
    still = max(float(run.latency.max()) for run in runs)
    line(
        f"serial, 1 Mbaud, {1e3 * period:g} ms, {periods * period:.0f} s: frames lost",
        f"{lost} of {2 * periods}",
        "< 0.1 %",
        lost < 2e-3 * periods,
        note=f"{runs[0].scheduling}; the machine missed {missed} periods, stood still for up to "
        f"{1e3 * still:.2g} ms, and ended {len(runs) - 1} runs",
    )


def command(sequence: int, voltage: float, mode: int, run: int) -> bytes:
    """A command to an arm, as the page on file formats describes it."""
    body = struct.pack(
        "<4sHHIIddIIIQ", b"FLRT", 2, 2, sequence, 1, 0.0, voltage, mode, 0, 0, run
    )
    return body + struct.pack("<I", zlib.crc32(body))


def damaged(whole: bytes, random: np.random.Generator) -> bytes:
    """The message with some bits flipped, some bytes lost, or some added."""
    data = np.frombuffer(whole, dtype=np.uint8)
    count, kind = int(random.integers(1, 9)), random.integers(3)
    if kind == 0:
        bits = random.choice(8 * data.size, count, replace=False)
        flips = np.zeros(8 * data.size, dtype=np.uint8)
        flips[bits] = 1
        return (data ^ np.packbits(flips)).tobytes()
    places = random.choice(data.size - 1, count, replace=False) + 1
    if kind == 1:
        return np.delete(data, places).tobytes()
    return np.insert(data, places, random.integers(0, 256, count)).tobytes()


def damage(count: int) -> None:
    """Damaged commands that the exported firmware obeys."""
    random = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        with redirect_stdout(io.StringIO()):
            fl.main(["export", "arm-firmware", "--out", folder])
        built = Path(folder) / "arm_link.so"
        words = ["cc", "-O2", "-shared", "-fPIC", str(built.with_suffix(".c")), "-o"]
        subprocess.run([*words, str(built)], check=True)  # noqa: S603
        firmware = ctypes.CDLL(str(built))
    link, message = ctypes.create_string_buffer(512), ctypes.create_string_buffer(56)
    voltage, zero = ctypes.c_float(), ctypes.c_float(0.0)

    def period(data: bytes) -> float:
        for byte in data:
            firmware.arm_link_take(link, ctypes.c_uint8(byte))
        firmware.arm_link_period(link, zero, zero, ctypes.byref(voltage), message)
        return voltage.value

    firmware.arm_link_begin(link, 4000, 1)
    period(command(1, 0.0, 0, 0))
    (run,) = struct.unpack_from("<Q", message.raw, 44)
    wrong = recovered = 0
    for number in range(count):
        sequence = 3 * number + 2
        # no whole command has 9 V
        wrong += period(damaged(command(sequence, 9.0, 1, run), random)) == 9.0
        # what is left of a damaged message may take the next one with it
        period(command(sequence + 1, 1.0, 1, run))
        recovered += period(command(sequence + 2, 2.0, 1, run)) == 2.0
    line(
        f"damaged commands that are obeyed, of {count}",
        f"{wrong}",
        "0",
        wrong == 0,
    )
    line(
        "whole commands obeyed, the second after a damaged one",
        f"{recovered} of {count}",
        "all",
        recovered == count,
    )


def main() -> None:
    given = sizes(
        __doc__,
        milliseconds=(2000, 50),
        rounds=(3, 1),
        seconds=(600, 1),
        damaged=(100_000, 100),
    )
    if not _kernels.REALTIME:
        line("the real-time loop", "not on this system", "Linux")
        return
    for busy in (0, 2):
        for period in (0.004, 0.001):
            jitter(period, 1e-3 * given.milliseconds, given.rounds, busy)
    serial_line(0.004, given.seconds)
    damage(given.damaged)


if __name__ == "__main__":
    main()
