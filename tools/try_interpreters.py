"""Run the demo and the core's tests on the interpreters of this machine.

python tools/try_interpreters.py installs into build/interpreters. The oldest Python
gets the lowest versions allowed by pyproject.toml, the newest Python the newest ones,
each with the core's tests; the versions in between only run `make demo`.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from check_core import core_tests

ROOT = Path(__file__).resolve().parents[1]
HOME = ROOT / "build" / "interpreters"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
DEMO = ("run", "--rig", "paper-2023-geared", "--log", "demo", "--certify", "--force")
OPTIONS = ("-m", "not slow", "-p", "no:cacheprovider")
PROBE = """import sys, sysconfig, venv, ensurepip
assert not sysconfig.get_config_var("Py_GIL_DISABLED")
print("3.%d" % sys.version_info[1])"""


def requirements(*, lowest: bool) -> list[str]:
    """What pyproject.toml names, extras and build tools included."""
    extras = PROJECT["project"]["optional-dependencies"]
    named = [*PROJECT["project"]["dependencies"], *PROJECT["build-system"]["requires"]]
    named += [row for name in extras if name != "all" for row in extras[name]]
    if lowest:
        named = [re.sub(r">=([^,]+).*", r"==\1", row) for row in named]
    # The build backend runs these two, and uses those of the system if possible.
    return [*dict.fromkeys(named), "cmake", "ninja"]


def stated() -> list[str]:
    """The versions of Python that the classifiers promise."""
    rows = (
        re.fullmatch(r".*:: (3\.\d+)", r) for r in PROJECT["project"]["classifiers"]
    )
    return [row[1] for row in rows if row]


def interpreters() -> dict[str, Path]:
    """The first interpreter of each stated version that can make an environment: on the
    path, or kept by pyenv.
    """
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    folders = [*map(Path, os.get_exec_path()), *sorted(pyenv.glob("versions/*/bin"))]
    usable: dict[str, Path] = {}
    for version in stated():
        for place in (folder / f"python{version}" for folder in folders):
            if version not in usable and place.is_file():
                probe = subprocess.run(  # noqa: S603
                    (place, "-c", PROBE), capture_output=True, text=True, check=False
                )
                if probe.stdout.strip() == version:
                    usable[version] = place
        if version not in usable:
            print(f"Python {version}: not on this machine, not tried")
    return usable


class Attempt:
    """One interpreter with one choice of versions, in an environment of its own."""

    def __init__(
        self, version: str, interpreter: Path, setting: Callable[[Attempt], None]
    ) -> None:
        self.name = f"Python {version}, {setting.__name__} versions"
        self.interpreter, self.setting = interpreter, setting
        self.home = HOME / f"{version}-{setting.__name__}"
        self.python = self.home / "bin" / "python"
        self.log = HOME / f"{self.home.name}.log"

    def run(self, *command: object) -> None:
        # The environment's own cmake and ninja; tests may skip what is not installed in
        # it.
        environment = os.environ | {
            "PATH": f"{self.python.parent}{os.pathsep}{os.environ['PATH']}",
            "SKBUILD_BUILD_DIR": str(self.home / "build"),
            "FRACLINK_CI": "0",
        }
        line = [str(part) for part in command]
        with self.log.open("a", encoding="utf-8") as log:
            print("$", *line, file=log, flush=True)
            done = subprocess.run(  # noqa: S603
                line, cwd=ROOT, env=environment, stdout=log, stderr=log, check=False
            )
        if done.returncode:
            raise subprocess.CalledProcessError(done.returncode, line)

    def install(self, *options: object) -> None:
        pip = (self.python, "-m", "pip", "install", "--quiet", "--no-compile")
        self.run(*pip, "--disable-pip-version-check", *options)

    def lowest(self) -> None:
        self.run(self.interpreter, "-m", "venv", self.home)
        self.install("--only-binary", ":all:", *requirements(lowest=True))
        self.install("--no-deps", "--no-build-isolation", "--editable", ".")
        self.run(self.python, "-m", "pytest", *OPTIONS, "tests/test_cli.py")
        fraclink = self.python.parent / "fraclink"
        self.run(fraclink, *DEMO, "--out", self.home / "results")
        self.test()

    def newest(self) -> None:
        self.locked()
        newest = ("--upgrade", "--upgrade-strategy", "eager")
        self.install("--only-binary", ":all:", *newest, *requirements(lowest=False))
        self.test()

    def locked(self) -> None:
        words = (f"VENV={self.home}", f"PYTHON={self.interpreter}")
        self.run("make", "demo", *words, f"RESULTS={self.home / 'results'}")

    def test(self) -> None:
        self.run(self.python, "-m", "pytest", *OPTIONS, *core_tests())

    def report(self) -> bool:
        """Print the outcome, with the end of the log after a failure."""
        began = time.monotonic()
        shutil.rmtree(self.home, ignore_errors=True)
        self.log.unlink(missing_ok=True)
        try:
            self.setting(self)
        except (OSError, subprocess.CalledProcessError) as error:
            end = self.log.read_text("utf-8").splitlines()[-40:]
            print(*end, f"{self.name}: failed: {error}; see {self.log}", sep="\n")
            return False
        print(f"{self.name}: passed, {time.monotonic() - began:.0f} s", flush=True)
        return True


def main() -> int:
    HOME.mkdir(parents=True, exist_ok=True)
    found = interpreters()
    oldest, *between = found
    newest = between.pop() if between else oldest
    attempts = [
        Attempt(oldest, found[oldest], Attempt.lowest),
        Attempt(newest, found[newest], Attempt.newest),
        *(Attempt(version, found[version], Attempt.locked) for version in between),
    ]
    with ThreadPoolExecutor(2) as pool:
        return 0 if all(list(pool.map(Attempt.report, attempts))) else 1


if __name__ == "__main__":
    sys.exit(main())
