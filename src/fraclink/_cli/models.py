"""Commands on logs and link models: inspect, diagnose, record, and every fit of a link
to a log.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Unpack

import numpy as np
import typer

from fraclink import _identify as identification
from fraclink._arm.draft import RigDraft, doubts_of
from fraclink._arm.experiment import Experiment
from fraclink._arm.reference import Reference, chirp, prbs, pulse
from fraclink._arm.rig import Rig
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Writes, command
from fraclink._cli.console import steps
from fraclink._cli.options import (
    Columns,
    HeldOutShare,
    LinkMass,
    LogName,
    LogOptions,
    ModelFile,
    RigName,
    SeedNumber,
    as_stated,
    load_log,
    load_rig,
    load_rig_for_logs,
    log_path,
    required_model,
    whole,
)
from fraclink._reading.reading import inspect_log
from fraclink._simulate import Twin, simulate_log
from fraclink.errors import FieldError
from fraclink.findings import Finding, errors_of
from fraclink.logs._diagnosis import diagnose as examine
from fraclink.view._figures import validation_figure
from fracsys.checks import Between, Payload

StructureName = Annotated[
    str | None,
    "UD-IOM, D-IOM, UD-FOM or D-FOM; the one that the log supports where it is left out",
]

Payloads = Annotated[
    list[float] | None,
    typer.Option(metavar="KG"),
    "Payload of each log [kg], in their order",
]

app = group()


def _errors(log: Experiment, rig: Rig | RigDraft) -> tuple[Finding, ...]:
    """Findings that make a log unusable: a model fits a reversed gauge as well as a
    right one.
    """
    return errors_of(examine(log, whole(rig)))


def _known_stiffness(log: Experiment, rig: Rig | RigDraft) -> float | None:
    """A deflection log cannot show the stiffness; a torque log measures it."""
    known = whole(rig)
    # Γ = c (θm − θt): of the deflection alone every c fits as well.
    return (
        known.link.stiffness
        if known is not None and log.output_kind == "deflection"
        else None
    )


@command(app)
def inspect(log: LogName) -> Answer:
    """List a log's channels, rates and ranges, and a mapping to paste into the rig
    file.

    $ fraclink inspect log.csv
    """
    listing = inspect_log(log_path(log))
    return Answer(text=str(listing), values=listing.values())


@command(app)
def diagnose(log: LogName, rig: RigName, **reading: Unpack[LogOptions]) -> Answer:
    """Examine a log: offset, sign, delay, saturation, excitation; each finding with a
    remedy.

    $ fraclink diagnose log.csv --rig rig.toml
    """
    known = load_rig_for_logs(rig)
    findings = examine(load_log(log, known, **reading), whole(known))
    # Warnings do not fail a log: a model can be fitted to it, and the fit has gates of
    # its own.
    failed = bool(errors_of(findings))
    following = (
        "" if failed else f"fraclink identify {log} --rig {rig}{as_stated(reading)}"
    )
    return Answer(findings, not failed, following=following)


@command(app)
def identify(
    log: LogName,
    rig: RigName,
    out: Annotated[Path, "File to write the model to", Writes()] = Path("model.json"),
    structure: StructureName = None,
    heldout: HeldOutShare = None,
    **reading: Unpack[LogOptions],
) -> Answer:
    """Fit a link model to a log, with gain, offset and gauge delay as free parameters.

    $ fraclink identify log.csv --rig rig.toml --out model.json
    """
    with steps(3) as begin:
        begin("reading the log")
        known = load_rig_for_logs(rig)
        experiment = load_log(log, known, **reading)
        begin("examining the log")
        doubts = _errors(experiment, known)
        begin(f"fitting {structure or 'every structure'}")
        stiffness = _known_stiffness(experiment, known)
        fit = identification.identify(
            experiment, structure, heldout=heldout, stiffness=stiffness
        )
    fit.save(out)
    # A rig with blanks has no length and mass that the model could contradict.
    if (rig_in_full := whole(known)) is not None:
        # Each once, in the order in which they were found.
        doubts = tuple(dict.fromkeys((*doubts, *doubts_of(rig_in_full, fit.model))))
    following = f"fraclink design --rig {rig} --model {out}"
    if fit.model.payload is None:
        # `design` would take ω₀ from the rig.
        following = "repeat with --force and --payload, the log's payload [kg]: `design` needs it"
    return Answer(fit, fit.passed, doubts=doubts, written=(out,), following=following)


@command(app)
def compare_structures(
    log: LogName,
    rig: RigName,
    heldout: HeldOutShare = None,
    **reading: Unpack[LogOptions],
) -> Answer:
    """Fit all four structures to a log and compare them.

    $ fraclink compare-structures log.csv --rig rig.toml
    """
    known = load_rig_for_logs(rig)
    experiment = load_log(log, known, **reading)
    with steps(2) as begin:
        begin("examining the log")
        doubts = _errors(experiment, known)
        begin("fitting four structures")
        comparison = identification.compare_structures(
            experiment, heldout=heldout, stiffness=_known_stiffness(experiment, known)
        )
    return Answer(comparison, doubts=doubts)


def _logs_of(
    logs: list[str],
    known: Rig | RigDraft,
    column: list[str] | None,
    payload: list[float] | None,
) -> list[Experiment]:
    """Several logs, each with its payload."""
    # In the order of the logs: a mass that went to another log would tie ω₀ to the
    # wrong payload and look like physics.
    if payload and len(payload) != len(logs):
        problem, remedy = "not one for each log", "repeat --payload"
        raise FieldError(
            "payload",
            len(payload),
            problem,
            allowed=f"{len(logs)} values",
            remedy=remedy,
        )
    masses: list[float | None] = list(payload) if payload else [None] * len(logs)
    return [
        load_log(log, known, column, mass)
        for log, mass in zip(logs, masses, strict=True)
    ]


@command(app)
def identify_payloads(
    logs: Annotated[
        list[str],
        typer.Argument(metavar="LOG"),
        "Two or more logs, each of another payload",
    ],
    rig: RigName,
    structure: StructureName = None,
    payload: Payloads = None,
    tied: Annotated[bool, "Tie ω₀ to the payload by equation (5)"] = False,
    column: Columns = None,
) -> Answer:
    """Fit several payloads together and test whether their parameters may be common.

    $ fraclink identify-payloads 20g.csv 40g.csv --rig rig.toml
    """
    known = load_rig(rig)
    experiments = _logs_of(logs, known, column, payload)
    fit = identification.identify_payloads(
        experiments, structure, tied=tied, length=known.link.length
    )
    return Answer(fit, fit.test.common)


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
    found = fit.validate(*_logs_of(logs, known, column, payload))
    if out is not None:
        validation_figure(found).save(out)
    return Answer(found, found.passed, written=() if out is None else (out,))


@command(app)
def plan_experiment(
    rig: RigName,
    standard_error: Annotated[float, "Standard error of λ that is wanted"],
    noise: Annotated[float, "Standard deviation of the gauge's noise [N·m]"],
    duration: Annotated[float, "Length of the log [s]"] = 20.0,
    deflection_limit: Annotated[float, "Largest |θm − θt| [rad]"] = float("inf"),
    kind: Annotated[Literal["prbs", "multisine"], "Excitation"] = "prbs",
    model: ModelFile = None,
) -> Answer:
    """Choose amplitude and band of an excitation for a wanted standard error of λ.

    $ fraclink plan-experiment --rig rig.toml --standard-error 1e-3 --noise 0.04
    """
    known = load_rig(rig, model=model)
    return Answer(
        identification.design_experiment(
            required_model(known),
            standard_error=standard_error,
            noise=noise,
            period=known.period,
            duration=duration,
            kind=kind,
            motor=known.motor,
            deflection_limit=deflection_limit,
        )
    )


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
    model: ModelFile = None,
    excitation: Annotated[Excitation, "Motor reference"] = "prbs",
    amplitude: Annotated[float, "Size of the excitation [rad]"] = 0.1,
    duration: Annotated[
        float, Between(2.0, 3600.0, "s", remedy="20 s is usual"), "Length of the log"
    ] = 20.0,
    gauge_delay: Annotated[
        float, "Delay of the strain amplifier [s], whole milliseconds"
    ] = 0.0,
    seed: SeedNumber = 0,
) -> Answer:
    """Record a log of the twin, in the same CSV a rig writes, marked as simulated.

    $ fraclink record --rig paper-2023 --link-mass 0.00735 --out log.csv
    """
    known = load_rig(rig, model=model)
    # Said before the twin is built, whose own error would speak of damping.
    required_model(known)  # the twin takes its damping from there
    reference = _excitation(excitation, amplitude, duration)
    arm = Twin.from_rig(
        known, payload=payload, link_mass=link_mass, gauge_delay=gauge_delay
    )
    # Both ends: a log of 20 s has a sample at 20 s.
    count = round(duration / known.period) + 1
    log = simulate_log(
        arm.beam,
        arm.damping,
        reference.angle(known.period * np.arange(count)),
        period=known.period,
        sensors=arm.sensors,
        servo_pole=known.motor_loop.pole,
        seed=seed,
    )
    log.save(out)
    return Answer(
        values={"samples": count, "header": dict(log.header)},
        remarks=(f"{count} samples, simulated",),
        written=(out,),
        following=f"fraclink diagnose {out} --rig {rig}",
    )
