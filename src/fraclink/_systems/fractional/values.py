"""Values of sums of c·s^a·e^(-τs) on arrays: the arithmetic under `FractionalTransferFunction`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FieldError

Complexes = NDArray[np.complex128]


class TermLike(Protocol):
    """What a term must offer: a coefficient, an order and a delay [s]."""

    @property
    def coefficient(self) -> float: ...
    @property
    def order(self) -> float: ...
    @property
    def delay(self) -> float: ...


def evaluate(
    numerator: Sequence[TermLike], denominator: Sequence[TermLike], s: Any
) -> complex | NDArray[np.complex128]:
    """Return numerator(s)/denominator(s) on the principal sheet, in the shape of `s`."""
    points = np.asarray(s)
    if points.dtype.kind not in "biufc":
        raise FieldError(
            "s", s, "not a number", allowed="complex numbers or arrays of them", remedy="give s in rad/s"
        )
    flat = points.astype(np.complex128).ravel()
    with np.errstate(all="ignore"):
        logs = np.log(flat)
        value = _sum(numerator, flat, logs, 0.0) / _sum(denominator, flat, logs, 0.0)
        bad = ~np.isfinite(value)
        if bad.any():
            value[bad] = _extreme(numerator, denominator, flat[bad], logs[bad])
    return value.reshape(points.shape) if points.ndim else complex(value[0])


def _sum(terms: Sequence[TermLike], s: Complexes, logs: Complexes, shift: float) -> Complexes:
    total = np.zeros(s.shape, np.complex128)
    for term in terms:
        order = term.order - shift
        if order == 0.0:
            value = np.full(s.shape, term.coefficient, np.complex128)
        elif order.is_integer() and 0.0 < order <= 8.0:
            # Products of small integers are exact where they can be: (2j)² is -4 and not -4 + 5e-16j, and
            # the sign of that imaginary part would turn the phase of an undamped link by 360°.
            value = (term.coefficient * s ** int(order)).astype(np.complex128)
        else:
            value = (term.coefficient * np.exp(order * logs)).astype(np.complex128)
            value[s == 0.0] = 0.0 if order > 0.0 else np.inf
        total += value * np.exp(-term.delay * s) if term.delay else value
    return total


def _extreme(
    numerator: Sequence[TermLike], denominator: Sequence[TermLike], s: Complexes, logs: Complexes
) -> Complexes:
    """Values where the plain quotient is not finite: poles, s = 0, and |s| so large that powers overflow."""
    highest = max((t.order for t in (*numerator, *denominator)), default=0.0)
    top, bottom = _sum(numerator, s, logs, 0.0), _sum(denominator, s, logs, 0.0)
    large = np.abs(s) > 1.0
    if large.any():
        top[large] = _sum(numerator, s[large], logs[large], highest)
        bottom[large] = _sum(denominator, s[large], logs[large], highest)
    value = top / bottom
    value[(bottom == 0.0) & (top != 0.0)] = np.inf
    return value
