"""Options that several commands share, and how they become values of the library."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from fraclink import _validate as ranges
from fraclink._arm.experiment import Experiment, parse_columns
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._cli.command import option
from fraclink._design import Design
from fraclink._files import kind_of
from fraclink._identify import load_model
from fraclink._logs import bundled_log, read_log
from fraclink._simulate import geared
from fraclink.errors import FieldError

BUNDLED_LOG = "prbs_30g"  # simulated by the twin; its header says so

LogName = Annotated[str, typer.Argument(metavar="LOG", help="The log; `demo` is the bundled one.")]
DesignFile = Annotated[Path, typer.Argument(metavar="DESIGN", help="Design made by `fraclink design`.")]
RigName = Annotated[
    str,
    option(
        "--rig", metavar="RIG", help="A rig file (rig.toml) or the name of a bundled rig, e.g. paper-2023."
    ),
]
Payload = Annotated[float | None, option("--payload", range=ranges.Payload, help="Payload; default: nominal")]
LogPayload = Annotated[float | None, option("--payload", range=ranges.Payload, help="Payload of the log")]
PayloadRange = Annotated[
    tuple[float, float] | None,
    option("--payloads", metavar="LOW HIGH", help="Payload range [kg]; default: the rig's."),
]
GainCrossover = Annotated[
    float | None,
    option("--gain-crossover", range=ranges.Frequency, help="Least gain crossover; default: the rig's"),
]
_MarginDeg = Annotated[float, ranges.Between(0.0, 179.0, "°", low_open=True, remedy="50° is a usual margin")]
PhaseMarginDeg = Annotated[
    float | None,
    option("--phase-margin-deg", range=_MarginDeg, help="Least phase margin; default: the rig's"),
]
FilterTime = Annotated[
    float | None, option("--filter-time", help="δ [s], 0 for none; default: the 10 % rule.")
]
ModelFile = Annotated[
    Path | None, option("--model", help="Model of identify, or a design; default: the rig's or design's own.")
]
ModeGain = Annotated[
    float | None,
    option("--mode-gain", help="Bound on the loop gain at modes 2 and 3 of a link with mass, usually 0.5."),
]
LinkMass = Annotated[float | None, option("--link-mass", help="Mass of the link [kg]; default: the rig's.")]
Gear = Annotated[
    float | None, option("--gear", help="Gear ratio to put before the motor; default: the rig's.")
]
Placement = Annotated[
    Literal["tustin", "direct"], option("--placement", help="Poles of the sampled motor loop.")
]
MotorLoopKind = Annotated[Literal["ideal", "sampled"], option("--inner", help="Motor loop.")]
SeedNumber = Annotated[int, option("--seed", range=ranges.Seed, help="Seed of the noise")]
Columns = Annotated[
    list[str] | None,
    option(
        "--column",
        metavar="ROLE=NAME [UNIT]",
        help='A column of the log, such as "motor_angle=theta [deg]"; a minus turns the sign. '
        "Instead of [log] in the rig file; roles: time, motor_angle, torque or deflection, voltage.",
    ),
]
Resample = Annotated[
    bool, option("--resample", help="Interpolate over gaps, repeated stamps and strong jitter.")
]
Interpolate = Annotated[bool, option("--interpolate", help="Fill missing cells, at most 1 % of a column.")]


@ranges.checked
def radians(*, phase_margin_deg: _MarginDeg | None) -> float | None:
    """Degrees of `--phase-margin-deg` in radians; what is out of range is named as it was typed."""
    return None if phase_margin_deg is None else math.radians(phase_margin_deg)


def load_rig(name: str, *, link_mass: float | None = None, model: Path | None = None) -> Rig:
    """Return the rig of a file, or the bundled one of that name, with the mass and the model given."""
    looks_like_a_path = name.endswith(".toml") or "/" in name or "\\" in name
    rig = Rig.load(Path(name)) if looks_like_a_path or Path(name).is_file() else Rig.named(name)
    rig = rig if link_mass is None else replace(rig, link=replace(rig.link, mass=link_mass))
    return rig if model is None else replace(rig, model=load_link_model(model))


def required_model(rig: Rig) -> LinkModel:
    """Return the rig's model, or FieldError that names the option which gives one."""
    if rig.model is None:
        allowed, remedy = "a model of the link", "give --model model.json, or add [model] to the rig file"
        raise FieldError("model", None, "missing", allowed=allowed, remedy=remedy)
    return rig.model


def load_link_model(path: Path | None) -> LinkModel | None:
    """Return the model of a file of `identify` or `design`; None where none is given."""
    if path is None:
        return None
    return Design.load(path).model if kind_of(path) == "design" else load_model(path)


def load_design(path: Path, *, gear: float | None = None, model: Path | None = None) -> Design:
    """Return a design whose rig carries the model that it was made for, with a gear before the motor."""
    made = Design.load(path)
    rig = replace(made.rig, model=load_link_model(model) or made.rig.model or made.model)
    return replace(made, rig=rig if gear is None else geared(rig, gear))


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
    stated = parse_columns(columns) if columns else None
    options = {"resample": resample, "interpolate": interpolate}
    return read_log(log_path(name), rig=rig, columns=stated, payload=payload, **options)


def log_path(name: str) -> Path:
    """The file of a log that was named on the command line; ``demo`` is the bundled one."""
    return bundled_log(BUNDLED_LOG) if name == "demo" else Path(name)
