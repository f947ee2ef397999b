"""The classes that can be saved, as JSON or NPZ: those registered by `document`, and
every other class of fraclink with fields.

A class registered by `document` has its own format with a version. The other results
(margins, a step response, metrics …) are written field by field, under the name of the
class.
"""

from __future__ import annotations

import contextlib
import dataclasses
import re
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal, TypeVar

from fraclink.errors import FieldError

T = TypeVar("T")
Container = Literal["json", "npz", "toml", "either"]
# Importing the public names of these packages loads all classes of results.
PACKAGES = (
    "fraclink",
    "fracsys",
    *(f"fraclink.{name}" for name in ("extend", "logs", "lab", "trials", "view")),
)

_DOCUMENTS: dict[type, document] = {}


def _period_of(value: Any) -> float | None:
    period = getattr(value, "period", None)
    return None if period is None else float(period)


def _sources_of(value: Any) -> dict[str, str]:
    digest = value.sha256 if hasattr(value, "source") else ""
    return {value.source: digest} if digest else {}


def _verdict_of(value: Any) -> dict[str, bool]:
    return {"passed": value.passed} if hasattr(value, "passed") else {}


@dataclasses.dataclass(frozen=True)
class document:
    """Register a frozen dataclass as a document of `kind`; put this decorator above
    ``@dataclass``.

    Raise `version` whenever a stored field is renamed, removed or means something else;
    a new field with a default needs no new version: a file without it has the default.

    Parameters
    ----------
    kind
        the word in the file.
    version
        of the content's format.
    container
        "json", or "npz" for signals, whose arrays become members of the archive; with
        "either", the file's ending decides between them. A class whose file people write
        ("toml") has methods `save` and `load` of its own.
    hex_floats
        whether reals are written as 0x1.8p+1, for readers that must not depend on a
        decimal parser.
    period
        the sampling period of a value [s], for the envelope; by default its own, or
        None.
    sources
        what a value was made from: name -> SHA-256; by default the file that its
        `source` names.
    summary
        what follows from the content and helps people and programs that read the file,
        such as a verdict's sentence: covered by the digest, not read back. By default
        whether the value passed.
    """

    kind: str
    version: int = 1
    container: Container = "json"
    hex_floats: bool = False
    period: Callable[[Any], float | None] = _period_of
    sources: Callable[[Any], Mapping[str, str]] = _sources_of
    summary: Callable[[Any], Mapping[str, Any]] = _verdict_of

    def __call__(self, cls: type[T]) -> type[T]:
        """Return the class, registered."""
        _DOCUMENTS[cls] = self
        return cls


def document_of(cls: type) -> document:
    """Return the document of a class; FieldError for a class that cannot be saved."""
    if cls not in _DOCUMENTS:
        # The class itself, not its name: a user's class called Design is not a result
        # of fraclink.
        kind = _kind(cls.__name__)
        if not _is_result(cls) or _registered(kind):
            raise FieldError(
                "value",
                cls.__name__,
                "without a file format",
                "a result of fraclink",
                "save what a public function returned",
            )
        document(kind, container="either")(cls)
    return _DOCUMENTS[cls]


def class_of(kind: object) -> type | None:
    """Return the class of a kind of file, or None.

    The kind comes from a file that may be hostile: it is compared with those of the
    classes, and never imported itself.
    """
    # Importing every package takes a second: the classes already loaded are searched
    # first, then names like the kind, then all names.
    for asked in ("none", "alike", "all"):
        for package in filter(find_spec, PACKAGES if asked != "none" else ()):
            module = import_module(package)
            for name in (
                n for n in module.__all__ if asked == "all" or _kind(n) == kind
            ):
                # a copy of the core lacks the packages around it
                with contextlib.suppress(ModuleNotFoundError):
                    getattr(module, name)
        for cls in _results():
            if _kind(cls.__name__) == kind and not _registered(kind):
                document_of(cls)
        if matching := _registered(kind):
            return matching
    return None


def _kind(name: str) -> str:
    """PidStep -> pid-step."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", name).lower()


def _registered(kind: object) -> type | None:
    matching = (cls for cls, each in _DOCUMENTS.items() if each.kind == kind)
    return next(matching, None)


def _is_result(cls: type) -> bool:
    """Whether a class with fields is fraclink's own."""
    own = cls.__module__.partition(".")[0] in ("fraclink", "fracsys")
    return own and (dataclasses.is_dataclass(cls) or hasattr(cls, "_fields"))


def _results() -> list[type]:
    """The classes of results in all loaded modules.

    Found by name at call time: this layer must not depend on those above it.
    """
    own = ("fraclink", "fracsys")
    modules = [module for name, module in sys.modules.items() if name.startswith(own)]
    values = [value for module in modules for value in vars(module).values()]
    return [each for each in values if isinstance(each, type) and _is_result(each)]
