"""What the paper prints, read from reproduce/*.toml, and how well our values agree with
it.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

from fraclink.errors import FileFormatError

__all__ = [
    "VERDICTS",
    "Claim",
    "Equation",
    "Number",
    "Published",
    "agreement",
    "agrees",
    "read_published",
]

VERDICTS = {  # and the words after the count of each
    "input": "are inputs, used as they stand",
    "reproduced": "are reproduced",
    "corrected": "is corrected",
    "contradicts": "contradict the paper's own other numbers",
    "not reproducible": "need the laboratory's data",
}
_EQUATIONS = ("right", "misprint")
_CLAIMS = ("holds", "does not hold", "holds in part", "not testable without the logs")


@dataclass(frozen=True)
class Number:
    """One printed number: where it is printed, its digits, the name of our computation,
    and the verdict.
    """

    id: str
    where: str
    what: str
    value: str
    unit: str
    verdict: str
    ours: str = ""
    also: str = ""
    reason: str = ""

    @property
    def printed(self) -> float:
        """The printed value."""
        return float(self.value)


@dataclass(frozen=True)
class Equation:
    """One numbered equation, the function that implements it, and whether it is printed
    correctly.
    """

    number: str
    what: str
    code: str
    verdict: str
    reason: str = ""


@dataclass(frozen=True)
class Claim:
    """One statement in words, with the name of the measurement that tests it."""

    id: str
    where: str
    statement: str
    evidence: str
    verdict: str
    reason: str = ""


@dataclass(frozen=True)
class Published:
    """Everything the paper prints."""

    source: str
    numbers: tuple[Number, ...]
    equations: tuple[Equation, ...]
    claims: tuple[Claim, ...]


def agrees(printed: str, ours: float) -> bool:
    """Whether `ours`, rounded to the printed digits, is the printed number.

    >>> agrees("0.65", 0.655361), agrees("0.66", 0.655361)
    (False, True)
    """
    step = Decimal(1).scaleb(int(Decimal(printed).as_tuple().exponent))
    return abs(Decimal(ours) - Decimal(printed)) <= step / 2


def agreement(printed: float, ours: float) -> float:
    """Digits in which two numbers agree, −log10 of their relative difference; infinity
    for equal ones.

    >>> round(agreement(0.148, 0.215299), 2), round(agreement(11.54, 11.5470), 2)
    (0.34, 3.22)
    """
    if ours == printed:
        return math.inf
    return max(0.0, -math.log10(abs(ours - printed) / abs(printed)))


def read_published(folder: Path) -> Published:
    """Read numbers, equations and claims from `folder`; a FileFormatError states what
    is wrong.
    """
    numbers = _read(folder / "published.toml")
    rest = _read(folder / "equations.toml") | _read(folder / "claims.toml")
    return Published(
        str(numbers.get("source", "")),
        _items(Number, numbers.get("number", []), "verdict", tuple(VERDICTS), folder),
        _items(Equation, rest.get("equation", []), "verdict", _EQUATIONS, folder),
        _items(Claim, rest.get("claim", []), "verdict", _CLAIMS, folder),
    )


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except FileNotFoundError as error:
        remedy = "run in the repository"
        raise FileFormatError(
            path.name,
            str(path.parent),
            "not there",
            "a TOML file",
            remedy,
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(
            "published",
            str(path),
            f"not valid TOML ({error})",
            "a TOML file",
            "correct that line",
        ) from error


def _items(
    kind: Any,
    rows: list[dict[str, str]],
    field: str,
    allowed: tuple[str, ...],
    folder: Path,
) -> tuple[Any, ...]:
    made = []
    for row in rows:
        try:
            item = kind(**row)
        except TypeError as error:
            raise FileFormatError(
                "published",
                str(folder),
                f"wrong in {row} ({error})",
                "the known keys",
                "correct it",
            ) from error
        if getattr(item, field) not in allowed:
            raise FileFormatError(
                field,
                getattr(item, field),
                "unknown",
                ", ".join(allowed),
                f"correct {row}",
            )
        made.append(item)
    return tuple(made)
