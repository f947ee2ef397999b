"""Pages that describe the code are compared with the code; everything listed in an
index exists.
"""

from __future__ import annotations

import doctest
import importlib
import inspect
import re
import sys
from pathlib import Path
from typing import Any

import pytest

import fraclink
import fracsys
from fraclink import errors
from guard_sources import ROOT
from test_cli import every_command

DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)
CODE = re.compile(r"\bW[1-6]\d\d\b")


@pytest.mark.slow
def test_the_page_of_errors_is_what_the_source_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    try:
        import make_error_page  # type: ignore[import-not-found]

        assert make_error_page.page() == (DOCS / "reference" / "errors.md").read_text(
            "utf-8"
        ), "run tools/make_error_page.py"
    finally:
        sys.modules.pop("make_error_page", None)


def test_every_code_and_error_of_the_source_stands_on_the_page() -> None:
    text = (DOCS / "reference" / "errors.md").read_text("utf-8")
    sources = (
        path.read_text("utf-8") for path in (ROOT / "src" / "fraclink").rglob("*.py")
    )
    used = {
        code for source in sources for code in re.findall(r'"(W[1-6]\d\d)"', source)
    }
    assert used == set(re.findall(r"\*\*(W\d\d\d)\*\*", text))
    named = {
        name
        for name in errors.__all__
        if name not in ("FraclinkError", "FraclinkWarning")
    }
    assert named == set(re.findall(r"^\| `(\w+)`", text, flags=re.MULTILINE))
    assert "|  |" not in text  # a remedy for each


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("W315", "the band does not show the …"),
    ],
)
def test_a_code_that_is_handed_over_has_the_words_of_its_own_function(
    code: str, message: str
) -> None:
    rows = (DOCS / "reference" / "errors.md").read_text("utf-8").splitlines()
    told = [
        row.split("|")[3].strip() for row in rows if row.startswith(f"| **{code}**")
    ]
    assert message in told


@pytest.mark.parametrize(
    "page", PAGES, ids=lambda page: page.relative_to(DOCS).as_posix()
)
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
    assert {
        name for name in promised if not (DOCS / "how-to" / f"{name}.md").is_file()
    } == set()


@pytest.mark.parametrize(
    "page", PAGES, ids=lambda page: page.relative_to(DOCS).as_posix()
)
def test_pages_use_public_names_only(page: Path) -> None:
    private = re.compile(
        r"^[ >.]*(?:from|import)\s+(fraclink\._\S+)", flags=re.MULTILINE
    )
    assert private.findall(page.read_text("utf-8")) == []


def extension(name: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A module of the documentation's own Sphinx extensions."""
    monkeypatch.syspath_prepend(str(DOCS / "extensions"))
    return importlib.import_module(name)


@pytest.mark.slow
def test_every_command_has_a_page_with_example_options_and_picture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pages = extension("command_pages", monkeypatch)
    found = pages.every_command()
    commands = [" ".join(words) for words, _ in every_command()]
    assert list(found) == commands and set(pages.SHOWN) == set(commands)
    for name, command in found.items():
        text = pages.page(name, command)
        assert (
            "```console\n$ fraclink" in text
            and "{picture}" in text
            and "## Options" in text
        )
        assert (DOCS / f"{pages.SHOWN[name][1]}.md").is_file()


def test_every_picture_has_a_page_that_shows_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pictures = extension("pictures", monkeypatch).PICTURES
    commands = extension("command_pages", monkeypatch).SHOWN
    assert {picture for picture, _ in commands.values()} <= set(pictures)
    shown = {
        name
        for page in PAGES
        for name in re.findall(r"\{picture\} ([\w-]+)", page.read_text("utf-8"))
    }
    assert shown <= set(pictures)
    assert {
        name
        for name, item in pictures.items()
        if not (DOCS / f"{item.page}.md").is_file()
    } == set()


def test_every_saved_kind_stands_in_the_file_formats() -> None:
    text = (DOCS / "reference" / "file-formats.md").read_text("utf-8")
    constant = re.compile(
        r"^_?(?:[A-Z]+_)?KIND(?:, _?[A-Z]+)? = \"([\w-]+)\"", flags=re.MULTILINE
    )
    literal = re.compile(r"write_(?:json|npz)\(\s*[\w/ .\"]+, \"([\w-]+)\"")
    declared = re.compile(r"^@document\(\s*\"([\w-]+)\"", flags=re.MULTILINE)
    sources = [
        path.read_text("utf-8") for path in (ROOT / "src" / "fraclink").rglob("*.py")
    ]
    found = (
        pattern.findall(source)
        for source in sources
        for pattern in (constant, literal, declared)
    )
    kinds = {kind for some in found for kind in some}
    assert len(kinds) >= 12
    assert {kind for kind in kinds if f"`{kind}`" not in text} == set()
    versioned = re.compile(
        r"^@document\(\s*\"([\w-]+)\",(?:\s*version=(\d+))?", flags=re.MULTILINE
    )
    versions = {
        kind: version or "1"
        for source in sources
        for kind, version in versioned.findall(source)
    }
    stated = dict(re.findall(r"\| `([\w-]+)` \| (\d+) \|", text))
    assert len(stated) >= 12
    assert {kind: versions.get(kind, "1") for kind in stated} == stated


PUBLIC = (
    fraclink,
    fracsys,
    fraclink.extend,
    fraclink.lab,
    fraclink.logs,
    fraclink.trials,
    fraclink.view,
)


def documented() -> list[str]:
    """The full names of all entries of the reference."""
    pages = (DOCS / "reference").rglob("*.md")
    entry = re.compile(r"^\.\. (?:auto\w+|py:\w+):: ([\w.]+)", flags=re.MULTILINE)
    return [
        name
        for page in sorted(pages)
        for name in entry.findall(page.read_text("utf-8"))
    ]


def test_every_public_name_has_an_entry_in_the_reference() -> None:
    public = {f"fraclink.errors.{name}" for name in errors.__all__}
    for package in PUBLIC:
        for name in package.__all__:
            value = getattr(package, name)
            # Names re-exported at the root from a package are documented there.
            lent = package is not fraclink and name in fraclink.__all__
            if not inspect.ismodule(value) and not lent:
                public.add(f"{package.__name__}.{name}")
    assert sorted(public - set(documented())) == []


@pytest.mark.parametrize("name", [name for name in documented() if "." in name])
def test_every_entry_of_the_reference_exists(name: str) -> None:
    assert resolved(name) is not None


def test_every_entry_of_the_reference_stands_once() -> None:
    entries = documented()
    assert sorted(entries) == sorted(set(entries))


def resolved(name: str) -> object:
    """The object of a full name."""
    head, _, last = name.rpartition(".")
    return getattr(importlib.import_module(head), last)


@pytest.mark.slow
def test_the_table_of_peers_is_what_the_benchmark_measures(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Rows of tools that are not installed here contain the values measured elsewhere."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    try:
        import bench_peers  # type: ignore[import-not-found]

        found = bench_peers.rows()
        written = bench_peers.PAGE.read_text("utf-8")
        assert len(found) >= 13
        assert [
            row for row in found if f"| {row.tool} | {row.error} |" not in written
        ] == []
        assert [
            row.problem for row in found if f"| {row.problem} |" not in written
        ] == []
    finally:
        sys.modules.pop("bench_peers", None)


@pytest.mark.parametrize(
    "page", PAGES, ids=lambda page: page.relative_to(DOCS).as_posix()
)
def test_no_page_shows_the_source_of_a_formula(page: Path) -> None:
    """Formulas are written in Unicode; TeX would appear on the page as typed."""
    text = page.read_text("utf-8")
    assert [mark for mark in ("$$", "\\frac", "\\omega", "\\hat") if mark in text] == []


SESSION = re.compile(r"```python\n(>>> .*?)```", flags=re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if SESSION.search(page.read_text("utf-8"))],
    ids=lambda page: page.relative_to(DOCS).as_posix(),
)
def test_sessions_that_are_not_cells_print_what_they_say(page: Path) -> None:
    text = "\n".join(SESSION.findall(page.read_text("utf-8")))
    test = doctest.DocTestParser().get_doctest(text, {}, page.name, str(page), 0)
    outcome = doctest.DocTestRunner(optionflags=doctest.REPORT_NDIFF).run(test)
    assert outcome.attempted > 0
    assert outcome.failed == 0
