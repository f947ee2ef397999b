"""Options shared by several commands, and their conversion to values of the library."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from fraclink._arm.draft import RigDraft, load_rig_or_draft
from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._arm.log_columns import parse_columns
from fraclink._arm.reference import Reference, smooth_step
from fraclink._arm.rig import Rig
from fraclink._cli.command import Keywords, argument, option
from fraclink._design import Design
from fraclink._files import load
from fraclink._identify import Fit
from fraclink._law.design import Specification
from fraclink._reading.reading import bundled_log, read_log
from fraclink._reading.responses import read_reference
from fraclink.errors import FieldError
from fraclink.findings import Finding, errors_of
from fracsys import checks as ranges

BUNDLED_LOG = "prbs_30g"  # simulated by the twin, as its header states

LogName = Annotated[str, argument("LOG"), "The log; `demo` is the bundled one"]
DesignFile = Annotated[Path, argument("DESIGN"), "Design made by `fraclink design`"]
RigName = Annotated[
    str, option("RIG"), "A rig file, or a bundled rig such as paper-2023"
]
NominalPayload = Annotated[ranges.Payload | None, "Payload; default: nominal"]
BoxFlag = Annotated[
    bool | None,
    "Keep every requirement for every arm consistent with fit and rig, or for the model alone; "
    "default: for every arm, unless the request or the rig states a crossover or a margin",
]
# None if not given, so that it can be rejected together with an option that replaces it
Amplitude = Annotated[float | None, "Size of the move [rad]; default: 1"]
ReferenceFile = Annotated[
    Path | None,
    "Move of `fraclink shape`, or a table, to follow instead of --amplitude and --move-time",
]
Estimate = Annotated[
    bool, "The law is given the payload that it estimates while the arm moves"
]
Payloads = Annotated[
    list[float] | None,
    option("KG"),
    "Payload of each log [kg], in their order",
]
Columns = Annotated[
    list[str] | None,
    option("ROLE=NAME [UNIT]"),
    'A column of the log, such as "motor_angle=theta [deg]"; a minus reverses the sign. '
    "Instead of [log] in the rig file; roles: time, motor_angle, torque or deflection, voltage",
]


READING = Keywords(read_log, "keep", "resample", "interpolate")
LOG = Keywords(read_log, "payload", "keep", "resample", "interpolate")
REQUEST = Keywords(Specification, "payloads", "gain_crossover")
PhaseMarginDeg = Annotated[
    ranges.PhaseMarginDeg | None, "Least phase margin; default: the rig's"
]


def in_radians(angle_deg: float | None) -> float | None:
    """An angle that may be left out [rad]."""
    return None if angle_deg is None else math.radians(angle_deg)


def in_seconds(time_ms: float | None) -> float | None:
    """A time that may be left out [s]."""
    return None if time_ms is None else time_ms / 1e3


def load_rig(name: str, *, link_mass: float | None = None) -> Rig:
    """Return the rig of a file, or the bundled one of that name, with the mass given."""
    rig = Rig.load(Path(name)) if _is_path(name) else Rig.named(name)
    if link_mass is not None:
        rig = replace(rig, link=replace(rig.link, mass=link_mass))
    return rig


def _is_path(name: str) -> bool:
    # A name that looks like a path is one even if the file does not exist: "no such
    # file" helps more than a list of bundled rigs. A plain name of an existing file is
    # a path too.
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


def load_link_model(
    path: Path | None, rig: Rig
) -> tuple[LinkModel | None, tuple[Finding, ...]]:
    """Return the model from a file of `identify` or `design` (None where no file is
    given) and the gates that its fit or its design failed.

    From a fit it is the model as the loop of `rig` meets it (`Fit.loop_model`).
    """
    if path is None:
        return None, ()
    content: Any = load(path, (Fit, Design, LinkModel))
    # A bare model, as from a spectrum, has no gates that could fail.
    if isinstance(content, LinkModel):
        return content, ()
    # A design contains its model: a user who only kept design.json can go on.
    model = content.model if isinstance(content, Design) else content.loop_model(rig)
    return model, errors_of(content.findings)


def doubts_of_move(design: Design, *payloads: float | None) -> tuple[Finding, ...]:
    """The reasons why a move shows nothing: errors of the design, and payloads in
    another unit.
    """
    # Each once: --payload 30 --told 30 is one mistake.
    masses = (mass for mass in dict.fromkeys(payloads) if mass is not None)
    return (*filter(None, map(design.rig.payloads.doubt, masses)), *design.doubts)


def load_design(path: Path) -> Design:
    """Return a design whose rig carries the model that it was made for."""
    design = Design.load(path)
    # The twin takes its damping from the model of the rig, and a design from a fit may
    # have a rig without one.
    rig = replace(design.rig, model=design.rig.model or design.model)
    return replace(design, rig=rig)


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
        # Rejected instead of ignored: the user expects a given size to have an effect.
        refuse_beside(
            "--reference",
            "the move of the file",
            amplitude=amplitude,
            move_time=move_time,
        )
        return read_reference(path)
    time = usual_time if move_time is None else move_time
    return smooth_step(1.0 if amplitude is None else amplitude, duration=time)


def refuse_beside(option: str, instead: str, **given: object) -> None:
    """Raise FieldError for the first value that was given though `option` leaves it
    without effect.
    """
    for name, value in given.items():
        if value is not None:
            text = str(value) if isinstance(value, Path) else value
            remedy = f"leave out --{name.replace('_', '-')}"
            if option.startswith("--"):
                remedy += f" or {option}"
            raise FieldError(name, text, f"given beside {option}", instead, remedy)


def load_log(
    name: str,
    rig: Rig | RigDraft,
    column: list[str] | None = None,
    **options: Any,
) -> Experiment:
    """Return the log of a file, or the bundled one."""
    # --column replaces the rig's [log] table as a whole.
    columns = parse_columns(column) if column else rig.log
    return read_log(log_path(name), columns=columns, **options)


def load_logs(
    names: list[str],
    rig: Rig | RigDraft,
    payloads: list[float] | None,
    column: list[str] | None = None,
    **options: Any,
) -> list[Experiment]:
    """Return several logs, each with its payload."""
    # In the order of the logs: a mass assigned to the wrong log would tie ω₀ to the
    # wrong payload unnoticed.
    if payloads and len(payloads) != len(names):
        raise FieldError(
            "payload",
            len(payloads),
            "not one for each log",
            f"{len(names)} values",
            "repeat --payload",
        )
    masses: list[float | None] = list(payloads) if payloads else [None] * len(names)
    return [
        load_log(name, rig, column, payload=mass, **options)
        for name, mass in zip(names, masses, strict=True)
    ]


def log_path(name: str) -> Path:
    """The file of a log that was named on the command line; ``demo`` is the bundled
    one.
    """
    return bundled_log(BUNDLED_LOG) if name == "demo" else Path(name)
