"""A uniform time base from time stamps; the row index is never used instead.

On a simulated log at 4 ms, ω₀ changed by 0.014 % when a jitter of 0.5 ms rms was
ignored, by 1.4 % when 1 % of lost samples were ignored, and by 0.002 % when these were
interpolated onto the grid. Jitter is therefore reported and tolerated, gaps are
rejected, and values are interpolated on request only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import LogError
from fraclink.findings import Finding
from fracsys.checks import Real

# Share of the samples of a log, or of a run in real time, that may be lost: interpolated,
# they change ω₀ by the 0.002 % above.
LOST_SHARE = 0.01
PRINTED = 0.01  # fraction of a period: the rounding of stamps printed with few digits
# fraction of a period: jitter that changes no parameter, see the figures above
_TOLERATED = 0.25
# [s] no vibrating arm is sampled this slowly: the stamps are milliseconds
_SLOWEST = 1.0


@dataclass(frozen=True)
class TimeBase:
    """Uniform time of an experiment: `start` + k `period` [s], and the findings about
    it.
    """

    start: float
    period: float
    findings: tuple[Finding, ...] = ()


def time_base(
    stamps: Real, *, resample: bool = False, slowest: float = _SLOWEST
) -> TimeBase:
    """The uniform time base of `stamps`, shape (N,) [s], N >= 2.

    Raises LogError for decreasing or repeated stamps, gaps, or jitter above a quarter
    of a period; with `resample` the last three are findings, and `resampled` computes
    the uniform samples. Steps of `slowest` [s] or longer are rejected.
    """
    if stamps.size < 2:
        raise LogError(
            "time",
            f"{stamps.size} stamps",
            "too few rows for a step",
            ">= 2",
            "record for longer",
        )
    steps = np.diff(stamps)
    _check_order(stamps, steps, resample)
    steps = steps[steps > 0]
    # The median is not affected if a tenth of the samples is lost or if the clock stood
    # still for a minute.
    typical = float(np.median(steps))
    if typical >= slowest:
        raise LogError(
            "time",
            f"{typical:.6g} s between samples",
            "too slow for a vibrating arm; they look like milliseconds labelled as seconds",
            f"< {slowest:g} s",
            'state unit = "ms" for the time column',
        )
    # After the check of the unit, because gaps are counted in periods.
    gaps = np.flatnonzero(steps > _longest_step(typical))
    if gaps.size:
        finding = _gap(stamps, steps, gaps, typical, resample)
        return TimeBase(float(stamps[0]), _rounded(typical), (finding,))
    if (
        steps.size + 1 < stamps.size
    ):  # repeated stamps, accepted because they are resampled
        # A sample with a repeated stamp is a whole period off.
        return TimeBase(
            float(stamps[0]), _rounded(typical), _jitter(typical, typical, resample)
        )
    # From the two ends: over N steps the rounding of a stamp is divided by N, which the
    # median of the steps does not achieve.
    start, period = (
        float(stamps[0]),
        _rounded(float((stamps[-1] - stamps[0]) / steps.size)),
    )
    if _distance(stamps, start, period) > PRINTED * period:
        # Jitter of the two end stamps would tilt the whole grid: fit a line through all
        # stamps.
        slope, middle = np.polyfit(
            np.arange(stamps.size) - (stamps.size - 1) / 2, stamps, 1
        )
        period = _rounded(float(slope))
        start = float(middle - period * (stamps.size - 1) / 2)
        # A fitted line takes two of N degrees of freedom: it fits almost any three
        # stamps.
        spare = math.sqrt(stamps.size / max(stamps.size - 2, 1))
        worst = spare * _distance(stamps, start, period)
        return TimeBase(start, period, _jitter(worst, period, resample))
    return TimeBase(start, period)


def _distance(stamps: Real, start: float, period: float) -> float:
    return float(np.max(np.abs(stamps - (start + period * np.arange(stamps.size)))))


def _rounded(period: float) -> float:
    # Stamps in text are rounded to their last digit, and so is the mean of their steps.
    return float(f"{period:.10g}")


def _check_order(stamps: Real, steps: Real, resample: bool) -> None:
    back = np.flatnonzero(steps < 0)
    if back.size:
        row = int(back[0]) + 1
        raise LogError(
            "time",
            f"{stamps[row]:.9g} s at sample {row}",
            f"decreasing (after {stamps[row - 1]:.9g} s; {back.size} such)",
            "increasing stamps",
            "sort the log, or cut it where the clock was set",
        )
    same = np.flatnonzero(steps == 0)
    if same.size == steps.size:
        raise LogError(
            "time",
            f"{stamps[0]:.9g} s",
            "constant",
            "increasing stamps",
            "state another time column",
        )
    if same.size and not resample:
        rows = ", ".join(str(int(row) + 1) for row in same[:5]) + (
            " …" if same.size > 5 else ""
        )
        raise LogError(
            "time",
            f"{stamps[same[0]]:.9g} s",
            f"repeated at sample {rows} ({same.size} such)",
            "increasing stamps",
            "remove the repeated rows, or read with resample=True (--resample)",
        )


def _longest_step(period: float) -> float:
    """The step between two stamps beyond which a sample is missing: each of the two may
    be off by the tolerance.
    """
    return (1.0 + 2.0 * _TOLERATED) * period


def _gap(
    stamps: Real,
    steps: Real,
    gaps: NDArray[np.intp],
    typical: float,
    resample: bool,
) -> Finding:
    worst = float(steps.max())
    missing = int(np.rint(steps[gaps] / typical - 1).sum())
    first = float(stamps[gaps[0]])
    if not resample:
        raise LogError(
            "time",
            f"{worst * 1e3:.6g} ms between samples, first after {first:.6g} s",
            f"not uniform: {gaps.size} gaps, about {missing} samples lost at {typical * 1e3:.6g} ms",
            f"gaps below {_longest_step(typical) * 1e3:.4g} ms",
            "record again, read a stretch without gaps (--keep), or with resample=True (--resample)",
        )
    return Finding(
        "W205",
        "warning",
        f"{gaps.size} gaps in time were bridged by interpolation",
        {
            "gaps": gaps.size,
            "lost_samples": missing,
            "longest_s": worst,
            "period_s": typical,
            "time_s": first - float(stamps[0]),
        },
        "record again if the gaps lie where the arm moves",
    )


def _jitter(worst: float, period: float, resample: bool) -> tuple[Finding, ...]:
    share = worst / period
    if share <= PRINTED:
        return ()
    numbers = f"{worst * 1e3:.4g} ms, {100 * share:.3g} % of the period"
    if share > _TOLERATED and not resample:
        raise LogError(
            "time",
            numbers,
            "not uniform (largest distance of a stamp from the uniform grid)",
            f"<= {100 * _TOLERATED:g} % of {period * 1e3:.6g} ms",
            "record with a steady clock, or read with resample=True (--resample)",
        )
    return (
        Finding(
            "W205",
            "warning" if share > _TOLERATED else "info",
            f"stamps leave the uniform grid by up to {numbers}",
            {"jitter_s": worst, "jitter_share": share, "period_s": period},
            "samples were interpolated onto the grid"
            if resample
            else "taken as uniform: this changes no parameter noticeably",
        ),
    )


def uniform_before(stamps: Real, first: int, period: float) -> slice:
    """The samples before sample `first` that lead to it in steps of `period`, without
    gaps or repeated stamps.
    """
    steps = np.diff(stamps[: first + 1])
    odd = np.flatnonzero(np.abs(steps - period) > _longest_step(period) - period)
    return slice(int(odd[-1]) + 1 if odd.size else 0, first)


def resampled(stamps: Real, base: TimeBase, values: Real) -> Real:
    """`values` interpolated linearly from their stamps onto the uniform grid of `base`."""
    # A repeated stamp keeps its first value: `np.interp` needs increasing stamps, and
    # the second value is probably a copy.
    keep = np.concatenate(([True], np.diff(stamps) > 0))
    count = int(np.floor((stamps[-1] - base.start) / base.period + 1e-6)) + 1
    grid = base.start + base.period * np.arange(count)
    return np.interp(grid, stamps[keep], values[keep])
