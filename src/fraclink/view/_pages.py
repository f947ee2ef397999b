"""Pages from templates, in which everything from outside is escaped, and the colours of
every drawing.
"""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files

from fraclink import __version__
from fraclink.errors import MissingExtraError
from fraclink.view._tables import proof_sentence, proof_table
from fraclink.view._text import marked, sentence

__all__ = ["DARK", "DASHES", "LIGHT", "LINES", "colours", "literal"]
__all__ += ["rendered", "squeezed", "template_text", "tightened"]

_FOLDER = files("fraclink.view") / "templates"
# What a script is made of, as far as its spaces matter. A template holds at most one
# more inside of it.
_TEMPLATE = (
    r"`(?:\\.|[^`\\$]|\$(?!\{)|\$\{(?:[^`{}]|`(?:\\.|[^`\\])*`|\{[^{}]*\})*\})*`"
)
_PARTS = re.compile(
    r"(?P<comment>//[^\n]*|/\*.*?\*/)|(?P<space>\s+)"
    r"|(?P<text>'(?:\\.|[^'\\\n])*'|\"(?:\\.|[^\"\\\n])*\"|" + _TEMPLATE + r")"
    # Behind a sign that a value follows, with a space or without, a stroke begins a
    # pattern; else it divides.
    r"|(?P<pattern>(?:(?<=[(,=:!&|?])|(?<=[(,=:!&|?] ))"
    r"/(?:\\.|\[(?:\\.|[^\]\\])*\]|[^/\\\n\[])+/)|(?P<code>[\w$]+|.)",
    re.DOTALL,
)


def template_text(name: str) -> str:
    """Return the text of one of the files beside the templates."""
    return (_FOLDER / name).read_text("utf-8")


def squeezed(name: str) -> str:
    """A script or style without indentation and lines of comment: 5 kB, room for two
    more payloads.
    """
    # A comment of several lines is one: its second line, left in, takes the rule behind
    # it along.
    text = re.sub(
        r"^\s*/\*.*?\*/", "", template_text(name), flags=re.DOTALL | re.MULTILINE
    )
    lines = (line.strip() for line in text.splitlines())
    return "".join(f"{line}\n" for line in lines if line and not line.startswith("//"))


def tightened(script: str) -> str:
    """Return a script without its comments, and without the spaces and signs that
    separate nothing.

    It must be written with a semicolon behind every statement but a block, and without
    empty bodies of loops.

    >>> tightened("const a = (b) => { return `${b} + 1`; }; // twice\\n  f( a,\\n  'x y' );\\n")
    "const a=b=>{return`${b} + 1`};f(a,'x y');\\n"
    """
    found, gap = [""], ""
    for part in _PARTS.finditer(script):
        text = part[0]
        if part.lastgroup in ("comment", "space"):
            gap = "\n" if "\n" in text or gap == "\n" else " "
            continue
        # What stands between two tokens is decided when the second is known: a space
        # only between two words or two equal signs, `a - -b`, and a line break only
        # where it may end a statement.
        before, after = found[-1][-1:], text[0]
        if gap == "\n" and _may_end(before, after):
            found.append("\n")
        elif gap and (
            (_is_word(before) and _is_word(after))
            or (before == after and after in "+-")
        ):
            found.append(" ")
        # The last comma of a list and the last semicolon of a block separate nothing.
        # In an empty for (;;) both count, which is why scripts are written without.
        if text in ("}", "]", ")") and found[-1] == ("," if text != "}" else ";"):
            found.pop()
        found.append(text)
        gap = ""
        if (
            found[-5:-4] == ["("]
            and found[-3:] == [")", "=", ">"]
            and not _is_word(found[-6][-1:])
        ):
            del found[-5], found[-3]  # of the one parameter of a function
    return "".join(found) + "\n"


def _may_end(before: str, after: str) -> bool:
    """Whether a line break between these may be all that separates two statements."""
    if before == "}" and _is_word(after):
        return False
    return before not in ";{,([=:?&|<>" and after not in "})],.;:?&|"


def _is_word(character: str) -> bool:
    return character == "$" or character.isalnum() or character == "_"


def rendered(template: str, **contents: object) -> str:
    """Return the page that `template` makes of `contents`; a name that is missing is an
    error.
    """
    try:
        import jinja2
    except ModuleNotFoundError as error:
        raise MissingExtraError("jinja2", "report") from error

    # StrictUndefined: a name misspelled in a template is an error of the test suite,
    # not a blank in a report. autoescape: names of files and columns come from outside.
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
        "proof_sentence": proof_sentence,
        "proof_table": proof_table,
    }
    return environment.get_template(template).render(version=__version__, **contents)


# --- colours, read from the one style sheet ---------------------------------------------------------------

# Dashes [dots] of the lines 0 to 4: where colours are of no use, in grey print, and
# where curves lie on one another. Line 0 is the ink: a reference, a measured signal.
DASHES = ("", "", "7 3", "3 2.5", "9 3 2 3")
LINES = tuple(range(1, len(DASHES)))
LIGHT, DARK = 0, 1


@cache
def colours(theme: int = LIGHT) -> dict[str, str]:
    """Name and hexadecimal value of each colour of a theme.

    >>> colours()["card"], colours(DARK)["card"]
    ('#ffffff', '#131920')
    """
    found = re.findall(
        r"--([\w-]+): light-dark\((#\w{6}), (#\w{6})\)", template_text("palette.css")
    )
    return {name: values[theme] for name, *values in found}


def literal(style: str, theme: int = LIGHT) -> str:
    """Return a style with its colours by value: a drawing that stands alone has no page
    to ask.

    >>> literal("fill:var(--card)")
    'fill:#ffffff'
    """
    known = colours(theme)
    return re.sub(r"var\(--([\w-]+)\)", lambda name: known[name[1]], style)
