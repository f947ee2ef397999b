"""Options that several verbs share, and how they become nouns."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fraclink._arm.experiment import Experiment
    from fraclink._arm.link import LinkModel
    from fraclink._arm.rig import Rig

__all__ = [
    "BUNDLED_LOG",
    "Columns",
    "Force",
    "GainCrossover",
    "Gear",
    "Interpolate",
    "Json",
    "LinkMass",
    "LogName",
    "ModeGain",
    "ModelFile",
    "Payload",
    "PayloadRange",
    "PhaseMarginDeg",
    "Resample",
    "RigName",
    "load_link_model",
    "load_log",
    "load_rig",
    "log_path",
    "radians",
]

BUNDLED_LOG = "prbs_30g"  # simulated by the twin; its header says so
LogName = Annotated[str, typer.Argument(metavar="LOG", help="The log; `demo` is the bundled one.")]
RigName = Annotated[
    str,
    typer.Option(
        "--rig", metavar="RIG", help="A rig file (rig.toml) or the name of a bundled rig, e.g. paper-2023."
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite files that are already there.")]
Payload = Annotated[float | None, typer.Option("--payload", help="Payload [kg]; default: nominal.")]
PayloadRange = Annotated[
    tuple[float, float] | None,
    typer.Option("--payloads", metavar="LOW HIGH", help="Payload range [kg]; default: the rig's."),
]
GainCrossover = Annotated[
    float | None, typer.Option("--gain-crossover", help="Least gain crossover [rad/s]; default: the rig's.")
]
PhaseMarginDeg = Annotated[
    float | None, typer.Option("--phase-margin-deg", help="Least phase margin [degrees]; default: the rig's.")
]
ModelFile = Annotated[
    Path | None, typer.Option("--model", help="Model made by identify; default: the rig's own.")
]
ModeGain = Annotated[
    float | None,
    typer.Option("--mode-gain", help="Bound on the loop gain at modes 2 and 3 of a link with mass: 0.5."),
]
LinkMass = Annotated[
    float | None, typer.Option("--link-mass", help="Mass of the link [kg]; default: the rig's.")
]
Gear = Annotated[
    float | None, typer.Option("--gear", help="Gear ratio to put before the motor; default: the rig's.")
]
Columns = Annotated[
    list[str] | None,
    typer.Option(
        "--column",
        metavar="ROLE=NAME [UNIT]",
        help='A column of the log, such as "motor_angle=theta [deg]"; a minus turns the sign. '
        "Instead of [log] in the rig file; roles: time, motor_angle, torque or deflection, voltage.",
    ),
]
Resample = Annotated[
    bool, typer.Option("--resample", help="Interpolate over gaps, repeated stamps and strong jitter.")
]
Interpolate = Annotated[
    bool, typer.Option("--interpolate", help="Fill missing cells, at most 1 % of a column.")
]


def load_rig(name: str, *, link_mass: float | None = None) -> Rig:
    """Return the rig of a file, or the bundled one of that name, with `link_mass` [kg] if one is given."""
    from fraclink._arm.rig import Rig

    looks_like_a_path = name.endswith(".toml") or "/" in name or "\\" in name
    rig = Rig.load(Path(name)) if looks_like_a_path or Path(name).is_file() else Rig.named(name)
    return rig if link_mass is None else replace(rig, link=replace(rig.link, mass=link_mass))


def load_link_model(path: Path | None) -> LinkModel | None:
    """Return the model of a file that `identify` wrote; None where none is given."""
    if path is None:
        return None
    from fraclink._identify import load_model

    return load_model(path)


def load_log(
    name: str,
    rig: Rig,
    payload: float | None,
    columns: list[str] | None = None,
    *,
    resample: bool = False,
    interpolate: bool = False,
) -> Experiment:
    """Return the log of a file, or the bundled one."""
    from fraclink._arm.experiment import parse_columns
    from fraclink._logs import read_log

    stated = parse_columns(columns) if columns else None
    return read_log(
        log_path(name), rig=rig, columns=stated, payload=payload, resample=resample, interpolate=interpolate
    )


def log_path(name: str) -> Path:
    """The file of a log that was named on the command line; ``demo`` is the bundled one."""
    from fraclink._logs import bundled_log

    return bundled_log(BUNDLED_LOG) if name == "demo" else Path(name)


def radians(degrees: float | None) -> float | None:
    """Degrees of `--phase-margin-deg` in radians; what is out of range is named as it was typed."""
    from fraclink._validate import checked_between

    if degrees is None:
        return None
    remedy = "50° is a usual margin"
    return math.radians(
        checked_between("phase_margin_deg", degrees, 0.0, 179.0, "°", open_low=True, remedy=remedy)
    )
