"""The second vibration mode: what a log shows of it beside the first.

Behind the fitted mode the output may hold  gain · g₂ s²/(s² + 2 ζ ω₂ s + ω₂²) θm, the same kernel with
λ = 2. Every candidate ω₂ is a regression of the residual on that response, made orthogonal to everything
the first mode's parameters can explain: otherwise a slightly wrong λ or delay would pass for a mode.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import SecondMode
from fraclink._identify.covariance import correlation_lag, long_run_covariance
from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import Vector, Window, columns_of, mask_of

# A payload on a massive link leaves mode 2 at least 4.4 times (no payload: 6.3 times) above mode 1; between
# 2.5 and 4 times nothing but a misfit of the first mode would be found.
_LOWEST = 2.5
_HIGHEST = 0.8  # of the Nyquist frequency: the input between the samples is not known well enough beyond
_STEP, _RATIO = 0.04, 0.03  # of the scan: in ln ω₂, below the half width of a resonance with that ζ
_RATIOS = (0.005, 0.02, 0.06)
_RATIO_LIMITS = (5e-4, 0.2)  # more strongly damped, it is friction or a filter rather than a mode
# Standard deviations of its gain. The scan tries some hundred frequencies, of which noise alone makes the
# best one 3.5; the spread of a coloured residual is itself known to a third only.
_SIGNIFICANT = 6.0
_SEEN = 0.05  # a mode of this static share is one that a design must know: at ζ = 0.02 its peak is 1.25 c


def find_second_mode(
    search: Search, solution: Solution, motor_angle: Vector, whole: Vector
) -> tuple[SecondMode | None, float | None]:
    """The second mode in the residual of a fit, and else the frequency [rad/s] up to which none was seen.

    `motor_angle` and `whole` are the angle and the residual of the whole log: what the fitted part shows
    must show again in the part that was held out.
    """
    window, shape = search.window, solution.shape
    columns = columns_of(search.kernel, shape, mask_of(solution.free))
    residual = whole[: window.samples]
    basis = np.linalg.qr(np.vstack([columns, np.ones(window.samples)]).T)[0]
    low, high = math.log(_LOWEST) + shape[1], math.log(_HIGHEST * math.pi / window.period)
    if high - low < 0.5 or not np.any(residual):
        return None, None
    rest = Window(window.angle, residual, window.period, window.hold)
    kernel = rest.kernel(math.exp(low), longest_delay=search.longest_delay)

    def row(log_frequency: float, ratio: float) -> Vector:
        return np.array([2.0, log_frequency, ratio, 1.0, shape[4]])

    def response(place: Vector) -> Vector:
        column = columns_of(kernel, place)[0]
        return np.asarray(column - basis @ (basis.T @ column))

    grid = np.arange(low, high, _STEP)
    costs = kernel.costs(np.array([row(x, _RATIO) for x in grid]), math.nan, math.nan)
    lower, upper = row(low, _RATIO_LIMITS[0]), row(high, _RATIO_LIMITS[1])
    for start in grid[np.argsort(costs)[:3]]:
        starts = np.array([row(start, ratio) for ratio in _RATIOS])
        found = kernel.solve(starts, mask_of((1, 2)), lower, upper, math.nan, math.nan, 100)[1]
        at_limit = np.any(np.abs(found[1:3] - lower[1:3]) < 1e-6) or np.any(
            np.abs(found[1:3] - upper[1:3]) < 1e-6
        )
        gain, error = _regressed(residual, response(found))
        share = gain / solution.gain
        certain = not at_limit and share > 0 and abs(gain) > _SIGNIFICANT * error
        if certain and _shows_again(window, found, gain, motor_angle, whole):
            return SecondMode(math.exp(found[1]), share, float(found[2])), None
    noise = _noise(residual)
    seen = None
    for log_frequency in grid:
        size = float(np.linalg.norm(response(row(log_frequency, 0.02))))
        if _SIGNIFICANT * noise > _SEEN * abs(solution.gain) * size:
            break
        seen = math.exp(log_frequency)
    return None, seen


def _shows_again(window: Window, place: Vector, gain: float, motor_angle: Vector, whole: Vector) -> bool:
    """Whether the held-out part agrees; three standard errors there, as only one mode is on trial."""
    if whole.size - window.samples < 100:
        return True
    log = Window(motor_angle, whole, window.period, window.hold)
    column = columns_of(log.kernel(math.exp(place[1]), longest_delay=abs(place[4])), place)[0]
    again, error = _regressed(whole[window.samples :], column[window.samples :])
    return again * gain > 0 and abs(again) > 3.0 * error and 1 / 3 < again / gain < 3


def _regressed(residual: Vector, response: Vector) -> tuple[float, float]:
    """Coefficient of the response in the residual and its standard error, colour allowed for."""
    power = float(response @ response)
    gain = float(response @ residual) / power
    left = residual - gain * response
    scores: NDArray[np.float64] = (response * left)[None, :]
    lags = min(max(5 * correlation_lag(left), 10), left.size // 5)
    variance = max(float(long_run_covariance(scores, lags)[0, 0]), power * float(left @ left) / left.size)
    return gain, math.sqrt(variance) / power


def _noise(residual: Vector) -> float:
    """Standard deviation [unit of the output] of the residual as a high frequency meets it.

    Slow misfit does not hide a fast mode: the second difference, scaled to white noise, leaves it out.
    """
    return float(np.std(np.diff(residual, 2)) / math.sqrt(6.0))
