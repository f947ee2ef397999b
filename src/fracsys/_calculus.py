"""Derivatives and integrals of any order of a sampled signal."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.special import beta

from fracsys._contour import convolve
from fracsys.checks import Array, Real, above, checked
from fracsys.errors import FieldError

Samples = Annotated[ArrayLike, Array(1, min_size=4)]
# The second derivative of a cubic spline is continuous, its third only piecewise
# constant.
DerivativeOrder = Annotated[float, above(0.0, 2.0)]
IntegralOrder = Annotated[float, above(0.0, 20.0)]
Definition = Literal["caputo", "riemann-liouville"]

# On every interval but the last, the singularity of the kernel is at least one period
# away. Each Gauss-Legendre node then gains a factor of 5.8²; sixteen nodes reach 1e-24.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


@checked
def integral(t: Samples, y: Samples, order: IntegralOrder) -> Real:
    """Return the fractional integral of a sampled signal at every sample, shape (N,).

    (I^a y)(t) = 1/Γ(a) ∫ (t − τ)^(a−1) y(τ) dτ over τ from t[0] to t, with the cubic
    spline through the samples for y, integrated exactly.

    Parameters
    ----------
    t
        Equally spaced times, shape (N,), N >= 4.
    y
        The signal, shape (N,).
    order
        a, 0 < a <= 20; 1 is the usual integral.

    Raises
    ------
    FieldError
        Times that are not uniform, t and y of different lengths, an order out of range.

    References
    ----------
    Diethelm, The Analysis of Fractional Differential Equations (2010), section 2.1.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> print(f"{integral(t, t, 0.5)[-1]:.12f} {4 / 3 / np.sqrt(np.pi):.12f}")
    0.752252778064 0.752252778064
    """
    spline, period = _spline(t, y)
    return _integrated(spline.c, period, order)


@checked
def derivative(
    t: Samples, y: Samples, order: DerivativeOrder, *, definition: Definition = "caputo"
) -> Real:
    """Return the fractional derivative of a sampled signal at every sample, shape (N,).

    (D^a y)(t) = (I^(n−a) y^(n))(t), n − 1 < a <= n, Caputo's derivative from the first
    sample on, with the cubic spline through the samples for y.

    Parameters
    ----------
    t
        Times with the period T, shape (N,), N >= 4.
    y
        The signal, shape (N,). Noise of standard deviation σ becomes noise of about σ
        T^(−a): filter a measured signal first.
    order
        a, 0 < a <= 2.
    definition
        "caputo", or "riemann-liouville", the effect of s^a on a signal that is zero
        before its first sample: it adds y(t[0]) (t − t[0])^(−a)/Γ(1 − a) and, for a >
        1, y'(t[0]) (t − t[0])^(1−a)/Γ(2 − a), which are infinite at the first sample.

    Raises
    ------
    FieldError
        Times that are not uniform, t and y of different lengths, an order out of range.

    Notes
    -----
    The error is that of the spline's derivatives: O(T³) for a <= 1 and O(T²) above,
    where y is smooth.

    References
    ----------
    Diethelm, The Analysis of Fractional Differential Equations (2010), chapters 2, 3.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> print(f"{derivative(t, t**2, 0.5)[-1]:.12f} {8 / 3 / np.sqrt(np.pi):.12f}")
    1.504505556127 1.504505556127
    """
    spline, period = _spline(t, y)
    count = math.ceil(order)
    slopes = spline.derivative(count)
    if count == order:
        return slopes(spline.x)
    result = _integrated(slopes.c, period, count - order)
    if definition == "riemann-liouville":
        late = spline.x - spline.x[0]
        for k in range(count):
            first = float(spline(spline.x[0], k))
            if first:
                with np.errstate(divide="ignore"):
                    result += first * late ** (k - order) / math.gamma(k + 1 - order)
    return result


def _spline(t: ArrayLike, y: ArrayLike) -> tuple[CubicSpline, float]:
    """The cubic spline through the samples, and their period."""
    times, values = np.asarray(t, np.float64), np.asarray(y, np.float64)
    if times.size != values.size:
        raise FieldError(
            "y",
            values.size,
            "not one for each time",
            str(times.size),
            "give t and y of one length",
        )
    period = float(times[-1] - times[0]) / (times.size - 1)
    gaps = np.diff(times)
    if not period > 0.0 or not np.allclose(gaps, period, atol=0.0):
        raise FieldError(
            "t",
            [float(gaps.min()), float(gaps.max())],
            "not uniform: the shortest and the longest step differ",
            "one period between all times",
            "interpolate: np.interp(uniform, t, y)",
        )
    return CubicSpline(times[0] + period * np.arange(times.size), values), period


def _integrated(pieces: Real, period: float, order: float) -> Real:
    """The integral of order a of Σ_m c_m s^m on every interval, at all samples.

    `pieces` are the coefficients c of a `scipy.interpolate.PPoly`: shape (degree + 1, N
    − 1), highest power first.
    """
    count = pieces.shape[1]
    # For an interval that lies n periods in the past: ∫ (n − s)^(a−1) s^m ds, s from 0
    # to 1.
    nodes, weights = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS
    kernel = (np.arange(1.0, count + 1.0)[:, None] - nodes) ** (order - 1.0) * weights
    result = np.zeros(count + 1)
    for power, coefficients in enumerate(pieces[::-1]):
        row = kernel @ nodes**power
        row[0] = beta(power + 1.0, order)
        scale = period ** (order + power) / math.gamma(order)
        result[1:] += scale * convolve(row, coefficients)[:count]
    return result
