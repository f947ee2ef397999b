"""Checks that stand on the vibration mode of the log: roles, sign, delay, excitation, periods, sampling."""

from __future__ import annotations

import math
from collections.abc import Iterator

from fraclink._arm.experiment import Experiment
from fraclink._logs.diagnose.scan import Mode
from fraclink.findings import Finding

__all__ = ["mode_findings"]

_PERIODS = 3.0  # fewer do not separate damping from amplitude
_SAMPLES = 10.0  # a period: below it the hold between samples matters as much as the damping
_EXPLAINED = 0.3  # of the output's energy: below it no mode was found
_SWAPPED = 0.8  # explained share of the exchanged roles from which they are called exchanged


def mode_findings(experiment: Experiment, mode: Mode | None, reverse: Mode | None) -> Iterator[Finding]:
    """Findings on the mode from motor angle to output; `reverse` is the best one with the roles exchanged."""
    if mode is None:
        yield _too_short(experiment)
        return
    if reverse is not None and reverse.share > _SWAPPED and mode.share < 0.5 * reverse.share:
        yield _swapped(mode, reverse)
        return
    if mode.share < _EXPLAINED:
        yield _unexplained(mode)
        return
    yield _found(mode)
    if mode.gain < 0:
        yield _reversed(experiment, mode)
    yield from _resolution(experiment, mode)
    if mode.delay > 0.5 * experiment.period:
        yield _delayed(experiment, mode)


def _too_short(experiment: Experiment) -> Finding:
    return Finding(
        "W204",
        "error",
        f"{experiment.output.size} samples are too few to look for a vibration",
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
        "no vibration explained by the motor's motion was found: not excited, or covered by noise",
        {"explained": mode.share, "best_frequency": mode.frequency},
        "excite with more amplitude around the expected resonance; check the output's column",
    )


def _found(mode: Mode) -> Finding:
    return Finding(
        "W235",
        "info" if mode.share > 0.6 else "warning",
        f"a mode at {mode.frequency:.4g} rad/s explains {100 * mode.share:.3g} % of the output",
        {"frequency": mode.frequency, "damping_ratio": mode.damping_ratio, "explained": mode.share},
        "" if mode.share > 0.6 else "the rest is noise, offset, another mode or history before the log",
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
            "record at least three periods; ten give a damping",
        )
    if samples < _SAMPLES:
        yield Finding(
            "W215",
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
        "warning" if phase > 10 else "info",
        f"the output answers about {mode.delay * 1e3:.3g} ms late ({phase:.2g}° at the resonance)",
        {"delay_s": mode.delay, "samples": samples, "phase": math.radians(phase)},
        "it is fitted with the model; unfitted, a delay passes for a fractional order",
    )
