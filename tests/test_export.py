"""The C export: the files, what is refused, and the self-test with this machine's
compilers.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fraclink import Law, export_c, export_fmu
from fraclink.errors import FieldError, MissingExtraError
from law_bench import law
from needed_tools import tool

Answer = subprocess.CompletedProcess[str]
ROOT = Path(__file__).resolve().parents[1]
FLAGS = (
    "-std=c99",
    "-O2",
    "-ffp-contract=off",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-pedantic",
    "-Werror",
)


def single(made: Law) -> tuple[str, ...]:
    return ("-DLAW_SINGLE",) if made.precision == "single" else ()


def own_flags(folder: Path) -> tuple[str, ...]:
    """Return the compiler options that README.md gives for this design alone."""
    page = (folder / "README.md").read_text(encoding="utf-8")
    found = re.search(r"add `([^`]*)`: law\.c", page)
    assert found is not None
    return tuple(found[1].split())


def run(*command: str | Path, cwd: Path | None = None, check: bool = True) -> Answer:
    return subprocess.run(  # noqa: S603
        [str(part) for part in command],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=check,
        timeout=300,
    )


@pytest.fixture(scope="module", params=["single", "double"])
def exported(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Law, Path]:
    made = law(request.param)
    folder = tmp_path_factory.mktemp(request.param)
    export_c(made, folder)
    return made, folder


@pytest.mark.slow
def test_law_c_is_the_file_that_was_simulated(exported: tuple[Law, Path]) -> None:
    _, folder = exported
    for name in ("law.h", "law.c"):
        assert (folder / name).read_bytes() == (ROOT / "csrc" / name).read_bytes()


@pytest.mark.slow
def test_the_same_law_gives_the_same_bytes(
    exported: tuple[Law, Path], tmp_path: Path
) -> None:
    made, folder = exported
    for path in export_c(made, tmp_path / "again"):
        assert path.read_bytes() == (folder / path.name).read_bytes()


@pytest.mark.slow
def test_the_data_are_the_block(exported: tuple[Law, Path]) -> None:
    """The block compiled from the hex floats by a C compiler is the one that the
    package simulates with.
    """
    made, folder = exported
    program = folder / "block.c"
    program.write_text(
        '#include <stdio.h>\n#include "law_data.h"\n'
        "int main(void) { return fwrite(&law_data, sizeof(law_data), 1, stdout) == 1 ? 0 : 1; }\n",
        encoding="utf-8",
    )
    run(tool("gcc"), *FLAGS, *single(made), program, "-o", folder / "block")
    answer = subprocess.run([folder / "block"], capture_output=True, check=True)  # noqa: S603
    assert answer.stdout == made.block


@pytest.mark.slow
def test_the_self_test_tells_a_law_that_is_another(
    exported: tuple[Law, Path],
) -> None:
    """The hash written by the package, recomputed by the C code of the folder, and a
    different one.
    """
    made, folder = exported
    text = (folder / "law_selftest.c").read_text(encoding="utf-8")
    expected = re.findall(r"#define EXPECTED (0x\w+)U", text)[0]
    place = folder / "wrong_selftest.c"
    place.write_text(text.replace(expected, "0x12345678"), encoding="utf-8")
    for source, word in (("law_selftest.c", "passed"), (place.name, "FAILED")):
        command = (tool("gcc"), *FLAGS, "-O0", *single(made), source, "law.c")
        run(*command, "-o", "quick", cwd=folder)
        assert word in run(folder / "quick", check=False).stdout


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("level", ["-O0", "-O2", "-O3"])
def test_the_self_test_passes(
    exported: tuple[Law, Path], compiler: str, level: str
) -> None:
    made, folder = exported
    target = folder / f"selftest{compiler}{level}"
    run(
        tool(compiler),
        *FLAGS,
        level,
        *single(made),
        "law_selftest.c",
        "law.c",
        "-o",
        target,
        cwd=folder,
    )
    answer = run(target)
    assert "passed" in answer.stdout
    hashed = re.search(r"hash ([0-9A-F]{8}),", answer.stdout)
    assert hashed is not None
    assert f"hash {hashed.group(1)}" in (folder / "README.md").read_text(
        encoding="utf-8"
    )


@pytest.mark.slow
def test_the_self_test_finds_a_compiler_that_contracts(
    exported: tuple[Law, Path],
) -> None:
    made, folder = exported
    if "fma" not in Path("/proc/cpuinfo").read_text(encoding="utf-8"):
        pytest.skip("this processor has no fused multiply-add")
    target = folder / "contracted"
    flags = (
        "-std=gnu99",
        "-O2",
        "-mfma",
        "-ffp-contract=fast",
        "-DLAW_CONTRACT_OFF",
        *single(made),
    )
    run(tool("gcc"), *flags, "law_selftest.c", "law.c", "-o", target, cwd=folder)
    answer = run(target, check=False)
    assert answer.returncode == 1
    assert "FAILED" in answer.stdout
    refused = run(
        tool("gcc"),
        "-std=gnu99",
        "-O2",
        "-mfma",
        *single(made),
        "-c",
        "law.c",
        cwd=folder,
        check=False,
    )
    assert "ffp-contract=off" in refused.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "machine", ["__riscv_flen=32", "__FP_FAST_FMAF=1", "__ARM_FEATURE_FMA=1"]
)
def test_machines_that_fuse_are_refused_by_their_own_words(
    machine: str, tmp_path: Path
) -> None:
    """The macros of a cross compiler, without the compiler: gnu modes fuse, ISO modes
    and -ffp-contract=off do not.
    """
    export_c(law("single"), tmp_path)
    command = (tool("gcc"), "-fsyntax-only", "-DLAW_SINGLE", f"-D{machine}", "law.c")
    assert (
        "ffp-contract=off"
        in run(*command, "-std=gnu99", cwd=tmp_path, check=False).stderr
    )
    run(*command, "-std=c99", cwd=tmp_path)
    run(*command, "-std=gnu99", "-ffp-contract=off", "-DLAW_CONTRACT_OFF", cwd=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_fast_math_and_the_wrong_precision_are_refused(
    exported: tuple[Law, Path], compiler: str
) -> None:
    made, folder = exported
    # the last one also alone: it is the part of the others that removes the tests for
    # NaN
    for flag in ("-Ofast", "-ffast-math", "-ffinite-math-only"):
        flags = ("-std=c99", flag, *single(made), "-c", "law.c", "-o", "x.o")
        fast = run(tool(compiler), *flags, cwd=folder, check=False)
        assert (
            fast.returncode != 0 and "its NaN tests would be removed" in fast.stderr
        ), flag
    other = () if made.precision == "single" else ("-DLAW_SINGLE",)
    wrong = run(
        tool(compiler),
        *FLAGS,
        *other,
        "-c",
        "law_selftest.c",
        "-o",
        "x.o",
        cwd=folder,
        check=False,
    )
    assert "precision" in wrong.stderr


@pytest.mark.slow
def test_a_changed_coefficient_refuses_to_start(
    exported: tuple[Law, Path], tmp_path: Path
) -> None:
    made, folder = exported
    place = tmp_path / "changed"
    shutil.copytree(folder, place)
    text = (place / "law_data.h").read_text(encoding="utf-8")
    changed = re.sub(
        r"(\.direct = 0x1\.)(\w)",
        lambda m: m.group(1) + ("1" if m.group(2) != "1" else "2"),
        text,
    )
    assert changed != text
    (place / "law_data.h").write_text(changed, encoding="utf-8")
    run(
        tool("gcc"),
        *FLAGS,
        *single(made),
        "law_selftest.c",
        "law.c",
        "-o",
        "selftest",
        cwd=place,
    )
    answer = run(place / "selftest", check=False)
    assert answer.returncode == 1
    assert "hash 00000000" in answer.stdout  # law_init rejected it


def test_existing_folders_are_kept(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(FieldError, match="--force"):
        export_c(law(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    with pytest.raises(FieldError, match="already there"):
        export_c(law(), tmp_path / "mine.txt")
    export_c(law(), tmp_path, force=True)
    assert (tmp_path / "mine.txt").read_text(encoding="utf-8") == "mine"
    assert not list(tmp_path.glob("*.tmp"))


@pytest.mark.parametrize(
    "name",
    [
        "2fast",
        "for",
        "class",
        "a-b",
        "a b",
        "_hidden",
        "x" * 32,
        "x;int y",
        "ä",
        'a"',
    ],
)
def test_illegal_identifiers_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(FieldError, match="not a C identifier"):
        export_fmu(law(), tmp_path / f"{name}.fmu", compilers=())
    assert not list(tmp_path.iterdir())


def test_a_proof_without_the_provers_names_their_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "fraclink_prove", None)
    with pytest.raises(
        MissingExtraError, match=r"fraclink-prove .*pip install \./prove"
    ):
        export_c(law("single"), tmp_path / "firmware", prove=True)
    assert not (tmp_path / "firmware").exists()
