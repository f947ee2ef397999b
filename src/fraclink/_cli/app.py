"""The application: every verb, its options, and the one place where errors end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import typer

from fraclink._cli import (
    assessment,
    campaign,
    exports,
    identification,
    logs,
    mapping,
    optimisation,
    realtime,
    record,
    spectrum,
    stages,
    verdicts,
    whole,
)
from fraclink._cli.console import emit
from fraclink._cli.listing import Listing
from fraclink._cli.outcome import guarded

__all__ = ["application", "run"]


def _show_version(wanted: bool) -> None:
    if wanted:
        from fraclink import __version__

        emit(f"fraclink {__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """From the log of a flexible-link robot to the fractional-order controller on its board."""


def application() -> typer.Typer:
    """Return the command line's application with all verbs."""
    app = typer.Typer(
        name="fraclink",
        cls=Listing,
        epilog="Exit code: 0 holds, 1 does not hold, 2 bad input.",
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_options)
    for module in (
        whole,
        logs,
        record,
        stages,
        identification,
        spectrum,
        verdicts,
        assessment,
        mapping,
        optimisation,
        exports,
        realtime,
        campaign,
    ):
        module.register(app)
    return app


def run(arguments: Sequence[str]) -> int:
    """Run the command line with `arguments` and return the exit code."""
    given = list(arguments) or ["--help"]

    def work() -> int | None:
        result = application()(args=given, standalone_mode=False, prog_name="fraclink")
        return result if isinstance(result, int) else None

    return guarded(work, as_json="--json" in given)
