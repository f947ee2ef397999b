"""Validation of inputs: a range is written once, in the annotation, and checked where
the value enters.

    @checked
    def design(model: LinkModel, *, gain_crossover: Frequency): ...

    @checked
    @dataclass(frozen=True)
    class Sensor:
        period: Period
        noise: Annotated[float, Between(0.0, 1e6, "N·m")] = 0.0

`checked` reads the annotations at the first call, rejects invalid values with a
FieldError, and passes on plain values: float and int (never a bool or a numpy scalar),
tuples, paths, float64 arrays. The same rules write and read files and name the options
of the command line (`parameters`).
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Iterable
from dataclasses import is_dataclass
from types import MappingProxyType
from typing import Annotated, Any, TypeVar, cast, overload

import numpy as np
from numpy.typing import NDArray

from fracsys.checks import rules
from fracsys.checks.ranges import ARGUMENTS, Refused
from fracsys.checks.ranges import Array as Array
from fracsys.checks.ranges import Between as Between
from fracsys.checks.ranges import Where as Where
from fracsys.checks.ranges import above as above
from fracsys.checks.ranges import ascending as ascending
from fracsys.checks.ranges import length as length
from fracsys.checks.ranges import whole_number as whole_number
from fracsys.checks.rules import Parameter as Parameter
from fracsys.checks.rules import parameters as parameters
from fracsys.checks.rules import rule as rule
from fracsys.errors import FieldError

Target = TypeVar("Target", bound=Callable[..., Any])
Instance = TypeVar("Instance")

# --- arrays of any shape -------------------------------------------------------------------------------

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]

# --- ranges that recur --------------------------------------------------------------------------------

Positive = Annotated[float, above(0.0)]
Period = Annotated[
    float,
    above(0.0, 10.0, "s", remedy="give the sampling period in seconds"),
]
Time = Annotated[float, Between(0.0, 1e6, "s", remedy="give seconds")]
Duration = Annotated[float, above(0.0, 1e6, "s", remedy="give seconds")]
Payload = Annotated[
    float,
    above(0.0, 1e4, "kg", remedy="give the mass at the tip in kg"),
]
Frequency = Annotated[float, above(0.0, 1e6, "rad/s")]
# The unit depends on λ, because ω₀² is added to s^λ.
NaturalFrequency = Annotated[float, above(0.0, 1e6, "s^(-λ/2)")]
Angle = Annotated[
    float, Between(-1e6, 1e6, "rad", remedy="give radians; deg(50) converts degrees")
]
PhaseMargin = Annotated[
    float,
    above(
        0.0,
        math.pi,
        "rad",
        high_open=True,
        remedy="give radians; deg(50) converts degrees",
    ),
]
PhaseMarginDeg = Annotated[
    float, above(0.0, 179.0, "°", remedy="50° is a usual margin")
]
# the range of NumPy's generators
Seed = Annotated[int, Between(0, 2**64 - 1)]


# --- the decorator ------------------------------------------------------------------------------------


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
    the class's own ``__post_init__`` then sees normalised fields, arrays and mappings
    as read-only copies, and checks only what involves several of them. A dataclass that
    inherits from a checked one needs its own `@checked`, because `dataclass` generates
    a new ``__init__`` for it.

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
        return functools.partial(checked, error=error, prefix=prefix)
    if not isinstance(target, type):
        return _guarded(target, target, error, prefix)
    if not is_dataclass(target):
        remedy = "put checked above dataclass"
        raise TypeError(f"checked: {target.__name__} is not a dataclass; {remedy}")
    # Replaces the `__init__` of the class itself instead of deriving a class:
    # `replace`, `fields` and pickling see the dataclass as written.
    target.__init__ = _guarded(target.__init__, target, error, prefix)  # type: ignore[method-assign]
    return target


def _guarded(
    function: Callable[..., Any],
    target: Any,
    error: type[FieldError],
    prefix: str,
) -> Callable[..., Any]:
    is_class = isinstance(target, type)

    @functools.cache
    def annotated() -> tuple[list[str], dict[str, Any], str, str]:
        """The names by position, the checks by name, and the names of *args and
        **kwargs. Read at the first call, when every name of the module exists.
        """
        ways = inspect.signature(function).parameters.values()
        by_position = [each.name for each in ways if each.kind in _BY_POSITION]
        rest, others = (
            next((each.name for each in ways if each.kind is way), "") for way in _REST
        )
        checks = {name: each.rule.convert for name, each in parameters(target).items()}
        return by_position, checks, rest, others

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        by_position, checks, rest, others = annotated()
        name, values = "", list(args)
        try:
            for place, value in enumerate(args):
                name = by_position[place] if place < len(by_position) else rest
                if name in checks:
                    values[place] = checks[name](value, ARGUMENTS)
            for name, value in kwargs.items():
                check = checks.get(name) or checks.get(others)
                if check is not None:
                    kwargs[name] = check(value, ARGUMENTS)
        except Refused as refused:
            # Without the inner frames: the mistake is at the call, and the internals of
            # the check do not help to find it.
            raise refused.error(prefix + name, error) from None
        if is_class:  # the arrays and mappings that an object keeps are read-only
            values = [values[0], *map(_read_only, values[1:])]
            kwargs = {name: _read_only(value) for name, value in kwargs.items()}
        return function(*values, **kwargs)

    return call


_BY_POSITION = (
    inspect.Parameter.POSITIONAL_ONLY,
    inspect.Parameter.POSITIONAL_OR_KEYWORD,
)
_REST = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def _read_only(value: Any) -> Any:
    """A read-only array itself, a read-only copy of any other, and a read-only view of
    a mapping.
    """
    if isinstance(value, dict):  # already copied by the check
        return MappingProxyType(value)
    if not isinstance(value, np.ndarray):
        return value
    # A read-only view is not enough: the owner of its base can still write to it.
    if value.flags.writeable or value.base is not None or not value.flags.c_contiguous:
        value = np.array(value, order="C")
        value.flags.writeable = False
    return value


# --- values without an annotation of their own --------------------------------------------------------


def checked_choice(
    field: str,
    value: object,
    choices: Iterable[str],
    *,
    remedy: str = "choose one of these",
) -> str:
    """Return `value` if it is one of the words in `choices`."""
    return str(rules.choice(tuple(choices)).check(field, value, remedy=remedy))


def checked_noun(
    field: str, value: object, kind: type[Instance], *, remedy: str = ""
) -> Instance:
    """Return `value` if it is a `kind`; `remedy` says where to get one, by default the
    class itself.
    """
    return cast(Instance, rules.instance(kind).check(field, value, remedy=remedy))
