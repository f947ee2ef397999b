"""HDF5: any file of numeric datasets, and MATLAB's v7.3, which is HDF5 with transposed arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fraclink._logs.readers.parsers.column import MATLAB, NUMPY, RawColumn, check_size, columns_of
from fraclink.errors import MissingExtraError

__all__ = ["read"]


def read(path: Path) -> tuple[list[RawColumn], dict[str, str]]:
    """Every numeric dataset of one or two dimensions; attributes ``units`` or ``unit`` give the unit."""
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("h5py", "io") from error

    columns: list[RawColumn] = []
    with path.open("rb") as stream, h5py.File(stream, "r") as file:
        own = [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]
        matlab = any("MATLAB_class" in file[name].attrs for name in own)

        def visit(name: str, item: Any) -> None:
            # Links are not followed, and data kept in other files are not read: a log is one file.
            if isinstance(item, h5py.Dataset) and not name.startswith("#") and _is_plain(item):
                label = name.replace("/", ".") if matlab else name
                # MATLAB's files hold every array transposed: what is a row here was a column there.
                indexing = (MATLAB[1], MATLAB[0]) if matlab else NUMPY
                check_size(item.size, len(columns))
                columns.extend(columns_of(label, np.asarray(item[()]), _unit(item), indexing))

        file.visititems(visit)
    return columns, {}


def _is_plain(item: Any) -> bool:
    kind = _text(item.attrs.get("MATLAB_class", b"double"))
    return (
        item.dtype.kind in "fiub"
        and 1 <= len(item.shape or ()) <= 2
        and kind not in ("char", "cell", "function_handle")
        and not item.is_virtual
        and item.external is None
    )


def _unit(item: Any) -> str:
    return _text(item.attrs.get("units", item.attrs.get("unit", "")))[:20]


def _text(value: object) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
