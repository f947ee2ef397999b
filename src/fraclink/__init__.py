"""From the log of a flexible-link robot to the fractional-order controller on its
board.

Public names are loaded when they are first used: ``import fraclink`` itself loads numpy
only. Everything public is an attribute of this module or of `fraclink.errors`; modules
with an underscore are private.
"""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

__version__ = "0.2.0"

# Public name -> module that defines it, as the stub says it to editors and type
# checkers: the only list.
_STUB = Path(__file__).with_suffix(".pyi").read_text("utf-8")
_HOME = {
    alias.name: node.module
    for node in ast.parse(_STUB).body
    if isinstance(node, ast.ImportFrom) and node.module and node.module != "fraclink"
    for alias in node.names
}

__all__ = sorted(["__version__", *_HOME])


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
        # Found once, it is an attribute like any other: __getattr__ is asked only for
        # what is missing.
        globals()[name] = value
        return value
    raise AttributeError(f"module 'fraclink' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
