"""Numbers that come from outside: one check for every noun, one form of its error."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from fraclink.errors import FieldError

__all__ = ["checked_between", "checked_number", "checked_whole", "is_whole"]


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
