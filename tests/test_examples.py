"""Every script of examples/ runs, uses only public names, and prints what it should."""

from __future__ import annotations

import ast
import contextlib
import io
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from unittest.mock import patch

import pytest

import fraclink as fl
from guard_sources import ROOT

SCRIPTS = {path.stem: path for path in sorted((ROOT / "examples").glob("*.py"))}


def printed(name: str, folder: Path) -> str:
    """The output of a script in a process of its own, which may write only below
    `folder`.
    """
    answer = subprocess.run(  # noqa: S603
        [sys.executable, str(SCRIPTS[name]), str(folder)],
        cwd=folder,
        env=os.environ | {"MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    return answer.stdout


def printed_here(name: str, folder: Path) -> str:
    """The output of a script in this process, in a third of the time."""
    said, words = io.StringIO(), [str(SCRIPTS[name]), str(folder)]
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(said),
        patch.object(sys, "argv", words),
    ):
        runpy.run_path(words[0], run_name="__main__")
    return said.getvalue()


def number(pattern: str, text: str) -> float:
    """The number after `pattern`."""
    found = re.search(pattern + r"\s*([-+]?\d+(?:\.\d+)?)", text)
    assert found, text
    return float(found[1])


def test_every_script_has_a_test_and_a_line_in_the_readme() -> None:
    tested = Path(__file__).read_text("utf-8")
    readme = (ROOT / "README.md").read_text("utf-8")
    assert len(SCRIPTS) >= 6
    ways = ("printed", "printed_here")
    runs = {name for name in SCRIPTS for way in ways if f'{way}("{name}"' in tested}
    assert runs == set(SCRIPTS)
    assert [name for name in SCRIPTS if f"examples/{name}.py" not in readme] == []


@pytest.mark.parametrize("name", SCRIPTS)
def test_scripts_use_public_names_only(name: str) -> None:
    tree = ast.parse(SCRIPTS[name].read_text("utf-8"))
    modules = [
        a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names
    ]
    modules += [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    plain = {"fraclink", "fracsys", "matplotlib", "numpy", "pathlib", "sys"}
    assert set(modules) <= plain
    used = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "fl"
    }
    assert used <= set(fl.__all__)


@pytest.mark.slow
def test_arrays_give_back_the_arm_they_were_made_from(tmp_path: Path) -> None:
    text = printed_here("arrays_of_your_own", tmp_path)
    for name, true in (("order", 1.90), ("natural_frequency", 11.0)):
        error = number(rf"{name} = [\d.]+ ±", text)
        assert 0.0 < error < 0.01 * true
        assert abs(number(f"{name} =", text) - true) < 4.0 * error


@pytest.mark.slow
def test_the_fractional_link_has_its_poles_and_the_margins_of_the_formula(
    tmp_path: Path,
) -> None:
    text = printed_here("fractional_systems", tmp_path)
    # s^λ = -100 on the principal sheet: 100^(1/λ) at the angle π/λ.
    pole = complex(
        *(float(x) for x in re.findall(r"\[(-[\d.]+)([+-][\d.]+)j", text)[0])
    )
    assert abs(pole - 100 ** (1 / 1.92) * complex(*_unit(1 / 1.92))) < 1e-3
    assert abs(number("phase margin", text) - _margin_of_the_loop()) < 0.01
    assert 1.7 < number("peak", text) < 2.0  # below 2, the peak without damping
    assert number("at most", text) < 0.01


def _unit(turn: float) -> tuple[float, float]:
    from math import cos, pi, sin

    return cos(pi * turn), sin(pi * turn)


def _margin_of_the_loop() -> float:
    """Phase margin [°] of 0.07 s^0.61 · 100/(s^1.92 + 100), by bisection on |L| above
    the resonance.
    """
    import cmath

    def loop(w: float) -> complex:
        return complex(0.07 * (1j * w) ** 0.61 * 100 / ((1j * w) ** 1.92 + 100))

    low, high = 11.5, 100.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if abs(loop(middle)) > 1 else (low, middle)
    return 180.0 + cmath.phase(loop(low)) * 180.0 / cmath.pi


@pytest.mark.slow
def test_a_log_becomes_code_for_a_board(tmp_path: Path) -> None:
    text = printed("log_to_board", tmp_path)
    assert (
        abs(number("order", text) - 1.92) < 0.002
    )  # what the bundled log was simulated with
    assert "proved for every payload: True" in text
    assert (tmp_path / "firmware" / "law.c").read_text("utf-8") == (
        ROOT / "csrc" / "law.c"
    ).read_text("utf-8")
    design = fl.load(tmp_path / "design.json")
    assert isinstance(design, fl.Design)
    assert design.payloads == (0.020, 0.040)


@pytest.mark.slow
def test_margins_fall_below_the_range_and_are_kept_inside(tmp_path: Path) -> None:
    text = printed("margins_against_payload", tmp_path)
    left = [number(rf"\b{grams} g:", text) for grams in (8, 20, 30, 40, 60)]
    assert left == sorted(left)
    assert left[0] < 49.0 <= left[1]  # required: 50° in the range from 20 g on
    assert (tmp_path / "margins.svg").read_text("utf-8").startswith("<?xml")


@pytest.mark.slow
def test_an_arm_that_loses_payload_arrives(tmp_path: Path) -> None:
    text = printed_here("payload_that_drops", tmp_path)
    assert text.count("passed") == 2
    run = fl.load(tmp_path / "run.npz")
    assert abs(float(run.tip_angle[-1]) - 1.0) < 0.02


@pytest.mark.slow
def test_most_varied_arms_pass(tmp_path: Path) -> None:
    text = printed_here("varied_arms", tmp_path)
    assert 0 <= int(text.split()[0]) < 20
    assert text.count("rank correlation") == 3
    assert "less than" in text or "(" in text  # the rate has an interval
