"""Commands on logs: inspect, diagnose, validate."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

from fraclink import _identify as identification
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Writes, argument, command
from fraclink._cli.options import (
    LOG,
    Columns,
    LogName,
    Payloads,
    RigName,
    load_log,
    load_logs,
    load_rig_for_logs,
    log_path,
    whole,
)
from fraclink._reading.reading import inspect_log
from fraclink.findings import errors_of
from fraclink.logs import diagnose as examine
from fraclink.view._figures import validation_figure

app = group()


@command(app)
def inspect(log: LogName) -> Answer:
    """List a log's channels, rates and ranges.

    $ fraclink inspect log.csv
    """
    return Answer(inspect_log(log_path(log)))


@command(app)
def diagnose(
    log: LogName,
    rig: RigName,
    column: Columns = None,
    **reading: Annotated[Any, LOG],
) -> Answer:
    """Examine a log: offset, sign, delay, saturation, excitation; each finding with a
    remedy.

    $ fraclink diagnose log.csv --rig rig.toml
    """
    arm = load_rig_for_logs(rig)
    findings = examine(load_log(log, arm, column, **reading), whole(arm))
    # Warnings do not fail a log: a model can be fitted to it, and the fit has its own
    # gates.
    failed = bool(errors_of(findings))
    following = "" if failed else f"fraclink identify {shlex.quote(log)} --rig {rig}"
    if following and (column or any(reading.values())):
        following += ", with the same options"
    return Answer(findings, not failed, following=following)


@command(app)
def validate(
    model: Annotated[Path, argument("MODEL"), "Model made by `fraclink identify`"],
    logs: Annotated[
        list[str],
        argument("LOG"),
        "One or more logs that the model was not made from",
    ],
    rig: RigName,
    out: Annotated[
        Path | None, "Figure of the logs under the prediction (.svg)", Writes()
    ] = None,
    payload: Payloads = None,
    column: Columns = None,
) -> Answer:
    """Test a model on other logs of the arm: its error on each, and the link that each
    log gives by itself.

    $ fraclink validate model.json other.csv --rig rig.toml
    """
    fit = identification.Fit.load(model)
    arm = load_rig_for_logs(rig)
    validation = fit.validate(*load_logs(logs, arm, payload, column=column))
    figure = {} if out is None else {out: validation_figure(validation)}
    return Answer(validation, validation.passed, saved=figure)
