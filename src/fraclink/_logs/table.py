"""A table of raw numbers as a file holds it, and the limits beyond which a file is refused.

A rig that runs for an hour at 1 kHz makes 3.6 million samples; four columns of them are about 200 MB of
text. What is larger is not one experiment and is refused before memory is taken.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FileFormatError, LogError, SizeError

FILE_LIMIT = 256_000_000  # bytes
SAMPLE_LIMIT = 4_000_000  # rows
COLUMN_LIMIT = 1_000
LINE_LIMIT = 100_000  # bytes of one line of text
VALUE_LIMIT = 32_000_000  # numbers in all: 256 MB in memory
MEMORY_LIMIT = 1_000_000_000  # bytes of address space of the child that reads binary files
CPU_SECONDS = 10  # of that child, for one file
WALL_SECONDS = 60  # of that child, for one file: the disk may be slow


def check_file(path: Path) -> int:
    """Return the size of the file at `path` [bytes], or raise where there is none or it is too large."""
    if not path.exists():
        raise FileFormatError("log", str(path), "not there", allowed="a log file", remedy="check the path")
    if not path.is_file():
        raise FileFormatError(
            "log", str(path), "not a file", allowed="a log file", remedy="give the file itself"
        )
    size = path.stat().st_size
    if size > FILE_LIMIT:
        raise SizeError(
            "log",
            f"{size / 1e6:.0f} MB",
            "too large",
            allowed=f"{FILE_LIMIT / 1e6:.0f} MB",
            remedy="cut the recording to one experiment, or record at a lower rate",
        )
    if size == 0:
        raise FileFormatError(
            "log", str(path), "empty", allowed="a header and samples", remedy="record again"
        )
    return size


@dataclass(frozen=True)
class CellFaults:
    """What is wrong with the cells of one text column: how many, and the first of each sort.

    `first_missing` and `first_bad` are (line number, text).
    """

    missing: int = 0
    first_missing: tuple[int, str] = (0, "")
    bad: int = 0
    first_bad: tuple[int, str] = (0, "")


@dataclass(frozen=True, eq=False)
class LogTable:
    """Columns of raw numbers in the order of the file; cells that are missing or bad hold NaN.

    Parameters
    ----------
    names
        column names, as the file has them; they may repeat.
    values
        one array for each name, shape (N,); binary files may hold columns of different lengths.
    kind
        file format in words.
    notes
        header entries (key, value).
    faults
        what is wrong with the cells of a column, by its place.
    units
        unit that the file states for a column, by its place; "" for none.
    """

    names: tuple[str, ...]
    values: tuple[NDArray[np.float64], ...]
    kind: str
    notes: tuple[tuple[str, str], ...] = ()
    faults: Mapping[int, CellFaults] = field(default_factory=lambda: MappingProxyType({}))
    units: tuple[str, ...] = ()

    def place(self, name: str, role: str, remedy: str = "correct [log] of the rig file") -> int:
        """The place of the column that is stated for `role`; ``"#2"`` names the second by its number.

        `remedy` says where the name was stated and how to mend it.
        """
        if name.startswith("#") and name[1:].isascii() and name[1:].isdigit() and name not in self.names:
            number = int(name[1:4])
            if 1 <= number <= len(self.names):
                return number - 1
        places = [place for place, known in enumerate(self.names) if known == name]
        if not places:
            raise self._missing(name, role, remedy)
        if len(places) > 1:
            raise LogError(
                f"column of {role}",
                name,
                f"the name of {len(places)} columns",
                allowed="a name that only one column has",
                remedy="rename one in the log, or give its number: "
                + " or ".join(f'"#{place + 1}"' for place in places[:3]),
            )
        return places[0]

    def _missing(self, name: str, role: str, remedy: str) -> LogError:
        known = {known.lower(): known for known in self.names}
        near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
        listed = ", ".join(self.names[:12]) + (", …" if len(self.names) > 12 else "")
        hint = f"did you mean {known[near[0]]!r}?" if near else remedy
        return LogError(f"column of {role}", name, "not in the log", allowed=listed, remedy=hint)
