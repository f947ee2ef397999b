"""Start-up costs: `import fraclink` next to `import numpy`, and the main job on the
bundled log.

Every process is timed in processor seconds including its children, so that other work
on the machine does not count; the imports alternate, each in a fresh interpreter.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from harness import line, median, sizes

ROOT = Path(__file__).resolve().parent.parent
# Public names are loaded when they are first used, so the root alone takes less time
# than numpy.
SESSION = "import fraclink as fl, fracsys; fl.Rig, fl.read_log, fl.identify, fl.design, fl.Law, fl.simulate, fracsys.s"
DEMO = ("-m", "fraclink", "run", "--rig", "paper-2023-geared", "--log", "demo")


def seconds(*command: str) -> float:
    """Processor seconds of Python with these arguments."""
    before = os.times()
    run: Sequence[str] = (sys.executable, *command)
    subprocess.run(run, cwd=ROOT, check=True, capture_output=True)  # noqa: S603
    after = os.times()
    user = after.children_user - before.children_user
    return user + after.children_system - before.children_system


def imports(rounds: int) -> None:
    """`import fraclink` and what the session needs first, against `import numpy`."""
    codes = ("pass", "import numpy", "import fraclink", SESSION)
    spent = np.array([[seconds("-c", code) for code in codes] for _ in range(rounds)])
    ratio, spread = median(spent[:, 2] / spent[:, 1])
    line(
        "import fraclink / import numpy (whole process)",
        f"{ratio:.2f} ± {spread:.2f}",
        "<= 1.3",
        ratio <= 1.3,
    )
    bare, numpy, _, session = np.median(spent, axis=0)
    line(
        "every name of the README's session / numpy, numpy included",
        f"{(session - bare) / (numpy - bare):.2f}",
        "no bound",
    )


def main() -> None:
    given = sizes(__doc__, rounds=(15, 1), demos=(3, 0))
    imports(given.rounds)
    if not given.demos:  # CI runs `make demo` itself
        return
    with tempfile.TemporaryDirectory() as folder:
        command = (*DEMO, "--out", folder, "--force")
        value, spread = median(
            np.array([seconds(*command) for _ in range(given.demos)])
        )
    line(
        "fraclink run on the bundled log, its demo",
        f"{value:.2f} ± {spread:.2f} s",
        "< 10 s",
        value < 10,
    )


if __name__ == "__main__":
    main()
