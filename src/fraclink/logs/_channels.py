"""The vibration that a log shows without a guess, and checks on one channel at a time.

The output of the link is the motor angle through a high-pass of second order,

    Γ/θm = c s²/(s² + 2ζω s + ω²)·e^(−τs).

For a grid of ω and ζ the cross-correlation of the output with that response is taken at
all lags at once by FFT; its largest value gives gain, sign and delay together, and its
share of the output's energy says how well one mode explains the log. It is a diagnosis,
not an identification: a percent of ω is enough.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._arm.rig import Rig
from fraclink._identify.columns import lead_of, motion_at_start
from fraclink._identify.shape import moving_angle
from fraclink._reading.columns import converter_step
from fraclink.findings import Finding

_LONGEST = 8_192  # samples looked at: 8 s at 1 kHz, half a minute at 250 Hz
# A factor of four apart, which the search refines; below the first one the ringing
# outlasts the window, and the share hardly depends on ζ.
_DAMPINGS = (0.01, 0.04, 0.15)
_ROUNDS = (
    16  # of the search around the best point of the grid, which ends within 0.3 % of ω
)
# Its peak vanishes at 1/√2: beyond 0.5 any smooth output is explained by some ω.
_MOST_DAMPED = 0.5
# Energies are products of two squares: 1e-240, above the smallest double of 2e-308.
_TINY = 1e-60
# frequencies: 8 % apart over two and a half decades; the widest ζ covers the gaps
_GRID = 72
_LATEST = (
    0.15  # of the mode's period: a later answer could as well be one of the other sign
)


@dataclass(frozen=True)
class Mode:
    """The mode that explains the output best.

    Parameters
    ----------
    frequency, damping_ratio
        ω [rad/s] and ζ [1].
    gain
        c, in units of the output for one radian; negative where the output follows with
        the wrong sign.
    delay
        τ of the output [s], >= 0.
    share
        of the output's energy that this mode explains, 0 to 1.
    residual
        standard deviation of what is left, in units of the output.
    """

    frequency: float
    damping_ratio: float
    gain: float
    delay: float
    share: float
    residual: float


def find_mode(
    angle: NDArray[np.float64], output: NDArray[np.float64], period: float
) -> Mode | None:
    """The best mode from `angle` to `output`, both shape (N,); None where the log is
    too short for one.
    """
    angle, output = (
        angle[:_LONGEST] - angle[0],
        output[:_LONGEST] - np.mean(output[:_LONGEST]),
    )
    count = angle.size
    # Two periods within the log, of one the offset explains as much; and 0.6 of the
    # Nyquist frequency, above which the hold between samples is a part of the response.
    lowest, highest = 2 * math.pi * 2 / (count * period), 0.6 * math.pi / period
    if lowest * 4 > highest or not np.ptp(angle) or not np.ptp(output):
        return None
    if not all(_TINY < np.abs(values).max() < 1 / _TINY for values in (angle, output)):
        return None  # their squares underflow or overflow: no angle and no torque
    spectra = _Spectra.of(angle, output, period)
    grid = [
        (w, z) for w in np.geomspace(lowest, highest, _GRID).tolist() for z in _DAMPINGS
    ]
    # The rough share costs one FFT and errs where ringing outlasts the log: it ranks
    # the 216 points, and the three best are fitted as they are.
    grid.sort(key=lambda point: -spectra.rough_share(*point))
    best = max((spectra.fit(w, z) for w, z in grid[:3]), key=lambda mode: mode.share)
    # From the spacing of the grid on, halved in the logarithm whenever none of the four
    # neighbours is better.
    step, factor = (highest / lowest) ** (1 / (_GRID - 1)), 2.0
    for _ in range(_ROUNDS):
        w, z = best.frequency, best.damping_ratio
        near = (
            (w * step, z),
            (w / step, z),
            (w, min(z * factor, _MOST_DAMPED)),
            (w, z / factor),
        )
        closer = max(
            (spectra.fit(*point) for point in near), key=lambda mode: mode.share
        )
        if closer.share > best.share:
            best = closer
        else:
            step, factor = math.sqrt(step), math.sqrt(factor)
    return best


@dataclass(frozen=True)
class _Spectra:
    """The spectra of both signals, padded to twice their length so that correlations do
    not wrap around.
    """

    count: int
    period: float
    frequencies: NDArray[np.float64]
    angle: NDArray[np.complex128]
    output: NDArray[np.complex128]
    energy: float

    @staticmethod
    def of(
        angle: NDArray[np.float64], output: NDArray[np.float64], period: float
    ) -> _Spectra:
        count = angle.size
        # A power of two of at least twice the length: a correlation at a lag is then
        # that of the two signals and not of one with the other's other end.
        size = 1 << (2 * count - 1).bit_length()
        held = np.concatenate((angle, np.full(size - count, angle[-1])))
        # Beyond its end the angle returns to zero by a ramp: a jump would ring through
        # the whole window.
        held[count:] *= np.linspace(1, 0, size - count)
        return _Spectra(
            count,
            period,
            np.asarray(2 * np.pi * np.fft.rfftfreq(size, period), dtype=np.float64),
            np.fft.rfft(held),
            np.fft.rfft(output, size),
            float(output @ output),
        )

    def _response(self, frequency: float, damping: float) -> NDArray[np.complex128]:
        """Spectrum of the output that a mode with c = 1 and no delay would give."""
        square = self.frequencies**2
        below = frequency**2 - square + 2j * damping * frequency * self.frequencies
        return np.asarray(self.angle * (-square / below), dtype=np.complex128)

    def _lags(self, frequency: float) -> int:
        return 1 + min(
            self.count // 4, int(_LATEST * 2 * math.pi / (frequency * self.period))
        )

    def rough_share(self, frequency: float, damping: float) -> float:
        """Share of the output explained, where the ringing after the log's end still
        counts: one FFT.
        """
        spectrum = self._response(frequency, damping)
        correlation = np.fft.irfft(np.conj(spectrum) * self.output)[
            : self._lags(frequency)
        ]
        size = 2 * (spectrum.size - 1)
        power = 2 * float((spectrum.real**2 + spectrum.imag**2).sum()) / size
        return (
            float(np.abs(correlation).max()) ** 2 / (power * self.energy)
            if power
            else 0.0
        )

    def fit(self, frequency: float, damping: float) -> Mode:
        """Gain and delay of the mode of `frequency` and `damping` that explain most of
        the output.
        """
        size = 2 * (self.frequencies.size - 1)
        response = np.fft.irfft(self._response(frequency, damping), size)[: self.count]
        response -= response.mean()
        spectrum = np.fft.rfft(response, size)
        correlation = np.fft.irfft(np.conj(spectrum) * self.output)[
            : self._lags(frequency)
        ]
        # The largest in modulus: an output of the wrong sign answers with a negative
        # peak at its own delay, and the sign is read off it.
        lag = int(np.argmax(np.abs(correlation)))
        power = float(response @ response) or math.inf
        share = min(1.0, float(correlation[lag]) ** 2 / (power * self.energy))
        residual = math.sqrt(max(0.0, 1 - share) * self.energy / self.count)
        delay = (lag + _crest(correlation, lag)) * self.period
        return Mode(
            frequency, damping, float(correlation[lag]) / power, delay, share, residual
        )


def _crest(values: NDArray[np.float64], place: int) -> float:
    """Where between the samples the extreme value at `place` lies, by a parabola: −0.5
    to 0.5.
    """
    if not 0 < place < values.size - 1:
        return 0.0
    before, here, after = values[place - 1 : place + 2].tolist()
    bend = before - 2 * here + after
    return 0.5 * (before - after) / bend if bend else 0.0


_CLIPPED = 0.005  # share of samples at the extreme value
# times as many samples at the extreme as one step inside; a sine's crest has 2.4 times
# as many
_PILE = 4.0
_FAR = 8.0  # times the range that holds 99 % of the samples: no motion goes there
# levels: beyond a converter of 14 bits the steps are those of the numbers' text
_FINE = 20_000
_OFFSET_INFO, _OFFSET_WARNING = 0.1, 0.5  # of the standard deviation of the motion


def labels(experiment: Experiment, rig: Rig | None) -> Iterator[Finding]:
    """What the log says of itself: the payload, and whether it was simulated."""
    if experiment.simulated:
        yield Finding(
            "W230",
            "info",
            "the log says that it was simulated",
            {},
            "results describe a model, not a rig",
        )
    if experiment.payload is None:
        yield Finding(
            "W216",
            "warning",
            "no payload is stated for this log",
            {},
            "state it (--payload, or # payload_kg: in the log): from a known one a model scales to others",
        )
    # A percent: the rates of a timer's dividers lie farther apart, and a timer's
    # crystal is off by less.
    if rig is not None and abs(experiment.period - rig.period) > 0.01 * rig.period:
        yield Finding(
            "W217",
            "info",
            f"the log has a sample every {1e3 * experiment.period:.4g} ms, the rig's law runs every "
            f"{1e3 * rig.period:.4g} ms",
            {"log_period_s": experiment.period, "rig_period_s": rig.period},
            "the model does not depend on it; check period_ms if they should be the same",
        )
    if experiment.payload is None or rig is None:
        return
    if doubt := rig.payloads.doubt(experiment.payload):
        yield doubt
    elif not rig.payloads.low <= experiment.payload <= rig.payloads.high:
        yield Finding(
            "W216",
            "info",
            f"the payload of {experiment.payload:g} kg lies outside the rig's range",
            {
                "payload": experiment.payload,
                "low": rig.payloads.low,
                "high": rig.payloads.high,
            },
            "check the label",
        )


def _channels(experiment: Experiment) -> tuple[tuple[str, str, str], ...]:
    """Attribute, name in words and unit of the two channels."""
    return (
        ("motor_angle", "motor angle", "rad"),
        ("output", experiment.output_kind, experiment.output_unit),
    )


def constant_channels(experiment: Experiment) -> Iterator[Finding]:
    """A channel that moves by less than a billionth of its value tells nothing."""
    remedies = (
        "excite the arm: a pulse, a PRBS or a square wave",
        "check the gauge and its amplifier",
    )
    for (name, named, unit), remedy in zip(
        _channels(experiment), remedies, strict=True
    ):
        values = getattr(experiment, name)
        spread, size = float(values.std()), float(np.abs(values).max())
        # Decimals of nine digits leave that much of a constant.
        if spread <= 1e-9 * size or size == 0:
            state = (
                f"constant at {float(values[0]):.6g} {unit}"
                if size
                else "zero throughout"
            )
            yield Finding(
                "W202",
                "error",
                f"the {named} is {state}",
                {"standard_deviation": spread},
                remedy,
            )


def range_of_angle(experiment: Experiment) -> Iterator[Finding]:
    """More than a turn is rare on these rigs; degrees called radians are not."""
    largest = float(np.abs(experiment.motor_angle - experiment.motor_angle[0]).max())
    if largest > 2 * math.pi:
        yield Finding(
            "W209",
            "error",
            f"the motor turns by {largest:.4g} rad, more than a full turn: "
            "are these degrees labelled as radians?",
            {"largest_angle": largest, "if_degrees": math.radians(largest)},
            'state unit = "deg" for the motor angle if they are',
        )


def outliers(experiment: Experiment) -> Iterator[Finding]:
    """Samples far outside the range that holds 99 % of the channel."""
    for name, named, _unit in _channels(experiment):
        values = getattr(experiment, name)
        # Quantiles, as one spike of 100 times the motion would raise a standard
        # deviation to where it is none itself. At most one sample in a hundred lies
        # beyond both, so that what is found is always few.
        low, middle, high = np.quantile(values, (0.005, 0.5, 0.995))
        # An output that rests in 99 % of the samples has no such range.
        reach = max(high - middle, middle - low) or float(values.std())
        far = np.flatnonzero(np.abs(values - middle) > _FAR * reach)
        if far.size:
            worst = int(far[np.argmax(np.abs(values[far] - middle))])
            yield Finding(
                "W224",
                "error",
                f"{far.size} outliers in the {named}, the largest at sample {worst}",
                {
                    "value": float(values[worst]),
                    "median": float(middle),
                    "outliers": far.size,
                    "time_s": worst * experiment.period,
                },
                "remove or repair these rows: a fit by least squares follows them",
            )


def _piled(values: NDArray[np.float64], step: float) -> tuple[int, int]:
    """Samples at the maximum, and samples one step inside of it."""
    top = float(values.max())
    return int((values >= top - 0.5 * step).sum()), int(
        ((values < top - 0.5 * step) & (values >= top - 1.5 * step)).sum()
    )


def clipping(experiment: Experiment, rig: Rig | None) -> Iterator[Finding]:
    """Samples that pile up at the largest or smallest reading."""
    values = experiment.output
    # A continuous signal has no levels: a five-hundredth of its range stands for one,
    # which the crest of a sine fills 2.4 times as full as the next, too.
    step = converter_step(values) or float(np.ptp(values)) / 500
    for side, signed in (("largest", values), ("smallest", -values)):
        at, inside = _piled(signed, step)
        if at > _CLIPPED * values.size and at > _PILE * max(inside, 1):
            yield Finding(
                "W213",
                "warning",
                f"{100 * at / values.size:.3g} % of the samples lie at the {side} output: it seems clipped",
                {
                    "value": float(signed.max()) * (1 if side == "largest" else -1),
                    "samples": at,
                    "time_s": float(np.argmax(signed)) * experiment.period,
                },
                "move less or lower the amplifier's gain; a clipped torque biases every fit",
            )
    # The limit is a torque: a deflection's converter has one of its own that no rig
    # file states.
    limit = (
        rig.gauge.limit
        if rig is not None and experiment.output_kind == "torque"
        else math.inf
    )
    past = np.flatnonzero(np.abs(values) >= 0.99 * limit)
    if beyond := past.size:
        yield Finding(
            "W213",
            "warning",
            f"{beyond} samples of the torque reach the gauge's limit of {limit:g} N·m",
            {
                "limit": limit,
                "samples": beyond,
                "time_s": float(past[0]) * experiment.period,
            },
            "move less or lower the amplifier's gain",
        )


def voltage_limit(experiment: Experiment, rig: Rig | None) -> Iterator[Finding]:
    """Samples at the amplifier's limit: the motor loop was open there."""
    if (
        experiment.voltage is None
        or rig is None
        or not math.isfinite(rig.motor.voltage_limit)
    ):
        return
    # An amplifier that saturates is recorded a converter's step below what its data
    # sheet says.
    full = np.abs(experiment.voltage) >= 0.99 * rig.motor.voltage_limit
    if share := float(full.mean()):
        yield Finding(
            "W236",
            "info",
            f"the voltage is at its limit in {100 * share:.3g} % of the samples",
            {
                "limit": rig.motor.voltage_limit,
                "share": share,
                "time_s": float(np.argmax(full)) * experiment.period,
            },
            "the link's model is not affected; a motor model is",
        )


def rest_at_start(
    experiment: Experiment, offset: float, spread: float
) -> Iterator[Finding]:
    """Offset of the gauge, and whether the link is at rest before the motion begins."""
    ratio = abs(offset) / spread if spread else math.inf
    if ratio > _OFFSET_INFO:
        yield Finding(
            "W212",
            "warning" if ratio > _OFFSET_WARNING else "info",
            f"the {experiment.output_kind} has an offset of {offset:.4g} {experiment.output_unit}, "
            f"{100 * ratio:.3g} % of the motion in it",
            {"offset": offset, "motion": spread},
            "it is fitted with the model; balance the gauge bridge if it grows",
        )
    begins = motion_at_start(experiment.motor_angle, experiment.output - offset, spread)
    lead = lead_of(experiment.output)
    if begins is not None:
        known = _begins_before(experiment, lead)
        yield Finding(
            "W231",
            "info" if known else "warning",
            f"the log does not start at rest: {begins} in its first {lead * experiment.period:.3g} s",
            {
                "first_output": float(experiment.output[:lead].mean()),
                "offset": offset,
                "first_move": float(np.ptp(experiment.motor_angle[:lead])),
                "time_s": 0.0,
            },
            "identify starts from what the motor did before the cut; other fits assume rest at the cut"
            if known
            else "start recording before the motion, or cut the log where the arm is at rest "
            "(keep=, --keep): models assume rest",
        )


def _begins_before(experiment: Experiment, lead: int) -> bool:
    """Whether the log was cut, and what the motor did before the cut is known from a
    rest on.

    `identify` starts from there. The rest must last as long as that of a log that was
    not cut: behind a gap in the stamps a few samples that hardly differ are no rest.
    """
    angle = moving_angle(experiment)  # of a very long history its end
    still = 0.02 * float(np.ptp(angle))
    return (
        angle.size - experiment.output.size >= lead
        and float(np.ptp(angle[:lead])) <= still
    )


def quantisation(experiment: Experiment, mode: Mode | None) -> Iterator[Finding]:
    """Steps of the converter against the signal and against what the mode leaves
    unexplained.
    """
    for name, named, unit in _channels(experiment):
        values = getattr(experiment, name)
        step = converter_step(values)
        if not step:
            continue
        levels = float(np.ptp(values)) / step
        if levels > _FINE:
            continue
        # A step q is noise of q/√12: of 50 levels 0.6 % of the range, and of twice what
        # the mode leaves a third of the power of that.
        coarse = levels < 50 or (
            name == "output" and mode is not None and step > 2 * mode.residual
        )
        yield Finding(
            "W214",
            "warning" if coarse else "info",
            f"the {named} has steps of {step:.4g} {unit}: {levels:.0f} levels",
            {"step": step, "levels": levels, "noise_of_steps": step / math.sqrt(12)},
            "move further or use a finer converter"
            if coarse
            else "fine enough for a fit",
        )
