"""Shared by the guards: the sources of the package as syntax trees."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = (ROOT / "src" / "fracsys", ROOT / "src" / "fraclink")


def component(name: str) -> str:
    """``fraclink._arm.rig`` -> ``_arm``, ``fracsys._roots`` -> ``fracsys``."""
    package, _, rest = name.partition(".")
    return rest.partition(".")[0] if package == "fraclink" and rest else package


@dataclass(frozen=True)
class Source:
    """One module: its dotted name, its path and text."""

    name: str
    path: Path
    text: str

    @property
    def tree(self) -> ast.Module:
        """The syntax tree, parsed again each time, a second for all modules: keeping
        the trees of the package would take 100 MB.
        """
        return ast.parse(self.text, filename=str(self.path))

    @property
    def component(self) -> str:
        """What a floor is assigned to: fracsys, or the part of fraclink."""
        return component(self.name)


@cache
def sources() -> tuple[Source, ...]:
    """Every module of the packages."""
    modules = []
    for package in PACKAGES:
        for path in sorted(package.rglob("*.py")):
            parts = path.relative_to(package.parent).with_suffix("").parts
            parts = parts[:-1] if parts[-1] == "__init__" else parts
            modules.append(
                Source(".".join(parts), path, path.read_text(encoding="utf-8"))
            )
    return tuple(modules)


def _typing_only(tree: ast.Module) -> set[int]:
    """Ids of the nodes below ``if TYPE_CHECKING``: they are never imported when the
    code runs.
    """
    hidden: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            hidden.update(id(inner) for child in node.body for inner in ast.walk(child))
    return hidden


def _inside_functions(tree: ast.Module) -> set[int]:
    """Ids of the nodes inside functions: their imports wait until they are called."""
    kinds = ast.FunctionDef | ast.AsyncFunctionDef
    return {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, kinds)
        for inner in ast.walk(node)
    }


@cache
def public_names() -> frozenset[str]:
    """Every name in the stub of a package, which is its public interface."""
    stubs = (
        ast.parse(path.read_text("utf-8"))
        for package in PACKAGES
        for path in package.rglob("__init__.pyi")
    )
    return frozenset(
        alias.name
        for stub in stubs
        for node in stub.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    )


def statements(package: str) -> int:
    """Statements of a package; docstrings and imports do not count."""
    return sum(
        isinstance(node, ast.stmt)
        and not isinstance(node, ast.Import | ast.ImportFrom)
        and not (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        )
        for source in sources()
        if source.component == package
        for node in ast.walk(source.tree)
    )


def imported_modules(source: Source, *, at_once: bool = False) -> tuple[str, ...]:
    """Modules of the packages that a module imports.

    At its top or inside a function; with `at_once` at its top only.
    """
    return tuple(name for name, late in _imported(source) if not (at_once and late))


@cache
def _imported(source: Source) -> tuple[tuple[str, bool], ...]:
    """What a module imports, and whether inside a function."""
    tree = source.tree  # one tree for all three, because nodes are compared by identity
    hidden, late = _typing_only(tree), _inside_functions(tree)
    return tuple(
        (name, id(node) in late)
        for node in ast.walk(tree)
        if id(node) not in hidden
        for name in _names_imported(node)
    )


@cache
def _module_names() -> frozenset[str]:
    return frozenset(item.name for item in sources())


def _names_imported(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        for alias in node.names:
            if alias.name.split(".")[0] in ("fraclink", "fracsys"):
                yield alias.name
    elif isinstance(node, ast.ImportFrom):
        module = node.module or ""
        if module.split(".")[0] not in ("fraclink", "fracsys"):
            return
        for alias in node.names:
            longer = f"{module}.{alias.name}"
            # `from fraclink._design import design` may name a module or a value of
            # the package.
            yield longer if longer in _module_names() else module
