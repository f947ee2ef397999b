"""The application: the list of commands, each loaded with its module when it is called."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from fraclink import __version__
from fraclink._cli.console import emit, guarded

__all__ = ["application", "run"]

# Section -> module -> commands; the help lists them in this order.
_SECTIONS: dict[str, tuple[tuple[str, str], ...]] = {
    "From a log to a board": (
        *(("run", "designs"), ("inspect", "models"), ("diagnose", "models"), ("identify", "models")),
        *(("design", "designs"), ("simulate", "designs"), ("twin", "designs"), ("certify", "designs")),
        *(("export", "boards"), ("run-realtime", "boards"), ("serve-arm", "boards"), ("report", "designs")),
    ),
    "More on logs and models": tuple(
        (name, "models")
        for name in (
            *("identify-all", "identify-payloads", "identify-motor", "identify-spectrum"),
            *("plan-experiment", "record"),
        )
    ),
    "More on designs and laws": (
        *((name, "assessments") for name in ("assess", "optimise", "compare", "design-map")),
        *(("campaign", "campaigns"), ("replay", "boards")),
    ),
}
_HOMES = {name: module for listed in _SECTIONS.values() for name, module in listed}


class _Group(TyperGroup):
    """A group of commands that lists each with its whole sentence.

    click cuts a summary off behind some fifty characters and sorts by the order of registration; a user
    who looks for the next stage finds neither what it does nor where it stands.
    """

    def list_commands(self, ctx: Any) -> list[str]:
        """The names of the commands in their order."""
        return list(_HOMES) if ctx.parent is None else list(self.commands)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name; its module is imported here and not before."""
        if ctx.parent is None and cmd_name in _HOMES and cmd_name not in self.commands:
            app = import_module(f"fraclink._cli.{_HOMES[cmd_name]}").app
            self.commands.update(typer.main.get_group(app).commands)
        return super().get_command(ctx, cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """As click has it; a name that is not there is looked for among all commands ("did you mean")."""
        if ctx.parent is None and args and args[0] not in _HOMES:
            for name in _HOMES:
                self.get_command(ctx, name)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section for each purpose: command and whole sentence."""
        sections = {title: [name for name, _ in listed] for title, listed in _SECTIONS.items()}
        for title, names in sections.items() if ctx.parent is None else [("Commands", list(self.commands))]:
            with formatter.section(title):
                formatter.write_dl([(name, _sentence(self.get_command(ctx, name))) for name in names])


def _sentence(command: Any) -> str:
    return " ".join((command.help or "").partition("\n\n")[0].split())


def group(help: str = "") -> typer.Typer:
    """An empty group of commands."""
    return typer.Typer(cls=_Group, help=help or None, rich_markup_mode=None)


def _show_version(wanted: bool) -> None:
    if wanted:
        emit(f"fraclink {__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """From the log of a flexible-link robot to the fractional-order controller on its board."""


def application() -> typer.Typer:
    """Return the command line's application."""
    app = typer.Typer(
        name="fraclink",
        cls=_Group,
        epilog="Exit code: 0 passed, 1 failed or not shown, 2 bad input.",
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_options)
    return app


def run(arguments: Sequence[str]) -> int:
    """Run the command line with `arguments` and return the exit code."""
    given = list(arguments) or ["--help"]

    def work() -> int | None:
        result = application()(args=given, standalone_mode=False, prog_name="fraclink")
        return result if isinstance(result, int) else None

    return guarded(work, as_json="--json" in given)
