"""One decorator for every command: it checks the files to be written, calls, shows, and returns the code."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer

from fraclink._cli.console import FAILED, PASSED, emit, emit_json, tell, width
from fraclink._files import output_path
from fraclink._show.records import to_json
from fraclink._show.text import View, plain_text
from fraclink._show.views import view
from fraclink._validate import describe

__all__ = ["Answer", "Writes", "command", "option"]


@dataclass(frozen=True)
class Answer:
    """What a command found: a result that `view` and `to_json` know, or text; and what follows from it.

    text replaces the view and values the JSON; values are added to it otherwise. remarks go to standard error
    and are left out with --json. written are the files; following is the command a user would give next.
    """

    result: Any = None
    passed: bool = True
    text: str | View = ""
    values: dict[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    written: tuple[Path, ...] = ()
    following: str = ""


@dataclass(frozen=True)
class Writes:
    """Marks an option for a path that is written: a file, or a folder with files of these names."""

    names: tuple[str, ...] = ()

    def check(self, place: Path, *, force: bool) -> None:
        """Raise FieldError where a file is already there and must be kept."""
        for path in [place / name for name in self.names] or [place]:
            output_path(path, force=force)


def option(*words: str, range: Any = None, help: str, **more: Any) -> Any:
    """An option whose help states the range that its annotation admits.

    >>> from fraclink._validate import Payload
    >>> option("--payload", range=Payload, help="Payload [kg]").help
    'Payload [kg], > 0 and <= 10000 kg.'
    """
    stated = help if range is None else f"{help}, {describe(range)}."
    return typer.Option(*words, help=stated, **more)


_JSON = Annotated[
    bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")
]
_FORCE = Annotated[bool, typer.Option("--force", help="Overwrite files that are already there.")]


def command(function: Callable[..., Answer]) -> Callable[..., int]:
    """Make a command of a function that returns an Answer: adds --json, and --force where it writes.

    A function that checks its files itself takes `force` as an argument of its own.
    """
    hints = get_type_hints(function, include_extras=True)
    writes = {
        name: mark for name, hint in hints.items() for mark in get_args(hint) if isinstance(mark, Writes)
    }

    @functools.wraps(function)
    def run(*, json: bool = False, force: bool = False, **given: Any) -> int:
        for name, mark in writes.items():
            if given[name] is not None:
                mark.check(given[name], force=force)
        answer = function(**given, **({"force": force} if "force" in hints else {}))
        (_show_json if json else _show_text)(answer)
        return PASSED if answer.passed else FAILED

    one = inspect.Parameter
    kept = [p for p in inspect.signature(function).parameters.values() if p.name != "force"]
    added = {"json": _JSON, **({"force": _FORCE} if writes or "force" in hints else {})}
    run.__annotations__ = {**{p.name: hints[p.name] for p in kept}, **added, "return": int}
    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            *(p.replace(annotation=hints[p.name], kind=one.KEYWORD_ONLY) for p in kept),
            *(one(name, one.KEYWORD_ONLY, default=False, annotation=hint) for name, hint in added.items()),
        ]
    )
    del run.__wrapped__  # typer would read the annotations of what is wrapped
    return run


def _show_json(answer: Answer) -> None:
    values = {} if answer.result is None else to_json(answer.result)
    out: dict[str, Any] = {}
    if answer.written:
        paths = [str(path) for path in answer.written]
        out = {"out": paths if len(paths) > 1 else paths[0]}
    emit_json(values | out | answer.values)


def _show_text(answer: Answer) -> None:
    shown = answer.text or (view(answer.result) if answer.result is not None else "")
    text = plain_text(shown, width()) if isinstance(shown, View) else shown
    if text:
        emit(text)
    for remark in answer.remarks:
        tell(remark)
    for path in answer.written:
        tell(f"written: {path}")
    if answer.following:
        tell(f"next: {answer.following}")
