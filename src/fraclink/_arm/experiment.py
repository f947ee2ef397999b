"""An experiment: one recorded motion, in SI units and radians, on a uniform time base."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._files import document, write_text
from fraclink._validate import checked_choice, checked_number, checked_series
from fraclink.errors import FieldError, LogError
from fraclink.findings import Finding

__all__ = ["Experiment"]

OutputKind = Literal["torque", "deflection"]


@document(
    "log",
    version=2,
    container="npz",
    upgrades={1: dict},  # without a digest and without findings
    period=lambda log: log.period,
    sources=lambda log: {log.source: log.sha256} if log.sha256 else {},
)
@dataclass(frozen=True, eq=False)
class Experiment:
    """One recorded motion of a flexible arm; what every identification starts from.

    Arguments:
        period: sampling period Ts [s], > 0.
        motor_angle: θm, shape (N,) [rad].
        output: shape (N,): base torque Γ [N·m], or deflection θm − θt [rad]. Both are positive where the
            tip lags behind a motor that turns forward: Γ = c(θm − θt), eq. (3).
        output_kind: ``"torque"`` or ``"deflection"``.
        payload: m [kg], > 0, or None where nobody stated it.
        source: file name or a sentence on where it comes from.
        sha256: hash of the file, or "".
        findings: what the reader noticed (codes W2xx).
        start_time: stamp of the first sample [s].
        voltage: at the amplifier's input, shape (N,) [V], or None.
        notes: header entries of the log, such as (("simulated", "true"),).

    Arrays are stored as read-only copies. Raises LogError for arrays of different lengths, fewer than two
    samples, or a value that is not finite. Source: Benftima et al. (2023), section 3.1.

    >>> log = Experiment(period=0.004, motor_angle=[0, 0.1, 0.2], output=[0, 0.01, 0.03])
    >>> log.time.tolist(), log.output_kind
    ([0.0, 0.004, 0.008], 'torque')
    """

    period: float
    motor_angle: NDArray[np.float64]
    output: NDArray[np.float64]
    output_kind: OutputKind = "torque"
    payload: float | None = None
    source: str = ""
    sha256: str = ""
    findings: tuple[Finding, ...] = ()
    start_time: float = 0.0
    voltage: NDArray[np.float64] | None = None
    notes: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        _number("period", self.period, "s", positive=True)
        _number("start_time", self.start_time, "s", positive=False)
        if self.payload is not None:
            _number("payload", self.payload, "kg", positive=True)
        checked_choice("output_kind", self.output_kind, ("torque", "deflection"))
        for name in ("motor_angle", "output", "voltage"):
            if name != "voltage" or self.voltage is not None:
                object.__setattr__(self, name, _frozen(name, getattr(self, name)))
        self._check_lengths()

    def _check_lengths(self) -> None:
        count = self.motor_angle.size
        if count < 2:
            raise LogError(
                "motor_angle", count, "too short", allowed=">= 2 samples", remedy="give a recorded motion"
            )
        for name in ("output", "voltage"):
            values = getattr(self, name)
            if values is not None and values.size != count:
                raise LogError(
                    name,
                    values.size,
                    f"another number of samples than motor_angle has ({count})",
                    allowed=f"{count} samples",
                    remedy="cut the channels to their common span of time",
                )

    @property
    def time(self) -> NDArray[np.float64]:
        """Time of the samples, shape (N,) [s]."""
        return np.asarray(self.start_time + self.period * np.arange(self.motor_angle.size), dtype=np.float64)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Experiment):
            return NotImplemented
        return all(_same(getattr(self, item.name), getattr(other, item.name)) for item in fields(self))

    def __hash__(self) -> int:
        return hash((self.period, self.output_kind, self.source, self.sha256, self.output.tobytes()))

    def save(self, path: Path | str) -> None:
        """Write the log as CSV with its notes, in SI units, so that `read_log` gives the same numbers back.

        Findings are not written: reading and `diagnose` find them again.

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
        notes = [(key, value) for key, value in self.notes if key != "payload_kg"]
        if self.payload is not None:
            notes.append(("payload_kg", repr(float(self.payload))))
        lines = ["# " + " ".join(f"{key}: {value}".split()) for key, value in notes]
        columns = {"time_s": self.time, "motor_angle_rad": self.motor_angle}
        columns["torque_Nm" if self.output_kind == "torque" else "deflection_rad"] = self.output
        if self.voltage is not None:
            columns["voltage_V"] = self.voltage
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        return "\n".join([*lines, ",".join(columns), *(",".join(map(repr, row)) for row in rows)])

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return self.period * (self.motor_angle.size - 1)

    @property
    def output_unit(self) -> str:
        """Unit of the output: ``N·m`` of a torque, ``rad`` of a deflection."""
        return "N·m" if self.output_kind == "torque" else "rad"

    @property
    def simulated(self) -> bool:
        """Whether the log says of itself that it was simulated."""
        return dict(self.notes).get("simulated", "").lower() in ("true", "yes", "1")

    def split(self, fraction: float) -> tuple[slice, slice]:
        """The first `fraction` of the samples and the rest, as two slices.

        Raises FieldError where `fraction` is outside (0, 1) or leaves one part empty.

        >>> Experiment(period=0.004, motor_angle=[0, 1, 2, 3], output=[0, 1, 2, 3]).split(0.5)
        (slice(0, 2, None), slice(2, 4, None))
        """
        count = self.motor_angle.size
        _number("fraction", fraction, "", positive=True)
        border = round(fraction * count)
        if not 0 < border < count:
            raise FieldError(
                "fraction",
                fraction,
                "leaving one part empty",
                allowed=f"{1 / count:.3g} to {1 - 1 / count:.3g}",
                remedy="give a fraction such as 0.6",
            )
        return slice(0, border), slice(border, count)


def _number(name: str, value: object, unit: str, *, positive: bool) -> None:
    checked_number(
        name,
        value,
        allowed=f"{'> 0' if positive else 'any finite number'} [{unit or '-'}]",
        remedy=f"give {name} as a number in SI units",
        holds=lambda x: x > 0 or not positive,
    )


def _same(one: object, other: object) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.array_equal(one, other)
    return not isinstance(one, np.ndarray) and not isinstance(other, np.ndarray) and one == other


def _frozen(name: str, values: ArrayLike) -> NDArray[np.float64]:
    array = checked_series(name, values, error=LogError, remedy="give one channel")
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise LogError(
            name,
            f"{array[bad[0]]} at sample {bad[0]}",
            f"not finite ({bad.size} of {array.size} samples)",
            allowed="finite numbers",
            remedy="repair the recording, or read it with interpolate=True where few samples are missing",
        )
    array.flags.writeable = False
    return array
