"""What is known of a log's columns while they are weighed: guesses, open questions, and
the time.

`read_log` guesses nothing; what is concluded here reaches it as stated columns, with
the evidence beside it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.log_columns import (
    QUANTITY_OF,
    ROW_NUMBER,
    UNITS,
    Channel,
    ColumnStatement,
)
from fraclink._reading.columns import (
    clean_column,
    clock_step,
    seconds_and_parts,
    with_combined,
)
from fraclink._reading.names import names_time, unit_of_name
from fraclink._reading.text import LogTable
from fraclink.errors import FieldError

__all__ = [
    "Guess",
    "Question",
    "Weighing",
    "answered",
    "guess_time",
    "samples_of",
    "stamps_of",
]
__all__ += ["statements"]

Certainty = Literal["stated", "certain", "likely", "assumed"]
Array = NDArray[np.float64]

# A vibrating arm is sampled every 0.2 ms to 0.1 s. The window is narrower than a factor
# of 1000, so that at most one of s, ms, us and ns puts a clock's step into it.
_FASTEST, _SLOWEST = 2e-4, 0.1


@dataclass(frozen=True)
class Guess:
    """One conclusion about a log.

    Parameters
    ----------
    part
        what it is about, such as "motor angle" or "sign of the output".
    value
        what is taken.
    certainty
        ``"stated"`` by the user or by the log's own names, ``"certain"`` or
        ``"likely"`` from the values, ``"assumed"`` where the log cannot tell.
    evidence
        why, in words.
    """

    part: str
    value: str
    certainty: Certainty
    evidence: str


@dataclass(frozen=True)
class Question:
    """What a log cannot tell.

    Parameters
    ----------
    role
        time, motor_angle, output or voltage.
    part
        ``"column"`` (the answer is a name), ``"unit"`` (a unit, with a factor before it
        if need be) or ``"sign"`` (+ or -).
    text
        the question.
    choices
        usual answers.
    default
        the assumption that stands where nobody answers; "" where there is none.
    option
        the option of the command line that states it.
    """

    role: str
    part: str
    text: str
    choices: tuple[str, ...]
    default: str
    option: str


def statements(
    column: Iterable[str], period: float | None
) -> dict[str, ColumnStatement]:
    """What the call states, by role; both kinds of output share one."""
    stated: dict[str, ColumnStatement] = {}
    for text in column:
        found = ColumnStatement.of(text)
        role = "output" if found.role in ("torque", "deflection") else found.role
        if role in stated:
            remedy = "state each column once; an output is a torque or a deflection"
            raise FieldError(
                "column",
                text,
                "stated twice",
                allowed="one for each role",
                remedy=remedy,
            )
        stated[role] = found
    if period is not None:
        if "time" in stated:
            remedy = "leave one of them out"
            raise FieldError(
                "period",
                period,
                "given beside a time column",
                allowed="one",
                remedy=remedy,
            )
        stated["time"] = ColumnStatement("time", ROW_NUMBER, "s", scale=period)
    return stated


def answered(
    statement: ColumnStatement, question: Question, text: str
) -> ColumnStatement:
    """Return `statement` completed by the answer to `question`; FieldError where it is
    not understood.

    >>> asked = Question("motor_angle", "unit", "Which unit?", ("deg",), "", "")
    >>> answered(ColumnStatement("motor_angle"), asked, "1/4096 rev").scale
    0.000244140625
    """
    text = text.strip()
    if question.part == "column":
        return replace(statement, column=text)
    if question.part == "sign":
        return replace(statement, sign=-1 if text.startswith("-") else 1)
    factor, _, unit = text.rpartition(" ")
    # The words of --column, so that both are written alike and refused alike.
    role = (
        statement.role
        if statement.role != "output"
        else "torque"
        if unit in UNITS["torque"]
        else "deflection"
    )
    found = ColumnStatement.of(
        f"{role}=x * {factor} [{unit}]" if factor else f"{role}=x [{unit}]"
    )
    units = list(UNITS[QUANTITY_OF[role]])
    if question.role == "output":
        units = [*UNITS["torque"], *UNITS["angle"], "raw"]
    if found.unit not in units:
        remedy = f"such as {', '.join(question.choices)}"
        raise FieldError(
            "answer", text, "not understood", allowed=", ".join(units), remedy=remedy
        )
    column = ROW_NUMBER if question.part == "period" else statement.column
    return replace(
        statement, role=role, column=column, unit=found.unit, scale=found.scale
    )


@dataclass
class Weighing:
    """What is known of one table so far; each step of `guess_columns` adds to it."""

    table: LogTable
    stated: Mapping[str, ColumnStatement]
    assume: bool
    interpolate: bool
    source: str = "log.csv"
    guesses: list[Guess] = field(default_factory=list)
    questions: list[Question] = field(default_factory=list)
    units: dict[str, str] = field(
        default_factory=dict
    )  # of a column that is made of others, by role

    def conclude(
        self, part: str, value: str, certainty: Certainty, evidence: str
    ) -> None:
        self.guesses.append(Guess(part, value, certainty, evidence))

    def ask(self, question: Question) -> bool:
        """Whether the default of `question` is to be assumed; where not, the question
        stays open.
        """
        if self.assume and question.default:
            return True
        self.questions.append(question)
        return False

    def statement(self, role: str) -> ColumnStatement:
        return self.stated.get(role, ColumnStatement(role))

    def place(self, statement: ColumnStatement) -> int | None:
        """The place of a stated column; a name that itself ends in brackets is found
        whole.
        """
        if statement.column is None:
            return None
        whole = f"{statement.column} [{statement.unit}]"
        name = (
            whole
            if statement.column not in self.table.names and whole in self.table.names
            else statement.column
        )
        return self.table.place(name, statement.role)

    def label(self, place: int) -> str:
        """Its name for the reader, or its number where the name stands twice or is
        empty.
        """
        name = self.table.names[place]
        return name if name and self.table.names.count(name) == 1 else f"#{place + 1}"

    def cells(self, place: int) -> Array:
        """The numbers of a column; LogError where a cell is none."""
        return clean_column(self.table, place, interpolate=self.interpolate)[0]

    def unit(self, place: int) -> str:
        """The unit that the file states for a column, or its name."""
        own = self.table.units[place] if self.table.units else ""
        # The file's own statement first; spelled as this package does, where it knows
        # the spelling.
        return (unit_of_name(f"x [{own}]") if own else "") or unit_of_name(
            self.table.names[place]
        )


# --- time -------------------------------------------------------------------------------------------------


def guess_time(weighing: Weighing) -> Channel | None:
    """The channel of the stamps."""
    table, statement = weighing.table, weighing.statement("time")
    if statement.column == ROW_NUMBER:
        unit, scale = statement.unit or "s", statement.scale or 1.0
        weighing.conclude(
            "time",
            f"one sample every {scale:g} {unit}",
            "stated",
            "the log has no stamps",
        )
        return Channel(ROW_NUMBER, unit, scale=scale)
    place = weighing.place(statement)
    named = place is not None
    if place is None and (parts := seconds_and_parts(table)):
        weighing.table = with_combined(table, [parts])
        table, weighing.units["time"] = weighing.table, "s"
        place = table.names.index(parts)
    if place is None:
        place = _clock(table)
    if place is None:
        question = (
            "No column never decreases, so none is the time. How long is one sample?"
        )
        option = '--period-ms 4, or --column "time=NAME [s]"'
        weighing.ask(Question("time", "period", question, ("4 ms",), "", option))
        return None
    values = weighing.cells(place)
    step = clock_step(values) or float(np.median(np.abs(np.diff(values))))
    if named:
        weighing.conclude("time", weighing.label(place), "stated", "as stated")
    else:
        by_name = names_time(table.names[place])
        evidence = f"it rises by {step:.6g} a sample" + (
            ", and is named so" if by_name else ""
        )
        weighing.conclude(
            "time", weighing.label(place), "certain" if by_name else "likely", evidence
        )
    unit = _time_unit(weighing, place, step)
    return (
        None
        if not unit
        else Channel(weighing.label(place), unit, scale=statement.scale or 1.0)
    )


def _clock(table: LogTable) -> int | None:
    """The place of the column that is most likely the time."""

    def rank(place: int) -> tuple[bool, bool, float]:
        steps = np.diff(table.values[place])
        # Named as a time first; a plain counter of rows last, as it may be one; and of
        # two the steadier.
        uneven = float(np.std(steps) / np.median(steps))
        return (
            not names_time(table.names[place]),
            float(np.median(steps)) == 1.0,
            uneven,
        )

    clocks = [
        place
        for place, values in enumerate(table.values)
        if clock_step(values) is not None
    ]
    longest = max((table.values[place].size for place in clocks), default=0)
    # The longest columns are the signals, and their clock is as long.
    clocks = [place for place in clocks if table.values[place].size == longest]
    if clocks:
        return min(clocks, key=rank)
    # Stamps that jump back, or hold no number, are still those: the reader says what is
    # wrong with them.
    return next(
        (place for place, name in enumerate(table.names) if names_time(name)), None
    )


def _time_unit(weighing: Weighing, place: int, step: float) -> str:
    statement, own = (
        weighing.statement("time"),
        weighing.units.get("time") or weighing.unit(place),
    )
    scale = statement.scale or 1.0
    if statement.unit:
        weighing.conclude(
            "unit of time",
            statement.unit,
            "stated",
            f"a sample every {step * scale:.6g} {statement.unit}",
        )
        return statement.unit
    fitting = [
        unit
        for unit, size in UNITS["time"].items()
        if _FASTEST <= step * scale * size <= _SLOWEST
    ]
    rate = f"a sample every {step * scale:.6g}"
    # The name's unit stands unless it makes a step of a second and more, with which no
    # vibration of an arm is recorded: then somebody exported ms under the name of s.
    if own in UNITS["time"] and step * UNITS["time"][own] < 1.0:
        weighing.conclude("unit of time", own, "stated", f"by its name: {rate} {own}")
        return own
    # A column that rises by one may count samples or milliseconds: only a name of time
    # makes it the latter.
    counter = step == 1.0 and not names_time(weighing.table.names[place])
    if len(fitting) == 1 and not counter and own not in UNITS["time"]:
        others = "s" if fitting[0] != "s" else "ms"
        weighing.conclude(
            "unit of time",
            fitting[0],
            "likely",
            f"{rate}: in {others} no arm is sampled so",
        )
        return fitting[0]
    text = f"{weighing.label(place)} rises by {step:.6g}: what is its unit?"
    if counter:
        text = f"{weighing.label(place)} counts samples: how long is one?"
    name = weighing.label(place)
    option = (
        f'--column "time={name} * 0.004 [s]"'
        if counter
        else f'--column "time={name} [ms]"'
    )
    weighing.ask(Question("time", "unit", text, ("s", "ms", "us"), "", option))
    return ""


def samples_of(weighing: Weighing, time: Channel | None) -> int:
    """Samples of the columns that belong to the time."""
    table = weighing.table
    if time is None or time.column == ROW_NUMBER:
        stated = weighing.place(weighing.statement("motor_angle"))
        return (
            table.values[stated].size
            if stated is not None
            else max(v.size for v in table.values)
        )
    return table.values[table.place(time.column, "time")].size


def stamps_of(weighing: Weighing, time: Channel) -> Array:
    """The stamps in seconds."""
    if time.column == ROW_NUMBER:
        return time.in_si(
            np.arange(samples_of(weighing, time), dtype=np.float64), "time"
        )
    return time.in_si(weighing.cells(weighing.table.place(time.column, "time")), "time")
