"""The Grünwald–Letnikov simulation, for comparison only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink import _kernels
from fraclink._systems.fractional import FractionalTransferFunction, Term
from fraclink._systems.fractional.checks import checked_system
from fraclink._systems.response.checks import samples
from fraclink._validate import checked_between
from fraclink.errors import FieldError, SizeError

__all__ = ["grunwald_letnikov", "grunwald_letnikov_weights"]

Reals = NDArray[np.float64]
_LONGEST = 300_000  # samples: N²/2 products of each of two sums, half a minute of one core


def grunwald_letnikov_weights(order: float, count: int) -> Reals:
    """Return (-1)^k binom(order, k), k = 0 … count-1.

    h^(-order) Σ weights_k u(t - kh) approximates the derivative of that order of u.

    >>> grunwald_letnikov_weights(0.5, 4)
    array([ 1.    , -0.5   , -0.125 , -0.0625])
    """
    k = np.arange(1.0, count)
    weights: Reals = np.concatenate(([1.0], np.cumprod(1.0 - (order + 1.0) / k)))[:count]
    return weights


def grunwald_letnikov(G: FractionalTransferFunction, u: ArrayLike, period: float) -> Reals:
    """Return the response of G to samples u by the Grünwald–Letnikov difference with full memory.

    s^a becomes T^(-a) Σ_k (-1)^k binom(a, k) z^(-k) in numerator and denominator. This is the method of
    FOMCON's `fode_sol` and of the source paper, offered for comparison: its error is of first order in the
    period, 6 % (step) to 16 % (random binary input) of full scale on a lightly damped link at 4 ms, and its
    cost is O(N²). Never use it for a plant.

    Parameters: G without delays; u of shape (N,), N up to 300 000, finite; `period` > 0 [s]. Returns y of
    shape (N,). Raises `FieldError` for delays and values out of range, `SizeError` for longer signals.

    >>> from fraclink._systems.fractional import s
    >>> grunwald_letnikov(1 / (s + 1), [1.0, 1.0, 1.0], 1.0)  # implicit Euler: 1 - 2^-(k+1)
    array([0.5  , 0.75 , 0.875])
    """
    checked_system("G", G)
    if any(t.delay for t in (*G.numerator, *G.denominator)):
        raise FieldError("delay", G.delay, "present", allowed="no delays", remedy="use time_response")
    period = checked_between("period", period, 1e-12, 1e12, "s")
    values = samples(u)
    count = len(values)
    if count > _LONGEST:
        raise SizeError(
            "u",
            count,
            f"too many samples for a memory of all of them: {count**2:.2g} products",
            allowed=f"<= {_LONGEST}",
            remedy="use time_response, whose cost is linear in N",
        )
    driven = np.asarray(_kernels.memory_sum(_combined(G.numerator, count, period), values))
    output: Reals = np.asarray(_kernels.memory_solve(_combined(G.denominator, count, period), driven))
    return output


def _combined(terms: Sequence[Term], count: int, period: float) -> Reals:
    total = np.zeros(count)
    for t in terms:
        total += t.coefficient * period**-t.order * grunwald_letnikov_weights(t.order, count)
    return total
