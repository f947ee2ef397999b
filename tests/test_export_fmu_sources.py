"""The C files of an FMU: compilers, checkers, sanitizers, an importer that builds them,
other platforms.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from fmu_bench import Imported, fmpy_or_skip, outputs_of, sources_of
from fraclink import export_fmu
from fraclink._export.fmi import VARIABLES
from fraclink.errors import FieldError
from law_bench import law, run, signals
from needed_tools import tool
from test_export import run as shell
from test_export_gates import CLANG, GCC

ROWS = signals(1000)
HEADER = Path(__file__).parents[1] / "csrc" / "law.h"


def test_the_largest_flags_are_all_flags_of_the_law() -> None:
    bits = re.findall(r"#define LAW_FLAG_\w+ (\d+)U", HEADER.read_text("utf-8"))
    assert next(v.largest for v in VARIABLES if v.name == "flags") == sum(
        map(int, bits)
    )


@pytest.mark.slow
def test_an_importer_builds_the_same_from_the_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmpy_or_skip()
    # cmake is one of the build's packages and is next to the interpreter
    monkeypatch.setenv(
        "PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    )
    tool("cmake")
    from fmpy.build import build_platform_binary

    made = law("single")
    file = export_fmu(made, tmp_path / "arm.fmu", compilers=())
    folder = tmp_path / "built"
    sources_of(file, folder)
    (tmp_path / "build").mkdir()
    build_platform_binary(folder, tmp_path / "build", all_warnings=True)
    rebuilt = shutil.make_archive(str(tmp_path / "again"), "zip", folder)
    imported = Imported(Path(rebuilt), tmp_path / "fmu")
    imported.initialize()
    np.testing.assert_array_equal(
        imported.run(ROWS, made.period), outputs_of(run(made, ROWS, first_tick=0))
    )


@pytest.mark.slow
def test_the_declarations_are_those_of_the_standard(tmp_path: Path) -> None:
    """The header of the standard is included first, so that compilers compare the
    declarations; strict warnings, with and without it.
    """
    headers = Path(fmpy_or_skip().__file__).parent / "c-code"
    for precision in ("single", "double"):
        file = export_fmu(
            law(precision), tmp_path / f"{precision}_law.fmu", compilers=()
        )
        sources = sources_of(file, tmp_path / precision)
        for compiler, flags in (
            ("gcc", GCC),
            ("clang", (*CLANG, "-Wno-missing-prototypes")),
        ):
            shell(tool(compiler), *flags, "-c", "all.c", "-o", "all.o", cwd=sources)
    with_header = (
        "-isystem",
        str(headers),
        "-include",
        "fmi3Functions.h",
        "-fsyntax-only",
        "all.c",
    )
    # that header maps the name of each function to itself
    shell(
        tool("clang"),
        *CLANG,
        "-Wno-disabled-macro-expansion",
        *with_header,
        cwd=sources,
    )


@pytest.mark.slow
def test_checkers_have_nothing_to_say(tmp_path: Path) -> None:
    sources = sources_of(
        export_fmu(law("single"), tmp_path / "arm.fmu", compilers=()),
        tmp_path / "fmu",
    )
    unset = [
        f"-U{name}" for name in ("_WIN32", "LAW_REALS", "LAW_PAIRS", "LAW_FORWARDS")
    ]
    unset += [f"-UFMI3_{kind}FUNCTION_PREFIX" for kind in ("", "ACTUAL_")]
    command = [tool("cppcheck"), "-q", "--std=c99", "--inconclusive", *unset]
    command += ["--enable=warning,style,performance,portability", "all.c"]
    answer = shell(*command, cwd=sources, check=False)
    assert answer.stdout + answer.stderr == ""
    # all.c is meant to include the other files
    checks = (
        "--checks=-*,bugprone-*,-bugprone-suspicious-include,cert-*,clang-analyzer-*"
    )
    command = [tool("clang-tidy"), "all.c", checks, "--", "-std=c99"]
    answer = shell(*command, cwd=sources, check=False)
    assert "warning:" not in answer.stdout and "error:" not in answer.stdout, (
        answer.stdout[:2000]
    )


@pytest.mark.slow
def test_a_life_under_sanitizers(tmp_path: Path) -> None:
    """Valid and invalid calls in C: no leak, no out-of-bounds access, no undefined
    behaviour.
    """
    sources = sources_of(
        export_fmu(law("single"), tmp_path / "arm.fmu", compilers=()),
        tmp_path / "fmu",
    )
    driver = Path(__file__).parent / "firmware" / "fmu_life.c"
    flags = ["-std=c99", "-g", "-O1", "-ffp-contract=off", "-I", "."]
    flags += ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    command = [tool("gcc"), *flags, driver, "-o", "life"]
    shell(*command, cwd=sources)
    answer = shell(sources / "life", check=False)
    assert answer.returncode == 0, answer.stdout + answer.stderr[-2000:]
    assert answer.stdout.strip() == "lived"


@pytest.mark.slow
def test_two_fmus_link_into_one_program(tmp_path: Path) -> None:
    """Importers for real-time targets compile and link the sources; each FMU contains
    its own law.
    """
    compiler = tool("gcc")
    names = ("first", "second")
    for name, precision in zip(names, ("single", "double"), strict=True):
        file = export_fmu(law(precision), tmp_path / f"{name}.fmu", compilers=())
        sources = sources_of(file, tmp_path / name)
        flags = ["-std=c99", "-ffp-contract=off", f"-DFMI3_FUNCTION_PREFIX={name}_"]
        shell(
            compiler, *flags, "-c", "all.c", "-o", tmp_path / f"{name}.o", cwd=sources
        )
    calls = "".join(f"const char *{name}_fmi3GetVersion(void);\n" for name in names)
    calls += "int main(void) { return first_fmi3GetVersion()[0] != second_fmi3GetVersion()[0]; }\n"
    (tmp_path / "main.c").write_text(calls, encoding="utf-8")
    shell(compiler, "main.c", "first.o", "second.o", "-o", "both", cwd=tmp_path)
    shell(tmp_path / "both")


@pytest.mark.slow
def test_a_cross_compiler_adds_windows(tmp_path: Path) -> None:
    cross = tool("x86_64-w64-mingw32-gcc", "gcc-mingw-w64-x86-64-win32")
    file = export_fmu(law(), tmp_path / "arm.fmu", compilers=(tool("gcc"), cross))
    sources_of(file, tmp_path / "fmu")
    linux, windows = ("x86_64-linux", "x86_64-windows")
    exported = []
    for path, lister in (
        (f"{linux}/arm.so", "nm -D"),
        (f"{windows}/arm.dll", "x86_64-w64-mingw32-objdump -p"),
    ):
        program, option = lister.split()
        told = shell(
            tool(program, "binutils"), option, tmp_path / "fmu" / "binaries" / path
        ).stdout
        exported.append(set(re.findall(r"\bfmi3\w+", told)))
    assert exported[0] == exported[1]
    assert len(exported[0]) == 75  # all that the standard requires for co-simulation
    with pytest.raises(FieldError, match=r"the second one for x86_64-linux"):
        export_fmu(law(), tmp_path / "other.fmu", compilers=("gcc", "cc"))
