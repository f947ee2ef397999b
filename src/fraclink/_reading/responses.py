"""Readers of what is no log of an arm: frequency responses, any two channels,
references.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.log_columns import UNITS
from fraclink._arm.recording import FrequencyResponse, Recording
from fraclink._arm.reference import Reference, SampledReference, spline
from fraclink._files import kind_of, load, sha256_of
from fraclink._reading.columns import clean_column, clock_step
from fraclink._reading.faults import normal_bytes
from fraclink._reading.formats import read_table
from fraclink._reading.forms import NUMBER, separator_of, split_cells
from fraclink._reading.names import names_time, stated_unit, unit_of_name, words_of
from fraclink._reading.reading import read_columns
from fraclink._reading.text import LogTable, check_file
from fraclink.errors import FieldError, FileFormatError, LogError
from fracsys.checks import checked

__all__ = ["COLUMNS", "read_frequency_response", "read_recording", "read_reference"]

Reals = NDArray[np.float64]

# What the words of a column's name say it is; the first that fits.
_ROLES = {
    "coherence": ("coherence", "coh", "gamma"),
    "phase": ("phase", "phi", "arg", "angle", "ph"),
    "real": ("real", "re"),
    "imaginary": ("imaginary", "imag", "im"),
    "gain": ("gain", "magnitude", "mag", "amplitude", "abs", "db", "ratio"),
    "frequency": ("frequency", "freq", "omega", "w", "f", "hz", "khz", "ω"),
}
_UNITS = {
    "frequency": {"rad/s": 1.0, "Hz": 2 * math.pi, "kHz": 2000 * math.pi},
    "phase": {unit: UNITS["angle"][unit] for unit in ("rad", "deg", "mrad")},
    "gain": {"1": 1.0, "dB": 1.0},
    "real": {"1": 1.0},
    "imaginary": {"1": 1.0},
    "coherence": {"1": 1.0},
}
_SPELLED_OUT = {
    "frequency": "a column such as frequency_rad_s or frequency_Hz",
    "gain and phase, or real and imag": "columns such as gain_dB and phase_deg, or real and imag",
}
_OMEGA = ("omega", "w", "ω")  # these letters are angular frequencies in every book
_CALLED = 'name it as the header does, or by its number: "#1" is the first'
_JITTER = 0.05  # of a step: a sample that much late is noise of 5 % of the slope
_FEWEST = 3  # rows of a table that lies on its side: frequency, gain, phase


def read_frequency_response(
    path: Path | str, columns: Mapping[str, str] | Sequence[str] | None = None
) -> FrequencyResponse:
    """Read a table of a frequency response: one line a row, or one line a column.

    Parameters
    ----------
    path
        a table in any format of `read_log`. Names of its columns (or rows) say what
        they are, such as ``frequency_Hz``, ``omega``, ``gain``, ``mag [dB]``,
        ``phase_deg``, ``real``, ``imag``, ``coherence``.
    columns
        says it instead: ``{"frequency": "f [Hz]", "gain": "m [dB]", "phase": "p
        [deg]"}``, or the names of a table without a header in their order, such as
        ``("frequency [Hz]", "real", "imag")``.

    Raises
    ------
    LogError
        a column that is needed is not there, its unit is not stated or is none of its
        quantity: rad/s, Hz or kHz; rad, deg or mrad; 1 or dB. A unit is never guessed.
    FileFormatError, SizeError
        the file is damaged, or too large.

    Examples
    --------
    >>> import tempfile
    >>> table = Path(tempfile.mkdtemp(), "frf.csv")
    >>> _ = table.write_text("f [Hz],1,2\\nmag [dB],0,-20\\nphase [deg],0,-90\\n")
    >>> read_frequency_response(table).response.round(3)
    array([1.+0.j , 0.-0.1j])
    """
    place = Path(path)
    found = _columns_of(place, columns)
    frequency = _values(found, "frequency")
    # First, as they need no unit: a table that holds both forms says the same twice.
    if "real" in found and "imaginary" in found:
        response = _values(found, "real") + 1j * _values(found, "imaginary")
    elif "gain" in found and "phase" in found:
        level = _values(found, "gain")
        size = 10 ** (level / 20) if found["gain"][1] == "dB" else level
        response = size * np.exp(1j * _values(found, "phase"))
    else:
        raise _absent(found, "gain and phase, or real and imag")
    coherence = _values(found, "coherence") if "coherence" in found else None
    return FrequencyResponse(
        frequency,
        np.asarray(response, dtype=np.complex128),
        coherence=coherence,
        source=place.name,
        sha256=sha256_of(place),
    )


Found = dict[
    str, tuple[Reals, str, str]
]  # role: values, unit ("" where it is not stated), name


def _values(found: Found, role: str) -> Reals:
    """A column in SI units."""
    if role not in found:
        raise _absent(found, role)
    values, unit, name = found[role]
    if not unit:
        units = " or ".join(_UNITS[role])
        remedy = f'write it behind the name, as in "{name} [{next(iter(_UNITS[role]))}]", or state columns'
        raise LogError(
            f"column of {role}", name, "without its unit", allowed=units, remedy=remedy
        )
    if unit not in _UNITS[role]:
        raise _other_unit(role, name, unit, _UNITS[role])
    return np.asarray(values * _UNITS[role][unit], dtype=np.float64)


def _other_unit(
    role: str, name: str, unit: str, known: Mapping[str, float]
) -> LogError:
    allowed = " or ".join(known) if set(known) != {"1"} else "no unit"
    problem = f"in {unit}, a unit that is not converted"
    remedy = f"convert the column and state its unit, as in [{next(iter(known))}]"
    return LogError(f"column of {role}", name, problem, allowed=allowed, remedy=remedy)


def _absent(found: Found, wanted: str) -> LogError:
    names = (
        ", ".join(f"{role}: {name}" for role, (_, _, name) in found.items()) or "(none)"
    )
    remedy = "rename a column in the table's header, or state columns"
    allowed = _SPELLED_OUT.get(wanted, f"a column of {wanted}")
    return LogError(
        "columns", names, f"without {wanted}", allowed=allowed, remedy=remedy
    )


def _columns_of(path: Path, stated: Mapping[str, str] | Sequence[str] | None) -> Found:
    table = _on_its_side(path) or read_table(path)
    if isinstance(stated, Mapping):
        return {
            _known_role(role): (*_stated(table, role, text), text)
            for role, text in stated.items()
        }
    names, values = list(table.names), [*range(len(table.names))]
    rows: list[Reals] = []
    if stated is not None:
        names = list(stated)
        if len(names) == len(table.names):
            rows = [clean_column(table, k, interpolate=False)[0] for k in values]
        # As many names as rows: the table lies on its side and has no header.
        elif len(names) == table.values[0].size:
            rows = list(
                np.array(
                    [clean_column(table, k, interpolate=False)[0] for k in values]
                ).T
            )
        else:
            shape = f"{table.values[0].size} rows of {len(table.names)} columns"
            remedy = "name every column (or every row) in its order"
            raise LogError(
                "columns",
                shape,
                f"none of which are {len(names)}",
                allowed=shape,
                remedy=remedy,
            )
    else:
        rows = [
            clean_column(table, k, interpolate=False)[0]
            if _role(names[k])
            else np.empty(0)
            for k in values
        ]
    found: Found = {}
    for name, column in zip(names, rows, strict=True):
        role = _role(name)
        if role in found:
            remedy = "rename one, or state columns"
            raise LogError(
                f"column of {role}",
                name,
                "given twice",
                allowed="one column",
                remedy=remedy,
            )
        if role:
            in_file = (
                table.units[names.index(name)] if stated is None and table.units else ""
            )
            found[role] = (column, _unit(name, role, in_file), name)
    return found


def _known_role(role: str) -> str:
    if role not in _ROLES:
        allowed, remedy = ", ".join(_ROLES), "correct the word"
        raise LogError("columns", role, "unknown", allowed=allowed, remedy=remedy)
    return role


def _stated(table: LogTable, role: str, text: str) -> tuple[Reals, str]:
    """The column and the unit of ``"name [unit]"``."""
    match = re.fullmatch(r"(.*?)\s*\[([^\]]*)\]\s*", text)
    name = match[1] if match else text
    exact = text if text in table.names else name
    place = table.place(exact, role, _CALLED)
    in_file = table.units[place] if table.units else ""
    return clean_column(table, place, interpolate=False)[0], _unit(text, role, in_file)


def _role(name: str) -> str:
    """What a name says of a column, or ""."""
    words = [*words_of(name), *(("ω",) if "ω" in name else ())]
    return next(
        (
            role
            for role, known in _ROLES.items()
            if any(word in known for word in words)
        ),
        "",
    )


def _unit(name: str, role: str, in_file: str) -> str:
    """The unit that a name or the file states, that of a name which needs none, or ""."""
    # "freqHz" is split behind the word of the role, and not in front of the capital:
    # "fkHz" is no "fk" in Hz.
    known = "|".join(sorted(_ROLES[role], key=len, reverse=True))
    parted = re.sub(rf"^((?i:{known}))(?=[kmuµn]?[A-Z])", r"\1 ", name.strip())
    unit = stated_unit(parted, _UNITS[role]) or unit_of_name(
        f"[{name}]", _UNITS[role]
    )  # "kHz" alone
    unit = unit or stated_unit(f"[{in_file}]", _UNITS[role])
    if (
        not unit
        and role == "frequency"
        and any(word in _OMEGA for word in [*words_of(name), name.strip()])
    ):
        return "rad/s"
    return unit or ("1" if "1" in _UNITS[role] else "")


def _on_its_side(path: Path) -> LogTable | None:
    """A text table whose first cell of every row is the name of that row; None for all
    others.
    """
    if path.suffix.lower() not in (".csv", ".txt", ".dat", ".tsv"):
        return None
    check_file(path)
    lines = [
        line
        for line in normal_bytes(path.read_bytes(), path).decode().split("\n")
        if line.strip()
    ]
    lines = [line for line in lines if line.lstrip()[0] not in "#%"]
    # As many rows as there are roles at most: a table of ten frequencies has more
    # lines, and stands upright.
    if not _FEWEST <= len(lines) <= len(_ROLES):
        return None
    separator = separator_of(lines[0])
    rows = [split_cells(line, separator) for line in lines]
    named = all(
        len(row) > 1
        and not NUMBER.fullmatch(row[0])
        and all(NUMBER.fullmatch(cell) for cell in row[1:])
        for row in rows
    )
    if not named or len({len(row) for row in rows}) != 1:
        return None
    values = tuple(np.array(row[1:], dtype=np.float64) for row in rows)
    return LogTable(tuple(row[0] for row in rows), values, "text")


# --- two channels of any file -------------------------------------------------------------------------------


def read_recording(
    path: Path | str,
    input: str,
    output: str,
    *,
    time: str | None = None,
    period: float | None = None,
    input_at_rest: float = 0.0,
) -> Recording:
    """Read two channels of a file as an input and an output, in the file's own units.

    Parameters
    ----------
    path
        a table in any format of `read_log`.
    input, output
        names of columns; ``"#2"`` is the second one.
    time
        the column of stamps; by default the one that never decreases and is named so.
        Its unit is the one that its name or the file states: s, ms, us or ns, as in
        ``time_ms`` or ``t [us]``; s without one.
    period
        sampling period [s] instead of stamps.
    input_at_rest
        value of the input before the first sample.

    Raises
    ------
    FieldError
        both time and period.
    LogError, FileFormatError, SizeError
        a column is not there, stamps are missing, not uniform or in another unit, or
        the file is damaged or too large.

    Examples
    --------
    >>> from fraclink._reading.reading import bundled_log
    >>> record = read_recording(bundled_log("prbs_30g"), "motor_angle_rad", "torque_Nm")
    >>> record.period, record.input.size
    (0.004, 5001)
    """
    if period is not None and time is not None:
        remedy = "leave one of them out"
        raise FieldError(
            "period",
            period,
            "given beside a time column",
            allowed="one of both",
            remedy=remedy,
        )
    place = Path(path)
    table = read_table(place)

    def column(name: str, role: str) -> Reals:
        return clean_column(table, table.place(name, role, _CALLED), interpolate=False)[
            0
        ]

    if period is None:
        period = _period(table, time or _stamps(table))
    return Recording(
        period=period,
        input=column(input, "input"),
        output=column(output, "output"),
        input_at_rest=input_at_rest,
        source=place.name,
        sha256=sha256_of(place),
    )


def _second(table: LogTable, place: int) -> float:
    """Unit of a column of stamps [s]: in 10 ms that are taken for 10 s every frequency
    is a thousandth.
    """
    name = table.names[place]
    known = UNITS["time"]
    words = (
        unit_of_name(f"[{word}]", known) for word in words_of(name)
    )  # "millis", "ms_since_start"
    stated = stated_unit(name, known) or next(filter(None, words), "")
    in_file = table.units[place] if table.units else ""
    # The file's own statement before the name's: a TDMS property is set by the program,
    # a name by a person.
    unit = stated_unit(f"[{in_file}]", known) or stated
    if unit and unit not in known:
        raise _other_unit("time", name, unit, known)
    return known[unit or "s"]


def _period(table: LogTable, name: str) -> float:
    """Step of the stamps, of any size: unlike an arm, a furnace may be sampled once in
    a minute.
    """
    place = table.place(name, "time", _CALLED)
    stamps = clean_column(table, place, interpolate=False)[0] * _second(table, place)
    if stamps.size < 2:
        allowed, remedy = ">= 2 rows", "record a motion, or give period"
        raise LogError(
            "time",
            stamps.size,
            "too few rows for a step",
            allowed=allowed,
            remedy=remedy,
        )
    # The mean step, as the rounding of single stamps cancels in it; each step may be
    # off by its share of jitter.
    step = (stamps[-1] - stamps[0]) / (stamps.size - 1)
    worst = float(np.max(np.abs(np.diff(stamps) - step), initial=0.0))
    if not step > 0 or worst > _JITTER * step:
        remedy = "resample both channels onto uniform stamps, or give period"
        evidence = f"steps of {step:.6g} s, off by up to {worst:.3g} s"
        raise LogError(
            "time",
            evidence,
            "not uniform",
            allowed="one step throughout",
            remedy=remedy,
        )
    return float(step)


def _stamps(table: LogTable) -> str:
    clocks = [
        name
        for name, values in zip(table.names, table.values, strict=True)
        if names_time(name) and clock_step(values) is not None
    ]
    if len(clocks) == 1:
        return clocks[0]
    allowed = "one column of stamps [s]"
    remedy = "name it by time, or give period"
    raise LogError(
        "time", ", ".join(table.names[:12]), "not clear", allowed=allowed, remedy=remedy
    )


COLUMNS = ("time_s", "angle_rad", "velocity_rad_per_s", "acceleration_rad_per_s2")
_SHAPED = "shaped-move"
_UNEVEN = 1e-3  # of a period: what decimals of a time leave


@checked
def read_reference(path: Path) -> Reference:
    """Return the reference of a file: a move that `shape` saved, or a table in any
    format of `read_log`.

    A table has the columns ``time_s`` [s] and ``angle_rad`` [rad], from 0 s on. With
    ``velocity_rad_per_s`` [rad/s] and ``acceleration_rad_per_s2`` [rad/s²] beside them,
    in equal steps, as `export_reference` writes it, the law gets the table's own
    numbers. Without them the angles are via points or samples, and the path is the
    cubic spline through them, from rest to rest.

    Raises
    ------
    FileFormatError
        another file, a column that is missing, times that are not in equal steps where
        they have to be.

    Examples
    --------
    >>> import fraclink as fl, tempfile
    >>> place = Path(tempfile.mkdtemp()) / "points.csv"
    >>> _ = place.write_text("time_s,angle_rad\\n0,0\\n0.4,0.7\\n1,0.5\\n")
    >>> path = fl.extend.read_reference(place)
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
        raise FileFormatError(
            missing[0], path.name, "without this column", allowed=allowed, remedy=remedy
        )
    time, *values = (columns[name] for name in COLUMNS if name in columns)
    if len(values) == 1:
        return spline(time, values[0])
    steps = np.diff(time)
    if not steps.size:
        allowed, remedy = ">= 2 rows", "add the rows of the motion"
        raise FileFormatError(
            "reference", path.name, "one row, no path", allowed=allowed, remedy=remedy
        )
    # A law takes the rows one by one: a start elsewhere or another step would play the
    # move late or at another speed.
    if len(values) != 3 or time[0] != 0.0 or np.ptp(steps) > _UNEVEN * steps.mean():
        allowed = "velocity and acceleration both, at 0 s and in equal steps from there"
        remedy = "leave both out: a spline goes through angles at any times"
        raise FileFormatError(
            "reference", path.name, "no whole table", allowed=allowed, remedy=remedy
        )
    # The step from the whole duration: that of one row is rounded to the text's digits.
    return SampledReference(float(time[-1] / len(steps)), np.array(values))
