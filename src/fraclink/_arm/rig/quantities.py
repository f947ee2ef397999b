"""One table of what every rig field may hold: its key in the file, its unit, its range.

The same `Quantity` checks a value given in Python, builds the reader of the file, and prints the
allowed range, so that the three cannot drift apart.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass
from typing import Annotated, Any, cast, get_args, get_origin, get_type_hints

import numpy as np

from fraclink.errors import FieldError

__all__ = ["NAME", "SENTENCE", "SIZE_LIMITS", "SOURCE", "Quantity", "Text", "check_fields", "specs"]

# Products of a handful of values between these stay far from overflow (1e308) and underflow.
SIZE_LIMITS = (1e-15, 1e15)


@dataclass(frozen=True)
class Quantity:
    """A number: `key` in the rig file, `unit`, and bounds (exclusive `above`, inclusive the others)."""

    key: str
    unit: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    integer: bool = False
    may_be_infinite: bool = False  # "no limit": the default of a limit that the file does not state
    remedy: str = ""

    @property
    def allowed(self) -> str:
        """The range as an error prints it."""
        bounds = [(">", self.above), (">=", self.at_least), ("<=", self.at_most)]
        text = " and ".join(f"{sign} {bound:g}" for sign, bound in bounds if bound is not None)
        kind = "an integer" if self.integer else "a finite number"
        unit = f" [{self.unit}]" if self.unit else ""
        return f"{kind} {text}".strip() + unit

    def check(self, path: str, value: object) -> float | int:
        """Return `value` as a plain number, or raise FieldError naming `path`."""
        problem = self._problem(value)
        if problem:
            remedy = self.remedy or f"give {path.rsplit('.', 1)[-1]} as a number" + (
                f" in {self.unit}" if self.unit else ""
            )
            raise FieldError(path, value, problem, allowed=self.allowed, remedy=remedy)
        number = cast(float, value)  # what _problem has just checked
        return int(number) if self.integer else float(number)

    def _problem(self, value: object) -> str:
        if isinstance(value, (bool, np.bool_)) or not isinstance(
            value, (int, float, np.integer, np.floating)
        ):
            return f"of type {type(value).__name__}, not a number"
        if self.integer and not isinstance(value, (int, np.integer)):
            return "not an integer"
        try:
            number = float(value)
        except OverflowError:
            return "too large"
        if math.isnan(number) or (math.isinf(number) and not (self.may_be_infinite and number > 0)):
            return "not finite"
        return self._range_problem(number)

    def _range_problem(self, number: float) -> str:
        if self.above is not None and not number > self.above:
            return "negative" if number < 0 <= self.above else "too small"
        if self.at_least is not None and number < self.at_least:
            return "negative" if number < 0 <= self.at_least else "too small"
        if self.at_most is not None and number > self.at_most:
            return "too large"
        low, high = SIZE_LIMITS
        if number and math.isfinite(number) and not low <= abs(number) <= high:
            return f"outside {low:g} … {high:g} in size, where products overflow"
        return ""


@dataclass(frozen=True)
class Text:
    """A text of at most `limit` characters; `choices` where only some words are meant."""

    key: str
    limit: int = 200
    choices: tuple[str, ...] = ()
    may_be_empty: bool = False

    @property
    def allowed(self) -> str:
        """The range as an error prints it."""
        if self.choices:
            return ", ".join(self.choices)
        return f"text of {0 if self.may_be_empty else 1} to {self.limit} characters"

    def check(self, path: str, value: object) -> str:
        """Return `value`, or raise FieldError naming `path`."""
        problem = self._problem(value)
        if problem:
            raise FieldError(path, value, problem, allowed=self.allowed, remedy="give another text")
        return str(value)

    def _problem(self, value: object) -> str:
        if not isinstance(value, str):
            return f"of type {type(value).__name__}, not a text"
        if len(value) > self.limit:
            return f"too long ({len(value)} characters)"
        if not value and not self.may_be_empty:
            return "empty"
        if any(0xD800 <= ord(c) <= 0xDFFF for c in value):
            return "not valid Unicode (a lone surrogate), which no file can hold"
        if self.choices and value not in self.choices:
            return "unknown"
        return ""


NAME = Text("name", limit=100)
SOURCE = Text("source", limit=500, may_be_empty=True)
SENTENCE = Text("assumptions", limit=500)


@functools.cache
def specs(kind: Any) -> dict[str, Quantity | Text]:
    """The specification of every annotated field of a dataclass, by field name."""
    hints: dict[str, Any] = get_type_hints(kind, include_extras=True)
    found: dict[str, Quantity | Text] = {}
    for item in dataclasses.fields(kind):
        hint = hints[item.name]
        if get_origin(hint) is Annotated:
            found[item.name] = next(m for m in get_args(hint)[1:] if isinstance(m, (Quantity, Text)))
    return found


def check_fields(noun: Any, section: str) -> None:
    """Check every annotated field of a frozen dataclass and store it as a plain Python value."""
    kind: Any = type(noun)
    for name, spec in specs(kind).items():
        value = getattr(noun, name)
        if value is not None:
            path = f"{section}.{name}" if section else name
            object.__setattr__(noun, name, spec.check(path, value))
        elif not _may_be_none(kind, name):
            spec.check(f"{section}.{name}" if section else name, value)


@functools.cache
def _may_be_none(kind: Any, name: str) -> bool:
    hint = get_type_hints(kind)[name]
    return type(None) in get_args(hint)
