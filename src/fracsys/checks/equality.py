"""Equality of results that hold arrays: `a == b` is a single bool, not an array."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

Kind = TypeVar("Kind", bound=type)


def compared(kind: Kind) -> Kind:
    """Make instances of a frozen dataclass equal if all their fields are, with arrays
    compared element by element.

    A field that is not compared (``field(compare=False)``) is left out; two NaN are
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
    # Not isinstance: a subclass may have fields unknown here, and `a == b` could differ
    # from `b == a`.
    if type(other) is not type(self):
        return NotImplemented
    kind: Any = type(self)
    fields = (field.name for field in dataclasses.fields(kind) if field.compare)
    return all(_same(getattr(self, name), getattr(other, name)) for name in fields)


def _hash(self: Any) -> int:
    """Hash of the fields that are words, integers or bools: equal results have equal
    hashes.
    """
    values = (
        getattr(self, field.name) for field in dataclasses.fields(self) if field.compare
    )
    # Floats are left out: NaN equals NaN here, but since Python 3.10 two NaN have
    # different hashes.
    return hash(
        (type(self), *(value for value in values if type(value) in (str, int, bool)))
    )


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        a, b = np.asarray(one), np.asarray(other)
        # NaN equals NaN: a gap in a log is still the same gap after the log was saved
        # and read.
        return a.dtype == b.dtype and np.array_equal(
            a, b, equal_nan=a.dtype.kind in "fc"
        )
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(
            _same(value, other[key]) for key, value in one.items()
        )
    # Entry by entry, because `==` raises for tuples that hold arrays.
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    # Since Python 3.13 the generated `==` no longer treats a NaN in a field as equal to
    # itself.
    plain = getattr(type(one), "__dataclass_params__", None)
    if plain is not None and plain.eq and type(one) is type(other):
        return bool(_equal(one, other))
    return bool(one == other) or (one != one and other != other)
