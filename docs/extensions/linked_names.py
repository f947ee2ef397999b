"""Turns names of fraclink in running text into links; a name that does not exist fails
the build.

`fl.design`, `fraclink.extend.Beam(…)` and `Design.sampled_at` between backticks are
looked up. Names that begin with `fl.` or `fraclink.` must be in the reference:
otherwise Sphinx's nitpicky mode reports an undefined symbol. A bare name is linked if
it is at the root of the package, and left unchanged otherwise.
"""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from importlib.util import find_spec

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

import fraclink

NAME = r"[A-Za-z_]\w*"
CALL = re.compile(
    rf"((?P<root>fl|fraclink)\.)?(?P<path>{NAME}(\.{NAME})*)(?P<call>\(.*\))?",
    re.DOTALL,
)
FILE = re.compile(r"\.(py|toml|md|csv|html|json)$")


def target_of(text: str) -> str | None:
    """The full name that a literal means, None where it is not one of this package."""
    found = CALL.fullmatch(text)
    if not found or FILE.search(text):
        return None
    path = found["path"]
    if found["root"]:
        place = path not in fraclink.__all__ and is_module(f"fraclink.{path}")
        return None if place else entry_of(path)
    head, *rest = path.split(".")
    known = head in fraclink.__all__ and (head[0].isupper() or found["call"])
    if not known:
        return None
    value = getattr(fraclink, head)
    there = not rest or hasattr(value, rest[0]) or rest[0] in fields_of(value)
    return entry_of(path) if there else None


def entry_of(path: str) -> str:
    """The entry of the reference that describes a name: a field is described with its
    class.
    """
    head, _, last = path.rpartition(".")
    if (
        path.startswith("_")
        and last in fraclink.__all__
        and is_module(f"fraclink.{head}")
    ):
        return f"fraclink.{last}"  # its module is private, its name is public
    if last in fields_of(getattr(fraclink, head, None)):
        return f"fraclink.{head}"
    return f"fraclink.{path}"


def fields_of(value: object) -> tuple[str, ...]:
    """The names of a data class's fields, none for anything else."""
    return tuple(field.name for field in fields(value)) if is_dataclass(value) else ()


def is_module(name: str) -> bool:
    """Whether this is a module: prose may name one without an entry in the reference."""
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def link_names(app: Sphinx, tree: nodes.document) -> None:
    """Put a reference around every literal that names something of fraclink."""
    for literal in list(tree.findall(nodes.literal)):
        target = target_of(literal.astext())
        if target is None or isinstance(
            literal.parent, nodes.reference | addnodes.pending_xref
        ):
            continue
        link = addnodes.pending_xref(
            "",
            refdomain="py",
            reftype="obj",
            reftarget=target,
            refexplicit=True,
            refwarn=True,
            refdoc=app.env.docname,
        )
        link.source, link.line = literal.source, literal.line
        literal.replace_self(link)
        link += literal


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("doctree-read", link_names)
    return {"parallel_read_safe": True}
