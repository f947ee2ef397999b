"""`read_log`: the one door from a file to an `Experiment`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FieldError, LogError
from fraclink.experiment import Experiment
from fraclink.files import sha256_of
from fraclink.rig import LogColumns, Rig

_LOGS = Path(__file__).resolve().parent.parent / "logs"


def bundled_logs() -> tuple[str, ...]:
    """The names of the logs that come with the package; every one is simulated and says so."""
    return tuple(sorted(path.stem for path in _LOGS.glob("*.csv")))


def bundled_log(name: str) -> Path:
    """The path of a log that comes with the package."""
    if name not in bundled_logs():
        raise FieldError(
            "log", name, "unknown", allowed=", ".join(bundled_logs()), remedy="give one of these, or a path"
        )
    return _LOGS / f"{name}.csv"


def read_columns(path: Path | str) -> dict[str, NDArray[np.float64]]:
    """Read a table of numbers as it stands: column name to values."""
    lines = Path(path).read_text().splitlines()
    start = next(i for i, line in enumerate(lines) if line.strip() and not line.startswith("#"))
    names = [name.strip() for name in lines[start].split(",")]
    data = np.loadtxt(lines[start + 1 :], delimiter=",", ndmin=2)
    return {name: np.ascontiguousarray(data[:, i]) for i, name in enumerate(names)}


def read_log(
    path: Path | str,
    *,
    rig: Rig | None = None,
    columns: LogColumns | None = None,
    payload: float | None = None,
) -> Experiment:
    """Read a log whose columns and units are stated by `columns` or by the rig."""
    stated = columns or (rig.log if rig else None)
    if stated is None:
        raise LogError(
            "columns", "(nothing)", "not stated", allowed="[log]", remedy="state the columns in the rig file"
        )
    table = read_columns(path)
    notes = []
    for line in Path(path).read_text().splitlines():
        if not line.startswith("#"):
            break
        key, _, value = line[1:].partition(":")
        notes.append((key.strip(), value.strip()))
    if payload is None and "payload_kg" in dict(notes):
        payload = float(dict(notes)["payload_kg"])
    channels = stated.channels()
    for channel in channels.values():
        if channel.column not in table:
            raise LogError(
                channel.column, "(nothing)", "missing", allowed=", ".join(table), remedy="correct [log]"
            )
    data = {role: channel.in_si(table[channel.column], role) for role, channel in channels.items()}
    time = data["time"]
    return Experiment(
        period=float(round((time[-1] - time[0]) / (time.size - 1), 12)),
        motor_angle=data["motor_angle"],
        output=data[stated.output_kind],
        output_kind=stated.output_kind,
        payload=payload,
        source=Path(path).name,
        sha256=sha256_of(Path(path)),
        start_time=float(time[0]),
        voltage=data.get("voltage"),
        notes=tuple(notes),
    )
