"""A log as fraclink keeps it beside its results: SI units, one NPZ file."""

from __future__ import annotations

from pathlib import Path

from fraclink._arm.experiment import Experiment
from fraclink._npz import read_npz, write_npz
from fraclink.errors import FileFormatError

__all__ = ["load_log", "save_log"]

_FORMAT = 1
_PLAIN = ("period", "output_kind", "payload", "source", "sha256", "start_time")


def save_log(log: Experiment, path: Path | str) -> None:
    """Write a log that `load_log` reads back."""
    about = {name: getattr(log, name) for name in _PLAIN} | {"notes": [list(note) for note in log.notes]}
    arrays = {"motor_angle": log.motor_angle, "output": log.output}
    if log.voltage is not None:
        arrays["voltage"] = log.voltage
    write_npz(path, "log", _FORMAT, about, arrays, compressed=True)


def load_log(path: Path | str) -> Experiment:
    """Read a log that `save_log` wrote; FileFormatError for anything else."""
    about, arrays = read_npz(path, "log", (_FORMAT,))
    try:
        return Experiment(
            motor_angle=arrays["motor_angle"],
            output=arrays["output"],
            voltage=arrays.get("voltage"),
            notes=tuple((str(name), str(value)) for name, value in about["notes"]),
            **{name: about[name] for name in _PLAIN},
        )
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            "log",
            str(path),
            f"not a log of fraclink ({error})",
            allowed="log.npz of `fraclink run`",
            remedy="run it again",
        ) from error
