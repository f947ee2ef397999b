"""From the log of a flexible-link robot to the fractional-order controller on its
board.

Public names are loaded when they are first used: ``import fraclink`` itself loads numpy
only. Everything public is an attribute of this module or of `fraclink.errors`; modules
with an underscore are private.
"""

from __future__ import annotations

from fracsys._public import public_names

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
