"""From a log without a description to a first model: guess, ask about the rest, read,
fit.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from fraclink._arm.draft import draft_text
from fraclink._arm.experiment import Experiment
from fraclink._arm.log_columns import LogColumns
from fraclink._display import Overview, Table, displayed, rows_of
from fraclink._files import output_path, write_text
from fraclink._identify import Fit, identify
from fraclink._reading.formats import read_table
from fraclink._reading.reading import read_log
from fraclink._reading.table import LogTable
from fraclink.errors import LogError
from fraclink.findings import Finding, errors_of
from fraclink.logs._diagnosis import diagnose
from fraclink.logs._match import match_table
from fraclink.logs._questions import Guess, Question, statements
from fracsys.checks import Payload, Period, checked

START_FILES = ("rig.toml", "model.json")
Ask = Callable[[Question], str]


@displayed
@dataclass(frozen=True, eq=False)
class Start:
    """What was concluded about a log, and the first model of its link.

    Parameters
    ----------
    guesses
        every conclusion with its certainty and evidence.
    columns
        the guesses as columns that `read_log` takes.
    experiment
        the log in SI units.
    findings
        what `diagnose` found in it.
    fit
        the model.
    rig_file
        text of a rig file with these columns, and blanks for the physics that `design`
        needs.
    """

    guesses: tuple[Guess, ...]
    columns: LogColumns
    experiment: Experiment
    findings: tuple[Finding, ...]
    fit: Fit
    rig_file: str

    @property
    def passed(self) -> bool:
        """Whether neither the log nor the model has an error."""
        return self.fit.passed and not errors_of(self.findings)

    def overview(self) -> Overview:
        """What the log was taken for and why, and the first model."""
        model = self.fit.overview()
        check = sum(each.certainty in ("likely", "assumed") for each in self.guesses)
        guesses = (
            rows_of(
                guess,
                ("part", "log"),
                ("value", "taken as"),
                ("certainty", "certainty"),
                ("evidence", "evidence"),
            )
            for guess in self.guesses
        )
        checked = f"; {check} of {len(self.guesses)} guesses to check" if check else ""
        rows = rows_of(
            self,
            "columns",
            "fit",
            "blanks",
            *(replace(row, key="") for row in model.rows),
        )
        return Overview(
            model.headline + checked,
            "passed" if self.passed else "not shown",
            rows,
            (Table.of("guesses", guesses),),
            (*errors_of(self.findings), *self.fit.findings),
        )

    @property
    def blanks(self) -> int:
        """How many numbers `design` still needs in the rig file."""
        # A blank is a commented line with its key, which the draft's reader also uses
        # to name missing values.
        return len(re.findall(r"^# \w+ = ", self.rig_file, flags=re.MULTILINE))

    def save(
        self, folder: Path | str = ".", *, force: bool = False
    ) -> tuple[Path, ...]:
        """Write rig.toml and model.json into `folder` and return their paths.

        Raises FieldError where a file is already there, unless `force` is given.
        """
        rig, model = (
            output_path(Path(folder) / name, force=force) for name in START_FILES
        )
        rig.parent.mkdir(parents=True, exist_ok=True)
        write_text(rig, self.rig_file)
        self.fit.save(model)
        return rig, model


@checked
def start(
    log: Path | str,
    *,
    column: Iterable[str] = (),
    period: Period | None = None,
    payload: Payload | None = None,
    resample: bool = False,
    interpolate: bool = False,
    ask: Ask | None = None,
) -> Start:
    """Guess what the columns of a log are, read it, and fit a first model of its link.

    Time, motor angle, output, voltage, units and sign are guessed from names, ranges
    and the vibration in the log; each guess says why and how certain it is. No number
    of motor, link or payload is needed.

    Parameters
    ----------
    log
        the file, of any format that `read_log` reads.
    column
        what is known, such as ``"motor_angle=theta [deg]"``, ``"torque=-bridge
        [mNm]"``, a name alone (``"motor_angle=theta"``), a unit alone
        (``"deflection=[deg]"``), or a factor with it (``"motor_angle=pot * 36.8
        [deg]"``). A minus turns the sign, a plus keeps it. The unit ``raw`` says that
        an output is not calibrated: it is scaled so that its gain on the motor angle is
        1.
    period
        sampling period Ts [s] of a log without time stamps.
    payload
        m [kg] that the arm carried, if it is known.
    resample, interpolate
        as in `read_log`.
    ask
        called with each `Question` that the log leaves open; its answer is a text such
        as those that the question lists. Without it an open question is an error.

    Raises
    ------
    LogError
        a question is open and there is nobody to ask, or the log cannot be read or
        fitted.
    FieldError
        a statement or an answer that is not understood.

    Examples
    --------
    >>> from fraclink._reading.reading import bundled_log
    >>> first = start(bundled_log("pulse_30g"))
    >>> first.columns.motor_angle.unit, first.fit.structure, first.passed
    ('rad', 'UD-FOM', True)
    """
    place = Path(log)
    by_role = statements(column, period)
    table = read_table(place)
    state = match_table(table, by_role, str(log), interpolate)
    while state.questions:
        if ask is None:
            raise _open(table, state.questions)
        # One question at a time: an answer often settles others as well, since
        # everything is matched again.
        question = state.questions[0]
        answer = question.statement(ask(question), by_role.get(question.role))
        by_role[question.role] = answer
        state = match_table(table, by_role, str(log), interpolate)
    assert state.columns is not None  # without a question  # noqa: S101
    # The common reader receives the guesses as statements, and rejects or converts them
    # as always.
    experiment = read_log(
        place,
        columns=state.columns,
        payload=payload,
        resample=resample,
        interpolate=interpolate,
    )
    fit = identify(experiment)
    guesses = (*state.guesses, *_of_the_fit(experiment, fit, payload))
    return Start(
        guesses,
        state.columns,
        experiment,
        diagnose(experiment),
        fit,
        draft_text(
            place.stem[:100] or "arm",
            experiment.period,
            state.columns,
            _remarks(guesses),
            known=_known(experiment, fit, payload),
        ),
    )


def _known(
    log: Experiment, fit: Fit, payload: float | None
) -> dict[str, tuple[float, str]]:
    """Values that the rig file need not leave blank: c from a torque log, and the
    stated payload.
    """
    values = {}
    if log.output_kind == "torque":
        # Five digits: the rest is noise of the fit, and people read rig files.
        values["link.stiffness"] = (
            float(f"{fit.model.stiffness:.5g}"),
            "c, from this log",
        )
    if payload is not None:
        values["payloads.low"] = (
            payload,
            "of this log; the lightest that a controller has to carry",
        )
        values["payloads.high"] = (payload, "of this log; the heaviest")
    return values


def _open(table: LogTable, questions: tuple[Question, ...]) -> LogError:
    return LogError(
        "columns",
        ", ".join(table.names[:12]),
        f"not clear from names and values: {' '.join(question.text for question in questions)}",
        "an answer to each question",
        "give " + "; ".join(question.option for question in questions),
    )


def _of_the_fit(
    experiment: Experiment, fit: Fit, payload: float | None
) -> tuple[Guess, ...]:
    """The guesses added by the reader and the fit: period, payload and delay."""
    evidence = f"{experiment.motor_angle.size} samples, {experiment.duration:.4g} s"
    guesses = [
        Guess("period", f"{1e3 * experiment.period:.6g} ms", "certain", evidence)
    ]
    if experiment.payload is not None:
        source = "as stated" if payload is not None else "in the log's header"
        guesses.append(Guess("payload", f"{experiment.payload:g} kg", "stated", source))
    late, error = f"{1e3 * fit.delay:.3g} ms", fit.standard_errors.get("delay")
    reason = "fitted with the model" + (
        "" if error is None else f", ± {1e3 * error:.2g} ms"
    )
    guesses.append(Guess("delay of the output", late, "certain", reason))
    return tuple(guesses)


# The guesses that belong above each line of the [log] table of the rig file.
_LINES = {
    "time": ("time", "unit of time"),
    "motor_angle": ("motor angle", "unit of the motor angle"),
    "torque": ("output", "output measures", "sign of the output"),
    "voltage": ("voltage",),
}


def _remarks(guesses: tuple[Guess, ...]) -> dict[str, tuple[str, ...]]:
    """The guesses to be checked, as comments by role."""
    remarks = {
        role: tuple(
            f"{'CHECK, ' if guess.certainty in ('likely', 'assumed') else ''}{guess.certainty}: "
            f"{guess.part}: {guess.value} ({guess.evidence})"
            for guess in guesses
            if guess.part in parts
        )
        for role, parts in _LINES.items()
    }
    return remarks | {"deflection": remarks["torque"]}
