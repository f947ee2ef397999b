"""A log as fraclink keeps it beside its results: SI units, one NPZ file."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from fraclink.errors import FileFormatError
from fraclink.experiment import Experiment
from fraclink.files import atomic_write

__all__ = ["is_log", "load_log", "save_log"]

_FORMAT = 1
_LIMIT = 400_000_000  # bytes: 2 000 000 samples and more
_PLAIN = ("period", "output_kind", "payload", "source", "sha256", "start_time")


def save_log(log: Experiment, path: Path | str) -> None:
    """Write a log that `load_log` reads back."""
    about: dict[str, Any] = {"fraclink": "log", "format": _FORMAT, "units": "SI, radians"}
    about |= {name: getattr(log, name) for name in _PLAIN} | {"notes": [list(note) for note in log.notes]}
    arrays: dict[str, Any] = {"motor_angle": log.motor_angle, "output": log.output}
    if log.voltage is not None:
        arrays["voltage"] = log.voltage
    with atomic_write(path, "wb") as stream:
        np.savez_compressed(stream, about=np.array(json.dumps(about)), **arrays)


def is_log(path: Path) -> bool:
    """Whether an NPZ file holds a log and not a run."""
    try:
        with zipfile.ZipFile(path) as archive:
            return "output.npy" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def load_log(path: Path | str) -> Experiment:
    """Read a log that `save_log` wrote; FileFormatError for anything else."""
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(item.file_size for item in archive.infolist())
        if size > _LIMIT:
            raise ValueError(f"{size} bytes when unpacked")
        with np.load(path, allow_pickle=False) as data:
            about = json.loads(str(data["about"]))
            if (about.get("fraclink"), about.get("format")) != ("log", _FORMAT):
                raise ValueError("another kind or version")
            voltage = np.array(data["voltage"]) if "voltage" in data else None
            return Experiment(
                motor_angle=np.array(data["motor_angle"]),
                output=np.array(data["output"]),
                voltage=voltage,
                notes=tuple((str(name), str(value)) for name, value in about["notes"]),
                **{name: about[name] for name in _PLAIN},
            )
    except (OSError, KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(
            "log",
            str(path),
            f"not a log of fraclink ({error})",
            allowed="log.npz of `fraclink run`",
            remedy="run it again",
        ) from error
