"""From the log of a flexible-link robot to the fractional-order controller on its board.

Public names are loaded when they are first used: ``import fraclink`` itself loads numpy only.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

# Public name -> module that defines it. tests/test_public_names.py guards the list.
_HOME: dict[str, str] = {}

__all__ = sorted(["__version__", *_HOME])


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'fraclink' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
