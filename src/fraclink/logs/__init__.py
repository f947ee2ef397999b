"""Logs without a description: diagnosis, and a first model by matching columns or
asking.
"""

from __future__ import annotations

from fracsys._public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
