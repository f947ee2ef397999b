"""The application: the list of commands, each loaded with its module when it is called."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from fraclink import __version__
from fraclink._cli.console import emit, guarded

__all__ = ["application", "every_command", "run"]

# The commands of the first screen, with the few words that there is room for.
_FIRST = {
    "start": "your own log to a first model, columns and units guessed",
    "run": "log to model, controller, simulated moves and report, all in one",
    "inspect": "list a log's channels, rates and ranges",
    "diagnose": "examine a log before a model is fitted to it",
    "identify": "fit a link model to a log, or any structure",
    "design": "design the controller for a payload range",
    "simulate": "simulate a move of the tip",
    "certify": "prove stability for every payload and delay",
    "export": "write the controller as C99 or FMU",
    "report": "gather a folder of results, or the arm that moves, into one HTML file",
    "studio": "a page on this machine: drag the loop, see the arm",
    "doctor": "check this installation",
}

# Section -> module -> commands; `fraclink help all` lists them in this order.
_SECTIONS: dict[str, dict[str, str]] = {
    "From a log to a board": {
        "start": "starting",
        **dict.fromkeys(("run",), "designs"),
        **dict.fromkeys(("inspect", "diagnose"), "models"),
        "identify": "identification",
        **dict.fromkeys(("design", "simulate", "certify"), "designs"),
        **dict.fromkeys(("export", "run-realtime", "serve-arm"), "boards"),
        **dict.fromkeys(("tune", "watch"), "tunings"),
        "report": "designs",
        "studio": "studio",
    },
    "More on logs and models": {
        **dict.fromkeys(("validate", "record"), "models"),
    },
    "More on designs and laws": {
        **dict.fromkeys(("assess", "compare"), "assessments"),
        "shape": "moves",
        "tune-pid": "assessments",
        "campaign": "campaigns",
        "replay": "boards",
    },
    "This installation": {"doctor": "installation"},
}
# A module of commands brings the library with it: the first screen must not pay for all
# of them, and lists what it has not loaded from this table.
_HOMES = {
    name: module for listed in _SECTIONS.values() for name, module in listed.items()
}
_EPILOG = "Exit code: 0 passed, 1 failed or not shown, 2 bad input."


class _Group(TyperGroup):
    """A group of commands that lists each with its whole sentence.

    click cuts a summary off behind some fifty characters and sorts by the order of
    registration; a user who looks for the next stage finds neither what it does nor
    where it stands.
    """

    def list_commands(self, ctx: Any) -> list[str]:
        """The names of the commands in their order."""
        return list(_HOMES) if ctx.parent is None else list(self.commands)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name; its module is imported here and not before."""
        # Only of the program itself: a group's commands came with its module, and
        # `export c` must not look for a stage of that name.
        if ctx.parent is None and cmd_name in _HOMES and cmd_name not in self.commands:
            app = import_module(f"fraclink._cli.{_HOMES[cmd_name]}").app
            self.commands.update(typer.main.get_group(app).commands)
        return super().get_command(ctx, cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """As click has it; a name that is not there is looked for among all commands
        ("did you mean").
        """
        # Slow, and only on the way to an error: click looks for near names among what
        # is loaded.
        if ctx.parent is None and args and args[0] not in _HOMES:
            for name in _HOMES:
                self.get_command(ctx, name)
        return super().resolve_command(ctx, args)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the commands; the first screen has no room for options that every
        program has.
        """
        if ctx.parent is not None:
            super().format_options(ctx, formatter)
            return
        with formatter.section("Commands"):
            formatter.write_dl(list(_FIRST.items()))
        with formatter.section("More"):
            formatter.write_dl(
                [
                    ("help all", "every command"),
                    ("help COMMAND", "its options, and an example"),
                    ("--version", "print the version"),
                    (
                        "--install-completion",
                        "complete commands and options in this shell",
                    ),
                ]
            )

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write each command of a group with its whole sentence."""
        with formatter.section("Commands"):
            self.list_with_sentences(ctx, formatter, list(self.commands))

    def list_with_sentences(
        self, ctx: Any, formatter: Any, names: Sequence[str]
    ) -> None:
        """Write commands and the first sentence of their help."""
        formatter.write_dl(
            [(name, _sentence(self.get_command(ctx, name))) for name in names]
        )


def _sentence(command: Any) -> str:
    return " ".join((command.help or "").partition("\n\n")[0].split())


def _everything() -> str:
    """Every command with its whole sentence, in sections."""
    top = typer.main.get_group(application())
    context = typer.Context(top, info_name="fraclink")
    formatter = context.make_formatter()
    for title, listed in _SECTIONS.items():
        with formatter.section(title):
            top.list_with_sentences(context, formatter, list(listed))  # type: ignore[attr-defined]
    formatter.write_paragraph()
    formatter.write_text(_EPILOG)
    return str(formatter.getvalue()).strip("\n")


def group(help: str = "") -> typer.Typer:
    """An empty group of commands."""
    return typer.Typer(cls=_Group, help=help or None, rich_markup_mode=None)


def _show_version(wanted: bool) -> None:
    if wanted:
        emit(f"fraclink {__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_show_version,
            is_eager=True,
            help="Print the version.",
        ),
    ] = False,
) -> None:
    """From the log of a flexible-link robot to the fractional-order controller on its
    board.
    """


def application() -> typer.Typer:
    """Return the command line's application."""
    app = typer.Typer(
        name="fraclink",
        cls=_Group,
        epilog=_EPILOG,
        # rich's tracebacks show local variables: keys and paths of the user's would
        # land in a report of a defect.
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_options)
    return app


def every_command() -> dict[str, Any]:
    """Return every command by the words that call it, those of a group behind its name."""
    top: Any = typer.main.get_command(application())
    context = typer.Context(top)
    found: dict[str, Any] = {}
    for name in top.list_commands(context):
        each = top.get_command(context, name)
        inner = getattr(each, "commands", None)
        found |= (
            {name: each}
            if inner is None
            else {f"{name} {word}": inner[word] for word in inner}
        )
    return found


def run(arguments: Sequence[str]) -> int:
    """Run the command line with `arguments` and return the exit code."""
    given = list(arguments) or ["--help"]
    # Words and not an option: it stands where the name of a command does.
    everything = given == ["help", "all"]
    if given[0] == "help":
        given = [*given[1:], "--help"]

    def work() -> int | None:
        if everything:
            emit(_everything())
            return None
        streams = sys.stdout, sys.stderr
        try:
            # Not standalone: click would print errors in its own words and end the
            # process, also of a test.
            result = application()(
                args=given, standalone_mode=False, prog_name="fraclink"
            )
        except SystemExit as end:
            # Where a pipe's reader left typer exits with 1, which is a verdict, and
            # wraps both streams.
            if not isinstance(end.__context__, BrokenPipeError):
                raise
            sys.stdout, sys.stderr = streams
            raise end.__context__ from None
        # --help and --version return what click makes of them: nothing went wrong.
        return result if isinstance(result, int) else None

    return guarded(work, as_json="--json" in given)
