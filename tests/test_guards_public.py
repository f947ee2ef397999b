"""The root of the package is a promise: its names exist, are documented, and cost nothing to import."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from types import ModuleType

import pytest

import fraclink
from guard_sources import ROOT

NAMES = [name for name in fraclink.__all__ if name != "__version__"]
# Reading a docstring must teach how to call: these parts are looked for by eye of the machine.
HEAVY = ("scipy", "matplotlib", "pydantic", "typer", "rich", "jinja2", "control", "flint", "mpmath", "pandas")


def test_the_list_is_sorted_and_small() -> None:
    assert fraclink.__all__ == sorted(fraclink.__all__)
    assert list(fraclink._HOME) == sorted(fraclink._HOME, key=str.lower) or list(fraclink._HOME) == sorted(
        fraclink._HOME
    )
    assert len(NAMES) <= 40  # what a person can learn; everything else lives in its module


@pytest.mark.parametrize("name", NAMES)
def test_public_name_exists_and_is_defined_where_it_is_said(name: str) -> None:
    value = getattr(fraclink, name)
    home = importlib.import_module(fraclink._HOME[name])
    assert getattr(home, name) is value
    assert name in getattr(home, "__all__", [name])


@pytest.mark.parametrize("name", NAMES)
def test_public_name_is_documented_with_an_example(name: str) -> None:
    value = getattr(fraclink, name)
    if isinstance(value, ModuleType) or not callable(value) or not inspect.getmodule(value):
        return
    text = inspect.getdoc(value) or ""
    assert text, f"{name} has no docstring"
    if isinstance(value, type) and issubclass(value, Exception | Warning):
        return
    assert not text.startswith(f"{name}("), f"{name}: a dataclass's generated signature is no docstring"
    assert ">>>" in text, f"{name} has no example that runs"


@pytest.mark.parametrize("name", NAMES)
def test_public_function_states_units_and_types(name: str) -> None:
    value = getattr(fraclink, name)
    if not inspect.isfunction(value):
        return
    signature = inspect.signature(value)
    untyped = [p.name for p in signature.parameters.values() if p.annotation is inspect.Parameter.empty]
    assert untyped == []
    assert signature.return_annotation is not inspect.Signature.empty
    if any("float" in str(p.annotation) for p in signature.parameters.values()):
        assert "[" in (inspect.getdoc(value) or ""), f"{name} names no unit in brackets"


def test_public_names_stand_in_the_reference() -> None:
    page = (ROOT / "docs" / "reference" / "api.md").read_text("utf-8")
    assert [name for name in NAMES if f"`{name}`" not in page and f"fraclink.{name}" not in page] == []


def test_the_root_answers_dir_and_refuses_unknown_names() -> None:
    assert dir(fraclink) == fraclink.__all__
    with pytest.raises(AttributeError, match="no attribute 'desing'"):
        fraclink.desing  # noqa: B018


def test_import_loads_numpy_only() -> None:
    code = "import sys, fraclink; print(*sys.modules)"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    loaded = {module.partition(".")[0] for module in answer.stdout.split()}
    assert loaded & set(HEAVY) == set()


def test_typing_stub_of_the_root_agrees() -> None:
    """Editors see the lazily loaded names through a TYPE_CHECKING block; it must list the same ones."""
    tree = ast.parse((ROOT / "src" / "fraclink" / "__init__.py").read_text("utf-8"))
    block = next(
        node for node in tree.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
    )
    told = {
        alias.asname or alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert told == fraclink._HOME


def test_a_verb_is_not_hidden_by_the_module_of_its_name() -> None:
    same = [name for name in NAMES if fraclink._HOME[name] == f"fraclink.{name}"]
    code = (
        "import importlib, types, fraclink\n"
        f"for name in {same!r}: importlib.import_module('fraclink.' + name)\n"
        f"print([n for n in {same!r} if isinstance(getattr(fraclink, n), types.ModuleType)])"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    assert answer.stdout.strip() == "[]"
