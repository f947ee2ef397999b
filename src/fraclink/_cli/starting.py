"""The command `start`: from a log without any description to rig.toml, a first model
and a picture.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

from fraclink._cli.app import group
from fraclink._cli.command import Answer, Keywords, Writes, command, option
from fraclink._cli.console import ask, interactive, tell
from fraclink._cli.options import LogName, in_seconds, log_path
from fraclink._reading.reading import read_log
from fraclink.logs import Question, Start
from fraclink.logs import start as start_from
from fraclink.logs._start import START_FILES
from fraclink.view._figures import fit_figure
from fracsys.checks import Payload, above

app = group()

_PICTURE = "fit.svg"


@command(app)
def start(
    log: LogName,
    out: Annotated[
        Path,
        "Folder for rig.toml, model.json and fit.svg",
        Writes((*START_FILES, _PICTURE)),
    ] = Path(),
    column: Annotated[
        list[str] | None,
        option("ROLE=NAME [UNIT]"),
        'What you know of a column: "motor_angle=theta", "torque=-bridge [mNm]", "deflection=[deg]", '
        '"motor_angle=pot * 36.8 [deg]"; a minus reverses the sign, a plus keeps it',
    ] = None,
    period_ms: Annotated[
        float | None,
        above(0.0, 1000.0, "ms"),
        "Sampling period of a log without time stamps",
    ] = None,
    payload: Annotated[Payload | None, "Payload of the log, if it is known"] = None,
    force: bool = False,
    **filling: Annotated[Any, Keywords(read_log, "resample", "interpolate")],
) -> Answer:
    """Guess columns, units and sign of a log, say why, and fit a first model; asks what
    it cannot know.

    $ fraclink start log.csv --out mine
    """
    result = start_from(
        log_path(log),
        column=column or (),
        period=in_seconds(period_ms),
        payload=payload,
        **filling,
        # A script cannot answer: it gets the error with the option that settles the
        # question.
        ask=_ask if interactive() else None,
    )
    files = result.save(out, force=force)
    return Answer(
        result,
        result.passed,
        written=files,
        # Also for a failed fit: the picture shows the reason.
        saved={out / _PICTURE: fit_figure(result.experiment, result.fit)},
        following=_following(result, log, out),
    )


def _following(result: Start, log: str, out: Path) -> str:
    rig, model = (shlex.quote(str(out / name)) for name in START_FILES)
    if not result.passed:
        return f"fraclink diagnose {shlex.quote(log)} --rig {rig}"
    fill = f"fill in the {result.blanks} blanks of {rig}, then"
    if result.fit.model.payload is None:
        # The rig file does not state the payload of this log; without it `design` could
        # not use the identified ω₀.
        again = f"fraclink identify {shlex.quote(log)} --rig {rig} --payload KG --out {model} --force"
        return f"{fill} {again}, with the payload of this log for KG"
    return f"{fill} fraclink design --rig {rig} --model {model}"


def _ask(question: Question) -> str:
    """Ask on the terminal until the answer is valid: columns by name, units with
    examples.
    """
    tell(question.text)
    # Choices are not numbered: numbers would make examples such as "36.8 deg" look like
    # the only choices, and "2" look like the column #2.
    choices = ", ".join(question.choices)
    column = question.part == "column"
    tell(
        f"  one of: {choices}; or none, where the log does not hold it"
        if column
        else f"  such as: {choices}"
    )

    def understood(text: str) -> str:
        # Raises for an invalid answer, and the question is repeated.
        question.statement(text)
        return text

    return ask("", understood, option=question.option)
