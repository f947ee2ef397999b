"""Figures of the fault campaign: verdicts and causes, clean periods, narrower guards,
flipped bits.

    python benchmarks/bench_faults.py [--periods 1000000] [--seeds 10] [--first-seed 1]
    [PART ...]

A part is one of verdicts, rest, quiet, narrower, floors, identified, bits; default:
all. Every line: what was measured | value | wanted | error beside it.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import fraclink as fl
from fraclink._campaign.endurance import soak, upsets
from fraclink._campaign.fault_trial import MOVE, TICK_MISSED, Trial, execute
from fraclink._campaign.faults import (
    CATALOGUE,
    GROUPS,
    Bench,
    Case,
    FaultTable,
    cases,
    fault_named,
    run_faults,
)
from fraclink._design.completed import design_for
from fraclink._law import Modes, Moves, equip
from fraclink._simulate import geared


def line(what: str, value: str, wanted: str, error: str = "") -> None:
    """Print one figure."""
    print(f"{what} | {value} | {wanted} | {error}", flush=True)


def arm() -> tuple[Bench, fl.Design]:
    """Return the default design on the paper's arm with a gear of 50 and a carbon rod."""
    rig = geared(fl.Rig.named("paper-2023"))
    design = fl.design(
        rig.model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
    )
    return Bench.of(design, link_mass=0.00735), design


def verdicts(bench: Bench, seeds: range) -> FaultTable:
    """Print how many faults meet their requirement, and the open ones with their worst
    value.
    """
    began = time.process_time()
    table = run_faults(bench, cases(bench, seeds=seeds))
    seconds = time.process_time() - began
    rows = table.rows()
    runs = len(table.outcomes)
    line(
        "faults with a verdict",
        f"{len(rows)} of {len(CATALOGUE)}",
        "44",
        f"{runs} runs, {len(seeds)} seed(s)",
    )
    met = sum(row.passed for row in rows)
    line(
        "faults met in every run",
        f"{met}",
        "44 or listed as open",
        f"{len(table.failures)} open runs",
    )
    for group in GROUPS:
        named = [row.number for row in rows if row.group == group]
        line(
            f"faults: {group}",
            f"{len(named)}",
            "44" if group == "met" else "0",
            " ".join(named),
        )
    for row in rows:
        if not row.passed:
            line(
                f"{row.group}: {row.number} {row.title}",
                f"{row.failed} of {row.runs} runs",
                "0",
                row.worst,
            )
            line("    because of", fault_named(row.number).cause, "-")
    line(
        "time of a run in both precisions",
        f"{1e3 * seconds / runs:.1f} ms",
        "-",
        "clean runs included",
    )
    return table


def rest(bench: Bench, seeds: range) -> None:
    """Print how often an arm that stands still for a minute is switched off, at three
    payloads.
    """
    table = run_faults(bench, cases(bench, only=["F43"], severities=(1,), seeds=seeds))
    said = f"seeds {seeds.start} to {seeds[-1]}, {len(bench.payloads)} payloads, both precisions"
    line(
        "F43, an arm at rest: runs that do not meet it",
        f"{len(table.failures)} of {len(table.outcomes)}",
        "0",
        said,
    )


def quiet(bench: Bench, periods: int) -> None:
    """Print trips and flags of a healthy arm that moves to and fro."""
    for payload in bench.payloads:
        for precision in ("double", "single"):
            began = time.process_time()
            made = bench.with_law(bench.law.in_precision(precision))  # type: ignore[arg-type]
            result = soak(made, payload, periods=periods)
            spent = time.process_time() - began
            line(
                f"clean periods, {1e3 * payload:g} g, {precision}: trips and flags",
                f"{result.trips} and {result.flagged} in {result.periods}",
                "0 and 0 in 1e6",
                f"peak tip error {result.peak:.4f} rad, {1e6 * spent / result.periods:.2f} us a period",
            )


def narrower(bench: Bench, design: fl.Design) -> None:
    """Print what guards for the campaign's own move, instead of the default largest
    one, would change.
    """
    moves = Moves(
        velocity=2.0, acceleration=10.0
    )  # the move has 1.6 rad/s and 4 rad/s²
    narrow = bench.with_law(equip(bench.law, bench.rig, design.model, moves=moves))
    for only in ("F07", "F08", "F40"):
        for name, tried in (("6 rad/s", bench), ("2 rad/s", narrow)):
            table = run_faults(tried, cases(tried, only=[only]), single=False)
            delays = [o.reacted for o in table.outcomes if o.reacted > 0]
            median = (
                f"{statistics.median(delays):.0f} periods" if delays else "no reaction"
            )
            peaks = max(o.peak for o in table.outcomes)
            line(
                f"{only} with guards for {name}",
                f"{len(table.failures)} of {len(table.outcomes)} open",
                "0",
                f"reacts after {median}, peak {peaks:.2f} rad",
            )
    clean = soak(narrow, bench.payloads[0], periods=100_000)
    line(
        "clean periods with guards for 2 rad/s",
        f"{clean.trips} trips in {clean.periods}",
        "0",
        "",
    )


def floors(bench: Bench) -> None:
    """Print why some bounds are out of reach on this arm: what is left when the law
    cannot be blamed.
    """
    for phase in ("mid", "rest"):
        peaks = []
        for payload in bench.payloads:
            trial = Trial(
                bench, Case("F07", 1, payload, phase, 1), bench.law, MOVE, 7.0
            )
            trial.set_bits(slice(trial.row, trial.count), TICK_MISSED)
            trial.at(trial.row, lambda vessel: vessel.voltage.fill(0.0))
            peaks.append(float(np.abs(execute(trial).error).max()))
        wanted = "F07: 0.4 rad" if phase == "mid" else "F08: 1.1 x clean, 0.043 rad"
        line(
            f"drive cut in the very period of the fault, {phase}: peak",
            f"{max(peaks):.3f} rad",
            wanted,
        )
    alone = bench.with_law(replace(bench.law, correction=Modes(0.0)))
    table = run_faults(
        alone, cases(alone, only=["F24"], severities=(2, 3), seeds=(1,)), single=False
    )
    trips = sum(outcome.mode == "off" for outcome in table.outcomes)
    line(
        "F24, two and three periods more, correction left out",
        f"{trips} of {len(table.outcomes)} trip",
        "0",
    )


def identified() -> None:
    """Print how many faults the demo's design meets, made from its own log and from the
    rig's model.
    """
    rig = fl.Rig.named("paper-2023-geared")
    fit = fl.identify(fl.read_log(fl.bundled_log("prbs_30g"), rig=rig))
    for name, model in (("its log", fit.model), ("the rig", rig.model)):
        made, _ = design_for(rig, model)
        bench = Bench.of(made, link_mass=0.00735)
        table = run_faults(bench, cases(bench, seeds=(1, 2)), single=False)
        missed = [row for row in table.rows() if not row.passed]
        what = f"faults that the demo's design misses, model of {name}"
        error = " ".join(f"{row.number} {row.failed}/{row.runs}" for row in missed)
        line(
            what,
            f"{len(missed)} of {len(CATALOGUE)}",
            "as few as with the rig's",
            error,
        )


def every_bit(bench: Bench) -> None:
    """Print what a flipped bit of the law's memory does: each bit, in three moments of
    a move.
    """
    for precision in ("single", "double"):
        made = bench.with_law(bench.law.in_precision(precision))  # type: ignore[arg-type]
        for phase in ("start", "mid", "rest"):
            found = upsets(made, phase=phase)  # type: ignore[arg-type]
            failed = Counter(upset.name for upset in found if not upset.passed)
            worst = max(
                (upset for upset in found if not upset.passed),
                key=lambda u: u.peak,
                default=None,
            )
            line(
                f"flipped bits, {precision}, {phase}: tip beyond 0.3 rad and not off within 10 periods",
                f"{failed.total()} of {len(found)}",
                "0",
                ", ".join(f"{name} {count}" for name, count in failed.items())
                + (
                    ""
                    if worst is None
                    else f"; worst {worst.name} bit {worst.bit}: {worst.peak:.2f} rad"
                ),
            )


def main() -> None:
    """Print every figure, or those of the parts that are named."""
    bench, design = arm()
    parser = argparse.ArgumentParser()
    parser.add_argument("--periods", type=int, default=1_000_000)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("part", nargs="*")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    parts: dict[str, Callable[[], object]] = {
        "verdicts": lambda: verdicts(bench, seeds),
        "rest": lambda: rest(bench, seeds),
        "quiet": lambda: quiet(bench, options.periods),
        "narrower": lambda: narrower(bench, design),
        "floors": lambda: floors(bench),
        "identified": identified,
        "bits": lambda: every_bit(bench),
    }
    if unknown := set(options.part) - parts.keys():
        parser.error(
            f"no such part: {', '.join(sorted(unknown))}; there are {', '.join(parts)}"
        )
    for name in options.part or parts:
        parts[name]()


if __name__ == "__main__":
    main()
