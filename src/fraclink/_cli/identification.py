"""The command `identify`: a link from one log or several, a motor, a frequency
response, any structure.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np

from fraclink import _identify as identification
from fraclink._arm.draft import doubts_of
from fraclink._arm.experiment import Experiment
from fraclink._arm.log_columns import drive_columns
from fraclink._arm.recording import FrequencyResponse, Recording
from fraclink._arm.rig import Rig
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Keywords, argument, command, declared, option
from fraclink._cli.console import steps
from fraclink._cli.options import (
    READING,
    Columns,
    Payloads,
    in_seconds,
    load_logs,
    load_rig,
    load_rig_for_logs,
    log_path,
    refuse_beside,
    whole,
)
from fraclink._files import output_path, save
from fraclink._reading.reading import read_log
from fraclink._reading.responses import read_frequency_response, read_recording
from fraclink.errors import FieldError, LogError, required
from fraclink.findings import errors_of
from fraclink.logs import diagnose
from fracsys.checks import Real, above

app = group()


RigFile = Annotated[
    str | None,
    option("RIG"),
    "A rig file, or a bundled rig such as paper-2023; a link needs one",
]
ModelOut = Annotated[
    Path | None,
    "File to write the model to; default: model.json, or structure.json for a transfer function",
]
Output = Annotated[
    str | None,
    "Transfer function: column of its output; with `driven`: torque, if that was measured instead of the motor angle",
]
BAND = Keywords(identification.identify_driven_link, "band")


def _link(
    logs: list[str],
    structure: str | None,
    *,
    rig: RigFile = None,
    out: ModelOut = None,
    payload: Payloads = None,
    column: Columns = None,
    force: bool = False,
    **options: Annotated[Any, READING, Keywords(identification.identify, "heldout")],
) -> Answer:
    """One log of a link."""
    rig, place = _rig(rig), output_path(out or "model.json", force=force)
    with steps(3) as begin:
        begin("reading the log")
        file_rig = load_rig_for_logs(rig)
        reading = READING.of(options)
        (experiment,) = load_logs(logs, file_rig, payload, column, **reading)
        # A rig with blanks has no limits, no stiffness and no length.
        arm, stiffness = whole(file_rig), None
        begin("examining the log")
        # A model fits a reversed gauge as well as a correct one.
        doubts = errors_of(diagnose(experiment, arm))
        begin(f"fitting {structure or 'every structure'}")
        # A deflection log does not determine the stiffness: in Γ = c (θm − θt) every c
        # fits equally well. A torque log does.
        if arm is not None and experiment.output_kind == "deflection":
            stiffness = arm.link.stiffness
        fit = identification.identify(
            experiment, structure, heldout=options["heldout"], stiffness=stiffness
        )
    if arm is not None:
        # Each once, in the order in which they were found.
        doubts = tuple(dict.fromkeys((*doubts, *doubts_of(arm, fit.model))))
    following = f"fraclink design --rig {rig} --model {place}"
    if fit.model.payload is None:
        # Otherwise `design` would take ω₀ from the rig.
        following = "repeat with --force and --payload, the log's payload [kg]: `design` needs it"
    return Answer(
        fit, fit.passed, doubts=doubts, saved={place: fit}, following=following
    )


def _rig(name: str | None) -> str:
    return required("rig", name, "a rig", "give --rig rig.toml, or --rig paper-2023")


def _several(
    logs: list[str],
    structure: str | None,
    *,
    rig: RigFile = None,
    payload: Payloads = None,
    column: Columns = None,
    **options: Annotated[
        Any, READING, Keywords(identification.identify_payloads, "tied")
    ],
) -> Answer:
    """Several payloads together, and whether their parameters may be common."""
    arm, reading = load_rig(_rig(rig)), READING.of(options)
    fit = identification.identify_payloads(
        load_logs(logs, arm, payload, column, **reading),
        structure,
        tied=options["tied"],
        length=arm.link.length,
    )
    return Answer(fit, fit.test.common)


def _motor(
    logs: list[str],
    structure: str | None,
    *,
    column: Columns = None,
    rig: RigFile = None,
) -> Answer:
    """K/J, ν/J, Coulomb torque, dead zone and delay of a motor from voltage and angle.

    The link loads the motor: its torque is taken from the log, or computed from its
    deflection with the rig's stiffness. A log of angle and voltage alone is that of a
    motor without a link.
    """
    if not column:
        rig = required(
            "rig",
            rig,
            "a rig, or the columns",
            "give --rig, or --column for time, motor_angle and voltage",
        )
    arm = None if rig is None else load_rig(rig)
    # --column describes the whole log: mixed with the rig's mapping, two columns could
    # have the same role.
    columns = drive_columns(column) if column else None
    experiment = read_log(log_path(logs[0]), rig=arm, columns=columns)
    if experiment.voltage is None:
        raise LogError(
            "log",
            logs[0],
            "without the amplifier's voltage",
            "a log with a voltage column",
            'name it in the rig file\'s [log], or by --column "voltage=NAME [V]"',
        )
    torque = _load(experiment, arm)
    fit = identification.identify_motor(
        experiment.voltage,
        experiment.motor_angle,
        period=experiment.period,
        torque=torque,
        # Only if no torque determines the inertia: a stated and a measured value could
        # contradict each other unnoticed.
        inertia=arm.motor.inertia if torque is None and arm is not None else None,
    )
    return Answer(fit, fit.passed)


def _load(log: Experiment, rig: Rig | None) -> Real | None:
    """The link's torque on the motor; None for a log of the drive alone."""
    if log.output_kind == "torque":
        return log.output
    if np.array_equal(log.output, log.motor_angle):
        return None  # `drive_columns`: there is no other signal
    if rig is None:
        raise LogError(
            "log",
            log.source,
            "with a deflection only",
            "the link's torque",
            "give --rig, whose stiffness turns the deflection into a torque",
        )
    return rig.link.stiffness * log.output


def _driven(
    tables: list[str],
    structure: str | None,
    *,
    column: Columns = None,
    output: Output = None,
    payload: Payloads = None,
    rig: RigFile = None,
    out: ModelOut = None,
    force: bool = False,
    **options: Annotated[Any, BAND],
) -> Answer:
    """Link and motor, from a frequency response to the amplifier's voltage."""
    rig, place = _rig(rig), output_path(out or "model.json", force=force)
    arm = load_rig(rig)
    # The function itself rejects any other output.
    fit = identification.identify_driven_link(
        read_frequency_response(tables[0], _named(column)),
        output=cast(Any, output or "motor_angle"),
        **options,
    )
    if not fit.passed:
        return Answer(fit, passed=False)
    # J n² [kg·m²]: the response is that of the gear's output.
    inertia = arm.motor.inertia * arm.motor.gear_ratio**2
    mass = payload[0] if payload else arm.payloads.nominal
    save(fit.model(inertia, payload=mass), place, force=True)
    following = f"fraclink design --rig {rig} --model {place}"
    return Answer(fit, written=(place,), following=following)


def _transfer_function(
    data: list[str],
    structure: str | None,
    *,
    column: Columns = None,
    input: Annotated[str | None, "Transfer function: column of its input"] = None,
    output: Output = None,
    period_ms: Annotated[
        float | None,
        above(0.0, 1e6, "ms"),
        "Transfer function: sampling period of a file without time stamps",
    ] = None,
    ring_down: Annotated[
        bool,
        "Transfer function: the link was bent and let go, no input but the force that held it",
    ] = False,
    out: ModelOut = None,
    force: bool = False,
    **options: Annotated[Any, BAND],
) -> Answer:
    """A transfer function with fractional orders and a delay, from a recording, or from
    a frequency response where no column is named.
    """
    place, band = output_path(out or "structure.json", force=force), options["band"]
    measured: Recording | FrequencyResponse
    if input is None and output is None:
        refuse_beside(
            "a frequency response",
            "--input and --output of a recording",
            period_ms=period_ms,
            ring_down=ring_down or None,
        )
        measured = read_frequency_response(log_path(data[0]), _named(column))
        if band:
            measured = measured.between(*band)
    else:
        refuse_beside(
            "--input and --output",
            "the columns of a recording",
            column=column,
            band=band,
        )
        if ring_down:
            refuse_beside("--ring-down", "an output alone", input=input)
            # The output takes the place of the input until the next line removes it.
            input = output
        remedy = "a recording needs both, anything else none of them"
        channels = [
            required(name, column, "the name of a column", remedy)
            for name, column in {"input": input, "output": output}.items()
        ]
        period = in_seconds(period_ms)
        measured = read_recording(log_path(data[0]), *channels, period=period)
        if ring_down:
            swing = (measured.period, measured.output)
            measured = Recording.ring_down(
                *swing, source=measured.source, sha256=measured.sha256
            )
    with steps(1) as begin:
        begin("fitting the structure")
        fit = identification.identify_structure(measured, str(structure))
    return Answer(fit, fit.passed, saved={place: fit})


def _named(texts: list[str] | None) -> dict[str, str] | None:
    """The NAME of every ROLE=NAME by its role; None where there is none."""
    by_role: dict[str, str] = {}
    for text in texts or ():
        role, _, name = (part.strip() for part in text.partition("="))
        # With two columns for one role the last one would apply, and a typing error
        # would change a fit unnoticed.
        if not name or role in by_role:
            raise FieldError(
                "column",
                text,
                "given twice" if name else "without a name",
                "ROLE=NAME, each role once",
                "as in --column frequency=f",
            )
        by_role[role] = name
    return by_role or None


_FITS: dict[str, Callable[..., Answer]] = {
    "link": _link,
    "several links": _several,
    "motor": _motor,
    "driven": _driven,
    "transfer function": _transfer_function,
}
_WORDS = {"link": "the fit of one log", "several links": "the fit of several logs"}


@command(app)
def identify(
    data: Annotated[
        list[str],
        argument("DATA"),
        "A log, `demo` for the bundled one; several logs, each of another payload; "
        "or a table of a frequency response",
    ],
    structure: Annotated[
        str | None,
        "UD-IOM, D-IOM, UD-FOM or D-FOM; motor, for a log with the voltage; driven, for a "
        "frequency response to the motor's voltage; or a transfer function, such as "
        '"k/(T*s**a + 1)*exp(-L*s)". Default: the link that the log supports',
    ] = None,
    **options: Annotated[Any, *map(Keywords, _FITS.values())],
) -> Answer:
    """Fit a link model to a log, with gain, offset and gauge delay as free parameters.

    Several logs are fitted together: exit code 1 where their parameters cannot be
    common. `--structure` names anything else that is fitted: the motor, a frequency
    response, a transfer function with fractional orders and a delay.

    $ fraclink identify log.csv --rig rig.toml --out model.json
    """
    kind = _kind(data, structure)
    fit = _FITS[kind]
    acting = [name for name in declared(fit) if name in options]
    # Any other option is rejected, since the user expects it to have an effect.
    refuse_beside(
        _WORDS.get(kind, f"--structure {structure}"),
        ", ".join(f"--{name.replace('_', '-')}" for name in acting),
        **{name: options[name] or None for name in options if name not in acting},
    )
    return fit(data, structure, **{name: options[name] for name in acting})


def _kind(data: list[str], structure: str | None) -> str:
    """The kind of fit, a key of `_FITS`."""
    # Only the text of a transfer function contains a separate s.
    kind = "transfer function" if re.search(r"\bs\b", structure or "") else structure
    if kind not in _FITS:
        return "several links" if len(data) > 1 else "link"
    if len(data) > 1:
        raise FieldError(
            "data",
            ", ".join(data),
            "several files",
            "one file",
            "give one; only logs of a link are fitted together",
        )
    return kind
