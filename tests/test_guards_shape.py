"""Shapes and habits that can be checked automatically: sizes, forbidden calls, what may
not be in a tracked file.
"""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from guard_sources import PACKAGES, ROOT, sources

FILE_LINES = 600  # an alarm, not a target: a file is as long as its subject requires
FUNCTION_LINES = 100


def test_files_stay_readable() -> None:
    files = [
        *(path for package in PACKAGES for path in package.rglob("*.py")),
        *(ROOT / "csrc").rglob("*.[ch]"),
        *(ROOT / "csrc").rglob("*.cpp"),
    ]
    # law.c is a deliverable of its own: one file that users copy to a board and read
    # from top to bottom.
    files.remove(ROOT / "csrc" / "law.c")
    # Each is one subject, read from top to bottom.
    for whole in ("_design/procedure.py", "_design/request.py"):
        files.remove(ROOT / "src" / "fraclink" / whole)
    long = {
        str(path.relative_to(ROOT)): len(path.read_text("utf-8").splitlines())
        for path in files
    }
    assert {name: lines for name, lines in long.items() if lines > FILE_LINES} == {}


def _code_lines(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function without its docstring, whose length depends on the number of
    arguments.
    """
    first = node.body[0]
    told = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    docstring = (first.end_lineno or first.lineno) - first.lineno + 1 if told else 0
    return (node.end_lineno or node.lineno) - node.lineno + 1 - docstring


def test_functions_stay_readable() -> None:
    long = [
        f"{source.name}:{node.name} has {_code_lines(node)} lines"
        for source in sources()
        for node in ast.walk(source.tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if _code_lines(node) > FUNCTION_LINES
    ]
    assert long == []


def test_no_array_of_objects_is_unpickled() -> None:
    # Other ways to execute the content of a file (pickle, eval, a shell) are found by
    # the linter's S rules.
    asked = re.compile(r"allow_pickle=(?!False)")
    assert [source.name for source in sources() if asked.search(source.text)] == []


def tracked_files() -> list[Path]:
    """Files under version control; outside a checkout there is nothing to check."""
    try:
        answer = subprocess.run(  # noqa: S603
            ["git", "-C", str(ROOT), "ls-files", "-z"],  # noqa: S607
            capture_output=True,
            check=True,
        )
    except (FileNotFoundError, subprocess.CalledProcessError):
        pytest.skip("git or its metadata is missing: tracked files are unknown")
    return [ROOT / name for name in answer.stdout.decode().split("\0") if name]


# Written so that this file does not match itself.
MACHINE = re.compile(
    r"(?<![\w.])/(?:work|farm|tmp|home|root|Users)/[A-Za-z.]"
    r"|py[p]i\.org|python[h]osted|anaconda\.or[g]|[a]rtifactory|--(?:extra-)?inde[x]-url\b"
)


def test_tracked_files_name_no_machine_and_no_registry() -> None:
    found = []
    for path in tracked_files():
        if not path.is_file() or path.suffix in {".png", ".npz", ".mat", ".woff2"}:
            continue
        for number, line in enumerate(
            path.read_text("utf-8", errors="replace").splitlines(), 1
        ):
            if hit := MACHINE.search(line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {hit.group()}")
    assert found == []


def test_the_machine_pattern_sees_machines() -> None:
    assert MACHINE.search("/" + "home/anna/x")
    assert MACHINE.search("https://py" + "pi.org/simple")
    assert not MACHINE.search("docs/how-to/home/in.md and a/Users/b")


# numpydoc without types, which are in the signature; "Arguments:" and running lists are
# other styles.
OTHER_STYLE = re.compile(
    r"^(Arguments|Args|Returns|Raises|Parameters|Attributes|Yields|Fields|Options):"
    r"|^(?:Parameters|Attributes)\n-+\n(?:.+\n|\n(?=    ))*?\*{0,2}\w[\w, *]* : \S"
    r"|^Returns\n-+\n",
    flags=re.MULTILINE,
)


def _docstrings(tree: ast.Module) -> Iterator[tuple[str, str]]:
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    for node in ast.walk(tree):
        if isinstance(node, kinds) and (text := ast.get_docstring(node)):
            yield getattr(node, "name", "module"), text


def test_docstrings_have_one_style() -> None:
    other = [
        f"{source.name}.{name}: {found.group().splitlines()[-1]}"
        for source in sources()
        for name, text in _docstrings(source.tree)
        if (found := OTHER_STYLE.search(text))
    ]
    assert other == []
