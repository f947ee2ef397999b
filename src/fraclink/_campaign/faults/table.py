"""The result of a fault campaign: one row a run, saved as JSON, summed up by fault."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from fraclink._campaign.faults.catalogue import fault_named
from fraclink._campaign.faults.nouns import Case, Check, Outcome
from fraclink._files import read_json, write_json
from fraclink.errors import FieldError, FileFormatError

__all__ = ["FaultTable", "Row"]

KIND, FORMAT = "fault-campaign", 1


@dataclass(frozen=True)
class Row:
    """One fault in the summary: its runs, those that fail, the check that fails worst and its run."""

    number: str
    title: str
    reaction: str
    required: str
    runs: int
    failed: int
    worst: str
    example: Outcome | None

    @property
    def passed(self) -> bool:
        """Whether every run met the requirement."""
        return self.failed == 0


@dataclass(frozen=True)
class FaultTable:
    """Verdicts of a campaign in the order of the runs; `about` says what was run."""

    outcomes: tuple[Outcome, ...]
    about: Mapping[str, str] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether every run of every fault met its requirement."""
        return all(outcome.passed for outcome in self.outcomes)

    @property
    def failures(self) -> tuple[Outcome, ...]:
        """The runs that did not meet their requirement: the open points."""
        return tuple(outcome for outcome in self.outcomes if not outcome.passed)

    def rows(self) -> tuple[Row, ...]:
        """Return one row a fault."""
        numbers = dict.fromkeys(outcome.case.fault for outcome in self.outcomes)
        return tuple(self._row(number) for number in numbers)

    def _row(self, number: str) -> Row:
        fault = fault_named(number)
        mine = [outcome for outcome in self.outcomes if outcome.case.fault == number]
        failed = [outcome for outcome in mine if not outcome.passed]
        worst = max(
            ((check, o) for o in failed for check in o.failed), key=lambda x: _excess(x[0]), default=None
        )
        told = "" if worst is None else f"{worst[0]} ({worst[1].name})"
        return Row(
            number,
            fault.title,
            fault.reaction,
            fault.required,
            len(mine),
            len(failed),
            told,
            None if worst is None else worst[1],
        )

    def markdown(self) -> str:
        """Return the summary as a Markdown table, then what the campaign cannot show of a fault."""
        lines = [
            "| fault | what | class | required | runs | open | worst |",
            "|---|---|---|---|---|---|---|",
        ]
        for row in self.rows():
            cells = (row.number, row.title, row.reaction, row.required, row.runs, row.failed, row.worst)
            lines.append("| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |")
        notes = {row.number: fault_named(row.number).note for row in self.rows()}
        lines += ["", *(f"- {number}: {note}." for number, note in notes.items() if note)]
        return "\n".join(lines).rstrip("\n") + "\n"

    def save(self, path: Path | str) -> None:
        """Write the table to a JSON file, complete or not at all."""
        rows = [
            asdict(outcome) | {"checks": [_check_values(check) for check in outcome.checks]}
            for outcome in self.outcomes
        ]
        write_json(path, KIND, FORMAT, {"about": dict(self.about), "outcomes": _plain(rows)})

    @classmethod
    def load(cls, path: Path | str) -> FaultTable:
        """Read back what `save` wrote; FileFormatError for anything else."""
        data = read_json(path, KIND, (FORMAT,))
        try:
            return cls(
                tuple(_outcome(row) for row in data["outcomes"]),
                {str(k): str(v) for k, v in data["about"].items()},
            )
        except (KeyError, TypeError, ValueError, AttributeError, FieldError) as error:
            raise FileFormatError(
                "outcomes",
                str(error),
                "not those of a fault campaign",
                allowed="a file of `fraclink campaign faults`",
                remedy="run it again",
            ) from error


def _excess(check: Check) -> float:
    """By how much a limit is exceeded, as a factor; a reaction that never came is the worst."""
    if not math.isfinite(check.measured):
        return math.inf
    return check.measured / check.limit if check.limit > 0 else check.measured


def _check_values(check: Check) -> list[object]:
    return [check.name, check.measured, check.limit, check.passed]


def _plain(value: Any) -> Any:
    """JSON has no infinity and no NaN: they are written as words."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _outcome(row: Mapping[str, Any]) -> Outcome:
    return Outcome(
        case=Case(**row["case"]),
        checks=tuple(Check(str(n), float(m), float(x), bool(h)) for n, m, x, h in row["checks"]),
        peak=float(row["peak"]),
        clean_peak=float(row["clean_peak"]),
        final=float(row["final"]),
        mode=str(row["mode"]),
        reason=str(row["reason"]),
        reacted=int(row["reacted"]),
        detail=str(row["detail"]),
    )
