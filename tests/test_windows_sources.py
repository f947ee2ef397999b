"""The C sources for Windows: parsed for clang-cl and for a compiler without vectors,
and compiled by MinGW. Nothing is run there.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from guard_sources import ROOT
from needed_tools import tool

CSRC = ROOT / "csrc"
SOURCES = sorted([*CSRC.glob("*.c"), *CSRC.glob("kernels/*.c")])
INCLUDES = [f"-I{CSRC}", f"-I{CSRC / 'kernels'}"]

# What the sources need of the C library, whose headers for Windows cannot be shipped
# here.
HEADERS = {
    "math.h": """
        #define INFINITY ((float)(1e300 * 1e300))
        #define NAN (-(float)(INFINITY * 0.0F))
        int isfinite(double), isnan(double), isinf(double);
        double fabs(double), floor(double), ceil(double), nearbyint(double), round(double);
        double exp(double), expm1(double), log(double), log1p(double), sqrt(double), hypot(double, double);
        double sin(double), cos(double), tan(double), asin(double), atan(double), atan2(double, double);
        double cosh(double), tanh(double), pow(double, double);
        double fmin(double, double), fmax(double, double);
        double copysign(double, double), fmod(double, double), remainder(double, double);
    """,
    "string.h": """
        #include <stddef.h>
        void *memcpy(void *, const void *, size_t), *memmove(void *, const void *, size_t);
        void *memset(void *, int, size_t);
        int memcmp(const void *, const void *, size_t);
    """,
    "stdlib.h": """
        #include <stddef.h>
        void *malloc(size_t), *calloc(size_t, size_t), free(void *);
    """,
}
# A compiler that identifies as neither gcc nor clang, like cl.exe.
PLAIN = ["-U__clang__", "-fgnuc-version=0"]

HARNESS = """
#include <stdio.h>
#include "fit.h"
static unsigned state = 1;
static double next(void) { return ((state = state * 1664525u + 1013904223u) >> 8) / 16777216.0 - 0.5; }
int main(void) {
    enum { COUNT = 203, PAD = 64 };
    static double input[COUNT + 2 * PAD], output[COUNT], columns[6 * COUNT], gram[64];
    static fit_table table;
    for (int i = 0; i < COUNT; i++) output[i] = next(), input[PAD + i] = next();
    double *cells = table.state_gain[0][0];
    size_t count = (sizeof table - offsetof(fit_table, state_gain)) / sizeof *cells;
    for (size_t i = 0; i < count; i++) cells[i] = 0.3 * next();
    table.outputs = 4, table.modes = 16, table.states = 21, table.shift = 3;
    fit_problem problem = {.count = COUNT, .input = input + PAD, .output = output, .before = 5, .pad = PAD};
    fit_pass(&problem, &table, gram, columns);
    for (int i = 0; i < 36; i++) printf("%a\\n", gram[i]);
    for (int i = 0; i < 4 * COUNT; i++) printf("%a\\n", columns[i]);
    return 0;
}
"""


def compiled(*command: object) -> None:
    outcome = subprocess.run(  # noqa: S603
        [str(part) for part in command], capture_output=True, text=True, check=False
    )
    assert outcome.returncode == 0, outcome.stderr


@pytest.fixture
def library(tmp_path: Path) -> list[str]:
    for name, text in HEADERS.items():
        (tmp_path / name).write_text(text)
    return ["-ffreestanding", "-isystem", str(tmp_path)]


@pytest.mark.slow
@pytest.mark.parametrize("dialect", [[], PLAIN], ids=["clang-cl", "no-vectors"])
def test_the_sources_are_c_for_microsofts_compilers(
    dialect: list[str], library: list[str]
) -> None:
    command = [tool("clang"), "--target=x86_64-pc-windows-msvc", "-fsyntax-only"]
    # No variable-length arrays: they are optional in C11, and cl.exe has none.
    strict = [
        "-std=c11",
        "-pedantic-errors",
        "-Wvla",
        "-Werror",
        "-Wno-unknown-pragmas",
    ]
    compiled(*command, *dialect, *library, *strict, *INCLUDES, *SOURCES)


@pytest.mark.slow
def test_mingw_compiles_the_sources(tmp_path: Path) -> None:
    gcc = tool("x86_64-w64-mingw32-gcc", "gcc-mingw-w64-x86-64-win32")
    for source in SOURCES:
        compiled(
            *(gcc, "-std=c11", "-O1", "-fopenmp-simd", "-Wall", "-Werror", *INCLUDES),
            *("-c", source, "-o", tmp_path / f"{source.stem}.o"),
        )


@pytest.mark.slow
def test_loops_and_vectors_fit_alike(tmp_path: Path, library: list[str]) -> None:
    clang = tool("clang")
    (tmp_path / "harness.c").write_text(HARNESS)
    numbers = []
    for name, dialect in (("vectors", []), ("loops", [*PLAIN, *library])):
        part, program = tmp_path / f"{name}.o", tmp_path / name
        options = ["-std=c11", "-O1", "-ffp-contract=off", *INCLUDES]
        compiled(
            clang, *dialect, *options, "-c", CSRC / "kernels/fit_pass.c", "-o", part
        )
        compiled(clang, *options, tmp_path / "harness.c", part, "-o", program)
        printed = subprocess.run(  # noqa: S603
            [str(program)], capture_output=True, text=True, check=True
        ).stdout
        numbers.append([float.fromhex(row) for row in printed.split()])
    np.testing.assert_allclose(numbers[0], numbers[1], rtol=1e-12, atol=1e-14)
    assert np.ptp(numbers[0]) > 0.1
