"""One request, one table: Python, the command line, the studio, the report and a folder
that was kept say the same of a design, row by row, and refuse it for the same row.
"""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import main
from fraclink.errors import FraclinkError, InfeasibleError
from fraclink.studio._session import opened
from fraclink.trials import load_study
from test_studio import connected, talked
from tuned_arms import LIMITS, PERIOD, RIG, arm

REQUESTS = 20
# Every so many are kept and reported: a report draws eight figures, which takes a second.
KEPT = 17


@dataclass(frozen=True)
class Request:
    """A rig, and what is asked for by the names of the command line."""

    rig: fl.Rig
    options: dict[str, Any]

    @property
    def in_python(self) -> dict[str, Any]:
        """The keywords of `fraclink.design`."""
        options = dict(self.options)
        if "phase_margin_deg" in options:
            options["phase_margin"] = fl.deg(options.pop("phase_margin_deg"))
        return options

    def words(self) -> list[str]:
        """The words of the command line."""
        words = []
        for name, value in self.options.items():
            words.append(f"--{name.replace('_', '-')}")
            values = value if isinstance(value, tuple) else (value,)
            words += [str(each) for each in values if each is not True]
        return words


def drawn(seed: int) -> Request:
    """Return the request of a seed; one is over the box of its rig, and one states
    nothing, of a rig that states nothing either, which is over the box too.
    """
    draw = np.random.default_rng(seed)
    name = str(draw.choice(["paper-2023", "paper-2023-geared"], p=[0.8, 0.2]))
    rig = fl.Rig.named(name)
    light = float(draw.uniform(0.015, 0.025))
    payloads = (light, light * float(draw.uniform(1.2, 2.2)))
    if seed == 9:
        return Request(replace(rig, design=None), {"payloads": payloads})
    options: dict[str, Any] = {
        "gain_crossover": float(draw.uniform(8.0, 14.0)),
        "phase_margin_deg": float(draw.uniform(30.0, 55.0)),
    }
    optional = {
        "payloads": payloads,
        "max_sensitivity": float(draw.uniform(1.6, 2.5)),
        "noise_gain": float(draw.uniform(0.4, 2.0)),
        "mode_gain": float(draw.uniform(0.1, 0.5)),
        "filter_time": float(draw.choice([0.0, 0.02])),
        "filter_order": 2,
    }
    options |= {key: value for key, value in optional.items() if draw.random() < 0.25}
    if seed == 4:
        options["box"] = True
    return Request(rig, options)


@dataclass(frozen=True)
class Page:
    """The studio as a page sees it."""

    talk: Any
    folder: Path

    def answer(self, number: int, verb: str, **given: Any) -> dict[str, Any]:
        return talked(self.talk, seq=number, verb=verb, **given)[0]


@pytest.fixture
def page(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Page]:
    """A studio opened with the rig of a request."""
    folder = tmp_path / "kept"
    session = opened(
        None, rig=drawn(request.node.callspec.params["seed"]).rig, out=folder
    )
    with connected(session) as talk:
        yield Page(talk, folder)


COLUMNS = ("requirement", "required", "achieved", "verdict")


def texts(design: fl.Design) -> list[list[str]]:
    """The table of a design as people read it."""
    marks = {"passed": "✓ passed", "failed": "✗ failed"}
    cells = [
        [row.text for row in requirement.rows if row.label in COLUMNS]
        for requirement in design.requirements
    ]
    return [[*words, marks[verdict]] for *words, verdict in cells]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(REQUESTS))
def test_a_request_has_one_table(
    seed: int, page: Page, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    request = drawn(seed)
    rig_file, design_file = tmp_path / "rig.toml", tmp_path / "design.json"
    request.rig.save(rig_file)
    files = ("--rig", str(rig_file), "--out", str(design_file), "--json")
    code = main(["design", *files, *request.words()])
    printed = json.loads(capsys.readouterr().out)
    shown = page.answer(1, "exact", state=request.options)
    try:
        design = fl.design(request.rig.model, request.rig, **request.in_python)
    except FraclinkError as error:
        names = ("condition", "nearest", "field", "allowed", "remedy")
        parts = {name: getattr(error, name) for name in names if hasattr(error, name)}
        assert code == (1 if isinstance(error, InfeasibleError) else 2)
        assert not design_file.exists()
        assert printed["error"] == {**printed["error"], **parts}
        offer = dict(parts.get("nearest", {}))
        if "phase_margin" in offer:  # the page asks for it in degrees
            degrees = math.degrees(offer.pop("phase_margin"))
            parts["nearest"] = offer | {"phase_margin_deg": pytest.approx(degrees)}
        assert shown == {**shown, **parts, "ok": False, "error": str(error)}
        return

    rows = [
        {**asdict(row), "slack": row.slack, "passed": row.passed}
        for row in design.requirements
    ]
    for row in rows:
        del row["bound"]
    assert (code, printed["passed"]) == (0 if design.passed else 1, design.passed)
    assert printed["requirements"] == rows
    assert fl.Design.load(design_file) == design

    assert shown["design"]["passed"] == design.passed
    assert shown["design"]["requirements"]["lines"] == texts(design)
    promise = next(line for line in shown["verdict"] if line[0] == "promise")
    assert promise[-1].endswith(design.overview().state)

    if seed % KEPT == 0:
        assert page.answer(2, "keep")["ok"]
        kept = load_study(page.folder)
        assert kept.design == design and kept.law == design.law()
        report = tmp_path / "report.html"
        main(["report", str(page.folder), "--out", str(report)])
        assert table_of(report.read_text("utf-8")) == texts(design)


@pytest.mark.slow
def test_what_tuning_leaves_has_the_table_of_its_request(tmp_path: Path) -> None:
    """The request of the rig, over the box of what was measured."""
    crossover, margin_deg = 10.8, 48.0
    folder = tmp_path / "tuned"
    assert RIG.design is not None
    wanted = replace(RIG.design, gain_crossover=crossover, phase_margin_deg=margin_deg)
    rig = replace(RIG, design=wanted)
    plan = fl.TuningPlan(LIMITS, 0.030, (0.020, 0.040), PERIOD, rig)
    tuning = fl.tune(arm(seed=1).callback, plan, out=folder, clock="none")
    design = load_study(folder).design
    assert tuning.has_law and design is not None
    assert design.passed and fl.Design.load(folder / "design.json") == design

    again = fl.design(
        design.model,
        design.rig,
        payloads=plan.payloads,
        box=design.box,
        gain_crossover=crossover,
        phase_margin=fl.deg(margin_deg),
    )
    assert texts(again) == texts(design)

    with connected(opened(folder)) as talk:
        shown, *_ = talked(talk, seq=1, verb="hello")
    assert shown["design"]["passed"]
    assert shown["design"]["requirements"]["lines"] == texts(design)
    report = tmp_path / "report.html"
    assert main(["report", str(folder), "--out", str(report)]) == 0
    assert table_of(report.read_text("utf-8")) == texts(design)


def table_of(report: str) -> list[list[str]]:
    """The lines of the table of requirements in a report."""
    for table in re.findall(r"<table.*?</table>", report, re.S):
        cells = [
            [html.unescape(re.sub("<.*?>", "", cell)).strip() for cell in line]
            for line in (
                re.findall(r"<t[hd].*?</t[hd]>", row, re.S)
                for row in re.findall(r"<tr.*?</tr>", table, re.S)
            )
        ]
        if "required" in cells[0]:
            places = [cells[0].index(name) for name in COLUMNS]
            return [[line[k] for k in places] for line in cells[1:]]
    raise AssertionError("no table of requirements")
