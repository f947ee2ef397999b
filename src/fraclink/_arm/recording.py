"""Measurements of any system: an input and an output sampled together, or lines of a
frequency response.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._display import Overview, Row, displayed, source_name
from fraclink._files import document
from fraclink.errors import FieldError, LogError
from fracsys.checks import Array, Between, Complex, Positive, Real, above, checked
from fracsys.checks.equality import compared

__all__ = ["Coherence", "FrequencyResponse", "Lines", "Recording", "coherence_weights"]

# share of the whole swing: a link that moves less than this at the beginning is held by
# hand
_HELD = 0.05
Signal = Annotated[Real, Array(1, min_size=2)]


@displayed
@document(
    "recording",
    container="npz",
)
@checked(error=LogError)
@compared
@dataclass(frozen=True, eq=False)
class Recording:
    """An input and an output that were sampled together; any two channels, in any
    units.

    Parameters
    ----------
    period
        sampling period [s].
    input, output
        shape (N,). The system is at rest before the first sample, with the input at
        `input_at_rest`.
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
            raise LogError(
                "output",
                self.output.size,
                f"not as long as the input ({self.input.size} samples)",
                "equal lengths",
                "cut both to their common span of time",
            )

    def overview(self) -> Overview:
        """What is known about the two channels."""
        ends = {
            name: (float(values.min()), float(values.max()))
            for name, values in (("input", self.input), ("output", self.output))
        }
        rows = (
            Row("samples", "samples", self.input.size),
            Row("period", "period", self.period, "s", digits=6),
            *(Row(name, name, interval) for name, interval in ends.items()),
        )
        return Overview(source_name(self.source), rows=rows)

    @classmethod
    def ring_down(
        cls,
        period: float,
        output: Real,
        *,
        source: str = "",
        sha256: str = "",
    ) -> Recording:
        """Return the record of a link that was bent, held and let go, from its output
        alone.

            y(0) − y(t) = G(s) 1/s,    G = k/(s^a + w): the response to removing the force that held it

        A record that begins while it is held keeps that part, as a delay of the step;
        one that begins later is cut at its widest swing, where the link turns round.
        Raises LogError where nothing moves.

        >>> t = np.arange(0, 4, 0.01)
        >>> record = Recording.ring_down(0.01, 0.1 * np.cos(6 * t) * np.exp(-0.2 * t))
        >>> float(record.input.max()), round(float(record.output.max()), 2)
        (1.0, 0.19)
        """
        values = np.asarray(output, np.float64)
        # A fiftieth of the record, but at least ten samples: enough to tell a held
        # link, which only shows noise, from a moving one.
        lead = max(10, values.size // 50)
        # Below fifty samples the last fifth, which determines the rest position, is
        # shorter than the beginning.
        if values.size < 5 * lead or not np.ptp(values):
            raise LogError(
                "output",
                int(values.size),
                "no ring-down",
                ">= 50 samples that move",
                "record from before the link is let go",
            )
        rested = float(np.ptp(values[:lead])) < _HELD * float(np.ptp(values))
        # The mean of the last fifth averages over the periods of a vibration that is
        # still decaying; a single sample does not.
        rest = float(values[-(values.size // 5) :].mean())
        # The speed is zero at the widest swing, as at release. Only the first half is
        # searched, so that noise at the end is not taken for a swing.
        begin = (
            0 if rested else int(np.argmax(np.abs(values[: values.size // 2] - rest)))
        )
        start = float(values[:lead].mean()) if rested else float(values[begin])
        deflection = start - values[begin:]
        return cls(
            period, np.ones(deflection.size), deflection, source=source, sha256=sha256
        )

    @property
    def time(self) -> Real:
        """Time of the samples from the first one on, shape (N,) [s]."""
        return self.period * np.arange(self.input.size, dtype=np.float64)

    @classmethod
    def of(
        cls,
        log: Experiment,
        input: Literal["motor_angle", "voltage"] = "motor_angle",
        output: Literal["output", "motor_angle"] = "output",
    ) -> Recording:
        """Return two channels of a log; the motor angle is at rest at its first sample,
        a voltage at 0.
        """
        channels = {"motor_angle": log.motor_angle}
        if log.voltage is not None:
            channels["voltage"] = log.voltage
        channels["output"] = log.output
        for role in (input, output):
            if role not in channels:
                raise LogError(
                    "input",
                    role,
                    "not in the log",
                    ", ".join(channels),
                    "name another channel",
                )
        # The first reading of the encoder is the position of the arm, not a step from
        # zero.
        rest = {"motor_angle": float(log.motor_angle[0])}
        measured = channels[output] - rest.get(output, 0.0)
        start = rest.get(input, 0.0)
        return cls(log.period, channels[input], measured, start, log.source, log.sha256)


_OUT = "leave out the line at zero frequency"
Lines = Annotated[
    Real,
    Array(1),
    above(0.0, unit="rad/s", remedy=_OUT),
]
Coherence = Annotated[
    Real,
    Array(1),
    above(0.0, 1.0, remedy="leave out lines without it"),
]


@displayed
@document(
    "frequency-response",
    container="npz",
)
@checked
@compared
@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """What was measured of a system at some frequencies, H(jω) = output/input.

    Parameters
    ----------
    frequency
        ω, shape (N,), > 0 [rad/s] (or radians per sample).
    response
        H(jω), complex, shape (N,).
    magnitude
        of the input's lines: the weight with which each line's error appears in the
        output. None where it is not known.
    coherence
        γ² in (0, 1] of each line, None where it was not measured.
    source, sha256
        file that it comes from.

    Raises
    ------
    FieldError
        columns of different lengths, or values out of range.

    Examples
    --------
    >>> FrequencyResponse([1.0, 2.0], [1 - 1j, 0.4 - 0.8j]).band
    (1.0, 2.0)
    """

    frequency: Lines
    response: Annotated[Complex, Array(1, min_size=1)]
    magnitude: Annotated[Real, Array(1), Between(0.0)] | None = None
    coherence: Coherence | None = None
    source: str = ""
    sha256: str = ""

    __made_by__ = (
        "read_frequency_response(path) or FrequencyResponse(frequency, response)"
    )

    def __post_init__(self) -> None:
        for name in ("response", "magnitude", "coherence"):
            column = getattr(self, name)
            if column is not None and column.shape != self.frequency.shape:
                raise FieldError(
                    name,
                    str(column.shape),
                    f"not as long as frequency {self.frequency.shape}",
                    "equal lengths",
                    "give one for each frequency",
                )

    @property
    def band(self) -> tuple[float, float]:
        """Lowest and highest frequency [rad/s]."""
        return float(self.frequency.min()), float(self.frequency.max())

    def overview(self) -> Overview:
        """What is known about the response."""
        least = None if self.coherence is None else float(self.coherence.min())
        rows = (
            Row("lines", "lines", self.frequency.size),
            Row("band", "band", self.band, "rad/s"),
            Row("coherence", "least coherence", least, digits=3),
        )
        return Overview(source_name(self.source), rows=rows)

    def between(self, low: float, high: float) -> FrequencyResponse:
        """Return the lines from `low` to `high` [rad/s].

        >>> FrequencyResponse([1.0, 2.0, 3.0], [1, 2j, 3]).between(1.5, 3.0).frequency.tolist()
        [2.0, 3.0]
        """
        inside = (self.frequency >= low) & (self.frequency <= high)
        if not inside.any():
            low_end, high_end = self.band
            raise FieldError(
                "band",
                (low, high),
                "without a line",
                f"a band that overlaps {low_end:.6g} to {high_end:.6g} rad/s",
                "widen the band",
            )
        magnitude, coherence = (
            None if column is None else column[inside]
            for column in (self.magnitude, self.coherence)
        )
        return replace(
            self,
            frequency=self.frequency[inside],
            response=self.response[inside],
            magnitude=magnitude,
            coherence=coherence,
        )


def coherence_weights(response: Complex, coherence: Real) -> Real:
    """Weight √(γ²/(1 − γ²))/|H| of each line's error: proportional to the inverse of
    its standard deviation.
    """
    # γ² = 1 would have infinite weight. The limit, a millionth below, corresponds to an
    # error of 0.1 % of a line, less than any measurement has.
    share = np.minimum(coherence, 1 - 1e-6)
    return np.sqrt(share / (1 - share)) / np.abs(response)
