"""What a report is made of, before it is a page: its parts for each thing that a study
has.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink._arm.experiment import Experiment
from fraclink.errors import FieldError, MissingExtraError
from fraclink.view import _arm_page as arm_page
from fraclink.view import _loops as loops
from fraclink.view import _pages as pages

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


def log() -> Experiment:
    time = 0.004 * np.arange(400)
    return Experiment(
        period=0.004, motor_angle=np.sin(time), output=np.cos(time), source="a/log.csv"
    )


# --- pages ------------------------------------------------------------------------------------------------


def test_a_page_names_what_it_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    import jinja2

    with pytest.raises(jinja2.UndefinedError, match="is undefined"):
        pages.rendered("campaign.html")
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(MissingExtraError, match="jinja2"):
        pages.rendered("report.html")


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
