"""Commands on logs: inspect, diagnose, validate, record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer

from fraclink import _identify as identification
from fraclink._arm.reference import Reference, chirp, prbs, pulse
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Writes, command
from fraclink._cli.options import (
    LOG,
    Columns,
    LinkMass,
    LogName,
    Payloads,
    RigName,
    SeedNumber,
    as_stated,
    load_log,
    load_logs,
    load_rig,
    load_rig_for_logs,
    log_path,
    required,
    whole,
)
from fraclink._reading.reading import inspect_log
from fraclink._simulate import Twin, simulate_log
from fraclink.findings import errors_of
from fraclink.logs import diagnose as examine
from fraclink.view._figures import validation_figure
from fracsys.checks import Between, Payload

app = group()


@command(app)
def inspect(log: LogName) -> Answer:
    """List a log's channels, rates and ranges, and a mapping to paste into the rig
    file.

    $ fraclink inspect log.csv
    """
    listing = inspect_log(log_path(log))
    return Answer(text=str(listing), values=listing.values())


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
    known = load_rig_for_logs(rig)
    findings = examine(load_log(log, known, column, **reading), whole(known))
    # Warnings do not fail a log: a model can be fitted to it, and the fit has gates of
    # its own.
    failed = bool(errors_of(findings))
    following = (
        ""
        if failed
        else f"fraclink identify {log} --rig {rig}{as_stated({'column': column} | reading)}"
    )
    return Answer(findings, not failed, following=following)


@command(app)
def validate(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL"), "Model made by `fraclink identify`"
    ],
    logs: Annotated[
        list[str],
        typer.Argument(metavar="LOG"),
        "One or more logs that the model was not made from",
    ],
    rig: RigName,
    out: Annotated[
        Path | None, "Figure of the logs under the prediction (.svg)", Writes()
    ] = None,
    payload: Payloads = None,
    column: Columns = None,
) -> Answer:
    """Hold a model against other logs of the arm: its error on each, and what each log
    says of the link by itself.

    $ fraclink validate model.json other.csv --rig rig.toml
    """
    fit = identification.Fit.load(model)
    known = load_rig_for_logs(rig)
    found = fit.validate(*load_logs(logs, known, payload, column=column))
    if out is not None:
        validation_figure(found).save(out)
    return Answer(found, found.passed, written=() if out is None else (out,))


AT_REST = (
    0.5  # [s] before the excitation: an identification takes the first sample for rest
)
Excitation = Literal["prbs", "pulse", "chirp"]


def _excitation(kind: Excitation, amplitude: float, duration: float) -> Reference:
    if kind == "pulse":
        # A third of the log up, the rest down: a ring-down behind each edge.
        return pulse(amplitude, 0.35 * duration, start=AT_REST)
    if kind == "chirp":
        # 0.2 to 5 Hz, about the 2 Hz at which the paper's arm rings.
        return chirp(amplitude, 0.2, 5.0, duration=duration)
    bit = 0.24
    return prbs(
        amplitude, bit, bits=max(1, int(duration / bit)), register=9, start=AT_REST
    )


@command(app)
def record(
    rig: RigName,
    out: Annotated[Path, "File to write the log to (CSV)", Writes()] = Path(
        "twin_log.csv"
    ),
    payload: Annotated[Payload | None, "Payload; default: nominal"] = None,
    link_mass: LinkMass = None,
    excitation: Annotated[Excitation, "Motor reference"] = "prbs",
    amplitude: Annotated[float, "Size of the excitation [rad]"] = 0.1,
    duration: Annotated[
        float, Between(2.0, 3600.0, "s", remedy="20 s is usual"), "Length of the log"
    ] = 20.0,
    seed: SeedNumber = 0,
) -> Answer:
    """Record a log of the twin, in the same CSV a rig writes, marked as simulated.

    $ fraclink record --rig paper-2023 --link-mass 0.00735 --out log.csv
    """
    known = load_rig(rig)
    # Said before the twin is built, whose own error would speak of damping.
    remedy = "give a rig with [model], or make it one with `fraclink identify`"
    required("model", known.model, "a model of the link", remedy)
    reference = _excitation(excitation, amplitude, duration)
    arm = Twin.from_rig(known, payload=payload, link_mass=link_mass)
    # Both ends: a log of 20 s has a sample at 20 s.
    count = round(duration / known.period) + 1
    log = simulate_log(
        arm.beam,
        arm.damping,
        reference.angle(known.period * np.arange(count)),
        period=known.period,
        sensors=arm.sensors,
        motor_loop_pole=known.motor_loop.pole,
        seed=seed,
    )
    log.save(out)
    return Answer(
        values={"samples": count, "header": dict(log.header)},
        remarks=(f"{count} samples, simulated",),
        written=(out,),
        following=f"fraclink diagnose {out} --rig {rig}",
    )
