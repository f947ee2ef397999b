"""Run every benchmarks/bench_*.py in a process of its own and print one table.

A benchmark prints one line per figure: `ok` or `MISS`, the figure, the measured value
with its spread, the goal. The exit code is 1 if a benchmark crashed or printed nothing;
a missed figure is a result. `--short` uses the smallest sizes, one benchmark on each
processor: in a minute it shows that all of them run; its times are meaningless.

`--record` appends the figures to history.csv with version, commit and processor, so
that a figure can be followed over the releases. Record on an otherwise idle machine.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fraclink import __version__

HERE = Path(__file__).parent
MARKS = ("ok", "MISS")


@dataclass(frozen=True)
class Outcome:
    """What one benchmark printed: its figures, its duration [s] and its exit code."""

    name: str
    figures: tuple[str, ...]
    seconds: float
    code: int

    @property
    def crashed(self) -> bool:
        return self.code != 0 or not self.figures


def is_figure(line: str) -> bool:
    """A line that states a figure: it begins with a mark, or says what is wanted."""
    return line.split(maxsplit=1)[:1] in ([MARKS[0]], [MARKS[1]]) or " wanted " in line


def run(script: Path, *, short: bool = False) -> Outcome:
    """Run one benchmark, passing its lines on as they come; in the short form, where
    others run beside it, when it has ended.
    """
    began = time.monotonic()
    figures: list[str] = []
    with subprocess.Popen(  # noqa: S603
        [sys.executable, str(script), *(["--short"] if short else [])],
        cwd=HERE.parent,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        lines = process.stdout.readlines() if short else process.stdout
        print(f"\n{script.stem}", flush=True)
        for line in lines:
            print(line, end="", flush=True)
            if is_figure(line):
                figures.append(line.rstrip())
    spent = time.monotonic() - began
    return Outcome(script.stem, tuple(figures), spent, process.returncode)


def record(outcomes: list[Outcome]) -> Path:
    """Append every figure to history.csv, which is made with its header where there is
    none.
    """
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"],  # noqa: S607
        cwd=HERE,
        capture_output=True,
        text=True,
        check=False,
    ).stdout.strip()
    path = HERE / "history.csv"
    fresh = not path.exists()
    with path.open("a", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        if fresh:
            table.writerow(("version", "commit", "processor", "benchmark", "figure"))
        for outcome in outcomes:
            for figure in outcome.figures:
                machine = platform.processor() or platform.machine()
                table.writerow((__version__, commit, machine, outcome.name, figure))
    return path


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument(
        "names", nargs="*", help="benchmarks to run, e.g. response; all by default"
    )
    parser.add_argument(
        "--record", action="store_true", help="append the figures to history.csv"
    )
    parser.add_argument(
        "--short", action="store_true", help="the smallest sizes, to see that all run"
    )
    options = parser.parse_args()
    wanted = options.names
    scripts = sorted(HERE.glob("bench_*.py"))
    unknown = [name for name in wanted if not (HERE / f"bench_{name}.py").is_file()]
    if unknown:
        known = ", ".join(script.stem.removeprefix("bench_") for script in scripts)
        parser.error(f"no benchmark named {', '.join(unknown)}; there are {known}")
    chosen = [
        script
        for script in scripts
        if not wanted or script.stem.removeprefix("bench_") in wanted
    ]
    with ThreadPoolExecutor(os.cpu_count() if options.short else 1) as pool:
        outcomes = list(pool.map(partial(run, short=options.short), chosen))
    print(f"\n{'benchmark':<24} {'figures':>8} {'missed':>8} {'time [s]':>8}")
    for outcome in outcomes:
        missed = sum(line.startswith("MISS") for line in outcome.figures)
        note = f"  CRASHED (exit code {outcome.code})" if outcome.crashed else ""
        print(
            f"{outcome.name:<24} {len(outcome.figures):>8} {missed:>8} {outcome.seconds:>8.1f}{note}"
        )
    if options.record:
        print(f"\n{record(outcomes)}")
    return 1 if any(outcome.crashed for outcome in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
