"""`inspect_log`: what is in a file, before anybody says what it means."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fraclink._logs.readers.formats import read_table
from fraclink._logs.readers.stated import clock_step, suggested_mapping
from fraclink._logs.readers.table import Table

__all__ = ["ChannelSummary", "LogListing", "converter_step", "inspect_log"]

_DISTINCT_LIMIT = 100_000  # samples looked at for the step of the converter


@dataclass(frozen=True)
class ChannelSummary:
    """One column of a file, in the file's own units.

    Arguments:
        name: its name; unit: the unit that the file states, or "".
        samples: its length; missing: cells that hold no finite number.
        minimum, maximum: range of the finite values.
        quantum: smallest step between two of its values, 0 where it looks continuous or is constant.
        period: median step where the values never decrease, as those of a clock; None otherwise.
    """

    name: str
    unit: str
    samples: int
    missing: int
    minimum: float
    maximum: float
    quantum: float
    period: float | None


@dataclass(frozen=True)
class LogListing:
    """The channels of a file, its header's notes, and a mapping to paste into a rig file.

    `print` it for a person; `values` gives the same for a machine.
    """

    path: str
    kind: str
    channels: tuple[ChannelSummary, ...]
    notes: tuple[tuple[str, str], ...]
    suggestion: str

    def values(self) -> dict[str, object]:
        """The listing as plain values; None for the range of a column without numbers."""
        channels = [
            {key: None if value != value else value for key, value in asdict(channel).items()}
            for channel in self.channels
        ]
        return asdict(self) | {"notes": dict(self.notes), "channels": channels}

    def __str__(self) -> str:
        head = f"{self.path}: {self.kind}, {len(self.channels)} channels"
        width = max(7, *(len(_shown(c.name)) for c in self.channels), 7)
        lines = [head, f"{'channel':{width}}  unit   samples  missing       minimum       maximum     step"]
        for c in self.channels:
            clock = f"  every {c.period:.6g}" if c.period is not None else ""
            lines.append(
                f"{_shown(c.name):{width}}  {c.unit or '?':5}  {c.samples:7d}  {c.missing:7d}  "
                f"{c.minimum:12.6g}  {c.maximum:12.6g}  {c.quantum:7.3g}{clock}"
            )
        lines += [f"# {_shown(key)}: {_shown(value)}" for key, value in self.notes]
        return "\n".join([*lines, "", "to paste into the rig file:", self.suggestion])


def _shown(text: str) -> str:
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text[:80])


def inspect_log(path: Path | str) -> LogListing:
    """List the channels of a file: rates and ranges [in the file's own units], a suggested mapping.

    Nothing is interpreted: the suggestion marks with ``?`` what only a person can say.
    Raises FileFormatError, LogError or SizeError where the file cannot be read, MissingExtraError where a
    reader is not installed.

    >>> from fraclink._logs.readers import bundled_log
    >>> listing = inspect_log(bundled_log("prbs_30g"))
    >>> print(listing.suggestion)
    [log] # check every line: column, unit and sign
    time = { column = "time_s", unit = "s" }
    motor_angle = { column = "motor_angle_rad", unit = "rad" }
    torque = { column = "torque_Nm", unit = "Nm" }
    """
    place = Path(path)
    table = read_table(place)
    channels = tuple(_summary(table, number) for number in range(len(table.names)))
    return LogListing(place.name, table.kind, channels, table.notes, suggested_mapping(table))


def _summary(table: Table, number: int) -> ChannelSummary:
    values = table.values[number]
    finite = values[np.isfinite(values)]
    period = clock_step(values)
    return ChannelSummary(
        name=table.names[number],
        unit=table.units[number] if table.units else "",
        samples=values.size,
        missing=values.size - finite.size,
        minimum=float(finite.min()) if finite.size else float("nan"),
        maximum=float(finite.max()) if finite.size else float("nan"),
        quantum=converter_step(finite) if period is None else 0.0,
        period=period,
    )


def converter_step(values: NDArray[np.float64]) -> float:
    """Step of the converter: the smallest gap between distinct values, 0 where they do not repeat.

    Gaps below a thousandth of the median gap are rounding of the numbers' text, not steps.
    """
    distinct = np.unique(values[:_DISTINCT_LIMIT])
    if distinct.size < 2 or distinct.size > 0.5 * min(values.size, _DISTINCT_LIMIT):
        return 0.0
    gaps = np.diff(distinct)
    return float(gaps[gaps > 1e-3 * np.median(gaps)].min())
