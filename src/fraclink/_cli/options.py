"""Options that several commands share, and how they become values of the library."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

import typer

from fraclink._arm.draft import RigDraft, load_rig_or_draft
from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._arm.log_columns import parse_columns
from fraclink._arm.reference import Reference, smooth_step
from fraclink._arm.rig import Rig
from fraclink._design import Design
from fraclink._files import kind_of
from fraclink._identify import Fit, load_model
from fraclink._identify.fitting import HeldOut
from fraclink._law.estimator import PayloadEstimator
from fraclink._reading.reading import bundled_log, read_log
from fraclink._reading.responses import read_reference
from fraclink._simulate import Twin, geared
from fraclink.errors import FieldError
from fraclink.findings import Finding, errors_of
from fracsys import checks as ranges

BUNDLED_LOG = "prbs_30g"  # simulated by the twin; its header says so

LogName = Annotated[
    str, typer.Argument(metavar="LOG"), "The log; `demo` is the bundled one"
]
DesignFile = Annotated[
    Path, typer.Argument(metavar="DESIGN"), "Design made by `fraclink design`"
]
RigName = Annotated[
    str, typer.Option(metavar="RIG"), "A rig file, or a bundled rig such as paper-2023"
]
ModelFile = Annotated[
    Path | None,
    "Model of identify, or a design; default: the rig's or the design's own",
]
LinkMass = Annotated[float | None, "Mass of the link [kg]; default: the rig's"]
Gear = Annotated[
    ranges.Positive | None, "Gear ratio to put before the motor; default: the rig's"
]
PayloadRange = Annotated[
    tuple[float, float] | None,
    typer.Option(metavar="LOW HIGH"),
    "Payload range [kg]; default: the rig's",
]
FilterTime = Annotated[
    float | None, "δ [s], 0 for none; default: chosen with the controller"
]
ModeGain = Annotated[
    float | None,
    "Bound on the loop gain at modes 2 and 3 of a link with mass, usually 0.5",
]
BoxFlag = Annotated[
    bool,
    "Keep every requirement over all that fit and rig leave open of the arm, not at the model alone",
]
Placement = Annotated[Literal["tustin", "direct"], "Poles of the sampled motor loop"]
MotorLoopKind = Annotated[Literal["ideal", "sampled"], "Motor loop"]
SeedNumber = Annotated[ranges.Seed, "Seed of the noise"]
# None where it is not given, so that it can be refused beside what takes its place
Amplitude = Annotated[float | None, "Size of the move [rad]; default: 1"]
MoveTime = Annotated[float | None, "Time of the move [s]; default: 1"]
ReferenceFile = Annotated[
    Path | None,
    "Move of `fraclink shape`, or a table, to follow instead of --amplitude and --move-time",
]
GivenPayload = Annotated[float, "Payload that the law is given [kg]; 0: none"]
Estimate = Annotated[
    bool, "The law is given the payload that it estimates while the arm moves"
]
HeldOutShare = Annotated[
    HeldOut | None,
    "Share at the end that no fit sees; default: 0.4, or more where the arm rests",
]
Columns = Annotated[
    list[str] | None,
    typer.Option(metavar="ROLE=NAME [UNIT]"),
    'A column of the log, such as "motor_angle=theta [deg]"; a minus turns the sign. '
    "Instead of [log] in the rig file; roles: time, motor_angle, torque or deflection, voltage",
]


class LogOptions(TypedDict):
    """How a log is read where the rig file does not say it."""

    payload: Annotated[ranges.Payload | None, "Payload of the log"]
    column: Columns
    keep: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="FROM UNTIL"),
        "Stretch of the log to read [s from its first sample]; default: all of it",
    ]
    resample: Annotated[
        bool, "Interpolate over gaps, repeated stamps and strong jitter"
    ]
    interpolate: Annotated[bool, "Fill missing cells, at most 1 % of a column"]


class DesignRequest(TypedDict):
    """What a design is asked for; the rig completes it."""

    payloads: PayloadRange
    gain_crossover: Annotated[
        ranges.Frequency | None, "Least gain crossover; default: the rig's"
    ]
    phase_margin_deg: Annotated[
        ranges.PhaseMarginDeg | None, "Least phase margin; default: the rig's"
    ]
    filter_time: FilterTime
    mode_gain: ModeGain


class ArmOptions(TypedDict):
    """The arm that a design is run on."""

    payload: Annotated[ranges.Payload | None, "Payload; default: nominal"]
    link_mass: LinkMass
    gear: Gear
    model: ModelFile


def as_stated(options: Mapping[str, Any]) -> str:
    """The options that were given, as words of the next command, each behind a space."""
    words: list[str] = []
    for name, value in options.items():
        flag = f"--{name.replace('_', '-')}"
        if name == "column":
            words += [word for each in value or () for word in (flag, each)]
        elif value is True:
            words.append(flag)
        # Six digits, as people give them: the words are pasted and compared by eye.
        elif isinstance(value, tuple):
            words += [flag, *(f"{each:g}" for each in value)]
        elif value is not None and value is not False:
            words += [flag, f"{value:g}"]
    return "".join(f" {shlex.quote(word)}" for word in words)


def in_radians(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """The options of a request as the library takes them: ``phase_margin`` [rad] for
    the one in degrees.
    """
    margin = wanted["phase_margin_deg"]
    rest = {name: value for name, value in wanted.items() if name != "phase_margin_deg"}
    return rest | {"phase_margin": None if margin is None else math.radians(margin)}


def load_rig(
    name: str, *, link_mass: float | None = None, model: Path | None = None
) -> Rig:
    """Return the rig of a file, or the bundled one of that name, with the mass and the
    model given.
    """
    rig = Rig.load(Path(name)) if _is_path(name) else Rig.named(name)
    rig = (
        rig
        if link_mass is None
        else replace(rig, link=replace(rig.link, mass=link_mass))
    )
    return rig if model is None else replace(rig, model=load_link_model(model, rig))


def _is_path(name: str) -> bool:
    # What looks like a path is one even if it is not there: "no such file" helps more
    # than a list of bundled rigs. A plain name that is a file is one, too.
    return name.endswith(".toml") or "/" in name or "\\" in name or Path(name).is_file()


def load_rig_for_logs(name: str) -> Rig | RigDraft:
    """Return a rig for reading and fitting a log: the numbers that only a design needs
    may be blank.
    """
    return load_rig_or_draft(Path(name)) if _is_path(name) else Rig.named(name)


def whole(rig: Rig | RigDraft) -> Rig | None:
    """Return the rig, or None where it has blanks and so no limits to check a log
    against.
    """
    return rig if isinstance(rig, Rig) else None


def required_model(rig: Rig) -> LinkModel:
    """Return the rig's model, or FieldError that names the option which gives one."""
    if rig.model is None:
        allowed, remedy = (
            "a model of the link",
            "give --model model.json, or add [model] to the rig file",
        )
        raise FieldError("model", None, "missing", allowed=allowed, remedy=remedy)
    return rig.model


def load_link_model(path: Path | None, rig: Rig | None = None) -> LinkModel | None:
    """Return the model of a file of `identify` or `design`; None where none is given.

    Of a fit it is the one that the loop of `rig` meets, where that is given
    (`Fit.loop_model`).
    """
    if path is None:
        return None
    kind = kind_of(path)
    if kind == "fit" and rig is not None:
        return Fit.load(path).loop_model(rig)
    # A design carries the model it was made for: who kept only design.json can go on.
    return Design.load(path).model if kind == "design" else load_model(path)


def load_doubts(path: Path | None) -> tuple[Finding, ...]:
    """The gates that the fit or the design of a model file failed."""
    # A bare model, as from a spectrum, has no gates that could have failed.
    if path is None or (kind := kind_of(path)) not in ("fit", "design"):
        return ()
    found: Fit | Design = Design.load(path) if kind == "design" else Fit.load(path)
    return errors_of(found.findings)


def doubts_of_move(made: Design, *payloads: float | None) -> tuple[Finding, ...]:
    """What leaves nothing shown by a move: errors of the design, and payloads in
    another unit.
    """
    # Each once: --payload 30 --told 30 is one mistake.
    masses = (mass for mass in dict.fromkeys(payloads) if mass is not None)
    return (*filter(None, map(made.rig.payloads.doubt, masses)), *made.doubts)


def load_design(
    path: Path, *, gear: float | None = None, model: Path | None = None
) -> Design:
    """Return a design whose rig carries the model that it was made for, with a gear
    before the motor.
    """
    made = Design.load(path)
    # The model of the option, of the rig, of the design, in this order: the twin takes
    # its damping from it, and a design of a fit may stand on a rig file without one.
    rig = replace(
        made.rig, model=load_link_model(model, made.rig) or made.rig.model or made.model
    )
    return replace(made, rig=rig if gear is None else geared(rig, gear))


def load_arm(path: Path, options: ArmOptions) -> tuple[Design, Twin]:
    """Return a design and the twin that it is run on."""
    made = load_design(path, gear=options["gear"], model=options["model"])
    return made, Twin.from_rig(
        made.rig, payload=options["payload"], link_mass=options["link_mass"]
    )


def reference_of(
    path: Path | None,
    amplitude: float | None,
    move_time: float | None,
    *,
    usual_time: float = 1.0,
) -> Reference:
    """Return the reference of a file, or the quintic of that size [rad] and duration
    [s].
    """
    if path is not None:
        # Refused rather than dropped: a user who gives a size believes that it counts.
        refuse_beside(
            "--reference",
            "the move of the file",
            amplitude=amplitude,
            move_time=move_time,
        )
        return read_reference(path)
    # Under the option's own name: a reference calls it its duration.
    time = ranges.Between(1e-9, 1e9, "s").check(
        "move_time", usual_time if move_time is None else move_time
    )
    return smooth_step(1.0 if amplitude is None else amplitude, duration=time)


def refuse_beside(option: str, instead: str, **given: object) -> None:
    """Raise FieldError for the first value that was given though `option` leaves it
    without effect.
    """
    for name, value in given.items():
        if value is not None:
            shown = str(value) if isinstance(value, Path) else value
            remedy = f"leave out --{name.replace('_', '-')} or {option}"
            raise FieldError(
                name, shown, f"given beside {option}", allowed=instead, remedy=remedy
            )


def load_log(
    name: str,
    rig: Rig | RigDraft,
    column: list[str] | None = None,
    payload: float | None = None,
    **options: Any,
) -> Experiment:
    """Return the log of a file, or the bundled one."""
    columns = parse_columns(column) if column else rig.log
    # The columns stand for the rig: --column replaces its [log] as a whole.
    return read_log(
        log_path(name), rig=None, columns=columns, payload=payload, **options
    )


def log_path(name: str) -> Path:
    """The file of a log that was named on the command line; ``demo`` is the bundled
    one.
    """
    return bundled_log(BUNDLED_LOG) if name == "demo" else Path(name)


def told_or_estimated(
    made: Design, told: float, estimate: bool
) -> float | PayloadEstimator:
    """What `simulate` takes for --told and --estimate; FieldError where both are given."""
    # A payload of 0 is none, so that --told 0 beside --estimate is no contradiction.
    if estimate and told:
        allowed, remedy = (
            "one of --told and --estimate",
            "leave --told out to have the payload estimated",
        )
        raise FieldError(
            "told", told, "given beside --estimate", allowed=allowed, remedy=remedy
        )
    return made.estimator() if estimate else told


def named_channels(input: str | None, output: str | None) -> tuple[str, str]:
    """Both columns of a recording; FieldError where one of them is not named."""
    for name, column in {"input": input, "output": output}.items():
        if column is None:
            remedy = "a recording needs both, anything else none of them"
            raise FieldError(
                name, None, "missing", allowed="the name of a column", remedy=remedy
            )
    return str(input), str(output)
