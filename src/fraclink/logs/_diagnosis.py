"""`diagnose`: every check on one log before a model is fitted, in the order in which a
person would ask.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._arm.rig import Rig
from fraclink._reading.columns import converter_step
from fraclink.findings import Finding, worst_first
from fraclink.logs._channels import (
    Mode,
    clipping,
    constant_channels,
    find_mode,
    labels,
    outliers,
    quantisation,
    range_of_angle,
    rest_at_start,
    voltage_limit,
)
from fracsys.checks import checked


@checked
def diagnose(experiment: Experiment, rig: Rig | None = None) -> tuple[Finding, ...]:
    """Examine a log before a model is fitted to it; the gravest findings come first.

    Looks at the start (at rest?), the gauge's offset and sign, the delay of the output,
    quantisation, clipping, stiction, outliers, excitation of the resonance, number of
    periods and samples in each. What needs a vibration stands on the one mode Γ/θm = c
    s²/(s² + 2ζωs + ω²)·e^(−τs) that explains most of the output, found by a scan that
    needs no guess.

    The findings have codes W205 … W237; ``error`` means that the log cannot be used as
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
    return worst_first(_all(experiment, rig))


def _all(experiment: Experiment, rig: Rig | None) -> Iterator[Finding]:
    yield from experiment.findings
    yield from labels(experiment, rig)
    dead = list(constant_channels(experiment))
    yield from dead
    # Without two signals that move there is no mode to speak of: what follows would
    # find fault with noise.
    if dead:
        return
    yield from range_of_angle(experiment)
    yield from outliers(experiment)
    yield from clipping(experiment, rig)
    yield from voltage_limit(experiment, rig)
    yield from stiction(experiment)
    mode = find_mode(experiment.motor_angle, experiment.output, experiment.period)
    # The same scan with the roles exchanged: a motor angle follows from its torque as a
    # double integral, so that a swap shows as a large share this way and a small one
    # that way.
    reverse = find_mode(experiment.output, experiment.motor_angle, experiment.period)
    yield from mode_findings(experiment, mode, reverse)
    offset, spread = _offset(experiment, mode)
    yield from rest_at_start(experiment, offset, spread)
    yield from quantisation(experiment, mode)


def _offset(experiment: Experiment, mode: Mode | None) -> tuple[float, float]:
    """Offset of the output and the standard deviation of the motion in it, in units of
    the output.

    A link that starts and ends at rest has a torque of zero mean over many periods: Γ =
    mL²θt'' integrates to a change of velocity.
    """
    offset = float(experiment.output.mean())
    # What the mode does not explain is noise, offset or another mode: it is no motion
    # that an offset could be compared with.
    residual = mode.residual if mode is not None else 0.0
    spread = float(experiment.output.std())
    return offset, max(spread**2 - residual**2, 0.0) ** 0.5 or spread


# --- the vibration mode: roles, sign, delay, excitation, periods, sampling -------------------------------


_PERIODS = 3.0  # fewer do not separate damping from amplitude
_SAMPLES = (
    10.0  # a period: below it the hold between samples matters as much as the damping
)
_EXPLAINED = 0.3  # of the output's energy: below it no mode was found
_SWAPPED = (
    0.8  # explained share of the exchanged roles from which they are called exchanged
)


def mode_findings(
    experiment: Experiment, mode: Mode | None, reverse: Mode | None
) -> Iterator[Finding]:
    """Findings on the mode from motor angle to output; `reverse` is the best one with
    the roles exchanged.
    """
    if mode is None:
        yield _too_short(experiment)
        return
    # Half as much: where one vibration fills the log, either signal explains the other
    # well.
    if (
        reverse is not None
        and reverse.share > _SWAPPED
        and mode.share < 0.5 * reverse.share
    ):
        yield _swapped(mode, reverse)
        return
    # Before sign, periods and delay: those of a mode that explains nothing would be
    # sentences about noise.
    if mode.share < _EXPLAINED:
        yield _unexplained(mode)
        return
    yield _found(mode)
    if mode.gain < 0:
        yield _reversed(experiment, mode)
    yield from _resolution(experiment, mode)
    # Half a sample is what the parabola through the correlation's crest resolves.
    if mode.delay > 0.5 * experiment.period:
        yield _delayed(experiment, mode)


def _too_short(experiment: Experiment) -> Finding:
    return Finding(
        "W204",
        "error",
        f"{experiment.output.size} samples are too few to find a vibration",
        {"samples": experiment.output.size, "duration_s": experiment.duration},
        "record at least 200 samples and three periods of the vibration",
    )


def _swapped(mode: Mode, reverse: Mode) -> Finding:
    return Finding(
        "W210",
        "error",
        "the motor angle follows the output: the two columns seem to be exchanged",
        {"explained": mode.share, "explained_exchanged": reverse.share},
        "exchange motor_angle and the output in [log] of the rig file",
    )


def _unexplained(mode: Mode) -> Finding:
    return Finding(
        "W233",
        "warning",
        "no vibration explained by the motor's motion was found: it is not excited, or hidden by noise",
        {"explained": mode.share, "best_frequency": mode.frequency},
        "excite with more amplitude around the expected resonance; check the output's column",
    )


def _found(mode: Mode) -> Finding:
    return Finding(
        "W235",
        "info" if mode.share > 0.6 else "warning",
        f"a mode at {mode.frequency:.4g} rad/s explains {100 * mode.share:.3g} % of the output",
        {
            "frequency": mode.frequency,
            "damping_ratio": mode.damping_ratio,
            "explained": mode.share,
        },
        ""
        if mode.share > 0.6
        else "the rest is noise, offset, another mode or history before the log",
    )


def _reversed(experiment: Experiment, mode: Mode) -> Finding:
    return Finding(
        "W211",
        "error",
        f"the {experiment.output_kind} has the wrong sign: where the motor speeds up it must be positive",
        {"gain": mode.gain, "explained": mode.share},
        f"state sign = -1 for the {experiment.output_kind} (or for the motor angle) in [log] of the rig file",
    )


def _resolution(experiment: Experiment, mode: Mode) -> Iterator[Finding]:
    cycle = 2 * math.pi / mode.frequency
    periods, samples = experiment.duration / cycle, cycle / experiment.period
    if periods < _PERIODS:
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
            # At four a period the resonance stands at half of the Nyquist frequency: a
            # fit rests on the hold there.
            "warning" if samples > 4 else "error",
            f"there are {samples:.3g} samples in a period of the vibration",
            {"samples_per_period": samples, "period_s": experiment.period},
            f"record with a period below {cycle / _SAMPLES * 1e3:.3g} ms",
        )


def _delayed(experiment: Experiment, mode: Mode) -> Finding:
    samples = mode.delay / experiment.period
    phase = math.degrees(mode.delay * mode.frequency)
    return Finding(
        "W234",
        # A delay τ turns the phase at the resonance by ωτ, as an order below 2 does:
        # ten degrees pass for λ = 1.9.
        "warning" if phase > 10 else "info",
        f"the output lags by about {mode.delay * 1e3:.3g} ms ({phase:.2g}° at the resonance)",
        {"delay_s": mode.delay, "samples": samples, "phase": math.radians(phase)},
        "it is fitted with the model; if ignored, it would look like a fractional order",
    )


# --- stiction: the motor stands still though it is driven ------------------------------------------------


# s: over less, a slow motion cannot be distinguished from a standstill by a coarse
# encoder
_WINDOW = 0.05
_SHORTEST = 0.02  # s: a standstill shorter than that is a reversal
_DRIVEN = 0.02  # of the largest voltage: less is an idle amplifier's offset


def _longest_run(mask: NDArray[np.bool_]) -> tuple[int, int]:
    """First sample and length of the longest stretch that is true; 0 and 0 without one."""
    # Zeros at both ends, so that stretches that begin or end the log have two edges as
    # well.
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    if not edges.size:
        return 0, 0
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    return int(edges[2 * longest]), int(edges[2 * longest + 1] - edges[2 * longest])


def _still(angle: NDArray[np.float64], window: int, reach: float) -> NDArray[np.bool_]:
    """Where the angle moves by no more than `reach` within `window` samples around."""
    moves = np.abs(angle[window:] - angle[:-window])
    still = np.zeros(angle.size, dtype=bool)
    # The verdict of a window belongs to its middle: the motor stood still before and
    # after it.
    still[window // 2 : window // 2 + moves.size] = moves <= reach
    return still


def stiction(experiment: Experiment) -> Iterator[Finding]:
    """A motor that stands still under voltage, with the voltage that did not move it.

    Without a voltage a standstill cannot be distinguished from a reference that stands
    still.
    """
    if experiment.voltage is None:
        return
    step = converter_step(experiment.motor_angle)
    # One step of the encoder may flicker at rest; two are motion.
    still = _still(
        experiment.motor_angle, max(3, round(_WINDOW / experiment.period)), 1.5 * step
    )
    driven = np.abs(experiment.voltage) > _DRIVEN * float(
        np.abs(experiment.voltage).max()
    )
    shortest = max(5, round(_SHORTEST / experiment.period))
    stuck = still & driven
    first, longest = _longest_run(stuck)
    if not driven.any() or longest < shortest:
        return
    share = float(stuck.sum() / driven.sum())
    # Not the largest: the voltage that breaks the motor loose belongs to the last
    # sample of a standstill.
    held = float(np.quantile(np.abs(experiment.voltage[stuck]), 0.95))
    yield Finding(
        "W232",
        "warning" if share > 0.1 else "info",
        f"the motor stands still in {100 * share:.3g} % of its driven time, up to about {held:.3g} V",
        {
            "share": share,
            "voltage": held,
            "longest_s": longest * experiment.period,
            "time_s": first * experiment.period,
        },
        "stiction: compensate it in the motor loop; the model of the link is not affected",
    )
