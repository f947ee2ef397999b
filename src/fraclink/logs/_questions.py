"""Conclusions and questions of `start`: guesses with their certainty, questions, and
the statements made by answers.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

from fraclink._arm.log_columns import ROW_NUMBER, UNITS, UNITS_OF, ColumnStatement
from fraclink._reading.names import unit_of_name
from fraclink.errors import FieldError

Certainty = Literal["stated", "certain", "likely", "assumed"]
# The answer if the log does not contain the requested signal.
ABSENT = "none"


@dataclass(frozen=True)
class Guess:
    """One conclusion about a log.

    Parameters
    ----------
    part
        what it is about, such as "motor angle" or "sign of the output".
    value
        what it is taken for.
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
    """Something that the log cannot tell: at most one question for each of three roles.

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
        columns, or examples of units; others may be answered as well, such as
        ``#3 + #4 [rad]``.
    option
        the option of the command line that states it.
    others
        columns that are unlikely but possible answers.
    """

    role: str
    part: str
    text: str
    choices: tuple[str, ...]
    option: str
    others: tuple[str, ...] = ()

    def statement(
        self, text: str, known: ColumnStatement | None = None
    ) -> ColumnStatement:
        """Return what an answer states, added to what is known of the column.

        Raises FieldError where it is not understood.

        >>> asked = Question("motor_angle", "unit", "Which unit?", ("deg",), "")
        >>> asked.statement("1/4096 rev").scale
        0.000244140625
        >>> asked = Question("output", "column", "Which column?", ("#3", "#4"), "")
        >>> asked.statement("#3 + #4 [rad]").unit
        'rad'
        """
        text, known = text.strip(), known or ColumnStatement(self.role)
        of_column = self.part == "column"
        if of_column and text == ABSENT and ABSENT not in self.choices:
            return replace(known, column=ABSENT)
        # "36.8 deg" as well as "deg" and "* 36.8 [deg]", the syntax of --column.
        factor, _, unit = text.removesuffix("]").replace("[", " ").rpartition(" ")
        formula = f"x * {factor.strip('* ')} [{unit}]" if factor else f"x [{unit}]"
        if of_column:
            formula, unit = text, unit if "[" in text else ""
        role = self.role
        if role == "output":
            kind = "torque" if unit in UNITS["torque"] else "deflection"
            role = known.role if not unit and known.role != "output" else kind
        each = ColumnStatement.of(f"{role}={formula}")
        units = [*UNITS_OF[role], *(["raw"] * (self.role == "output"))]
        own = unit_of_name(each.column or "")
        if of_column and self.role == "motor_angle" and each.unit is None:
            # Without a unit in the name either, this is an error: no second question
            # asks for the unit.
            each = replace(each, unit=own if own in units else "")
        # Only a number may stand before a unit: a column there would be lost.
        complete = each.column == "x"
        if of_column:
            complete = any(name in text for name in (*self.choices, *self.others))
        optional = of_column and self.role == "output" and each.unit is None
        if not complete or (each.unit not in units and not optional):
            problem = "not understood" if each.unit else "without a unit"
            allowed = f"one of {', '.join(units)}, after a number if it needs one"
            remedy = f"such as {', '.join(self.choices)}"
            if of_column:
                allowed = f"a column and one of {', '.join(units)}"
                remedy = f"such as {self.choices[0]} [deg]"
            if of_column and not complete:
                problem = "none of these columns"
                allowed = f"{', '.join(self.choices[:12])}, a sum such as a + b [rad], or none"
            raise FieldError("answer", text, problem, allowed, remedy)
        if self.part == "period":
            return replace(each, column=ROW_NUMBER)
        return each if of_column else replace(each, column=known.column)


def statements(
    column: Iterable[str], period: float | None
) -> dict[str, ColumnStatement]:
    """The statements of the call by role; torque and deflection share "output"."""
    texts = list(column)
    if period is not None:
        texts.append(f"time={ROW_NUMBER} * {period!r} [s]")
    by_role: dict[str, ColumnStatement] = {}
    for text in texts:
        each = ColumnStatement.of(text)
        role = "output" if each.role in ("torque", "deflection") else each.role
        if role in by_role:
            raise FieldError(
                "column" if role != "time" or period is None else "period",
                text,
                "stated twice",
                "one for each role",
                "state each column once; an output is a torque or a deflection",
            )
        by_role[role] = each
    return by_role
