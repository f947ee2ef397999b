"""What every stated column must be before it becomes part of an experiment: complete, and a signal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fraclink._logs.readers.cells import NUMBER, cell_remedy
from fraclink._logs.readers.table import Table
from fraclink._rules import rule
from fraclink._validate import Payload
from fraclink.errors import LogError
from fraclink.findings import Finding

__all__ = ["check_signals", "clean_column", "stated_payload"]

_INTERPOLATED = 0.01  # largest share of missing cells that may be interpolated


def clean_column(table: Table, place: int, *, interpolate: bool) -> tuple[NDArray[np.float64], list[Finding]]:
    """One column without missing cells, or an error that names the first one."""
    values, name = table.values[place], table.names[place]
    faults = table.faults.get(place)
    if faults is not None and faults.bad:
        line, cell = faults.first_bad
        raise LogError(
            f"line {line}, column {name}",
            cell,
            f"not a number ({faults.bad} such cells)",
            allowed="numbers such as -1.5e-3",
            remedy=cell_remedy(cell),
        )
    missing = np.flatnonzero(~np.isfinite(values))
    if not missing.size:
        return values, []
    share = missing.size / values.size
    line, cell = (
        faults.first_missing if faults is not None else (int(missing[0]), repr(float(values[missing[0]])))
    )
    where = f"line {line}" if faults is not None else f"sample {line}"
    if not interpolate or share > _INTERPOLATED:
        few = share <= _INTERPOLATED
        raise LogError(
            f"{where}, column {name}",
            cell or "(empty)",
            f"missing ({missing.size} of {values.size} cells)",
            allowed="finite numbers",
            remedy="record again, or read with interpolate=True (--interpolate)" if few else "record again",
        )
    good = np.flatnonzero(np.isfinite(values))
    filled = np.interp(np.arange(values.size), good, values[good])
    return filled, [
        Finding(
            "W201",
            "warning",
            f"{missing.size} missing cells of column {name!r} were interpolated",
            {"missing": missing.size, "share": share},
            "look whether they lie where the arm moves",
        )
    ]


def check_signals(angle: NDArray[np.float64], output: NDArray[np.float64], kind: str) -> None:
    """Raise LogError where the motor angle or the output is the same in all samples."""
    for role, values, remedy in (
        ("motor_angle", angle, "excite the arm: a pulse, a PRBS or a square wave; or state another column"),
        (kind, output, "check the gauge and its amplifier, or state another column"),
    ):
        if np.ptp(values) == 0:
            value = float(values[0])
            raise LogError(
                role,
                f"{value:.6g} in all {values.size} samples (standard deviation 0)",
                "constant",
                allowed="a signal that moves",
                remedy=remedy,
            )


def stated_payload(table: Table, stated: float | None) -> tuple[float | None, list[Finding]]:
    """The payload of a log, from the call or from its own header."""
    mass_range = rule(Payload)
    labels = {value for key, value in table.notes if key == "payload_kg"}
    if len(labels) > 1:
        raise LogError(
            "payload_kg",
            ", ".join(sorted(labels)),
            "given more than once",
            allowed="one label",
            remedy="remove one",
        )
    header = None
    for label in labels:
        if not NUMBER.fullmatch(label):
            raise LogError(
                "payload_kg", label, "not a number", allowed="> 0 [kg]", remedy="write # payload_kg: 0.030"
            )
        header = mass_range.check("payload_kg", float(label))
    if stated is None:
        return header, []
    mass = mass_range.check("payload", stated)
    if header is None or abs(mass - header) <= 1e-9 * mass:
        return mass, []
    return mass, [
        Finding(
            "W216",
            "warning",
            f"payload {mass:g} kg was stated, the log's header says {header:g} kg",
            {"stated": mass, "header": header},
            "fraclink uses the stated one; correct the other",
        )
    ]
