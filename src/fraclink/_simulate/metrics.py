"""What a run is judged by."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._law import MODES, REASONS

__all__ = ["Metrics", "Verdict", "judge", "latest_settling", "measure"]

Real = NDArray[np.float64]

BAND = 0.02  # of the move: the usual band of the settling time
REST_BAND = 2e-3  # [rad]: what "settled" means where there is no move to take 2 % of


@dataclass(frozen=True)
class Metrics:
    """Figures of one simulated run.

    overshoot: largest excess of the tip beyond its final reference, as a part of the move [1].
    settling_time: time from which the tip stays within 2 % of the move [s]; infinite if it never does.
    residual_vibration: half the peak-to-peak tip angle in the two vibration periods after the reference
    ended [rad]. steady_state_error: mean of tip − reference over the last tenth of the run [rad].
    peak_tip_error: largest |tip − reference| [rad], the motor loop's lag included.
    peak_voltage: largest |voltage| [V].
    motor_reference_noise: standard deviation of the motor reference in the last tenth, its trend taken out
    [rad]. saturated: part of the periods with the voltage at its limit [1].
    """

    overshoot: float
    settling_time: float
    residual_vibration: float
    steady_state_error: float
    peak_tip_error: float
    peak_voltage: float
    motor_reference_noise: float
    saturated: float


@dataclass(frozen=True)
class Verdict:
    """Whether a run holds, and if not, why; true where it holds.

    >>> bool(Verdict(True, "settled")), str(Verdict(False, "unstable: grows"))
    (True, 'does not hold: unstable: grows')
    """

    passed: bool
    reason: str

    def __bool__(self) -> bool:
        return self.passed

    def __str__(self) -> str:
        return "passed" if self.passed else f"does not hold: {self.reason}"


def _tail(values: Real, part: float = 0.1) -> Real:
    return values[-max(8, int(part * len(values))) :]


def _band(reference: Real) -> float:
    """Half the width [rad] of the band that a settled tip stays in."""
    return BAND * abs(float(reference[-1] - reference[0])) or REST_BAND


def measure(
    time: Real,
    reference: Real,
    tip: Real,
    motor_reference: Real,
    voltage: Real,
    saturated: NDArray[np.bool_],
    *,
    ended: float,
    vibration_period: float,
) -> Metrics:
    """Return the metrics; `ended` is when the reference came to rest [s], `vibration_period` the link's
    [s].
    """
    final = float(reference[-1])
    move = final - float(reference[0])
    outside = np.flatnonzero(np.abs(tip - final) > _band(reference))
    settling = 0.0
    if outside.size:
        last = int(outside[-1])
        settling = float(time[last + 1]) if last + 1 < len(time) else math.inf
    after = (time >= ended) & (time <= ended + 2 * vibration_period)
    rest = tip[after] if after.any() else _tail(tip)
    last_tenth = _tail(motor_reference)
    steps = np.arange(len(last_tenth), dtype=float)
    smooth = np.polyval(np.polyfit(steps, last_tenth, 2), steps)
    return Metrics(
        overshoot=max(0.0, float(np.max((tip - final) / move))) if move else 0.0,
        settling_time=settling,
        residual_vibration=0.5 * float(np.ptp(rest)),
        steady_state_error=float(np.mean(_tail(tip - reference))),
        peak_tip_error=float(np.max(np.abs(tip - reference))),
        peak_voltage=float(np.max(np.abs(voltage))),
        motor_reference_noise=float(np.std(last_tenth - smooth)),
        saturated=float(np.mean(saturated)),
    )


def latest_settling(last: float, vibration_period: Real | float) -> Real | float:
    """Return the latest settling time [s] that counts in a run that ends at `last` [s].

    A vibration that only passes through the band leaves it again within half of its period [s].
    """
    return last - 0.5 * vibration_period


def _growth(time: Real, deviation: Real, vibration_period: float) -> float:
    """Growth rate [1/s] of the vibration's envelope, from its peaks in windows of one period."""
    count = max(2, round(vibration_period / (time[1] - time[0])))
    windows = len(deviation) // count
    if windows < 4:
        return 0.0
    peaks = np.ptp(deviation[-windows * count :].reshape(windows, count), axis=1)
    if peaks.max() < REST_BAND:
        return 0.0
    level = np.log(np.maximum(peaks, 1e-12))
    return float(np.polyfit(np.arange(windows) * count * (time[1] - time[0]), level, 1)[0])


def judge(
    metrics: Metrics,
    time: Real,
    reference: Real,
    tip: Real,
    mode: NDArray[np.uint32],
    reason: NDArray[np.uint32],
    *,
    ended: float,
    vibration_period: float,
) -> Verdict:
    """Return the verdict: instability first, then trips, saturation, and a tip that has not settled."""
    abnormal = np.flatnonzero(mode != 1)
    stop = int(abnormal[0]) if abnormal.size else len(time)
    quiet = (time >= ended + vibration_period) & (np.arange(len(time)) < stop)
    rate = _growth(time[quiet], (tip - reference)[quiet], vibration_period) if quiet.sum() > 8 else 0.0
    # A tip that is away because it was left behind does not swing out of its band: its noise may still
    # rise a little, and to call that unstable would name the wrong cause.
    swings = 0.5 * float(np.ptp(_tail(tip - reference))) > _band(reference)
    settled = metrics.settling_time <= latest_settling(float(time[-1]), vibration_period)
    if not np.all(np.isfinite(tip)) or (rate > 0 and swings and not settled):
        grown = f"unstable: the vibration grows at {rate:.3g} 1/s"
        return Verdict(False, f"{grown}; the law trips at {time[stop]:.3g} s" if abnormal.size else grown)
    if abnormal.size:
        what = f"{MODES[mode[stop]]} ({REASONS[reason[stop]]})"
        return Verdict(False, f"tripped: the law goes to {what} at {time[stop]:.3g} s")
    if not settled:
        lasting = "saturated: the voltage is at its limit" if metrics.saturated > 0.2 else "not settled"
        error = float(np.max(np.abs(_tail(tip - reference))))
        return Verdict(False, f"{lasting}; the tip is still {error:.3g} rad away at {time[-1]:.3g} s")
    return Verdict(True, f"settled in {metrics.settling_time:.3g} s")
