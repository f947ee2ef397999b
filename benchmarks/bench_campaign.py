"""Figures of campaigns: speed of the loop with its law, set-up, scaling, memory; faults
of the catalogue, and every bit of the law's memory.
"""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import fraclink as fl
from fraclink._law import MODES
from fraclink._simulate.kernel import ArmState
from fraclink.trials import (
    Bench,
    Campaign,
    Case,
    cases,
    fault_named,
    run_campaign,
    run_faults,
    simulate_part,
)
from fraclink.trials import _arms as part_module
from fraclink.trials._fault_trial import execute
from harness import line, sizes

ROOT = Path(__file__).resolve().parent.parent
TICKS = 5000


def campaign(runs: int, *, ticks: int = 1001) -> Campaign:
    """The paper's arm under our own order-4 law with all its guards, motor loop and
    friction included.
    """
    rig = fl.Rig.named("paper-2023")
    law = fl.discretize(
        fl.Controller(
            derivative_gain=0.069876, derivative_order=0.612197, link=rig.model
        ),
        rig.period,
        order=4,
    )
    return replace(
        Campaign.of(rig, rig.model, law, runs=runs, seed=7),
        duration=(ticks - 1) * law.period,
    )


def seconds(work: Callable[[], object]) -> float:
    """Processor time of this thread: other work on the machine does not count."""
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


def speed(runs: int, rounds: int) -> None:
    """10 000 runs × 5000 ticks, from a sample of `runs` runs, repeated."""
    asked = campaign(runs, ticks=TICKS)
    whole, links, measure = [], [], []
    before = part_module.batch_links, part_module.measure_many
    part_module.batch_links = accounted(before[0], links)  # type: ignore[assignment]
    part_module.measure_many = accounted(before[1], measure)  # type: ignore[assignment]
    try:
        for _ in range(rounds):
            links.clear(), measure.clear()
            total = seconds(
                lambda: [simulate_part(asked, part) for part in range(asked.parts)]
            )
            whole.append((total, sum(links), sum(measure)))
    finally:
        part_module.batch_links, part_module.measure_many = before
    scale = 10_000 / runs
    total, setup, metrics = (
        float(np.median(column)) * scale for column in zip(*whole, strict=True)
    )
    spread = (max(w[0] for w in whole) - min(w[0] for w in whole)) * scale
    line(
        "10 000 runs x 5000 ticks, guards, noise, 10 friction substeps, one core",
        f"{total:.2f} s",
        "<= 8 s",
        total <= 8,
        f"spread of 5: {spread:.2f} s",
    )
    line(
        "  of it the kernel",
        f"{total - setup - metrics:.2f} s = {(total - setup - metrics) * 20:.0f} ns/tick",
        "-",
    )
    line("  of it the metrics", f"{metrics:.2f} s", "-")
    line(
        "  of it the set-up of the links",
        f"{100 * setup / total:.1f} %",
        "<= 10 %",
        setup <= 0.1 * total,
    )


def scaling(runs: int) -> None:
    """One worker against two, wall clock, interleaved; the load of the machine is
    printed with it.
    """
    asked = campaign(runs, ticks=TICKS)
    ratios, loads = [], os.getloadavg()[0]
    for _ in range(3):
        took = {}
        for workers in (1, 2):
            finished: list[float] = []
            run_campaign(
                asked,
                workers=workers,
                watch=lambda *_, f=finished: f.append(time.monotonic()),
            )
            # From the first finished part on, so that the start does not count.
            took[workers] = (finished[-1] - finished[workers - 1]) / (
                len(finished) - workers
            )
        ratios.append(took[1] / took[2])
    spread = f"{min(ratios):.2f} ... {max(ratios):.2f} of 3"
    line(
        "two workers against one",
        f"{np.median(ratios):.2f} x",
        ">= 1.9 x",
        bool(np.median(ratios) >= 1.9),
        f"{spread}; load before {loads:.1f}",
    )


def memory(parts: int) -> None:
    """Largest resident memory of this process after 1 and after many parts."""
    peaks = []
    for count in (1, parts):
        run_campaign(campaign(1000 * count))
        peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    line(
        f"memory after {parts} parts",
        f"{peaks[1]:.0f} MB",
        "<= 500 MB",
        peaks[1] <= 500,
        f"after one part {peaks[0]:.0f} MB",
    )


def bench() -> Bench:
    """The geared arm, its link with mass, under the design of the documentation."""
    rig = fl.Rig.named("paper-2023-geared")
    request = {"gain_crossover": 12.0, "phase_margin": fl.deg(50)}
    design = fl.design(rig.model, rig, payloads=(0.020, 0.040), **request)
    return Bench.of(design, link_mass=0.00735)


def faults(tested: Bench, seeds: int) -> None:
    """The whole catalogue, at every severity, payload and phase."""
    planned = cases(tested, seeds=tuple(range(1, seeds + 1)) or (1,))
    planned = planned if seeds else planned[:3]
    began = time.thread_time()
    table = run_faults(tested, planned)
    spent = time.thread_time() - began
    rows = table.rows()
    for row in (row for row in rows if not row.passed):
        print(
            f"  {row.number}: {row.failed} of {row.runs}, {row.group}: {row.worst[0]}"
        )
    unsafe = sum(outcome.group == "unsafe" for outcome in table.outcomes)
    line(
        f"faults met in every one of {len(planned)} runs",
        f"{sum(row.passed for row in rows)} of {len(rows)}",
        "-",
        note=f"{1e3 * spent / len(planned):.1f} ms a run",
    )
    line("runs that are unsafe", str(unsafe), "0", unsafe == 0)


def upsets(tested: Bench, bits: int) -> None:
    """Flip each bit of the law's memory in a run of its own, in the middle of the move:
    the tip stays within 0.3 rad, or the drive is off within ten periods.
    """
    fault, case = fault_named("F29"), Case("F29", 1, 0.02, "mid", 1)
    size = 8 * len(tested.law.initial_state())
    harmful = []
    tried = range(0, size, max(1, size // bits))
    for bit in tried:
        trial = fault.trial(tested, case)

        def flip(arm: ArmState, bit: int = bit) -> None:
            arm.law[bit // 8] ^= np.uint8(1 << bit % 8)

        trial.at(trial.row, flip)
        run, _ = execute(trial)
        off = np.flatnonzero(run.mode[trial.row :] == MODES.index("off"))
        peak = float(np.abs(run.error[trial.row :]).max()) if run.finished else np.inf
        if peak > 0.3 and not (off.size and off[0] < 10):
            harmful.append(bit)
    line(
        f"bits of the law's memory that do harm, of {len(tried)}",
        str(len(harmful)),
        "0",
        not harmful,
    )


def main() -> None:
    """Print all figures."""
    given = sizes(
        __doc__,
        runs=(1000, 16),
        rounds=(5, 1),
        parts=(20, 1),
        shared=(8000, 0),
        seeds=(10, 0),
        bits=(10**5, 4),
    )
    tested = bench()
    faults(tested, given.seeds)
    upsets(tested, given.bits)
    speed(given.runs, given.rounds)
    memory(given.parts)
    if given.shared:
        scaling(given.shared)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    line("peak memory of this benchmark", f"{peak:.0f} MB", "-")


if __name__ == "__main__":
    main()
