"""Which classes have a file: those that say so by `document`, and every other public
one, JSON or NPZ.

A class that `document` names has a format of its own, with a version. The
other public results (margins of a matrix, a step response, tolerances …) are written by
their fields, under the class's name.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, TypeVar

from fraclink.errors import FieldError, FileFormatError

__all__ = ["HOMES", "Document", "document", "document_of", "registered"]

T = TypeVar("T")
Container = Literal["json", "npz", "toml", "either"]
# Whose public classes may be saved.
PACKAGES = (
    "fraclink",
    "fracsys",
    *(f"fraclink.{name}" for name in ("extend", "logs", "lab", "trials", "view")),
)
# Kind -> module that defines its class, so that reading one file imports what that file
# needs and no more.
HOMES = {
    **dict.fromkeys(("campaign", "sweep"), "fraclink.trials._campaign"),
    "certificate": "fraclink._certify",
    "comparison": "fraclink.trials._tournament",
    "design": "fraclink._law.design",
    "fault-campaign": "fraclink.trials._faults",
    **dict.fromkeys(("driven-link", "fit", "structure-fit"), "fraclink._identify"),
    "realtime-run": "fraclink.lab._run",
    "served-arm": "fraclink.lab._arm",
    "run": "fraclink._simulate",
    "fractional-pid": "fraclink._arm.fractional_pid",
    "log": "fraclink._arm.experiment",
    "margins": "fraclink._arm.controller",
    "model": "fraclink._arm.link",
    "law": "fraclink._law",
    "pid-tuning": "fraclink._design.pid_tuning",
    **dict.fromkeys(("frequency-response", "recording"), "fraclink._arm.recording"),
    "reference": "fraclink._arm.controller",
    "rig": "fraclink._arm.rig",
    "shaped-move": "fraclink._simulate.shaped_move",
    "study": "fraclink.trials._study",
    **dict.fromkeys(
        ("tuning", "tuned-link", "tuned-motor", "watch", "wiring"),
        "fraclink.lab._watch",
    ),
}


@dataclasses.dataclass(frozen=True)
class Document:
    """What `document` states about a class."""

    cls: type
    kind: str
    version: int
    container: Container
    hex_floats: bool
    period: Callable[[Any], float | None]
    sources: Callable[[Any], Mapping[str, str]]
    summary: Callable[[Any], Mapping[str, Any]]
    before_save: Callable[[Any], None]
    own: bool


# Public classes that are no values: an open connection, an arm that moves.
_NO_VALUES = {"Callback", "Serial", "SimulatedArm", "Udp"}

_BY_KIND: dict[str, Document] = {}
_BY_CLASS: dict[type, Document] = {}


def document(
    kind: str,
    *,
    version: int = 1,
    container: Container = "json",
    hex_floats: bool = False,
    period: Callable[[Any], float | None] = lambda value: None,
    sources: Callable[[Any], Mapping[str, str]] = lambda value: {},
    summary: Callable[[Any], Mapping[str, Any]] = lambda value: {},
    before_save: Callable[[Any], None] = lambda value: None,
    own: bool = False,
) -> Callable[[type[T]], type[T]]:
    """Register a frozen dataclass as a document of `kind`; put this decorator above
    ``@dataclass``.

    Raise `version` whenever a stored field is renamed, removed or means something else;
    a new field with a default needs no new one, as a file without it means the default.

    Parameters
    ----------
    kind
        the word in the file; add it to `HOMES` above.
    version
        of the content's format.
    container
        "json", or "npz" for signals, whose arrays become members of the archive.
    hex_floats
        whether reals are written as 0x1.8p+1, for readers that must not depend on a
        decimal parser.
    period
        the sampling period of a value [s], for the envelope; None where it has none.
    sources
        what a value was made from: name -> SHA-256.
    summary
        what people and other programs want to read in the file and what follows from
        the content, such as a verdict's sentence: under the digest, not read back.
    before_save
        raises where a value must not be saved.
    own
        whether the class's methods `save` and `load` write and read the file
        themselves.
    """

    def register(cls: type[T]) -> type[T]:
        hooks = (period, sources, summary, before_save)
        made = Document(cls, kind, version, container, hex_floats, *hooks, own)
        _BY_KIND[kind] = _BY_CLASS[cls] = made
        return cls

    return register


def document_of(value: object) -> Document:
    """The document of a value's class; FieldError for one that has no file."""
    return document_of_class(type(value))


def document_of_class(cls: type) -> Document:
    """The document of a class; FieldError for one whose values have no file."""
    if (
        cls not in _BY_CLASS
    ):  # of a room below this one, or of none: the refusal names all there are
        for home in filter(_installed, sorted(set(HOMES.values()))):
            import_module(home)
    found = _BY_CLASS.get(cls) or _plain(cls)
    if found is None:
        allowed = ", ".join(sorted(item.__name__ for item in _BY_CLASS))
        remedy = "save one of these, or another public result"
        raise FieldError(
            "value",
            cls.__name__,
            "without a file format",
            allowed=allowed,
            remedy=remedy,
        )
    return found


def _installed(module: str) -> bool:
    """Whether the package of a module is here: a copy of the core has no satellites."""
    return find_spec(module.rpartition(".")[0]) is not None


def _kind(name: str) -> str:
    """PidStep -> pid-step."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", name).lower()


def _public(name: str | Callable[[str], bool]) -> list[Any]:
    """The public values of that name, in any package that is installed.

    By name and at call time: this floor knows nothing of those above it.
    """
    wanted = name.__eq__ if isinstance(name, str) else name
    values = []
    for package in PACKAGES:
        if find_spec(package) is not None:
            module = import_module(package)
            values += [getattr(module, key) for key in module.__all__ if wanted(key)]
    return values


def _plain(cls: type) -> Document | None:
    """The document of a public class that names no format; None for what is no value."""
    # The object itself, not its name: a user's class called Design is no result of
    # fraclink.
    if cls not in _public(cls.__name__) or cls.__name__ in _NO_VALUES:
        return None
    if not dataclasses.is_dataclass(cls) and not hasattr(cls, "_fields"):
        return None
    kind = _kind(cls.__name__)
    if (
        cls not in _BY_CLASS and kind in _BY_KIND
    ):  # a part of it has that name: a study is a folder of files
        return None
    if cls not in _BY_CLASS:
        own = hasattr(cls, "save") and hasattr(cls, "load")
        document(kind, container="either", own=own)(cls)
    return _BY_CLASS[cls]


def registered(kind: object, wanted: tuple[type, ...], place: Path) -> Document:
    """Return the document of a kind, whose module is imported where that has not
    happened.
    """
    # The word comes from a file that may be hostile: it selects a module from a list
    # and is never itself imported.
    if (
        isinstance(kind, str)
        and kind not in _BY_KIND
        and kind in HOMES
        and _installed(HOMES[kind])
    ):
        import_module(HOMES[kind])
    if isinstance(kind, str) and kind not in _BY_KIND:
        # Functions stand in the packages as well: `design` reads as the kind of
        # `Design`.
        for value in _public(lambda name: _kind(name) == kind):
            if isinstance(value, type):
                _plain(value)
    # JSON may hold a list here, which no dict can be asked for.
    found = _BY_KIND.get(kind) if isinstance(kind, str) else None
    allowed = ", ".join(sorted({*HOMES, *_BY_KIND}))
    # Whatever else may be saved is of no use to who expected one kind: the answer names
    # that.
    if found is not None and wanted and found.cls not in wanted:
        allowed = " or ".join(
            _BY_CLASS[cls].kind if cls in _BY_CLASS else cls.__name__ for cls in wanted
        )
        found = None
    if found is None:
        problem, remedy = f"of kind {str(kind)[:40]!r}", "give another file"
        raise FileFormatError(
            "file", place.name, problem, allowed=allowed, remedy=remedy
        )
    return found
