"""Commands that fit what is no log of a link: a motor, a frequency response, any
structure.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from numpy.typing import NDArray

from fraclink import _identify as identification
from fraclink._arm.experiment import Experiment
from fraclink._arm.log_columns import drive_columns
from fraclink._arm.recording import FrequencyResponse, Recording
from fraclink._arm.rig import Rig
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Writes, command
from fraclink._cli.console import steps
from fraclink._cli.options import (
    Columns,
    RigName,
    load_rig,
    log_path,
    named_channels,
)
from fraclink._reading.reading import read_log
from fraclink._reading.responses import read_frequency_response, read_recording
from fraclink.errors import FieldError, LogError
from fracsys.checks import Between, Payload

ResponseColumns = Annotated[
    list[str] | None,
    typer.Option(metavar="ROLE=NAME [UNIT]"),
    'A column of the table, such as "frequency=f [Hz]"; without "=" the columns of a table '
    'that has no header, in their order: "frequency [Hz]", "gain [dB]", "phase [deg]"',
]
ResponseBand = Annotated[
    tuple[float, float] | None,
    typer.Option(metavar="FROM UNTIL"),
    "Lines to fit [rad/s]; default: all, or the widest part in which the model holds",
]

app = group()


def _columns(texts: list[str] | None) -> dict[str, str] | list[str] | None:
    """Columns of a response as `read_frequency_response` takes them."""
    if not texts:
        return None
    if not any("=" in text for text in texts):
        return texts
    return dict(_named("column", texts))


@command(app)
def identify_motor(
    log: Annotated[
        str, typer.Argument(metavar="LOG"), "A log with the amplifier's voltage"
    ],
    rig: Annotated[
        str | None,
        typer.Option(metavar="RIG"),
        "A rig file, or a bundled rig; not needed beside --column",
    ] = None,
    column: Columns = None,
) -> Answer:
    """Identify the motor from voltage and angle: K/J, ν/J, Coulomb torque, dead zone,
    delay.

    The link loads the motor: its torque is taken from the log, or made of its
    deflection by the rig's stiffness. A log of angle and voltage alone is that of a
    motor without a link.

    $ fraclink identify-motor log.csv --rig rig.toml
    """
    known = None if rig is None else load_rig(rig)
    if known is None and not column:
        remedy = "give --rig, or --column for time, motor_angle and voltage"
        raise FieldError(
            "rig", None, "missing", allowed="a rig, or the columns", remedy=remedy
        )
    # --column describes a log on its own: mixed with the rig's mapping, two columns
    # would claim one role.
    columns = drive_columns(column) if column else known.log if known else None
    experiment = read_log(log_path(log), columns=columns)
    if experiment.voltage is None:
        allowed = "a log with a voltage column"
        remedy = 'name it in the rig file\'s [log], or by --column "voltage=NAME [V]"'
        raise LogError(
            "log",
            log,
            "without the amplifier's voltage",
            allowed=allowed,
            remedy=remedy,
        )
    torque = _load(experiment, known)
    fit = identification.identify_motor(
        experiment.voltage,
        experiment.motor_angle,
        period=experiment.period,
        torque=torque,
        # Only where no torque shows the inertia: stated and measured, the two would
        # contradict each other in silence.
        inertia=known.motor.inertia if torque is None and known is not None else None,
    )
    return Answer(fit, fit.passed)


def _load(log: Experiment, rig: Rig | None) -> NDArray[np.float64] | None:
    """The link's torque on the motor; None for a log of the drive alone."""
    if log.output_kind == "torque":
        return log.output
    if np.array_equal(log.output, log.motor_angle):
        return None  # `drive_columns`: there is no other signal
    if rig is None:
        allowed, remedy = (
            "the link's torque",
            "give --rig, whose stiffness makes a torque of the deflection",
        )
        raise LogError(
            "log", log.source, "with a deflection only", allowed=allowed, remedy=remedy
        )
    return rig.link.stiffness * log.output


@command(app)
def identify_spectrum(
    response: Annotated[
        Path,
        typer.Argument(metavar="TABLE"),
        "Table with frequency_rad_s or frequency_Hz, gain or gain_dB, phase_rad or phase_deg",
    ],
    column: ResponseColumns = None,
    band: ResponseBand = None,
    resonances: Annotated[int, Between(1, 6), "Number of resonances"] = 1,
    anti_resonances: Annotated[int, Between(0, 6), "Number of anti-resonances"] = 0,
) -> Answer:
    """Fit modes with one common λ to a table of gain and phase; a column `coherence` is
    used.

    $ fraclink identify-spectrum response.csv --resonances 2
    """
    measured = read_frequency_response(response, _columns(column))
    measured = measured if band is None else measured.between(*band)
    fit = identification.identify_frequency_response(
        measured.frequency,
        measured.response,
        coherence=measured.coherence,
        resonances=resonances,
        anti_resonances=anti_resonances,
    )
    return Answer(
        fit,
        fit.passed,
        values={"outliers": [float(measured.frequency[k]) for k in fit.outliers]},
    )


@command(app)
def identify_driven_link(
    response: Annotated[
        Path,
        typer.Argument(metavar="TABLE"),
        "Table of the response, as of identify-spectrum",
    ],
    rig: RigName,
    output: Annotated[
        Literal["motor_angle", "torque"], "What was measured"
    ] = "motor_angle",
    column: ResponseColumns = None,
    band: ResponseBand = None,
    payload: Annotated[Payload | None, "Payload; default: the rig's nominal"] = None,
    out: Annotated[Path, "File to write the model to", Writes()] = Path("model.json"),
) -> Answer:
    """Fit link and motor to a frequency response from the amplifier's voltage.

    $ fraclink identify-driven-link response.csv --rig rig.toml
    """
    known = load_rig(rig)
    found = identification.identify_driven_link(
        read_frequency_response(response, _columns(column)), output=output, band=band
    )
    if not found.passed:
        return Answer(found, passed=False)
    # J n² [kg·m²]: the response is that of the gear's output.
    inertia = known.motor.inertia * known.motor.gear_ratio**2
    carried = known.payloads.nominal if payload is None else payload
    identification.save_model(found.model(inertia, payload=carried), out)
    return Answer(
        found, written=(out,), following=f"fraclink design --rig {rig} --model {out}"
    )


@command(app)
def identify_structure(
    data: Annotated[
        Path,
        typer.Argument(metavar="FILE"),
        "A recording; without --input and --output a table of a frequency response",
    ],
    structure: Annotated[
        str,
        typer.Argument(metavar="STRUCTURE"),
        'Transfer function, such as "k/(T*s**a + 1)*exp(-L*s)"',
    ],
    input: Annotated[str | None, "Column of the input"] = None,
    output: Annotated[str | None, "Column of the output"] = None,
    time: Annotated[
        str | None,
        "Column of the stamps (s; ms as in time_ms); default: the one that is named so",
    ] = None,
    period_ms: Annotated[
        float | None,
        Between(0.0, 1e6, "ms", low_open=True),
        "Sampling period of a file without stamps",
    ] = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE"),
        "A parameter that is known, or offset=0",
    ] = None,
    bound: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LOW,HIGH"),
        "Range of a parameter, as in k=-10,10",
    ] = None,
    ring_down: Annotated[
        bool,
        "The link was bent and let go: no input but the force that held it, taken away",
    ] = False,
    out: Annotated[Path, "File to write the fit to", Writes()] = Path("structure.json"),
) -> Answer:
    """Fit a transfer function of your own, with fractional orders and a delay; no start
    value is needed.

    $ fraclink identify-structure log.csv "k/(T*s**a + 1)" --input u --output y
    """
    measured: Recording | FrequencyResponse
    if input is None and output is None:
        for name, value in {
            "time": time,
            "period_ms": period_ms,
            "ring_down": ring_down or None,
        }.items():
            if value is not None:
                problem, remedy = (
                    "given beside a frequency response",
                    "leave it out, or give input and output",
                )
                raise FieldError(
                    name, value, problem, allowed="a recording with it", remedy=remedy
                )
        measured = read_frequency_response(data)
    else:
        if ring_down and input is not None:
            problem, remedy = (
                "given beside --ring-down",
                "leave one of both out: a ring-down has no input",
            )
            raise FieldError(
                "input", input, problem, allowed="one of both", remedy=remedy
            )
        # A ring-down has no input: its output stands for it until the next line takes
        # it away.
        channels = named_channels(output if ring_down else input, output)
        period = None if period_ms is None else period_ms / 1e3
        measured = read_recording(data, *channels, time=time, period=period)
        if ring_down:
            swing = (measured.period, measured.output)
            measured = Recording.ring_down(
                *swing, source=measured.source, sha256=measured.sha256
            )
    with steps(1) as begin:
        begin("fitting the structure")
        fit = identification.identify_structure(
            measured,
            structure,
            fixed={
                name: _numbers("fix", text, 1)[0] for name, text in _named("fix", fix)
            },
            bounds={
                name: _numbers("bound", text, 2)
                for name, text in _named("bound", bound)
            },
        )
    fit.save(out)
    return Answer(fit, fit.passed, written=(out,))


def _named(option: str, texts: list[str] | None) -> list[tuple[str, str]]:
    """Name and value of every NAME=VALUE."""
    pairs = [text.partition("=") for text in texts or ()]
    for name, mark, _ in pairs:
        if not mark:
            allowed, remedy = "NAME=VALUE", f'write it as --{option} "k=1"'
            raise FieldError(
                option, name, "without a value", allowed=allowed, remedy=remedy
            )
    found: dict[str, str] = {}
    for name, _, value in pairs:
        # The last one would win in a dictionary: a typing error would move a fit
        # without a word.
        if (own := name.strip()) in found:
            problem, remedy = (
                f"given beside {own}={found[own]}",
                "leave one of them out",
            )
            raise FieldError(
                option,
                f"{own}={value}",
                problem,
                allowed="one for each name",
                remedy=remedy,
            )
        found[own] = value
    return list(found.items())


def _numbers(option: str, text: str, count: int) -> Any:
    """The numbers of "1" or "1,2"."""
    try:
        found = tuple(float(cell) for cell in text.split(","))
    except ValueError:
        found = ()
    if len(found) != count:
        allowed = "a number" if count == 1 else "two numbers with a comma between them"
        raise FieldError(
            option, text, "not understood", allowed=allowed, remedy="write 0.5, or 0,10"
        )
    return found
