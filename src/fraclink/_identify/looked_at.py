"""What a fit is looked at with: responses of log and model, their coherence, the error
around the best.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._identify.fit import Fit
from fraclink._identify.fitting import fitted_window
from fraclink._identify.shape import chosen_hold, shape_of

__all__ = ["ErrorMap", "WelchResponse", "error_map", "welch_response"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SEGMENTS = 8  # of half-overlapping ones 15: a coherence of 0.3 is then no accident
_ORDERS, _RESONANCES = 25, 25  # points of the map
_TRIED, _LEAST, _MOST = (
    0.01,
    0.002,
    0.1,
)  # of λ and of ln Ω: first step, least and greatest reach of the map
_GROWN = 0.6  # of the error, by which it has grown where the map ends


@dataclass(frozen=True)
class WelchResponse:
    """Frequency [rad/s], responses of log and model from the motor's angle, the
    coherence; shape (N,).
    """

    frequency: Real
    measured: Complex
    predicted: Complex
    coherence: Real


def welch_response(log: Experiment, fit: Fit) -> WelchResponse:
    """Return the averaged responses (Welch) of what was measured and of what the fit
    predicts.

        H = P_yu / P_uu,    γ² = |P_yu|² / (P_uu P_yy)

    Both go through the same windows, so that what these do to a sharp resonance they do
    to both. Frequencies at which the motor moved less than a thousandth of the most are
    left out.

    >>> from fraclink._identify import identify
    >>> from fraclink._reading.reading import bundled_log, read_log
    >>> log = read_log(bundled_log("prbs_30g"))
    >>> found = welch_response(log, identify(log, details=False))
    >>> told = found.coherence > 0.9  # elsewhere the noise has the peaks
    >>> round(float(found.frequency[told][np.argmax(np.abs(found.measured[told]))]))
    16
    """
    # Half-overlapping: a Hann window forgets the ends of a segment, which lie in the
    # middle of the next.
    size = 2 * (log.output.size // (_SEGMENTS + 1))
    starts = range(0, log.output.size - size + 1, size // 2)
    window = np.hanning(size)
    signals = (log.motor_angle, log.output, np.asarray(fit.predicted))

    def spectra(signal: Real) -> Complex:
        parts = np.stack([signal[k : k + size] for k in starts])
        return np.asarray(
            np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window)[:, 1:]
        )

    u, y, model = map(spectra, signals)
    power = np.mean(np.abs(u) ** 2, axis=0)
    # A thousandth in amplitude: below, the ratio is the gauge's noise over an
    # encoder's.
    moved = power > 1e-6 * power.max()
    cross = np.mean(y * u.conj(), axis=0)
    heard = np.maximum(power * np.mean(np.abs(y) ** 2, axis=0), 1e-300)
    other = np.mean(model * u.conj(), axis=0)
    frequency = 2.0 * math.pi * np.arange(1, power.size + 1) / (size * log.period)
    with np.errstate(divide="ignore", invalid="ignore"):
        return WelchResponse(
            frequency[moved],
            (cross / power)[moved],
            (other / power)[moved],
            np.minimum(np.abs(cross) ** 2 / heard, 1.0)[moved],
        )


@dataclass(frozen=True)
class ErrorMap:
    """Orders λ (M,), resonances Ω [rad/s] (N,), and the mean square error over the
    least one, (M, N).
    """

    order: Real
    resonance: Real
    ratio: Real


def error_map(log: Experiment, fit: Fit) -> ErrorMap:
    """Return how the error of the fitted part grows around the fit, in the link's order
    and resonance.

    Gain and offset are the best ones at every point; damping and delay stay those of
    the fit. Ratio 1 is the least of the map: where the valley is long and narrow the
    log leaves a combination of the two open.

    >>> from fraclink._identify import identify
    >>> from fraclink._reading.reading import bundled_log, read_log
    >>> log = read_log(bundled_log("prbs_30g"))
    >>> fit = identify(log, details=False)
    >>> found = error_map(log, fit)
    >>> row, column = np.unravel_index(np.argmin(found.ratio), found.ratio.shape)
    >>> bool(abs(found.order[row] - fit.model.order) < 0.01)
    True
    """
    count = fit.fitted_samples
    window = fitted_window(log, count, chosen_hold(log.motor_angle, "auto"))
    best = shape_of(fit.model, fit.delay)
    # The grid of rates reaches down to the lowest resonance of the map, or its edge
    # would be wrong.
    kernel = window.kernel(math.exp(best[1] - _MOST), longest_delay=abs(fit.delay))
    # A parabola through the best point and one beside it says where the error will have
    # grown enough.
    beside = best + _TRIED * np.array(
        [[0.0] * 5, [-1.0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0]]
    )
    least, *grown = kernel.costs(beside, math.nan, math.nan)
    # A direction in which nothing grows is cut at _MOST: a parabola without curvature
    # reaches anywhere.
    shares = np.maximum(np.array(grown) / least - 1.0, 1e-6)
    reach = np.clip(_TRIED * np.sqrt(_GROWN / shares), _LEAST, _MOST)
    orders = np.linspace(
        max(best[0] - reach[0], 1.0), min(best[0] + reach[0], 2.0), _ORDERS
    )
    resonances = best[1] + np.linspace(-reach[1], reach[1], _RESONANCES)
    shapes = np.array(
        [[order, place, *best[2:]] for order in orders for place in resonances]
    )
    costs = kernel.costs(shapes, math.nan, math.nan).reshape(_ORDERS, _RESONANCES)
    return ErrorMap(orders, np.exp(resonances), costs / np.min(costs))
