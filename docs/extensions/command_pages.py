"""A page for every command, written before a build from the help of the command: what
it does, an example with the output recorded for the tests, its options, a picture, and
a link to a page with more explanation.

The pages are in `reference/commands`, which no other module writes to.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer
from sphinx.application import Sphinx

from fraclink._cli.app import application

ROOT = Path(__file__).resolve().parents[2]
OUTPUTS = ROOT / "tests" / "golden" / "commands"
_LONGEST = 45  # lines of an output: more would push the options out of sight

# Command -> picture and page with more explanation.
SHOWN: dict[str, tuple[str, str]] = {
    "start": ("detail", "tutorial/your-own-csv"),
    "run": ("moves", "tutorial/from-log-to-board"),
    "inspect": ("log", "how-to/read-your-log"),
    "diagnose": ("log", "how-to/read-your-log"),
    "identify": ("detail", "how-to/choose-a-structure"),
    "design": ("bode", "how-to/design-a-controller"),
    "simulate": ("moves", "how-to/run-the-twin"),
    "certify": ("nyquist", "how-to/read-a-certificate"),
    "export c": ("loop", "how-to/flash-a-board"),
    "export fmu": ("loop", "how-to/export-an-fmu"),
    "export arm-firmware": ("arm", "how-to/build-an-arm"),
    "run-realtime": ("loop", "how-to/run-in-real-time"),
    "serve-arm": ("arm", "how-to/run-in-real-time"),
    "tune": ("bode", "how-to/tune-an-arm"),
    "watch": ("log", "how-to/tune-an-arm"),
    "studio": ("margins", "how-to/use-the-studio"),
    "report": ("margins", "how-to/read-the-report"),
    "validate": ("validation", "how-to/validate-on-a-second-log"),
    "assess": ("budget", "explanation/margins"),
    "compare": ("published", "how-to/compare-rivals"),
    "tune-pid": ("pid-step", "how-to/tune-a-fractional-pid"),
    "shape": ("moves", "how-to/shape-a-move"),
    "campaign montecarlo": ("moves", "how-to/run-a-campaign"),
    "campaign faults": ("dropped", "how-to/run-a-fault-campaign"),
    "replay": ("moves", "how-to/run-a-campaign"),
}


def every_command() -> dict[str, Any]:
    """Every command by the words that call it, those of a group behind its name."""
    top: Any = typer.main.get_command(application())
    commands: dict[str, Any] = {}
    for name in top.list_commands(typer.Context(top)):
        each = top.get_command(typer.Context(top), name)
        inner = getattr(each, "commands", None)
        if inner is None:
            commands[name] = each
        else:
            commands |= {f"{name} {word}": inner[word] for word in inner}
    return commands


def file_name(name: str) -> str:
    """Where a command's page lies."""
    return name.replace(" ", "-")


def summary(command: Any) -> str:
    """The first sentence of a command's help."""
    return " ".join((command.help or "").partition("\n\n")[0].split())


def page(name: str, command: Any) -> str:
    """A command's page."""
    body, _, example = (command.help or "").partition("$ ")
    picture, more = SHOWN.get(name, ("", ""))
    example = " ".join(example.split()) or f"fraclink {name} --help"
    parts = [f"# fraclink {name}", " ".join(body.split())]
    parts += [f"```console\n$ {example}\n```"]
    if picture:
        parts += [f"```{{picture}} {picture}\n```"]
    parts += _output(name)
    parts += ["## Options", _options(command)]
    if more:
        parts += [f"## See also\n\n[](../../{more}.md), [](../command-line.md)"]
    return "\n\n".join(parts) + "\n"


def _output(name: str) -> list[str]:
    """Return the output of the command as recorded for the tests."""
    place = OUTPUTS / f"{file_name(name)}.txt"
    if not place.is_file():
        return []
    lines = place.read_text("utf-8").rstrip().splitlines()
    cut = lines[:_LONGEST] + (
        [f"… {len(lines) - _LONGEST} more lines"] if len(lines) > _LONGEST else []
    )
    return ["## What it prints", "```text\n" + "\n".join(cut) + "\n```"]


def _options(command: Any) -> str:
    rows = ["| option | meaning | default |", "|---|---|---|"]
    for item in command.params:
        text = " ".join((getattr(item, "help", "") or "").split()).replace("|", "\\|")
        given = getattr(item, "opts", [])
        names = (
            (item.metavar or item.name.upper(),)
            if item.param_type_name == "argument"
            else (*given, *item.secondary_opts)
        )
        shown = " / ".join(f"`{word}`" for word in names)
        rows.append(f"| {shown} | {text} | {_default(item)} |")
    return "\n".join(rows)


def _default(item: Any) -> str:
    if item.required:
        return "required"
    value = item.default
    if value is None or value is False or value == () or callable(value):
        return ""
    return (
        f"`{' '.join(map(str, value)) if isinstance(value, tuple | list) else value}`"
    )


def write(app: Sphinx) -> None:
    """Write the pages, and the table that is part of the page of commands."""
    if not (Path(app.srcdir) / "reference" / "command-line.md").is_file():
        return
    folder = Path(app.srcdir) / "reference" / "commands"
    folder.mkdir(exist_ok=True)
    found = every_command()
    rows = [
        f"| [`{name}`](commands/{file_name(name)}.md) | {summary(command)} |"
        for name, command in found.items()
    ]
    texts = {
        "_all": "\n".join(["| command | what it does |", "|---|---|", *rows]) + "\n"
    }
    texts |= {file_name(name): page(name, command) for name, command in found.items()}
    for old in folder.glob("*.md"):
        if old.stem not in texts:
            old.unlink()
    for name, text in texts.items():
        place = folder / f"{name}.md"
        if (
            not place.is_file() or place.read_text("utf-8") != text
        ):  # unchanged pages are not built again
            place.write_text(text, "utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}
