"""The only package that formats or draws: results as tables, figures and reports."""

from __future__ import annotations

from pathlib import Path

from fracsys._public import public_names

__getattr__, __dir__, __all__ = public_names(
    __name__, Path(__file__).with_suffix(".pyi")
)
