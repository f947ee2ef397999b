"""A table: named columns of raw numbers as a file holds them, before anybody says what they mean."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import LogError

__all__ = ["CellFaults", "Table"]


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
class Table:
    """Columns of raw numbers in the order of the file; cells that are missing or bad hold NaN.

    Arguments:
        names: column names, as the file has them; they may repeat.
        values: one array for each name, shape (N,); binary files may hold columns of different lengths.
        kind: file format in words.
        notes: header entries (key, value).
        faults: what is wrong with the cells of a column, by its place.
        units: unit that the file states for a column, by its place; "" for none.
    """

    names: tuple[str, ...]
    values: tuple[NDArray[np.float64], ...]
    kind: str
    notes: tuple[tuple[str, str], ...] = ()
    faults: Mapping[int, CellFaults] = field(default_factory=lambda: MappingProxyType({}))
    units: tuple[str, ...] = ()

    def place(self, name: str, role: str) -> int:
        """The place of the column that is stated for `role`; ``"#2"`` names the second by its number."""
        if name.startswith("#") and name[1:].isascii() and name[1:].isdigit() and name not in self.names:
            number = int(name[1:4])
            if 1 <= number <= len(self.names):
                return number - 1
        places = [place for place, known in enumerate(self.names) if known == name]
        if not places:
            raise self._missing(name, role)
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

    def _missing(self, name: str, role: str) -> LogError:
        known = {known.lower(): known for known in self.names}
        near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
        listed = ", ".join(self.names[:12]) + (", …" if len(self.names) > 12 else "")
        hint = f"did you mean {known[near[0]]!r}?" if near else "correct [log] of the rig file"
        return LogError(f"column of {role}", name, "not in the log", allowed=listed, remedy=hint)
