"""The verdict on a statement, and on each of its readings, with no reading left out and
none preferred.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["HOLDS", "LOGS", "NOT", "PART", "Evidence", "Reading", "judged", "together"]

HOLDS, PART, NOT = "holds", "holds in part", "does not hold"
LOGS = "not testable without the logs"


@dataclass(frozen=True)
class Reading:
    """One reading of a statement: which controllers on which loop, what was found, and
    the verdict.
    """

    name: str
    text: str
    verdict: str


@dataclass(frozen=True)
class Evidence:
    """What was measured, in words, the verdict, and the readings it is based on, if
    there are several.
    """

    text: str
    verdict: str
    readings: tuple[Reading, ...] = ()


def judged(truths: Iterable[bool]) -> str:
    """All true: holds. None true: does not hold. Some: holds in part.

    >>> judged([True, True]), judged([True, False]), judged([False, False])
    ('holds', 'holds in part', 'does not hold')
    """
    found = list(truths)
    return HOLDS if all(found) else PART if any(found) else NOT


def together(readings: Iterable[Reading], text: str) -> Evidence:
    """The verdict over all readings: what they agree on, else "holds in part".

    >>> a, b = Reading("a", "", "holds"), Reading("b", "", "does not hold")
    >>> together([a, b], "").verdict, together([b, b], "").verdict
    ('holds in part', 'does not hold')
    """
    rows = tuple(readings)
    found = {row.verdict for row in rows}
    return Evidence(text, found.pop() if len(found) == 1 else PART, rows)
