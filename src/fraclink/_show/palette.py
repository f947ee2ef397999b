"""The colours of every drawing, read from the one style sheet that pages share."""

from __future__ import annotations

import re
from functools import cache

from fraclink._show.pages import template_text

__all__ = ["DARK", "DASHES", "LIGHT", "LINES", "colours", "literal"]

# Dashes [dots] of the lines 0 to 4: where colours are of no use, in grey print, and where curves lie on one
# another. Line 0 is the ink: a reference, a measured signal.
DASHES = ("", "", "7 3", "3 2.5", "9 3 2 3")
LINES = tuple(range(1, len(DASHES)))
LIGHT, DARK = 0, 1


@cache
def colours(theme: int = LIGHT) -> dict[str, str]:
    """Name and hexadecimal value of each colour of a theme.

    >>> colours()["card"], colours(DARK)["card"]
    ('#ffffff', '#131920')
    """
    found = re.findall(r"--([\w-]+): light-dark\((#\w{6}), (#\w{6})\)", template_text("palette.css"))
    return {name: values[theme] for name, *values in found}


def literal(style: str, theme: int = LIGHT) -> str:
    """Return a style with its colours by value: a drawing that stands alone has no page to ask.

    >>> literal("fill:var(--card)")
    'fill:#ffffff'
    """
    known = colours(theme)
    return re.sub(r"var\(--([\w-]+)\)", lambda name: known[name[1]], style)
