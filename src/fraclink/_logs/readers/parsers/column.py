"""A raw column, and how arrays of any shape become columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._logs.readers.limits import COLUMN_LIMIT, VALUE_LIMIT
from fraclink.errors import SizeError

__all__ = ["MATLAB", "NUMPY", "RawColumn", "check_size", "columns_of"]

_WIDEST = 256  # columns of one array: what is wider is a picture or a matrix, not a log


@dataclass(frozen=True, eq=False)
class RawColumn:
    """A column as a parser found it: name, unit ("" where the file states none) and float64 values."""

    name: str
    unit: str
    values: NDArray[np.float64]


MATLAB = ("{name}(:,{one})", "{name}({one},:)")
NUMPY = ("{name}[:,{zero}]", "{name}[{zero},:]")


def columns_of(
    name: str, array: object, unit: str = "", indexing: tuple[str, str] = MATLAB
) -> Iterator[RawColumn]:
    """The columns of a real array of up to two dimensions; along the longer one runs time.

    `indexing` is how a column and how a row of the array is written. Anything else (text, objects, complex
    numbers, scalars) holds no samples and yields nothing.
    """
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiub" or not 1 <= array.ndim <= 2:
        return
    if array.size < 2:
        return
    check_size(array.size)
    table = array.reshape(-1, 1) if array.ndim == 1 else array
    wide = table.shape[0] < table.shape[1]
    table = table.T if wide else table
    if table.shape[1] > _WIDEST:
        return
    for place in range(table.shape[1]):
        label = indexing[wide].format(name=name, one=place + 1, zero=place) if table.shape[1] > 1 else name
        yield RawColumn(label, unit, np.ascontiguousarray(table[:, place], dtype=np.float64))


def check_size(values: int, columns: int = 1) -> None:
    """Raise SizeError where an array is over the limits, before it is made."""
    if values > VALUE_LIMIT or columns > COLUMN_LIMIT:
        raise SizeError(
            "log",
            f"{values} numbers in {columns} columns",
            "too large",
            allowed=f"{VALUE_LIMIT} numbers, {COLUMN_LIMIT} columns",
            remedy="cut the recording to one experiment",
        )
