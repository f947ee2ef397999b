"""The arm in a page: complete in itself, deaf to what names try, and in a browser bit for bit the package."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import html
import io
import json
import re
import runpy
import subprocess
from dataclasses import replace

import pytest

import fraclink as fl
from fraclink._cli import main
from fraclink._show.arm_page import render_arm_page
from fraclink._workflow import save_study
from needed_tools import tool
from test_report import HOSTILE, Elements, parsed


@pytest.fixture(scope="module")
def study() -> fl.Study:
    rig = fl.Rig.named("paper-2023")
    assert rig.model is not None
    design = fl.design(rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0, phase_margin=fl.deg(50))
    return fl.Study(rig=rig, design=design, law=design.law())


@pytest.fixture(scope="module")
def page(study) -> str:
    return render_arm_page(study)


def named(study: fl.Study, text: str) -> fl.Study:
    """The study with `text` wherever a text from outside can stand."""
    rig = replace(study.design.rig, name=text, source=text, assumptions=(text,))
    design = replace(study.design, rig=rig)
    return replace(study, rig=rig, design=design, uncertified=text, assumptions=(text,))


@pytest.fixture(scope="module")
def plain(study) -> Elements:
    return parsed(render_arm_page(named(study, "plain"), title="plain"))


@pytest.mark.slow
@pytest.mark.parametrize("text", HOSTILE)
def test_no_text_from_outside_becomes_an_element(study, plain, text):
    page = parsed(render_arm_page(named(study, text), title=text))
    assert page.found == plain.found
    assert page.references == plain.references == []


@pytest.mark.slow
def test_the_page_asks_nobody_and_allows_its_own_script_only(page):
    policy = html.unescape(re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1])
    script = re.search(r"<script>(.*?)</script>", page, re.DOTALL)[1]
    style = re.search(r"<style>(.*?)</style>", page, re.DOTALL)[1]
    said = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in (script, style)]
    assert f"script-src 'sha256-{said[0]}' 'wasm-unsafe-eval'; style-src 'sha256-{said[1]}';" in policy
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
        assert word not in script.replace("http://www.w3.org/2000/svg", "") + style, word
    assert len(page.encode()) <= 150_000


@pytest.mark.slow
def test_the_same_study_gives_the_same_page(study, page):
    assert render_arm_page(study) == page


@pytest.mark.slow
def test_the_page_says_what_is_promised_and_what_it_simulates(study, page):
    texts = " ".join(" ".join(parsed(page).texts).split())
    assert "designed for payloads from 20 to 40 g" in texts.replace("  ", " ")
    assert "Outside of this range nothing is promised" in texts
    assert "promise passed, model not run, reality not run" in texts
    assert "No certificate came with this design" in texts
    assert "The mass of the link" in texts
    refuted = render_arm_page(replace(study, uncertified="because of the moon"))
    assert "not certified: because of the moon" in refuted


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
    design = fl.design(fast.model, fast, payloads=(0.02, 0.04), gain_crossover=12.0, phase_margin=fl.deg(50))
    text = render_arm_page(fl.Study(rig=fast, design=design))
    assert len(text.encode()) <= 150_000
    assert len(json.loads(re.search(r'id="arm-data">(.*?)</script>', text, re.DOTALL)[1])["payloads"]) >= 7


def test_a_folder_without_a_design_names_the_command(study, tmp_path, capsys):
    save_study(replace(study, design=None, law=None), tmp_path / "none")
    assert main(["share", str(tmp_path / "none"), "--out", str(tmp_path / "arm.html")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "fraclink design" in said and "design: " in said
    assert not (tmp_path / "arm.html").exists()


@pytest.mark.slow
def test_the_command_writes_the_page_and_leaves_a_file_alone(study, page, tmp_path, capsys):
    save_study(study, tmp_path / "results")
    command = ["share", str(tmp_path / "results"), "--out", str(tmp_path / "arm.html")]
    assert main(command) == 0
    assert (tmp_path / "arm.html").read_text() == page
    assert main(command) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*command, "--force"]) == 0


# What the page's address can say; together every slider, every fault and both precisions.
RUNS = (
    "",
    "payload=3&move=-37&time=9&noise=0.031&offset=0.11&delay=3&told=0&single=1&nan=80",
    "payload=18&move=90&time=2&noise=0&offset=-0.2&delay=0&told=1&single=0&reversed=60&missed=200",
    "payload=11&move=60&noise=0.004&single=1&stuck=30&encoder=310&late=1",
)


@pytest.mark.slow
@pytest.mark.parametrize("settings", RUNS, ids=["start", "lost gauge", "reversed, missed", "stuck, late"])
def test_a_browser_runs_the_packages_bits_without_a_complaint(study, page, tmp_path, monkeypatch, settings):
    browser = tool("chromium")
    place = tmp_path / "arm.html"
    place.write_text(page)
    study.design.save(tmp_path / "design.json")
    command = [
        browser,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--enable-logging=stderr",
        "--dump-dom",
    ]
    answer = subprocess.run(  # noqa: S603
        [*command, "--dump-dom", f"--user-data-dir={tmp_path / 'profile'}", f"{place.as_uri()}#{settings}"],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "CONSOLE" not in answer.stderr  # neither an error nor a request that the policy refused
    assert 'data-ready="true"' in answer.stdout
    code = html.unescape(re.search(r'<pre id="python"[^>]*>(.*?)</pre>', answer.stdout, re.DOTALL)[1])
    for name in ("nan", "stuck", "reversed", "encoder", "missed"):
        assert (f"{name}=" in settings) == (f'id="fault-{name}" aria-pressed="true"' in answer.stdout)
    script = tmp_path / "same_run.py"
    script.write_text(code)
    monkeypatch.chdir(tmp_path)
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        runpy.run_path(str(script))
    assert re.search(r"# (\d+) in this page", code)[1] == said.getvalue().strip()


def contrast(first: str, second: str) -> float:
    """Ratio of luminances of two colours, as WCAG 2 defines it."""

    def luminance(colour: str) -> float:
        digits = colour[1:] if len(colour) == 7 else "".join(2 * digit for digit in colour[1:])
        parts = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    bright, dark = sorted((luminance(first), luminance(second)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("theme", [0, 1], ids=["light", "dark"])
def test_text_and_lines_stand_out_in_both_themes(page, theme):
    colours = dict(re.findall(r"--([\w-]+): (#\w+);", re.findall(r"\.armpage[^{]*\{([^}]*)\}", page)[theme]))
    for name in ("ink", "quiet", "good", "fair", "bad", "accent", "tip", "hub", "ghost", "measured"):
        assert contrast(colours[name], colours["card"]) >= 4.5, name
    for name in ("good", "fair", "bad"):
        assert contrast(colours[name], colours[f"{name}-wash"]) >= 4.5, name
    assert contrast(colours["on-accent"], colours["accent"]) >= 4.5
    assert contrast(colours["quiet"], colours["page"]) >= 4.5
    for name in ("link", "load", "metal"):
        assert contrast(colours[name], colours["card"]) >= 3.0, name
