"""`fraclink man`: the manual page, made from the help of every command as it is."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from fraclink import __version__
from fraclink._cli.app import application, every_command, group
from fraclink._cli.command import Answer, Writes, command
from fraclink._files import write_text

__all__ = ["manual_page"]

app = group()

_EXIT = (
    ("0", "what was asked for passed"),
    ("1", "it failed, or is not shown"),
    ("2", "the input is bad: a message names field, value, range and remedy"),
    ("70", "a defect of fraclink"),
)
_ENVIRONMENT = (
    ("NO_COLOR", "if set, text only: no colours and no links"),
    ("FORCE_COLOR", "if set, colours and links in pipes, too"),
    ("COLUMNS", "width of tables and messages"),
    ("FRACLINK_TRACEBACK", "1: where an error was raised, for a report of a defect"),
)


@command(app)
def man(
    out: Annotated[Path | None, "Write it here (fraclink.1); default: standard output", Writes()] = None,
) -> Answer:
    """Write the manual page of all commands, for man(1).

    $ fraclink man --out ~/.local/share/man/man1/fraclink.1
    """
    text = manual_page()
    if out is None:
        return Answer(text=text.rstrip("\n"), values={"page": text})
    write_text(out, text)
    inside = out.resolve().parent.name == "man1"
    return Answer(written=(out,), following="man fraclink" if inside else f"man -l {out}")


def manual_page() -> str:
    """Return the page in the macros of man(7).

    >>> manual_page().splitlines()[1].split()[:3]
    ['.TH', 'FRACLINK', '1']
    """
    top = typer.main.get_command(application())
    lines = [
        '.\\" Made by `fraclink man`.',
        f'.TH FRACLINK 1 "" "fraclink {__version__}" "User commands"',
        *_section("NAME", "fraclink \\- " + _text(_lowered(top.help or ""))),
        *_section("SYNOPSIS", ".B fraclink\n.I command\n[options]"),
        *_section(
            "DESCRIPTION",
            _text(
                "A log of a flexible-link robot becomes a model, the model a controller, the controller C "
                "code for a board, with simulations, a proof and a report on the way. Every command prints "
                "its verdict first and names the next command; files pass results on from stage to stage."
            ),
        ),
        ".SH COMMANDS",
    ]
    for name, each in every_command().items():
        lines += _command(name, each)
    lines += [".SH EXIT STATUS", *_listed(_EXIT), ".SH ENVIRONMENT", *_listed(_ENVIRONMENT)]
    lines += _section("SEE ALSO", _text("fraclink help all, fraclink help COMMAND, fraclink doctor"))
    return "\n".join(lines) + "\n"


def _lowered(sentence: str) -> str:
    """A sentence as whatis(1) lists it: behind a dash, without its full stop."""
    return sentence[:1].lower() + sentence[1:].rstrip(".")


def _section(title: str, text: str) -> list[str]:
    return [f".SH {title}", text]


def _command(name: str, each: Any) -> Iterator[str]:
    """Name, sentence, example and options of one command."""
    body, _, example = (each.help or "").partition("$ ")
    given = [item for item in each.params if item.param_type_name == "argument"]
    words = " ".join(item.metavar or item.name.upper() for item in given)
    yield f'.SS "fraclink {_text(f"{name} {words}".strip())}"'
    for paragraph in filter(None, map(str.strip, body.split("\n\n"))):
        yield from (".PP", _text(" ".join(paragraph.split())))
    if example:
        yield from (".PP", ".EX", _text("$ " + " ".join(example.split())), ".EE")
    options = [item for item in each.params if item.param_type_name == "option"]
    yield from _listed([(", ".join((*item.opts, *item.secondary_opts)), item.help or "") for item in options])


def _listed(rows: Any) -> Iterator[str]:
    for word, meaning in rows:
        yield from (".TP", f".B {_text(word)}", _text(" ".join(meaning.split())))


def _text(text: str) -> str:
    """A text as roff reads it back: backslashes, hyphens, and a dot or quote that begins a line."""
    escaped = text.replace("\\", "\\e").replace("-", "\\-").replace('"', "\\(dq")
    return re.sub(r"^([.'])", r"\\&\1", escaped)
