"""The verb: every check on one log, in the order in which a person would ask."""

from __future__ import annotations

from collections.abc import Iterator

from fraclink._arm.experiment import Experiment
from fraclink._arm.rig import Rig
from fraclink._logs.diagnose.channels import (
    clipping,
    constant_channels,
    labels,
    outliers,
    quantisation,
    range_of_angle,
    rest_at_start,
    voltage_limit,
)
from fraclink._logs.diagnose.friction import stiction
from fraclink._logs.diagnose.mode import mode_findings
from fraclink._logs.diagnose.scan import Mode, find_mode
from fraclink._validate import checked_noun
from fraclink.findings import Finding

__all__ = ["diagnose"]

_ORDER = {"error": 0, "warning": 1, "info": 2}


def diagnose(experiment: Experiment, rig: Rig | None = None) -> tuple[Finding, ...]:
    """Examine a log before a model is fitted to it; the gravest findings come first.

    Looks at the start (at rest?), the gauge's offset and sign, the delay of the output, quantisation,
    clipping, stiction, outliers, excitation of the resonance, number of periods and samples in each. What
    needs a vibration stands on the one mode Γ/θm = c s²/(s² + 2ζωs + ω²)·e^(−τs) that explains most of the
    output, found by a scan that needs no guess.

    Arguments:
        experiment: the log, motor angle [rad], output [N·m] or [rad].
        rig: limits of its gauge and motor sharpen the checks.

    Returns findings with codes W201 … W235; ``error`` means that the log cannot be used as it is.

    >>> from fraclink._logs.readers import bundled_log, read_log
    >>> findings = diagnose(read_log(bundled_log("prbs_30g")))
    >>> any(finding.severity == "error" for finding in findings)
    False
    """
    checked_noun("experiment", experiment, Experiment, remedy="read the file with read_log first")
    if rig is not None:
        checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")
    return tuple(sorted(_all(experiment, rig), key=lambda finding: _ORDER[finding.severity]))


def _all(experiment: Experiment, rig: Rig | None) -> Iterator[Finding]:
    yield from experiment.findings
    yield from labels(experiment, rig)
    dead = list(constant_channels(experiment))
    yield from dead
    if dead:
        return
    yield from range_of_angle(experiment)
    yield from outliers(experiment)
    yield from clipping(experiment, rig)
    yield from voltage_limit(experiment, rig)
    yield from stiction(experiment)
    mode = find_mode(experiment.motor_angle, experiment.output, experiment.period)
    reverse = find_mode(experiment.output, experiment.motor_angle, experiment.period)
    yield from mode_findings(experiment, mode, reverse)
    offset, spread = _offset(experiment, mode)
    yield from rest_at_start(experiment, offset, spread)
    yield from quantisation(experiment, mode)


def _offset(experiment: Experiment, mode: Mode | None) -> tuple[float, float]:
    """Offset of the output and the standard deviation of the motion in it, in units of the output.

    A link that starts and ends at rest has a torque of zero mean over many periods: Γ = mL²θt'' integrates
    to a change of velocity.
    """
    offset = float(experiment.output.mean())
    residual = mode.residual if mode is not None else 0.0
    spread = float(experiment.output.std())
    return offset, max(spread**2 - residual**2, 0.0) ** 0.5 or spread
