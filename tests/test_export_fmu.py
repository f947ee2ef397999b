"""The FMU: what is in it, whether FMPy takes it, and its outputs against the package's, bit for bit."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import stat
import sys
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_bench import Imported, eventful
from fraclink.errors import FieldError
from fraclink.export import export_fmu
from fraclink.export.fmu_model import VARIABLES
from law_bench import PERIOD, law, run, signals
from needed_tools import missing, tool
from test_export import run as shell
from test_export_gates import CLANG, GCC

FMIS = [2, 3]
ROWS = signals(1000)


def _fmpy() -> Any:
    if importlib.util.find_spec("fmpy") is None:
        missing("FMPy is not installed (Python package fmpy)")
    import fmpy

    return fmpy


def _extracted(file: Path, folder: Path) -> Path:
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder)
    return folder / "sources"


def _outputs(columns: Any) -> np.ndarray:
    return np.column_stack(
        [
            getattr(columns, name)
            for name in ("motor_reference", "voltage", "tip_estimate", "mode", "reason", "flags")
        ]
    )


@pytest.mark.parametrize(
    ("precision", "ending", "modes"), [("double", "degraded", {1, 2, 4}), ("single", "held", {1, 3, 4})]
)
@pytest.mark.parametrize("fmi", FMIS)
def test_50_000_periods_are_those_of_the_simulation(
    fmi: int, precision: str, ending: str, modes: set[int], tmp_path: Path
) -> None:
    """Noise, friction, saturation, NaN and lost sensors; every mode, and every flag that inputs can raise."""
    tool("cc", "gcc")
    made, rows, simulated = eventful(50_000, precision, ending)
    imported = Imported(export_fmu(made, tmp_path / "arm.fmu", fmi=fmi), tmp_path / "fmu")  # type: ignore[arg-type]
    imported.initialize()
    got = imported.run(rows, made.period)
    assert got.shape[0] > 50_000
    np.testing.assert_array_equal(got, _outputs(made.run(made.initial_state(), *rows, first_tick=0)[1]))
    np.testing.assert_array_equal(got[:, 0], simulated.motor_reference)
    # the twin tells the voltage that acts: the one of the period before
    np.testing.assert_array_equal(got[:-1, 1], simulated.voltage[1:])
    assert set(simulated.mode.tolist()) == modes
    seen = np.bitwise_or.reduce(simulated.flags)
    # residual (256) needs an encoder that stands still; missed and repeated periods (8, 16) another timer
    assert seen == 0x1FF - 8 - 16 - (256 if ending == "held" else 0)


@pytest.mark.parametrize("fmi", FMIS)
@pytest.mark.parametrize("precision", ["single", "double"])
def test_fmpy_finds_no_problem_and_simulates_to_the_bit(fmi: int, precision: str, tmp_path: Path) -> None:
    fmpy = _fmpy()
    tool("cc", "gcc")
    from fmpy.validation import validate_fmu

    made = law(precision)
    file = str(export_fmu(made, tmp_path / "arm.fmu", fmi=fmi))  # type: ignore[arg-type]
    assert validate_fmu(file) == []
    names = [variable.name for variable in VARIABLES if variable.causality == "input"]
    table = np.zeros(ROWS.shape[1], dtype=[("time", float), *((name, float) for name in names)])
    table["time"] = np.arange(ROWS.shape[1]) * PERIOD
    for name, row in zip(names, ROWS, strict=True):
        table[name] = row
    result = fmpy.simulate_fmu(
        file, input=table, stop_time=table["time"][-1], output_interval=PERIOD, validate=True
    )
    own = run(made, ROWS, first_tick=0)
    got = np.column_stack([result[v.name] for v in VARIABLES if v.causality == "output"])
    np.testing.assert_array_equal(got[1:], _outputs(own)[:-1])


@pytest.mark.parametrize("fmi", FMIS)
def test_an_importer_builds_the_same_from_the_sources(
    fmi: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _fmpy()
    # cmake is one of the build's packages: it lies beside the interpreter
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    tool("cmake")
    from fmpy.build import build_platform_binary

    made = law("single")
    file = export_fmu(made, tmp_path / "arm.fmu", fmi=fmi, compilers=())  # type: ignore[arg-type]
    folder = tmp_path / "built"
    _extracted(file, folder)
    (tmp_path / "build").mkdir()
    build_platform_binary(folder, tmp_path / "build", all_warnings=True)
    rebuilt = shutil.make_archive(str(tmp_path / "again"), "zip", folder)
    imported = Imported(Path(rebuilt), tmp_path / "fmu")
    imported.initialize()
    np.testing.assert_array_equal(imported.run(ROWS, made.period), _outputs(run(made, ROWS, first_tick=0)))


@pytest.mark.parametrize("fmi", FMIS)
def test_the_declarations_are_those_of_the_standard(fmi: int, tmp_path: Path) -> None:
    """The standard's own header in front: compilers then compare; strict warnings, with and without it."""
    headers = Path(_fmpy().__file__).parent / "c-code"
    for precision in ("single", "double"):
        file = export_fmu(law(precision), tmp_path / f"{precision}_law.fmu", fmi=fmi, compilers=())  # type: ignore[arg-type]
        sources = _extracted(file, tmp_path / precision)
        for compiler, flags in (("gcc", GCC), ("clang", (*CLANG, "-Wno-missing-prototypes"))):
            shell(tool(compiler), *flags, "-c", "all.c", "-o", "all.o", cwd=sources)
    with_header = ("-isystem", str(headers), "-include", f"fmi{fmi}Functions.h", "-fsyntax-only", "all.c")
    # that header refers each function's name to itself
    shell(tool("clang"), *CLANG, "-Wno-disabled-macro-expansion", *with_header, cwd=sources)


@pytest.mark.parametrize("fmi", FMIS)
def test_checkers_have_nothing_to_say(fmi: int, tmp_path: Path) -> None:
    sources = _extracted(
        export_fmu(law("single"), tmp_path / "arm.fmu", fmi=fmi, compilers=()),  # type: ignore[arg-type]
        tmp_path / "fmu",
    )
    unset = [f"-U{name}" for name in ("_WIN32", "LAW_REALS", "LAW_PAIRS", "LAW_FORWARDS")]
    unset += [f"-UFMI{fmi}_{kind}FUNCTION_PREFIX" for kind in ("", "ACTUAL_")]
    command = [tool("cppcheck"), "-q", "--std=c99", "--inconclusive", *unset]
    command += ["--enable=warning,style,performance,portability", "all.c"]
    answer = shell(*command, cwd=sources, check=False)
    assert answer.stdout + answer.stderr == ""
    # one file that includes the others is what all.c is for
    checks = "--checks=-*,bugprone-*,-bugprone-suspicious-include,cert-*,clang-analyzer-*"
    command = [tool("clang-tidy"), "all.c", checks, "--", "-std=c99"]
    answer = shell(*command, cwd=sources, check=False)
    assert "warning:" not in answer.stdout and "error:" not in answer.stdout, answer.stdout[:2000]


@pytest.mark.parametrize("fmi", FMIS)
def test_a_life_under_sanitizers(fmi: int, tmp_path: Path) -> None:
    """Right and wrong calls in C: no leak, no access outside, nothing undefined."""
    sources = _extracted(
        export_fmu(law("single"), tmp_path / "arm.fmu", fmi=fmi, compilers=()),  # type: ignore[arg-type]
        tmp_path / "fmu",
    )
    driver = Path(__file__).parent / "firmware" / "fmu_life.c"
    flags = ["-std=c99", "-g", "-O1", "-ffp-contract=off", f"-DFMI={fmi}", "-I", "."]
    flags += ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    command = [tool("gcc"), *flags, driver, "-o", "life"]
    shell(*command, cwd=sources)
    answer = shell(sources / "life", check=False)
    assert answer.returncode == 0, answer.stdout + answer.stderr[-2000:]
    assert answer.stdout.strip() == "lived"


def test_two_fmus_link_into_one_program(tmp_path: Path) -> None:
    """Importers for real-time targets compile sources and link them; each FMU brings its own law."""
    compiler = tool("gcc")
    names = ("first", "second")
    for name, precision in zip(names, ("single", "double"), strict=True):
        file = export_fmu(law(precision), tmp_path / f"{name}.fmu", compilers=())
        sources = _extracted(file, tmp_path / name)
        flags = ["-std=c99", "-ffp-contract=off", f"-DFMI2_FUNCTION_PREFIX={name}_"]
        shell(compiler, *flags, "-c", "all.c", "-o", tmp_path / f"{name}.o", cwd=sources)
    calls = "".join(f"const char *{name}_fmi2GetVersion(void);\n" for name in names)
    calls += "int main(void) { return first_fmi2GetVersion()[0] != second_fmi2GetVersion()[0]; }\n"
    (tmp_path / "main.c").write_text(calls, encoding="utf-8")
    shell(compiler, "main.c", "first.o", "second.o", "-o", "both", cwd=tmp_path)
    shell(tmp_path / "both")


@pytest.mark.parametrize("fmi", FMIS)
def test_a_cross_compiler_adds_windows(fmi: int, tmp_path: Path) -> None:
    cross = tool("x86_64-w64-mingw32-gcc", "gcc-mingw-w64-x86-64-win32")
    file = export_fmu(law(), tmp_path / "arm.fmu", fmi=fmi, compilers=(tool("gcc"), cross))  # type: ignore[arg-type]
    _extracted(file, tmp_path / "fmu")
    linux, windows = {2: ("linux64", "win64"), 3: ("x86_64-linux", "x86_64-windows")}[fmi]
    exported = []
    for path, lister in (
        (f"{linux}/arm.so", "nm -D"),
        (f"{windows}/arm.dll", "x86_64-w64-mingw32-objdump -p"),
    ):
        program, option = lister.split()
        told = shell(tool(program, "binutils"), option, tmp_path / "fmu" / "binaries" / path).stdout
        exported.append(set(re.findall(rf"\bfmi{fmi}\w+", told)))
    assert exported[0] == exported[1]
    assert len(exported[0]) == {2: 34, 3: 75}[fmi]  # all that the standard wants for co-simulation
    with pytest.raises(FieldError, match=r"the second one for x86_64-linux"):
        export_fmu(law(), tmp_path / "other.fmu", fmi=fmi, compilers=("gcc", "cc"))  # type: ignore[arg-type]


@pytest.mark.parametrize("fmi", FMIS)
def test_the_description_and_the_library_know_the_same_variables(fmi: int, tmp_path: Path) -> None:
    tool("cc", "gcc")
    file = export_fmu(law(), tmp_path / "arm.fmu", fmi=fmi)  # type: ignore[arg-type]
    imported = Imported(file, tmp_path / "fmu")
    described = {v.valueReference: v for v in imported.about.modelVariables}
    assert [described[k].name for k in range(len(VARIABLES))] == [v.name for v in VARIABLES]
    for reference, variable in enumerate(VARIABLES):
        assert described[reference].unit == (variable.unit or None)
        whole = {2: "Integer", 3: "UInt32"}[fmi]
        assert described[reference].type == ({2: "Real", 3: "Float64"}[fmi] if variable.real else whole)
    outputs = [v.name for v in VARIABLES if v.causality == "output"]
    assert [u.variable.name for u in imported.about.outputs] == outputs
    assert [u.variable.name for u in imported.about.initialUnknowns] == outputs
    assert all(u.dependencies == [] for u in imported.about.outputs)
    assert imported.about.defaultExperiment.stepSize == str(PERIOD)


@pytest.mark.parametrize("fmi", FMIS)
def test_sources_only_and_the_same_law_the_same_file(fmi: int, tmp_path: Path) -> None:
    files = [
        export_fmu(law(), tmp_path / folder / "arm.fmu", fmi=fmi, compilers=())  # type: ignore[arg-type]
        for folder in "ab"
    ]
    assert files[0].read_bytes() == files[1].read_bytes()
    with zipfile.ZipFile(files[0]) as archive:
        assert not any(name.startswith("binaries") for name in archive.namelist())
        assert all(info.external_attr >> 16 & stat.S_IROTH for info in archive.infolist())
        assert archive.read("sources/law.c") == (Path(__file__).parents[1] / "csrc" / "law.c").read_bytes()


@pytest.mark.parametrize("equipped", [True, False])
def test_the_page_inside_explains_every_number(equipped: bool, tmp_path: Path) -> None:
    file = export_fmu(law(equipped=equipped), tmp_path / "arm.fmu", compilers=())
    with zipfile.ZipFile(file) as archive:
        text, header = (archive.read(name).decode() for name in ("documentation/index.html", "sources/law.h"))
    root = ET.fromstring(text.replace("<!doctype html>", "").replace('<meta charset="utf-8">', ""))  # noqa: S314
    cells = [["".join(cell.itertext()) for cell in row] for row in root.iter("tr")]
    bits = {int(bit): name for name, bit in re.findall(r"LAW_FLAG_(\w+) (\d+)U", header)}
    assert {int(row[0]): row[1] for row in cells if len(row) == 3 and row[0].isdigit()} == bits
    assert sum(bits) == next(v.largest for v in VARIABLES if v.name == "flags")
    assert [row[0] for row in cells if len(row) == 4][1:] == [v.name for v in VARIABLES]
    assert ("connect voltage, within ±10 V" in "".join(root.itertext())) == equipped


def test_another_law_has_another_token(tmp_path: Path) -> None:
    tokens = set()
    for precision in ("single", "double"):
        for fmi in FMIS:
            file = export_fmu(
                law(),
                tmp_path / f"{precision}{fmi}.fmu".replace("s", "a"),
                fmi=fmi,
                precision=precision,
                compilers=(),  # type: ignore[arg-type]
            )
            with zipfile.ZipFile(file) as archive:
                root = ET.fromstring(archive.read("modelDescription.xml"))  # noqa: S314 - our own file
            tokens.add(root.attrib["guid" if fmi == 2 else "instantiationToken"])
    assert len(tokens) == 4


@pytest.mark.parametrize("name", ["arm.zip", "2 arms.fmu", "for.fmu", "law_step.fmu"])
def test_bad_names_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(FieldError, match="out"):
        export_fmu(law(), tmp_path / name)
    assert not list(tmp_path.iterdir())


def _compiler(folder: Path, triple: str) -> str:
    """A program that claims to compile for `triple` and cannot."""
    path = folder / f"cc-{triple}"
    path.write_text(
        f"#!/bin/sh\n[ $1 = -dumpmachine ] && echo {triple} && exit\necho 'all.c:1: error: no' >&2; exit 1\n",
        encoding="utf-8",
    )
    path.chmod(0o755)
    return str(path)


def test_compilers_that_cannot_are_named(tmp_path: Path) -> None:
    out = tmp_path / "arm.fmu"
    with pytest.raises(FieldError, match=r"compiler: no-such-cc is not installed"):
        export_fmu(law(), out, compilers=("no-such-cc",))
    with pytest.raises(FieldError, match=r"riscv64-linux is a platform that FMI 3 has no name for"):
        export_fmu(law(), out, fmi=3, compilers=(_compiler(tmp_path, "riscv64-linux-gnu"),))
    with pytest.raises(FieldError, match=r"aarch64-darwin is a platform that FMI 2 has no name for"):
        export_fmu(law(), out, compilers=(_compiler(tmp_path, "arm64-apple-darwin23"),))
    with pytest.raises(FieldError, match=r"unable to compile the FMU \(all.c:1: error: no\)"):
        export_fmu(law(), out, fmi=3, compilers=(_compiler(tmp_path, "arm64-apple-darwin23"),))
    with pytest.raises(FieldError, match=r"fmi: 1 is not offered"):
        export_fmu(law(), out, fmi=1, compilers=())  # type: ignore[arg-type]
    assert not out.exists()
