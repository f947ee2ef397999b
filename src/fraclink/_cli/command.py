"""One decorator for every command: it declares the options, checks, calls, shows, and
returns the code.

The annotation of a parameter contains everything about its option:

    def simulate(payload: Annotated[Payload, "Payload"], out: Annotated[Path, "File",
    Writes()]): ...

A string is the help, a range is checked and added to the help, `Writes` protects
existing files, and a `typer.Option` or `typer.Argument` is given if the name alone does
not determine the spelling. Keywords of a public function are declared there and nowhere
else: `Keywords` takes type, range, default and help of each from it.
"""

from __future__ import annotations

import copy
import functools
import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer
from typer.models import OptionInfo, ParameterInfo

from fraclink._cli.console import (
    FAILED,
    PASSED,
    emit,
    emit_json,
    tell,
    unread_allowed,
    width,
)
from fraclink._files import output_path
from fraclink.findings import Finding
from fraclink.view._text import doubted, plain, plain_text, to_json, view
from fracsys.checks import Parameter, parameters, rule


@dataclass(frozen=True)
class Answer:
    """What a command prints: the overview of a result, or a text; and what follows from
    it.

    `text` takes the place of the overview. `values` are added to the JSON of the
    result, or are the whole JSON where there is no result. `doubts` are errors of the
    input, with which even a good result shows nothing. `remarks` go to standard error
    and are left out with --json. `saved` are results by the file that each is saved to,
    `written` the files that the command wrote itself, `following` the command that a
    user would give next.
    """

    result: Any = None
    passed: bool = True
    text: str = ""
    values: dict[str, Any] = field(default_factory=dict)
    doubts: tuple[Finding, ...] = ()
    remarks: tuple[str, ...] = ()
    saved: Mapping[Path, Any] = field(default_factory=dict)
    written: tuple[Path, ...] = ()
    following: str = ""

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that the answer was written to."""
        return (*self.saved, *self.written)


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


class Keywords:
    """Options of a command that are keywords of another function or of a TypedDict; all
    keywords if none is named. Type, range and default come from its signature, the help
    from the annotation or the docstring.
    """

    def __init__(self, function: Callable[..., Any], *names: str) -> None:
        self.function, self.names = function, names

    def of(self, options: dict[str, Any]) -> dict[str, Any]:
        """Those of `options` that are keywords of the function."""
        return {name: options[name] for name in self.names}

    @property
    def options(self) -> dict[str, Parameter]:
        """The options by name."""
        by_name, texts = declared(self.function), _parameter_texts(self.function)
        only = inspect.Parameter.KEYWORD_ONLY
        names = self.names or [name for name in by_name if by_name[name].way is only]
        return {
            name: replace(
                by_name[name], hint=Annotated[by_name[name].hint, texts.get(name, "")]
            )
            for name in names
        }


def declared(function: Callable[..., Any]) -> dict[str, Parameter]:
    """The arguments of a function by name, and those that it takes over from others."""
    options: dict[str, Parameter] = {}
    for name, each in parameters(function).items():
        if each.way is inspect.Parameter.VAR_KEYWORD:
            for others in getattr(each.hint, "__metadata__", ()):
                options |= others.options
        else:
            options[name] = each
    return options


def _parameter_texts(function: Callable[..., Any]) -> dict[str, str]:
    """The first sentence on each parameter in a numpydoc docstring."""
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


def _mark(parameter: Parameter, kind: type) -> Any:
    """The first mark of that class in the annotation of a parameter, or None."""
    marks = getattr(parameter.hint, "__metadata__", ())
    return next((mark for mark in marks if isinstance(mark, kind)), None)


def _option(parameter: Parameter) -> inspect.Parameter:
    """The parameter in typer's form: its plain type, and its help with the range."""
    annotations = SimpleNamespace(__annotations__={"option": parameter.hint})
    kind = get_type_hints(annotations)["option"]
    # A copy, since several commands share the mark through a common type.
    info = copy.copy(_mark(parameter, ParameterInfo) or typer.Option())
    text, expected = _mark(parameter, str) or "", parameter.rule.expected
    info.help = text.rstrip(".")
    info.help += f", {expected}" if expected != rule(kind).expected else ""
    repeated = any(get_origin(part) is list for part in get_args(kind))
    info.help += "; may be repeated." if repeated else "."
    if isinstance(info, OptionInfo) and not info.param_decls:
        word = parameter.name.replace("_", "-")
        # A flag that is on by default, or left to a rule, needs a word to turn it off;
        # one that is off needs none.
        stays_off = parameter.default is False or bool not in (kind, *get_args(kind))
        info.param_decls = (f"--{word}" if stays_off else f"--{word}/--no-{word}",)
    return inspect.Parameter(
        parameter.name,
        inspect.Parameter.KEYWORD_ONLY,
        default=parameter.default,
        annotation=Annotated[kind, info],
    )


def argument(word: str) -> Any:
    """Mark a parameter as an argument, which the help calls `word`."""
    return typer.Argument(metavar=word)


def option(word: str) -> Any:
    """Mark an option whose value the help calls `word`."""
    return typer.Option(metavar=word)


def _flags(
    json: Annotated[bool, "Print the result as one JSON object"] = False,
    force: Annotated[bool, "Overwrite files that are already there"] = False,
) -> None:
    """The options common to all commands."""


def command(app: typer.Typer) -> Callable[[Callable[..., Answer]], Callable[..., int]]:
    """Add a function that returns an Answer to `app`, with --json, and with --force
    where it writes.

    A function that checks its files itself takes `force` as an argument of its own.
    """

    def add(function: Callable[..., Answer]) -> Callable[..., int]:
        # Given explicitly, since click cuts the first sentence off after some fifty
        # characters.
        sentence, _, _ = (inspect.getdoc(function) or "").partition("\n\n")
        return app.command(short_help=" ".join(sentence.split()))(_command(function))

    return add


def _command(function: Callable[..., Answer]) -> Callable[..., int]:
    options = declared(function)
    # A command that checks its files itself receives --force.
    own_force = options.pop("force", None)
    writes = {name: mark for name in options if (mark := _mark(options[name], Writes))}
    flags = parameters(_flags)
    if not writes and not own_force:
        del flags["force"]  # it would have no effect here

    @functools.wraps(function)
    def run(*, json: bool = False, force: bool = False, **given: Any) -> int:
        # Ranges first, then files, then the computation: a typing error must not cost a
        # minute of work.
        for name, each in options.items():
            given[name] = each.rule.check(name, given[name])
        for name, mark in writes.items():
            if given[name] is not None:
                mark.check(given[name], force=force)
        answer = function(**given, **({"force": force} if own_force else {}))
        for place, result in answer.saved.items():
            result.save(place)
        with unread_allowed():
            (_show_json if json else _show_text)(answer)
        # Doubts are errors of the input: a result that rests on them shows nothing,
        # however good it is.
        return PASSED if answer.passed and not answer.doubts else FAILED

    signature = [_option(each) for each in (*options.values(), *flags.values())]
    run.__annotations__ = {p.name: p.annotation for p in signature} | {"return": int}
    run.__signature__ = inspect.Signature(signature)  # type: ignore[attr-defined]
    del run.__wrapped__  # typer would read the annotations of the wrapped function
    return run


def _show_json(answer: Answer) -> None:
    values = {} if answer.result is None else to_json(answer.result)
    if answer.doubts:
        # Doubts about the input first: they are the reason to distrust the rest.
        values["findings"] = [*map(plain, answer.doubts), *values.get("findings", ())]
    paths = [str(path) for path in answer.files]
    # A single file is a string, since most commands write one, and scripts read `out`
    # without an index.
    out: dict[str, Any] = (
        {"out": paths if len(paths) > 1 else paths[0]} if paths else {}
    )
    # The values added by the command take precedence, such as "out": null for a failed
    # proof.
    emit_json(values | out | answer.values)


def _show_text(answer: Answer) -> None:
    text = answer.text
    if not text and answer.result is not None:
        text = plain_text(doubted(view(answer.result), answer.doubts), width())
    if text:
        emit(text)
    for remark in answer.remarks:
        tell(remark)
    for path in answer.files:
        tell(f"written: {path}")
    # No next command for a result from doubtful input.
    if answer.following and not answer.doubts:
        tell(f"next: {answer.following}")
