"""Pages that describe the code are compared with it; what an index promises is there."""

from __future__ import annotations

import re
import sys

import pytest

from fraclink import errors
from guard_sources import ROOT

DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)
CODE = re.compile(r"\bW[1-6]\d\d\b")


def test_the_page_of_errors_is_what_the_source_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    try:
        import make_error_page  # type: ignore[import-not-found]

        assert make_error_page.page() == (DOCS / "reference" / "errors.md").read_text("utf-8"), (
            "run tools/make_error_page.py"
        )
    finally:
        sys.modules.pop("make_error_page", None)


def test_every_code_and_error_of_the_source_stands_on_the_page() -> None:
    text = (DOCS / "reference" / "errors.md").read_text("utf-8")
    sources = (path.read_text("utf-8") for path in (ROOT / "src" / "fraclink").rglob("*.py"))
    used = {code for source in sources for code in re.findall(r'"(W[1-6]\d\d)"', source)}
    assert used == set(re.findall(r"\*\*(W\d\d\d)\*\*", text))
    named = {name for name in errors.__all__ if name not in ("FraclinkError", "FraclinkWarning")}
    assert named == set(re.findall(r"^\| `(\w+)`", text, flags=re.MULTILINE))
    assert "|  |" not in re.sub(r"\*\*W403\*\*.*", "", text)  # a remedy for each but the one that needs none


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(DOCS).as_posix())
def test_codes_in_pages_exist(page: object) -> None:
    known = set(CODE.findall((DOCS / "reference" / "errors.md").read_text("utf-8")))
    assert set(CODE.findall((ROOT / str(page)).read_text("utf-8"))) <= known


def test_every_how_to_of_the_index_is_there() -> None:
    promised = (
        "bring-your-rig",
        "read-your-log",
        "choose-a-structure",
        "choose-the-filter",
        "include-your-motor-loop",
        "flash-a-board",
        "python-control",
        "run-a-campaign",
        "read-a-certificate",
    )
    assert {name for name in promised if not (DOCS / "how-to" / f"{name}.md").is_file()} == set()


def test_every_saved_kind_stands_in_the_file_formats() -> None:
    text = (DOCS / "reference" / "file-formats.md").read_text("utf-8")
    constant = re.compile(r"^_?(?:[A-Z]+_)?KIND(?:, _?[A-Z]+)? = \"([\w-]+)\"", flags=re.MULTILINE)
    literal = re.compile(r"write_(?:json|npz)\(\s*[\w/ .\"]+, \"([\w-]+)\"")
    sources = [path.read_text("utf-8") for path in (ROOT / "src" / "fraclink").rglob("*.py")]
    kinds = {kind for source in sources for kind in (*constant.findall(source), *literal.findall(source))}
    assert len(kinds) >= 8
    assert {kind for kind in kinds if f"`{kind}`" not in text} == set()
