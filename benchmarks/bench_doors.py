"""What it costs to come in: `import fraclink` beside `import numpy`, `make demo` after
set-up, the results.

Every process is timed in processor seconds of itself and its children, so that other
work on the machine does not count; the two imports are interleaved, in a fresh
interpreter each.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ROUNDS = 15
# Public names are loaded when they are first used, so the root alone costs less than
# numpy does.
SESSION = "import fraclink as fl; fl.Rig, fl.read_log, fl.identify, fl.design, fl.Law, fl.simulate, fl.s"


def seconds(command: Sequence[str]) -> float:
    """Processor seconds of a command."""
    before = os.times()
    subprocess.run(  # noqa: S603
        command,
        cwd=ROOT,
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    after = os.times()
    return (
        after.children_user
        - before.children_user
        + after.children_system
        - before.children_system
    )


def row(figure: str, measured: float, spread: str, wanted: str, holds: bool) -> None:
    """Print one figure."""
    print(
        f"{'ok' if holds else 'MISS':<5} {figure:<52} {measured:8.3f} {spread:<22} wanted {wanted}",
        flush=True,
    )


def imports() -> None:
    """`import fraclink` and what the session needs first, against `import numpy`."""
    spent: dict[str, list[float]] = {
        "pass": [],
        "import numpy": [],
        "import fraclink": [],
        SESSION: [],
    }
    for _ in range(ROUNDS):
        for code, values in spent.items():
            values.append(seconds([sys.executable, "-c", code]))
    ratios = [
        f / n
        for f, n in zip(spent["import fraclink"], spent["import numpy"], strict=True)
    ]
    ratio = statistics.median(ratios)
    low, high = statistics.quantiles(ratios, n=4)[::2]
    row(
        "import fraclink / import numpy (whole process)",
        ratio,
        f"({low:.2f} to {high:.2f})",
        "<= 1.3",
        ratio <= 1.3,
    )
    bare = statistics.median(spent["pass"])
    numpy = statistics.median(spent["import numpy"]) - bare
    own = (statistics.median(spent["import fraclink"]) - bare) / numpy
    row("the same, without the interpreter's start", own, "", "<= 1.3", own <= 1.3)
    session = (statistics.median(spent[SESSION]) - bare) / numpy
    print(
        f"      with every name of the README's session {session:.2f} times numpy, numpy included: no bound"
    )


def demo() -> None:
    """The main job on the bundled log, as `make demo` runs it after set-up."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            "run",
            "--rig",
            "paper-2023",
            "--log",
            "demo",
            "--out",
            folder,
            "--force",
        ]
        spent = [
            seconds([sys.executable, "-m", "fraclink", *command]) for _ in range(3)
        ]
    value = statistics.median(spent)
    row(
        "fraclink run on the bundled log [s]",
        value,
        f"({min(spent):.2f} to {max(spent):.2f})",
        "< 10",
        value < 10,
    )


def results() -> None:
    """Every number and figure of the paper."""
    with tempfile.TemporaryDirectory() as folder:
        value = seconds([sys.executable, "-m", "reproduce", "--out", folder])
    row("make reproduce [s]", value, "", "<= 120", value <= 120)


def main() -> None:
    """Print every figure."""
    imports()
    demo()
    results()


if __name__ == "__main__":
    main()
