"""Mislabelled columns of a log: checks of their values before any model is fitted."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink.findings import Finding
from fracsys.checks import Real

# Share of the variance of a channel that a single other one explains: for 300 random
# vibrating links, angle, speed and acceleration of the motor explain at most 31 % of
# the torque, the time 0.5 %.
COPIED_LEAST = 0.98
# Share of the samples at the limits of the amplifier: 6 % change the identified gain by
# 0.6 %, 13 % by 8 %.
STOPPED_MOST = 0.1
# Share of the samples at an extreme above which it counts as a limit: half a per cent
# of them changes the gain by 0.05 %.
_HELD = 0.005
# Ratio of the number of samples at the extreme value to that at the adjacent level; at
# the crest of a sine in a coarse converter it is 2.4.
_PILE = 4.0


def column_findings(log: Experiment) -> Iterator[Finding]:
    """Findings W209, W324 and W213: degrees, a copy of the motor's motion, a clock, an
    amplifier at its limits.
    """
    angle, output = log.motor_angle, log.output
    # Central differences, without their factors, at all samples but two at each end.
    inner, speed = slice(2, -2), angle[2:] - angle[:-2]
    sources = {
        "angle": angle[inner],
        "speed": speed[1:-1],
        "acceleration": speed[2:] - speed[:-2],
    }
    shares = {name: _explained(output[inner], each) for name, each in sources.items()}
    nearest = max(shares, key=lambda name: shares[name])
    time = np.arange(output.size, dtype=np.float64)
    stopped = sum(held for _, held in rails(output)) / output.size
    largest = float(np.max(np.abs(angle - angle[0])))
    checks = (
        (
            shares[nearest] > COPIED_LEAST,
            Finding(
                "W324",
                "error",
                f"the output is the motor's {nearest} times a constant: no vibration is in it",
                {"explained": shares[nearest], "most": COPIED_LEAST},
                "check the column of the output; a stiff link needs faster moves to vibrate",
            ),
        ),
        (
            _explained(output, time) > COPIED_LEAST or _is_ramp(output),
            Finding(
                "W324",
                "error",
                "the output grows steadily with time: a clock, a counter, or the drift of an amplifier",
                {"first": float(output[0]), "last": float(output[-1])},
                "check the column of the output, and let the amplifier warm up",
            ),
        ),
        (
            _is_ramp(angle),
            Finding(
                "W324",
                "error",
                "the motor angle grows by one step at each sample: a clock, or a speed that excites nothing",
                {"first": float(angle[0]), "last": float(angle[-1])},
                "check the column of the motor angle, or excite the arm: a pulse, a PRBS or a square wave",
            ),
        ),
        (
            stopped > STOPPED_MOST,
            Finding(
                "W213",
                "error",
                f"{100 * stopped:.3g} % of the samples lie at the largest or smallest output: the amplifier "
                "saturates, or this is a command, not a measurement",
                {
                    "share": stopped,
                    "most": STOPPED_MOST,
                    "low": float(output.min()),
                    "high": float(output.max()),
                },
                "move less or lower the amplifier's gain, and check the column of the output",
            ),
        ),
        (
            # On the output side of the gear no flexible arm turns more than once, but 7
            # degrees labelled as radians do.
            largest > math.tau,
            Finding(
                "W209",
                "error",
                "the motor turns by more than one revolution: are these degrees labelled as radians?",
                {"largest_angle": largest, "if_degrees": math.radians(largest)},
                'give the angle at the link\'s side of the gear in rad, or state unit = "deg"',
            ),
        ),
    )
    yield from (finding for shown, finding in checks if shown)


def motion_at_start(
    angle: Real, vibration: Real, spread: float
) -> tuple[int, str | None]:
    """The number of samples that show whether a log begins at rest, and what moves in
    them, None if the arm rests; `vibration` is without offset.
    """
    # At least ten samples: the mean of fewer is noise of the gauge and not the
    # deflection of the link.
    lead = max(10, round(0.01 * vibration.size))
    # A fiftieth of the motion: encoder noise and the creep of a brake stay below it, a
    # move does not.
    if float(np.ptp(angle[:lead])) > 0.02 * float(np.ptp(angle)):
        return lead, "the motor moves"
    bent = abs(float(vibration[:lead].mean())) > 0.5 * spread
    return lead, "the link is bent" if bent else None


def _explained(values: Real, source: Real) -> float:
    """Share of the variance of `values` that a multiple of `source` and a constant
    explain: R².
    """
    centred, other = values - values.mean(), source - source.mean()
    # Squared, so that a copy with the opposite sign or in another unit also counts as a
    # copy.
    power = float(centred @ centred) * float(other @ other)
    return float(centred @ other) ** 2 / power if power > 0 else 0.0


def _is_ramp(values: Real) -> bool:
    """Whether nearly all steps are equal, like those of a clock or of a counter that
    restarts.
    """
    steps = np.diff(values)
    # A hundred of them suffice: the usual step of a ramp is the same everywhere.
    some = np.sort(steps[:: steps.size // 100 + 1])
    usual = float(some[some.size // 2])
    # Measured steps differ by counts of the encoder and by noise: only computed ones
    # agree to a millionth. A tenth may differ, where a counter restarts.
    return (
        usual != 0 and float(np.mean(np.abs(steps - usual) < 1e-6 * abs(usual))) > 0.9
    )


def rails(output: Real) -> Iterator[tuple[float, int]]:
    """The extreme values at which an amplifier has saturated, each with its number of
    samples: far more than at the adjacent level.
    """
    low, high = output.min(), output.max()
    for end in (low, high):
        held = np.count_nonzero(output == end)
        if held > _HELD * output.size:
            apart = np.abs(output[(output > low) & (output < high)] - end)
            beside = np.count_nonzero(apart == np.min(apart, initial=np.inf))
            if held > _PILE * beside:
                yield float(end), int(held)
