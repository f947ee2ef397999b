"""Pages from templates, in which all external data are escaped, and the colours of all
drawings.
"""

from __future__ import annotations

import base64
import hashlib
import re
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable

from fraclink._display import marked
from fraclink.errors import MissingExtraError
from fraclink.view._text import grid_of, sentence

__all__ = ["ARM_SCRIPTS", "DARK", "DASHES", "LIGHT", "LINES", "colours", "literal"]
__all__ += ["rendered", "scoped", "squeezed", "template_text"]

_FOLDER = files("fraclink.view") / "templates"
ARM_SCRIPTS = ("arm_engine.js", "arm_drawing.js", "arm_page.js")


def template_text(name: str) -> str:
    """Return the text of one of the files next to the templates."""
    return (_FOLDER / name).read_text("utf-8")


def squeezed(name: str, folder: Traversable = _FOLDER) -> str:
    """Return a script or style without indentation and comment lines, which are a sixth
    of it; `folder`: by default that of the templates.
    """
    # Comments of several lines go as a whole: a second line left in would disable the
    # rule after it.
    text = re.sub(
        r"^\s*/\*.*?\*/",
        "",
        (folder / name).read_text("utf-8"),
        flags=re.DOTALL | re.MULTILINE,
    )
    lines = (line.strip() for line in text.splitlines())
    return "".join(f"{line}\n" for line in lines if line and not line.startswith("//"))


def scoped(*names: str) -> str:
    """Return scripts as one, preceded by the drawing helpers that they use, with names
    that no other script of the page sees.
    """
    body = re.sub(
        r"^(import .*\n|export )",
        "",
        "".join(map(squeezed, ("svg.js", *names))),
        flags=re.MULTILINE,
    )
    return f"(async () => {{\n'use strict';\n{body}}})();\n"


def _hash_of(text: str) -> str:
    """The hash by which a policy allows a script or a style."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def rendered(template: str, **contents: object) -> str:
    """Return the page from `template` with `contents`; a missing name is an error."""
    try:
        import jinja2
    except ModuleNotFoundError as error:
        raise MissingExtraError("jinja2", "report") from error

    # StrictUndefined: a misspelled name in a template fails in the test suite instead
    # of leaving a blank in a report. autoescape: names of files and columns come from
    # outside.
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(template_text),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "sentence": sentence,
        "marked": marked,
        "grid": grid_of,
        "hash": _hash_of,
    }
    return environment.get_template(template).render(
        version=version("fraclink"), **contents
    )


# --- colours, read from the one style sheet ---------------------------------------------------------------

# Dash patterns [dots] of the lines 0 to 4, for grey prints and for curves that
# coincide. Line 0 is black ink: a reference or a measured signal.
DASHES = ("", "", "7 3", "3 2.5", "9 3 2 3")
LINES = tuple(range(1, len(DASHES)))
LIGHT, DARK = 0, 1


@cache
def colours(theme: int = LIGHT) -> dict[str, str]:
    """Name and hexadecimal value of each colour of a theme.

    >>> colours()["card"], colours(DARK)["card"]
    ('#ffffff', '#131920')
    """
    pairs = re.findall(
        r"--([\w-]+): light-dark\((#\w{6}), (#\w{6})\)", template_text("palette.css")
    )
    return {name: values[theme] for name, *values in pairs}


def literal(style: str, theme: int = LIGHT) -> str:
    """Return a style with literal colours, since a separate drawing has no page that
    defines them.

    >>> literal("fill:var(--card)")
    'fill:#ffffff'
    """
    values = colours(theme)
    return re.sub(r"var\(--([\w-]+)\)", lambda name: values[name[1]], style)
