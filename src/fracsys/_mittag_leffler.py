"""The Mittag-Leffler function E_{α,β}(z) at complex points, by one contour integral
with exact poles.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import rgamma

from fracsys._contour import GRIDS, best_offset, place, pole_weight
from fracsys._precision import EPSILON, FOLDS
from fracsys._terms import TOGETHER
from fracsys.checks import Between, Complex, Real, checked
from fracsys.errors import FieldError, value_text

# The parabola s = μ(1 + iu)² crosses the real axis at μ. Rounding grows by e^μ; a
# smaller μ takes more nodes for the same truncation.
_VERTEX = 2.0


@checked
def mittag_leffler(
    z: ArrayLike,
    alpha: Annotated[float, Between(0.02, 20.0)],
    *,
    beta: Annotated[float, Between(-1.0, 100.0)] = 1.0,
) -> Any:
    """Return the Mittag-Leffler function of one or two parameters, at real or complex
    points of any shape.

    E_{α,β}(z) = Σ_{k≥0} z^k/Γ(αk + β)

    E_{1,1} = e^z, E_{2,1}(−x²) = cos x, E_{1/2,1}(−x) = e^(x²) erfc x. t^(β−1)
    E_{α,β}(λ t^α) is the impulse response of s^(α−β)/(s^α − λ). The error is at most
    1e-13, relative where |E| ≥ 1 and absolute elsewhere, up to |z|^(1/α) = 100 and,
    where |arg z| ≥ απ/2, for every z. Beyond, E grows like exp(z^(1/α)) and its
    relative error like 1e-15·|z|^(1/α): the argument of the exponential is rounded. For
    α > 2 E oscillates between large values, and the bound is relative to that
    amplitude, not to E itself near its zeros. Values beyond the range of doubles are
    infinite. Real points give real values.

    Parameters
    ----------
    z
        A number or an array of any shape [1].
    alpha
        α, 0.02 … 20.
    beta
        β, −1 … 100.

    Raises
    ------
    FieldError
        α or β out of range, z not a finite number.

    Notes
    -----
    E is the inverse Laplace transform of s^(α−β)/(s^α − z) at t = 1, computed by the
    trapezoidal rule on a parabola. Each pole z^(1/α) of the principal sheet
    enters with its residue times 1/(1 − exp(−2πi u_p/h)): 1 outside the parabola, 0
    deep inside, and exact in between.

    References
    ----------
    Gorenflo, Kilbas, Mainardi, Rogosin, Mittag-Leffler Functions (2014), eq. (4.1.1)
    and (4.9.3); Weideman and Trefethen, Math. Comp. 76 (2007) 1341, for the parabola.

    Examples
    --------
    >>> mittag_leffler([0.0, -1.0], 1.0).round(12).tolist()
    [1.0, 0.367879441171]
    >>> print(f"{mittag_leffler(-4.0, 0.5):.12f}, {mittag_leffler(2j, 1.5, beta=2.0):.9f}")
    0.136999457625, 0.836490341+0.574280690j
    """
    points = _numbers(z)
    flat = points.astype(np.complex128).ravel()
    # Where z² is lost in rounding, two terms of the series are exact; 1/Γ is 0 at the
    # poles of Γ, without a special case.
    value = rgamma(beta) + flat * rgamma(alpha + beta)
    far = np.flatnonzero(np.abs(flat) > EPSILON)
    with np.errstate(all="ignore"):
        for start in range(0, len(far), TOGETHER):
            part = far[start : start + TOGETHER]
            value[part] = _values(flat[part], alpha, beta)
    shaped = value.reshape(points.shape)
    result = (
        shaped
        if points.dtype.kind == "c"
        else np.where(np.isnan(shaped.real), np.inf, shaped.real)
    )
    return result if points.ndim else result[()]


def _numbers(z: ArrayLike) -> NDArray[Any]:
    try:
        numbers = np.asarray(z)
    except ValueError:  # rows of several lengths
        numbers = np.array(None)
    if numbers.dtype.kind not in "biufc" or not np.all(np.isfinite(numbers)):
        raise FieldError(
            "z",
            value_text(z),
            "not finite numbers",
            "finite real or complex numbers",
            "give one number, or an array without NaN",
        )
    return numbers


def _values(z: Complex, alpha: float, beta: float) -> Complex:
    """E_{α,β} at points other than 0."""
    step, count, inside = _rule(beta)
    logs, places = _poles(z, alpha)
    # A pole close to a node causes two large terms that cancel; take the offset
    # farthest from all poles.
    offset = best_offset(places / step)
    total = np.empty(z.shape, np.complex128)
    for o in GRIDS:
        at = offset == o
        u = (np.arange(-count - 1, count + 2) + o) * step
        log_s = math.log(_VERTEX) + 2.0 * np.log(1.0 + 1j * u)
        weights = (
            step
            * _VERTEX
            / math.pi
            * (1.0 + 1j * u)
            * np.exp(np.exp(log_s) + (alpha - beta) * log_s)
        )
        # Points with the same offset have the same nodes: one row of exponentials
        # serves all of them.
        total[at] = (weights / _denominator(log_s, z[at, None], alpha)).sum(axis=1)
    kernel = pole_weight(places, offset, step)
    residues = np.exp(np.exp(logs) + (1.0 - beta) * logs) / alpha
    enclosed = places.imag < inside  # False where there is no pole (nan)
    return total + np.where(enclosed, kernel * residues, 0.0).sum(axis=0)


def _denominator(log_s: Complex, z: Complex, alpha: float) -> Complex:
    """s^α − z. For small α the whole parabola lies close to the pole, and the plain
    difference would lose a factor of 1/α in precision.
    """
    # Cancellation occurs only for z near s^α. Near z = 0 there is none, and ln z would
    # amplify the rounding without bound.
    difference = z * np.expm1(alpha * log_s - np.log(z))
    return np.where(np.abs(z) > 0.1, difference, np.exp(alpha * log_s) - z)


def _poles(z: Complex, alpha: float) -> tuple[Complex, Complex]:
    """ln of each pole z^(1/α) on the principal sheet and its position u, both of shape
    (poles, points); NaN where there is no pole.
    """
    size, error = _modulus(z)
    # Both 1/α and |z| are rounded; the first error is multiplied by ln z, the second by
    # 1/α.
    inverse = 1.0 / alpha
    defect = float(Fraction(1) / Fraction(alpha) - Fraction(inverse))
    radius = size**inverse * (1.0 + defect * np.log(size) + inverse * error)
    # z^(1/α) has an argument within ±π for this many branches of z; for α < 1 there is
    # at most one pole.
    turns = math.ceil(0.5 * alpha)
    angles = (np.angle(z) + math.tau * np.arange(-turns, turns + 1)[:, None]) / alpha
    angles = np.where(np.abs(angles) <= math.pi, angles, np.nan)
    logs = np.log(radius) + 1j * angles
    return logs, place(logs, math.log(_VERTEX))


def _modulus(z: Complex) -> tuple[Real, Real]:
    """|z| and its relative rounding error."""
    size = np.abs(z)
    exponent = np.frexp(size)[1]
    # Powers of two scale without rounding; the squares of 1e±200 would overflow or
    # underflow.
    parts = [np.ldexp(part, -exponent) for part in (z.real, z.imag, size)]
    (x, dx), (y, dy), (r, dr) = (_square(part) for part in parts)
    return size, 0.5 * (((x - r) + y) + (dx + dy - dr)) / r


def _square(x: Real) -> tuple[Real, Real]:
    """x² and its rounding error (Dekker and Veltkamp)."""
    # 2^27 + 1 splits a double into halves of 26 bits, whose products are exact.
    product, wide = x * x, 134217729.0 * x
    high = wide - (wide - x)
    low = x - high
    return product, ((high * high - product) + 2.0 * high * low) + low * low


@lru_cache(maxsize=64)
def _rule(beta: float) -> tuple[float, int, float]:
    """Step h in u, the number of nodes on either side, and Im u above which a pole
    counts as part of the origin.

    The discretisation error is e^(−A(1 − δ)), A = 2π/h, times the integrand at the
    distance δ from its singularity u = i, where s = 0; it is smallest at δ = (2β −
    1)/A. The circle of that radius encloses poles nearer to i: their residues may be
    huge, and cancel against the cut. The truncation error beyond the last node is
    e^(μ(1 − u²)), times |s|^(−β) for negative β.
    """
    power = max(2.0 * beta - 1.0, 0.0)
    exponent, decay = (
        max(60.0, 2.0 * power),
        FOLDS - (beta - 1.0) * math.log(_VERTEX),
    )
    while power and exponent - power * (1.0 + math.log(exponent / power)) < decay:
        exponent += 4.0
    reach = 4.0
    while (
        _VERTEX * (reach**2 - 1.0)
        - max(0.0, -beta) * math.log(_VERTEX * (1.0 + reach**2))
        < FOLDS
    ):
        reach += 0.1
    step = math.tau / exponent
    return step, math.ceil(reach / step), 1.0 - power / exponent
