"""Figures of campaigns: speed of the loop with its law, set-up, scaling, memory, and
what Python adds.

    python benchmarks/bench_campaign.py [--runs 2000]

Every line: what was measured | value | wanted | error beside it.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import fraclink as fl
from fraclink._campaign import Campaign, run_campaign, simulate_part
from fraclink._campaign import arms as part_module
from fraclink._campaign.campaign import draw
from fraclink._simulate.kernel import SUBSTEPS, LumpedArms

ROOT = Path(__file__).resolve().parent.parent
TICKS = 5000


def line(what: str, value: str, wanted: str, error: str = "") -> None:
    """Print one figure."""
    print(f"{what} | {value} | {wanted} | {error}", flush=True)


def campaign(runs: int, *, ticks: int = 1001) -> Campaign:
    """The paper's arm under our own order-4 law with all its guards, motor loop and
    friction included.
    """
    rig = fl.Rig.named("paper-2023")
    law = fl.discretize(
        fl.Controller(gain=0.069876, order=0.612197, link=rig.model),
        rig.period,
        order=4,
    )
    return replace(
        Campaign.of(rig, rig.model, law, runs=runs, seed=7),
        duration=(ticks - 1) * law.period,
    )


def seconds(work: Callable[[], object]) -> float:
    """Processor time of this thread: what others do on the machine does not count."""
    began = time.thread_time()
    work()
    return time.thread_time() - began


def accounted(what: Callable[..., object], spent: list[float]) -> Callable[..., object]:
    """`what`, its processor time added to `spent`."""

    def timed(*arguments: object, **options: object) -> object:
        began = time.thread_time()
        try:
            return what(*arguments, **options)
        finally:
            spent.append(time.thread_time() - began)

    return timed


def speed(runs: int) -> None:
    """10 000 runs × 5000 ticks, from a sample of `runs` runs, repeated."""
    asked = campaign(runs, ticks=TICKS)
    whole, links, measure = [], [], []
    before = part_module.batch_links, part_module.measure_many
    part_module.batch_links = accounted(before[0], links)  # type: ignore[assignment]
    part_module.measure_many = accounted(before[1], measure)  # type: ignore[assignment]
    try:
        for _ in range(5):
            links.clear(), measure.clear()
            total = seconds(
                lambda: [simulate_part(asked, part) for part in range(asked.parts)]
            )
            whole.append((total, sum(links), sum(measure)))
    finally:
        part_module.batch_links, part_module.measure_many = before
    scale = 10_000 / runs
    total, setup, metrics = (
        statistics.median(column) * scale for column in zip(*whole, strict=True)
    )
    spread = (max(w[0] for w in whole) - min(w[0] for w in whole)) * scale
    line(
        "10 000 runs x 5000 ticks, guards, noise, 10 friction substeps, one core",
        f"{total:.2f} s",
        "<= 8 s",
        f"spread of 5: {spread:.2f} s",
    )
    line(
        "  of it the kernel",
        f"{total - setup - metrics:.2f} s = {(total - setup - metrics) * 20:.0f} ns/tick",
        "-",
    )
    line("  of it the metrics", f"{metrics:.2f} s", "-")
    line("  of it the set-up of the links", f"{100 * setup / total:.1f} %", "<= 10 %")
    values = draw(asked.draws, asked.seed, 0, 1000)
    drawing = seconds(lambda: draw(asked.draws, asked.seed, 0, 1000)) * 10
    line(
        "  drawing the parameters of 10 000 runs",
        f"{100 * drawing / total:.2f} %",
        "<= 10 %",
        f"{len(values)} names",
    )


def scaling() -> None:
    """One worker against two, wall clock, interleaved; what it means when others use
    the machine is told.
    """
    asked = campaign(8000, ticks=TICKS)
    ratios, loads = [], os.getloadavg()[0]
    for _ in range(3):
        took = {}
        for workers in (1, 2):
            with tempfile.TemporaryDirectory() as folder:
                finished: list[float] = []
                run_campaign(
                    asked,
                    folder,
                    workers=workers,
                    watch=lambda _, f=finished: f.append(time.monotonic()),
                )
                # From the first part on: the start of processes is a constant of 2 s,
                # whatever the campaign.
                took[workers] = (finished[-1] - finished[workers - 1]) / (
                    len(finished) - workers
                )
        ratios.append(took[1] / took[2])
    spread = f"{min(ratios):.2f} ... {max(ratios):.2f} of 3"
    line(
        "two workers against one",
        f"{statistics.median(ratios):.2f} x",
        ">= 1.9 x",
        f"{spread}; load before {loads:.1f}",
    )


ALONE = """
import sys, time
from fraclink._campaign import load_campaign, simulate_part
asked = load_campaign(sys.argv[1])
simulate_part(asked, 0)
began = time.thread_time()
for part in range(1, 4):
    simulate_part(asked, part)
print(time.thread_time() - began)
"""


def implied() -> None:
    """The same by processor time, which others disturb less: one process against two at
    once.
    """
    from fraclink._campaign import save_campaign

    with tempfile.TemporaryDirectory() as folder:
        save_campaign(campaign(8000, ticks=TICKS), Path(folder))
        ratios = []
        for _ in range(3):
            took = {}
            for count in (1, 2):
                line_ = [sys.executable, "-c", ALONE, folder]
                running = [
                    subprocess.Popen(line_, stdout=subprocess.PIPE)  # noqa: S603
                    for _ in range(count)
                ]
                took[count] = max(
                    float(process.communicate()[0]) for process in running
                )
            ratios.append(2.0 * took[1] / took[2])
    spread = f"{min(ratios):.2f} ... {max(ratios):.2f} of 3"
    line(
        "  by processor time, two at once against one",
        f"{statistics.median(ratios):.2f} x",
        ">= 1.9 x",
        spread,
    )


MEMORY = """
import resource, sys
from fraclink._campaign.run import compute
for part in range(int(sys.argv[2])):
    compute(sys.argv[1], part)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def memory() -> None:
    """Largest resident memory of a worker after 1 and after 20 parts of a campaign of a
    million runs.
    """
    from fraclink._campaign import save_campaign

    with tempfile.TemporaryDirectory() as folder:
        save_campaign(campaign(1_000_000), Path(folder))
        peaks = []
        for parts in ("1", "20"):
            command = [sys.executable, "-c", MEMORY, folder, parts]
            told = subprocess.run(command, capture_output=True, check=True)  # noqa: S603
            peaks.append(int(told.stdout) / 1024)
    line(
        "memory of a worker after 20 parts",
        f"{peaks[1]:.0f} MB",
        "<= 500 MB",
        f"after one part {peaks[0]:.0f} MB",
    )


DRIVER = r"""
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "loop.h"
#include "group.h"
static double *floats(FILE *f, long n) { double *p = malloc(sizeof(double) * (size_t)n);
  if (fread(p, sizeof(double), (size_t)n, f) != (size_t)n) exit(1); return p; }
int main(int argc, char **argv) {
  FILE *f = fopen(argv[1], "rb"); (void)argc;
  long head[4]; loop_rig rig;
  if (!f || fread(head, sizeof head, 1, f) != 1 || fread(&rig, sizeof rig, 1, f) != 1) return 1;
  const long n = head[0], reals = head[1], pairs = head[2], bytes = head[3];
  double *first = floats(f, 6), *decay = floats(f, reals), *weight = floats(f, 6 * reals);
  double *pr = floats(f, pairs), *pi = floats(f, pairs);
  double *wr = floats(f, 6 * pairs), *wi = floats(f, 6 * pairs);
  double *angle = floats(f, n), *acceleration = floats(f, n), stiffness = *floats(f, 1);
  void *params = aligned_alloc(64, (size_t)((bytes + 63) / 64 * 64));
  if (fread(params, 1, (size_t)bytes, f) != (size_t)bytes) return 1;
  loop_link link = {(int)reals, (int)pairs, decay, weight, pr, pi, wr, wi, {0}, stiffness};
  for (int j = 0; j < 6; j++) link.first[j] = first[j];
  double *o = malloc(sizeof(double) * 9 * (size_t)n), *normal = o + 8*n;
  uint32_t *m = malloc(4 * 3 * (size_t)n);
  const loop_input path = {n, angle, acceleration, normal, NULL};
  const loop_trace t = {o, o + n, o + 2*n, o + 3*n, o + 4*n, o + 5*n, o + 6*n, o + 7*n, m, m + n, m + 2*n};
  const int repeats = atoi(argv[2]);
  struct timespec a, b;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &a);
  for (int r = 0; r < repeats; r++) {
    rig.weights = loop_weights_of(&rig);
    loop_normals((uint64_t)r, normal, n);
    if (loop_run(&link, &rig, &LAW_IN_DOUBLE, params, &path, &t)) return 1;
  }
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &b);
  printf("%.9f %.17g\n", (double)(b.tv_sec - a.tv_sec) + 1e-9 * (double)(b.tv_nsec - a.tv_nsec), o[n - 1]);
  return 0;
}
"""


def plain_c() -> None:
    """The loop, one run at a time, from a C program and from Python, on the same
    numbers, in turns.
    """
    asked = campaign(64, ticks=TICKS)
    drawn = {name: column[:64] for name, column in draw(asked.draws, 7, 0, 64).items()}
    arms, chosen = part_module.block_of(asked, drawn, 0)
    alone, path = arms.rows(slice(0, 1)), part_module.unit_paths(asked)
    shared = part_module.shared_rig(asked.rig, asked.law, asked.motor_loop)
    links = alone.links
    angle, acceleration = alone.amplitude[0] * path[chosen[0]]
    pieces = [
        links.first[0],
        links.decay[0],
        links.weight[0],
        links.pair[0].real,
        links.pair[0].imag,
    ]
    pieces += [
        links.pair_weight[0].real,
        links.pair_weight[0].imag,
        angle,
        acceleration,
        alone.stiffness,
    ]

    def from_python(repeats: int) -> float:
        for seed in range(repeats):
            arm = replace(alone, seed=np.array([seed], dtype=np.uint64))
            signals, _ = part_module.run_lumped(
                asked.law, shared, arm, path, chosen[:1], everything=True
            )
        return float(signals[0, 0, -1])

    with tempfile.TemporaryDirectory() as folder:
        program = compiled(Path(folder))
        head = np.array(
            [TICKS, links.decay.shape[1], links.pair.shape[1], len(asked.law.block)],
            dtype=np.int64,
        )
        rig = rig_bytes(asked, alone)
        data = b"".join(
            [
                head.tobytes(),
                rig,
                *(np.ascontiguousarray(p).tobytes() for p in pieces),
                asked.law.block,
            ]
        )
        (Path(folder) / "data").write_bytes(data)
        ratios = []
        for _ in range(7):
            out = subprocess.run(  # noqa: S603
                [program, str(Path(folder) / "data"), "200"],
                capture_output=True,
                check=True,
                text=True,
            ).stdout.split()
            took = seconds(lambda: from_python(200))
            assert float(out[1]) == from_python(200), "C and Python disagree"
            ratios.append(took / float(out[0]))
    spread = f"{min(ratios):.3f} ... {max(ratios):.3f} of 7; same last bit"
    line(
        "one run at a time, from Python against plain C",
        f"{statistics.median(ratios):.3f} x",
        "<= 1.1 x",
        spread,
    )


def rig_bytes(asked: Campaign, arm: LumpedArms) -> bytes:
    """The C struct loop_rig of an arm: three ints, padding, doubles, room for the
    weights.
    """
    rig, law = asked.rig, asked.law
    own = (arm.motor_gain, arm.motor_decay, arm.friction)
    gauge = (
        rig.gauge.limit,
        rig.gauge.quantum,
        float(arm.gauge_delay[0]),
        float(arm.gauge_gain[0]),
    )
    reals = [
        law.period,
        law.inner_pole,
        *(float(value[0]) for value in own),
        0.0,
        rig.encoder.resolution,
    ]
    reals += [
        float(arm.gauge_offset[0]),
        float(arm.noise[0]),
        *gauge,
        float(arm.payload_given[0]),
        0.0,
    ]
    return struct.pack("@3i4x15d24x", 1, SUBSTEPS, int(arm.delay_samples[0]), *reals)


def compiled(folder: Path) -> str:
    """Build the driver with the package's own sources and options."""
    (folder / "driver.c").write_text(DRIVER)
    kernels, common = (
        ROOT / "csrc" / "kernels",
        ["-I", str(ROOT / "csrc"), "-I", str(ROOT / "csrc" / "kernels")],
    )
    options = ["-ffp-contract=off", "-fPIC", "-DWITHOUT_ESTIMATOR"]
    fast = [
        "-O3",
        "-std=gnu11",
        "-fopenmp-simd",
        "-fno-math-errno",
        "-fno-trapping-math",
        *options,
    ]
    law = [
        "-O2",
        "-std=c99",
        *options,
        "-c",
        str(ROOT / "csrc" / "law.c"),
        "-o",
        str(folder / "law.o"),
    ]
    subprocess.run(["cc", *law], check=True)  # noqa: S603, S607
    sources = [
        str(folder / "driver.c"),
        str(kernels / "law_port.c"),
        str(kernels / "loop.c"),
        str(kernels / "normal.c"),
        str(kernels / "weights.c"),
        str(folder / "law.o"),
    ]
    subprocess.run(  # noqa: S603
        ["cc", *fast, *common, *sources, "-lm", "-o", str(folder / "driver")],  # noqa: S607
        check=True,
    )
    return str(folder / "driver")


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    asked = parser.parse_args()
    speed(asked.runs)
    plain_c()
    memory()
    scaling()
    implied()
    line(
        "peak memory of this benchmark",
        f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB",
        "-",
    )


if __name__ == "__main__":
    main()
