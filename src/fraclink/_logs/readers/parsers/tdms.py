"""TDMS of LabVIEW: channels with their units, and the time of those that carry a sampling step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fraclink._logs.readers.parsers.column import RawColumn, check_size, columns_of
from fraclink.errors import MissingExtraError

__all__ = ["read"]


def read(path: Path) -> tuple[list[RawColumn], dict[str, str]]:
    """Every numeric channel as ``group/channel``; ``group/channel.time`` is its own stamps [s]."""
    try:
        from nptdms import TdmsFile
    except ImportError as error:
        raise MissingExtraError("npTDMS", "io") from error

    columns: list[RawColumn] = []
    # From a stream the reader looks for no index file beside the log, which could belong to another one.
    with path.open("rb") as stream, TdmsFile.open(stream) as file:
        for group in file.groups():
            for channel in group.channels():
                check_size(len(channel), len(columns))
                columns.extend(_channel(f"{group.name}/{channel.name}", channel))
    return columns, {}


def _channel(name: str, channel: Any) -> list[RawColumn]:
    unit = str(channel.properties.get("unit_string", ""))[:20]
    found = list(columns_of(name, np.asarray(channel[:]), unit))
    step = channel.properties.get("wf_increment")
    if found and isinstance(step, float) and np.isfinite(step) and step > 0:
        start = channel.properties.get("wf_start_offset", 0.0)
        stamps = np.asarray(float(start) + step * np.arange(found[0].values.size), dtype=np.float64)
        found.append(RawColumn(f"{name}.time", "s", stamps))
    return found
