"""Tables of raw numbers from a file, and the size limits beyond which a file is
rejected.

A rig that runs for an hour at 1 kHz makes 3.6 million samples; four columns of them are
about 200 MB of text. A larger file is not one experiment and is rejected before memory
is allocated.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from fraclink._arm.timebase import LOST_SHARE
from fraclink._files.codec import suggestion
from fraclink._reading.names import KNOWN, names_time, roles_of, unit_of_name
from fraclink.errors import FileFormatError, LogError, SizeError
from fraclink.findings import Finding
from fracsys.checks import Real

FILE_LIMIT = 256_000_000  # bytes
SAMPLE_LIMIT = 4_000_000
COLUMN_LIMIT = 1_000
VALUE_LIMIT = FILE_LIMIT // np.dtype(np.float64).itemsize  # numbers in memory
NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?")
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+(?:[eE][+-]?[0-9]{1,3})?")
_FACTOR = r"(?:([0-9.]+(?:[eE][-+]?[0-9]+)?) *\* *)?"
_COMBINED = re.compile(_FACTOR + r"(\S.*?)\s+([-+])\s+" + _FACTOR + r"(\S.*)")


def check_file(path: Path) -> None:
    """Raise FileFormatError where there is no file at `path` or an empty one, SizeError
    where it is too large.
    """
    problem, remedy = "", "give the file itself"
    if not path.exists():
        problem, remedy = "not there", "check the path"
    elif not path.is_file():
        problem = "not a file"
    elif path.stat().st_size == 0:
        problem, remedy = "empty", "record again"
    if problem:
        raise FileFormatError("log", str(path), problem, "a log file", remedy)
    check_bytes(path.stat().st_size)


def check_bytes(size: int) -> None:
    """Raise SizeError if a log has more bytes than one experiment needs."""
    if size > FILE_LIMIT:
        raise too_large(f"{size / 1e6:.0f} MB", f"{FILE_LIMIT / 1e6:.0f} MB")


def check_size(values: int, columns: int = 1) -> None:
    """Raise SizeError if there are too many numbers, before an array is allocated."""
    if values > VALUE_LIMIT or columns > COLUMN_LIMIT:
        raise too_large(
            f"{values} numbers in {columns} columns",
            f"{VALUE_LIMIT} numbers, {COLUMN_LIMIT} columns",
        )


def too_large(size: str, allowed: str, field: str = "log") -> SizeError:
    """The error for a log, or a line of it, beyond a limit."""
    remedy = (
        "cut the recording to one experiment, or record at a lower rate; in a text write "
        "one sample per line"
    )
    return SizeError(field, size, "too large", allowed, remedy)


@dataclass(frozen=True)
class CellFaults:
    """The faults of the cells of one text column.

    Parameters
    ----------
    bad
        how many are neither numbers nor empty.
    first
        line number and text of the first of these, or else of the first missing cell.
    """

    bad: int
    first: tuple[int, str]


@dataclass(frozen=True, eq=False)
class LogTable:
    """Columns of raw numbers in the order of the file; cells that are missing or bad
    hold NaN.

    Parameters
    ----------
    names
        column names, as the file has them; they may repeat.
    values
        one array for each name, shape (N,); binary files may hold columns of different
        lengths.
    units
        unit that the file states for each column; "" for none.
    kind
        file format in words.
    notes
        header entries (key, value).
    faults
        what is wrong with the cells of a column, by its place.
    remarks
        what was done to the file's form to read it, in sentences.
    hints
        names in the file, if they do not match the columns in number; () where `names`
        are the file's own. They suggest roles, but state nothing.
    """

    names: tuple[str, ...]
    values: tuple[Real, ...]
    units: tuple[str, ...]
    kind: str
    notes: tuple[tuple[str, str], ...] = ()
    faults: Mapping[int, CellFaults] = field(
        default_factory=lambda: MappingProxyType({})
    )
    remarks: tuple[str, ...] = ()
    hints: tuple[str, ...] = ()

    def place(
        self, name: str, role: str, remedy: str = "correct [log] of the rig file"
    ) -> int:
        """The place of the column stated for `role`; ``"#2"`` denotes the second
        column.

        `remedy` says where the name was stated and how to correct it.
        """
        numbers = {f"#{place + 1}": place for place in range(len(self.names))}
        places = [place for place, own in enumerate(self.names) if own == name]
        if not places and name in numbers:
            return numbers[name]
        if len(places) == 1:
            return places[0]
        what, problem = f"column of {role}", "not in the log"
        allowed = ", ".join(self.names[:12]) + (", …" if len(self.names) > 12 else "")
        if places:
            problem, allowed = f"the name of {len(places)} columns", "a name of its own"
            remedy = "rename one in the log, or give its number: "
            remedy += " or ".join(f'"#{place + 1}"' for place in places[:3])
        elif name in self.hints:
            problem = "one of names that do not match the columns in number"
            remedy = f'state it by its number, "#{self.hints.index(name) + 1}" if the names begin at the first'
        else:
            remedy = suggestion(name, self.names) or remedy
        raise LogError(what, name, problem, allowed, remedy)

    def name(self, place: int) -> str:
        """The name of a column in the file, if known."""
        return self.hints[place] if place < len(self.hints) else self.names[place]

    def label(self, place: int) -> str:
        """The name of a column for display, or its number if the name is empty or not
        unique.
        """
        name = self.names[place]
        return name if name and self.names.count(name) == 1 else f"#{place + 1}"

    @property
    def roles(self) -> list[tuple[str, str]]:
        """The role of each column according to its name, and the decisive word."""
        return roles_of([*map(self.name, range(len(self.names)))])

    def unit(self, place: int, known: Collection[str] = KNOWN) -> str:
        """The unit of a column stated by the file or else by its name, in the spelling
        of `known`; or "".
        """
        texts = (f"x [{self.units[place]}]", self.name(place))
        units = [unit_of_name(text, known) for text in texts]
        return next(filter(None, units), "")

    def clock(self) -> str:
        """The name of the column of stamps: named as a time, or rising as a clock does;
        or "".
        """
        names = [*map(self.name, range(len(self.names)))]
        # A file may hold several recordings, each with its own clock: take the one with
        # the most signals, and among equals the longest.
        sizes = [values.size for values in self.values if moves(values)]
        most = max(((sizes.count(size), size) for size in sizes), default=(0, 0))[1]
        fitting = [k for k, values in enumerate(self.values) if values.size == most]
        rising = {k: step for k in fitting if (step := clock_step(self.values[k]))}
        # Stamps that jump back or contain non-numbers are still stamps, and the reader
        # reports the fault. A row counter comes last, since it may also be a clock.
        times = [k for k in rising or fitting if names_time(names[k])]
        # An angle that only increases is not a clock: its steps differ.
        roles = self.roles
        steps = {k: np.diff(self.values[k]) for k in rising}
        equal = {k for k in rising if np.allclose(steps[k], rising[k], rtol=0.01)}
        alone = [k for k in rising if k in equal or not roles[k][0]]
        alone.sort(key=lambda k: (roles[k][0] != "", rising[k] == 1))
        place = next(iter([*times, *alone]), None)
        return "" if place is None else self.label(place)

    def with_combined(self, stated: Iterable[str]) -> LogTable:
        """Return the table with a column for each stated sum or difference, such as ``"enc
        - 179 * tip"``.

        An existing column name denotes that column. Cells missing in either part are
        missing in the result.
        """
        table = self
        for name in dict.fromkeys(stated):
            parts = _COMBINED.fullmatch(name)
            if parts is None or name in table.names:
                continue
            places = [table.place(parts[k], name) for k in (2, 5)]
            first, second = (table.values[place] for place in places)
            try:
                factors = [float(parts[k] or 1) for k in (1, 4)]
                sign = 1.0 if parts[3] == "+" else -1.0
                values = factors[0] * first + sign * factors[1] * second
            except ValueError as error:
                raise LogError(
                    "columns",
                    name,
                    "no sum of two columns that were sampled together",
                    "two columns of one length, with factors such as 1.5e-3",
                    "write it as enc - 179 * tip",
                ) from error
            # A fault in either part is a fault of the sum; the first one is reported
            # with its line, which both parts share.
            faults = next((table.faults[k] for k in places if k in table.faults), None)
            table = replace(
                table,
                names=(*table.names, name),
                values=(*table.values, values),
                units=(*table.units, ""),
                hints=(*table.hints, name) if table.hints else (),
                faults={
                    **table.faults,
                    **({len(table.names): faults} if faults else {}),
                },
            )
        return table

    def clean(
        self, place: int, *, interpolate: bool = False
    ) -> tuple[Real, list[Finding]]:
        """A column without missing cells, or an error that names the first missing one."""
        values, name = self.values[place], self.names[place]
        faults = self.faults.get(place)
        missing = np.flatnonzero(~np.isfinite(values))
        if not missing.size:
            return values, []
        share = missing.size / values.size
        where, cell = f"sample {missing[0]}", repr(float(values[missing[0]]))
        problem, allowed = f"missing ({missing.size} of {values.size} cells)", "numbers"
        remedy = "record again"
        if share <= LOST_SHARE:
            remedy += ", or let the reader of a log interpolate them (interpolate=True, --interpolate)"
        if faults is not None:
            line, cell = faults.first
            where = f"line {line}"
            if faults.bad:
                problem = f"not a number ({faults.bad} such cells)"
                allowed, remedy = "numbers such as -1.5e-3", cell_remedy(cell)
        # Never offered beyond one per cent: a straight line across a missing second of
        # vibration is a false torque that least squares would fit.
        bad = faults is not None and faults.bad
        if bad or not interpolate or share > LOST_SHARE:
            field, value = f"{where}, column {name}", cell or "(empty)"
            raise LogError(field, value, problem, allowed, remedy)
        good = np.flatnonzero(np.isfinite(values))
        # Over the row number: whether the samples are uniform is determined later, from
        # the stamps.
        complete = np.interp(np.arange(values.size), good, values[good])
        return complete, [
            Finding(
                "W205",
                "warning",
                f"{missing.size} missing cells of column {name!r} were interpolated",
                {"missing": missing.size, "share": share},
                "check whether they lie where the arm moves",
            )
        ]

    def is_switched(self, place: int) -> bool:
        """Whether a column moves by more than half of its range within one sample, as
        commands do, but nothing with inertia.
        """
        values = self.values[place]
        return bool(np.abs(np.diff(values)).max() > 0.5 * np.ptp(values))

    def repeats(self, place: int, other: int) -> bool:
        """Whether two columns hold the same signal, perhaps in two units; not if their
        names denote different quantities.
        """
        roles = {self.roles[place][0], self.roles[other][0]}
        if len(roles) == 2 and all(roles):
            return False
        pair = self.values[place], self.values[other]
        if pair[0].size != pair[1].size or not all(map(moves, pair)):
            return False
        # Equal up to a rounding to four digits.
        return bool(np.corrcoef(*pair)[0, 1] ** 2 > 1 - 1e-6)

    def bad_cells(self) -> list[str]:
        """A sentence for each column with cells that are not numbers, with the first
        of them.
        """
        return [
            f"{self.names[place]}: {each.bad} of its cells are not numbers, the first in line "
            f"{each.first[0]}, {each.first[1]!r}: {cell_remedy(each.first[1])}"
            for place, each in sorted(self.faults.items())
            if each.bad
        ]


def clock_step(values: Real) -> float | None:
    """Median step of values that never decrease, like those of a clock; None for
    others.
    """
    finite = values[np.isfinite(values)]
    steps = np.diff(finite)
    # Two values always rise or fall; "never decreases" needs at least three. Equal
    # stamps are allowed, since a coarse clock repeats itself.
    if finite.size < 3 or bool((steps < 0).any()):
        return None
    step = float(np.median(steps))
    return step if step > 0 else None


def moves(values: Real) -> bool:
    """Whether a column contains a moving signal."""
    finite = values[np.isfinite(values)]
    # A column with more than a tenth of its cells missing is an event counter or a
    # comment, whatever its name.
    return finite.size > 0.9 * values.size and bool(np.ptp(finite) > 0)


def cell_remedy(cell: str) -> str:
    """The remedy for a cell that is not a number."""
    foreign = any(c.isdigit() and not c.isascii() for c in cell)
    if DECIMAL_COMMA.fullmatch(cell):
        return "it has a decimal comma: export with decimal points"
    if ":" in cell or re.fullmatch("[0-9]{4}-[0-9]{2}-[0-9]{2}", cell):
        return "write the time as seconds, such as those since the start"
    if foreign or "_" in cell:
        return "write the digits 0 to 9, without underscores"
    return "repair the cell, or state another column"
