"""References from files: a saved move, a table with its derivatives, or points that a spline goes through."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fraclink._arm.reference import Reference, SampledReference, spline
from fraclink._files import kind_of, load
from fraclink._logs.reading import read_columns
from fraclink._validate import checked
from fraclink.errors import FileFormatError

__all__ = ["COLUMNS", "read_reference"]

COLUMNS = ("time_s", "angle_rad", "velocity_rad_per_s", "acceleration_rad_per_s2")
_SHAPED = "shaped-move"
_UNEVEN = 1e-3  # of a period: what decimals of a time leave


@checked
def read_reference(path: Path) -> Reference:
    """Return the reference of a file: a move that `shape` saved, or a table in any format of `read_log`.

    A table has the columns ``time_s`` [s] and ``angle_rad`` [rad], from 0 s on. With ``velocity_rad_per_s``
    [rad/s] and ``acceleration_rad_per_s2`` [rad/s²] beside them, in equal steps, as `export_reference` writes
    it, the law gets the table's own numbers. Without them the angles are via points or samples, and the path
    is the cubic spline through them, from rest to rest.

    Raises
    ------
    FileFormatError
        another file, a column that is missing, times that are not in equal steps where they have to be.

    Examples
    --------
    >>> import fraclink as fl, tempfile
    >>> place = Path(tempfile.mkdtemp()) / "points.csv"
    >>> _ = place.write_text("time_s,angle_rad\\n0,0\\n0.4,0.7\\n1,0.5\\n")
    >>> path = fl.read_reference(place)
    >>> round(float(path.angle(0.4)), 12), path.duration
    (0.7, 1.0)
    """
    if kind_of(path) == _SHAPED:
        reference: Reference = load(path).reference
        return reference
    columns = read_columns(path)
    if missing := [name for name in COLUMNS[:2] if name not in columns]:
        allowed = f"{COLUMNS[0]} and {COLUMNS[1]}, or a move of `fraclink shape`"
        remedy = "name the columns so in the first line"
        raise FileFormatError(missing[0], path.name, "without this column", allowed=allowed, remedy=remedy)
    time, *values = (columns[name] for name in COLUMNS if name in columns)
    if len(values) == 1:
        return spline(time, values[0])
    steps = np.diff(time)
    if not steps.size:
        allowed, remedy = ">= 2 rows", "add the rows of the motion"
        raise FileFormatError("reference", path.name, "one row, no path", allowed=allowed, remedy=remedy)
    if len(values) != 3 or time[0] != 0.0 or np.ptp(steps) > _UNEVEN * steps.mean():
        allowed = "velocity and acceleration both, at 0 s and in equal steps from there"
        remedy = "leave both out: a spline goes through angles at any times"
        raise FileFormatError("reference", path.name, "no whole table", allowed=allowed, remedy=remedy)
    return SampledReference(float(time[-1] / len(steps)), np.array(values))
