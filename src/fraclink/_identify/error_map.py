"""The error of a fit as a function of order and resonance around it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._identify.fit import Fit
from fraclink._identify.fitting import fitted_window
from fraclink._identify.shape import chosen_hold, shape_of
from fracsys.checks import Real

__all__ = ["ErrorMap", "error_map"]


_ORDERS, _RESONANCES = 25, 25  # grid points of the map
# in λ and ln Ω: first step, smallest and largest extent of the map
_TRIED, _LEAST, _MOST = (0.01, 0.002, 0.1)
_GROWN = 0.6  # relative growth of the error at the edge of the map


@dataclass(frozen=True)
class ErrorMap:
    """Orders λ (M,), resonances Ω [rad/s] (N,), and the mean square error relative to
    the least one, (M, N).
    """

    order: Real
    resonance: Real
    ratio: Real


def error_map(log: Experiment, fit: Fit) -> ErrorMap:
    """Return the error of the fitted part around the fit as a function of the link's
    order and resonance.

    Gain and offset are optimal at every point; damping and delay remain those of the
    fit. A ratio of 1 is the minimum of the map: with a long and narrow valley, the log
    does not determine a combination of the two.

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
    # The grid of rates extends down to the lowest resonance of the map; otherwise its
    # edge would be wrong.
    kernel = window.kernel(math.exp(best[1] - _MOST), longest_delay=abs(fit.delay))
    # A parabola through the best point and a neighbour predicts where the error has
    # grown enough.
    beside = best + _TRIED * np.array(
        [[0.0] * 5, [-1.0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0]]
    )
    least, *grown = kernel.costs(beside, math.nan, math.nan)
    # A direction without growth ends at _MOST, since a parabola without curvature
    # extends to infinity.
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
