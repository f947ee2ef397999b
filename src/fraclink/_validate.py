"""Values that come from outside: one check for every kind, one form of its error."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FieldError

__all__ = [
    "checked_between",
    "checked_choice",
    "checked_noun",
    "checked_number",
    "checked_series",
    "checked_whole",
    "is_whole",
]

Noun = TypeVar("Noun")


def checked_number(
    field: str,
    value: object,
    *,
    allowed: str,
    remedy: str = "check the value and its unit",
    holds: Callable[[float], bool] = lambda number: True,
) -> float:
    """Return `value` as a finite float that `holds`.

    `allowed` is the range in words, with its unit in brackets or behind it. Raises FieldError for anything
    else: a text, a bool (True is an int in Python), NaN, and a whole number that no float can hold.

    >>> checked_number("payload", 3e-2, allowed="> 0 kg", holds=lambda mass: mass > 0)
    0.03
    >>> checked_number("payload", 10**400, allowed="> 0 kg")
    Traceback (most recent call last):
    fraclink.errors.FieldError: payload: inf is out of range; allowed > 0 kg; check the value and its unit
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.floating | np.integer):
        raise FieldError(field, value, "not a number", allowed=allowed, remedy=remedy)
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number) or not holds(number):
        raise FieldError(field, number, "out of range", allowed=allowed, remedy=remedy)
    return number


def checked_between(
    field: str,
    value: object,
    low: float,
    high: float,
    unit: str = "",
    *,
    open_low: bool = False,
    remedy: str = "check the value and its unit",
) -> float:
    """Return `value` as a float in [low, high], or in (low, high] with `open_low`; FieldError otherwise.

    >>> checked_between("filter_time", 2, 0.0, 10.0, "s")
    2.0
    >>> checked_between("pole", 0.0, 0.0, 9.0, "rad/s", open_low=True, remedy="raise it")
    Traceback (most recent call last):
    fraclink.errors.FieldError: pole: 0.0 is out of range; allowed > 0 and <= 9 rad/s; raise it
    """
    return checked_number(
        field,
        value,
        allowed=f"{'>' if open_low else '>='} {low:g} and <= {high:g} {unit}".rstrip(),
        remedy=remedy,
        holds=lambda number: (low < number if open_low else low <= number) and number <= high,
    )


def checked_whole(field: str, value: object, low: int, high: int, unit: str = "") -> int:
    """Return `value` as an int from `low` to `high`, both included; FieldError for anything else.

    >>> checked_whole("seed", 7, 0, 10), checked_whole("delay_samples", np.int64(2), 0, 8, "samples")
    (7, 2)
    """
    if not is_whole(value, low, high):
        allowed = f"whole number {low} to {high} {unit}".rstrip()
        raise FieldError(field, value, "not in range", allowed=allowed, remedy="give a whole number")
    return int(value)  # type: ignore[call-overload, no-any-return]


def is_whole(value: object, low: int, high: int) -> bool:
    """Whether `value` is an integer from `low` to `high`, and neither a bool nor a float.

    >>> is_whole(3, 0, 12), is_whole(True, 0, 12), is_whole(2.0, 0, 12), is_whole(13, 0, 12)
    (True, False, False, False)
    """
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and bool(low <= value <= high)


def checked_choice(
    field: str, value: object, choices: Iterable[str], *, remedy: str = "choose one of these"
) -> str:
    """Return `value` where it is one of the words in `choices`; FieldError for anything else.

    >>> checked_choice("hold", "zero", ("zero", "first"))
    'zero'
    >>> checked_choice("hold", ["zero"], ("zero", "first"))
    Traceback (most recent call last):
    fraclink.errors.FieldError: hold: ['zero'] is unknown; allowed zero, first; choose one of these
    """
    words = tuple(choices)
    if not isinstance(value, str) or value not in words:
        raise FieldError(field, value, "unknown", allowed=", ".join(words), remedy=remedy)
    return value


def checked_noun(field: str, value: object, kind: type[Noun], *, remedy: str) -> Noun:
    """Return `value` where it is a `kind`; FieldError, which says where to get one, for anything else.

    >>> checked_noun("log", "log.csv", dict, remedy="read it first")
    Traceback (most recent call last):
    fraclink.errors.FieldError: log: 'log.csv' is no dict; allowed a dict; read it first
    """
    if not isinstance(value, kind):
        name = kind.__name__
        article = "an" if name[0] in "AEIOU" else "a"
        raise FieldError(field, repr(value), f"no {name}", allowed=f"{article} {name}", remedy=remedy)
    return value


def checked_series(
    field: str,
    value: object,
    *,
    remedy: str = "give one column of numbers",
    error: type[FieldError] = FieldError,
) -> NDArray[np.float64]:
    """Return `value` as an array of shape (N,); `error` where it is no single column of real numbers.

    Whether the numbers are finite is for the caller to ask: some columns may have gaps.

    >>> checked_series("torque", [0, 0.1]).tolist()
    [0.0, 0.1]
    >>> checked_series("torque", "0, 0.1", remedy="read the file")
    Traceback (most recent call last):
    fraclink.errors.FieldError: torque: str is no column of numbers; allowed shape (N,); read the file
    """
    allowed = "shape (N,)"
    try:
        array = np.asarray(value)
        numbers = array.astype(np.float64) if array.dtype.kind in "iuf" else None
    except (TypeError, ValueError, OverflowError):  # rows of different lengths; objects that are no numbers
        numbers = None
    if numbers is None:
        raise error(field, type(value).__name__, "no column of numbers", allowed=allowed, remedy=remedy)
    if numbers.ndim != 1:
        raise error(field, numbers.shape, "not one column", allowed=allowed, remedy=remedy)
    return numbers
