"""Values from outside: a range is written once, in the annotation, and checked where
the value enters.

    @checked
    def design(model: LinkModel, *, gain_crossover: Frequency): ...

    @checked
    @dataclass(frozen=True)
    class Sensor:
        period: Period
        noise: Annotated[float, Between(0.0, 1e6, "N·m")] = 0.0

`checked` reads the annotations at the first call, refuses what they do not admit with a
FieldError, and hands on plain values: float and int (never a bool or a numpy scalar),
tuples, paths, float64 arrays. The same annotation gives the command line's help
(`describe`) and the rule of a file's field (`rules`).
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import math
import os
import sys
import types
from collections.abc import Callable, Iterable
from dataclasses import dataclass, is_dataclass
from typing import Annotated, Any, TypeVar, cast, get_type_hints, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracsys.checks.ranges import CHECK_UNIT as CHECK_UNIT
from fracsys.checks.ranges import Array as Array
from fracsys.checks.ranges import Between as Between
from fracsys.checks.ranges import Check, Refused, number_rule, whole_rule
from fracsys.checks.ranges import Length as Length
from fracsys.checks.ranges import Ordered as Ordered
from fracsys.checks.ranges import Rule as Rule
from fracsys.checks.ranges import Where as Where
from fracsys.checks.rules import (
    conditional_rule,
    instance_rule,
    listed,
    rule,
)
from fracsys.checks.rules import unaliased as unaliased
from fracsys.errors import FieldError

Target = TypeVar("Target", bound=Callable[..., Any])
Instance = TypeVar("Instance")

# --- ranges that recur --------------------------------------------------------------------------------

Positive = Annotated[float, Between(0.0, low_open=True)]
NonNegative = Annotated[float, Between(0.0)]
Fraction = Annotated[float, Between(0.0, 1.0)]
Period = Annotated[
    float,
    Between(
        0.0, 10.0, "s", low_open=True, remedy="give the sampling period in seconds"
    ),
]
Time = Annotated[float, Between(0.0, 1e6, "s", remedy="give seconds")]
Duration = Annotated[
    float, Between(0.0, 1e6, "s", low_open=True, remedy="give seconds")
]
Payload = Annotated[
    float,
    Between(0.0, 1e4, "kg", low_open=True, remedy="give the mass at the tip in kg"),
]
Frequency = Annotated[float, Between(0.0, 1e6, "rad/s", low_open=True)]
# Its unit depends on λ: ω₀² is added to s^λ.
NaturalFrequency = Annotated[float, Between(0.0, 1e6, "s^(-λ/2)", low_open=True)]
Angle = Annotated[
    float, Between(-1e6, 1e6, "rad", remedy="give radians; deg(50) converts degrees")
]
_HALF_TURN = Between(
    0.0,
    math.pi,
    "rad",
    low_open=True,
    high_open=True,
    remedy="give radians; deg(50) converts degrees",
)
PhaseMargin = Annotated[float, _HALF_TURN]
PhaseMarginDeg = Annotated[
    float, Between(0.0, 179.0, "°", low_open=True, remedy="50° is a usual margin")
]
LinkOrder = Annotated[
    float, Between(1.0, 2.0, "(λ)", remedy="λ is 2 for a classical link")
]
# A billion: more than any count in a file that fits into memory, and exact as a double.
Count = Annotated[int, Between(1, 10**9)]
# What NumPy's generators take.
Seed = Annotated[int, Between(0, 2**64 - 1)]
Workers = Annotated[int, Between(1, 1024)]
Series = Annotated[NDArray[np.float64], Array(1)]
SeriesLike = Annotated[ArrayLike, Array(1)]
FilePath = str | os.PathLike[str]


def describe(annotation: Any) -> str:
    """Return what `annotation` admits in words, as errors and the command line's help
    print it.

    >>> from typing import Literal
    >>> describe(Period), describe(Annotated[int, Between(1, 8, "samples")] | None)
    ('> 0 and <= 10 s', 'whole number 1 to 8 samples')
    >>> describe(Literal["zero", "first"]), describe(tuple[Payload, Payload])
    ('zero or first', 'a pair, each > 0 and <= 10000 kg')
    """
    return rule(annotation).expected


# --- the decorator ------------------------------------------------------------------------------------

_TARGETS: list[
    Callable[..., Any]
] = []  # every checked function and class, for the test of their annotations


@overload
def checked(target: Target, /) -> Target: ...
@overload
def checked(
    *, error: type[FieldError] = ..., prefix: str = ...
) -> Callable[[Target], Target]: ...
def checked(
    target: Any = None, /, *, error: type[FieldError] = FieldError, prefix: str = ""
) -> Any:
    """Check the arguments of a function, or the fields of a frozen dataclass, by their
    annotations.

    Defaults are trusted and not checked. `error` is the class that is raised; `prefix`
    stands before the field's name ("lead."). Put it above `@dataclass(frozen=True)`;
    the class's own ``__post_init__`` then sees normalised fields and checks only what
    involves several of them. A dataclass that inherits from a checked one needs its own
    `@checked`, because `dataclass` writes it a new ``__init__``.

    >>> from typing import Literal
    >>> @checked
    ... def sample(duration: Duration, *, hold: Literal["zero", "first"] = "zero") -> float:
    ...     return duration
    >>> sample(1)
    1.0
    >>> sample(1, hold="second")
    Traceback (most recent call last):
    fracsys.errors.FieldError: hold: unknown (got second); expected zero or first. Choose one of these.
    """
    if target is None:
        return functools.partial(_checked, error=error, prefix=prefix)
    return _checked(target, error=error, prefix=prefix)


def _checked(target: Any, *, error: type[FieldError], prefix: str) -> Any:
    # Annotations are resolved at the first call: a test goes through this list, so that
    # none fails for a user first.
    _TARGETS.append(target)
    if not isinstance(target, type):
        return _guarded(target, target, error, prefix, own=False)
    if not is_dataclass(target):
        raise TypeError(
            f"checked: {target.__name__} is not a dataclass; put checked above dataclass"
        )
    # The class's own `__init__` and not a wrapper class: `replace`, `fields` and
    # pickles see the dataclass as it is written.
    target.__init__ = _guarded(target.__init__, target, error, prefix, own=True)  # type: ignore[method-assign]
    return target


@dataclass(frozen=True)
class _Plan:
    """How to check one call: by position (name, check), by name, and what *args and
    **kwargs hold.
    """

    ordered: list[tuple[str, Check | None]]
    named: dict[str, Check | None]
    rest: Check | None
    others: Check | None


def _plan(function: Callable[..., Any], target: Any, own: bool) -> _Plan:
    checks = {
        name: rule(hint, own=own).convert for name, hint in _hints(target).items()
    }
    kinds: dict[Any, list[str]] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        kinds.setdefault(parameter.kind, []).append(name)
    one = inspect.Parameter
    # A parameter that takes both is in both tables: the call decides which of them is
    # asked.
    ordered = kinds.get(one.POSITIONAL_ONLY, []) + kinds.get(
        one.POSITIONAL_OR_KEYWORD, []
    )
    named = kinds.get(one.POSITIONAL_OR_KEYWORD, []) + kinds.get(one.KEYWORD_ONLY, [])
    rest, others = (
        checks.get(kinds.get(kind, [""])[0])
        for kind in (one.VAR_POSITIONAL, one.VAR_KEYWORD)
    )
    return _Plan(
        [(name, checks.get(name)) for name in ordered],
        {name: checks.get(name) for name in named},
        rest,
        others,
    )


def _guarded(
    function: Callable[..., Any],
    target: Any,
    error: type[FieldError],
    prefix: str,
    *,
    own: bool,
) -> Callable[..., Any]:
    plan: _Plan | None = (
        None  # made at the first call, when every name of the module exists
    )

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal plan
        if plan is None:
            plan = _plan(function, target, own)
        name, ordered = "", plan.ordered
        try:
            if args:
                values = list(args)
                for index, value in enumerate(args):
                    # Behind the last one comes *args, whose entries have no name of
                    # their own.
                    name, check = (
                        ordered[index] if index < len(ordered) else ("", plan.rest)
                    )
                    if check is not None:
                        values[index] = check(value)
                args = tuple(values)
            for name, value in kwargs.items():
                check = plan.named.get(name, plan.others)
                if check is not None:
                    kwargs[name] = check(value)
        except Refused as refused:
            # Without the inner frames: the user's mistake is at the call, and the rule
            # that saw it is no part of the message.
            raise refused.error(prefix + name, error) from None
        return function(*args, **kwargs)

    return call


def rules(target: Callable[..., Any]) -> dict[str, Rule]:
    """Return the rule of each annotated argument of a function, or field of a
    dataclass.

    >>> rules(Between.check)["field"].expected
    'a text'
    """
    return {name: rule(hint) for name, hint in _hints(target).items()}


def _hints(target: Any, *, strict: bool = False) -> dict[str, Any]:
    """The annotations of `target`, without what cannot be resolved unless `strict`.

    A name imported under TYPE_CHECKING only does not exist when the program runs. That
    is a mistake in fraclink, found by its tests; a user's call must not fail for it.
    """
    try:
        hints = get_type_hints(target, include_extras=True)
    except NameError:
        if strict:
            raise
        hints = {}
        # Base classes first, so that a field's own annotation wins.
        for part in reversed(target.__mro__) if isinstance(target, type) else (target,):
            hints |= _resolvable(part)
    hints.pop("return", None)
    return hints


def _resolvable(target: Any) -> dict[str, Any]:
    hints: dict[str, Any] = {}
    scope = vars(sys.modules[target.__module__])
    for name, hint in inspect.get_annotations(target).items():
        # One name at a time: get_type_hints resolves all annotations of a target or
        # none.
        lone = types.SimpleNamespace(__annotations__={name: hint})
        with contextlib.suppress(NameError):
            hints |= get_type_hints(lone, globalns=scope, include_extras=True)
    return hints


# --- calls by name, while packages move to annotations ------------------------------------------------


def checked_number(
    field: str,
    value: object,
    *,
    allowed: str,
    remedy: str = CHECK_UNIT,
    holds: Callable[[float], bool] = lambda number: True,
) -> float:
    """Return `value` as a finite float that `holds`; `allowed` is the range in words."""
    where = Where(holds, allowed, remedy=remedy)
    number = Between(remedy=remedy)
    try:
        return cast(float, conditional_rule(number_rule(number), where).convert(value))
    except Refused as refused:
        # The words of a condition say more than the range: they name both.
        refused.expected = allowed
        raise refused.error(field, FieldError) from None


def checked_between(
    field: str,
    value: object,
    low: float,
    high: float,
    unit: str = "",
    *,
    open_low: bool = False,
    remedy: str = CHECK_UNIT,
) -> float:
    """Return `value` as a float in [low, high], or in (low, high] with `open_low`."""
    return Between(low, high, unit, low_open=open_low, remedy=remedy).check(
        field, value
    )


def checked_whole(
    field: str, value: object, low: int, high: int, unit: str = ""
) -> int:
    """Return `value` as an int from `low` to `high`, both included."""
    return cast(int, whole_rule(Between(low, high, unit)).check(field, value))


def is_whole(value: object, low: int, high: int) -> bool:
    """Whether `value` is an integer from `low` to `high`, and neither a bool nor a
    float.
    """
    # A bool is an int in Python, and True no count of anything.
    return (
        isinstance(value, int | np.integer)
        and not isinstance(value, bool)
        and bool(low <= value <= high)
    )


def checked_choice(
    field: str,
    value: object,
    choices: Iterable[str],
    *,
    remedy: str = "choose one of these",
) -> str:
    """Return `value` where it is one of the words in `choices`."""
    words = tuple(choices)
    if not isinstance(value, str) or value not in words:
        raise FieldError(field, value, "unknown", allowed=listed(words), remedy=remedy)
    return value


def checked_noun(
    field: str, value: object, kind: type[Instance], *, remedy: str | None = None
) -> Instance:
    """Return `value` where it is a `kind`; `remedy` says where to get one, else the
    class itself does.
    """
    try:
        return cast(Instance, instance_rule(kind).convert(value))
    except Refused as refused:
        refused.remedy = remedy or refused.remedy
        raise refused.error(field, FieldError) from None


def checked_series(
    field: str,
    value: object,
    *,
    remedy: str = "give one column of numbers",
    error: type[FieldError] = FieldError,
) -> NDArray[np.float64]:
    """Return `value` as an array of shape (N,), which may hold NaN."""
    try:
        # A copy: what is fitted must not change while its caller goes on recording into
        # the array.
        return np.array(
            rule(Annotated[NDArray[np.float64], Array(1, finite=False)]).convert(value)
        )
    except Refused as refused:
        refused.remedy = remedy
        raise refused.error(field, error) from None
