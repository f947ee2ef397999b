"""What both ends of the page's connection agree on before a message is read."""

from __future__ import annotations

__all__ = ["LONGEST"]

# bytes of a request: a state takes 400, the statements of twelve columns 2000
LONGEST = 16_384
