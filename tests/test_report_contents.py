"""What a report is made of, before it is a page: its parts for each thing that a study
has.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink._arm.experiment import Experiment
from fraclink.errors import FieldError, MissingExtraError
from fraclink.findings import Finding
from fraclink.trials._faults import Case, Check, FaultTable, Outcome
from fraclink.view import _arm_page as arm_page
from fraclink.view import _loops as loops
from fraclink.view import _marks as marks
from fraclink.view import _pages as pages
from fraclink.view import _report as report
from fraclink.view._drawing import Figure, Panel
from fraclink.view._scales import Scale

RIG = fl.Rig.named("paper-2023")


@pytest.fixture(scope="module")
def design() -> fl.Design:
    return fl.design(
        RIG.model, RIG, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=0.0
    )


@pytest.fixture(autouse=True)
def few_payloads(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plot of margins with five points instead of 25: each is a search of the sampled
    loop.
    """
    monkeypatch.setattr(loops, "_STEPS", 5)


@pytest.fixture
def contents(monkeypatch: pytest.MonkeyPatch) -> Any:
    """What the template of a report gets, by name."""
    monkeypatch.setattr(
        report, "rendered", lambda template, **given: {"template": template, **given}
    )
    return lambda study, **given: report.render_report(study, **given)


def log() -> Experiment:
    time = 0.004 * np.arange(400)
    return Experiment(
        period=0.004, motor_angle=np.sin(time), output=np.cos(time), source="a/log.csv"
    )


def test_a_report_of_a_rig_and_a_log_has_their_parts_alone(contents: Any) -> None:
    found = [
        Finding("W101", "warning", "of the rig"),
        Finding("W210", "info", "of the log"),
    ]
    told = contents(fl.trials.Study(rig=RIG, experiment=log(), findings=tuple(found)))
    assert told["template"] == "report.html" and told["title"] == "paper-2023: log.csv"
    assert sorted(told["tables"]) == ["log", "rig"] and list(told["figures"]) == ["log"]
    assert (told["rig_findings"], told["log_findings"]) == ([found[0]], [found[1]])
    assert (
        told["said"][0] == "It carries 20 to 40 g on a link of 0.65 m."
        and "<style>" not in told["sketch"]
    )
    assert (
        told["arm"],
        told["faults"],
        told["tolerated"],
        told["power_on"],
        told["on_paper"],
    ) == (
        None,
        None,
        [],
        [],
        [],
    )
    assert told["files"] == [("rig.toml", "the rig")] and told["zone"] == "0 to 0 g"
    assert contents(fl.trials.Study(), title="mine")["title"] == "mine"
    nothing = contents(fl.trials.Study())
    assert nothing["title"] == "unnamed rig: unnamed log"
    assert (
        nothing["sketch"],
        nothing["said"],
        nothing["tables"],
        nothing["figures"],
    ) == ("", [], {}, {})


@pytest.mark.slow
def test_a_report_of_a_design_has_its_figures_and_what_to_do_next(
    contents: Any, design: fl.Design
) -> None:
    told = contents(fl.trials.Study(rig=RIG, design=design), script=False)
    assert list(told["figures"]) == ["bode", "nyquist", "margins", "budget"]
    assert sorted(told["tables"]) == ["controller", "margins", "requirements", "rig"]
    assert [row[0] for row in told["tables"]["margins"].rows] == [
        "8 g",
        "20 g",
        "30 g",
        "40 g",
    ]
    assert (told["arm"], told["pointer"], told["zone"]) == (None, None, "20 to 40 g")
    assert told["files"] == [
        ("rig.toml", "the rig"),
        ("design.json", "request, controller, requirements"),
    ]
    assert len(told["on_paper"]) == 1 and "fig-margins" not in told["on_paper"][0]
    assert (
        "data-x" not in told["on_paper"][0] and "aria-label" not in told["on_paper"][0]
    )
    assert len(told["power_on"]) == 6 and len(told["steps"]) == 4
    assert told["tolerated"][-1].endswith("times as stiff as the model")
    assert 'aria-label="Where the phase goes at 20 g: ' in told["figures"]["budget"]


@pytest.mark.slow
def test_a_report_of_moves_and_models_shows_them(
    contents: Any, design: fl.Design
) -> None:
    run = fl.simulate(
        design, fl.smooth_step(0.2, duration=0.5), payload=0.030, duration=1.0
    )
    told = contents(fl.trials.Study(rig=RIG, runs=(run,)))
    assert sorted(told["tables"]) == ["moves", "rig"] and list(told["figures"]) == [
        "moves"
    ]
    assert len(told["on_paper"]) == 1
    assert told["pointer"]["hash"] == report.page_hash(told["pointer"]["script"])


def test_a_refused_request_is_drawn_on_the_map_of_what_can_be_had(
    contents: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From half the slower crossover to 1.25 times the faster; margins to 100° or 1.1
    times the larger.
    """
    asked = {"gain_crossover": 9.0, "phase_margin": math.radians(95.0)}
    nearest = {"gain_crossover": 12.0, "phase_margin": math.radians(50.0)}
    grids: list[Any] = []

    def mapped(
        model: Any, rig: Any, *, gain_crossovers: Any, phase_margins: Any
    ) -> Any:
        grids.append((gain_crossovers, np.degrees(phase_margins)))
        noise = np.full((len(phase_margins), len(gain_crossovers)), 2.0)
        noise[-1] = np.nan
        return SimpleNamespace(
            gain_crossover=gain_crossovers,
            phase_margin=phase_margins,
            noise_gain=noise,
            feasible=np.isfinite(noise),
        )

    monkeypatch.setattr(report, "feasibility_map", mapped)
    refused = SimpleNamespace(asked=asked, nearest=nearest)
    told = contents(fl.trials.Study(rig=RIG, stopped="too slow", refused=refused))  # type: ignore[arg-type]
    assert list(told["figures"]) == ["map"] and told["refusal"].startswith(
        "Requested: a crossover of 9 rad/s"
    )
    rates, angles = grids[0]
    assert (rates[0], rates[-1], rates.size) == pytest.approx((4.5, 15.0, 48))
    assert (angles[0], angles[-1], angles.size) == pytest.approx((10.0, 104.5, 48))
    assert report._map(fl.trials.Study(refused=refused)) is None  # type: ignore[arg-type]
    half = SimpleNamespace(asked={"noise_gain": 2.0}, nearest=nearest)
    assert report._map(fl.trials.Study(rig=RIG, refused=half)) is None  # type: ignore[arg-type]
    refused.asked = {"gain_crossover": 9.0, "phase_margin": math.radians(50.0)}
    report._map(fl.trials.Study(rig=RIG, refused=refused))  # type: ignore[arg-type]
    assert grids[1][1][-1] == pytest.approx(100.0)


def test_a_map_shows_requests_levels_and_edges() -> None:
    noise = np.array([[1.0, 2.0, np.nan], [3.0, 4.0, 8.0]])
    found = SimpleNamespace(
        gain_crossover=np.array([10.0, 12.0, 14.0]),
        phase_margin=np.radians([40.0, 60.0]),
        noise_gain=noise,
        feasible=np.isfinite(noise),
    )
    drawn = loops.map_figure(
        found, (9.0, math.radians(20.0)), (20.0, math.radians(85.0))
    )  # type: ignore[arg-type]
    cells = drawn.panels[0].marks[0]
    assert isinstance(cells, marks.Cells)
    assert cells.across.tolist() == [
        9.0,
        11.0,
        13.0,
        15.0,
    ] and cells.up == pytest.approx([30.0, 50.0, 70.0])
    assert drawn.key == ("noise gain", "up to 2", "to 3", "to 4", "above 4")
    assert cells.levels.tolist() == [[0, 1, -1], [2, 3, 3]]
    assert (drawn.x.low, drawn.x.high) == pytest.approx((9.0, 21.0))
    assert (drawn.panels[0].y.low, drawn.panels[0].y.high) == pytest.approx(
        (15.0, 90.0)
    )
    top, bottom = drawn.panels[0].marks[1:3]
    assert top.y == pytest.approx([70, 70, 70, 70, 70, 70])  # type: ignore[union-attr]
    assert bottom.y == pytest.approx([30, 30, 30, 30, 50, 50])  # type: ignore[union-attr]
    times = [
        (m.text, m.value) for m in drawn.panels[0].marks if isinstance(m, marks.Upright)
    ]
    assert times == [
        ("0.3 s", pytest.approx(2 * math.pi / 0.3)),
        ("0.4 s", pytest.approx(2 * math.pi / 0.4)),
        ("0.5 s", pytest.approx(2 * math.pi / 0.5)),
        ("0.6 s", pytest.approx(2 * math.pi / 0.6)),
    ]
    points = [
        (m.x, m.y, m.text, m.sign)
        for m in drawn.panels[0].marks
        if isinstance(m, marks.Point)
    ]
    assert points == [
        (9.0, pytest.approx(20.0), "requested", "cross"),
        (20.0, pytest.approx(85.0), "nearest: 20 rad/s, 85.0°", "ring"),
    ]
    plain = loops.map_figure(found)  # type: ignore[arg-type]
    assert (plain.x.low, plain.x.high) == pytest.approx((9.0, 15.0))
    nothing = SimpleNamespace(
        **vars(found) | {"noise_gain": np.full((2, 3), np.nan), "feasible": noise < 0}
    )
    assert loops.map_figure(nothing).key[1:] == ("up to 1", "to 2", "to 3", "above 3")  # type: ignore[arg-type]


@pytest.mark.slow
def test_margins_over_the_payload_have_a_band_and_the_request(
    design: fl.Design,
) -> None:
    drawn = loops.margins_figure(design)
    margin, crossover = drawn.panels
    zone, _, band, *curves, wanted = margin.marks
    assert (zone.low, zone.high) == (20.0, 40.0)  # type: ignore[union-attr]
    assert [curve.name for curve in curves] == [
        "on paper",
        "with motor loop",
        "as it runs",
    ]  # type: ignore[union-attr]
    assert [curve.line for curve in curves] == [4, 3, 1]  # type: ignore[union-attr]
    assert (wanted.value, wanted.text) == (pytest.approx(50.0), "requested")  # type: ignore[union-attr]
    mass, angle = np.asarray(curves[2].x), np.asarray(curves[2].y)  # type: ignore[union-attr]
    assert (mass[0], mass[-1], mass.size) == (
        pytest.approx(8.0),
        pytest.approx(46.0),
        5,
    )
    at = math.degrees(design.sampled_at(1e-3 * float(mass[2])).phase_margin)
    assert angle[2] == pytest.approx(at)
    assert np.all(np.asarray(band.low) <= angle + 0.5) and np.all(
        np.asarray(band.high) >= angle - 0.5
    )  # type: ignore[union-attr]
    rate = crossover.marks[1]
    assert rate.y[2] == pytest.approx(
        design.sampled_at(1e-3 * float(mass[2])).gain_crossover
    )  # type: ignore[union-attr, index]
    assert crossover.marks[2].value == 12.0  # type: ignore[union-attr]
    bare = replace(design, findings=(Finding("W410", "error", "no law"),))
    names = [
        m.name
        for m in loops.margins_figure(bare).panels[0].marks
        if isinstance(m, marks.Curve)
    ]
    assert names == ["on paper", "with motor loop", "with delay"]
    curve = SimpleNamespace(
        kind="motor",
        payload=np.array([0.01, 0.05]),
        phase_margin=np.radians([30.0, 60.0]),
    )
    drawn = loops.margin_curves_figure([curve], (0.02, 0.04), math.radians(45.0))  # type: ignore[list-item]
    zone, zero, line, wanted = drawn.panels[0].marks
    assert (zone.low, zone.high, zero.value) == (20.0, 40.0, 0.0)  # type: ignore[union-attr]
    assert (line.x.tolist(), line.y.tolist()) == (
        [10.0, 50.0],
        pytest.approx([30.0, 60.0]),
    )  # type: ignore[union-attr]
    assert (line.name, line.line, wanted.value) == (
        "with motor loop",
        3,
        pytest.approx(45.0),
    )  # type: ignore[union-attr]
    assert (drawn.x.low, drawn.x.high) == (10.0, 50.0)


def test_a_campaigns_report_has_the_worst_two_runs_of_each_metric(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    def metric(name: str) -> Any:
        return SimpleNamespace(
            name=name,
            quantiles=(SimpleNamespace(probability=0.5, value=0.6),),
            drivers=(("payload", 0.5), ("gain", 0.1)),
            worst=((7, math.inf), (3, 1.5), (9, 1.0)),
        )

    summary: Any = SimpleNamespace(
        metrics=(metric("settling_time"), metric("saturated")),
        failure="f",
        given="g",
        left_out="l",
        passed=False,
    )
    told: dict[str, Any] = {}
    asked: list[Any] = []

    def columns(campaign: Any, folder: Any, *names: str) -> list[Any]:
        asked.append(names)
        rng = np.random.default_rng(0)
        return [
            rng.uniform(0.5, 1.5, 200),
            rng.uniform(0, 1, 200),
            np.arange(200) > 20,
        ] + [np.linspace(0, 1, 200) for _ in names[3:]]

    monkeypatch.setattr(report, "columns", columns)
    monkeypatch.setattr(
        report, "rendered", lambda template, **given: told.update(given) or "page"
    )
    campaign: Any = SimpleNamespace(rig=RIG)
    assert (
        report.write_campaign_report(campaign, "arms", summary, tmp_path / "c.html")
        == tmp_path / "c.html"
    )
    assert (tmp_path / "c.html").read_text("utf-8") == "page"
    assert asked[0][:4] == ("payload", "gain", "passed", "settling_time")
    assert told["tables"]["worst"].rows == (
        ("settling time [s]", "never", "fraclink campaign replay arms --run 7"),
        ("settling time [s]", "1.5", "fraclink campaign replay arms --run 3"),
    )
    assert (told["title"], told["state"], told["parameters"]) == (
        "Campaign on paper-2023",
        "failed",
        ("gain", "payload"),
    )
    assert len(told["spread"]) == 6 and "settling time" in told["spread"][0]
    assert (
        "Share of failing runs" in told["figures"]["failures"]
        and ">gain<" in told["figures"]["failures"]
    )


def test_faults_of_a_report_are_their_map_and_the_command_that_made_them() -> None:
    check = Check("peak over clean", 1.3, 1.1, passed=False)
    outcome = Outcome(
        Case("F11", 2, 0.03, "start", 1), (check,), 0.1, 0.1, 0.0, "run", "none", 0
    )
    told = report._faults(
        fl.trials.Study(faults=FaultTable((outcome,), {"command": "made so"}))
    )
    assert told is not None
    assert (told["command"], told["columns"]) == ("made so", ("severity 2, 30 g",))
    assert (
        told["sentence"] == "0 of 1 faults meet their requirement in every run, 1 runs"
    )
    assert report._faults(fl.trials.Study()) is None
    unnamed = report._faults(fl.trials.Study(faults=FaultTable((outcome,), {})))
    assert unnamed is not None and unnamed["command"] == ""


# --- pages ------------------------------------------------------------------------------------------------


def test_a_page_names_what_it_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    import jinja2

    with pytest.raises(jinja2.UndefinedError, match="is undefined"):
        pages.rendered("campaign.html")
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(MissingExtraError, match="jinja2"):
        pages.rendered("report.html")


def test_scripts_and_styles_lose_their_comments_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept = (
        "  a {\n\n    b: c; /* kept */\n  }\n/* one\n   two */\n// gone\n  x // stays\n"
    )
    monkeypatch.setattr(pages, "template_text", lambda name: kept)
    assert pages.squeezed("x.css") == "a {\nb: c; /* kept */\n}\nx // stays\n"


@pytest.mark.parametrize(
    ("script", "wanted"),
    [
        ("a + +b; c - -d; e++ + f;", "a+ +b;c- -d;e++ +f;"),
        ("let a = 1;\nlet b = 2;", "let a=1;let b=2;"),
        ("x = a\n[1]", "x=a\n[1]"),
        ("if (a) { b(); }\nc();", "if(a){b()}c();"),
        (
            "const $a = 'it\\'s  so', b_1 = /[/]  x/g;",
            "const $a='it\\'s  so',b_1=/[/]  x/g;",
        ),
        ("f(a => a,)", "f(a=>a)"),
        ("g = (a, b) => a;", "g=(a,b)=>a;"),
        ("h((a) => a);", "h(a=>a);"),
        ("return (a) => a;", "return(a)=>a;"),
        ("in_ (a) => 1", "in_(a)=>1"),
        ("[a, b,]", "[a,b]"),
        ("{ a: 1, }", "{a:1,}"),
        ("a /* x */ b", "a b"),
        ("a /* x\n */ b", "a\nb"),
        ("a // x\nb", "a\nb"),
        ("x\n.y()", "x.y()"),
        ("return\nx", "return\nx"),
        ("`a  ${ {b: 1}.b }  c`", "`a  ${ {b: 1}.b }  c`"),
    ],
)
def test_a_script_is_tightened_to_the_same_meaning(script: str, wanted: str) -> None:
    assert pages.tightened(script) == wanted + "\n"


# --- the page of the arm ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_page_of_the_arm_says_what_it_simulates(design: fl.Design) -> None:
    mode = fl.SecondMode(frequency=90.0, gain=0.05, damping_ratio=0.02)
    model = replace(design.model, gauge_delay=0.0025, second_mode=mode)
    told = replace(design, model=model)
    assert arm_page._simulated(told) == [
        "the model of the link: λ = 1.92, ω₀ = 11.09 at 30 g, stiffness 1.56 N·m/rad, and a second mode at "
        "90 rad/s in the gauge",
        "a motor with inertia, viscous and Coulomb friction, driven by the law's own motor loop",
        "an encoder with 100000 counts per revolution",
        f"a gauge with noise, offset and a range of ±{RIG.gauge.limit:g} N·m, 2.5 ms late",
        "the shipped law (law.c) with its guards, run every 4 ms",
    ]
    smooth = replace(
        design,
        rig=replace(RIG, encoder=replace(RIG.encoder, counts_per_revolution=None)),
    )
    plain = arm_page._simulated(smooth)
    assert (
        plain[0].endswith("at 30 g, stiffness 1.56 N·m/rad")
        and plain[2] == "an encoder without steps"
    )
    assert plain[3].endswith("N·m")
    assert arm_page._not_simulated(told)[0] == (
        "the mass of the link, and so higher modes in the motion of the tip"
    )
    assert arm_page._not_simulated(design)[0].startswith(
        "the mass of the link, and so the second and all"
    )
    assert len(arm_page._not_simulated(design)) == 4
    twin = arm_page._twin_simulated(design, twin_fits=True)
    assert (
        twin[0].endswith("its second mode moves tip and gauge")
        and ", assumed because" in twin[0]
    )
    heavy = replace(design, rig=replace(RIG, link=replace(RIG.link, mass=0.00735)))
    assert arm_page._twin_simulated(heavy, twin_fits=True)[0].startswith(
        "a link with a mass of 7.35 g: its"
    )
    assert arm_page._twin_simulated(design, twin_fits=False) == [
        "there is no twin in this page: at this sampling period it does not fit into it"
    ]


@pytest.mark.slow
def test_a_page_that_is_too_large_has_fewer_payloads_and_then_no_twin(
    design: fl.Design, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A link takes some 4 kB: one payload less, and one more for every 4000 bytes
    beyond the limit.
    """
    tried: list[tuple[int, bool]] = []
    sizes = [190_000, 150_001, 160_000, 155_000, 150_000]

    def box(study: Any, design: Any, *, payloads: int, twin: bool) -> Any:
        tried.append((payloads, twin))
        return SimpleNamespace(style="", has_twin=twin)

    monkeypatch.setattr(arm_page, "arm_box", box)
    monkeypatch.setattr(
        arm_page, "rendered", lambda name, **given: "x" * sizes[len(tried) - 1]
    )
    page = arm_page.render_arm_page(fl.trials.Study(rig=RIG, design=design))
    assert len(page) == 150_000
    assert tried == [(24, True), (13, True), (12, True), (9, True), (24, False)]
    monkeypatch.setattr(arm_page, "arm_box", lambda *a, **k: None)
    with pytest.raises(FieldError, match=r"rig\.period"):
        arm_page.render_arm_page(fl.trials.Study(rig=RIG, design=design))
    with pytest.raises(FieldError, match="there is no controller"):
        arm_page.render_arm_page(fl.trials.Study(rig=RIG))


def test_a_figure_of_its_own_is_inlined_without_its_style() -> None:
    panel = Panel("", Scale(0.0, 1.0), [marks.Curve([0, 1], [0, 1])])
    text = Figure("one", "what", Scale(0.0, 1.0), (panel,)).alone()
    inner = report._inline(text)
    assert (
        "<style>" not in inner
        and "ground" not in inner
        and inner.startswith("<svg")
        and "c1 d1" in inner
    )
