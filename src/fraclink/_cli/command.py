"""One decorator for every command: it declares the options, checks, calls, shows, and
returns the code.

What stands beside a parameter's type says everything about its option, once:

    def simulate(payload: Annotated[Payload, "Payload"], out: Annotated[Path, "File",
    Writes()]): ...

A text is the help, a range is checked and added to the help, `Writes` keeps what is
already there, and a `typer.Option` or `typer.Argument` stands where the name alone does
not say how it is written. Keywords of a public function are declared there and nowhere
else: `Keywords` takes type, range, default and help of each from it.
"""

from __future__ import annotations

import copy
import functools
import inspect
import re
import webbrowser
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, get_args, get_origin, get_type_hints, is_typeddict

import typer
from typer.models import OptionInfo, ParameterInfo

from fraclink._cli.console import (
    FAILED,
    PASSED,
    emit,
    emit_json,
    tell,
    tell_written,
    unread_allowed,
    width,
)
from fraclink._files import output_path
from fraclink.findings import Finding
from fraclink.view._text import doubted, plain, plain_text, to_json, view
from fracsys.checks import rule

__all__ = ["Answer", "Keywords", "Writes", "command"]


@dataclass(frozen=True)
class Answer:
    """What a command found: a result with an overview, or text; and what follows from
    it.

    text replaces the overview and values the JSON; values are added to it otherwise. doubts
    are errors of the input that leave nothing shown by the result. remarks go to
    standard error and are left out with --json. written are the files; following is the
    command a user would give next; opened is a page for the browser.
    """

    result: Any = None
    passed: bool = True
    text: str = ""
    values: dict[str, Any] = field(default_factory=dict)
    doubts: tuple[Finding, ...] = ()
    remarks: tuple[str, ...] = ()
    written: tuple[Path, ...] = ()
    following: str = ""
    opened: Path | None = None


@dataclass(frozen=True)
class Writes:
    """Marks an option for a path that is written: a file, or a folder with files of
    these names.
    """

    names: tuple[str, ...] = ()

    def check(self, place: Path, *, force: bool) -> None:
        """Raise FieldError where a file is already there and must be kept."""
        for path in [place / name for name in self.names] or [place]:
            output_path(path, force=force)


@dataclass(frozen=True)
class Declared:
    """One parameter of a command: its plain type for typer, the type with its marks,
    and its default.
    """

    name: str
    kind: Any
    hint: Any
    default: Any

    def mark(self, kind: type) -> Any:
        """The first mark of that class, or None."""
        return next((mark for mark in self._marks if isinstance(mark, kind)), None)

    @property
    def _marks(self) -> tuple[Any, ...]:
        return get_args(self.hint)[1:] if get_origin(self.hint) is Annotated else ()

    @property
    def ranged(self) -> bool:
        """Whether a range stands beside the type."""
        return rule(self.hint).expected != rule(self.kind).expected

    @property
    def help(self) -> str:
        """The text of the help, with the range and with what is true of every list.

        >>> from fracsys.checks import Payload
        >>> Declared("payload", float, Annotated[Payload, "Payload [kg]"], None).help
        'Payload [kg], > 0 and <= 10000 kg.'
        """
        text = (self.mark(str) or "").rstrip(".")
        text += f", {rule(self.hint).expected}" if self.ranged else ""
        return text + (
            "; may be repeated."
            if list in (get_origin(k) for k in get_args(self.kind))
            else "."
        )

    @property
    def parameter(self) -> inspect.Parameter:
        """What typer reads."""
        # A copy, as the mark belongs to a type that several commands share.
        info = copy.copy(self.mark(ParameterInfo) or typer.Option())
        info.help = self.help
        if isinstance(info, OptionInfo) and not info.param_decls:
            word = self.name.replace("_", "-")
            # A flag that is on must have a word that turns it off; one that is off
            # needs none.
            info.param_decls = (
                (f"--{word}/--no-{word}",) if self.default is True else (f"--{word}",)
            )
        hint = Annotated[self.kind, info]  # type: ignore[name-defined]  # made at run time
        return inspect.Parameter(
            self.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=self.default,
            annotation=hint,
        )


_JSON = Declared(
    "json", bool, Annotated[bool, "Print the result as one JSON object"], False
)
_FORCE = Declared(
    "force", bool, Annotated[bool, "Overwrite files that are already there"], False
)


class Keywords:
    """Options of a command that are keywords of a public function, or of a TypedDict of
    them: type, range and default are those of its signature, the help those of its
    docstring.
    """

    def __init__(self, function: Callable[..., Any], *names: str) -> None:
        self.function, self.names = function, names

    def of(self, options: dict[str, Any]) -> dict[str, Any]:
        """Those of `options` that are keywords of the function."""
        return {name: options[name] for name in self.names}

    @property
    def declared(self) -> Iterator[Declared]:
        """The options."""
        texts = _parameter_texts(self.function)
        for each in _parameters(self.function, self.names):
            yield replace(each, hint=Annotated[each.hint, texts[each.name]])


def _parameter_texts(function: Callable[..., Any]) -> dict[str, str]:
    """The first sentence that a numpydoc docstring says of each parameter."""
    _, _, section = (inspect.getdoc(function) or "").partition("Parameters\n----------")
    section = section.partition("\n----")[0]
    texts: dict[str, str] = {}
    for names, text in re.findall(
        r"^(\w[\w, ]*)\n((?: +.*\n|\n(?= ))+)", section, re.M
    ):
        text = " ".join(text.split()).replace("``", "`")
        sentence = re.split(r"\. (?=[A-Z])", text)[0]
        # A symbol such as ω_c or n keeps its case.
        word = sentence.partition(" ")[0]
        if word.isascii() and word.isalpha() and len(word) > 1:
            sentence = sentence[0].upper() + sentence[1:]
        texts |= dict.fromkeys(names.split(", "), sentence)
    return texts


def _parameters(
    function: Callable[..., Any], names: Iterable[str] | None = None
) -> Iterator[Declared]:
    """The parameters of these names, or all; keywords as `Keywords` declares them."""
    if is_typeddict(function):
        hints = get_type_hints(function, include_extras=True)
        kinds = get_type_hints(function)
        for name in names or hints:
            yield Declared(name, kinds[name], hints[name], None)
        return
    parameters = inspect.signature(function).parameters
    # Only what is asked for is evaluated: other annotations of a library's function may
    # name what is imported for the type checker alone.
    source: Any = inspect.unwrap(function)
    wanted = {name: source.__annotations__[name] for name in names or parameters}
    annotated = SimpleNamespace(__annotations__=wanted)
    kinds = get_type_hints(annotated, source.__globals__)
    hints = get_type_hints(annotated, source.__globals__, include_extras=True)
    for name, hint in hints.items():
        if parameters[name].kind is not inspect.Parameter.VAR_KEYWORD:
            yield Declared(name, kinds[name], hint, parameters[name].default)
            continue
        for keywords in get_args(hint)[1:]:
            yield from keywords.declared


def command(app: typer.Typer) -> Callable[[Callable[..., Answer]], Callable[..., int]]:
    """Add a function that returns an Answer to `app`, with --json, and with --force
    where it writes.

    A function that checks its files itself takes `force` as an argument of its own.
    """
    return lambda function: app.command()(_command(function))


def _command(function: Callable[..., Answer]) -> Callable[..., int]:
    # Every command that writes has --force; where the command checks its files itself
    # it also hears of it.
    declared = [part for part in _parameters(function) if part.name != "force"]
    own_force = "force" in inspect.signature(function).parameters
    writes = {part.name: mark for part in declared if (mark := part.mark(Writes))}
    ranges = {part.name: rule(part.hint) for part in declared if part.ranged}
    # A command that writes nothing has no --force, which would promise something.
    added = [_JSON, _FORCE] if writes or own_force else [_JSON]

    @functools.wraps(function)
    def run(*, json: bool = False, force: bool = False, **given: Any) -> int:
        # Ranges before files before work: a typing error must not cost the minute that
        # the work takes.
        for name, allowed in ranges.items():
            if given[name] is not None:
                given[name] = allowed.check(name, given[name])
        for name, mark in writes.items():
            if given[name] is not None:
                # Before the work and not when it is written: what cannot be kept is not
                # computed.
                mark.check(given[name], force=force)
        answer = function(**given, **({"force": force} if own_force else {}))
        with unread_allowed():
            (_show_json if json else _show_text)(answer)
        if answer.opened and not webbrowser.open(answer.opened.resolve().as_uri()):
            tell(f"no browser was found; open {answer.opened} yourself")
        # Doubts are errors of the input: a result that rests on them shows nothing,
        # however well it came out.
        return PASSED if answer.passed and not answer.doubts else FAILED

    parameters = [part.parameter for part in (*declared, *added)]
    run.__annotations__ = {p.name: p.annotation for p in parameters} | {"return": int}
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    del run.__wrapped__  # typer would read the annotations of what is wrapped
    return run


def _show_json(answer: Answer) -> None:
    values = {} if answer.result is None else to_json(answer.result)
    if answer.doubts:
        # The input's doubts first: they are why the rest is to be distrusted.
        values["findings"] = [*map(plain, answer.doubts), *values.get("findings", ())]
    paths = [str(path) for path in answer.written]
    # One file is a string, as most commands write one; scripts read `out` without an
    # index.
    out: dict[str, Any] = (
        {"out": paths if len(paths) > 1 else paths[0]} if paths else {}
    )
    # What the command adds by itself has the last word, such as "out": null of a proof
    # that failed.
    emit_json(values | out | answer.values)


def _show_text(answer: Answer) -> None:
    shown = answer.text
    if not shown and answer.result is not None:
        shown = plain_text(doubted(view(answer.result), answer.doubts), width())
    if shown:
        emit(shown)
    for remark in answer.remarks:
        tell(remark)
    for path in answer.written:
        tell_written(path)
    if answer.following:
        tell(f"next: {answer.following}")
