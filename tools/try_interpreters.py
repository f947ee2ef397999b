"""The core's tests and the demo on every interpreter from 3.11 up that is on this machine,
once with the newest versions that pyproject.toml allows and once with the lowest.

python tools/try_interpreters.py tests/test_files.py ... needs the tools of
requirements.lock beside its interpreter.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TOOLS = Path(sys.executable).parent
PROBE = """import sys, sysconfig, venv, ensurepip
assert sys.version_info >= (3, 11) and not sysconfig.get_config_var("Py_GIL_DISABLED")
print("%d.%d" % sys.version_info[:2])"""
DEMO = ("run", "--rig", "paper-2023-geared", "--log", "demo", "--certify", "--force")
# Of these the lock's versions are built with and tested with; the rest is theirs.
EXTRAS = ("--extra", "all", "--extra", "test")


def run(*command: object, **environment: str) -> None:
    # The tools of the lock (cmake, ninja) serve every environment.
    path = f"{TOOLS}{os.pathsep}{os.environ['PATH']}"
    subprocess.run(  # noqa: S603
        [str(part) for part in command],
        cwd=ROOT,
        env=os.environ | {"PATH": path} | environment,
        check=True,
    )


def interpreters() -> dict[str, Path]:
    """Version -> interpreter, of those on the path and those that pyenv keeps."""
    folders = [Path(folder) for folder in os.get_exec_path()]
    kept = os.environ.get("PYENV_ROOT")
    if kept is None and shutil.which("pyenv"):
        kept = subprocess.run(
            ("pyenv", "root"),  # noqa: S607 capture_output=True, text=True, check=True
        ).stdout.strip()
    if kept:
        folders += sorted(Path(kept).glob("versions/*/bin"))
    usable: dict[str, Path] = {}
    refused: dict[str, Path] = {}
    for folder in folders:
        for place in sorted(folder.glob("python3.*")):
            version = re.fullmatch(r"python(3\.\d+)", place.name)
            if version is None or int(version[1][2:]) < 11 or version[1] in usable:
                continue
            probe = subprocess.run(  # noqa: S603
                (place, "-c", PROBE), capture_output=True, text=True, check=False
            )
            if probe.returncode == 0:
                usable[probe.stdout.strip()] = place
            else:  # a shim of pyenv whose version is not active; no venv
                refused[version[1]] = place
    for version, place in sorted(refused.items()):
        if version not in usable:
            print(f"skipped: {place} cannot make an environment (venv, ensurepip)")
            if os.environ.get("FRACLINK_CI"):
                sys.exit(f"error: {place} is on the path and cannot be tried")
    return usable


def attempt(version: str, python: Path, kind: str, tests: list[str]) -> None:
    """Set up an environment of its own, run the demo and the tests in it."""
    home = ROOT / f".venv-{version}-{kind}"
    inside = home / "bin" / "python"
    uv = TOOLS / "uv"
    build = {"SKBUILD_BUILD_DIR": f"build/{version}-{kind}"}
    needed = home / "needed.txt"
    if kind == "newest":
        # As a newcomer does, from the lock, with that interpreter's own pip.
        words = (f"VENV={home.name}", f"PYTHON={python}")
        run("make", "--no-print-directory", "demo", *words, **build)
        choice: tuple[str, ...] = ("-c", "requirements.lock")
    else:
        run(uv, "venv", "--quiet", "--clear", "--python", python, home)
        choice = ("--resolution", "lowest-direct")
    with (ROOT / "pyproject.toml").open("rb") as file:
        backend = tomllib.load(file)["build-system"]["requires"]
    (home / "backend.in").write_text("\n".join(backend) + "\n", encoding="utf-8")
    # Only wheels: nobody compiles scipy for a check.
    words = ("--quiet", "--no-build", "--generate-hashes", "--python", inside, *EXTRAS)
    files = ("pyproject.toml", home / "backend.in", "-o", needed)
    run(uv, "pip", "compile", *choice, *words, *files)
    install = (uv, "pip", "install", "--quiet", "--python", inside)
    run(*install, "--require-hashes", "-r", needed)
    if kind == "lowest":
        run(*install, "--no-deps", "--no-build-isolation", "-e", ".", **build)
        run(home / "bin" / "fraclink", *DEMO, "--out", home / "results")
    options = (
        "-n",
        "2",
        "--dist",
        "loadfile",
        "-m",
        "not slow",
        "-p",
        "no:cacheprovider",
    )
    run(inside, "-m", "pytest", *options, *tests)


def main() -> None:
    tests, rows = sys.argv[1:], []
    for version, python in sorted(interpreters().items()):
        for kind in ("newest", "lowest"):
            began = time.monotonic()
            print(f"--- Python {version}, {kind} versions", flush=True)
            try:
                attempt(version, python, kind, tests)
                verdict = "passed"
            except subprocess.CalledProcessError as error:
                verdict = f"failed: {' '.join(error.cmd[:4])} ..., {error.returncode}"
            rows.append((version, kind, verdict, time.monotonic() - began))
    for version, kind, verdict, seconds in rows:
        print(f"Python {version}, {kind}: {verdict}, {seconds:.0f} s")
    sys.exit(any(verdict != "passed" for _, _, verdict, _ in rows))


if __name__ == "__main__":
    main()
