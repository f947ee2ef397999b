"""Gates of law.c: the strictest compiler settings, checkers, prover, fuzzer, coverage,
and seeded defects.
"""

from __future__ import annotations

import itertools
import math
import re
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import pytest

import fraclink as fl
from fraclink import Law, export_c
from fraclink.extend import equip
from law_bench import PERIOD, law, with_pair
from law_mutants import MUTANTS
from needed_tools import missing, tool
from test_export import own_flags, run, single

FIRMWARE = Path(__file__).parent / "firmware"
GCC = (
    *(
        "-std=c99",
        "-pedantic",
        "-Wall",
        "-Wextra",
        "-Wconversion",
        "-Wsign-conversion",
        "-Wdouble-promotion",
    ),
    *(
        "-Wshadow",
        "-Wcast-qual",
        "-Wundef",
        "-Wvla",
        "-ffp-contract=off",
        "-O2",
        "-Werror",
    ),
)
CLANG = (
    "-std=c99",
    "-Weverything",
    "-Wno-padded",
    "-Wno-declaration-after-statement",
    "-O2",
    "-Werror",
)
Result = TypeVar("Result")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("gates")
    export_c(law("single"), place)
    return place


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_compilers_have_nothing_to_say(precision: str, tmp_path: Path) -> None:
    made = law(precision)
    export_c(made, tmp_path)
    for name, flags in (("gcc", GCC), ("clang", CLANG)):
        for exact in ((), own_flags(tmp_path)):
            run(
                tool(name),
                *flags,
                *single(made),
                *exact,
                "-c",
                tmp_path / "law.c",
                "-o",
                tmp_path / "law.o",
            )
    run(
        tool("gcc"),
        *GCC,
        *single(made),
        "-c",
        tmp_path / "law_selftest.c",
        "-o",
        tmp_path / "test.o",
    )


@pytest.mark.slow
def test_cppcheck_and_misra_have_nothing_to_say(folder: Path) -> None:
    # unusedFunction: the functions of a library are used elsewhere;
    # missingIncludeSystem: stdint.h is not parsed
    general = tuple(f"-ULAW_{kind}" for kind in ("REALS", "PAIRS", "FORWARDS"))
    for build in (general, ("-ULAW_PAIRS", *own_flags(folder))):
        answer = run(
            tool("cppcheck"), "-q", "--std=c99", "--enable=all", "--inconclusive", "--addon=misra",
            "--suppress=unusedFunction", "--suppress=missingIncludeSystem", *build, folder / "law.c",
        )  # fmt: skip
        assert answer.stdout + answer.stderr == ""


@pytest.mark.slow
@pytest.mark.parametrize("define", [(), ("-DLAW_SINGLE",)])
def test_clang_tidy_has_nothing_to_say(folder: Path, define: tuple[str, ...]) -> None:
    checks = "--checks=-*,bugprone-*,cert-*,clang-analyzer-*"
    answer = run(
        tool("clang-tidy"),
        folder / "law.c",
        checks,
        "--",
        "-std=c99",
        *define,
        check=False,
    )
    assert "warning:" not in answer.stdout
    assert "error:" not in answer.stdout


@pytest.mark.slow
def test_the_fuzzer_breaks_no_invariant() -> None:
    """A second of the fuzzing that `make fuzz` does for a minute."""
    program = Path(__file__).parents[1] / "tools" / "fuzz_law.py"
    answer = run(sys.executable, program, "--seconds", "1", check=False)
    if "not installed" in answer.stderr:
        missing(answer.stderr.strip())
    assert answer.returncode == 0, answer.stdout + answer.stderr
    runs = re.match(r"(\d+) executions", answer.stdout)
    assert runs is not None
    assert int(runs.group(1)) > 1000


@pytest.mark.slow
def test_every_line_and_branch_of_the_law_is_run(folder: Path) -> None:
    (folder / "one.c").write_text(
        '#include "law.c"\n#include "drive.c"\n', encoding="utf-8"
    )
    run(
        tool("gcc"), "-std=c99", "-DLAW_SINGLE", "-O0", "--coverage", "-ffp-contract=off", "-I", folder,
        "-I", FIRMWARE, "one.c", "-lm", "-o", "one", cwd=folder,
    )  # fmt: skip
    run(folder / "one", "300", cwd=folder)
    answer = run(tool("gcov", "gcc"), "-b", "one.c", cwd=folder).stdout
    mine = answer[answer.index("law.c'") :]
    assert re.search(r"Lines executed:100\.00%", mine), mine[:300]
    assert re.search(r"Taken at least once:100\.00%", mine), mine[:300]


def both_cores(work: Callable[[int], Result], items: Sequence[int]) -> list[Result]:
    """Compilers are separate processes: two threads that wait for them keep two cores
    busy.
    """
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(work, items))


CONTROLLERS = (
    *(
        (0.03, 0.4, 0.0),
        (0.03, 0.4, 0.16),
        (0.07, 0.61, 0.0),
        (0.07, 0.61, 0.005),
        (0.15, 0.65, 0.0),
    ),
    *(
        (0.15, 0.65, 0.16),
        (0.2, 0.8, 0.005),
        (0.2, 0.8, 0.16),
        (0.3, 0.5, 0.0),
        (0.3, 0.5, 0.005),
    ),
)
LINKS = ((7.0, 1.7), (9.6, 1.92), (11.1, 1.8), (13.6, 2.0), (16.0, 1.96), (20.0, 1.5))


def law_of(
    gain: float,
    order: float,
    delta: float,
    natural: float,
    exponent: float,
    *,
    modes: int,
) -> Law:
    link = fl.LinkModel(stiffness=1.56, natural_frequency=natural, order=exponent)
    controller = fl.Controller(
        derivative_gain=gain,
        derivative_order=order,
        filter_time=delta,
        filter_order=2,
        link=link,
    )
    made = fl.discretize(controller, PERIOD, order=modes)
    return equip(made, fl.Rig.named("paper-2023"), link)


@pytest.mark.slow
def test_many_designs_compile_clean_and_pass_their_self_test(tmp_path: Path) -> None:
    export_c(law("double"), tmp_path / "law")
    for define, name in (("-DLAW_DOUBLE", "double"), ("-DLAW_SINGLE", "single")):
        run(
            tool("gcc"),
            *GCC,
            define,
            "-c",
            "law.c",
            "-o",
            f"{name}.o",
            cwd=tmp_path / "law",
        )
    # a fit takes a second: each controller is fitted once, each link without one, and
    # every link meets five of the controllers
    corrections = [
        law_of(*controller, 11.1, 1.8, modes=4).correction for controller in CONTROLLERS
    ]
    links = [law_of(*CONTROLLERS[0], *link, modes=0) for link in LINKS]
    pairs = zip(itertools.cycle(links), itertools.cycle(corrections), strict=True)
    designs = list(itertools.islice(pairs, math.lcm(len(links), len(corrections))))
    assert len(designs) >= 30

    def check(number: int) -> None:
        made, correction = designs[number]
        made = replace(made, correction=correction).in_precision(
            "single" if number % 2 else "double"
        )
        place = tmp_path / str(number)
        export_c(made, place)
        law_object = tmp_path / "law" / f"{made.precision}.o"
        run(
            tool("gcc"),
            *GCC,
            "-O0",
            *single(made),
            "law_selftest.c",
            law_object,
            "-o",
            "selftest",
            cwd=place,
        )
        assert "passed" in run(place / "selftest").stdout, made

    both_cores(check, range(len(designs)))


@pytest.fixture(scope="module")
def with_pairs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Law]:
    """A design whose correction has a complex pair, so that every line of law.c is
    covered.
    """
    made = with_pair("single")
    place = tmp_path_factory.mktemp("pairs")
    export_c(made, place)
    return place, made


SANITIZED = ("-fsanitize=address,undefined",)


def _caught(folder: Path, made: Law, number: int) -> str | None:
    """Return the first gate that detects the mutant, cheapest first, or None."""
    old, new = MUTANTS[number]
    text = (folder / "law.c").read_text(encoding="utf-8")
    assert text.count(old) >= 1, f"the mutant's pattern is gone: {old}"
    place = folder / f"mutant{number}"
    place.mkdir()
    (place / "law.c").write_text(text.replace(old, new, 1), encoding="utf-8")
    # what ships is compiled by -O2 above; here half of the time would go into that
    compiled = (tool("gcc"), *GCC, "-O0", *single(made), "-I", folder, "-c", "law.c")
    if run(*compiled, "-o", "law.o", cwd=place, check=False).returncode:
        return "gcc"
    run(tool("gcc"), "law.o", folder / "selftest.o", "-o", "selftest", cwd=place)
    if run(place / "selftest", check=False).returncode:
        return "self-test"
    # a mutant that breaks an invariant needs no sanitizer
    for options, gate in (((), "fault drive"), (SANITIZED, "sanitizers")):
        if options:
            run(*compiled, *options, "-o", "law.o", cwd=place)
        drive = folder / f"{gate}.o"
        run(tool("gcc"), *options, "law.o", drive, "-lm", "-o", "one", cwd=place)
        answer = run(place / "one", "10", check=False)
        if answer.returncode or "runtime error" in answer.stderr:
            return gate
    return None


@pytest.mark.slow
def test_seeded_defects_are_caught(with_pairs: tuple[Path, Law]) -> None:
    assert len(MUTANTS) >= 30
    folder, made = with_pairs
    for source, options, target in (
        (folder / "law_selftest.c", (), "selftest"),
        (FIRMWARE / "drive.c", (), "fault drive"),
        (FIRMWARE / "drive.c", SANITIZED, "sanitizers"),
    ):
        run(
            *(tool("gcc"), "-std=c99", *options, *single(made), "-I", folder),
            *("-c", source, "-o", folder / f"{target}.o"),
        )
    gates = both_cores(lambda number: _caught(*with_pairs, number), range(len(MUTANTS)))
    table = {
        f"{old} -> {new}": gate for (old, new), gate in zip(MUTANTS, gates, strict=True)
    }
    survivors = [name for name, gate in table.items() if gate is None]
    for name, gate in table.items():
        print(f"{gate or 'SURVIVED':12} {name}")
    assert len(survivors) <= 0.1 * len(MUTANTS), survivors
