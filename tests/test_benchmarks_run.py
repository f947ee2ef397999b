"""The benchmark runner: a crash is an error, a missed target is a result."""

from __future__ import annotations

import csv
import importlib.util
import sys
from pathlib import Path

import pytest

import fraclink

RUNNER = Path(__file__).parents[1] / "benchmarks" / "run.py"
spec = importlib.util.spec_from_file_location("benchmarks_run", RUNNER)
assert spec is not None
assert spec.loader is not None
runner = importlib.util.module_from_spec(spec)
sys.modules[spec.name] = runner  # dataclasses look up their module
spec.loader.exec_module(runner)


@pytest.mark.parametrize(
    ("code", "figures", "crashed"),
    [
        (
            "print('ok   speed   3 R   wanted <= 4 R')\nprint('MISS error 1 wanted 0')\nprint('a note')",
            2,
            False,
        ),
        ("print('mode 1  3.2 rad/s  wanted 3.2')", 1, False),
        ("print('ok speed 3')\nraise SystemExit(3)", 1, True),
        ("print('okay, nothing measured')", 0, True),
        ("1 / 0", 0, True),
    ],
)
def test_outcomes(tmp_path: Path, code: str, figures: int, crashed: bool) -> None:
    script = tmp_path / "bench_one.py"
    script.write_text(code, encoding="utf-8")
    outcome = runner.run(script)
    assert (len(outcome.figures), outcome.crashed) == (figures, crashed)


@pytest.mark.parametrize(
    ("code", "exit_code"), [("print('MISS a 1 wanted 2')", 0), ("1 / 0", 1)]
)
def test_exit_code(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    code: str,
    exit_code: int,
) -> None:
    (tmp_path / "bench_one.py").write_text(code, encoding="utf-8")
    monkeypatch.setattr(runner, "HERE", tmp_path)
    monkeypatch.setattr(sys, "argv", ["run.py"])
    assert runner.main() == exit_code
    assert "bench_one" in capsys.readouterr().out


def test_an_unknown_benchmark_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["run.py", "nothing"])
    with pytest.raises(SystemExit) as caught:
        runner.main()
    assert caught.value.code == 2


def test_the_history_grows_by_the_figures_of_each_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bench_one.py").write_text(
        "print('ok speed 3, wanted 4')\nprint('a note')", encoding="utf-8"
    )
    monkeypatch.setattr(runner, "HERE", tmp_path)
    monkeypatch.setattr(sys, "argv", ["run.py", "--record"])
    assert (runner.main(), runner.main()) == (0, 0)
    with (tmp_path / "history.csv").open(encoding="utf-8", newline="") as stream:
        header, *rows = csv.reader(stream)
    assert header == ["version", "commit", "processor", "benchmark", "figure"]
    assert [(row[0], *row[3:]) for row in rows] == 2 * [
        (fraclink.__version__, "bench_one", "ok speed 3, wanted 4")
    ]
    assert "history.csv" in capsys.readouterr().out
