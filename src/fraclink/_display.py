"""The content of a result for people and programs, stated once by its class.

A figure is a `Row`: its key for programs, its label and unit for people, and its value.
Rows of several similar objects form a `Table`, and an `Overview` is the whole content
of a result: the word of its verdict, a sentence, its figures, its findings. Command
line, JSON, notebook, report and studio loop over them; `fraclink.view` formats and
draws.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from operator import attrgetter
from pathlib import PurePath
from types import MappingProxyType
from typing import Any, Literal, TypeVar

Kind = TypeVar("Kind", bound=type)
Item = TypeVar("Item")

# --- values as people read them: few digits, a real minus, powers of ten -----------------

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

# Stated unit -> displayed unit, its size in SI units, and the number of decimal places
# if it is the same in every column.
_UNITS: dict[str, tuple[str, float, int | None]] = {
    "rad": ("°", math.pi / 180.0, 1),
    "kg": ("g", 1e-3, None),
    "g": ("g", 1e-3, None),
    "mm": ("mm", 1e-3, None),
    "cm": ("cm", 1e-2, None),
    "ms": ("ms", 1e-3, None),
    "µs": ("µs", 1e-6, 1),
    "mrad": ("mrad", 1e-3, 2),
    "mN·m": ("mN·m", 1e-3, None),
    "%": ("%", 1e-2, None),
    "Hz": ("Hz", math.tau, None),
}


def number(value: float | None, digits: int = 4) -> str:
    """Return `value` with `digits` significant digits.

    >>> number(-0.00068712), number(13399.771, 8), number(float("inf")), number(None)
    ('−6.871×10⁻⁴', '13399.771', '∞', '–')
    """
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    # adding 0.0 turns −0.0 into 0.0, since the sign of zero has no meaning
    text = f"{value + 0.0:.{digits}g}"
    mantissa, _, exponent = text.partition("e")
    # Python uses powers of ten only below 1e-4; 0.0006871 and 0.006871 in one column
    # are easily confused.
    if 0 < abs(value) < 1e-3 and not exponent:
        mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    mantissa = mantissa.replace("-", "−")
    if not exponent:
        return mantissa
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return f"{mantissa}×10{str(int(exponent)).translate(_RAISED)}"


def _fixed(value: float, places: int) -> str:
    """A value with a fixed number of places; a value that rounds to zero has no sign."""
    text = f"{value:.{places}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−")


def uncertain(value: float, error: float) -> str:
    """Return `value ± error`, both with the digits that are significant according to
    the error.

    >>> uncertain(1.918734, 0.000213), uncertain(116.0, 145.0)
    ('1.91873 ± 0.00021', 'undetermined')
    """
    # Digits of a value whose sign is uncertain would suggest false accuracy.
    if error >= abs(value):
        return "undetermined"
    # Two digits of the error: one would round 0.14 to 0.1, and three are more than any
    # covariance knows.
    places = max(0, 1 - math.floor(math.log10(error)))
    if places > 9 or abs(value) >= 1e6:
        return f"{number(value, 5)} ± {number(error, 2)}"
    return f"{_fixed(value, places)} ± {_fixed(error, places)}"


def size_of(unit: str) -> float:
    """The size of a display unit in SI units.

    >>> size_of("mrad"), size_of("rad/s")
    (0.001, 1.0)
    """
    word, size, _ = _UNITS.get(unit, ("", 1.0, None))
    return size if word == unit else 1.0


def _in_unit(value: float | None, unit: str, digits: int) -> tuple[str, str]:
    """A value given in SI units in its display unit, and that unit."""
    word, size, places = _UNITS.get(unit, (unit, 1.0, None))
    if value is None or places is None or not math.isfinite(value):
        return number(None if value is None else value / size, digits), word
    return _fixed(value / size, places), word


def quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """Return a value given in SI units as text in its display unit.

    >>> quantity(12.0, "rad/s"), quantity(math.pi / 4, "rad"), quantity(0.0305, "kg")
    ('12 rad/s', '45.0°', '30.5 g')
    """
    text, word = _in_unit(value, unit, digits)
    if text == "–":
        return text
    return text + (word if word == "°" else f" {word}".rstrip())


def span(low: float, high: float, unit: str) -> str:
    """Return an interval with its unit; a single value if it has no length.

    >>> span(0.02, 0.04, "kg"), span(0.03, 0.03, "kg")
    ('20 to 40 g', '30 g')
    """
    ends = quantity(high, unit)
    return ends if low == high else f"{_in_unit(low, unit, 4)[0]} to {ends}"


# --- figures, tables, findings, and all that a result says -------------------------------


@dataclass(frozen=True)
class Row:
    """One figure of a result.

    Parameters
    ----------
    key
        for programs; a dot leads into an object of the JSON. Empty: for people only.
    label
        for people. Empty: for programs only.
    value
        a number in SI units and radians, an interval of two, a text, or a verdict.
    unit
        in which people read it; with "ms", too, `value` is in seconds.
    error
        its standard error, in SI units.
    digits
        significant digits, where the error does not determine them.
    infinite
        the word for an infinite value.

    >>> Row("delay", "gauge delay", 0.002064, "ms", digits=3).text
    '2.06 ms'
    """

    key: str
    label: str
    value: Any
    unit: str = ""
    error: float | None = None
    digits: int = 4
    infinite: str = "∞"

    @staticmethod
    def time(key: str, label: str, value: float) -> Row:
        """A time [s] that may never come."""
        return Row(key, label, value, "s", digits=3, infinite="never")

    @property
    def text(self) -> str:
        """The value with its unit, as people read it."""
        return self._read(with_unit=True)

    @property
    def cell(self) -> str:
        """The value alone, for a column whose head has the unit."""
        return self._read(with_unit=False)

    @property
    def heading(self) -> str:
        """The label with the unit, for a column of such figures."""
        unit = _UNITS.get(self.unit, (self.unit,))[0]
        return f"{self.label} [{unit}]" if unit else self.label

    def _read(self, *, with_unit: bool) -> str:
        value, unit = self.value, self.unit if with_unit else ""
        if isinstance(value, bool):
            return "passed" if value else "failed"
        if isinstance(value, str):
            return value
        word, size, _ = _UNITS.get(self.unit, (self.unit, 1.0, None))
        if isinstance(value, tuple):
            ends = (_in_unit(end, self.unit, self.digits)[0] for end in value)
            return f"{' to '.join(ends)} {word if unit else ''}".rstrip()
        if value is not None and math.isinf(value):
            return self.infinite if value > 0 else f"−{self.infinite}"
        if self.error is not None and 0.0 < self.error < math.inf:
            text = uncertain(value / size, self.error / size)
            numeric = unit and text != "undetermined"
            # A line may break before the sign, but not after it.
            return text.replace("± ", "±\N{NO-BREAK SPACE}") + (
                f" {word}" if numeric else ""
            )
        if unit:
            return quantity(value, unit, self.digits)
        return _in_unit(value, self.unit, self.digits)[0]


def rows_of(result: object, *rows: Row | str | tuple[Any, ...]) -> tuple[Row, ...]:
    """Return the rows of a result. A name gives the attribute to programs alone, with
    the name as its key; a name with label, unit and digits gives it to people, too; a
    `Row` is taken as it is.

    >>> [row.text for row in rows_of(0.02 + 1.0j, ("real", "width", "ms", 2), "imag")]
    ['20 ms', '1']
    """

    def row(name: str, label: str = "", unit: str = "", digits: int = 4) -> Row:
        return Row(name, label, attrgetter(name)(result), unit, digits=digits)

    named = ((each,) if isinstance(each, str) else each for each in rows)
    return tuple(each if isinstance(each, Row) else row(*each) for each in named)


@dataclass(frozen=True)
class Table:
    """Similar objects, each with the same rows: under `key` for programs, under one
    heading for people.
    """

    key: str
    records: tuple[tuple[Row, ...], ...]

    @staticmethod
    def of(key: str, records: Iterable[Any]) -> Table:
        """The table of such records, or of objects with `rows`."""
        return Table(
            key, tuple(tuple(getattr(record, "rows", record)) for record in records)
        )

    def columns(self, *labels: str) -> Table:
        """The same with these columns only."""
        return Table.of(
            self.key,
            ([row for row in record if row.label in labels] for record in self.records),
        )


Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    """One observation of a check; `code` is stable across releases.

    Parameters
    ----------
    code
        ``W101`` and so on: rig W1xx, log W2xx, identification W3xx, design W4xx, law
        and simulation W5xx, twin W6xx.
    severity
        ``info`` (good to know), ``warning`` (results may mislead) or ``error``
        (unusable).
    message
        One sentence for a person.
    evidence
        The numbers behind it, name to value, in SI units and radians.
    remedy
        What to do.

    Examples
    --------
    >>> print(Finding("W101", "warning", "c contradicts 3EI/L", {"c": 1.56, "3EI/L": 1.2}, "measure c"))
    W101 warning: c contradicts 3EI/L (c 1.56, 3EI/L 1.2); measure c
    """

    code: str
    severity: Severity
    message: str
    evidence: Mapping[str, float] = field(default_factory=dict, hash=False)
    remedy: str = ""

    def __post_init__(self) -> None:
        # A read-only copy: a finding travels with its experiment and is hashed, so
        # nobody may change its numbers, even through the dict from which it was
        # created.
        object.__setattr__(self, "evidence", MappingProxyType(dict(self.evidence)))

    def __str__(self) -> str:
        numbers = ", ".join(
            f"{name.replace('_', ' ')} {value:.6g}"
            for name, value in self.evidence.items()
        )
        text = f"{self.code} {self.severity}: {self.message}" + (
            f" ({numbers})" if numbers else ""
        )
        return text + (f"; {self.remedy}" if self.remedy else "")

    @property
    def rows(self) -> tuple[Row, ...]:
        """What it says, as people and programs read it."""
        return (
            Row("code", "code", self.code),
            Row("severity", "severity", self.severity),
            Row("message", "what", self.message),
            Row("evidence", "", self.evidence),
            Row("remedy", "remedy", self.remedy),
        )

    def __reduce__(self) -> tuple[object, ...]:
        # A mapping proxy cannot cross a process border; its dict can.
        return type(self), (
            self.code,
            self.severity,
            self.message,
            dict(self.evidence),
            self.remedy,
        )


@dataclass(frozen=True)
class Overview:
    """The whole content of a result, for people and programs.

    Parameters
    ----------
    headline
        a sentence with what decides.
    state
        the word of its verdict; empty where it has none.
    rows
        its own figures.
    tables
        one for each kind of part that occurs several times.
    findings
        what its checks noticed.
    notes
        further sentences.
    """

    headline: str = ""
    state: str = ""
    rows: tuple[Row, ...] = ()
    tables: tuple[Table, ...] = ()
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()


def source_name(source: str) -> str:
    """The name of a file without the folders of this machine.

    >>> source_name("C:\\\\logs\\\\run.csv"), source_name("")
    ('run.csv', 'unnamed log')
    """
    return PurePath(source.replace("\\", "/")).name or "unnamed log"


def state_of(passed: bool) -> str:
    """The word of a verdict that is either passed or failed."""
    return "passed" if passed else "failed"


# --- results in a prompt and in a notebook -----------------------------------------------


_MARKS = {
    "passed": "✓",
    "failed": "✗",
    "not shown": "!",
    "missing": "!",
    "not run": "–",
    "outdated": "⟳",
}


def marked(text: str) -> str:
    """A verdict's word with a sign before it, so that colours are not needed.

    >>> marked("passed"), marked("failed"), marked("20 g")
    ('✓ passed', '✗ failed', '20 g')
    """
    return f"{_MARKS[text]} {text}" if text in _MARKS else text


_LONGEST = 110  # characters of a repr, so that a list of results stays readable


def _repr(result: Any) -> str:
    """The class and the headline of a result."""
    overview = result.overview()
    line = ": ".join(filter(None, (marked(overview.state), overview.headline)))
    line = line if len(line) <= _LONGEST else line[: _LONGEST - 1] + "…"
    return f"{type(result).__name__}({line})"


def _by_view(name: str, otherwise: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A method that calls `fraclink.view`, or `otherwise` in a copy of the core, which
    does not include that package.
    """

    def rendered(result: Any) -> Any:
        if find_spec("fraclink.view") is None:
            return otherwise(result)
        return getattr(import_module("fraclink.view._notebook"), name)(result)

    return rendered


def displayed(kind: Kind) -> Kind:
    """Give a class with an `overview` what a prompt and a notebook ask for: a short
    repr, its figures by `print`, its table and, where there is one, its drawing.

    >>> import fraclink as fl
    >>> fl.Rig.named("paper-2023")
    Rig(paper-2023)
    """
    kind.__repr__ = _repr  # type: ignore[assignment]
    kind.__str__ = _by_view("text", _repr)  # type: ignore[assignment]
    kind._repr_html_ = _by_view("page_part", lambda result: None)  # type: ignore[attr-defined]
    kind._repr_svg_ = _by_view("drawing", lambda result: None)  # type: ignore[attr-defined]
    return kind


@displayed
class Listed(tuple[Item, ...]):
    """A tuple of similar objects with `rows`, shown as one table at a prompt and in a
    notebook.
    """

    def overview(self) -> Overview:
        """Its table and the number of entries."""
        table = Table.of("", self)
        passed = all(getattr(item, "passed", True) for item in self)
        return Overview(str(len(self)), state_of(passed), tables=(table,))
