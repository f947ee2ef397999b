"""The design map on the twin, and the pages of campaigns: what is drawn, written and refused."""

from __future__ import annotations

import json
import math
import re

import pytest

import fraclink as fl
from campaigns import computed, small
from fraclink._campaign import load_sweep, save_sweep, summarise, sweep
from fraclink._cli import main
from fraclink._show.report.campaigns import write_sweep_report
from fraclink._simulate.twin import Twin, geared, run_twin
from fraclink.errors import FieldError, FileFormatError, SizeError

MASS = 0.00735


@pytest.fixture(scope="module")
def rig():
    return geared(fl.Rig.named("paper-2023"))


@pytest.fixture(scope="module")
def found(rig):
    return sweep(
        rig,
        gain_crossovers=[8.0, 12.0],
        phase_margins=[fl.deg(60)],
        payloads=[0.02, 0.03],
        link_mass=MASS,
    )


def test_a_cell_is_the_design_run_on_the_twin(rig, found):
    design = fl.design(rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(60))
    twin = Twin.from_rig(rig, payload=0.03, link_mass=MASS)
    run = run_twin(twin, design.controller.discretize(rig.period), fl.smooth_step(1.0, 0.6))
    cell = found.at(12.0, fl.deg(60), 0.03)
    assert (cell.gain_crossover, cell.phase_margin, cell.payload) == (12.0, fl.deg(60), 0.03)
    assert cell.settling_time == run.metrics.settling_time and cell.passed == run.verdict.passed


def test_infeasible_cells_name_their_condition(found):
    cell = found.at(8.0, fl.deg(60), 0.02)
    assert "heaviest payload" in cell.infeasible and not cell.passed and math.isnan(cell.settling_time)
    assert not found.at(12.0, fl.deg(60), 0.02).infeasible


def test_the_map_does_not_depend_on_the_workers(rig, found):
    seen = []
    again = sweep(
        rig,
        gain_crossovers=found.gain_crossovers,
        phase_margins=found.phase_margins,
        payloads=found.payloads,
        link_mass=MASS,
        workers=2,
        watch=lambda done, of: seen.append((done, of)),
    )
    assert repr(again) == repr(found) and seen[-1] == (2, 2)


def test_maps_read_back_equal(found, tmp_path):
    save_sweep(found, tmp_path / "map.json")
    assert repr(load_sweep(tmp_path / "map.json")) == repr(found)
    data = json.loads((tmp_path / "map.json").read_text())
    data["cells"].pop()
    (tmp_path / "map.json").write_text(json.dumps(data))
    with pytest.raises(FileFormatError):
        load_sweep(tmp_path / "map.json")


@pytest.mark.parametrize("values", [[], [0.0], [-1.0], [math.nan], [12.0, 12.0]])
def test_impossible_axes_are_refused(rig, values):
    with pytest.raises(FieldError, match="gain_crossovers"):
        sweep(rig, gain_crossovers=values, phase_margins=[0.9])


def test_too_many_cells_are_refused_before_the_work(rig):
    with pytest.raises(SizeError, match="cells"):
        sweep(
            rig,
            gain_crossovers=[1.0 + i for i in range(300)],
            phase_margins=[0.001 * i for i in range(1, 300)],
        )


def test_the_command_writes_map_and_page(tmp_path, capsys):
    out = tmp_path / "map.json"
    line = [
        "campaign",
        "sweep",
        "--gear",
        "50",
        "--link-mass",
        "0.00735",
        "--payload",
        "0.03",
        "--out",
        str(out),
    ]
    line += ["--gain-crossover", "12", "--phase-margin-deg", "50"]
    assert main(line) == 0
    assert "12 rad/s, 50°" in capsys.readouterr().out
    assert load_sweep(out).passed and out.with_suffix(".html").exists()
    assert main(line) == 2  # never over a file that is there
    capsys.readouterr()
    assert main([*line, "--force", "--json", "--gain-crossover", "18"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert [cell["passed"] for cell in told["cells"]] == [True, False]


def is_one_closed_page(text: str) -> None:
    assert "<script" not in text and "<image" not in text  # the page's own policy would not show an image
    assert not re.search(r'(src|href)="(?!#)', text)


def test_pages_are_closed_and_repeat_byte_for_byte(found, tmp_path):
    pages = [write_sweep_report(found, tmp_path / name).read_text() for name in ("a.html", "b.html")]
    assert pages[0] == pages[1] and "gain crossover right of the peak" in pages[0]
    is_one_closed_page(pages[0])


def test_a_campaigns_page_names_its_worst_runs(tmp_path, capsys):
    campaign = small(runs=300)
    folder, page = computed(campaign, tmp_path / "parts"), tmp_path / "page.html"
    line = ["campaign", "report", str(folder), "--out", str(page)]
    assert main(line) == 1
    assert "written" in capsys.readouterr().err
    text, summary = page.read_text(), summarise(campaign, folder)
    is_one_closed_page(text)
    assert summary.failure.sentence in text and text.count("<svg") == 3
    assert f"--run {summary.metrics[0].worst[0][0]}" in text
    assert main(line) == 2  # never over a file that is there
