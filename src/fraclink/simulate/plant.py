"""The link as the closed-loop kernel takes it: exact for a cubic motor angle within each period.

Between two samples the motor's angle is q₀ + q₁x + q₂x² + q₃x³ with x = (t − kT)/T. The response of
G = θt/θm to each power is exact: at the end of its own period by inverting the Laplace transform, later by
the modes of the step response (a sum of exponentials, see fraclink.response).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FieldError
from fraclink.link import LinkModel

__all__ = ["LinkWeights", "link_weights"]

POWERS = 4
TOLERANCE = 1e-9  # of the step response: 1e-9 rad for a move of 1 rad, three digits below what is promised


@dataclass(frozen=True)
class LinkWeights:
    """Decays and weights of the link's recursion; see loop.h for the formula."""

    first: NDArray[np.float64]
    decay: NDArray[np.float64]
    weight: NDArray[np.float64]
    pair: NDArray[np.complex128]
    pair_weight: NDArray[np.complex128]


def link_weights(model: LinkModel, period: float, span: float) -> LinkWeights:
    """Return the recursion of `model`'s tip at `period` [s], valid for `span` [s].

    >>> weights = link_weights(LinkModel(1.56, 11.094, order=2.0), 0.004, 10.0)
    >>> len(weights.decay), len(weights.pair)
    (0, 1)
    """
    from fraclink.response.contour import held_response
    from fraclink.response.discrete import discretize
    from fraclink.response.held import HeldQuotient

    tip = model.tip()
    modes = discretize(tip, period, span=span, tolerance=TOLERANCE)
    quotient = HeldQuotient.of(tip.numerator, tip.denominator).quotient
    if quotient is None:
        raise FieldError(
            "model", model, "without dynamics", allowed="a LinkModel", remedy="give ϖ > 0 and λ > 1"
        )
    at_end = [
        math.factorial(j) / period**j * float(held_response(quotient, np.array([period]), j + 1)[0])
        for j in range(POWERS)
    ]
    real = modes.gains * _relative_powers(modes.log_decays)
    pair = modes.pole_gains * _relative_powers(modes.pole_log_decays)
    first = np.array(at_end) - real.sum(axis=1) - pair.sum(axis=1).real
    return LinkWeights(first, modes.decays, real, modes.pole_decays, pair)


def _relative_powers(log_decay: NDArray[Any]) -> NDArray[Any]:
    """φ_j/φ_0 for j = 0 ... 3, φ_j(z) = ∫₀¹ x^j e^(z(1 − x)) dx: a mode's answer to x^j, relative to a step.

    Where |z| is large φ_j = (j φ_(j-1) − 1)/z; that cancels for small |z|, where the series j! Σ zⁿ/(n + j
    + 1)! is used.
    """
    z = np.atleast_1d(np.asarray(log_decay))
    near = np.abs(z) < 1.0
    small = np.where(near, z, 0.0)
    large = np.where(near, 1.0, z)
    rows = []
    by_recursion = np.expm1(large) / large
    for j in range(POWERS):
        by_series = math.factorial(j) * sum(small**n / math.factorial(n + j + 1) for n in range(20))
        if j:
            by_recursion = (j * by_recursion - 1.0) / large
        rows.append(np.where(near, by_series, by_recursion))
    return np.asarray(np.array(rows) / rows[0])
