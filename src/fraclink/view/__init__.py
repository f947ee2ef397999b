"""The only package that formats or draws: results as tables, figures and reports."""

from __future__ import annotations

from fracsys._public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
