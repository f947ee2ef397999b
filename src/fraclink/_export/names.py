"""Names and titles that go into generated C: checked, never escaped."""

from __future__ import annotations

import re

from fraclink.errors import FieldError

__all__ = ["identifier", "title_text"]

_KEYWORDS = frozenset(
    (  # noqa: SIM905 - words read better than quotes
        "auto break case char const continue default do double else enum extern float for goto if inline "
        "int long register restrict return short signed sizeof static struct switch typedef union unsigned "
        "void volatile while main "
        # C++ compilers read the header too
        "asm bool catch class delete explicit export false friend mutable namespace new operator private "
        "protected public template this throw true try typename using virtual"
    ).split()
)


def identifier(field: str, name: object) -> str:
    """Return `name` if C takes it as an identifier: a letter, then letters, digits or _, at most 31, no
    keyword.

    >>> identifier("name", "arm_law")
    'arm_law'
    """
    # 31 characters is what C99 guarantees for external names; a leading _ belongs to the compiler.
    fits = isinstance(name, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,30}", name) is not None
    if not isinstance(name, str) or not fits or name in _KEYWORDS:
        raise FieldError(
            field,
            name,
            "not a C identifier",
            allowed="a letter, then letters, digits or _, at most 31, no keyword",
            remedy="choose a name such as law_data",
        )
    if name.lower().startswith("law_") and name != "law_data":
        raise FieldError(
            field, name, "in the law's own name space", allowed="another prefix", remedy="e.g. arm_law"
        )
    return name


def title_text(title: object) -> str:
    """Return `title` if it cannot end or change the comment it stands in.

    >>> title_text("Arm 2, 20-40 g")
    'Arm 2, 20-40 g'
    """
    if not isinstance(title, str) or not re.fullmatch(r"[A-Za-z0-9 .,:()+=-]{0,80}", title):
        raise FieldError(
            "title",
            title,
            "not plain text",
            allowed="at most 80 of letters, digits, space and . , : ( ) + = -",
            remedy="use a plain title; it is written into a C comment",
        )
    return title
