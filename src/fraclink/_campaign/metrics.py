"""The metrics of `fraclink._simulate`, for many runs at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._simulate.metrics import BAND, latest_settling

__all__ = ["Signals", "measure_many"]

Real = NDArray[np.float64]

_SATURATED = 64  # LAW_FLAG_SATURATED of law.h
_RUN = 1  # LAW_RUN


@dataclass(frozen=True)
class Signals:
    """What the kernel returns of R runs of N periods: tip, motor reference, voltage (R, N); flags, mode."""

    tip: Real
    motor_reference: Real
    voltage: Real
    flags: NDArray[np.uint32]
    mode: NDArray[np.uint32]
    reason: NDArray[np.uint32]


def measure_many(
    signals: Signals, reference: Real, *, period: float, ended: Real, vibration_period: Real
) -> dict[str, NDArray[np.generic]]:
    """Return the metrics of every run by name, as `simulate` defines them for one; shape (R,) each.

    `reference` (R, N) [rad]; `ended` (R,) when each reference comes to rest [s]; `vibration_period` (R,) [s].
    ``mode`` and ``reason`` are the law's first abnormal ones (1 and 0 where there is none); ``holds`` is
    whether the tip settled, half a vibration period before the end at the latest, and the law never left
    its normal mode.
    """
    tip, final = signals.tip, reference[:, -1:]
    move = final[:, 0] - reference[:, 0]
    excess = tip - final
    tenth = max(8, int(0.1 * tip.shape[1]))
    settling = _settling(np.abs(excess), BAND * np.abs(move), period)
    mode, reason = _first_abnormal(signals)
    settled = settling <= latest_settling(period * (tip.shape[1] - 1), vibration_period)
    return {
        "overshoot": np.maximum(0.0, (excess * np.sign(move)[:, None]).max(axis=1) / np.abs(move)),
        "settling_time": settling,
        "residual_vibration": _residual(tip, period, ended, vibration_period),
        "steady_state_error": (tip[:, -tenth:] - reference[:, -tenth:]).mean(axis=1),
        "peak_tip_error": np.abs(tip - reference).max(axis=1),
        "peak_voltage": np.abs(signals.voltage).max(axis=1),
        "motor_reference_noise": _noise(signals.motor_reference[:, -tenth:]),
        "saturated": ((signals.flags & _SATURATED) != 0).mean(axis=1),
        "mode": mode,
        "reason": reason,
        "passed": settled & (mode == _RUN),
    }


def _settling(distance: Real, band: Real, period: float) -> Real:
    outside = distance > band[:, None]
    length = distance.shape[1]
    last = length - 1 - np.argmax(outside[:, ::-1], axis=1)  # last sample outside, where there is one
    time = np.where(outside.any(axis=1), (last + 1.0) * period, 0.0)
    return np.where(outside[:, -1], np.inf, time)


def _residual(tip: Real, period: float, ended: Real, vibration_period: Real) -> Real:
    """Half the peak-to-peak tip angle in the two vibration periods after the reference ended."""
    time = period * np.arange(tip.shape[1])
    begin = np.searchsorted(time, ended, side="left")
    end = np.searchsorted(time, ended + 2.0 * vibration_period, side="right")
    return np.array([0.5 * np.ptp(row[b : max(e, b + 1)]) for row, b, e in zip(tip, begin, end, strict=True)])


def _noise(tail: Real) -> Real:
    """Standard deviation about a parabola: the same least squares as for one run, as one projection."""
    steps = np.linspace(-1.0, 1.0, tail.shape[1])
    basis, _ = np.linalg.qr(np.vander(steps, 3))
    return np.asarray(np.std(tail - (tail @ basis) @ basis.T, axis=1))


def _first_abnormal(signals: Signals) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Mode and reason of the first period that is not LAW_RUN; of the last one where there is none."""
    at = np.argmax(signals.mode != _RUN, axis=1)
    rows = np.arange(len(at))
    return signals.mode[rows, at], np.where(signals.mode[rows, at] == _RUN, 0, signals.reason[rows, at])
