"""Verbs that hand a design on: export c, and what else leaves the building."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from fraclink.cli.console import emit, emit_json
from fraclink.cli.options import Force, Json
from fraclink.cli.outcome import HOLDS
from fraclink.cli.verdicts import DesignFile

__all__ = ["register"]


def c(
    plan_file: DesignFile,
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("firmware"),
    precision: Annotated[
        Literal["single", "double"], typer.Option("--precision", help="Arithmetic of the board.")
    ] = "single",
    motor: Annotated[
        bool,
        typer.Option("--motor/--no-motor", help="With the motor loop, or for a robot with its own servo."),
    ] = True,
    name: Annotated[
        str, typer.Option("--name", help="C identifier of the block of coefficients.")
    ] = "law_data",
    title: Annotated[str, typer.Option("--title", help="Text for the first comment.")] = "",
    json: Json = False,
    force: Force = False,
) -> int:
    """Write the law as C99: the files that were simulated, the coefficients, a self-test, a page to read."""
    from fraclink.design import Plan
    from fraclink.export import export_c
    from fraclink.law import equip

    plan = Plan.load(plan_file)
    law = plan.controller.discretize(plan.rig.period)
    whole = equip(law, plan.rig, plan.model) if motor else law
    paths = export_c(whole, out, precision=precision, name=name, title=title, force=force)
    if json:
        emit_json({"out": [str(path) for path in paths]})
    else:
        emit("\n".join(map(str, paths)))
    return HOLDS


def register(app: typer.Typer) -> None:
    """Add the verbs of this module to the application, below `export`."""
    export = typer.Typer(help="Hand a design on: C for a board.")
    export.command()(c)
    export.callback()(lambda: None)
    app.add_typer(export, name="export")
