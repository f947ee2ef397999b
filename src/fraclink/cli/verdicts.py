"""Verbs on a design: certify, export, replay, compare, twin, reproduce."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fraclink.cli.console import emit, emit_json, steps, tell
from fraclink.cli.options import Force, Json
from fraclink.cli.outcome import FAILS, HOLDS
from fraclink.files import output_path

__all__ = ["register"]

DesignFile = Annotated[Path, typer.Argument(metavar="DESIGN", help="Design made by `fraclink design`.")]


def certify(
    plan_file: DesignFile,
    out: Annotated[Path, typer.Option("--out", help="File to write the certificate to.")] = Path(
        "certificate.json"
    ),
    json: Json = False,
    force: Force = False,
) -> int:
    """Prove stability for every payload and delay in range; exit code 1 where the proof fails."""
    from fraclink.certify import certify as prove
    from fraclink.design import Plan

    place = output_path(out, force=force)
    with steps(1) as begin:
        begin("proving")
        certificate = prove(Plan.load(plan_file))
    certificate.save(place)
    if json:
        emit_json({"holds": certificate.holds, "verdict": certificate.verdict, "out": str(place)})
    else:
        emit(certificate.verdict)
        tell(f"written: {place}")
    return HOLDS if certificate.holds else FAILS


def reproduce(
    out: Annotated[Path, typer.Option("--out", help="Folder for RESULTS.md and figures/.")] = Path(
        "reproduce"
    ),
    published: Annotated[
        Path, typer.Option("--published", help="Folder with published.toml and its neighbours.")
    ] = Path("reproduce"),
    json: Json = False,
    force: Force = False,
) -> int:
    """Recompute every number, statement and figure of the source paper."""
    from fraclink.reproduce import reproduce as recompute

    output_path(out / "RESULTS.md", force=force)
    with steps(4) as begin:
        place = recompute(published, out, begin=begin)
    emit_json({"out": str(place)}) if json else emit(str(place))
    return HOLDS


def register(app: typer.Typer) -> None:
    """Add the verbs of this module to the application."""
    for verb in (certify, reproduce):
        app.command()(verb)
