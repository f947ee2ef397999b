"""The report: self-contained, identical every time, and safe against hostile file
names.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import math
import re
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from browser import browser, command_line
from fraclink import (
    Design,
    Experiment,
    Rig,
    bundled_log,
    compare_structures,
    design,
    read_log,
)
from fraclink.extend import number
from fraclink.findings import Finding, Scope, Verdict
from fraclink.trials import (
    CATALOGUE,
    Case,
    Check,
    FaultTable,
    Outcome,
    Study,
    load_study,
    save_study,
)
from fraclink.view import write_report

HOSTILE = [
    "<img src=x onerror=alert(1)>",
    "<script>alert(1)</script>",
    "</title><script>alert(1)</script>",
    "</style><b>x</b>",
    "</svg><script>alert(1)</script>",
    '"><svg onload=alert(1)>',
    "'><iframe src=//evil.example>",
    "<a href=javascript:alert(1)>x</a>",
    "&lt;script&gt;alert(1)&lt;/script&gt;",
    "&#60;script&#62;",
    "<!-- ",
    "-->",
    "]]><script>x</script>",
    "<![CDATA[<script>x</script>]]>",
    "{{ 7 * 7 }}",
    "{% include 'report.css' %}",
    "${alert(1)}",
    "$\\mathrm{x}$ and $$",
    "<math><mi>x</mi></math>",
    "<base href=//evil.example>",
    "<meta http-equiv=refresh content=0>",
    "<link rel=stylesheet href=//evil.example>",
    "<object data=x>",
    "<form action=//evil.example><input>",
    "<style>*{display:none}</style>",
    "<table><tr><td>",
    "\u202eright to left <b>",
    "<IMG SRC=`x`>",
    "<x onclick=alert(1)>x",
    "<details open ontoggle=alert(1)>",
    "%3Cscript%3E<u>",
]
# What one of them does to a page it does beside others: ten pages have three or four,
# as many as a name of 100 characters holds.
HOSTILE_PAGES = [" ".join(HOSTILE[start::10]) for start in range(10)]
RIG = Rig.named("paper-2023")


def designed() -> Design:
    """Return the design that the tests report."""
    return design(RIG.model, RIG, gain_crossover=12.0, phase_margin=math.radians(50))


def rendered(study: Study, **options: Any) -> str:
    """Return the text of a study's report."""
    with tempfile.TemporaryDirectory() as folder:
        place = write_report(study, Path(folder) / "report.html", **options)
        return place.read_text("utf-8")


class Elements(HTMLParser):
    """Counts start tags with the names of their attributes, and stores their
    references.
    """

    def __init__(self) -> None:
        super().__init__()
        self.found: Counter[tuple[str, tuple[str, ...]]] = Counter()
        self.references: list[str] = []
        self.texts: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found[tag, tuple(sorted(name for name, _ in attrs))] += 1
        names = {"src", "href", "xlink:href", "data", "action", "srcset", "poster"}
        self.references += [value or "" for name, value in attrs if name in names]

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def parsed(text: str) -> Elements:
    """The elements of a page."""
    elements = Elements()
    elements.feed(text)
    elements.close()
    return elements


def study(text: str, *, design: bool = False) -> Study:
    """A study in which every text from outside is `text`."""
    time = np.arange(400) * 0.004
    log = Experiment(
        period=0.004,
        motor_angle=np.sin(time),
        output=np.cos(time),
        source=f"{text}.csv",
        notes=(("title", text), ("source", text)),
    )
    finding = Finding("W205", "warning", text, {}, text)
    made = designed() if design else None
    return Study(
        rig=replace(RIG, name=text, source=text, assumptions=(text,)),
        experiment=log,
        findings=(finding, replace(finding, code="W101")),
        design=made,
        missing={"design": text},
        assumptions=(text,),
        faults=faults(text),
    )


def faults(text: str) -> FaultTable:
    """A campaign with a fault that passes and one that does not."""
    checks = (Check("peak", 1.0, 1.1, passed=True), Check(text, 1.3, 1.1, passed=False))
    cases = (Case("F09", 1, 0.02, "mid", 1), Case("F11", 2, 0.03, "start", 1))
    outcomes = tuple(
        Outcome(case, checks[:count], 0.1, 0.1, 0.0, "run", "none", 0, text)
        for count, case in enumerate(cases, start=1)
    )
    return FaultTable(outcomes, {"command": text})


@pytest.fixture(scope="module")
def plain() -> Elements:
    return parsed(rendered(study("plain")))


@pytest.mark.slow
@pytest.mark.parametrize("text", HOSTILE_PAGES)
def test_no_text_from_outside_becomes_an_element(text: str, plain: Elements) -> None:
    page = parsed(rendered(study(text)))
    assert page.found == plain.found
    assert page.references == plain.references


@pytest.mark.slow
def test_the_page_asks_nobody_for_anything() -> None:
    text = rendered(study("plain", design=True))
    assert all(reference.startswith("#") for reference in parsed(text).references)
    assert "url(" not in re.sub(r"url\(#[\w-]+\)", "", text)
    assert "@import" not in text
    assert "default-src 'none'" in text
    allowed = re.findall(r"script-src ([^;]*);", text)
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    digests = (
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        for script in scripts
    )
    hashes = " ".join(f"'sha256-{digest}'" for digest in digests)
    assert [html.unescape(sources) for sources in allowed] == [
        f"{hashes} 'wasm-unsafe-eval'"
    ]
    assert "self-contained: no request to any host." in text
    # values at the pointer, and the arm with the numbers that it reads
    assert len(scripts) == 2
    assert text.count("<script") == 3
    assert len(scripts[0].encode()) <= 10_000
    assert len(text.encode()) < 700_000


@pytest.mark.slow
def test_a_report_without_script_holds_none() -> None:
    text = rendered(study("plain", design=True), script=False)
    assert "self-contained: no script, no request to any host." in text
    assert "<script" not in text and "script-src" not in text and "armbox" not in text
    page = rendered(study("plain"))
    assert page.count("<script") == 1 and "wasm-unsafe-eval" not in page


@pytest.mark.slow
@pytest.mark.parametrize(
    "period, payload", [(1e-4, 0.03), (0.004, None)], ids=["short run", "no payload"]
)
def test_a_design_with_a_fast_clock_or_without_a_payload_is_reported(
    period: float, payload: float | None
) -> None:
    rig = replace(RIG, period=period)
    made = design(
        replace(rig.model, payload=payload),
        rig,
        gain_crossover=12.0,
        phase_margin=math.radians(50),
    )
    assert 'id="moving"' in rendered(Study(rig=rig, design=made))


@pytest.mark.slow
def test_a_report_leaves_the_arm_out_that_no_payload_lets_move() -> None:
    made = design(RIG.model, RIG, gain_crossover=12.0, phase_margin=math.radians(50))
    fast = replace(made, model=replace(made.model, natural_frequency=1e3))
    text = rendered(Study(rig=RIG, design=fast, law=made.law()))
    assert (
        'id="moving"' not in text
        and "wasm-unsafe-eval" not in text
        and 'id="design"' in text
    )


@pytest.mark.slow
def test_the_same_study_gives_the_same_bytes_in_another_process(tmp_path: Path) -> None:
    code = (
        "import math, sys; import fraclink as fl\n"
        "rig = fl.Rig.named('paper-2023')\n"
        "made = fl.design(rig.model, rig, gain_crossover=12.0, phase_margin=math.radians(50))\n"
        "study = fl.trials.Study(rig=rig, design=made)\n"
        "fl.view.write_report(study, sys.argv[1])"
    )
    # the hashes of strings in this process begin with another number
    environment = {"PYTHONHASHSEED": "1", "PATH": "", "MPLCONFIGDIR": str(tmp_path)}
    subprocess.run(  # noqa: S603
        [sys.executable, "-c", code, str(tmp_path / "other.html")],
        check=True,
        env=environment,
    )
    here = write_report(Study(rig=RIG, design=designed()), tmp_path / "here.html")
    assert (tmp_path / "other.html").read_bytes() == here.read_bytes()


def test_an_infeasible_design_is_told() -> None:
    assert "because of the moon" in rendered(
        Study(rig=RIG, missing={"design": "because of the moon"})
    )


@pytest.mark.slow
def test_faults_have_a_section_and_a_verdict_of_their_own(tmp_path: Path) -> None:
    made = designed()
    (title,) = (fault.title for fault in CATALOGUE if fault.number == "F11")
    table = faults("peak over clean")
    saved = Study(rig=RIG, design=made, faults=table)
    save_study(saved, tmp_path)
    back = load_study(tmp_path)
    assert back.faults == saved.faults
    assert back.verdict.twin == Scope(
        "failed", ("1 of 2 faults miss their requirement",)
    )
    assert back.verdict.promise == replace(saved, faults=None).verdict.promise
    texts = " ".join(parsed(rendered(back)).texts)
    assert "1 of 2 faults meet their requirement in every run, 2 runs" in texts
    assert (
        "peak over clean: 1.3 (limit 1.1) (F11-2-30g-start-1: peak over clean)" in texts
    )
    assert f"F11 {title}" in texts
    alone = replace(table, about={})  # run in Python, by no command
    bare = replace(back, design=None)
    assert 'id="faults"' in rendered(replace(bare, faults=alone))
    assert 'id="faults"' not in rendered(replace(bare, faults=None))


@pytest.mark.parametrize(
    ("states", "whole"),
    [
        (("passed", "passed", "passed"), "passed"),
        (("passed", "passed", "not run"), "not run"),
        (("not shown", "passed", "not run"), "not shown"),
        (("passed", "failed", "not shown"), "failed"),
        (("passed", "passed", "failed"), "failed"),
    ],
)
def test_the_headline_is_never_better_than_its_worst_part(
    states: tuple[str, ...], whole: str
) -> None:
    verdict = Verdict(*(Scope(state) for state in states))
    assert verdict.state == whole
    assert verdict.passed == (whole == "passed")


@pytest.mark.slow
def test_an_error_of_log_or_model_leaves_nothing_shown() -> None:
    wrong = Finding("W399", "error", "the model predicts nothing", {}, "record again")
    made = designed()
    verdict = Study(rig=RIG, design=made, findings=(wrong,)).verdict
    states = [scope.state for scope in verdict.scopes.values()]
    assert states == ["not shown", "not shown", "not shown", "not run"]
    page = rendered(Study(rig=RIG, design=made, findings=(wrong,)))
    assert '<div class="verdict not-shown">' in page


@pytest.mark.slow
def test_the_design_shows_every_requirement_with_its_payload() -> None:
    made = designed()
    texts = " ".join(parsed(rendered(Study(rig=RIG, design=made))).texts)
    for requirement in made.requirements:
        assert requirement.name in texts
    assert number(made.controller.derivative_gain, 5) in texts
    # the sampled margin at 20 g is next to the requested one
    assert "48.8°" in texts or "50.0°" in texts


@pytest.mark.slow
def test_the_margin_of_every_arm_stands_below_that_of_the_model() -> None:
    """The design is of the model alone; the band of its figure goes lower."""
    made = designed()
    assert made.box is None
    page = re.sub("<[^>]+>", " ", rendered(Study(rig=RIG, design=made)))
    (least,) = re.findall(r"consistent with fit and rig\s+at least ([\d.]+)°", page)
    assert 0.0 < float(least) < 49.0 < math.degrees(made.phase_margin)


@pytest.mark.slow
def test_a_model_without_a_natural_frequency_is_named_by_the_model_that_it_is() -> None:
    log = read_log(bundled_log("pulse_30g"))
    comparison = compare_structures(log, details=False)
    page = rendered(
        Study(experiment=log, comparison=comparison, fit=comparison.fits["UD-FOM"])
    )
    row = page[page.index("<td>D-FOM</td>") :].partition("</tr>")[0]
    resonance, hertz, frequency = re.findall(r"<td[^>]*>(.*?)</td>", row)[1:4]
    assert frequency == "–"
    rate = abs(comparison.fits["D-FOM"].model.pole.imag)
    assert float(resonance) == pytest.approx(rate, rel=1e-3)
    assert float(hertz) == pytest.approx(rate / math.tau, rel=5e-3)
    assert "D-FOM ended at ω₀ = 0: it is UD-FOM with λ = 2 − α" in page


def test_nothing_is_left_when_writing_fails(tmp_path: Path) -> None:
    place = tmp_path / "folder"
    place.mkdir()
    with pytest.raises(OSError, match="folder"):
        write_report(Study(), place)
    assert [entry.name for entry in tmp_path.iterdir()] == ["folder"]


POINTER = """
<script>
const at = (id, kind, x, more) => {
  const svg = document.getElementById(id), own = svg.getBoundingClientRect();
  const place = {clientX: own.left + x, clientY: own.top + 60, pointerType: 'mouse', ...more};
  svg.dispatchEvent(new PointerEvent(kind, place));
};
const said = [];
at('fig-bode', 'pointermove', 300);
said.push(document.getElementById('tip').textContent, document.querySelectorAll('#fig-bode .cursor').length);
at('fig-bode', 'pointerdown', 200, {button: 0});
at('fig-bode', 'pointermove', 400);
const own = document.getElementById('fig-bode').getBoundingClientRect();
dispatchEvent(new PointerEvent('pointerup', {clientX: own.left + 400, clientY: own.top + 60}));
said.push(document.querySelector('#fig-bode .box').getAttribute('viewBox').split(' ')[0]);
document.getElementById('fig-bode').dispatchEvent(new MouseEvent('dblclick'));
said.push(document.querySelector('#fig-bode .box').getAttribute('viewBox'));
said.push(document.querySelectorAll('.command button').length);
document.title = JSON.stringify(said);
</script>
"""


PRINTING = """
<script>
const folded = () => document.querySelectorAll('main > section:not(#appendix) details:not([open]) figure').length;
const said = [folded()];
dispatchEvent(new Event('beforeprint'));
said.push(folded(), document.querySelectorAll('#appendix figure').length);
said.push([...document.querySelectorAll('#appendix h2')].map((one) => one.textContent));
dispatchEvent(new Event('afterprint'));
said.push(folded(), document.querySelectorAll('#appendix').length);
document.title = JSON.stringify(said);
</script>
"""


def told_by(script: str, folder: Path) -> list[Any]:
    """What a script at the end of a report says in the title of the page."""
    page = rendered(Study(rig=RIG, design=designed()))
    # in the copy under test
    page = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page)
    place = folder / "report.html"
    place.write_text(page.replace("</body>", script + "</body>"), "utf-8")
    answer = subprocess.run(  # noqa: S603
        [*command_line(folder, "--dump-dom"), place.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    (title,) = re.findall(r"<title>(.*?)</title>", answer.stdout, re.DOTALL)
    said: list[Any] = json.loads(html.unescape(title))
    return said


@pytest.mark.slow
def test_what_is_folded_is_printed_as_an_appendix(tmp_path: Path) -> None:
    before, moved, printed, heads, after, left = told_by(PRINTING, tmp_path)
    assert before > 3 and moved == 0 and printed == before
    assert heads[0].startswith("Appendix") and "What is promised?" in heads
    assert after == before and left == 0


@pytest.mark.slow
def test_the_pointer_shows_values_and_zooms(tmp_path: Path) -> None:
    tip, cursors, left, whole, buttons = told_by(POINTER, tmp_path)
    assert re.fullmatch(r"[\d.]+\n20 g: −?[\d.]+\n30 g: −?[\d.]+\n40 g: −?[\d.]+", tip)
    assert cursors == 2  # both panels
    assert float(left) > 100 and whole == "0 0 4000 2000" and buttons >= 4


@pytest.mark.slow
def test_a_browser_shows_the_page_without_a_complaint(tmp_path: Path) -> None:
    place = write_report(study(HOSTILE[0], design=True), tmp_path / "report.html")
    with browser(tmp_path) as tab:
        tab.do("Page.navigate", url=place.as_uri())
        tab.until("document.documentElement?.dataset.ready", "the arm is ready")
        # neither a blocked style nor a script that was executed
        assert not tab.complaints
        shown = tab.run("document.documentElement.outerHTML")
    assert "alert" in shown  # the hostile name is on the page as text
    found = parsed(shown)
    drawn = sum(
        count
        for (tag, names), count in found.found.items()
        if tag == "svg" and "data-x" in names
    )
    assert drawn == 3  # log, Bode, margins
