"""What the guards share: the package's sources as syntax trees."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "src" / "fraclink"


@dataclass(frozen=True)
class Source:
    """One module: its dotted name below ``fraclink``, its path and text."""

    name: str
    path: Path
    text: str

    @property
    def tree(self) -> ast.Module:
        """Parsed anew each time, a second for all: kept, the trees of the package take
        100 MB.
        """
        return ast.parse(self.text, filename=str(self.path))

    @property
    def component(self) -> str:
        """First part of the dotted name: what a floor is assigned to."""
        return self.name.partition(".")[0]


@cache
def sources() -> tuple[Source, ...]:
    """Every module of the package."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        parts = parts[:-1] if parts[-1] == "__init__" else parts
        found.append(Source(".".join(parts), path, path.read_text(encoding="utf-8")))
    return tuple(found)


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


def imported_modules(source: Source, *, at_once: bool = False) -> Iterator[str]:
    """Modules of fraclink that a module imports, without the prefix.

    At its top or inside a function; with `at_once` at its top only.
    """
    names = {item.name for item in sources()}
    tree = source.tree  # one for all three: nodes are told apart by their identity
    hidden = _typing_only(tree) | (_inside_functions(tree) if at_once else set())
    for node in ast.walk(tree):
        if id(node) in hidden:
            continue
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.startswith("fraclink."):
                    yield alias.name.removeprefix("fraclink.")
        elif (
            isinstance(node, ast.ImportFrom)
            and node.module
            and node.module.split(".")[0] == "fraclink"
        ):
            base = node.module.removeprefix("fraclink").removeprefix(".")
            for alias in node.names:
                longer = f"{base}.{alias.name}".removeprefix(".")
                # `from fraclink._design import design` may name a module or a value of
                # the package.
                yield longer if longer in names else base
