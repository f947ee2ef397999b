"""The Grünwald-Letnikov sums, as a reference: FOMCON's `fode_sol` and `lsim`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from fracsys import FractionalTransferFunction
from fracsys._terms import Term

Real = NDArray[np.float64]


def grunwald_letnikov(
    G: FractionalTransferFunction, u: Real, period: float
) -> NDArray[np.float64]:
    """Response of G, without delays, to samples u by differences with full memory.

    s^a becomes T^(-a) Σ_k (-1)^k binom(a, k) z^(-k) in numerator and denominator, a
    filter with as many coefficients as samples: O(N²), of first order in the period.
    """
    top, bottom = (
        _weights(terms, len(u), period) for terms in (G.numerator, G.denominator)
    )
    return np.asarray(lfilter(top, bottom, u))


def _weights(terms: Sequence[Term], count: int, period: float) -> Real:
    k = np.arange(1.0, count)
    return np.asarray(
        sum(
            t.coefficient
            * period**-t.order
            * np.concatenate([[1.0], np.cumprod(1.0 - (t.order + 1.0) / k)])
            for t in terms
        )
    )
