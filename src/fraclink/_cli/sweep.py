"""The verb `campaign sweep`: a design map on the twin."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fraclink._cli.console import emit, emit_json, steps, table, tell
from fraclink._cli.options import Force, Json, RigName, load_rig
from fraclink._cli.outcome import FAILS, HOLDS
from fraclink._files import output_path

if TYPE_CHECKING:
    from fraclink._campaign import Cell, Sweep

__all__ = ["register"]

Many = list[float] | None


def sweep(
    out: Annotated[Path, typer.Option("--out", help="File for the map (.json); the page goes beside it.")],
    rig: RigName = "paper-2023",
    gain_crossover: Annotated[
        Many,
        typer.Option("--gain-crossover", metavar="RAD/S", help="Gain crossover [rad/s]; may be repeated."),
    ] = None,
    phase_margin_deg: Annotated[
        Many,
        typer.Option(
            "--phase-margin-deg", metavar="DEGREES", help="Phase margin [degrees]; may be repeated."
        ),
    ] = None,
    payload: Annotated[
        Many,
        typer.Option(
            "--payload", metavar="KG", help="Payload [kg]; may be repeated; default: the rig's range."
        ),
    ] = None,
    link_mass: Annotated[
        float | None, typer.Option("--link-mass", help="Mass of the twin's link [kg].")
    ] = None,
    gear: Annotated[
        float | None, typer.Option("--gear", help="Gear ratio put before the twin's motor.")
    ] = None,
    workers: Annotated[int, typer.Option("--workers", help="Processes on this machine.")] = 1,
    json: Json = False,
    force: Force = False,
) -> int:
    """Design over gain crossover × phase margin, and run each law on the twin with each payload."""
    from fraclink._campaign import save_sweep
    from fraclink._campaign import sweep as map_on_twin
    from fraclink._show.report.campaigns import write_sweep_report
    from fraclink._simulate.twin import geared

    place = output_path(out, force=force)
    page = output_path(place.with_suffix(".html"), force=force)
    arm = load_rig(rig)
    crossovers = gain_crossover or [10.0, 12.0, 14.0, 16.0, 18.0]
    margins = phase_margin_deg or [30.0, 40.0, 50.0, 60.0]
    with steps(len(crossovers) * len(margins)) as step:
        found = map_on_twin(
            geared(arm, gear) if gear is not None else arm,
            gain_crossovers=crossovers,
            phase_margins=[math.radians(margin) for margin in margins],
            payloads=payload or None,
            link_mass=link_mass,
            workers=workers,
            watch=lambda done, of: step(f"{done} of {of} requests"),
        )
    save_sweep(found, place)
    write_sweep_report(found, page)
    _tell(found, json=json)
    tell(f"written: {place}, {page}")
    return HOLDS if found.passed else FAILS


def _tell(found: Sweep, *, json: bool) -> None:
    if json:
        told = [
            {
                "gain_crossover": c.gain_crossover,
                "phase_margin": c.phase_margin,
                "payload": c.payload,
                "passed": c.passed,
                "settling_time": c.settling_time if math.isfinite(c.settling_time) else None,
                "infeasible": c.infeasible,
                "reason": c.reason,
            }
            for c in found.cells
        ]
        emit_json({"passed": found.passed, "cells": told})
        return
    header = ["request", *(f"{1e3 * m:.4g} g" for m in found.payloads)]
    rows = [
        [f"{w:.4g} rad/s, {math.degrees(p):.4g}°", *(_cell(found.at(w, p, m)) for m in found.payloads)]
        for w in found.gain_crossovers
        for p in found.phase_margins
    ]
    emit(table(header, rows))
    for condition in dict.fromkeys(c.infeasible for c in found.cells if c.infeasible):
        emit(f"infeasible: {condition}")


def _cell(cell: Cell) -> str:
    if cell.infeasible:
        return "infeasible"
    return f"{cell.settling_time:.3g} s" if cell.passed else cell.reason.split(":")[0].split(";")[0]


def register(app: typer.Typer) -> None:
    """Add the verb to the campaign's own application."""
    app.command()(sweep)
