"""Fractional systems: transfer functions in powers of s, responses, roots, stability,
margins and rational approximations. Nothing in it is specific to robots.

>>> import fracsys
>>> G = 100 / (fracsys.s**1.92 + 100)
>>> fracsys.is_stable(G).stable
True
"""

from __future__ import annotations

from fracsys._public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
