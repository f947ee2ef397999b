"""`read_log`, the only way from a file to an `Experiment`, and `inspect_log`, which
lists the content of a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._arm.log_columns import (
    ROW_NUMBER,
    UNITS_OF,
    Channel,
    LogColumns,
    parse_columns,
)
from fraclink._arm.rig import Rig
from fraclink._arm.timebase import resampled, time_base, uniform_before
from fraclink._display import Overview, Row, Table, displayed, rows_of
from fraclink._files import kind_of, load, sha256_of
from fraclink._identify.fitting import check_motion
from fraclink._reading.columns import (
    check_count,
    columns_of_names,
    converter_step,
    stated_payload,
)
from fraclink._reading.formats import read_table
from fraclink._reading.table import LogTable, check_size, clock_step
from fraclink.errors import LogError
from fraclink.findings import Finding
from fracsys.checks import Mask, Payload, Real, checked_choice
from fracsys.errors import printable

_LOGS = Path(__file__).resolve().parent.parent / "data" / "logs"


def bundled_logs() -> tuple[str, ...]:
    """The names of the logs that come with the package; each is simulated and marked as
    such.

    >>> "prbs_30g" in bundled_logs()
    True
    """
    return tuple(sorted(path.stem for path in _LOGS.glob("*.csv")))


def bundled_log(name: str) -> Path:
    """The path of a log that comes with the package; FieldError lists the known ones.

    >>> bundled_log("prbs_30g").name
    'prbs_30g.csv'
    """
    remedy = "give one of these, or a path"
    return _LOGS / f"{checked_choice('log', name, bundled_logs(), remedy=remedy)}.csv"


def read_columns(path: Path | str) -> dict[str, Real]:
    """Read a table of numbers as it stands: column name to values, shape (N,), in the
    file's own units.

    For tables that are not logs, such as a frequency response. Every format of `read_log`
    is read. Raises FileFormatError, LogError (a cell is not a number, a name occurs twice)
    or SizeError.

    >>> sorted(read_columns(bundled_log("prbs_30g")))[:2]
    ['motor_angle_rad', 'time_s']
    """
    table = read_table(Path(path))
    return {
        name: table.clean(table.place(name, "the table"))[0] for name in table.names
    }


def read_log(
    path: Path | str,
    *,
    rig: Rig | None = None,
    columns: LogColumns | Mapping[str, str] | None = None,
    payload: Payload | None = None,
    keep: tuple[float, float] | None = None,
    resample: bool = False,
    interpolate: bool = False,
) -> Experiment:
    """Read a recorded log: CSV and other text, MAT, HDF5 or TDMS.

    Which column is what, in which unit and with which sign, is stated and never
    guessed: by `columns`, by the rig's `[log]` table, or by names in the log that are a
    role and a unit (``time_s``, ``motor_angle_rad``, ``torque_Nm`` or
    ``deflection_rad``, ``voltage_V``).

    A log that `fraclink.save` wrote, such as the log.npz of a folder of results, is read
    as it was saved, and states its columns itself.

    The experiment is in SI units: motor angle [rad], torque [N·m] or deflection [rad],
    voltage [V].

    Parameters
    ----------
    path
        the log.
    rig
        whose `[log]` table states the columns.
    columns
        states them instead; a mapping of texts such as ``{"time": "t [s]", "torque": "-
        gauge * 0.1 [Nm]"}`` does, too.
    payload
        payload of the log [kg]; by default the log's own ``# payload_kg:`` line, if it has one.
    keep
        the stretch to read, (from, until) [s] from the first sample, 0 <= from < until;
        what lies outside need not be uniform. The motor angle before it is kept as far
        back as it is uniform (`Experiment.earlier_angle`): the vibration of a link that
        moves at the cut depends on it.
    resample
        interpolate onto a uniform grid where the stamps have gaps, repeats or strong
        jitter.
    interpolate
        fill missing cells linearly, at most 1 % of a column.

    Raises
    ------
    LogError, FileFormatError, SizeError
        the log cannot be used, is damaged, or too large; ValueError is their base.
    MissingExtraError
        the format needs a package that is not installed.

    >>> log = read_log(bundled_log("prbs_30g"))
    >>> log.period, log.payload, log.output_kind, log.simulated
    (0.004, 0.03, 'torque', True)
    >>> read_log(bundled_log("prbs_30g"), keep=(0.0, 8.0)).duration
    8.0
    """
    place = Path(path)
    if place.suffix == ".npz" and kind_of(place):
        return _saved(place, payload, keep)
    if columns is not None and not isinstance(columns, LogColumns):
        columns = parse_columns(f"{role}={text}" for role, text in columns.items())
    table = read_table(place)
    # The call takes precedence over the rig, and the rig over the names.
    channels = columns or (rig.log if rig else None) or columns_of_names(table.names)
    if channels is None:
        raise LogError(
            "columns",
            ", ".join(table.names[:12]),
            "not stated: which column is what, in which unit, is never guessed",
            "a [log] table in the rig file, or names such as time_s, motor_angle_rad, torque_Nm",
            "`fraclink start` finds them and writes that table; or give --column for each, such as "
            '"time=t [s]", "motor_angle=theta [deg]" and "torque=gamma [Nm]"',
        )
    # Units and signs are converted here; from now on all data are in SI, radians, and
    # positive where the motor accelerates.
    data, findings = _channels(table, channels, interpolate)
    stamps = data.pop("time")
    recorded, whole_angle, first = stamps, data["motor_angle"], 0
    if keep is not None:
        inside, cut = _kept(stamps, *keep)
        findings.append(cut)
        stamps = stamps[inside]
        data = {role: values[inside] for role, values in data.items()}
        first = int(np.argmax(inside))  # first of the samples that are kept
    base = time_base(stamps, resample=resample)
    # Uniform stamps need no interpolation, which would change the last bits.
    if resample and base.findings:
        # With a single stamp of another day, a grid over the gap would take more memory
        # than the log.
        check_size(int(float(np.ptp(stamps)) / base.period))
        data = {role: resampled(stamps, base, values) for role, values in data.items()}
    output = data[channels.output_kind]
    # A motor that moves by a billionth is left to `diagnose`.
    check_motion(motor_angle=data["motor_angle"], **{channels.output_kind: output})
    mass, payload_findings = stated_payload(table, payload)
    earlier = whole_angle[uniform_before(recorded, first, base.period)]
    return Experiment(
        period=base.period,
        motor_angle=data["motor_angle"],
        output=output,
        output_kind=channels.output_kind,
        payload=mass,
        source=place.name,
        sha256=sha256_of(place) if place.is_file() else "",
        findings=(*findings, *base.findings, *payload_findings),
        start_time=base.start,
        voltage=data.get("voltage"),
        notes=table.notes,
        earlier_angle=earlier if earlier.size else None,
    )


def _saved(
    place: Path, payload: float | None, keep: tuple[float, float] | None
) -> Experiment:
    """The log that `fraclink.save` wrote, or the stretch to keep of it."""
    log = load(place, Experiment)
    log = replace(log, payload=log.payload if payload is None else payload)
    if keep is None:
        return log
    inside, cut = _kept(log.time, *keep)
    first = int(np.argmax(inside))
    return replace(
        log,
        motor_angle=log.motor_angle[inside],
        output=log.output[inside],
        voltage=None if log.voltage is None else log.voltage[inside],
        findings=(*log.findings, cut),
        start_time=float(log.time[first]),
        earlier_angle=log.whole_angle[: log.whole_angle.size - log.time.size + first],
    )


def _kept(stamps: Real, begin: float, end: float) -> tuple[Mask, Finding]:
    """Mask of the samples from `begin` to `end` [s] after the first, and the finding
    that reports the selection (W237).
    """
    since = stamps - stamps[0]
    # Stamps are sums of periods, each of them rounded, and may miss the intended end.
    rounding = since.size * float(np.spacing(np.abs(stamps).max()))
    inside = (since >= begin - rounding) & (since <= end + rounding)
    if not (0.0 <= begin < end) or inside.sum() < 2:
        raise LogError(
            "keep",
            f"{begin:g} to {end:g} s",
            "no stretch of the log",
            f"0 <= from < until, within {float(since.max()):.6g} s, with two samples or more",
            "give the stretch in seconds from the first sample",
        )
    first, last = float(since[inside][0]), float(since[inside][-1])
    return inside, Finding(
        "W237",
        "info",
        f"of {float(since.max()):.4g} s, the stretch from {first:.4g} to {last:.4g} s was read",
        {"from_s": first, "until_s": last},
        "the rest is neither checked nor fitted; a fit starts its link from the motor angle before the cut, "
        "as far back as the stamps are uniform (of very long logs the last 200 000 samples)",
    )


def _channels(
    table: LogTable, columns: LogColumns, interpolate: bool
) -> tuple[dict[str, Real], list[Finding]]:
    """Every stated channel in SI units, and the findings."""
    data: dict[str, Real] = {}
    findings: list[Finding] = []
    channels = columns.channels()
    table = table.with_combined([channel.column for channel in channels.values()])
    for role, channel in channels.items():
        # Optional: a rig file states the voltage for all its logs, and some have none.
        # Without it the friction is unknown, but not the link.
        if role == "voltage" and channel.column not in table.names:
            continue
        if channel.column == ROW_NUMBER and ROW_NUMBER not in table.names:
            angle = table.place(columns.motor_angle.column, "motor_angle")
            raw = np.arange(table.values[angle].size, dtype=np.float64)
        else:
            place = table.place(channel.column, role)
            raw, repairs = table.clean(place, interpolate=interpolate)
            findings += [*repairs, *_contradicted(table, place, role, channel)]
        data[role] = channel.in_si(raw, role)
        if data[role].size != data["time"].size:
            raise LogError(
                f"column of {role}",
                channel.column,
                f"{raw.size} samples long, while time has {data['time'].size}",
                "columns of one length",
                "state the time column that belongs to it, or export the channels at one rate",
            )
    check_count(data["time"].size)
    return data, findings


def _contradicted(
    table: LogTable, place: int, role: str, channel: Channel
) -> list[Finding]:
    """The unit in the header of the log for a column, if it contradicts the stated one."""
    # Compared by value, not by spelling: Nm and N*m agree.
    factors = UNITS_OF[role]
    own = table.unit(place, tuple(factors)) or channel.unit
    # An explicit scale states the conversion, and names that do not match the columns
    # state nothing.
    if factors[own] == factors[channel.unit] or channel.scale != 1 or table.hints:
        return []
    return [
        Finding(
            "W220",
            "error",
            f"column {table.names[place]!r} is in {own} by the log's own header, in {channel.unit} by [log]",
            {"header_unit": factors[own], "stated_unit": factors[channel.unit]},
            "correct the unit in [log] of the rig file, or the header",
        )
    ]


# --- inspection: before units and roles are known ---------------------------------------------------------


@dataclass(frozen=True)
class ChannelSummary:
    """One column of a file, in the file's own units.

    Parameters
    ----------
    name, unit
        its name, and the unit that the file states, or "".
    samples, missing
        its length, and how many cells hold no finite number.
    minimum, maximum
        range of the finite values.
    quantum
        smallest step between two of its values, 0 where it looks continuous or is
        constant.
    period
        median step where the values never decrease, as those of a clock; None
        otherwise.
    """

    name: str
    unit: str
    samples: int
    missing: int
    minimum: float
    maximum: float
    quantum: float
    period: float | None

    @property
    def rows(self) -> tuple[Row, ...]:
        """The channel as shown to people and programs."""
        return rows_of(
            self,
            Row("name", "channel", _shown(self.name)),
            ("unit", "unit"),
            ("samples", "samples", "", 8),
            ("missing", "missing", "", 8),
            ("minimum", "minimum"),
            ("maximum", "maximum"),
            ("quantum", "step", "", 3),
            ("period", "every"),
        )


@displayed
@dataclass(frozen=True)
class LogListing:
    """The channels of a file, and the notes of its header.

    `remarks` lists in sentences how the form of the file was changed to read it.
    """

    path: str
    kind: str
    channels: tuple[ChannelSummary, ...]
    notes: tuple[tuple[str, str], ...]
    remarks: tuple[str, ...] = ()

    def overview(self) -> Overview:
        """Every channel with its range, and the header's notes."""
        rows = rows_of(
            self, "path", "kind", Row("notes", "", dict(self.notes)), "remarks"
        )
        lines = [f"read as: {remark}" for remark in self.remarks]
        lines += [f"# {_shown(key)}: {_shown(value)}" for key, value in self.notes]
        return Overview(
            f"{self.path}: {self.kind}, {len(self.channels)} channels",
            rows=rows,
            tables=(Table.of("channels", self.channels),),
            notes=tuple(lines),
        )


def _shown(text: str) -> str:
    # A name from a file may contain terminal escape sequences.
    return printable(text[:80])


def inspect_log(path: Path | str) -> LogListing:
    """List the channels of a file: rates and ranges, in the file's own units.

    Nothing is interpreted; `start` says what each column may be. Raises
    FileFormatError, LogError or SizeError where the file cannot be read,
    MissingExtraError where a reader is not installed.

    >>> from fraclink._reading.reading import bundled_log
    >>> listing = inspect_log(bundled_log("prbs_30g"))
    >>> [channel.name for channel in listing.channels]
    ['time_s', 'motor_angle_rad', 'torque_Nm']
    """
    place = Path(path)
    table = read_table(place)
    channels = tuple(_summary(table, number) for number in range(len(table.names)))
    remarks = (*table.remarks, *table.bad_cells())
    return LogListing(place.name, table.kind, channels, table.notes, remarks)


def _summary(table: LogTable, number: int) -> ChannelSummary:
    values = table.values[number]
    finite = values[np.isfinite(values)]
    period = clock_step(values)
    return ChannelSummary(
        name=table.names[number],
        unit=table.units[number],
        samples=values.size,
        missing=values.size - finite.size,
        minimum=float(finite.min()) if finite.size else float("nan"),
        maximum=float(finite.max()) if finite.size else float("nan"),
        # The step of a clock is its period, which must not be reported as the step of a
        # converter.
        quantum=converter_step(finite) if period is None else 0.0,
        period=period,
    )
