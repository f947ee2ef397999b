"""`diagnose`: all checks on a log before a model is fitted, in the order in which a
person would make them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._arm.rig import Rig
from fraclink._identify import Fit, identify
from fraclink._identify.columns import motion_at_start, rails
from fraclink._identify.problem import CLEARLY_LESS
from fraclink._identify.shape import moving_angle
from fraclink._reading.columns import converter_step
from fraclink.errors import FieldError
from fraclink.findings import Finding, Findings, worst_first
from fracsys.checks import Real, checked

# Findings of a one-mode fit that concern the columns and not the model.
_OF_COLUMNS = ("W209", "W211", "W324")
# multiple of the range that holds 99 % of the samples; no motion reaches that far
_FAR = 8.0
# fractions of the standard deviation of the motion
_OFFSET_INFO, _OFFSET_WARNING = 0.1, 0.5
PERIODS = 3.0  # fewer periods do not separate damping from amplitude
# samples per period: with fewer, the hold between samples matters as much as the
# damping
_SAMPLES = 10.0
# More than half of the variance of an output: no two different vibrations can each
# explain that much of it.
SHOWN = 0.5


@checked
def diagnose(experiment: Experiment, rig: Rig | None = None) -> Findings:
    """Examine a log before a model is fitted to it; the gravest findings come first.

    Looks at the start (at rest?), the gauge's offset and sign, the delay of the output,
    quantisation, clipping, outliers, excitation of the resonance, number of
    periods and samples in each. Checks that need a vibration use the fit of one mode
    Γ/θm = c s²/(s² + 2ζωs + ω²)·e^(−τs), which needs no initial guess.

    The findings have codes W202 … W324; ``error`` means that the log cannot be used as
    it is.

    Parameters
    ----------
    experiment
        the log: motor angle [rad], output [N·m] or [rad].
    rig
        limits of its gauge and motor sharpen the checks.

    >>> from fraclink._reading.reading import bundled_log, read_log
    >>> findings = diagnose(read_log(bundled_log("prbs_30g")))
    >>> any(finding.severity == "error" for finding in findings)
    False
    """
    return Findings(worst_first(_findings(experiment, rig)))


def vibration_of(log: Experiment) -> Fit | None:
    """The one mode that explains most of the output; None if nothing moves, or if the
    log is too short.
    """
    with np.errstate(all="ignore"):
        try:
            return identify(log, "D-IOM", details=False)
        except (FieldError, ArithmeticError):
            return None


def share_of(mode: Fit | None) -> float:
    """Share of the output's variance that a mode explains, 0 to 1."""
    return 0.0 if mode is None or not mode.nmse < 1 else 1 - mode.nmse


def _findings(log: Experiment, rig: Rig | None) -> Iterator[Finding]:
    yield from log.findings
    yield from _labels(log, rig)
    constant = list(_constant_channels(log))
    yield from constant
    # Without two moving signals there is no mode, and the following checks would only
    # judge noise.
    if constant:
        return
    yield from _outliers(log)
    yield from _limits(log, rig)
    mode = vibration_of(log)
    yield from _mode(log, mode)
    yield from _rest_at_start(log, mode)
    yield from _quantisation(log, mode)


def _labels(log: Experiment, rig: Rig | None) -> Iterator[Finding]:
    """The labels of the log: its payload, and whether it was simulated."""
    payload = log.payload
    if log.simulated:
        yield Finding(
            "W230",
            "info",
            "the log says that it was simulated",
            {},
            "results describe a model, not a rig",
        )
    if payload is None:
        yield Finding(
            "W216",
            "warning",
            "no payload is stated for this log",
            {},
            "state it (--payload, or # payload_kg: in the log): with it, a model scales to other payloads",
        )
    # One per cent: the rates that a timer can be set to are farther apart, and its
    # crystal is more accurate.
    if rig is not None and abs(log.period - rig.period) > 0.01 * rig.period:
        yield Finding(
            "W217",
            "info",
            f"the log has a sample every {1e3 * log.period:.4g} ms, the rig's law runs every "
            f"{1e3 * rig.period:.4g} ms",
            {"log_period_s": log.period, "rig_period_s": rig.period},
            "the model does not depend on it; check period_ms if they should be the same",
        )
    if payload is None or rig is None:
        return
    low, high = rig.payloads.low, rig.payloads.high
    if doubt := rig.payloads.doubt(payload):
        yield doubt
    elif not low <= payload <= high:
        yield Finding(
            "W216",
            "info",
            f"the payload of {payload:g} kg lies outside the rig's range",
            {"payload": payload, "low": low, "high": high},
            "check the label",
        )


def _channels(log: Experiment) -> tuple[tuple[str, Real, str], ...]:
    """Name in words, values and unit of the two channels."""
    return (
        ("motor angle", log.motor_angle, "rad"),
        (log.output_kind, log.output, log.output_unit),
    )


def _constant_channels(log: Experiment) -> Iterator[Finding]:
    """A channel that moves by less than a billionth of its value holds no information."""
    for name, values, unit in _channels(log):
        spread, size = float(values.std()), float(np.abs(values).max())
        # The rounding of a constant to nine digits is of that size.
        if spread <= 1e-9 * size:
            state = f"constant at {float(values[0]):.6g} {unit}"
            remedy = "check the gauge and its amplifier"
            if name == "motor angle":
                remedy = "excite the arm: a pulse, a PRBS or a square wave"
            yield Finding(
                "W202",
                "error",
                f"the {name} is {state if size else 'zero throughout'}",
                {"standard_deviation": spread},
                remedy,
            )


def _outliers(log: Experiment) -> Iterator[Finding]:
    """Samples far outside the range that holds 99 % of the channel."""
    for name, values, _unit in _channels(log):
        # Quantiles, because a single spike of 100 times the motion would raise the
        # standard deviation so far that the spike lies within it. At most one sample in
        # a hundred lies outside the two quantiles, so only few are reported.
        low, middle, high = np.quantile(values, (0.005, 0.5, 0.995))
        # An output at rest in 99 % of the samples has no such range.
        reach = max(high - middle, middle - low) or float(values.std())
        distance = np.abs(values - middle)
        worst = int(np.argmax(distance))
        if distance[worst] > _FAR * reach:
            count = int((distance > _FAR * reach).sum())
            yield Finding(
                "W224",
                "error",
                f"{count} outliers in the {name}, the largest at sample {worst}",
                {
                    "value": float(values[worst]),
                    "median": float(middle),
                    "outliers": count,
                    "time_s": worst * log.period,
                },
                "remove or repair these rows: a fit by least squares follows them",
            )


def _limits(log: Experiment, rig: Rig | None) -> Iterator[Finding]:
    """Samples at the limits of gauge and amplifier, whether stated or visible in the
    data.
    """
    values = log.output
    for value, held in rails(values):
        yield Finding(
            "W213",
            "warning",
            f"{100 * held / values.size:.3g} % of the samples read exactly {value:.4g} {log.output_unit}: "
            "the output seems clipped",
            {
                "value": value,
                "samples": held,
                "time_s": float(np.argmax(values == value)) * log.period,
            },
            "move less or lower the amplifier's gain; a clipped torque biases every fit",
        )
    if rig is None:
        return
    # The gauge's limit is a torque; the converter of a deflection has its own limit,
    # which no rig file states. A saturated amplifier is recorded one converter step
    # below the limit of its data sheet.
    limit = rig.gauge.limit if log.output_kind == "torque" else math.inf
    past = np.abs(values) >= 0.99 * limit
    if past.any():
        yield Finding(
            "W213",
            "warning",
            f"{past.sum()} samples of the torque reach the gauge's limit of {limit:g} N·m",
            {
                "limit": limit,
                "samples": int(past.sum()),
                "time_s": float(np.argmax(past)) * log.period,
            },
            "move less or lower the amplifier's gain",
        )


def _mode(log: Experiment, mode: Fit | None) -> Iterator[Finding]:
    """The vibration: roles, sign, delay, excitation, periods, sampling."""
    if mode is None:
        yield Finding(
            "W204",
            "error",
            f"{log.output.size} samples are too few to find a vibration",
            {"samples": log.output.size, "duration_s": log.duration},
            "record at least 200 samples and three periods of the vibration",
        )
        return
    # The motor angle follows from the torque as a double integral, so exchanged columns
    # leave a clearly smaller residual in this direction. In a log filled by one
    # vibration each signal explains the other well.
    exchanged = replace(
        log, motor_angle=log.output, output=log.motor_angle, earlier_angle=None
    )
    share, reverse = share_of(mode), share_of(vibration_of(exchanged))
    if reverse > SHOWN and 1 - reverse < CLEARLY_LESS * (1 - share):
        yield Finding(
            "W210",
            "error",
            "the motor angle follows the output: the two columns seem to be exchanged",
            {"explained": share, "explained_exchanged": reverse},
            "exchange motor_angle and the output in [log] of the rig file",
        )
        return
    frequency = mode.model.natural_frequency
    # Before sign, periods and delay, which would describe noise if the mode explains
    # nothing.
    if share < SHOWN:
        yield Finding(
            "W233",
            "warning",
            "no vibration explained by the motor's motion was found: it is not excited, or hidden by noise",
            {"explained": share, "best_frequency": frequency},
            "excite with more amplitude around the expected resonance; check the output's column",
        )
        return
    yield from (each for each in mode.findings if each.code in _OF_COLUMNS)
    yield Finding(
        "W235",
        "info",
        f"a mode at {frequency:.4g} rad/s explains {100 * share:.3g} % of the output",
        {
            "frequency": frequency,
            "damping_ratio": mode.model.damping / (2 * frequency),
            "explained": share,
        },
        "the rest is noise, offset, another mode or history before the log",
    )
    cycle = math.tau / frequency
    periods, samples = log.duration / cycle, cycle / log.period
    if periods < PERIODS:
        yield Finding(
            "W204",
            "error",
            f"the log holds {periods:.3g} periods of the vibration",
            {"periods": periods, "period_of_vibration_s": cycle},
            "record at least three periods, or ten to determine the damping",
        )
    if samples < _SAMPLES:
        yield Finding(
            "W215",
            # With four samples per period the resonance lies at half the Nyquist
            # frequency, where the result of a fit depends on the hold.
            "warning" if samples > 4 else "error",
            f"there are {samples:.3g} samples in a period of the vibration",
            {"samples_per_period": samples, "period_s": log.period},
            f"record with a period below {cycle / _SAMPLES * 1e3:.3g} ms",
        )
    phase = mode.delay * frequency
    if mode.delay > 0.5 * log.period:
        yield Finding(
            "W234",
            # A delay τ turns the phase at the resonance by ωτ, as does an order below
            # 2: ten degrees look like λ = 1.9.
            "warning" if phase > math.radians(10) else "info",
            f"the output lags by about {mode.delay * 1e3:.3g} ms ({math.degrees(phase):.2g}° at the resonance)",
            {
                "delay_s": mode.delay,
                "samples": mode.delay / log.period,
                "phase": phase,
            },
            "it is fitted with the model; if ignored, it would look like a fractional order",
        )


def _rest_at_start(log: Experiment, mode: Fit | None) -> Iterator[Finding]:
    """Offset of the gauge, and whether the link is at rest before the motion begins."""
    # If a link starts and ends at rest, its torque has zero mean over many periods: Γ =
    # mL²θt'' integrates to a change of velocity. The part that the mode does not
    # explain is noise, offset or another mode: the offset is not compared with it.
    offset, spread = float(log.output.mean()), float(log.output.std())
    moving = spread * math.sqrt(share_of(mode)) or spread
    ratio = abs(offset) / moving
    if ratio > _OFFSET_INFO:
        yield Finding(
            "W212",
            "warning" if ratio > _OFFSET_WARNING else "info",
            f"the {log.output_kind} has an offset of {offset:.4g} {log.output_unit}, "
            f"{100 * ratio:.3g} % of the motion in it",
            {"offset": offset, "motion": moving},
            "it is fitted with the model; balance the gauge bridge if it grows",
        )
    lead, begins = motion_at_start(log.motor_angle, log.output - offset, moving)
    if begins is None:
        return
    # `identify` uses the motion of the motor before a cut if it is known back to a
    # rest. That rest must last as long as in a log without a cut: a few similar samples
    # after a gap in the stamps are not a rest.
    angle = moving_angle(log)  # the end of a very long history
    still = float(np.ptp(angle[:lead])) <= 0.02 * float(np.ptp(angle))
    usable = still and angle.size - log.output.size >= lead
    yield Finding(
        "W231",
        "info" if usable else "warning",
        f"the log does not start at rest: {begins} in its first {lead * log.period:.3g} s",
        {
            "first_output": float(log.output[:lead].mean()),
            "offset": offset,
            "first_move": float(np.ptp(log.motor_angle[:lead])),
            "time_s": 0.0,
        },
        "identify starts from what the motor did before the cut; other fits assume rest at the cut"
        if usable
        else "start recording before the motion, or cut the log where the arm is at rest "
        "(keep=, --keep): models assume rest",
    )


def _quantisation(log: Experiment, mode: Fit | None) -> Iterator[Finding]:
    """Steps of the converter compared with the signal and with the residual of the
    mode.
    """
    rest = float(log.output.std()) * math.sqrt(1 - share_of(mode))
    for (name, values, unit), finest in zip(_channels(log), (0.0, rest), strict=True):
        step = converter_step(values)
        levels = float(np.ptp(values)) / step if step else math.inf
        # A step q is a noise of q/√12: with 50 levels 0.6 % of the range; at twice the
        # residual of the mode, a third of its power.
        if levels < 50 or step > 2 * finest > 0:
            yield Finding(
                "W214",
                "warning",
                f"the {name} has steps of {step:.4g} {unit}: {levels:.0f} levels",
                {
                    "step": step,
                    "levels": levels,
                    "noise_of_steps": step / math.sqrt(12),
                },
                "move further or use a finer converter",
            )
