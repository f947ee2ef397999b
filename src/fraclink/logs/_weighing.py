"""What is known of a log's columns while they are matched: guesses, open questions, and
what a call or an answer states.

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
from fraclink._reading.columns import clean_column, with_combined
from fraclink._reading.names import unit_of_name
from fraclink._reading.text import LogTable
from fraclink.errors import FieldError

__all__ = [
    "ABSENT",
    "Guess",
    "Question",
    "Weighing",
    "answered",
    "stamps_of",
    "statements",
]

# The answer where a log does not hold what a question asks for.
ABSENT = "none"

Certainty = Literal["stated", "certain", "likely", "assumed"]
Array = NDArray[np.float64]


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
    """What a log cannot tell; one for each role, and so three at most.

    Parameters
    ----------
    role
        time, motor_angle or output.
    part
        ``"column"`` (the answer is a name, with its unit in brackets: ``theta [deg]``;
        or ``none``, where the log does not hold it), ``"unit"`` or ``"period"`` (a unit,
        with a factor before it if need be).
    text
        the question.
    choices
        columns, or units; others may be answered as well, such as ``#3 + #4 [rad]``.
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
        each = ColumnStatement.of(text)
        role = "output" if each.role in ("torque", "deflection") else each.role
        if role in stated:
            remedy = "state each column once; an output is a torque or a deflection"
            allowed = "one for each role"
            raise FieldError(
                "column", text, "stated twice", allowed=allowed, remedy=remedy
            )
        stated[role] = each
    if period is not None:
        if "time" in stated:
            problem, remedy = "given beside a time column", "leave one of them out"
            raise FieldError("period", period, problem, allowed="one", remedy=remedy)
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
    >>> asked = Question("output", "column", "Which column?", ("#3", "#4"), "", "")
    >>> answered(ColumnStatement("output"), asked, "#3 + #4 [rad]").unit
    'rad'
    """
    text = text.strip()
    if question.part == "column":
        if text == ABSENT and ABSENT not in question.choices:
            return replace(statement, column=ABSENT)
        _check_columns(question, text)
        stated, unit = text, text.rpartition("[")[2].rstrip("]") if "[" in text else ""
    else:
        # "36.8 deg" beside "deg" and "* 36.8 [deg]", the words of --column.
        factor, _, unit = text.removesuffix("]").replace("[", " ").rpartition(" ")
        stated = f"x * {factor.strip('* ')} [{unit}]" if factor else f"x [{unit}]"
    role = statement.role
    if (question.role == "output" and role not in ("torque", "deflection")) or (
        question.role == "output" and unit
    ):
        role = "torque" if unit in UNITS["torque"] else "deflection"
    each = ColumnStatement.of(f"{role}={stated}")
    units = [*UNITS[QUANTITY_OF[role]], *(["raw"] * (question.role == "output"))]
    if question.part != "column":
        each = replace(each, column=statement.column)
    elif question.role == "motor_angle" and each.unit is None:
        # The same question, and not a second one.
        own = unit_of_name(each.column or "")
        each = replace(each, unit=own if own in units else "")
    if each.unit not in units and not (
        question.part == "column" and question.role == "output" and each.unit is None
    ):
        remedy = f"such as {question.choices[0]} [deg]"
        if question.part != "column":
            remedy = f"such as {', '.join(question.choices)}"
        problem = "without a unit" if not each.unit else "not understood"
        allowed = f"a column and one of {', '.join(units)}"
        raise FieldError("answer", text, problem, allowed=allowed, remedy=remedy)
    return replace(each, column=ROW_NUMBER) if question.part == "period" else each


def _check_columns(question: Question, text: str) -> None:
    """Raise FieldError where an answer names none of the columns that may be meant."""
    if not any(name in text for name in question.choices):
        allowed = (
            f"{', '.join(question.choices[:12])}, a sum such as a + b [rad], or none"
        )
        remedy = f"such as {question.choices[0]} [deg]"
        problem = "none of these columns"
        raise FieldError("answer", text, problem, allowed=allowed, remedy=remedy)


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

    def lacks(self, role: str) -> bool:
        """Whether an answer says that the log does not hold a role."""
        own = self.statement(role).column
        return own == ABSENT and ABSENT not in self.table.names

    def place(self, statement: ColumnStatement) -> int | None:
        """The place of a stated column; a name that itself ends in brackets is found
        whole.
        """
        if statement.column is None or self.lacks(statement.role):
            return None
        whole = f"{statement.column} [{statement.unit}]"
        known = statement.column in self.table.names or whole not in self.table.names
        return self.table.place(statement.column if known else whole, statement.role)

    def label(self, place: int) -> str:
        """Its name for the reader, or its number where the name stands twice or is
        empty.
        """
        name = self.table.names[place]
        return name if name and self.table.names.count(name) == 1 else f"#{place + 1}"

    def name(self, place: int) -> str:
        """What the file calls it, where that is known."""
        hints = self.table.hints
        return hints[place] if place < len(hints) else self.table.names[place]

    def cells(self, place: int) -> Array:
        """The numbers of a column; LogError where a cell is none."""
        return clean_column(self.table, place, interpolate=self.interpolate)[0]

    def unit(self, place: int) -> str:
        """The unit that the file states for a column, or its name."""
        own = self.table.units[place] if self.table.units else ""
        # The file's own statement first; spelled as this package does, where it knows
        # the spelling.
        return (unit_of_name(f"x [{own}]") if own else "") or unit_of_name(
            self.name(place)
        )

    def add(self, name: str, unit: str) -> int:
        """Add a column that is made of others, as ``"theta - tip"``; return its place."""
        table = with_combined(self.table, [name])
        place = table.names.index(name)
        units = [*(table.units or [""] * len(table.names))]
        units[place] = unit
        hints = (*table.hints, name) if table.hints else ()
        self.table = replace(table, units=tuple(units), hints=hints)
        return place


def stamps_of(weighing: Weighing, time: Channel) -> Array:
    """The stamps in seconds."""
    table = weighing.table
    if time.column == ROW_NUMBER:
        stated = weighing.place(weighing.statement("motor_angle"))
        longest = max(values.size for values in table.values)
        rows = longest if stated is None else table.values[stated].size
        return time.in_si(np.arange(rows, dtype=np.float64), "time")
    return time.in_si(weighing.cells(table.place(time.column, "time")), "time")
