"""Memory of a run of the tests: the largest sum of what its processes have, each with
its share.

    python benchmarks/memory_of_tests.py [pytest's arguments]

Default: what `make test` runs. A page that two processes share counts half for each
(PSS), so that the sum is what the machine has to have. Linux only. Printed: what was
measured | value | wanted | the largest processes.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

BETWEEN = 1.0  # [s]: a look costs 5 ms of a processor
NAMED = 4


def family(root: int) -> list[int]:
    """A process and all that it has started, and they."""
    children: dict[int, list[int]] = {}
    for place in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(place.read_text().rpartition(")")[2].split()[1])
        except OSError:  # it has ended
            continue
        children.setdefault(parent, []).append(int(place.parent.name))
    found = [root]
    for process in found:
        found += children.get(process, [])
    return found


def share(process: int) -> float:
    """Proportional set size [MB]; 0 where the process has ended."""
    try:
        rows = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    return next(
        (int(row.split()[1]) / 1000 for row in rows if row.startswith("Pss:")), 0.0
    )


def name(process: int) -> str:
    """The program and how it was started, shortened."""
    try:
        words = Path(f"/proc/{process}/cmdline").read_text(errors="replace").split("\0")
    except OSError:
        return "ended"
    return " ".join([Path(words[0]).name, *words[1:3]])[:50]


def main() -> None:
    """Run the tests and print the peak."""
    command = (
        [sys.executable, "-m", "pytest", *sys.argv[1:]]
        if sys.argv[1:]
        else ["make", "test"]
    )
    tests = subprocess.Popen(command)  # noqa: S603
    peak, largest = 0.0, ""
    while tests.poll() is None:
        sizes = sorted(((share(p), p) for p in family(tests.pid)), reverse=True)
        total = sum(size for size, _ in sizes)
        if total > peak:
            peak, largest = (
                total,
                ", ".join(f"{size:.0f} {name(p)}" for size, p in sizes[:NAMED]),
            )
        time.sleep(BETWEEN)
    print(f"largest memory of all processes | {peak:.0f} MB | <= 1000 MB | {largest}")
    sys.exit(tests.returncode)


if __name__ == "__main__":
    main()
