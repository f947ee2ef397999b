"""What the section of a fault campaign says, as rows of text that a template sets."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from fraclink._campaign.faults import fault_named

if TYPE_CHECKING:
    from fraclink._campaign.faults import FaultTable

__all__ = ["FaultLine", "fault_lines", "fault_notes", "faults_met"]


class FaultLine(NamedTuple):
    """One fault: what it is, what the law must do, how often it did not, and the worst time."""

    number: str
    title: str
    required: str
    runs: str
    failed: str
    worst: str
    passed: bool


def fault_lines(table: FaultTable) -> list[FaultLine]:
    """Return one line for each fault, in the catalogue's order."""
    return [
        FaultLine(
            row.number,
            row.title,
            row.required.replace("<=", "≤").replace(" x ", " × "),
            str(row.runs),
            "–" if row.passed else str(row.failed),
            row.worst,
            row.passed,
        )
        for row in table.rows()
    ]


def fault_notes(table: FaultTable) -> list[tuple[str, str]]:
    """Return what the campaign cannot show of a fault: its number and a sentence."""
    notes = ((row.number, fault_named(row.number).note) for row in table.rows())
    return [(number, note) for number, note in notes if note]


def faults_met(table: FaultTable) -> str:
    """Return how many faults met their requirement in every run, as a sentence's part.

    >>> from fraclink._campaign.faults import FaultTable
    >>> faults_met(FaultTable(()))
    '0 of 0 faults met in every run, 0 runs'
    """
    rows = table.rows()
    met = sum(row.passed for row in rows)
    return f"{met} of {len(rows)} faults met in every run, {len(table.outcomes)} runs"
