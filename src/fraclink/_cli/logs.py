"""Verbs on logs: inspect, diagnose."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from fraclink._cli.console import emit, emit_json
from fraclink._cli.options import (
    Columns,
    Interpolate,
    Json,
    LogName,
    Resample,
    RigName,
    load_log,
    load_rig,
    log_path,
)
from fraclink._cli.outcome import FAILS, HOLDS

if TYPE_CHECKING:
    from fraclink._arm.experiment import Experiment
    from fraclink._arm.rig import Rig
    from fraclink.findings import Finding

__all__ = ["register", "what_is_wrong"]


def what_is_wrong(experiment: Experiment, rig: Rig) -> tuple[Finding, ...]:
    """Findings that make a log unusable: a model fits a reversed gauge as well as a right one."""
    from fraclink._logs import diagnose as examine

    return tuple(finding for finding in examine(experiment, rig) if finding.severity == "error")


def inspect(
    log: LogName,
    json: Json = False,
) -> int:
    """List a log's channels, rates and ranges, and a mapping to paste into the rig file."""
    from fraclink._logs import inspect_log

    listing = inspect_log(log_path(log))
    emit_json(listing.values()) if json else emit(str(listing))
    return HOLDS


def diagnose(
    log: LogName,
    rig: RigName,
    payload: Annotated[float | None, typer.Option("--payload", help="Payload of the log [kg].")] = None,
    column: Columns = None,
    resample: Resample = False,
    interpolate: Interpolate = False,
    json: Json = False,
) -> int:
    """Examine a log: offset, sign, delay, saturation, excitation; each finding with what to do."""
    from fraclink._cli.summary import finding_text, finding_values
    from fraclink._logs import diagnose as examine

    known = load_rig(rig)
    findings = examine(
        load_log(log, known, payload, column, resample=resample, interpolate=interpolate), known
    )
    if json:
        emit_json({"findings": [finding_values(finding) for finding in findings]})
    else:
        emit("\n".join(map(finding_text, findings)) or "nothing to remark")
    return FAILS if any(finding.severity == "error" for finding in findings) else HOLDS


def register(app: typer.Typer) -> None:
    """Add the verbs of this module to the application."""
    for verb in (inspect, diagnose):
        app.command()(verb)
