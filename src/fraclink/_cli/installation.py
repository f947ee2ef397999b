"""`fraclink doctor`: what of this installation is there; `fraclink man`: the manual
page of all commands.
"""

from __future__ import annotations

import platform
import re
import shutil
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

import typer

from fraclink import __version__, _kernels
from fraclink._cli.app import application, every_command, group
from fraclink._cli.command import Answer, Writes, command
from fraclink._files import write_text
from fraclink.view._text import Row, Table, View

__all__ = ["manual_page"]

app = group()

# Distribution, the extra that installs it, and what it is for.
_EXTRAS = (
    ("matplotlib", "report", "figures and reports"),
    ("jinja2", "report", "reports"),
    ("control", "control", "exchange with python-control"),
    ("python-flint", "certify", "proofs"),
    ("h5py", "io", "logs in HDF5 and MATLAB 7.3"),
    ("npTDMS", "io", "logs of LabVIEW"),
    ("rosbags", "io", "logs of ROS"),
    ("pyarrow", "io", "logs in Parquet, campaigns"),
    ("distributed", "cluster", "campaigns on a cluster"),
    ("starlette", "studio", "the studio"),
)


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _row(name: str, found: str | None, instead: str, use: str) -> Row:
    return (name, found or instead, use, "passed" if found else "missing")


@command(app)
def doctor() -> Answer:
    """Check this installation: kernels, optional packages, C compiler, real-time loop.

    $ fraclink doctor
    """
    extras = {name: _installed(name) for name, _, _ in _EXTRAS}
    # `cc` alone, as replay and FMU call it: another compiler that is there does not
    # help them.
    compiler = shutil.which("cc")
    rows = [
        ("Python", platform.python_version(), "", "passed"),
        ("numpy", _installed("numpy") or "", "", "passed"),
        # By distribution and not by import: an import of all would take seconds, and
        # one that is broken would end the check that is to find it.
        *(
            _row(name, extras[name], f"pip install 'fraclink[{extra}]'", use)
            for name, extra, use in _EXTRAS
        ),
        _row("C compiler", compiler, "none found", "replay, FMU"),
        _row(
            "real-time loop",
            "here" if _kernels.REALTIME else None,
            "Linux only",
            "run-realtime",
        ),
    ]
    missing = [row[0] for row in rows if row[-1] == "missing"]
    headline = f"fraclink {__version__} on {platform.system()} {platform.machine()}"
    headline += f"; without {', '.join(missing)}" if missing else ""
    table = Table(("part", "version", "for", "state"), tuple(rows), judged=True)
    python = platform.python_version()
    values = {
        "version": __version__,
        "python": python,
        "extras": extras,
        "compiler": compiler,
    }
    return Answer(
        text=View(headline, (table,), state="passed"),
        values=values,
        following="fraclink run --rig paper-2023-geared --log demo --out results",
    )


# --- the manual page --------------------------------------------------------------------------------

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
    out: Annotated[
        Path | None, "Write it here (fraclink.1); default: standard output", Writes()
    ] = None,
) -> Answer:
    """Write the manual page of all commands, for man(1).

    $ fraclink man --out ~/.local/share/man/man1/fraclink.1
    """
    text = manual_page()
    if out is None:
        return Answer(text=text.rstrip("\n"), values={"page": text})
    write_text(out, text)
    # man looks by section: elsewhere the page is shown by its file.
    inside = out.resolve().parent.name == "man1"
    return Answer(
        written=(out,), following="man fraclink" if inside else f"man -l {out}"
    )


def manual_page() -> str:
    """Return the page in the macros of man(7).

    >>> manual_page().splitlines()[1].split()[:3]
    ['.TH', 'FRACLINK', '1']
    """
    top = typer.main.get_command(application())
    lines = [
        '.\\" Made by `fraclink man`.',
        f'.TH FRACLINK 1 "" "fraclink {__version__}" "User commands"',
        *_section(
            "NAME",
            "fraclink \\- " + _text(_lowered(" ".join((top.help or "").split()))),
        ),
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
    lines += [
        ".SH EXIT STATUS",
        *_listed(_EXIT),
        ".SH ENVIRONMENT",
        *_listed(_ENVIRONMENT),
    ]
    lines += _section(
        "SEE ALSO", _text("fraclink help all, fraclink help COMMAND, fraclink doctor")
    )
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
    yield from _listed(
        [
            (", ".join((*item.opts, *item.secondary_opts)), item.help or "")
            for item in options
        ]
    )


def _listed(rows: Any) -> Iterator[str]:
    for word, meaning in rows:
        yield from (".TP", f".B {_text(word)}", _text(" ".join(meaning.split())))


def _text(text: str) -> str:
    """A text as roff reads it back: backslashes, hyphens, and a dot or quote that
    begins a line.
    """
    # Backslashes first, as the others bring their own; a bare hyphen would be printed
    # as a dash and not be found by a search for --out.
    escaped = text.replace("\\", "\\e").replace("-", "\\-").replace('"', "\\(dq")
    return re.sub(r"^([.'])", r"\\&\1", escaped)
