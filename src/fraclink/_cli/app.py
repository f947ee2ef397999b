"""The application: the list of commands, each loaded with its module when it is called."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from fraclink import __version__
from fraclink._cli.console import INTERRUPTED, emit, guarded

# Command -> its module and a one-line description, in the order of a usual session. A
# module of commands imports the library; the list does not load it.
_COMMANDS = {
    "start": ("starting", "your own log to a first model, columns and units guessed"),
    "run": ("designs", "log to model, controller, simulated moves and report"),
    "inspect": ("models", "list a log's channels, rates and ranges"),
    "diagnose": ("models", "examine a log before a model is fitted to it"),
    "identify": ("identification", "fit a link model to a log, or any structure"),
    "design": ("designs", "design the controller for a payload range"),
    "simulate": ("designs", "simulate a move of the tip"),
    "certify": ("designs", "prove stability for every payload and delay"),
    "export": ("boards", "write the controller as C99 or FMU"),
    "report": ("designs", "gather a folder of results into one HTML file"),
    "studio": ("studio", "a page on this machine: drag the loop, see the arm"),
    "tune": ("tunings", "tune an unknown arm within limits, up to its first moves"),
    "run-realtime": ("boards", "run the shipped law on an arm in real time"),
    "serve-arm": ("boards", "serve a simulated arm in real time"),
    "watch": ("tunings", "report what has changed since an arm was tuned"),
    "validate": ("models", "test a model on other logs of the arm"),
    "assess": ("assessments", "phase budget, margins and higher modes of a design"),
    "compare": ("assessments", "run a design and its rivals on one twin"),
    "shape": ("moves", "shape the fastest move within the limits"),
    "tune-pid": ("assessments", "tune a fractional PID for any plant"),
    "campaign": ("campaigns", "many runs: Monte Carlo and faults"),
    "replay": ("campaigns", "repeat one run of a campaign with its signals"),
}
_EPILOG = (
    "Exit code: 0 passed, 1 failed or not shown, 2 bad input. "
    "`fraclink help COMMAND` shows options and an example."
)


class _Group(TyperGroup):
    """A group of commands in the order of a usual session."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names of the commands in their order."""
        return list(_COMMANDS if ctx.parent is None else self.commands)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name; its module is imported here and not before."""
        # Only for the program itself: the commands of a group came with its module, and
        # `export c` must not look for a command `fraclink c`.
        if ctx.parent is None and cmd_name not in self.commands:
            # For an unknown name all are loaded, which is slow but ends in an error
            # anyway: typer looks for similar names among them ("did you mean").
            for name in [cmd_name] if cmd_name in _COMMANDS else _COMMANDS:
                app = import_module(f"fraclink._cli.{_COMMANDS[name][0]}").app
                self.commands.update(typer.main.get_group(app).commands)
        return super().get_command(ctx, cmd_name)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, without the options that every program has."""
        if ctx.parent is not None:
            super().format_options(ctx, formatter)
            return
        with formatter.section("Commands"):
            formatter.write_dl(
                [(name, words) for name, (_, words) in _COMMANDS.items()]
            )


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
    """From the log of a flexible-link robot to the controller on its board."""


def application() -> typer.Typer:
    """Return the command line's application."""
    app = typer.Typer(
        name="fraclink",
        cls=_Group,
        epilog=_EPILOG,
        # Tracebacks of rich show local variables: the user's keys and paths would
        # appear in a bug report.
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_options)
    return app


def run(arguments: Sequence[str]) -> int:
    """Run the command line with `arguments` and return the exit code."""
    words = list(arguments) or ["--help"]
    if words[0] == "help":
        words = [*words[1:], "--help"]

    def work() -> int | None:
        streams = sys.stdout, sys.stderr
        try:
            # Not standalone: click would print errors in its own words and end the
            # process, even that of a test.
            result = application()(
                args=words, standalone_mode=False, prog_name="fraclink"
            )
        except SystemExit as end:
            # If the reader of a pipe leaves, typer exits with 1, which would be a
            # verdict, and wraps both streams.
            if not isinstance(end.__context__, BrokenPipeError):
                raise
            sys.stdout, sys.stderr = streams
            raise end.__context__ from None
        # typer turns Ctrl-C into an exit code without a word.
        if result == INTERRUPTED:
            raise KeyboardInterrupt
        # --help and --version return what click makes of them: nothing went wrong.
        return result if isinstance(result, int) else None

    return guarded(work, as_json="--json" in words)
