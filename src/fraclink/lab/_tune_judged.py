"""When a move has settled, judged by the sensors' readings: in the same way for a
promise and for the arm.
"""

from __future__ import annotations

import math

import numpy as np

from fraclink._design import Design
from fraclink._simulate.metrics import BAND
from fracsys.checks import Real

__all__ = ["Judged", "judged", "settling_band"]

# Settling time [s], and half of the peak-to-peak motor angle in the last two seconds
# [rad].
Judged = tuple[float, float]

# multiple of the gauge's white noise, as shaped by the loop: noise alone would leave a
# narrower band
_ABOVE = 6.0


def settling_band(amplitude: float, design: Design) -> float:
    """The band about its last angle in which the smoothed tip of a move has settled
    [rad].
    """
    rig, model = design.rig, design.model
    # The estimate contains the noise of the gauge: it would never stay in a narrower
    # band.
    noise = rig.gauge.noise / model.stiffness / math.sqrt(_width(design))
    return max(BAND * abs(amplitude), _ABOVE * noise)


def _width(design: Design) -> int:
    """Samples of a mean over a quarter of a vibration period, which preserves 2√2/π of
    the amplitude.
    """
    return max(3, round(0.5 * math.pi / design.model.resonance / design.rig.period))


def judged(
    angle: Real, torque: Real, band: float, ends: float, design: Design
) -> Judged:
    """Time from which the tip estimate stays within the band, and the motion of the
    motor from half a second after `ends` [s] on, each smoothed over a quarter of a
    vibration.
    """
    model, period, width = design.model, design.rig.period, _width(design)
    # Torque and angle at the same instant: with a gauge delay of 12 ms, the motion of
    # the motor would appear as vibration.
    late = round(model.gauge_lag / period)
    tip = angle[: angle.size - late] - torque[late:] / model.stiffness
    # Only means over the whole width: a shorter one at the end would show the noise of
    # single samples.
    smooth, motor = (
        np.convolve(x, np.full(width, 1 / width), "valid") for x in (tip, angle)
    )
    # About its final position (a mean over a vibration) and not the reference, since
    # friction of the motor leaves a small offset.
    final = float(np.mean(tip[-4 * width :]))
    outside = np.flatnonzero(np.abs(smooth - final) > band)
    middle = width // 2
    rest = round((ends + 0.5) / period) - middle
    return (
        period * float(outside[-1] + 1 + middle) if outside.size else 0.0,
        0.5 * float(np.ptp(motor[rest:])),
    )
