"""Build the engine of the arm in a page: law.c, its loop and the twin as WebAssembly,
without a library.

python tools/build_engine.py [--check] needs clang and wasm-ld (Debian: clang, lld). The
package contains the result with its SHA-256 and the version of its compiler, so that no
user needs a compiler to share an arm; a test builds it again and compares.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
ENGINE = ROOT / "src" / "fraclink" / "_simulate" / "engine.wasm"
DIGEST = ENGINE.with_suffix(".sha256")
LARGEST = 24_000  # bytes

_SOURCES = (
    "web/engine.c",
    "law.c",
    "law_single.c",
    "kernels/law_port.c",
    "kernels/law_port_single.c",
    "kernels/loop.c",
    "kernels/twin.c",
    "kernels/twin_law.c",
)
# No contraction, as for the board: a fused multiply-add would round once where the
# package rounds twice.
_FLAGS = (
    "--target=wasm32",
    "-std=c11",
    "-Oz",
    "-msimd128",  # two rows of the twin at once, each with the same bits as alone
    "-mbulk-memory",  # instructions that copy and clear; every browser with SIMD has them
    "-flto",  # a twentieth smaller: functions called once are inlined across files
    "-ffp-contract=off",
    "-ffreestanding",
    # 7 kB of the payload estimator; the page gives the law its payload, and moves a
    # single arm
    "-DLAW_ALONE",
    "-DLOOP_LANES=1",
    "-nostdlib",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-Wl,--no-entry",
    "-Wl,--strip-all",
    "-Wl,-z,stack-size=65536",
)


def compiler_version(clang: str) -> str:
    """Return "clang 14.0.6" of the compiler at `clang`."""
    said = subprocess.run(  # noqa: S603
        [clang, "--version"], capture_output=True, text=True, check=True
    ).stdout
    found = re.search(r"clang version (\d+\.\d+\.\d+)", said)
    return f"clang {found[1] if found else 'unknown'}"


def built(clang: str) -> bytes:
    """Return the engine as `clang` compiles it now."""
    csrc = ROOT / "csrc"
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "engine.wasm"
        includes = [f"-I{csrc / name}" for name in ("web", "kernels", "")]
        sources = [str(csrc / name) for name in _SOURCES]
        subprocess.run(  # noqa: S603
            [clang, *_FLAGS, *includes, "-o", str(out), *sources], check=True
        )
        return out.read_bytes()


def main() -> int:
    """Build and write the engine, or compare it with the committed one; return the exit
    code.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--check",
        action="store_true",
        help="write nothing; exit code 1 where it differs",
    )
    check = parser.parse_args().check
    clang = shutil.which("clang")
    if clang is None or shutil.which("wasm-ld") is None:
        print(
            "clang and wasm-ld are needed (Debian packages clang and lld)",
            file=sys.stderr,
        )
        return 2
    engine = built(clang)
    line = f"{hashlib.sha256(engine).hexdigest()}  {ENGINE.name}  {compiler_version(clang)}\n"
    print(f"{len(engine)} bytes  {line}", end="")
    if len(engine) > LARGEST:
        print(f"larger than {LARGEST} bytes", file=sys.stderr)
        return 1
    if check:
        same = ENGINE.read_bytes() == engine and DIGEST.read_text() == line
        print("the same as committed" if same else "not the engine that is committed")
        return 0 if same else 1
    ENGINE.write_bytes(engine)
    DIGEST.write_text(line)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
