"""The verb `discretize`, and what every request for a response is checked against."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fraclink._systems.fractional import FractionalTransferFunction, Term
from fraclink._systems.fractional.checks import checked_system
from fraclink._systems.response.held import HeldQuotient
from fraclink._systems.response.modes import DiscreteModes
from fraclink._validate import checked_choice
from fraclink.errors import FieldError

__all__ = ["check_request", "delay_groups", "discretize", "held_quotient"]

HOLDS = ("zero", "first")


@lru_cache(maxsize=64)
def held_quotient(top: tuple[Term, ...], bottom: tuple[Term, ...]) -> HeldQuotient:
    """The poles and the low-frequency part of N/D, kept for the next period, hold or input."""
    return HeldQuotient.of(top, bottom)


def discretize(
    G: FractionalTransferFunction,
    period: float,
    *,
    hold: str = "zero",
    span: float,
    tolerance: float = 1e-12,
) -> DiscreteModes:
    """Return the exact held response of G at `period` as a sum of exponential modes.

    Parameters
    ----------
    G : FractionalTransferFunction
        Proper, without delays in the denominator; the numerator's terms share one delay.
    period : float
        Sampling period T > 0 [s].
    hold : {"zero", "first"}
        How the input moves between samples.
    span : float
        Longest time [s] over which the response is remembered, ≥ T.
    tolerance : float
        Wanted error of the step response relative to its peak, 1e-14 … 1e-2. Fewer modes for a larger one.

    Raises
    ------
    FieldError
        Improper G, several delays, a denominator with delays, singular powers s^-a with a ≥ 0.94 other than
        the integrator 1/s (use `time_response`, which convolves them), values out of range.

    Source: branch-cut integral by a pole-corrected trapezoid rule; see docs/explanation/numerics.md.

    >>> from fraclink._systems.fractional import s
    >>> modes = discretize(1 / (s + 1), 0.1, span=10.0)
    >>> modes.decays, modes.gains
    (array([0.90483742]), array([0.09516258]))
    """
    checked_system("G", G)
    check_request(period, hold, span, tolerance)
    groups = delay_groups(G)
    if len(groups) > 1:
        raise FieldError(
            "delay",
            sorted(groups),
            "several delays in the numerator",
            allowed="one delay common to all terms",
            remedy="discretize the parts, or use time_response",
        )
    delay, top = next(iter(groups.items()), (0.0, ()))
    held = held_quotient(top, G.denominator)
    if held.low.powers or not held.low.is_split:
        raise FieldError(
            "order",
            held.low.powers[0][1] if held.low.powers else G.denominator[-1].order,
            "a power of 1/s without a sum of modes",
            allowed="singular powers s^-a with a < 0.94, and the integrator 1/s",
            remedy="use time_response",
        )
    return held.modes(period, hold=hold, span=span, tolerance=tolerance, delay=delay)


def check_request(period: float, hold: str, span: float, tolerance: float) -> None:
    """Raise `FieldError` for a period, hold, span or tolerance out of range."""
    checked_choice("hold", hold, HOLDS, remedy='"zero" is a D/A converter')
    for name, value, low, high in (
        ("period", period, 1e-12, 1e12),
        ("span", span, period, 1e15),
        ("tolerance", tolerance, 1e-14, 1e-2),
    ):
        if not (isinstance(value, (int, float, np.number)) and low <= value <= high):
            unit = "" if name == "tolerance" else " s"
            raise FieldError(
                name, value, "out of range", allowed=f"{low:g} … {high:g}{unit}", remedy="check the unit"
            )


def delay_groups(G: FractionalTransferFunction) -> dict[float, tuple[Term, ...]]:
    """The numerator's terms by delay [s]; raises for an improper G or delays in the denominator."""
    if not G.is_proper:
        raise FieldError(
            "relative_degree",
            G.relative_degree,
            "negative: the system is improper",
            allowed="≥ 0",
            remedy="add a filter: a time response of a derivative of a step does not exist",
        )
    if any(t.delay for t in G.denominator):
        raise FieldError(
            "delay",
            max(t.delay for t in G.denominator),
            "in the denominator",
            allowed="delays in the numerator",
            remedy="use time_response, which inverts such systems numerically",
        )
    groups: dict[float, tuple[Term, ...]] = {}
    for t in G.numerator:
        groups[t.delay] = (*groups.get(t.delay, ()), Term(t.coefficient, t.order))
    return groups
