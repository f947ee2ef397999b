"""certify, twin, compare, export and inspect, as a user calls them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from fraclink._arm.rig import Rig
from fraclink._certify import Certificate
from fraclink._cli import main
from fraclink._design import Design
from fraclink._design.completed import design_for
from fraclink._reading.reading import bundled_log
from reproduce import designs

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def fraclink(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Command:
    """Run the command line in a folder that holds design.json."""
    monkeypatch.chdir(tmp_path)
    design, _ = design_for(Rig.named("paper-2023"), filter_time=0.0)
    design.save("design.json")

    def run(line: str) -> tuple[int, str, str]:
        code = main(line.split())
        streams = capsys.readouterr()
        return code, streams.out, streams.err

    return run


@pytest.mark.slow
def test_the_default_design_is_certified(fraclink: Command) -> None:
    code, out, err = fraclink("certify design.json --out certificate.json")
    assert code == 0
    assert "every payload from 0.02 to 0.04 kg and every computation delay" in " ".join(
        out.split()
    )
    assert (
        err
        == "written: certificate.json\nnext: fraclink export c design.json --out firmware\n"
    )
    assert Certificate.load("certificate.json").passed


@pytest.mark.slow
def test_the_printed_controller_is_refused_with_its_poles(
    fraclink: Command, tmp_path: Path
) -> None:
    design = Design.load("design.json")
    from dataclasses import replace

    replace(design, controller=designs.printed().fractional).save("printed.json")
    code, out, _ = fraclink("certify printed.json --out certificate.json")
    assert code == 1
    assert "unstable" in out
    assert " g" in out
    assert not (tmp_path / "certificate.json").exists()
    told = json.loads(fraclink("certify printed.json --out certificate.json --json")[1])
    assert told["passed"] is False
    assert 0.020 <= told["payload"] <= 0.040


@pytest.mark.slow
def test_the_law_leaves_as_c(fraclink: Command, tmp_path: Path) -> None:
    code, out, _ = fraclink("export c design.json --out firmware --precision single")
    assert code == 0
    assert [Path(line).name for line in out.split()] == [
        "law.h",
        "law.c",
        "law_data.h",
        "law_selftest.c",
        "README.md",
        "law.json",
    ]
    code, _, err = fraclink("export c design.json --out firmware")
    assert (code, err.count("\n")) == (2, 1)
    assert "firmware" in err
    code, _, err = fraclink("export c design.json --out other --name 2nd")
    assert code == 2
    assert "2nd" in err
    assert not (tmp_path / "other").exists()


@pytest.mark.slow
def test_the_twin_runs_the_design(fraclink: Command) -> None:
    code, out, err = fraclink("twin design.json --gear 50 --link-mass 0.00735")
    assert code == 0, err
    assert out.startswith("✓ passed: ")
    told = json.loads(
        fraclink("twin design.json --gear 50 --link-mass 0.00735 --json")[1]
    )
    assert told["passed"] is True
    code, _, err = fraclink("twin design.json --link-mass -1")
    assert code == 2
    assert "-1" in err


@pytest.mark.slow
def test_rivals_run_on_equal_terms(fraclink: Command, tmp_path: Path) -> None:
    code, _, err = fraclink("compare --rig paper-2023 --only ZV --out comparison")
    assert code == 0
    assert err.splitlines()[-1] == "written: comparison/comparison.md"
    text = (tmp_path / "comparison" / "comparison.md").read_text("utf-8")
    assert "| fraclink |" in text
    assert "ZV" in text
    assert fraclink("compare --rig paper-2023 --out comparison")[0] == 2


def test_a_log_is_inspected_without_a_rig(fraclink: Command) -> None:
    path = bundled_log("prbs_30g")
    code, out, _ = fraclink(f"inspect {path}")
    assert code == 0
    assert 'motor_angle = { column = "motor_angle_rad", unit = "rad" }' in out
    told = json.loads(fraclink(f"inspect {path} --json")[1])
    assert [channel["name"] for channel in told["channels"]] == [
        "time_s",
        "motor_angle_rad",
        "torque_Nm",
    ]


@pytest.mark.slow
def test_a_log_is_diagnosed(fraclink: Command) -> None:
    code, out, _ = fraclink("diagnose demo --rig paper-2023")
    assert code == 0
    assert "W230 info: the log says that it was simulated" in out
    found = json.loads(fraclink("diagnose demo --rig paper-2023 --json")[1])["findings"]
    assert "W230" in {finding["code"] for finding in found}
