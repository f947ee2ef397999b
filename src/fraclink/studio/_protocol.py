"""Limits that both ends of the page's connection share."""

from __future__ import annotations

__all__ = ["LONGEST"]

# bytes of a request: a state takes 400, the statements of twelve columns take 2000
LONGEST = 16_384
