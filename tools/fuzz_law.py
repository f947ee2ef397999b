"""Fuzz law.c for as long as asked and print executions and coverage.

For example: tools/fuzz_law.py --seconds 60. libFuzzer runs tests/firmware/fuzz.c with
the address, undefined-behaviour and float sanitizers of clang. The invariants in that
file are the oracle: outputs are finite, within their limits and limited in slew rate,
and trips latch. The exit code is 1 if one is violated; the input is then in the printed
folder.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import fraclink as fl
from fraclink._export.data import exact_flags
from fraclink._law import discretize_controller

ROOT = Path(__file__).resolve().parents[1]
SANITIZERS = "fuzzer,address,undefined,float-divide-by-zero,float-cast-overflow"


def run(
    *command: str | Path, folder: Path, check: bool = True
) -> subprocess.CompletedProcess[str]:
    """Run a program in `folder` and return what it printed."""
    words = [str(word) for word in command]
    return subprocess.run(  # noqa: S603
        words, cwd=folder, capture_output=True, text=True, check=check
    )


def build(folder: Path, *, precision: str, exact: bool) -> Path:
    """Return the fuzzer of the paper's default law, exported to `folder`."""
    rig = fl.Rig.named("paper-2023")
    controller = fl.Controller(
        derivative_gain=0.069876, derivative_order=0.612197, link=rig.model
    )
    law = discretize_controller(controller, rig.period, rig=rig).in_precision(precision)
    fl.export_c(law, folder, force=True)
    defines = ["-DLAW_SINGLE"] if precision == "single" else []
    defines += exact_flags(law) if exact else ()
    coverage = ("-fprofile-instr-generate", "-fcoverage-mapping")
    options = (
        "-g",
        "-O1",
        "-ffp-contract=off",
        f"-fsanitize={SANITIZERS}",
        *coverage,
        *defines,
    )
    source = ROOT / "tests" / "firmware" / "fuzz.c"
    command = ("clang", *options, "-I", folder, source, "law.c", "-lm", "-o", "fuzz")
    built = run(*command, folder=folder, check=False)
    if built.returncode and "libclang_rt" in built.stderr:
        raise SystemExit(
            "clang's fuzzer is not installed (Debian package libclang-rt-14-dev)"
        )
    built.check_returncode()
    return folder / "fuzz"


def fuzz(program: Path, seconds: int, seed: int) -> int:
    """Run the fuzzer, print what it did, and return its exit code."""
    limits = (f"-max_total_time={seconds}", "-max_len=2000", f"-seed={seed}")
    done = run(program, *limits, folder=program.parent, check=False)
    if done.returncode:
        print(done.stderr[-3000:])
        print(f"the input that breaks it is in {program.parent}")
        return 1
    runs = re.search(r"Done (\d+) runs in (\d+) second", done.stderr)
    edges = re.findall(r"cov: (\d+) ft: (\d+) corp: (\d+)", done.stderr)
    if runs is None or not edges:
        print(done.stderr[-3000:])
        return 1
    print(f"{int(runs[1])} executions in {runs[2]} s, no invariant broken")
    print(f"{edges[-1][0]} edges, {edges[-1][1]} features, {edges[-1][2]} inputs kept")
    show_coverage(program)
    return 0


def show_coverage(program: Path) -> None:
    """Print the lines and branches of law.c that the fuzzer reached, where llvm's tools
    are installed.
    """
    folder = program.parent
    tools = [
        shutil.which(name) or shutil.which(f"{name}-14")
        for name in ("llvm-profdata", "llvm-cov")
    ]
    if None in tools:
        print(
            "no coverage of law.c: llvm-profdata and llvm-cov are not installed (Debian package llvm)"
        )
        return
    merge, show = map(str, tools)
    run(
        merge,
        "merge",
        "-sparse",
        "default.profraw",
        "-o",
        "law.profdata",
        folder=folder,
    )
    print(
        run(
            show,
            "report",
            program,
            "-instr-profile=law.profdata",
            "law.c",
            folder=folder,
        ).stdout
    )


def main() -> int:
    """Read the command line, build and fuzz."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--precision", choices=("single", "double"), default="single")
    parser.add_argument(
        "--exact", action="store_true", help="the build for this design alone"
    )
    given = parser.parse_args()
    if shutil.which("clang") is None:
        raise SystemExit(
            "clang is not installed (Debian packages clang and libclang-rt-14-dev)"
        )
    folder = Path(tempfile.mkdtemp(prefix="fuzz_law_"))
    program = build(folder, precision=given.precision, exact=given.exact)
    code = fuzz(program, given.seconds, given.seed)
    if code == 0:
        shutil.rmtree(folder)
    return code


if __name__ == "__main__":
    sys.exit(main())
