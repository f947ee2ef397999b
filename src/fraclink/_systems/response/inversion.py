"""Numerical inversion for functions without a sum of modes: delays in the denominator, poles not certified.

    f(t) = e^(σt)/W · [F(σ) + 2 Re Σ_k F(σ + jkω₀) e^(jkω₀t)],   ω₀ = 2π/W,

by one FFT on a window W of four spans, so that e^(-σW) kills what wraps around. The delay-free part of G has
an exact response and is taken off first: what is left falls about twice as fast at high frequency, so that
the truncated series converges. The error is estimated by a second inversion with another σ and half the
frequencies.

Source: Dubner and Abate, J. ACM 15 (1968) 115, with the aliasing controlled as by Crump (1976).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink.errors import FieldError

__all__ = ["delay_free_part", "feedthrough", "invert"]

Reals = NDArray[np.float64]

_WINDOW = 4
_OVERSAMPLING = 8
_DECAY = 32.0  # σW: what wraps around is e^-32 = 1e-14 of the response; rounding is raised by e^(32/4)
_SHIFTS = (0.0, 4.0, 8.0, 16.0)  # tried in turn, in units of 1/span, for responses that grow


def delay_free_part(G: FractionalTransferFunction) -> FractionalTransferFunction:
    """G without the delayed terms of its denominator: its response until the first of them acts."""
    leading = G.denominator[0]
    kept = tuple(t for t in G.denominator if t.delay == 0.0)
    if leading.delay != 0.0 or not kept:
        raise FieldError(
            "delay",
            leading.delay,
            "on the highest power of the denominator",
            allowed="a highest power without delay",
            remedy="such a system answers before its input or has no response from rest",
        )
    return FractionalTransferFunction(G.numerator, kept)


def feedthrough(G: FractionalTransferFunction) -> FractionalTransferFunction:
    """The direct part of G, which jumps with the input: what of G does not fall at high frequency."""
    order = G.denominator[0].order
    leading = tuple(t for t in G.numerator if t.order == order)
    return FractionalTransferFunction(leading, G.denominator[:1])


def invert(
    G: FractionalTransferFunction, exact: FractionalTransferFunction, count: int, period: float, degree: int
) -> tuple[Reals, float]:
    """Response of G - `exact` to a step (degree 1) or ramp (2) at k·period, k < count, and its error."""
    best, smallest = np.zeros(count), math.inf
    for shift in _SHIFTS:
        sigma = _DECAY / (_WINDOW * count * period) + shift / (count * period)
        fine = _series(G, exact, count, period, degree, sigma, _OVERSAMPLING)
        coarse = _series(G, exact, count, period, degree, 1.3 * sigma, _OVERSAMPLING // 2)
        error = float(np.max(np.abs(fine - coarse), initial=0.0))
        if error < smallest:
            best, smallest = fine, error
        if error <= 1e-7 * float(np.max(np.abs(fine), initial=0.0)):
            break
    return best, smallest


def _series(
    G: FractionalTransferFunction,
    exact: FractionalTransferFunction,
    count: int,
    period: float,
    degree: int,
    sigma: float,
    oversampling: int,
) -> Reals:
    size = 1 << (_WINDOW * count * oversampling - 1).bit_length()
    step = period / oversampling
    s = sigma + 2j * math.pi / (size * step) * np.arange(size // 2 + 1)
    spectrum = (G(s) - exact(s)) / s**degree
    values = np.fft.irfft(spectrum, size) / step
    times = np.arange(count) * period
    result: Reals = values[: count * oversampling : oversampling] * np.exp(sigma * times)
    return result
