"""From stamps to a uniform time base: the stamps are used, never the index.

On a simulated log 0.5 ms rms of jitter at 4 ms taken
as uniform moved ω₀ by 0.014 %, 1 % of lost samples taken as uniform by 1.4 %, the same
interpolated onto the grid by 0.002 %. So jitter is reported and tolerated, gaps are
refused, and values are interpolated on request only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import LogError
from fraclink.findings import Finding

_SILENT = 0.01  # of a period: stamps printed with a few digits
_TOLERATED = 0.25  # of a period: jitter that moves no parameter, see the figures above
_GAP = 1.5  # periods between stamps: a sample is missing
_SLOWEST = (
    1.0  # s: no vibrating arm is sampled that slowly; milliseconds called seconds
)


@dataclass(frozen=True)
class TimeBase:
    """Uniform time of an experiment: `start` + k `period` [s], with what was found on
    the way.
    """

    start: float
    period: float
    findings: tuple[Finding, ...] = ()


def time_base(
    stamps: NDArray[np.float64], *, resample: bool = False, slowest: float = _SLOWEST
) -> TimeBase:
    """The uniform time base of `stamps`, shape (N,) [s], N >= 2.

    Raises LogError for decreasing or repeated stamps, gaps, or jitter above a quarter
    of a period; with `resample` the last three are findings, and `resampled` makes the
    uniform samples. `slowest` [s]: steps of it and longer are refused.
    """
    if stamps.size < 2:
        raise LogError(
            "time",
            f"{stamps.size} stamps",
            "too few rows for a step",
            allowed=">= 2",
            remedy="record for longer",
        )
    steps = np.diff(stamps)
    _check_order(stamps, steps, resample)
    steps = steps[steps > 0]
    # The median: a tenth of the samples may be lost, or the clock may have stood for a
    # minute, and it does not move.
    typical = float(np.median(steps))
    if typical >= slowest:
        raise LogError(
            "time",
            f"{typical:.6g} s between samples",
            "too slow for a vibrating arm; it looks like milliseconds called seconds",
            allowed=f"< {slowest:g} s",
            remedy='state unit = "ms" for the time column',
        )
    # Behind the check of the unit: a gap is counted in periods, and these must be
    # right.
    gaps = np.flatnonzero(steps > _GAP * typical)
    if gaps.size:
        finding = _gap(stamps, steps, gaps, typical, resample)
        return TimeBase(float(stamps[0]), _rounded(typical), (finding,))
    if (
        steps.size + 1 < stamps.size
    ):  # repeated stamps, accepted because they are resampled
        # A sample that repeats its stamp is a whole period off its place.
        return TimeBase(
            float(stamps[0]), _rounded(typical), _jitter(typical, typical, resample)
        )
    # From the two ends: N steps average a stamp's rounding down by N, which a median of
    # steps does not.
    start, period = (
        float(stamps[0]),
        _rounded(float((stamps[-1] - stamps[0]) / steps.size)),
    )
    if _distance(stamps, start, period) > _SILENT * period:
        # Jitter of the two end stamps would tilt the whole grid: take the line through
        # all of them.
        slope, middle = np.polyfit(
            np.arange(stamps.size) - (stamps.size - 1) / 2, stamps, 1
        )
        period = _rounded(float(slope))
        start = float(middle - period * (stamps.size - 1) / 2)
        # A line leaves N - 2 of N stamps free: of three it follows almost any.
        spare = math.sqrt(stamps.size / max(stamps.size - 2, 1))
        worst = spare * _distance(stamps, start, period)
        return TimeBase(start, period, _jitter(worst, period, resample))
    return TimeBase(start, period)


def _distance(stamps: NDArray[np.float64], start: float, period: float) -> float:
    return float(np.max(np.abs(stamps - (start + period * np.arange(stamps.size)))))


def _rounded(period: float) -> float:
    # Text stamps carry the rounding of their last digit, and the mean of their steps
    # carries it on.
    return float(f"{period:.10g}")


def _check_order(
    stamps: NDArray[np.float64], steps: NDArray[np.float64], resample: bool
) -> None:
    back = np.flatnonzero(steps < 0)
    if back.size:
        row = int(back[0]) + 1
        raise LogError(
            "time",
            f"{stamps[row]:.9g} s at sample {row}",
            f"decreasing (after {stamps[row - 1]:.9g} s; {back.size} such)",
            allowed="increasing stamps",
            remedy="sort the log, or cut it where the clock was set",
        )
    same = np.flatnonzero(steps == 0)
    if same.size == steps.size:
        raise LogError(
            "time",
            f"{stamps[0]:.9g} s",
            "constant",
            allowed="increasing stamps",
            remedy="state another time column",
        )
    if same.size and not resample:
        rows = ", ".join(str(int(row) + 1) for row in same[:5]) + (
            " …" if same.size > 5 else ""
        )
        raise LogError(
            "time",
            f"{stamps[same[0]]:.9g} s",
            f"repeated at sample {rows} ({same.size} such)",
            allowed="increasing stamps",
            remedy="remove the repeated rows, or read with resample=True (--resample)",
        )


def _gap(
    stamps: NDArray[np.float64],
    steps: NDArray[np.float64],
    gaps: NDArray[np.intp],
    typical: float,
    resample: bool,
) -> Finding:
    worst = float(steps.max())
    lost = int(np.rint(steps[gaps] / typical - 1).sum())
    first = float(stamps[gaps[0]])
    if not resample:
        raise LogError(
            "time",
            f"{worst * 1e3:.6g} ms between samples, first after {first:.6g} s",
            f"not uniform: {gaps.size} gaps, about {lost} samples lost at {typical * 1e3:.6g} ms",
            allowed=f"gaps below {_GAP * typical * 1e3:.4g} ms",
            remedy="record again, read a stretch without gaps (--keep), or with resample=True (--resample)",
        )
    return Finding(
        "W205",
        "warning",
        f"{gaps.size} gaps in time were bridged by interpolation",
        {
            "gaps": gaps.size,
            "lost_samples": lost,
            "longest_s": worst,
            "period_s": typical,
            "time_s": first - float(stamps[0]),
        },
        "record again if the gaps lie where the arm moves",
    )


def _jitter(worst: float, period: float, resample: bool) -> tuple[Finding, ...]:
    share = worst / period
    if share <= _SILENT:
        return ()
    numbers = f"{worst * 1e3:.4g} ms, {100 * share:.3g} % of the period"
    if share > _TOLERATED and not resample:
        raise LogError(
            "time",
            numbers,
            "not uniform (largest distance of a stamp from the uniform grid)",
            allowed=f"<= {100 * _TOLERATED:g} % of {period * 1e3:.6g} ms",
            remedy="record with a steady clock, or read with resample=True (--resample)",
        )
    return (
        Finding(
            "W205",
            "warning" if share > _TOLERATED else "info",
            f"stamps leave the uniform grid by up to {numbers}",
            {"jitter_s": worst, "jitter_share": share, "period_s": period},
            "samples were interpolated onto the grid"
            if resample
            else "taken as uniform: this moves no parameter",
        ),
    )


def uniform_before(stamps: NDArray[np.float64], first: int, period: float) -> slice:
    """The samples before sample `first` that go on to it in steps of `period`, without
    gap or repeat.
    """
    steps = np.diff(stamps[: first + 1])
    # Two stamps may each be off by what one may be.
    odd = np.flatnonzero(np.abs(steps - period) > 2 * _TOLERATED * period)
    return slice(int(odd[-1]) + 1 if odd.size else 0, first)


def resampled(
    stamps: NDArray[np.float64], base: TimeBase, values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """`values` interpolated linearly from their stamps onto the uniform grid of `base`."""
    # A repeated stamp keeps its first value: `np.interp` needs rising places, and the
    # second is as likely a copy.
    keep = np.concatenate(([True], np.diff(stamps) > 0))
    count = int(np.floor((stamps[-1] - base.start) / base.period + 1e-6)) + 1
    grid = base.start + base.period * np.arange(count)
    return np.asarray(np.interp(grid, stamps[keep], values[keep]), dtype=np.float64)
