"""The command `start`: from a log that nobody has described to rig.toml, a first model
and a picture.
"""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from fraclink._arm.log_columns import ColumnStatement
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Writes, command
from fraclink._cli.console import tell
from fraclink._cli.options import LogName, log_path
from fraclink.errors import FieldError
from fraclink.logs._guess import Question
from fraclink.logs._start import START_FILES, Start
from fraclink.logs._start import start as start_from
from fraclink.logs._weighing import ABSENT, answered
from fraclink.view._figures import fit_figure
from fracsys.checks import Between, Payload

__all__ = ["start"]

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
        typer.Option(metavar="ROLE=NAME [UNIT]"),
        'What you know of a column: "motor_angle=theta", "torque=-bridge [mNm]", "deflection=[deg]", '
        '"motor_angle=pot * 36.8 [deg]"; a minus turns the sign, a plus keeps it',
    ] = None,
    period_ms: Annotated[
        float | None,
        Between(0.0, 1000.0, "ms", low_open=True),
        "Sampling period of a log without stamps",
    ] = None,
    payload: Annotated[Payload | None, "Payload of the log, if it is known"] = None,
    resample: Annotated[
        bool, "Interpolate over gaps, repeated stamps and strong jitter"
    ] = False,
    interpolate: Annotated[bool, "Fill missing cells, at most 1 % of a column"] = False,
    force: bool = False,
) -> Answer:
    """Guess columns, units and sign of a log, say why, and fit a first model; asks what
    it cannot know.

    $ fraclink start log.csv --out mine
    """
    found = start_from(
        log_path(log),
        column=column or (),
        period=None if period_ms is None else period_ms / 1e3,
        payload=payload,
        resample=resample,
        interpolate=interpolate,
        # A script cannot answer: it gets the error with the option that decides
        # instead.
        ask=_ask if sys.stdin.isatty() and sys.stderr.isatty() else None,
    )
    written = found.save(out, force=force)
    # Also of a fit that failed: the picture shows why.
    fit_figure(found.experiment, found.fit).save(out / _PICTURE)
    return Answer(
        found,
        found.passed,
        written=(*written, out / _PICTURE),
        following=_following(found, log, out),
    )


def _following(found: Start, log: str, out: Path) -> str:
    rig, model = (shlex.quote(str(out / name)) for name in START_FILES)
    if not found.passed:
        return f"fraclink diagnose {shlex.quote(log)} --rig {rig}"
    fill = f"fill in the {found.blanks} blanks of {rig}, then"
    if found.fit.model.payload is None:
        # No number of the rig file says with which payload this log was made; without
        # it `design` could not use the ω₀ that was found.
        again = f"fraclink identify {shlex.quote(log)} --rig {rig} --payload KG --out {model} --force"
        return f"{fill} {again}, with the payload of this log for KG"
    return f"{fill} fraclink design --rig {rig} --model {model}"


def _ask(question: Question) -> str:
    """Ask on the terminal until the answer is understood: the columns by name, of a
    unit examples.
    """
    tell(question.text)
    # No numbers before them: 1 before "36.8 deg" would read as one of several choices,
    # and "2" as the column #2.
    choices = ", ".join(question.choices)
    column = question.part == "column"
    tell(
        f"  one of: {choices}; or {ABSENT}, where the log does not hold it"
        if column
        else f"  such as: {choices}"
    )
    while True:
        sys.stderr.write(f"[{question.default}] > " if question.default else "> ")
        sys.stderr.flush()
        line = sys.stdin.readline()
        if not line:
            raise FieldError(
                "answer",
                "(end of input)",
                "missing",
                allowed="an answer",
                remedy=f"or give {question.option}",
            )
        text = line.strip() or question.default
        try:
            # Tried on an empty statement: what cannot be read is asked for again, not
            # found out at the end.
            answered(ColumnStatement(question.role), question, text)
        except FieldError as error:
            tell(str(error))
        else:
            return text
