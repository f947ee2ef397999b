"""Build the core in a copy without the satellite packages, and run its own tests.

python tools/check_core.py [pytest options] omits logs, lab, trials, view, studio and
the commands, runs the README's session with the rest, and then the tests that name none
of those packages.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
AROUND = ("lab", "logs", "trials", "view", "studio", "_cli")
# Names of the top level that come from the satellites.
LENT = ("Callback", "MotionLimits", "TuningPlan", "bode", "main", "tune")
NAMES_AROUND = re.compile(
    rf"\b(?:fl|fraclink)\.(?:{'|'.join(AROUND + LENT)})\b"
    rf"|from fraclink import (?:\([^)]*|.*)\b(?:{'|'.join(AROUND + LENT)})\b"
)
# The finder of an editable install precedes the path, and would load the package with
# all satellites.
ALONE = """
import sys
sys.meta_path[:] = [
    finder for finder in sys.meta_path if not type(finder).__name__.startswith("ScikitBuild")
]
"""
SESSION = """
import doctest, re, sys
import fraclink
assert fraclink.__file__.startswith(sys.argv[2]), fraclink.__file__
page = open(sys.argv[1], encoding="utf-8").read()
text = "".join(re.findall("```python\\n(.*?)```", page, re.DOTALL))
test = doctest.DocTestParser().get_doctest(text, {}, "README session", None, 0)
outcome = doctest.DocTestRunner().run(test)
sys.exit(outcome.failed > 0 or outcome.attempted < 10)
"""


def core_tests() -> list[str]:
    """The test files that neither name a package around the core, nor use a helper that
    does, nor look at the whole repository.
    """
    tests = ROOT / "tests"
    helpers = [path for path in tests.glob("*.py") if not path.stem.startswith("test_")]
    left_out = {
        path.stem for path in helpers if NAMES_AROUND.search(path.read_text("utf-8"))
    }
    # Browsers show the page of the studio, which belongs to fraclink as a whole.
    left_out |= {"golden", "guard_sources", "benchmarks", "browser", "reproduce"}
    uses = re.compile(rf"^\s*(?:from|import) (?:{'|'.join(left_out)})\b", re.MULTILINE)
    return [
        str(path.relative_to(ROOT))
        for path in sorted(tests.glob("test_*.py"))
        if not NAMES_AROUND.search(text := path.read_text("utf-8"))
        and not uses.search(text)
    ]


def build_core(folder: Path) -> Path:
    """Build what is left without the packages around the core, and return its place."""
    source, place = folder / "source", folder / "core"
    for name in ("src", "csrc"):
        shutil.copytree(
            ROOT / name,
            source / name,
            ignore=shutil.ignore_patterns("__pycache__", "*.so"),
        )
    for name in ("pyproject.toml", "CMakeLists.txt", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in AROUND:
        shutil.rmtree(source / "src" / "fraclink" / name)
    pip = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
    options = ("--no-deps", "--no-build-isolation", "--target", str(place))
    subprocess.run([*pip, "install", *options, str(source)], check=True)  # noqa: S603
    return place


def main(options: list[str]) -> int:
    with tempfile.TemporaryDirectory() as folder:
        place = build_core(Path(folder))
        (place / "sitecustomize.py").write_text(ALONE, "utf-8")
        environment = os.environ | {"PYTHONPATH": str(place)}
        session = [sys.executable, "-c", SESSION, str(ROOT / "README.md"), str(place)]
        subprocess.run(session, cwd=folder, env=environment, check=True)  # noqa: S603
        chosen = ["-m", "not slow", "-n", "2", "--dist", "loadfile", *options]
        line = [sys.executable, "-m", "pytest", *chosen, *core_tests()]
        return subprocess.run(line, cwd=ROOT, env=environment, check=False).returncode  # noqa: S603


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
