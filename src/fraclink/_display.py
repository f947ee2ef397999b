"""Results in a prompt and in a notebook: the classes name nothing, `fraclink.view`
knows how each looks.

A class of results lies floors below what draws it. Its methods therefore look their
template up when they are called, so that neither a table nor matplotlib is loaded with
the class.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any, TypeVar

__all__ = ["displayed"]

Kind = TypeVar("Kind", bound=type)


def _template(name: str) -> Callable[[Any], Any] | None:
    # By name and not imported above: this module lies floors below `view`, which loads
    # matplotlib, and which a copy of the core does not have.
    if find_spec("fraclink.view") is None:
        return None
    template: Callable[[Any], Any] = getattr(
        import_module("fraclink.view._notebook"), name
    )
    return template


def _repr(result: Any) -> str:
    short = _template("short")
    return f"{type(result).__name__}(...)" if short is None else str(short(result))


def _repr_html(result: Any) -> str | None:
    page_part = _template("page_part")
    return None if page_part is None else str(page_part(result))


def _repr_svg(result: Any) -> str | None:
    drawing = _template("drawing")
    return None if drawing is None else drawing(result)


def displayed(kind: Kind) -> Kind:
    """Give a class of results a short repr, and to notebooks its table and, where there
    is one, its drawing.

    A repr of the class's own is kept; the one that `dataclass` generates prints every
    sample of an array.

    >>> import fraclink as fl
    >>> fl.Rig.named("paper-2023")
    Rig(paper-2023)
    """
    # A repr of the class's own is what its author wants in a prompt; only dataclass's
    # is replaced.
    if kind.__dataclass_params__.repr:  # type: ignore[attr-defined]
        kind.__repr__ = _repr  # type: ignore[assignment]
    kind._repr_html_ = _repr_html  # type: ignore[attr-defined]
    kind._repr_svg_ = _repr_svg  # type: ignore[attr-defined]
    return kind
