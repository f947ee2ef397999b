"""A recording: an input and an output of any system, sampled together."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._display import displayed
from fraclink._files import document
from fraclink._validate import Array, Positive, checked
from fraclink.errors import LogError

__all__ = ["Recording"]

Signal = Annotated[NDArray[np.float64], Array(1, min_size=2)]


@displayed
@document(
    "recording",
    container="npz",
    period=lambda record: record.period,
    sources=lambda record: {record.source: record.sha256} if record.sha256 else {},
)
@checked(error=LogError)
@dataclass(frozen=True, eq=False)
class Recording:
    """An input and an output that were sampled together; any two channels, in any units.

    Parameters
    ----------
    period
        sampling period [s].
    input, output
        shape (N,). The system is at rest before the first sample, with the input at `input_at_rest`.
    input_at_rest
        0 for a command, the first sample for a position.
    source, sha256
        file that it comes from.

    Examples
    --------
    >>> Recording(period=0.1, input=[0, 1, 1], output=[0, 0.1, 0.2]).output.tolist()
    [0.0, 0.1, 0.2]
    """

    period: Positive
    input: Signal
    output: Signal
    input_at_rest: float = 0.0
    source: str = ""
    sha256: str = ""

    __made_by__ = "Recording(period, input, output)"

    def __post_init__(self) -> None:
        if self.input.size != self.output.size:
            remedy = "cut both to their common span of time"
            problem = f"not as long as the input ({self.input.size} samples)"
            raise LogError("output", self.output.size, problem, allowed="equal lengths", remedy=remedy)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Recording):
            return NotImplemented
        pairs = [(getattr(self, item.name), getattr(other, item.name)) for item in fields(self)]
        return all(np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b for a, b in pairs)

    def __hash__(self) -> int:
        return hash((self.period, self.source, self.sha256, self.output.tobytes()))

    @property
    def time(self) -> NDArray[np.float64]:
        """Time of the samples from the first one on, shape (N,) [s]."""
        return np.asarray(self.period * np.arange(self.input.size), dtype=np.float64)

    @classmethod
    def of(
        cls,
        log: Experiment,
        input: Literal["motor_angle", "voltage"] = "motor_angle",
        output: Literal["output", "motor_angle"] = "output",
    ) -> Recording:
        """Return two channels of a log; the motor angle is at rest at its first sample, a voltage at 0."""
        channels = {"motor_angle": log.motor_angle, "voltage": log.voltage, "output": log.output}
        for role in (input, output):
            if role not in channels or channels[role] is None:
                allowed = ", ".join(name for name, values in channels.items() if values is not None)
                raise LogError(
                    "input", role, "not in the log", allowed=allowed, remedy="name another channel"
                )
        start = float(log.motor_angle[0])
        signal = log.motor_angle if log.voltage is None or input == "motor_angle" else log.voltage
        measured = log.motor_angle - start if output == "motor_angle" else log.output
        rest = start if input == "motor_angle" else 0.0
        return cls(log.period, signal, measured, rest, log.source, log.sha256)
