"""`fraclink run`: from a log to a report, in one command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fraclink._cli.console import emit, emit_json, steps
from fraclink._cli.options import (
    Columns,
    Force,
    GainCrossover,
    Interpolate,
    Json,
    ModeGain,
    PayloadRange,
    PhaseMarginDeg,
    Resample,
    RigName,
    load_log,
    load_rig,
    radians,
)
from fraclink._cli.outcome import FAILS, HOLDS
from fraclink._files import output_path

__all__ = ["register"]

_PARTS = 6  # read, examine, identify, design, simulate, report


def run(
    rig: RigName,
    log: Annotated[str, typer.Option("--log", help="The log; `demo` is the bundled one.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("results"),
    structure: Annotated[
        str, typer.Option("--structure", help="Structure of the model that the design uses.")
    ] = "UD-FOM",
    payload: Annotated[float | None, typer.Option("--payload", help="Payload of the log [kg].")] = None,
    column: Columns = None,
    resample: Resample = False,
    interpolate: Interpolate = False,
    payloads: PayloadRange = None,
    gain_crossover: GainCrossover = None,
    phase_margin_deg: PhaseMarginDeg = None,
    filter_time: Annotated[
        float | None, typer.Option("--filter-time", help="δ [s], 0 for none; default: the 10 % rule.")
    ] = None,
    mode_gain: ModeGain = None,
    certify: Annotated[
        bool, typer.Option("--certify", help="Prove the design, too; takes a few seconds.")
    ] = False,
    title: Annotated[str | None, typer.Option("--title", help="Title of the report.")] = None,
    json: Json = False,
    force: Force = False,
) -> int:
    """Take a log to a model, a controller, simulated moves and a report; the exit code is the verdict."""
    from fraclink._cli.summary import study_text, study_values
    from fraclink._show.report import write_report
    from fraclink._workflow import Request, conduct, save_study

    for name in ("model.json", "design.json", "report.html"):
        output_path(out / name, force=force)
    request = Request(
        payloads=payloads,
        gain_crossover=gain_crossover,
        phase_margin=radians(phase_margin_deg),
        filter_time=filter_time,
        mode_gain=mode_gain,
    )
    with steps(_PARTS + certify) as begin:
        begin("reading the log")
        known = load_rig(rig)
        experiment = load_log(log, known, payload, column, resample=resample, interpolate=interpolate)
        study = conduct(known, experiment, request, structure=structure, certify=certify, begin=begin)
        begin("writing the report")
        save_study(study, out)
        place = write_report(study, out / "report.html", title=title)
    if json:
        emit_json(study_values(study) | {"report": str(place)})
    else:
        emit(study_text(study))
        emit(str(place))
    return HOLDS if study.passed else FAILS


def register(app: typer.Typer) -> None:
    """Add the verb of this module to the application."""
    app.command()(run)
