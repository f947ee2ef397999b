"""Readers of files other than logs of an arm: frequency responses, any two channels,
references.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fraclink._arm.log_columns import UNITS
from fraclink._arm.recording import FrequencyResponse, Recording
from fraclink._arm.reference import Reference, SampledReference, spline
from fraclink._arm.timebase import PRINTED, time_base
from fraclink._files import kind_of, load, sha256_of
from fraclink._reading.formats import read_table
from fraclink._reading.names import names_time, stated_unit, unit_of_name, words_of
from fraclink._reading.reading import read_columns
from fraclink._reading.table import LogTable
from fraclink.errors import FieldError, FileFormatError, LogError
from fracsys.checks import Real, checked, checked_choice

# Words in the name of a column, by quantity; the first match applies.
_ROLES = {
    "coherence": ("coherence", "coh", "gamma"),
    "phase": ("phase", "phi", "arg", "angle", "ph"),
    "real": ("real", "re"),
    "imaginary": ("imaginary", "imag", "im"),
    "gain": ("gain", "magnitude", "mag", "amplitude", "abs", "db", "ratio"),
    "frequency": ("frequency", "freq", "omega", "w", "f", "hz", "khz", "ω"),
}
_UNITS = {
    "frequency": UNITS["frequency"],
    "phase": {unit: UNITS["angle"][unit] for unit in ("rad", "deg", "mrad")},
    "gain": UNITS["gain"],
    **dict.fromkeys(("real", "imaginary", "coherence"), UNITS["ratio"]),
    "time": UNITS["time"],
}
_OMEGA = ("omega", "w", "ω")  # the usual symbols of angular frequency
_CALLED = 'name it as the header does, or by its number: "#1" is the first'


def read_frequency_response(
    path: Path | str, columns: Mapping[str, str] | None = None
) -> FrequencyResponse:
    """Read a table of a frequency response, one frequency per row.

    Parameters
    ----------
    path
        a table in any format of `read_log`. Names of its columns say what they are, such
        as ``frequency_Hz``, ``omega``, ``gain``, ``mag [dB]``,
        ``phase_deg``, ``real``, ``imag``, ``coherence``.
    columns
        states the columns instead: ``{"frequency": "f [Hz]", "gain": "m [dB]", "phase":
        "p [deg]"}``; ``"#1 [Hz]"`` is the first column, in Hz.

    Raises
    ------
    LogError
        a needed column is not there, or its unit is not stated or is not one of rad/s,
        Hz, kHz; rad, deg, mrad; 1, dB. A unit is never guessed.
    FileFormatError, SizeError
        the file is damaged, or too large.

    Examples
    --------
    >>> import tempfile
    >>> table = Path(tempfile.mkdtemp(), "frf.csv")
    >>> _ = table.write_text("f [Hz],mag [dB],phase [deg]\\n1,0,0\\n2,-20,-90\\n")
    >>> read_frequency_response(table).response.round(3)
    array([1.+0.j , 0.-0.1j])
    """
    place = Path(path)
    roles = _columns_of(read_table(place), columns)
    frequency = _in_si(roles, "frequency")
    # Real and imaginary part first, since they need no unit; a table with both forms
    # holds the same data twice.
    if "real" in roles and "imaginary" in roles:
        response = _in_si(roles, "real") + 1j * _in_si(roles, "imaginary")
    elif "gain" in roles and "phase" in roles:
        level = _in_si(roles, "gain")
        size = 10 ** (level / 20) if roles["gain"][1] == "dB" else level
        response = size * np.exp(1j * _in_si(roles, "phase"))
    else:
        needed = "columns such as gain_dB and phase_deg, or real and imag"
        raise _absent(roles, "gain and phase, or real and imag", needed)
    coherence = _in_si(roles, "coherence") if "coherence" in roles else None
    return FrequencyResponse(
        frequency,
        np.asarray(response, np.complex128),
        coherence=coherence,
        source=place.name,
        sha256=sha256_of(place),
    )


# By role: values, unit ("" if not stated), name.
Given = dict[str, tuple[Real, str, str]]


def _in_si(columns: Given, role: str) -> Real:
    if role not in columns:
        raise _absent(
            columns, role, f"a column such as {role}_{next(iter(_UNITS[role]))}"
        )
    values, unit, name = columns[role]
    factors = _UNITS[role]
    if unit not in factors:
        raise LogError(
            f"column of {role}",
            name,
            f"in {unit}, a unit that is not converted" if unit else "without its unit",
            "no unit" if set(factors) == {"1"} else " or ".join(factors),
            f'convert the column and state its unit, as in "{name} [{next(iter(factors))}]"',
        )
    return np.asarray(values * factors[unit], np.float64)


def _absent(columns: Given, wanted: str, allowed: str) -> LogError:
    names = ", ".join(f"{role}: {name}" for role, (_, _, name) in columns.items())
    remedy = "rename a column in the table's header, or state columns"
    return LogError("columns", names or "(none)", f"without {wanted}", allowed, remedy)


def _columns_of(table: LogTable, stated: Mapping[str, str] | None) -> Given:
    """The columns of a table by their roles."""
    for role in stated or ():
        checked_choice("columns", role, _ROLES)
    names = [table.name(place) for place in range(len(table.names))]
    given = [(_role(name), name, place) for place, name in enumerate(names)]
    if stated is not None:
        given = []
        for role, name in stated.items():
            bare = re.sub(r"\s*\[[^\]]*\]\s*$", "", name)
            exact = name if name in table.names else bare
            given.append((role, name, table.place(exact, role, _CALLED)))
    by_role: Given = {}
    for role, name, place in given:
        if role in by_role:
            raise LogError(
                f"column of {role}",
                name,
                "given twice",
                "one column",
                "rename one, or state columns",
            )
        if role:
            unit = _unit(name, role, table.units[place])
            by_role[role] = table.clean(place)[0], unit, name
    return by_role


def _role(name: str) -> str:
    """The role that the name of a column suggests, or ""."""
    words = {*words_of(name), *("ω" if "ω" in name else ())}
    return next((role for role, names in _ROLES.items() if words & set(names)), "")


def _unit(name: str, role: str, in_file: str) -> str:
    """The unit that the file or a name states or that the name implies, or ""."""
    factors, words = _UNITS[role], words_of(name)
    # "freqHz" is split after the word of its role and not at the capital, so that
    # "fkHz" is f in kHz and not "fk" in Hz.
    synonyms = "|".join(sorted(_ROLES.get(role, ()), key=len, reverse=True))
    parted = re.sub(rf"^((?i:{synonyms}))(?=[kmuµn]?[A-Z])", r"\1 ", name.strip())
    # A unit in the file takes precedence over one in the name: a program sets a TDMS
    # property, a person a name. "kHz", "millis" and "ms_since_start" state a unit too.
    units = [stated_unit(text, factors) for text in (f"[{in_file}]", parted)]
    units += [unit_of_name(f"[{text}]", factors) for text in (name, *words)]
    if role == "frequency" and {*words, name.strip()} & set(_OMEGA):
        units.append("rad/s")
    return next(filter(None, units), "1" if "1" in factors else "")


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
        the column of time stamps; by default the one that never decreases and is named
        as a time. Its unit is the one that its name or the file states: s, ms, us or
        ns, as in ``time_ms`` or ``t [us]``; s without one.
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
        raise FieldError(
            "period",
            period,
            "given beside a time column",
            "one of the two",
            "leave one of them out",
        )
    place = Path(path)
    table = read_table(place)
    channels = [
        table.clean(table.place(name, role, _CALLED))[0]
        for role, name in {"input": input, "output": output}.items()
    ]
    return Recording(
        period=_period(table, time) if period is None else period,
        input=channels[0],
        output=channels[1],
        input_at_rest=input_at_rest,
        source=place.name,
        sha256=sha256_of(place),
    )


def _period(table: LogTable, time: str | None) -> float:
    """Step of the stamps [s], of any size: unlike an arm, a furnace may be sampled once
    a minute.
    """
    name = time or table.clock()
    if not time and not names_time(name):
        raise LogError(
            "time",
            ", ".join(table.names[:12]),
            "not clear",
            "one column of stamps [s]",
            "name it by time, or give period",
        )
    table = table.with_combined([name])
    place = table.place(name, "time", _CALLED)
    stamps, name = table.clean(place)[0], table.names[place]
    unit = _unit(name, "time", table.units[place]) or "s"
    seconds = _in_si({"time": (stamps, unit, name)}, "time")
    return time_base(seconds, slowest=math.inf).period


COLUMNS = ("time_s", "angle_rad", "velocity_rad_per_s", "acceleration_rad_per_s2")


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
        another kind of file, a missing column, or times of a table with velocity and
        acceleration that are not in equal steps from 0 s on.

    Examples
    --------
    >>> import fraclink as fl, tempfile
    >>> place = Path(tempfile.mkdtemp()) / "points.csv"
    >>> _ = place.write_text("time_s,angle_rad\\n0,0\\n0.4,0.7\\n1,0.5\\n")
    >>> path = fl.extend.read_reference(place)
    >>> round(float(path.angle(0.4)), 12), path.duration
    (0.7, 1.0)
    """
    if kind_of(path) == "shaped-move":
        reference: Reference = load(path).reference
        return reference
    columns = read_columns(path)
    if missing := [name for name in COLUMNS[:2] if name not in columns]:
        raise FileFormatError(
            missing[0],
            path.name,
            "without this column",
            f"{COLUMNS[0]} and {COLUMNS[1]}, or a move of `fraclink shape`",
            "name the columns so in the first line",
        )
    time, *values = (columns[name] for name in COLUMNS if name in columns)
    if len(values) == 1:
        return spline(time, values[0])
    steps = np.diff(time)
    if not steps.size:
        raise FileFormatError(
            "reference",
            path.name,
            "one row, no path",
            ">= 2 rows",
            "add the rows of the motion",
        )
    # A law takes the rows one by one: with another start or another step it would play
    # the move late or at another speed.
    if len(values) != 3 or time[0] != 0.0 or np.ptp(steps) > PRINTED * steps.mean():
        raise FileFormatError(
            "reference",
            path.name,
            "not a complete table",
            "velocity and acceleration, both from 0 s on and in equal steps",
            "leave both out: a spline goes through angles at any times",
        )
    # The step from the whole duration, since that of one row is rounded to the digits
    # of the text.
    return SampledReference(float(time[-1] / len(steps)), np.array(values))
