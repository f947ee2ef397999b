"""Feed mutated files to every reader: 20 000 each, or as many as the first argument
says.

    python benchmarks/fuzz_readers.py [count] [format ...]

Wanted: no surprise (an exception that is not fraclink's own), no mutant over its limits
of memory and time. A child that dies is no surprise: that it is a child is why the
reader survives.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from fraclink._logs.text import WALL_SECONDS
from mutants import KINDS, run


def main(count: int = 20_000, kinds: tuple[str, ...] = KINDS) -> bool:
    """Print one line for each format; return whether every mutant was read or refused."""
    good = True
    print(
        f"{'format':8} {'mutants':>8} {'read':>7} {'refused':>8} {'child died':>10} {'surprises':>9}  slowest"
    )
    for kind in kinds:
        with tempfile.TemporaryDirectory() as folder:
            outcome = run(kind, count, Path(folder), seed=1)
        counts = outcome.counts
        print(
            f"{kind:8} {sum(counts.values()):8d} {counts['read']:7d} {counts['refused']:8d} "
            f"{counts['child died']:10d} {counts['surprise']:9d}  {outcome.slowest:.2f} s",
            flush=True,
        )
        for surprise in outcome.surprises[:5]:
            print("   ", surprise)
        good = good and not outcome.surprises and outcome.slowest < WALL_SECONDS + 5
    return good


if __name__ == "__main__":
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    sys.exit(0 if main(wanted, tuple(sys.argv[2:]) or KINDS) else 1)
