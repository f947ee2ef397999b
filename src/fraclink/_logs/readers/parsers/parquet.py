"""Parquet: numeric columns, and time stamps in seconds after the first one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fraclink._logs.readers.parsers.column import RawColumn, check_size
from fraclink.errors import MissingExtraError

__all__ = ["read"]


def read(path: Path) -> tuple[list[RawColumn], dict[str, str]]:
    """Every numeric column; a column's metadata ``unit`` gives its unit."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise MissingExtraError("pyarrow", "io") from error

    pa.set_cpu_count(1)
    with path.open("rb") as stream:
        file = parquet.ParquetFile(stream)
        check_size(file.metadata.num_rows * file.metadata.num_columns, file.metadata.num_columns)
        table = file.read(use_threads=False)
    columns = []
    for field in table.schema:
        values = _values(table.column(field.name) if _single(table, field.name) else None, field.type)
        if values is not None:
            unit = (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace")[:20]
            columns.append(RawColumn(field.name, "s" if pa.types.is_timestamp(field.type) else unit, values))
    return columns, {}


def _single(table: Any, name: str) -> bool:
    return int(table.schema.get_field_index(name)) >= 0  # -1 where two columns share the name


def _values(column: Any, kind: Any) -> Any:
    import pyarrow as pa

    if column is None:
        return None
    if pa.types.is_timestamp(kind):
        stamps = column.cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy()
        # Nanoseconds since 1970 do not fit a float64; since the first stamp they do.
        return (stamps - stamps[0]) * 1e-9 if column.null_count == 0 and len(stamps) else None
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
        return np.asarray(column.cast(pa.float64(), safe=False).to_numpy(), dtype=np.float64)
    return None
