"""ARCHITECTURE.md says how to add a structure, a requirement, a rival, a fault, a
reader and an export: each is added here.

The blocks of the page are inserted into a copy of the package, after the line that each
names, and then used.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fracsys._kernels
from fraclink import _kernels
from guard_sources import PACKAGES, ROOT

PAGE = (ROOT / "ARCHITECTURE.md").read_text("utf-8")
BLOCK = re.compile(
    r"```(?:python|toml)\n# src/fraclink/(\S+), (?:after: (.*?)|at the end)\n(.*?)```",
    flags=re.DOTALL,
)
RECIPES = {
    title: [(path, anchor, code) for path, anchor, code in BLOCK.findall(text)]
    for title, text in re.findall(
        r"^### (?:A|An) (\w+).*?\n(.*?)(?=^### |\Z)",
        PAGE,
        flags=re.DOTALL | re.MULTILINE,
    )
}

# The finder of an editable install comes before the path and would load the unextended
# package.
NO_EDITABLE_INSTALL = """
import sys
sys.meta_path[:] = [finder for finder in sys.meta_path if not type(finder).__name__.startswith("ScikitBuild")]
"""


def dense(text: str) -> str:
    """The text without white space: the formatter may break a line anywhere."""
    return "".join(text.split())


def insert(root: Path, path: str, anchor: str, code: str) -> None:
    """Insert `code` after the one line that begins with `anchor`, or at the end of the
    file without one.
    """
    place = root / "fraclink" / path
    lines = place.read_text("utf-8").splitlines(keepends=True)
    starts = [
        number
        for number, line in enumerate(lines)
        if anchor
        and line.strip()
        and dense("".join(lines[number : number + 4])).startswith(dense(anchor))
    ]
    assert len(starts) == (1 if anchor else 0), (
        f"{anchor!r} stands {len(starts)} times in {path}"
    )
    end = len(lines)
    if starts:
        # A row ends at its closing bracket.
        end, depth = starts[0], 1
        while depth:
            row = "".join(lines[starts[0] : end + 1])
            depth = sum(map(row.count, "([{")) - sum(map(row.count, ")]}"))
            end += 1
    place.write_text("".join([*lines[:end], code, *lines[end:]]), "utf-8")


@pytest.fixture(scope="module")
def grown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package with everything the page adds."""
    root = tmp_path_factory.mktemp("grown")
    for package in PACKAGES:
        shutil.copytree(
            package,
            root / package.name,
            ignore=shutil.ignore_patterns("__pycache__", "*.so"),
        )
    # An editable install keeps the compiled modules in another place.
    shutil.copy(_kernels.__file__, root / "fraclink")
    shutil.copy(fracsys._kernels.__file__, root / "fracsys")
    (root / "sitecustomize.py").write_text(NO_EDITABLE_INSTALL, "utf-8")
    for blocks in RECIPES.values():
        for path, anchor, code in blocks:
            insert(root, path, anchor, code)
    return root


def run(grown: Path, code: str) -> list[str]:
    """The lines printed by `code` with the extended package."""
    search = os.pathsep.join(
        [
            str(grown),
            *(path for path in sys.path if path and Path(path) != ROOT / "src"),
        ]
    )
    answer = subprocess.run(  # noqa: S603
        [
            sys.executable,
            "-c",
            f"import fraclink\nassert fraclink.__file__.startswith({str(grown)!r})\n{code}",
        ],
        cwd=grown,
        env=os.environ | {"PYTHONPATH": search},
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    return answer.stdout.splitlines()


def test_the_page_has_the_six_recipes_and_none_is_long() -> None:
    names = ["structure", "requirement", "rival", "fault", "reader", "export"]
    assert list(RECIPES) == names
    for title, blocks in RECIPES.items():
        written = [line for _, _, code in blocks for line in code.splitlines() if line]
        assert 1 <= len(written) <= 14, title


def test_every_package_that_the_page_names_is_there() -> None:
    named = re.findall(
        r"`((?:tests|src|csrc|prove|reproduce|benchmarks|examples)/[\w./]*)`", PAGE
    )
    assert [name for name in named if not (ROOT / name).exists()] == []


@pytest.mark.slow
def test_a_structure_is_one_row(grown: Path) -> None:
    code = """
import numpy as np, fraclink as fl, fracsys
s, T = fracsys.s, 0.004
angle = fl.prbs(0.2, 0.157).angle(T * np.arange(4000))
link = 1.56 * s**1.9 / (s**1.9 + 0.5 * s + 121)
torque = fracsys.time_response(link, angle, T).output
torque = torque + 1e-6 * np.random.default_rng(1).standard_normal(4000)
log = fl.Experiment(T, angle, torque)
fit = fl.identify(log, "VD-FOM")
print(fit.model.structure, fit.model.order, fit.model.damping)
print(*fl.compare_structures(log).fits)
"""
    first, second = run(grown, code)
    name, order, damping = first.split()
    assert name == "VD-FOM"
    assert abs(float(order) - 1.9) < 0.01
    # order and damping together explain a single width
    assert abs(float(damping) - 0.5) < 0.15
    assert second.split() == ["UD-IOM", "D-IOM", "UD-FOM", "D-FOM", "VD-FOM"]


@pytest.mark.slow
def test_a_requirement_is_one_row_and_its_words(grown: Path) -> None:
    code = """
import fraclink as fl
from fraclink._cli import main
rig = fl.Rig.named("paper-2023-geared")
asked = dict(payloads=(0.02, 0.04), gain_crossover=11.0, phase_margin=fl.deg(45))
free = fl.design(rig.model, rig, **asked, voltage_noise=1e9)
(noise,) = [row.achieved for row in free.requirements if row.unit == "V/rad"]
kept = fl.design(rig.model, rig, **asked, voltage_noise=0.98 * noise)
(row,) = [row for row in kept.requirements if row.unit == "V/rad"]
print(kept.passed, row.passed, row.achieved <= 0.98 * noise)
words = f"design --rig paper-2023-geared --gain-crossover 11 --voltage-noise {noise} --out quiet.json"
print(main(words.split()))
"""
    lines = run(grown, code)
    assert lines[0] == "True True True"
    assert lines[-1] == "0"
    assert any("noise of the voltage" in line for line in lines)


@pytest.mark.slow
def test_a_rival_is_one_row(grown: Path) -> None:
    code = """
import fraclink as fl
rig = fl.Rig.named("paper-2023-geared")
design = fl.design(rig.model, rig, payloads=(0.02, 0.04), gain_crossover=12.0, phase_margin=fl.deg(50))
found = fl.trials.compare(design, payloads=(0.03,), names=["half the gain"])
print(*(standing.name for standing in found.standings), sep="|")
"""
    assert run(grown, code) == ["fraclink|half the gain"]


@pytest.mark.slow
def test_a_fault_is_a_table_and_a_row(grown: Path) -> None:
    code = """
import fraclink as fl
rig = fl.Rig.named("paper-2023-geared")
design = fl.design(rig.model, rig, payloads=(0.02, 0.04), gain_crossover=12.0, phase_margin=fl.deg(50))
bench = fl.trials.Bench.of(design, link_mass=0.00735)
print(fl.trials.CATALOGUE[-1].number, fl.trials.CATALOGUE[-1].title)
outcome = fl.trials.run_case(bench, fl.trials.Case("F45", severity=3, payload=0.03, phase="rest", seed=1))
print(outcome.case.fault, any("peak tip error" in str(check) for check in outcome.checks))
"""
    assert run(grown, code) == ["F45 gauge reads zero for a while", "F45 True"]


@pytest.mark.slow
def test_a_reader_is_a_magic_word_and_a_parser(grown: Path) -> None:
    time = 0.004 * np.arange(500)
    table = np.column_stack([time, np.sin(3 * time), 0.1 * np.cos(3 * time)])
    (grown / "log.lab").write_bytes(b"LAB1" + table.astype("<f8").tobytes())
    code = """
import fraclink as fl
t, theta, gamma = fl.Channel("t", "s"), fl.Channel("theta", "rad"), fl.Channel("gamma", "Nm")
log = fl.read_log("log.lab", columns=fl.LogColumns(t, theta, torque=gamma))
print(log.period, log.motor_angle[100], log.output[100])
"""
    (line,) = run(grown, code)
    assert [float(x) for x in line.split()] == pytest.approx(
        [0.004, table[100, 1], table[100, 2]], rel=1e-12
    )


@pytest.mark.slow
def test_an_export_is_a_function(grown: Path) -> None:
    code = """
import fraclink as fl
rig = fl.Rig.named("paper-2023-geared")
design = fl.design(rig.model, rig, payloads=(0.02, 0.04), gain_crossover=12.0, phase_margin=fl.deg(50))
fl.save(design, "design.json")
assert fl.main(["export", "poles", "design.json", "--out", "poles.csv"]) == 0
print(*fl.discretize(design).correction.poles, sep=",")
"""
    printed = run(grown, code)
    head, *rows = (grown / "poles.csv").read_text("utf-8").splitlines()
    assert head == "pole,gain"
    assert [row.partition(",")[0] for row in rows] == printed[-1].split(",")
