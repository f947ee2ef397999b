"""`fraclink assess`: the assessment of a finished design."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

import fraclink as fl
from fraclink import main
from fraclink.extend import mode_gains
from law_bench import documented_design


def _design(place: Path) -> fl.Design:
    rig = fl.Rig.named("paper-2023")
    design = documented_design(rig)
    design.save(place)
    return design


@pytest.mark.slow
def test_assess_tells_budget_margins_and_spillover(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    design = _design(tmp_path / "design.json")
    link = replace(design.rig.link, mass=0.00735)
    replace(design, rig=replace(design.rig, link=link)).save(tmp_path / "design.json")
    code = main(["assess", str(tmp_path / "design.json"), "--json"])
    found = json.loads(capsys.readouterr().out)
    assert math.pi + sum(found["phase_budget"].values()) == pytest.approx(
        design.at(0.020).phase_margin
    )
    assert found["phase_margin"]["sampled"][-1] == pytest.approx(
        design.sampled_at(0.020).phase_margin
    )
    assert [item["name"] for item in found["spillover"]] == [
        "loop gain at mode 2",
        "loop gain at mode 3",
    ]
    assert code == (0 if all(item["passed"] for item in found["spillover"]) else 1)


@pytest.mark.slow
def test_a_massless_link_has_no_spillover(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    design = _design(tmp_path / "design.json")
    assert main(["assess", str(tmp_path / "design.json")]) == 0
    assert "higher modes: none, as the link has no mass" in " ".join(
        capsys.readouterr().out.split()
    )
    assert mode_gains(design, damping_ratio=0.02) == ()
