"""Results that hold arrays, compared: `a == b` is one answer and not an array of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

__all__ = ["compared"]

Kind = TypeVar("Kind", bound=type)


def compared(kind: Kind) -> Kind:
    """Let instances of a frozen dataclass be equal where all their fields are, arrays
    element by element.

    A field that is not compared (``field(compare=False)``) is left out, two NaN are
    equal.

    >>> @compared
    ... @dataclasses.dataclass(frozen=True, eq=False)
    ... class Pair:
    ...     samples: Any
    >>> Pair(np.arange(3.0)) == Pair(np.arange(3.0)), Pair(np.arange(3.0)) == Pair(np.arange(4.0))
    (True, False)
    """
    kind.__eq__ = _equal  # type: ignore[assignment]
    kind.__hash__ = _hash  # type: ignore[assignment]
    return kind


def _equal(self: Any, other: object) -> Any:
    # Not isinstance: a subclass has fields of which this class knows nothing, and the
    # answer would depend on who asks.
    if type(other) is not type(self):
        return NotImplemented
    kind: Any = type(self)
    fields = (field.name for field in dataclasses.fields(kind) if field.compare)
    return all(_same(getattr(self, name), getattr(other, name)) for name in fields)


def _hash(self: Any) -> int:
    """Of what is neither array nor container: equal results have equal ones."""
    values = (
        getattr(self, field.name) for field in dataclasses.fields(self) if field.compare
    )
    # Floats are left out: two NaN are equal here and have, since Python 3.10, different
    # hashes.
    return hash(
        (type(self), *(value for value in values if type(value) in (str, int, bool)))
    )


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        a, b = np.asarray(one), np.asarray(other)
        # NaN equals NaN: a gap in a log is the same gap in the log that was saved and
        # read.
        return a.dtype == b.dtype and np.array_equal(
            a, b, equal_nan=a.dtype.kind in "fc"
        )
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(
            _same(value, other[key]) for key, value in one.items()
        )
    # Entry by entry: `==` of tuples that hold arrays raises.
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    # Its own `==` finds a NaN in it equal to itself up to Python 3.12 only.
    plain = getattr(type(one), "__dataclass_params__", None)
    if plain is not None and plain.eq and type(one) is type(other):
        return bool(_equal(one, other))
    return bool(one == other) or (one != one and other != other)
