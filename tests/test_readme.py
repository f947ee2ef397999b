"""The session of the README runs and prints what it says; its commands exist; its links
lead somewhere.
"""

from __future__ import annotations

import doctest
import re
import runpy
from pathlib import Path

import pytest

import fraclink
from guard_sources import ROOT

README = (ROOT / "README.md").read_text("utf-8")


def blocks(language: str) -> list[str]:
    """The fenced blocks of one language."""
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.slow
def test_the_session_prints_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # the session writes a folder
    sessions = blocks("python")
    assert len(sessions) == 1
    # The output of the session must not change unnoticed; numbers are compared digit by
    # digit.
    runner = doctest.DocTestRunner(optionflags=doctest.REPORT_NDIFF)
    test = doctest.DocTestParser().get_doctest(
        sessions[0], {}, "README session", "README.md", 0
    )
    outcome = runner.run(test)
    assert outcome.attempted >= 10
    assert outcome.failed == 0


@pytest.mark.parametrize(
    "line", [line for block in blocks("console") for line in block.splitlines()]
)
def test_every_command_exists_with_its_options(
    line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = line.removeprefix("$ ").split()
    assert words[0] == "fraclink"
    verb = words[1:3] if words[1] == "export" else words[1:2]
    assert fraclink.main([*verb, "--help"]) == 0
    told = capsys.readouterr().out
    for option in (word for word in words if word.startswith("--")):
        assert option in told


@pytest.mark.slow
def test_the_comparison_is_what_its_script_prints() -> None:
    script = runpy.run_path(str(ROOT / "tools" / "make_comparison.py"))
    assert "\n".join(script["table"]()) in README


@pytest.mark.parametrize("language", ["python", "console"])
def test_code_fits_a_narrow_window(language: str) -> None:
    lines = "".join(blocks(language)).splitlines()
    assert lines and max(map(len, lines)) <= 88


def test_the_make_targets_exist() -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    for target in re.findall(r"`?make (\w+)", README):
        assert f"\n{target}:" in makefile


def test_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)]+)\)", README):
        if not target.startswith("https://"):
            assert (ROOT / target).exists(), target
