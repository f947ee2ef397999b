"""What may stand beside a type in an annotation, and the rules of numbers:
Annotated[float, Between(0, 1)]
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Any, cast

import numpy as np

from fracsys.errors import FieldError, value_text

Check = Callable[[Any], Any]

CHECK_UNIT = "check the value and its unit"


class Refused(
    Exception
):  # never leaves this module: the border makes a FieldError of it
    """A check that failed, before the name of its field is known."""

    def __init__(
        self,
        value: object,
        problem: str,
        expected: str,
        remedy: str,
        *,
        is_type: bool = False,
    ):
        super().__init__(problem)
        self.value, self.problem, self.expected, self.remedy = (
            value,
            problem,
            expected,
            remedy,
        )
        # the value is of another kind, so another member of a union may take it
        self.is_type = is_type
        self.place = ""  # "[0]" inside a sequence

    def error(self, field: str, kind: type[FieldError]) -> FieldError:
        value, place = self.value, field + self.place
        return kind(
            place, value, self.problem, allowed=self.expected, remedy=self.remedy
        )


@dataclass(frozen=True)
class Rule:
    """What an annotation admits: its words, its check and, for numbers and words, its
    bounds and choices.
    """

    expected: str
    convert: Check
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[Any, ...] = ()

    def check(
        self, field: str, value: object, *, error: type[FieldError] = FieldError
    ) -> Any:
        """Return `value` normalised; raises `error` (a FieldError) that names `field`
        otherwise.
        """
        try:
            return self.convert(value)
        except Refused as refused:
            raise refused.error(field, error) from None


# --- what stands beside a type: Annotated[float, Between(...)] ----------------------------------------


@dataclass(frozen=True)
class Between:
    """A range of numbers, of every element for arrays; bounds are included unless open.

    >>> Between(0.0, 9.0, "rad/s", low_open=True).expected
    '> 0 and <= 9 rad/s'
    >>> Between(0.0, 1e6, "s").check("filter_time", 2)
    2.0
    >>> Between(0.0, 1e6, "s").check("filter_time", -2)
    Traceback (most recent call last):
    fracsys.errors.FieldError: filter_time: out of range (got -2.0); expected 0 to 1e6 s. Check the value and
    its unit.
    """

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    _: KW_ONLY
    low_open: bool = False
    high_open: bool = False
    # False admits infinities inside the bounds, and NaN where there are no bounds
    finite: bool = True
    remedy: str = CHECK_UNIT

    @property
    def expected(self) -> str:
        """The range in words, with its unit."""
        low, high = _figure(self.low), _figure(self.high)
        bounds = (
            [f"{'>' if self.low_open else '>='} {low}"] if self.low > -math.inf else []
        )
        bounds += (
            [f"{'<' if self.high_open else '<='} {high}"]
            if self.high < math.inf
            else []
        )
        closed = len(bounds) == 2 and not (self.low_open or self.high_open)
        text = f"{low} to {high}" if closed else " and ".join(bounds)
        text = (
            f"{text} {self.unit}".strip()
            if bounds
            else f"a finite number {self.unit}".rstrip()
        )
        if self.finite:
            return text
        return f"{text} or infinite" if bounds else f"a number {self.unit}".rstrip()

    def admits(self, number: Any) -> Any:
        """Whether a number lies in the range; elementwise for arrays."""
        above = number > self.low if self.low_open else number >= self.low
        return above & (number < self.high if self.high_open else number <= self.high)

    def check(self, field: str, value: object) -> float:
        """Return `value` as a float of this range; for bounds that are known at run
        time only.
        """
        return cast(float, number_rule(self).check(field, value))


@dataclass(frozen=True)
class Array:
    """An array of real (or, where its type says so, complex) numbers with `ndim` axes."""

    ndim: int | None = 1
    finite: bool = True
    min_size: int = 0
    # whether True and False count as 1 and 0: a condition such as t > 1 is a step
    flags: bool = False

    @property
    def expected(self) -> str:
        """Shape and content in words."""
        shapes = {None: "any shape", 0: "no axis", 1: "shape (N,)", 2: "shape (N, M)"}
        size = f" with N >= {self.min_size}" if self.min_size else ""
        kind = "finite numbers" if self.finite else "numbers"
        return f"{kind} of {shapes.get(self.ndim, f'{self.ndim} axes')}{size}"


@dataclass(frozen=True)
class Ordered:
    """A pair (low, high) with low <= high, or low < high where `strict`."""

    strict: bool = False


@dataclass(frozen=True)
class Length:
    """The number of entries of a sequence, mapping or text."""

    low: int = 0
    high: int = 10**9


@dataclass(frozen=True)
class Where:
    """A condition of its own, in words: ``Where(str.isidentifier, "a Python
    identifier")``.
    """

    condition: Callable[[Any], bool]
    expected: str
    problem: str = "out of range"
    remedy: str = CHECK_UNIT


def _figure(number: float) -> str:
    """A bound as people write it: 1e6 for 1000000.0, every digit of a whole number that
    is an int.
    """
    # A range of samples is read by its digits, 300000; one of a unit by its size, 1e6.
    text = (
        str(number)
        if isinstance(number, int) and abs(number) < 10**6
        else f"{number:g}"
    )
    mantissa, mark, exponent = text.partition("e")
    # 1e+06 is what Python writes and nobody else.
    return f"{mantissa}e{int(exponent)}" if mark else text


def number_rule(bounds: Between | None = None) -> Rule:
    limits = bounds or Between()
    expected, remedy, finite = limits.expected, limits.remedy, limits.finite
    low, high, simple = (
        limits.low,
        limits.high,
        not (limits.low_open or limits.high_open),
    )

    def convert(value: Any) -> float:
        # The common case first: this runs at every call of every public function.
        if type(value) is not float:
            value = _as_float(value, expected, remedy)
        # NaN fails every comparison, so it falls through to the refusal below.
        if (low <= value <= high if simple else limits.admits(value)) and (
            not finite or math.isfinite(value)
        ):
            return cast(float, value)
        if not finite and math.isnan(value) and low == -math.inf and high == math.inf:
            return cast(float, value)
        raise Refused(
            value,
            "out of range" if math.isfinite(value) else "not finite",
            expected,
            remedy,
        )

    return Rule(expected, convert, limits.unit, low, high)


def _as_float(value: Any, expected: str, remedy: str) -> float:
    if isinstance(value, bool | np.bool_) or not isinstance(
        value, int | float | np.floating | np.integer
    ):
        raise Refused(brief(value), "not a number", expected, remedy, is_type=True)
    try:
        return float(value)
    except OverflowError:  # a whole number of more than 308 digits
        # As infinity it meets the range's own refusal, "not finite", which names the
        # bounds.
        return math.inf if value > 0 else -math.inf


def whole_rule(bounds: Between | None = None) -> Rule:
    limits = bounds or Between()
    low, high, unit = limits.low, limits.high, limits.unit
    text = (
        f"{_figure(low)} to {_figure(high)}"
        if math.isfinite(high)
        else f">= {_figure(low)}"
    )
    expected = (
        f"whole number {text if math.isfinite(low) else ''} {unit}".strip().replace(
            "  ", " "
        )
    )
    remedy = "give a whole number" if limits.remedy == CHECK_UNIT else limits.remedy

    def convert(value: Any) -> int:
        if isinstance(value, bool | np.bool_) or not isinstance(
            value, int | np.integer
        ):
            raise Refused(
                brief(value), "not a whole number", expected, remedy, is_type=True
            )
        # Python's int: bounds of 64 bits are compared exactly, which a numpy integer
        # would wrap around.
        number = int(value)
        if not low <= number <= high:
            raise Refused(number, "out of range", expected, remedy)
        return number

    return Rule(expected, convert, unit, low, high)


def complex_rule() -> Rule:
    expected, remedy = "a finite complex number", "give a number"

    def convert(value: Any) -> complex:
        kinds = int | float | complex | np.number
        if isinstance(value, bool | np.bool_) or not isinstance(value, kinds):
            raise Refused(brief(value), "not a number", expected, remedy, is_type=True)
        number = (
            complex(value) if isinstance(value, complex | np.complexfloating) else None
        )
        number = (
            complex(_as_float(value, expected, remedy)) if number is None else number
        )
        if not (math.isfinite(number.real) and math.isfinite(number.imag)):
            raise Refused(number, "not finite", expected, remedy)
        return number

    return Rule(expected, convert)


def brief(value: object) -> str:
    """A value of the wrong kind: small ones as written, the others by their type."""
    scalar = isinstance(value, str | bytes | int | float | complex | np.generic | None)
    # A message is one line: of a thousand samples the type says enough.
    short = isinstance(value, tuple | list) and len(value) <= 8
    return value_text(value) if scalar or short else type(value).__name__
