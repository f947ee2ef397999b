"""The root of the package is a promise: its names exist, are documented, and cost
nothing to import.
"""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys

import pytest

import fraclink
import fracsys
from guard_sources import ROOT

PUBLIC = {
    module.__name__: module
    for module in (
        fraclink,
        fracsys,
        fraclink.extend,
        fraclink.lab,
        fraclink.logs,
        fraclink.trials,
        fraclink.view,
    )
}
NAMES = [f"{package}.{name}" for package in PUBLIC for name in PUBLIC[package].__all__]


def value_of(dotted: str) -> object:
    package, _, name = dotted.rpartition(".")
    return getattr(PUBLIC[package], name)


# A docstring must explain how to call: these sections are checked automatically.
HEAVY = (
    "scipy",
    "matplotlib",
    "pydantic",
    "typer",
    "rich",
    "jinja2",
    "control",
    "flint",
    "mpmath",
    "pandas",
)


REFERENCE = ROOT / "docs" / "reference"
# The names explained on the first page of the reference: they are learned first, so
# each has an example.
FIRST = [
    name
    for name in NAMES
    if f"| `{name}` |" in (REFERENCE / "api.md").read_text("utf-8")
]


def test_the_lists_are_sorted_and_the_first_page_short() -> None:
    for module in PUBLIC.values():
        assert module.__all__ == sorted(module.__all__)
    assert 30 <= len(FIRST) <= 45


@pytest.mark.parametrize("package", PUBLIC)
def test_every_name_of_the_stub_is_public(package: str) -> None:
    stub = ast.parse(
        (ROOT / "src" / package.replace(".", "/") / "__init__.pyi").read_text("utf-8")
    )
    names = {
        alias.asname
        for node in stub.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert names == set(PUBLIC[package].__all__)


@pytest.mark.parametrize("name", NAMES)
def test_public_name_is_documented_with_an_example(name: str) -> None:
    value = value_of(name)
    if not isinstance(value, type) and not inspect.isfunction(value):
        return  # a table or an object whose class documents it
    text = inspect.getdoc(value) or ""
    assert text, f"{name} has no docstring"
    if isinstance(value, type) and issubclass(value, Exception | Warning):
        return
    assert not text.startswith(f"{name.rpartition('.')[2]}("), (
        f"{name}: a dataclass's generated signature is no docstring"
    )
    assert name not in FIRST or ">>>" in text, f"{name} has no example that runs"


@pytest.mark.parametrize("name", FIRST)
def test_public_function_states_units_and_types(name: str) -> None:
    value = value_of(name)
    if not inspect.isfunction(value):
        return
    signature = inspect.signature(value)
    untyped = [
        p.name
        for p in signature.parameters.values()
        if p.annotation is inspect.Parameter.empty
    ]
    assert untyped == []
    assert signature.return_annotation is not inspect.Signature.empty
    if any("float" in str(p.annotation) for p in signature.parameters.values()):
        assert "[" in (inspect.getdoc(value) or ""), f"{name} names no unit in brackets"


def test_the_root_answers_dir_and_refuses_unknown_names() -> None:
    assert dir(fraclink) == fraclink.__all__
    with pytest.raises(AttributeError, match="no attribute 'desing'"):
        fraclink.desing  # type: ignore[attr-defined]  # noqa: B018


def test_import_loads_numpy_only() -> None:
    code = "import sys, fraclink; print(*sys.modules)"
    answer = subprocess.run(  # noqa: S603
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    loaded = {module.partition(".")[0] for module in answer.stdout.split()}
    assert loaded & set(HEAVY) == set()
