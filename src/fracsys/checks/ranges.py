"""Rules, and the classes that may stand next to a type in an annotation:
``Annotated[float, Between(0, 1)]``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sized
from dataclasses import KW_ONLY, dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, cast

import numpy as np

from fracsys.errors import FieldError, value_text

CHECK_UNIT = "check the value and its unit"


class Refused(Exception):
    """A value rejected by a rule, before the name of its field is known.

    `is_type` says that the value is of another kind, so that another member of a union
    may accept it. `keys` are its path within the field, the outermost last. `inner` are
    the errors of several of its entries.
    """

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
        self.value, self.problem = value, problem
        self.expected, self.remedy, self.is_type = expected, remedy, is_type
        self.keys: list[object] = []
        self.inner: list[Refused] = []

    def error(self, field: str, kind: type[FieldError]) -> FieldError:
        """Return the error about `field`."""
        place = field + "".join(f"[{key!r}]" for key in reversed(self.keys))
        expected, remedy = self.expected, self.remedy
        return kind(place, self.value, self.problem, expected, remedy)


class Form:
    """The form in which values are given: as arguments of a call or, in a subclass, in
    a file. `own` holds functions of (rule, value) for kinds that a file cannot express.
    """

    own: Mapping[Any, Callable[[Rule, Any], Any]] = MappingProxyType({})

    def __call__(self, rule: Rule, value: Any) -> Any:
        """Return `value` converted; raises Refused if `rule` does not admit it."""
        own = self.own.get(rule.kind)
        return rule.convert(value, self) if own is None else own(rule, value)

    def entry(self, rule: Rule, value: Any, key: object) -> Any:
        """Return the value at `key` of a container, converted."""
        try:
            return self(rule, value)
        except Refused as refused:
            refused.keys.append(key)
            refused.is_type = False  # the container itself was of the right kind
            raise


@dataclass(frozen=True)
class Rule:
    """The values that an annotation accepts.

    Parameters
    ----------
    expected
        in words.
    convert
        returns a value normalised, or raises Refused; its parts are converted by the
        form that is handed to it.
    kind, of
        what a form may treat differently: float, complex, bytes, np.ndarray, Any, or
        type for the instances of a class; `of` is that class, or the element type of an
        array.
    unit
        of numbers.
    named
        whether a file has to name the class, since it is one of several.
    """

    expected: str
    convert: Callable[[Any, Form], Any]
    kind: Any = None
    of: Any = None
    _: KW_ONLY
    unit: str = ""
    named: bool = False

    def check(
        self,
        name: str,
        value: object,
        *,
        remedy: str = "",
    ) -> Any:
        """Return `value` normalised; raise a FieldError about `name` if it is rejected,
        with the rule's own remedy or another one.

        >>> number(Between(0.0, 1e6, "s")).check("filter_time", -2)
        Traceback (most recent call last):
        fracsys.errors.FieldError: filter_time: out of range (got -2.0); expected 0 to 1e6 s. Check the value and
        its unit.
        """
        try:
            return self.convert(value, ARGUMENTS)
        except Refused as refused:
            # Without the inner frames: the mistake is at the call, and the internals of
            # the check do not help to find it.
            refused.remedy = remedy or refused.remedy
            raise refused.error(name, FieldError) from None


ARGUMENTS = Form()


@dataclass(frozen=True)
class Between:
    """A range of numbers, of every element for arrays; bounds are included unless open.

    >>> above(0.0, 9.0, "rad/s").expected
    '> 0 and <= 9 rad/s'
    """

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    _: KW_ONLY
    low_open: bool = False
    high_open: bool = False
    # False admits infinities inside the bounds, and NaN where there are no bounds.
    finite: bool = True
    remedy: str = CHECK_UNIT

    @property
    def expected(self) -> str:
        """The range in words, with its unit."""
        low, high = _figure(self.low), _figure(self.high)
        bounds = []
        if self.low > -math.inf:
            bounds.append(f"{'>' if self.low_open else '>='} {low}")
        if self.high < math.inf:
            bounds.append(f"{'<' if self.high_open else '<='} {high}")
        if len(bounds) == 2 and not (self.low_open or self.high_open):
            bounds = [f"{low} to {high}"]
        if not bounds:
            number = "a finite number" if self.finite else "a number"
            return f"{number} {self.unit}".rstrip()
        infinite = "" if self.finite else " or infinite"
        return f"{' and '.join(bounds)} {self.unit}".rstrip() + infinite

    def admits(self, number: Any) -> Any:
        """Whether a number lies in the range; elementwise for arrays."""
        return (number > self.low if self.low_open else number >= self.low) & (
            number < self.high if self.high_open else number <= self.high
        )

    def check(self, name: str, value: object) -> float:
        """Return `value` as a float of this range; for bounds that are known at run
        time only.
        """
        return cast(float, number(self).check(name, value))


# The same range, its lower bound excluded.
above = partial(Between, low_open=True)


@dataclass(frozen=True)
class Array:
    """An array of real (or, where its type says so, complex) numbers with `ndim` axes."""

    ndim: int | None = 1
    finite: bool = True
    min_size: int = 0
    # whether True and False count as 1 and 0, so that a condition such as t > 1 is a
    # step
    flags: bool = False

    @property
    def expected(self) -> str:
        """Shape and content in words."""
        shapes = {None: "any shape", 1: "shape (N,)", 2: "shape (N, M)"}
        size = f" with N >= {self.min_size}" if self.min_size else ""
        kind = "finite numbers" if self.finite else "numbers"
        return f"{kind} of {shapes.get(self.ndim, f'{self.ndim} axes')}{size}"


@dataclass(frozen=True)
class Where:
    """A custom condition with its description: ``Where(str.isidentifier, "a Python
    identifier")``.
    """

    condition: Callable[[Any], bool]
    expected: str
    problem: str = "out of range"
    remedy: str = CHECK_UNIT


def length(low: int, high: int = 10**9) -> Where:
    """Return the condition on the number of entries of a sequence or of characters of a
    string.
    """
    bounds = f"{low} to {high}" if high < 10**9 else f"at least {low}"

    def fits(entries: Sized) -> bool:
        return low <= len(entries) <= high

    return Where(fits, f"{bounds} long", "of another length", f"give {bounds}")


def ascending(*, strict: bool = False) -> Where:
    """Return the condition on a pair (low, high): low <= high, or low < high if
    `strict`.
    """

    def fits(pair: tuple[float, float]) -> bool:
        return pair[0] < pair[1] or (pair[0] == pair[1] and not strict)

    expected = f"low {'<' if strict else '<='} high"
    return Where(fits, expected, "not in ascending order", "give the smaller one first")


def _figure(number: float) -> str:
    """A bound as people write it: 1e6 for 1000000.0, but all digits of an int below
    that.
    """
    # A bound on a number of samples is written in full, 300000; one on a physical
    # quantity as 1e6.
    if isinstance(number, int) and abs(number) < 10**6:
        return str(number)
    mantissa, mark, exponent = f"{number:g}".partition("e")
    # Python's own 1e+06 has a sign and zeros that nobody writes.
    return f"{mantissa}e{int(exponent)}" if mark else mantissa


def number(bounds: Between = Between()) -> Rule:
    """Return the rule of a real number."""
    expected, remedy, finite = bounds.expected, bounds.remedy, bounds.finite
    low, high = bounds.low, bounds.high
    closed = not (bounds.low_open or bounds.high_open)
    any_number = not finite and low == -math.inf and high == math.inf

    def convert(value: Any, form: Form) -> float:
        # The common case first: this runs at every call of every public function.
        if type(value) is not float:
            value = _as_float(value, expected, remedy)
        # NaN fails every comparison, so it falls through to the refusal below.
        inside = low <= value <= high if closed else bounds.admits(value)
        if (inside and (not finite or math.isfinite(value))) or any_number:
            return cast(float, value)
        raise Refused(
            value,
            "out of range" if math.isfinite(value) else "not finite",
            expected,
            remedy,
        )

    return Rule(expected, convert, float, unit=bounds.unit)


def _as_float(value: Any, expected: str, remedy: str) -> float:
    kinds = int | float | np.floating | np.integer
    if isinstance(value, bool | np.bool_) or not isinstance(value, kinds):
        raise Refused(brief(value), "not a number", expected, remedy, is_type=True)
    try:
        return float(value)
    except OverflowError:  # an integer of more than 308 digits
        # Infinity is then rejected by the range, whose message names the bounds.
        return math.inf if value > 0 else -math.inf


def whole_number(bounds: Between = Between()) -> Rule:
    """Return the rule of an integer, which excludes bool and 2.0."""
    low, high = bounds.low, bounds.high
    text = f" >= {_figure(low)}" if math.isfinite(low) else ""
    if math.isfinite(high):
        text = f" {_figure(low)} to {_figure(high)}"
    expected = f"whole number{text} {bounds.unit}".rstrip()
    remedy = "give a whole number" if bounds.remedy == CHECK_UNIT else bounds.remedy

    def convert(value: Any, form: Form) -> int:
        is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        if not is_whole:
            raise Refused(
                brief(value), "not a whole number", expected, remedy, is_type=True
            )
        # Python's int compares exactly with 64-bit bounds; a numpy integer would wrap
        # around.
        plain = int(value)
        if not low <= plain <= high:
            raise Refused(plain, "out of range", expected, remedy)
        return plain

    return Rule(expected, convert, int, unit=bounds.unit)


def brief(value: object) -> str:
    """Return a value of the wrong kind for display: small ones as written, the others
    by their type.
    """
    scalar = isinstance(value, str | bytes | int | float | complex | np.generic | None)
    # A message is one line: for a thousand samples the type is enough.
    short = isinstance(value, tuple | list) and len(value) <= 8
    return value_text(value) if scalar or short else type(value).__name__
