"""Metrics of runs: the same figures and the same verdict for one run and for a million."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from fraclink import _kernels
from fraclink._display import Overview, Row, displayed, rows_of, state_of
from fraclink._law import MODES, REASONS
from fracsys.checks import Real

__all__ = [
    "Metrics",
    "MoveVerdict",
    "growth_per_window",
    "judge",
    "judge_many",
    "measure",
    "measure_many",
]

Bits = NDArray[np.uint32]

BAND = 0.02  # fraction of the move: the usual band of the settling time
REST_BAND = 2e-3  # [rad]: the band of "settled" for a reference that does not move
# A growing vibration differs from one driven by noise in the straightness of its
# logarithmic envelope: slope over standard error. Student's t would suffice for
# independent windows, but those of a lightly damped loop are not, hence STRAIGHT as a
# lower bound: with it none of 5000 good arms with the paper's noise is found to grow,
# nor any of 500 resonances excited by noise. The printed controller (58) reaches 20 to
# 160 in 4 s, where 18 is required.
CHANCE, STRAIGHT = 2e-4, 10.0
# vibration periods: a straight line through three points has no meaningful standard
# error
WINDOWS = 4
# share of the periods at rest: a white voltage with an RMS of half the limit reaches
# that limit in 4.6 %
_AT_LIMIT = 0.05


@dataclass(frozen=True)
class Metrics:
    """Figures of one run.

    Parameters
    ----------
    overshoot
        largest excess of the tip beyond its final reference, as a part of the move [1].
    settling_time
        time from which the tip stays within 2 % of the move [s]; infinite if it never
        does.
    residual_vibration
        half the peak-to-peak tip angle in the two vibration periods after the reference
        came to rest [rad].
    steady_state_error
        mean of tip − reference over the last tenth of the run [rad].
    peak_tip_error
        largest |tip − reference| [rad], the motor loop's lag included.
    peak_voltage
        largest |voltage| [V].
    motor_reference_noise
        standard deviation of the motor reference about a parabola in the last tenth
        [rad].
    saturated
        part of the periods with the voltage at its limit [1].
    growth
        rate at which the vibration's envelope grows [1/s]; negative where it decays, 0
        where it cannot be distinguished from noise.
    """

    overshoot: float
    settling_time: float
    residual_vibration: float
    steady_state_error: float
    peak_tip_error: float
    peak_voltage: float
    motor_reference_noise: float
    saturated: float
    growth: float

    @property
    def rows(self) -> tuple[Row, ...]:
        """The figures as shown to people and programs."""
        return rows_of(
            self,
            ("overshoot", "overshoot", "%", 3),
            Row.time("settling_time", "settles to 2 %", self.settling_time),
            ("residual_vibration", "residual vibration", "mrad"),
            ("steady_state_error", "final error", "mrad"),
            ("peak_tip_error", "", "mrad"),
            ("peak_voltage", "peak voltage", "V", 3),
            ("motor_reference_noise", "reference noise", "mrad"),
            ("saturated", "", "%"),
            ("growth", "", "1/s"),
        )


@displayed
@dataclass(frozen=True)
class MoveVerdict:
    """Whether a run passed, and why; true where it did.

    >>> bool(MoveVerdict(True, "settled")), MoveVerdict(False, "unstable: grows")
    (True, MoveVerdict(✗ failed: unstable: grows))
    """

    passed: bool
    reason: str

    def __bool__(self) -> bool:
        return self.passed

    def overview(self) -> Overview:
        """Whether it passed, and the reason."""
        return Overview(self.reason, state_of(self.passed))


@dataclass(frozen=True)
class Signals:
    """The signals by which R runs of N periods are judged, shape (R, N) each; `ended`
    (R,) is when each reference comes to rest [s], `vibration_period` (R,) that of each
    link [s].
    """

    reference: Real
    tip_angle: Real
    motor_reference: Real
    voltage: Real
    flags: Bits
    mode: Bits
    reason: Bits
    period: float
    ended: Real
    vibration_period: Real

    @staticmethod
    def of(
        signals: Mapping[str, NDArray[Any]],
        period: float,
        ended: Real | float,
        vibration_period: Real | float,
    ) -> Signals:
        """Return the judged signals from named ones, of many runs or of one."""
        channels = ("reference", "tip_angle", "motor_reference", "voltage")
        marks = ("flags", "mode", "reason")
        return Signals(
            **{name: np.atleast_2d(signals[name]) for name in (*channels, *marks)},
            period=period,
            ended=np.atleast_1d(ended),
            vibration_period=np.atleast_1d(vibration_period),
        )


def measure_many(signals: Signals) -> dict[str, Real]:
    """Return the fields of `Metrics` of every run, shape (R,) each."""
    tip, reference = signals.tip_angle, signals.reference
    final = reference[:, -1:]
    move = final[:, 0] - reference[:, 0]
    excess = tip - final
    tenth = _tenth(tip.shape[1])
    beyond = (excess * np.sign(move)[:, None]).max(axis=1)
    return {
        # In the direction of the move; without a move there is no overshoot, and
        # `settling_time` has its own band.
        "overshoot": np.maximum(
            0.0,
            np.divide(beyond, np.abs(move), out=np.zeros_like(move), where=move != 0),
        ),
        "settling_time": _settling(np.abs(excess), _band(reference), signals.period),
        "residual_vibration": _residual(signals),
        # A mean, so that neither the noise of the gauge nor a decaying vibration is
        # taken for an offset.
        "steady_state_error": (tip[:, -tenth:] - reference[:, -tenth:]).mean(axis=1),
        "peak_tip_error": np.abs(tip - reference).max(axis=1),
        "peak_voltage": np.abs(signals.voltage).max(axis=1),
        "motor_reference_noise": _noise(signals.motor_reference[:, -tenth:]),
        "saturated": ((signals.flags & _kernels.LAW_FLAG_SATURATED) != 0).mean(axis=1),
        "growth": _growth(signals),
    }


def judge_many(
    signals: Signals, metrics: dict[str, Real]
) -> dict[str, NDArray[np.generic]]:
    """Return the law's first abnormal mode and its reason (1 and 0 if there is none),
    and which runs passed.

    A run passes if the tip settled at least half a vibration period before the end (a
    tip that only passes through the band has left it again by then), the law stayed in
    its normal mode, no vibration grows, and the voltage is not at its limit when
    reference and tip are at rest: an unstable loop bounded by the voltage limit hardly
    moves the tip.
    """
    rows, at = np.arange(len(signals.tip_angle)), _first_abnormal(signals.mode)
    within = np.minimum(at, signals.mode.shape[1] - 1)
    mode = signals.mode[rows, within]
    normal = mode == _kernels.LAW_RUN
    # Half a period of the vibration: a swing of constant size that happens to end
    # inside the band was outside within that time.
    end = signals.period * (signals.tip_angle.shape[1] - 1)
    settled = metrics["settling_time"] <= end - 0.5 * signals.vibration_period
    return {
        "mode": mode,
        "reason": np.where(normal, 0, signals.reason[rows, within]).astype(np.uint32),
        "passed": settled
        & normal
        & (metrics["growth"] <= 0.0)
        & (_driven(signals) <= _AT_LIMIT)
        & np.isfinite(signals.tip_angle).all(axis=1),
    }


def measure(signals: Signals) -> Metrics:
    """Return the metrics of the one run in `signals`."""
    values = measure_many(signals)
    return Metrics(
        **{field.name: float(values[field.name][0]) for field in fields(Metrics)}
    )


def judge(signals: Signals, metrics: Metrics) -> MoveVerdict:
    """Return the verdict on the one run in `signals`, with its first cause.

    The order of causes is instability, trips, saturation, and a tip that has not
    settled.
    """
    many = judge_many(
        signals, {name: np.array([value]) for name, value in vars(metrics).items()}
    )
    if many["passed"][0]:
        return MoveVerdict(True, f"settled in {metrics.settling_time:.3g} s")
    stop = int(_first_abnormal(signals.mode)[0])
    tripped, share = stop < signals.mode.shape[1], float(_driven(signals)[0])
    at = f"at {signals.period * stop:.3g} s"
    if metrics.growth > 0.0 or not np.all(np.isfinite(signals.tip_angle)):
        cause = f"unstable: the vibration grows at {metrics.growth:.3g} 1/s"
        cause += f"; the law trips {at}" if tripped else ""
    elif tripped:
        mode, reason = MODES[int(many["mode"][0])], REASONS[int(many["reason"][0])]
        cause = f"tripped: the law goes to {mode} ({reason}) {at}"
    elif share > _AT_LIMIT:
        cause = (
            "the voltage does not come to rest: it is at its limit in "
            f"{100 * share:.0f} % of the periods after the move"
        )
    else:
        error = np.abs(signals.tip_angle[0] - signals.reference[0])
        saturated = metrics.saturated > 0.2
        cause = "saturated: the voltage is at its limit" if saturated else "not settled"
        cause += (
            f"; the tip is still {error[-_tenth(error.size) :].max():.3g} rad "
            f"away at {signals.period * (error.size - 1):.3g} s"
        )
    return MoveVerdict(False, cause)


def _tenth(count: int) -> int:
    # At least eight samples: the deviation from a parabola through fewer is not noise.
    return max(8, int(0.1 * count))


def _band(reference: Real) -> Real:
    """Half the width [rad] of the band that a settled tip stays in, shape (R,)."""
    band = BAND * np.abs(reference[:, -1] - reference[:, 0])
    return np.where(band > 0.0, band, REST_BAND)


def _settling(distance: Real, band: Real, period: float) -> Real:
    outside = distance > band[:, None]
    length = distance.shape[1]
    # Index of the last sample outside the band, if there is one: the band may be left
    # and entered any number of times.
    last = length - 1 - np.argmax(outside[:, ::-1], axis=1)
    time = np.where(outside.any(axis=1), (last + 1.0) * period, 0.0)
    return np.where(outside[:, -1], np.inf, time)


def _residual(signals: Signals) -> Real:
    length = signals.tip_angle.shape[1]
    time = signals.period * np.arange(length)
    begin = np.searchsorted(time, signals.ended, side="left")
    # Two periods: the first may start at a node of the remaining modes.
    end = np.searchsorted(
        time, signals.ended + 2.0 * signals.vibration_period, side="right"
    )
    # for a run that ends with its reference, the last tenth
    begin = np.minimum(begin, length - _tenth(length))
    rows = zip(signals.tip_angle, begin, end, strict=True)
    return np.array([0.5 * np.ptp(row[b : max(e, b + 1)]) for row, b, e in rows])


def _noise(tail: Real) -> Real:
    """Standard deviation about a parabola, which is removed by one projection."""
    steps = np.linspace(-1.0, 1.0, tail.shape[1])
    # At the end of a run the motor reference still creeps with the slow modes of the
    # correction, which is not noise.
    basis, _ = np.linalg.qr(np.vander(steps, 3))
    return np.std(tail - (tail @ basis) @ basis.T, axis=1)


def _driven(signals: Signals) -> Real:
    """Share of the last tenth with the voltage at its limit, 0 if the reference still
    moves; shape (R,).
    """
    length = signals.tip_angle.shape[1]
    tenth = _tenth(length)
    # A reference that still moves may need the full voltage.
    rests = signals.ended <= signals.period * (length - tenth)
    at_limit = (signals.flags[:, -tenth:] & _kernels.LAW_FLAG_SATURATED) != 0
    return np.where(rests, at_limit.mean(axis=1), 0.0)


def _first_abnormal(mode: Bits) -> NDArray[np.intp]:
    """Index of the first period that is not LAW_RUN, or the number of periods; shape
    (R,).
    """
    abnormal = mode != _kernels.LAW_RUN
    return np.where(abnormal.any(axis=1), np.argmax(abnormal, axis=1), mode.shape[1])


def _growth(signals: Signals) -> Real:
    stop = _first_abnormal(signals.mode)
    deviation = signals.tip_angle - signals.reference
    # One period after the end of the reference: the residual of the move itself is a
    # step of the envelope and not growth.
    begin = np.ceil((signals.ended + signals.vibration_period) / signals.period).astype(
        int
    )
    window = np.maximum(2, np.rint(signals.vibration_period / signals.period)).astype(
        int
    )
    rows = zip(deviation, begin, stop, window, strict=True)
    return np.array(
        [growth_per_window(row[b:s], w) / (w * signals.period) for row, b, s, w in rows]
    )


def growth_per_window(deviation: Real, window: int) -> float:
    """Return the growth of ln(envelope) in a vibration period of `window` samples, 0 if
    the envelope is not straight enough to be trusted.
    """
    count = len(deviation) // window
    if count < WINDOWS:
        return 0.0
    # Peak to peak in windows of one vibration period, counted back from the end: an
    # offset cancels, and the last window, which holds the largest amplitude of a
    # growing vibration, is complete.
    peaks = np.ptp(deviation[-count * window :].reshape(count, window), axis=1)
    # A vibration below 2 mrad is attributed to the sensors, however straight its
    # envelope; `not >=` because NaN is not a vibration either.
    if not peaks.max() >= REST_BAND:
        return 0.0
    # A window without motion has no logarithm: use one picoradian.
    level = np.log(np.maximum(peaks, 1e-12))
    at = np.arange(count) - 0.5 * (count - 1)
    spread = float(at @ at)
    slope = float(at @ level) / spread
    residual = level - level.mean() - slope * at
    # Standard error of the slope of a straight line through `count` points, with count
    # − 2 degrees of freedom.
    error = math.sqrt(float(residual @ residual) / ((count - 2) * spread))
    least = max(STRAIGHT, float(stdtrit(count - 2, 1.0 - CHANCE)))
    return slope if abs(slope) > least * error else 0.0
