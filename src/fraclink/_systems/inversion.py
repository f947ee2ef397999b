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
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from fraclink import _kernels
from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.terms import Reals, Term
from fraclink._validate import Array, Between, checked
from fraclink.errors import FieldError, SizeError

_WINDOW = 4
_OVERSAMPLING = 8
_DECAY = 32.0  # σW: what wraps around is e^-32 = 1e-14 of the response; rounding is raised by e^(32/4)
_SHIFTS = (0.0, 4.0, 8.0, 16.0)  # tried in turn, in units of 1/span, for responses that grow


def delay_free_part(G: FractionalTransferFunction) -> FractionalTransferFunction:
    """G without the delayed terms of its denominator: its response until the first of them acts."""
    highest = G.denominator[0].order
    late = [term.delay for term in G.denominator if term.order == highest and term.delay]
    if late:
        # Its response jumps again after every delay, and a truncated series misses a jump by half of it.
        problem = "on the highest power of the denominator: the response jumps anew after each delay"
        allowed, remedy = "a highest power without delay", "add roll-off: a strictly proper loop has no jumps"
        raise FieldError("delay", max(late), problem, allowed=allowed, remedy=remedy)
    kept = tuple(term for term in G.denominator if term.delay == 0.0)
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


# --- The Grünwald–Letnikov simulation, for comparison only --------------------------------------------

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


@checked
def grunwald_letnikov(
    G: FractionalTransferFunction,
    u: Annotated[ArrayLike, Array(1, flags=True)],
    period: Annotated[float, Between(1e-12, 1e12, "s")],
) -> Reals:
    """Return the response of G to samples u by the Grünwald–Letnikov difference with full memory.

    s^a becomes T^(-a) Σ_k (-1)^k binom(a, k) z^(-k) in numerator and denominator. This is the method of
    FOMCON's `fode_sol` and of the source paper, offered for comparison: its error is of first order in the
    period, 6 % (step) to 16 % (random binary input) of full scale on a lightly damped link at 4 ms, and its
    cost is O(N²). Never use it for a plant.

    Parameters
    ----------
    G
        Without delays.
    u
        Input, shape (N,), N up to 300 000.
    period
        Sampling period, 1e-12 … 1e12 s.

    Raises
    ------
    FieldError
        Delays, or values out of range.
    SizeError
        A longer signal.

    Examples
    --------
    >>> from fraclink._systems.fractional import s
    >>> grunwald_letnikov(1 / (s + 1), [1.0, 1.0, 1.0], 1.0)  # implicit Euler: 1 - 2^-(k+1)
    array([0.5  , 0.75 , 0.875])
    """
    if any(t.delay for t in (*G.numerator, *G.denominator)):
        raise FieldError("delay", G.delay, "present", allowed="no delays", remedy="use time_response")
    values = np.ascontiguousarray(u, np.float64)
    count = len(values)
    if count > _LONGEST:
        problem = f"too many samples for a memory of all of them: {count**2:.2g} products"
        remedy = "use time_response, whose cost is linear in N"
        raise SizeError("u", count, problem, allowed=f"<= {_LONGEST}", remedy=remedy)
    driven = np.asarray(_kernels.memory_sum(_combined(G.numerator, count, period), values))
    output: Reals = np.asarray(_kernels.memory_solve(_combined(G.denominator, count, period), driven))
    return output


def _combined(terms: Sequence[Term], count: int, period: float) -> Reals:
    total = np.zeros(count)
    for t in terms:
        total += t.coefficient * period**-t.order * grunwald_letnikov_weights(t.order, count)
    return total
