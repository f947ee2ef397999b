"""`fraclink campaign faults`: exit codes, files, and the command that repeats a single
run.
"""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

import fraclink as fl
from fraclink import main as run
from fraclink.trials import FaultTable

ONE = ["--severity", "2", "--payload", "0.03", "--phase", "mid", "--seed", "1"]


@pytest.fixture
def arm(tmp_path: Path) -> list[str]:
    """The words of the campaign of a design on an arm with a gear and a massive link."""
    place = str(tmp_path / "design.json")
    assert run(["design", "--rig", "paper-2023-geared", "--out", place]) == 0
    return ["campaign", "faults", "--design", place]


def test_a_fault_that_is_met_exits_with_0(
    arm: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "met"
    assert run([*arm, *ONE, "--only", "F02", "--out", str(out)]) == 0
    assert "1 of 1 faults" in capsys.readouterr().out
    assert fl.load(out / "faults.json", FaultTable).passed
    assert (out / "run.svg").read_text("utf-8").startswith("<svg")
    kept = fl.load(out / "run.npz")
    assert kept.about["case"] == "F02-2-30g-mid-1" and len(kept.tip_angle) == 1751
    # A result is only overwritten on request.
    assert run([*arm, *ONE, "--only", "F02", "--out", str(out)]) == 2
    assert "--force" in capsys.readouterr().err


@pytest.mark.slow
def test_an_open_fault_exits_with_1_and_its_command_repeats_it(
    arm: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    capsys.readouterr()
    monkeypatch.chdir(tmp_path)
    given = [
        "--only",
        "F07",
        "--severity",
        "3",
        "--phase",
        "mid",
        "--payload",
        "0.02",
        "--payload",
        "0.03",
    ]
    assert run([*arm, *given, "--seed", "3", "--out", "first", "--json"]) == 1
    said = capsys.readouterr()
    told = json.loads(said.out)
    assert told["passed"] is False and told["faults"] == {
        "F07": {"runs": 2, "failed": 2}
    }
    words = shlex.split(told["failures"][1]["replay"])
    assert words[0] == "fraclink"
    assert run(words[1:]) == 1
    again = fl.load(tmp_path / "F07-3-30g-mid-3" / "faults.json", FaultTable)
    assert (
        again.outcomes
        == fl.load(tmp_path / "first" / "faults.json", FaultTable).outcomes[1:]
    )
    kept = fl.load(tmp_path / "F07-3-30g-mid-3" / "run.npz")
    assert kept.about["case"] == "F07-3-30g-mid-3"


@pytest.mark.parametrize(
    ("words", "field"),
    [
        (["--only", "F99"], "only"),
        (["--only", "F08", "--phase", "start"], "phase"),
        (["--severity", "0"], "severities[0]"),
        (["--design", "missing.json"], "missing.json"),
    ],
)
def test_bad_requests_exit_with_2(
    arm: list[str],
    words: list[str],
    field: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run([*arm, *words, "--out", str(tmp_path / "none")]) == 2
    assert field in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
