"""The arm in a page: self-contained, safe against hostile names, and in a browser
bitwise equal to the package.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import html
import io
import json
import re
import runpy
import tempfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fraclink as fl
from browser import browser
from fraclink import main
from fraclink._simulate.engine import engine_link
from fraclink.errors import FieldError
from fraclink.trials import save_study
from law_bench import documented_design
from test_report import HOSTILE_PAGES, Elements, parsed


@pytest.fixture(scope="module")
def study() -> fl.trials.Study:
    rig = fl.Rig.named("paper-2023")
    design = documented_design(rig)
    return fl.trials.Study(rig=rig, design=design, law=design.law())


def written(study: fl.trials.Study) -> str:
    """The page of a study."""
    with tempfile.TemporaryDirectory() as folder:
        path = fl.view.write_arm_page(study, Path(folder) / "arm.html")
        return path.read_text("utf-8")


@pytest.fixture(scope="module")
def page(study) -> str:
    return written(study)


def named(study: fl.trials.Study, text: str) -> fl.trials.Study:
    """The study with `text` wherever a text from outside can occur."""
    rig = replace(study.design.rig, name=text, source=text, assumptions=(text,))
    design = replace(study.design, rig=rig)
    return replace(
        study,
        rig=rig,
        design=design,
        missing={"certificate": text},
        assumptions=(text,),
    )


@pytest.fixture(scope="module")
def plain(study) -> Elements:
    return parsed(written(named(study, "plain")))


@pytest.mark.slow
@pytest.mark.parametrize("text", HOSTILE_PAGES)
def test_no_text_from_outside_becomes_an_element(study, plain, text):
    page = parsed(written(named(study, text)))
    assert page.found == plain.found
    assert page.references == plain.references == []


@pytest.mark.slow
def test_the_page_asks_nobody_and_allows_its_own_script_only(page):
    policy = html.unescape(
        re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1]
    )
    script = re.search(r"<script>(.*?)</script>", page, re.DOTALL)[1]
    style = re.search(r"<style>(.*?)</style>", page, re.DOTALL)[1]
    said = [
        base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        for text in (script, style)
    ]
    assert (
        f"script-src 'sha256-{said[0]}' 'wasm-unsafe-eval'; style-src 'sha256-{said[1]}';"
        in policy
    )
    assert policy.startswith("default-src 'none'; ")
    assert "unsafe-inline" not in policy
    assert " style=" not in page and " on" + "click=" not in page
    for word in (
        "fetch(",
        "XMLHttp",
        "WebSocket",
        "import(",
        "eval(",
        "innerHTML",
        "@import",
        "http:",
    ):
        assert word not in script.replace("http://www.w3.org/2000/svg", "") + style, (
            word
        )
    assert len(page.encode()) <= 160_000


@pytest.mark.slow
def test_the_same_study_gives_the_same_page(study, page):
    assert written(study) == page


@pytest.mark.slow
def test_the_page_says_what_is_promised_and_what_it_simulates(study, page):
    texts = " ".join(" ".join(parsed(page).texts).split())
    assert "designed for payloads from 20 to 40 g" in texts.replace("  ", " ")
    assert "Outside this range nothing is promised" in texts
    assert "carries 20 to 40 g at 12 rad/s" in texts
    assert "No certificate came with this design" in texts
    assert "The mass of the link" in texts
    refuted = written(replace(study, missing={"certificate": "because of the moon"}))
    assert "not certified: because of the moon" in refuted


@pytest.mark.slow
def test_slider_and_links_cover_the_designs_payloads(study, page):
    data = json.loads(re.search(r'id="arm-data">(.*?)</script>', page, re.DOTALL)[1])
    payloads = data["payloads"]
    assert payloads == sorted(payloads) and len(payloads) == len(data["links"]) >= 15
    assert {0.020, 0.030, 0.040} <= set(payloads)
    assert (payloads[0], payloads[-1]) == (0.008, 0.080)
    assert payloads[data["start"]["payload"]] == 0.030
    assert data["periods"] * data["period"] == pytest.approx(4.0, abs=0.5)


@pytest.mark.slow
def test_a_faster_clock_leaves_room_by_fewer_payloads(study):
    fast = replace(study.design.rig, period=0.001)
    design = documented_design(fast)
    text = written(fl.trials.Study(rig=fast, design=design))
    assert len(text.encode()) <= 160_000
    assert (
        len(
            json.loads(re.search(r'id="arm-data">(.*?)</script>', text, re.DOTALL)[1])[
                "payloads"
            ]
        )
        >= 7
    )


@pytest.mark.slow
def test_a_folder_without_a_design_names_the_command(study, tmp_path, capsys):
    save_study(replace(study, design=None, law=None), tmp_path / "none")
    files = ["--arm", str(tmp_path / "none"), "--out", str(tmp_path / "arm.html")]
    assert main(["report", *files]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "fraclink design" in said and "design: " in said
    assert not (tmp_path / "arm.html").exists()


@pytest.mark.slow
def test_the_command_writes_the_page_and_leaves_a_file_alone(
    study, page, tmp_path, capsys
):
    save_study(study, tmp_path / "results")
    files = ["--arm", str(tmp_path / "results"), "--out", str(tmp_path / "arm.html")]
    command = ["report", *files]
    assert main(command) == 0
    assert (tmp_path / "arm.html").read_text() == page
    assert main(command) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*command, "--force"]) == 0


# Settings that the address of the page can hold; together they cover every slider,
# every fault and both precisions.
RUNS = (
    "",
    "payload=3&move=-37&time=9&noise=0.031&offset=0.11&delay=3&told=0&single=1&nan=80&blind=400",
    "payload=18&move=90&time=2&noise=0&offset=-0.2&delay=0&told=1&single=0&reversed=60&half=150&missed=200",
    "payload=11&move=60&noise=0.004&single=1&stuck=30&encoder=310&slip=90&late=1",
    "twin=1&zero=100&backwards=300",
    "twin=1&payload=3&move=-37&time=9&noise=0.031&offset=0.11&delay=3&told=0&single=1&nan=80",
)


FAULTS = [
    "nan",
    "stuck",
    "reversed",
    "zero",
    "half",
    "encoder",
    "blind",
    "backwards",
    "slip",
    "missed",
]


def browsed(page: str, place: Path, settings: str) -> str:
    """The page at this address in a browser, after its script has run without an error."""
    address = place / "arm.html"
    address.write_text(page)
    with browser(place) as tab:
        tab.do("Page.navigate", url=f"{address.as_uri()}#{settings}")
        tab.until("document.documentElement?.dataset.ready", "the arm is ready")
        # neither an error nor a request that the policy blocked
        assert not tab.complaints
        assert all(request.startswith(("file:", "data:")) for request in tab.requests)
        return str(tab.run("document.documentElement.outerHTML"))


def python_of(shown: str) -> str:
    return html.unescape(
        re.search(r'<pre id="python"[^>]*>(.*?)</pre>', shown, re.DOTALL)[1]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    RUNS,
    ids=[
        "start",
        "lost gauge",
        "reversed, missed",
        "stuck, late",
        "twin",
        "twin, lost gauge",
    ],
)
def test_a_browser_runs_the_packages_bits_without_a_complaint(
    study, page, tmp_path, monkeypatch, settings
):
    study.design.save(tmp_path / "design.json")
    shown = browsed(page, tmp_path, settings)
    code = python_of(shown)
    for name in FAULTS:
        assert (f"{name}=" in settings) == (
            f'id="fault-{name}" aria-pressed="true"' in shown
        )
    script = tmp_path / "same_run.py"
    script.write_text(code)
    monkeypatch.chdir(tmp_path)
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        runpy.run_path(str(script))
    assert re.search(r"# (\d+) in this page", code)[1] == said.getvalue().strip()


def numbers_of(page: str) -> dict:
    return json.loads(re.search(r'id="arm-data">(.*?)</script>', page, re.DOTALL)[1])


@pytest.mark.slow
def test_the_motor_loop_alone_moves_beside_the_law(study, page, tmp_path):
    """The motor loop alone still swings when the law has long been at rest; with a
    payload so light that both come to rest, its time is that of the package.
    """
    modes = type(study.law.correction)
    alone = replace(study.law, correction=modes(0.0), feedforward=modes(0.0))
    data = numbers_of(page)
    assert [base64.b64decode(text) for text in data["blocks"][2:]] == [
        alone.in_precision(name).block for name in ("double", "single")
    ]
    move = fl.smooth_step(np.radians(60), 0.5)
    rig, model, half = study.rig, study.design.model, data["half"]
    noise = data["start"]["noise"]
    for place in (data["start"]["payload"], 0):
        run = fl.simulate(
            alone,
            move,
            rig=rig,
            model=model,
            payload=data["payloads"][place],
            noise=noise,
            duration=half,
        )
        rests = run.metrics.settling_time
        shown = browsed(page, tmp_path, f"payload={place}")
        fates = re.findall(r'class="fate"[^>]*>([^<]*)<', shown)
        if place:
            assert rests > 1.5
            assert fates[0] == f"swings on for {half:.1f} s" != fates[1]
        else:
            # Both directions: the page reports the longer of two moves with noise.
            said = float(re.fullmatch(r"at rest in ([\d.]+) s", fates[0])[1])
            assert said == pytest.approx(rests, abs=0.05)


@pytest.mark.slow
def test_a_model_without_a_payload_moves_with_the_links_that_simulate_has(study):
    rig = study.design.rig
    bare = replace(rig.model, payload=None)
    design = fl.design(
        bare, rig, payloads=(0.02, 0.04), gain_crossover=12.0, phase_margin=fl.deg(50)
    )
    page = written(fl.trials.Study(rig=rig, design=design))
    data = numbers_of(page)
    assert {0.020, 0.030, 0.040} <= set(data["payloads"])
    numbers = np.frombuffer(base64.b64decode(data["numbers"]))
    last = engine_link(
        replace(bare, natural_frequency=rig.natural_frequency(0.08), payload=0.08),
        data["period"],
        data["periods"] * data["period"],
    )
    assert data["payloads"][-1] == 0.08
    np.testing.assert_allclose(
        numbers[-last.numbers.size :], last.numbers, rtol=1e-6, atol=1e-12
    )
    assert replace(rig.model, payload=0.03).sentence in page


@pytest.mark.slow
def test_a_model_too_fast_for_its_period_is_refused_by_name(study, tmp_path):
    model = replace(study.design.model, natural_frequency=1e3)
    with pytest.raises(FieldError, match=r"rig\.period: too long.*0\.004.*[Ss]horten"):
        fl.view.write_arm_page(
            replace(study, design=replace(study.design, model=model)),
            tmp_path / "arm.html",
        )
    assert not (tmp_path / "arm.html").exists()


@pytest.mark.slow
def test_the_python_of_the_page_names_the_law_that_it_runs(study):
    other = fl.extend.equip(
        study.law,
        study.design.rig,
        study.design.model,
        moves=fl.extend.Moves(velocity=2.0),
    )
    loaded, double = 'fl.load("law.json")', '.in_precision("double")'
    bare = replace(study.law, motor_loop=None)
    for law, python in (
        (None, f"design.law(){double}"),
        (study.law, f"design.law(){double}"),
        (other, f"{loaded}{double}"),
        (study.law.in_precision("double"), loaded),
        (bare, f"fl.extend.equip({loaded}{double}, design.rig, design.model)"),
    ):
        data = numbers_of(written(replace(study, law=law)))
        assert data["law"] == python
        makes = {
            "design": study.design,
            "fl": SimpleNamespace(extend=fl.extend, load=lambda _, law=law: law),
        }
        assert eval(python, makes).block == base64.b64decode(data["blocks"][0])  # noqa: S307
