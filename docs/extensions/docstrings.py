"""Prepares the docstrings of the source for Sphinx.

They are plain text with formulas, written mainly for `help()`. Sphinx would misread a
paragraph after the last section in numpy style, a colon in the first line of a
property, and a bar or an asterisk in a formula. All three are corrected before napoleon
reads the docstrings.
"""

from __future__ import annotations

import inspect
import re
from typing import is_typeddict

from sphinx.application import Sphinx

# The handler of napoleon has Sphinx's default priority of 500.
BEFORE_NAPOLEON = 400
SECTION = re.compile(r"(Parameters|Returns|Raises|Attributes)$")
ARRAY = re.compile(
    r"~?numpy\.ndarray\[tuple\[(~typing\.)?Any, \.\.\.\], ~?numpy\.dtype\[(?P<kind>.*?)\]\]"
)
ALIAS = re.compile(r"TypeAliasForwardRef\('(?P<name>\w+)'\)")
TITLES = {"Source:": "References", "Sources:": "References", ">>>": "Examples"}


def end_sections(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Give "Source: …" and an example after the last section a title: napoleon would
    take them for entries of that section.
    """
    if what in ("property", "attribute", "data"):
        # an empty comment: the words before a colon in the first line would be taken as
        # a type
        lines[:0] = ["..", ""]
        return
    inside = False
    ready: list[str] = []
    for number, line in enumerate(lines):
        following = lines[number + 1] if number + 1 < len(lines) else ""
        if set(following) == {"-"}:
            inside = bool(SECTION.match(line))
        start = next((start for start in TITLES if line.startswith(start)), None)
        if inside and start and not lines[number - 1]:
            ready += [TITLES[start], "-" * len(TITLES[start])]
            inside = start != ">>>"
        ready.append(line)
    lines[:] = ready


def plain_text(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """A bar in |L(jω)| must not begin a substitution, nor a star in θt* or *.toml an
    emphasis.
    """
    example = False
    for number, line in enumerate(lines):
        example = line.lstrip().startswith(">>>") or (example and bool(line.strip()))
        if not example:
            parts = re.split(r"(``.*?``|`[^`]*`)", line)
            lines[number] = "".join(
                part if part.startswith("`") else re.sub(r"[|*]", r"\\\g<0>", part)
                for part in parts
            )


def short_signature(
    app: Sphinx,
    what: str,
    name: str,
    obj: type,
    options: object,
    signature: str | None,
    return_annotation: str | None,
) -> tuple[str | None, str | None]:
    """The fields of a class by name: types and ranges follow below, the annotations
    would fill a page.
    """
    if what != "class":
        return short_arrays(signature), short_arrays(return_annotation)
    if is_typeddict(obj):
        return f"({', '.join(f'{key}=…' for key in obj.__annotations__)})", None
    fields = inspect.signature(obj).parameters.values()
    shown = [
        field.name + ("" if field.default is field.empty else "=…") for field in fields
    ]
    return f"({', '.join(shown)})", None


def short_arrays(annotations: str | None) -> str | None:
    """Arrays by the names that numpy.typing gives them; an arbitrary shape says
    nothing.
    """
    return annotations and ALIAS.sub(
        r"\g<name>", ARRAY.sub(r"NDArray[\g<kind>]", annotations)
    )


def no_alias(
    app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object
) -> bool | None:
    """Leave out the fields of a named tuple: "Alias for field number 0" says nothing."""
    return (
        True
        if (getattr(obj, "__doc__", None) or "").startswith("Alias for field")
        else None
    )


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("autodoc-process-signature", short_signature)
    app.connect("autodoc-skip-member", no_alias)
    app.connect("autodoc-process-docstring", plain_text, priority=BEFORE_NAPOLEON)
    app.connect("autodoc-process-docstring", end_sections, priority=BEFORE_NAPOLEON)
    return {"parallel_read_safe": True}
