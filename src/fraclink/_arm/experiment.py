"""An experiment: one recorded motion in SI units and radians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from fraclink._arm.log_columns import (
    Channel,
    LogColumns,
    OutputKind,
    parse_columns,
)
from fraclink._arm.timebase import time_base
from fraclink._display import Overview, Row, displayed, rows_of, source_name
from fraclink._files import document, write_text
from fraclink.errors import LogError
from fraclink.findings import Finding, Findings
from fracsys.checks import Array, Payload, Positive, Real, above, checked
from fracsys.checks.equality import compared

__all__ = ["Experiment"]


@displayed
@document(
    "log",
    version=2,
    container="npz",
)
@checked(error=LogError)
@compared
@dataclass(frozen=True, eq=False)
class Experiment:
    """One recorded motion of a flexible arm: the input of every identification.

    Parameters
    ----------
    period
        sampling period Ts [s], > 0.
    motor_angle
        θm, shape (N,) [rad].
    output
        shape (N,): base torque Γ [N·m], or deflection θm − θt [rad]. Both are positive
        where the tip lags behind a motor that turns forward: Γ = c(θm − θt), eq. (3).
    output_kind
        ``"torque"`` or ``"deflection"``.
    payload
        m [kg], > 0, or None where it was not stated.
    source
        file name or a sentence on where it comes from.
    sha256
        hash of the file, or "".
    findings
        what the reader noticed (codes W2xx).
    start_time
        time stamp of the first sample [s].
    voltage
        at the amplifier's input, shape (N,) [V], or None.
    notes
        header entries of the log, such as (("simulated", "true"),).
    earlier_angle
        θm at the samples just before the first, shape (H,) [rad], of a log that was
        cut; None for one that begins with the recording. The vibration of a link that
        was moving at the cut depends on these samples.

    Arrays are stored as read-only copies.

    Raises
    ------
    LogError
        arrays of different lengths, fewer than two samples, a value that is not finite
        or out of its range.

    References
    ----------
    Benftima et al. (2023), section 3.1.

    Examples
    --------
    >>> log = Experiment(period=0.004, motor_angle=[0, 0.1, 0.2], output=[0, 0.01, 0.03])
    >>> log.time.tolist(), log.output_kind
    ([0.0, 0.004, 0.008], 'torque')
    """

    __made_by__ = "read_log(path)"

    period: Positive
    motor_angle: Annotated[Real, Array(1, min_size=2)]
    output: Annotated[Real, Array(1)]
    output_kind: OutputKind = "torque"
    payload: Payload | None = None
    source: str = ""
    sha256: str = ""
    findings: tuple[Finding, ...] = ()
    start_time: float = 0.0
    voltage: Annotated[Real, Array(1)] | None = None
    notes: tuple[tuple[str, str], ...] = ()
    earlier_angle: Annotated[Real, Array(1)] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "findings", Findings(self.findings))
        count = self.motor_angle.size
        for name, values in (("output", self.output), ("voltage", self.voltage)):
            if values is not None and values.size != count:
                raise LogError(
                    name,
                    values.size,
                    f"not as long as motor_angle ({count} samples)",
                    f"{count} samples",
                    "cut the channels to their common span of time",
                )

    @classmethod
    def from_frame(
        cls,
        frame: Any,
        columns: LogColumns | Mapping[str, str],
        *,
        payload: float | None = None,
        source: str = "",
    ) -> Experiment:
        """Return the experiment in a data frame: pandas, polars, a table of pyarrow, a
        dict of arrays.

        `columns` states which column is what, in which unit and with which sign: the
        rig's ``[log]`` table, or a text for each. Steps between time stamps must be
        below 1 s; raises LogError for gaps, repeats or strong jitter in them,
        FieldError for an unknown unit, LogError for a column that is not there.

        >>> frame = {"t": [0.0, 0.01, 0.02], "pot": [0.0, 5.0, 9.0], "gauge": [0.0, 0.1, 0.3]}
        >>> stated = {"time": "t [s]", "motor_angle": "pot [deg]", "torque": "- gauge [Nm]"}
        >>> Experiment.from_frame(frame, stated).output.tolist()
        [-0.0, -0.1, -0.3]
        """
        if not isinstance(columns, LogColumns):
            columns = parse_columns(f"{role}={text}" for role, text in columns.items())
        # Converted to SI before the time base is formed, because its limits are in
        # seconds (such as one second between samples).
        data = {
            role: channel.in_si(_column(frame, channel), role)
            for role, channel in columns.channels().items()
        }
        base, samples = time_base(data["time"]), data["motor_angle"].size
        if data["time"].size != samples:
            raise LogError(
                "time",
                f"{data['time'].size} stamps",
                f"not one for each of {samples} samples",
                "arrays of one length",
                "cut them to the samples that belong together",
            )
        return cls(
            period=base.period,
            motor_angle=data["motor_angle"],
            output=data[columns.output_kind],
            output_kind=columns.output_kind,
            payload=payload,
            source=source,
            findings=base.findings,
            start_time=base.start,
            voltage=data.get("voltage"),
        )

    @property
    def time(self) -> Real:
        """Time of the samples, shape (N,) [s]."""
        return self.start_time + self.period * np.arange(
            self.motor_angle.size, dtype=np.float64
        )

    def save(self, path: Path | str) -> None:
        """Write the log as CSV with its notes, in SI units, so that `read_log` gives
        the same numbers back.

        Findings are not written: reading and `diagnose` find them again. Nor is
        `earlier_angle`, for which a table of samples has no place; `fraclink.save` keeps
        both.

        >>> log = Experiment(period=0.004, motor_angle=[0, 0.1], output=[0, 0.01], payload=0.03)
        >>> print(log.text())
        # payload_kg: 0.03
        time_s,motor_angle_rad,torque_Nm
        0.0,0.0,0.0
        0.004,0.1,0.01
        """
        write_text(path, self.text() + "\n")

    def text(self) -> str:
        """The log as CSV [s, rad, N·m or rad, V]; see `save`."""
        # The field, not the note that it may have come from: a corrected payload must
        # not stand next to the old one.
        notes = [(key, value) for key, value in self.notes if key != "payload_kg"]
        if self.payload is not None:
            notes.append(("payload_kg", repr(self.payload)))
        lines = ["# " + " ".join(f"{key}: {value}".split()) for key, value in notes]
        columns = {"time_s": self.time, "motor_angle_rad": self.motor_angle}
        columns["torque_Nm" if self.output_kind == "torque" else "deflection_rad"] = (
            self.output
        )
        if self.voltage is not None:
            columns["voltage_V"] = self.voltage
        # The `repr` of a float is the shortest text that reads back to the same bits.
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        return "\n".join(
            [*lines, ",".join(columns), *(",".join(map(repr, row)) for row in rows)]
        )

    @property
    def whole_angle(self) -> Real:
        """θm from before the cut on: `earlier_angle` and `motor_angle`, shape (H + N,)
        [rad].

        >>> log = Experiment(period=0.004, motor_angle=[1, 2], output=[0, 0], earlier_angle=[0, 0.5])
        >>> log.whole_angle.tolist()
        [0.0, 0.5, 1.0, 2.0]
        """
        if self.earlier_angle is None:
            return self.motor_angle
        return np.concatenate([self.earlier_angle, self.motor_angle])

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return self.period * (self.motor_angle.size - 1)

    @property
    def output_unit(self) -> str:
        """Unit of the output: ``N·m`` of a torque, ``rad`` of a deflection."""
        return "N·m" if self.output_kind == "torque" else "rad"

    def overview(self) -> Overview:
        """What is known about the log."""
        kind = {"torque": "base torque [N·m]", "deflection": "deflection angle [rad]"}
        keys = ("title", "simulated", "source", "damping")
        rows = rows_of(
            self,
            Row("samples", "samples", self.output.size),
            ("duration", "duration", "s"),
            ("period", "sampling period", "ms"),
            "output_kind",
            Row("", "output", kind[self.output_kind]),
            ("payload", "payload", "g"),
            ("sha256", "SHA-256 of the file"),
            *(
                Row(f"notes.{key}", key, text)
                for key, text in self.notes
                if key in keys
            ),
        )
        return Overview(source_name(self.source), rows=rows, findings=self.findings)

    @property
    def simulated(self) -> bool:
        """Whether the log's notes say that it was simulated."""
        return dict(self.notes).get("simulated", "").lower() in ("true", "yes", "1")

    def split(self, fraction: float) -> tuple[slice, slice]:
        """The first `fraction` of the samples and the rest, as two slices.

        Raises FieldError where `fraction` is outside (0, 1) or leaves one part empty.

        >>> Experiment(period=0.004, motor_angle=[0, 1, 2, 3], output=[0, 1, 2, 3]).split(0.5)
        (slice(0, 2, None), slice(2, 4, None))
        """
        # The border is rounded: even half a sample from either end would leave a part
        # empty.
        count = self.motor_angle.size
        edge = 0.5 / count
        inside = above(
            edge,
            1 - edge,
            high_open=True,
            remedy="give a fraction such as 0.6",
        )
        border = round(inside.check("fraction", fraction) * count)
        return slice(0, border), slice(border, count)


def _column(frame: Any, channel: Channel) -> Real:
    try:
        # By column name only, which every kind of frame supports: no frame library is
        # imported.
        values = np.asarray(frame[channel.column], np.float64)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise LogError(
            "columns",
            channel.column,
            f"no column of numbers ({type(error).__name__})",
            "the name of a column of numbers",
            "state a column of the frame",
        ) from error
    if values.ndim != 1 or values.size < 2:
        raise LogError(
            "columns",
            channel.column,
            f"of shape {values.shape}",
            "(N,)",
            "give one-dimensional arrays of one length",
        )
    return values
