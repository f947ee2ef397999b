"""The link as the closed-loop kernel takes it: exact for a motor angle of degree 5 within each period.

Between two samples the motor's angle is Σ qⱼ xʲ with x = (t − kT)/T. The response of G = θt/θm to each
power is exact: at the end of its own period by the power series of G, later by the modes of the step
response (a sum of exponentials, see fraclink._systems.response).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel
from fraclink.errors import FieldError

__all__ = ["LinkWeights", "link_weights"]

POWERS = 6
LONGEST = 2.0  # |pole|·T [rad]: beyond, three samples a vibration, the power series cancels and no loop holds
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
    from fraclink._systems.response import discretize

    reach = abs(model.pole) * period
    if not reach < LONGEST:
        raise FieldError(
            "period",
            period,
            "too long for this link",
            allowed=f"< {LONGEST / abs(model.pole):.3g} s: {2 * math.pi / LONGEST:.2g} samples a vibration",
            remedy="simulate at a shorter period",
        )
    modes = discretize(model.tip(), period, span=span, tolerance=TOLERANCE)
    at_end = [_end_of_power(model, period, j) for j in range(POWERS)]
    real = modes.gains * _relative_powers(modes.log_decays)
    pair = modes.pole_gains * _relative_powers(modes.pole_log_decays)
    first = np.array(at_end) - real.sum(axis=1) - pair.sum(axis=1).real
    return LinkWeights(first, modes.decays, real, modes.pole_decays, pair)


def _end_of_power(model: LinkModel, period: float, power: int) -> float:
    """Response of G to xʲ at x = 1: G = Σ −(−X)ⁿ, X = (μ s^α + ω₀²)/s^λ, term by term: t^q/Γ(q + 1)."""
    stiff = model.natural_frequency**2 * period**model.order
    soft = model.damping * period ** (model.order - model.damping_order)
    total = 0.0
    for n in range(1, 100):
        part = 0.0
        for k in range(n + 1 if soft else 1):
            exponent = model.order * n - model.damping_order * k + power
            size = math.comb(n, k) * soft**k * stiff ** (n - k)
            part += size * math.exp(-math.lgamma(exponent + 1))
        total -= (-1) ** n * part
        if part < 1e-18 * abs(total):
            break
    return math.factorial(power) * total


def _relative_powers(log_decay: NDArray[Any]) -> NDArray[Any]:
    """φ_j/φ_0 for j = 0 ... 5, φ_j(z) = ∫₀¹ x^j e^(z(1 − x)) dx: a mode's answer to x^j, relative to a step.

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
