"""MATLAB files up to v7: numeric arrays, and structures of them such as Simulink's "structure with time".

Names are MATLAB's own: ``log.signals.values(:,2)``.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fraclink._logs.readers.parsers.column import RawColumn, columns_of

__all__ = ["read"]

_DEEPEST = 6  # structures within structures


def read(path: Path) -> tuple[list[RawColumn], dict[str, str]]:
    """Every numeric column of the file, in its order."""
    from scipy.io import loadmat

    with path.open("rb") as stream:
        data = loadmat(stream, struct_as_record=True, squeeze_me=False, mat_dtype=False)
    columns = [
        column
        for name, value in data.items()
        if not name.startswith("__")
        for column in _flat(name, value, _DEEPEST)
    ]
    return columns, {}


def _flat(name: str, value: object, depth: int) -> Iterator[RawColumn]:
    # Cells arrive as object arrays without fields, sparse matrices as no arrays at all; timetables, time
    # series and function handles as arrays with fields of MATLAB's own, in which no sample can be found.
    if not isinstance(value, np.ndarray) or not depth or type(value).__name__.startswith("Matlab"):
        return
    if value.dtype.names is None:
        yield from columns_of(name, value)
        return
    elements = value.reshape(-1)
    for place, element in enumerate(elements[:64]):
        label = name if elements.size == 1 else f"{name}({place + 1})"
        for field in value.dtype.names:
            yield from _flat(f"{label}.{field}", element[field], depth - 1)
