"""The child process that parses one binary file and writes its columns to an archive.

It is started as ``python -m fraclink._reading.worker KIND FILE ANSWER``, may use 1 GB
of address space and 10 s of processor time, and is expected to crash: a single changed
byte is enough for some parsers.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fraclink._files.containers import UNPACKED_LIMIT, write_archive
from fraclink._reading.table import COLUMN_LIMIT, check_size
from fraclink.errors import SizeError
from fracsys.checks import Real

# Windows has no such limits; the parent's time limit remains
if sys.platform != "win32":
    import resource

# Bytes of address space: a table at its limit takes a quarter, its file as much again,
# and the parser the rest.
MEMORY_LIMIT = 1_000_000_000
CPU_SECONDS = 10  # for one file


@dataclass(frozen=True, eq=False)
class RawColumn:
    """A column as returned by a parser: name, unit ("" where the file states none) and
    float64 values.
    """

    name: str
    unit: str
    values: Real


MATLAB = ("{name}(:,{one})", "{name}({one},:)")
NUMPY = ("{name}[:,{zero}]", "{name}[{zero},:]")


def columns_of(
    name: str, array: object, unit: str = "", indexing: tuple[str, str] = MATLAB
) -> Iterator[RawColumn]:
    """The columns of a real array of up to two dimensions; time runs along the longer
    one.

    `indexing` is the notation of a column and of a row of the array. Anything else
    (text, objects, complex numbers, scalars) contains no samples and yields nothing.
    """
    if (
        not isinstance(array, np.ndarray)
        or array.dtype.kind not in "fiub"
        or not 1 <= array.ndim <= 2
        or array.size < 2
    ):
        return
    check_size(array.size)
    table = array.reshape(-1, 1) if array.ndim == 1 else array
    # A log has more samples than channels: time runs along the longer axis, whichever
    # program wrote it.
    wide = table.shape[0] < table.shape[1]
    table = table.T if wide else table
    # a picture or a matrix, not a log
    if table.shape[1] > COLUMN_LIMIT:
        return
    for place in range(table.shape[1]):
        label = (
            indexing[wide].format(name=name, one=place + 1, zero=place)
            if table.shape[1] > 1
            else name
        )
        yield RawColumn(label, unit, np.ascontiguousarray(table[:, place], np.float64))


# --- HDF5, and MATLAB v7.3, which is HDF5 with transposed arrays -----------------------------------------


def read_hdf5(path: Path) -> list[RawColumn]:
    """Every numeric dataset of one or two dimensions; attributes ``units`` or ``unit``
    give the unit.
    """
    import h5py

    columns: list[RawColumn] = []
    with path.open("rb") as stream, h5py.File(stream, "r") as file:
        # Hard links only: a soft or external link leads out of this file, or in a
        # circle within it.
        own = [
            name
            for name in file
            if isinstance(file.get(name, getlink=True), h5py.HardLink)
        ]
        matlab = any("MATLAB_class" in file[name].attrs for name in own)

        def visit(name: str, item: Any) -> None:
            # Links are not followed, and data stored in other files are not read: a log
            # is one file.
            if (
                isinstance(item, h5py.Dataset)
                and not name.startswith("#")
                and _is_plain(item)
            ):
                label = name.replace("/", ".") if matlab else name
                # MATLAB's files hold every array transposed: rows here were columns
                # there.
                indexing = (MATLAB[1], MATLAB[0]) if matlab else NUMPY
                check_size(item.size, len(columns))
                unit = _text(item.attrs.get("units", item.attrs.get("unit", "")))[:20]
                columns.extend(columns_of(label, np.asarray(item[()]), unit, indexing))

        file.visititems(visit)
    return columns


def _is_plain(item: Any) -> bool:
    kind = _text(item.attrs.get("MATLAB_class", b"double"))
    return (
        item.dtype.kind in "fiub"
        and 1 <= len(item.shape or ()) <= 2
        and kind not in ("char", "cell", "function_handle")
        and not item.is_virtual
        and item.external is None
    )


def _text(value: object) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def read_mat5(path: Path) -> list[RawColumn]:
    """Every numeric column of the file, in its order."""
    from scipy.io import loadmat

    with path.open("rb") as stream:
        data = loadmat(stream, struct_as_record=True, squeeze_me=False, mat_dtype=False)
    return [
        column
        for name, value in data.items()
        if not name.startswith("__")
        for column in _flat(name, value)
    ]


def _flat(name: str, value: object) -> Iterator[RawColumn]:
    # Cells arrive as object arrays without fields, sparse matrices not as arrays at
    # all; timetables, time series and function handles arrive as arrays with internal
    # fields of MATLAB, which hold no samples.
    if not isinstance(value, np.ndarray) or type(value).__name__.startswith("Matlab"):
        return
    if value.dtype.names is None:
        yield from columns_of(name, value)
        return
    elements = value.reshape(-1)
    # An array of structures is a list of recordings.
    for place, element in enumerate(elements):
        label = name if elements.size == 1 else f"{name}({place + 1})"
        for field in value.dtype.names:
            yield from _flat(f"{label}.{field}", element[field])


# --- TDMS of LabVIEW -------------------------------------------------------------------------------------


def read_tdms(path: Path) -> list[RawColumn]:
    """Every numeric channel as ``group/channel``; ``group/channel.time`` holds its time
    stamps [s].
    """
    from nptdms import TdmsFile

    columns: list[RawColumn] = []
    # With a stream, the reader does not look for an index file next to the log, which
    # could belong to another one.
    with path.open("rb") as stream, TdmsFile.open(stream) as file:
        for group in file.groups():
            for channel in group.channels():
                check_size(len(channel), len(columns))
                columns.extend(_channel(f"{group.name}/{channel.name}", channel))
    return columns


def _channel(name: str, channel: Any) -> list[RawColumn]:
    unit = str(channel.properties.get("unit_string", ""))[:20]
    columns = list(columns_of(name, np.asarray(channel[:]), unit))
    step = channel.properties.get("wf_increment")
    if columns and isinstance(step, float) and np.isfinite(step) and step > 0:
        start = channel.properties.get("wf_start_offset", 0.0)
        stamps = np.asarray(
            float(start) + step * np.arange(columns[0].values.size), np.float64
        )
        columns.append(RawColumn(f"{name}.time", "s", stamps))
    return columns


PARSERS: dict[str, Callable[[Path], list[RawColumn]]] = {
    "MAT v5": read_mat5,
    "HDF5": read_hdf5,
    "TDMS": read_tdms,
}


# --- the child --------------------------------------------------------------------------------------------


def _limit() -> None:
    if sys.platform != "win32":
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        # The parent reads what the child writes: no more than an archive may hold.
        resource.setrlimit(resource.RLIMIT_FSIZE, (UNPACKED_LIMIT, UNPACKED_LIMIT))
        # Counted from the start of the child, whose imports take up to two seconds.
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS + 2, CPU_SECONDS + 4))


def answer(kind: str, path: Path) -> tuple[dict[str, Any], list[RawColumn]]:
    """The description of a file and its columns: names and units, or the reason why
    there are none.
    """
    try:
        columns = PARSERS[kind](path)
        check_size(sum(column.values.size for column in columns), len(columns))
    except ImportError as error:
        return {"missing": str(error)}, []
    except SizeError as error:
        return {"large": [error.value, error.allowed]}, []
    except MemoryError:
        return {"damaged": "it asks for more memory than a log needs"}, []
    except Exception as error:  # noqa: BLE001
        return {"damaged": f"{type(error).__name__}: {error}"[:200]}, []
    return {"columns": [[each.name[:200], each.unit] for each in columns]}, columns


def main() -> None:
    """Parse the file that the command line names."""
    _limit()
    kind, path, place = sys.argv[1:]
    about, columns = answer(kind, Path(path))
    arrays = {f"c{k}": np.asarray(c.values, "<f8") for k, c in enumerate(columns)}
    with Path(place).open("wb") as stream:
        write_archive(stream, json.dumps(about), arrays)


if __name__ == "__main__":
    main()
