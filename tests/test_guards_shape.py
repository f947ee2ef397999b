"""Shapes and habits that a machine can see: sizes, forbidden calls, what may not be in
a tracked file.
"""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from guard_sources import PACKAGES, ROOT, Source, sources

FILE_LINES = 600  # an alarm, not an aim: a file is as long as its subject
FUNCTION_LINES = 100
FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "shelve", "marshal"}


def test_files_stay_readable() -> None:
    files = [
        *(path for package in PACKAGES for path in package.rglob("*.py")),
        *(ROOT / "csrc").rglob("*.[ch]"),
        *(ROOT / "csrc").rglob("*.cpp"),
    ]
    # law.c is a deliverable of its own: one file that people copy to a board and read
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
    """Lines of a function without its docstring, which is as long as its arguments are
    many.
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


def _dangers(tree: ast.AST) -> Iterator[str]:
    """Constructs that run or unpack what a file holds, or swallow an error."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (
                alias.name for alias in node.names if alias.name in FORBIDDEN_MODULES
            )
        elif isinstance(node, ast.ImportFrom) and node.module in FORBIDDEN_MODULES:
            yield node.module or ""
        elif isinstance(node, ast.Call):
            yield from _dangerous_call(node)
        elif isinstance(node, ast.ExceptHandler):
            if node.type is None:
                yield "bare except"
            elif all(isinstance(part, ast.Pass) for part in node.body):
                yield "except: pass"


def _dangerous_call(node: ast.Call) -> Iterator[str]:
    if isinstance(node.func, ast.Name) and node.func.id in {"eval", "exec"}:
        yield node.func.id
    if isinstance(node.func, ast.Attribute) and ast.unparse(node.func) in {
        "yaml.load",
        "os.system",
    }:
        yield ast.unparse(node.func)
    for keyword in node.keywords:
        value = (
            keyword.value.value
            if isinstance(keyword.value, ast.Constant)
            else "computed"
        )
        if keyword.arg in {"allow_pickle", "shell"} and value is not False:
            yield f"{keyword.arg}={value!r}"


def test_nothing_runs_what_a_file_holds() -> None:
    found = {source.name: sorted(_dangers(source.tree)) for source in sources()}
    assert {name: dangers for name, dangers in found.items() if dangers} == {}


@pytest.mark.parametrize(
    "code",
    [
        "import pickle",
        "from dill import load",
        "eval('1')",
        "np.load(p, allow_pickle=True)",
        "run(c, shell=flag)",
        "yaml.load(t)",
        "try:\n f()\nexcept:\n g()",
        "try:\n f()\nexcept OSError:\n pass",
    ],
)
def test_the_gate_closes(code: str) -> None:
    assert list(_dangers(ast.parse(code)))


def test_no_global_state() -> None:
    def writes_globals(source: Source) -> bool:
        return any(isinstance(node, ast.Global) for node in ast.walk(source.tree))

    assert [source.name for source in sources() if writes_globals(source)] == []


def tracked_files() -> list[Path]:
    """Files under version control; outside a checkout there is nothing to guard."""
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


@pytest.mark.parametrize(
    "text",
    [
        "Sum.\n\nArguments:\n    a: one",
        "Sum.\n\nParameters: `a`, one",
        "Sum.\n\nParameters\n----------\na\n    one.\nb : int\n    two.",
        "Sum.\n\nReturns\n-------\nfloat\n    the sum.",
    ],
)
def test_other_styles_are_seen(text: str) -> None:
    assert OTHER_STYLE.search(text)


def test_the_style_itself_is_not_seen() -> None:
    text = "Sum.\n\nParameters\n----------\na, b\n    two : numbers.\n\nRaises\n------\nFieldError\n    no."
    assert not OTHER_STYLE.search(text)
