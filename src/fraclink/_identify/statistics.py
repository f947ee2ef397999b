"""What a fit is worth: information criteria, standard errors, tests of the residual."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["ResidualTests", "aic", "autocovariance", "bic", "long_run_covariance", "residual_tests"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_LAGS = 25  # of the portmanteau tests


def aic(mse: float, samples: int, parameters: int) -> float:
    """Akaike's criterion of the paper, AIC = 2k + n ln(MSE), equation (18); lower is better.

    Arguments: mean squared error [unit of the output, squared] > 0, n samples, k parameters of the
    structure (1, 2, 2, 3 for UD-IOM, D-IOM, UD-FOM, D-FOM). With n = 5001 it gives Table 2:

    >>> [round(aic(mse, 5001, k)) for mse, k in ((0.05845, 1), (0.00531, 2), (0.00524, 2), (0.00524, 3))]
    [-14199, -26192, -26258, -26256]
    """
    return 2.0 * parameters + samples * math.log(mse) if mse > 0 else -math.inf


def bic(mse: float, samples: int, parameters: int) -> float:
    """Schwarz's criterion k ln(n) + n ln(MSE), arguments as for `aic`; lower is better.

    >>> round(bic(0.00524, 5001, 2))
    -26245
    """
    return parameters * math.log(samples) + samples * math.log(mse) if mse > 0 else -math.inf


@dataclass(frozen=True)
class ResidualTests:
    """What the residual still holds, over the samples of the fit.

    Arguments:
        whiteness: p-value of Ljung and Box's test that the residual is white (25 lags).
        input_independence: p-value of the test that it does not depend on the motor's motion (25 lags).
        correlation_time: time after which its autocorrelation stays below 0.1 [s].
        variance_inflation: by how much its colour widens the variance of the least well supported parameter.

    A real arm's residual is never white in a thousand samples (second mode, friction, quantisation): a
    small `whiteness` says that standard errors must allow for colour, which ours then do, not that the
    model is useless. A small `input_independence` says that the motor's motion explains part of the
    residual: the structure misses something.
    """

    whiteness: float
    input_independence: float
    correlation_time: float
    variance_inflation: float


def autocovariance(first: Vector, second: Vector | None = None) -> Vector:
    """Sample covariances Σ_k x_{k+l} y_k / n of two series (or of one with itself) at lags 0..n−1."""
    count = first.size
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(first, size)
    other = spectrum if second is None else np.fft.rfft(second, size)
    return np.asarray(np.fft.irfft(spectrum * other.conj(), size)[:count] / count, dtype=np.float64)


def long_run_covariance(scores: Matrix, lags: int) -> Matrix:
    """Newey and West's estimate of n Σ_l Γ_l with Bartlett's weights up to `lags`; scores have shape (p, n).

    Bartlett's weights are the Fejér kernel in frequency: one matrix product instead of a sum over lags.
    """
    count = scores.shape[1]
    size = 1 << (count + lags).bit_length()
    spectrum = np.fft.rfft(scores, size, axis=1)
    half = np.pi * np.arange(1, spectrum.shape[1]) / size
    kernel = np.concatenate([[lags + 1.0], (np.sin((lags + 1) * half) / np.sin(half)) ** 2 / (lags + 1)])
    kernel[1 : (size + 1) // 2] *= 2  # the negative frequencies
    return np.asarray(((spectrum * kernel) @ spectrum.conj().T).real / size, dtype=np.float64)


def correlation_lag(residual: Vector) -> int:
    """First lag after which the autocorrelation stays below 0.1 for as long again."""
    covariance = autocovariance(residual)
    if covariance[0] <= 0:
        return 1
    large = np.flatnonzero(np.abs(covariance[: residual.size // 4]) > 0.1 * covariance[0])
    return int(large[-1]) + 1


def residual_tests(
    residual: Vector, motion: Vector, period: float, lag: int, inflation: float
) -> ResidualTests:
    """Test a residual against whiteness and against the motor's `motion` (its increments)."""
    from scipy.special import gammaincc

    count = residual.size
    centred = residual - residual.mean()
    variance = float(centred @ centred) / count
    if variance == 0:
        return ResidualTests(1.0, 1.0, period, 1.0)
    lags = min(_LAGS, count // 4)
    rho = autocovariance(centred)[1 : lags + 1] / variance
    ljung_box = count * (count + 2) * float(np.sum(rho**2 / (count - np.arange(1, lags + 1))))
    return ResidualTests(
        whiteness=float(gammaincc(lags / 2, ljung_box / 2)),
        input_independence=float(gammaincc(lags / 2, _input_statistic(centred, motion, lags) / 2)),
        correlation_time=lag * period,
        variance_inflation=inflation,
    )


def _input_statistic(residual: Vector, motion: Vector, lags: int) -> float:
    """n rᵀ R⁻¹ r of the cross-covariances r at lags 0..lags−1; R allows for colour on both sides."""
    from scipy.linalg import lstsq, toeplitz

    count = residual.size
    moved = motion - motion.mean()
    r = autocovariance(residual, moved)[:lags]
    # Bartlett: cov(r_i, r_j) = Σ_l γ_e(l) γ_u(l + i − j) / n, with γ_e tapered against its own noise.
    own, other = autocovariance(residual), autocovariance(moved)
    reach = count // 4
    taper = own[:reach] * (1 - np.arange(reach) / reach)
    two_sided = np.concatenate([taper[:0:-1], taper])
    shifted = np.concatenate([other[: reach + lags][:0:-1], other[: reach + lags]])
    centre = reach + lags - 1
    covariance = [
        float(two_sided @ shifted[centre - reach + 1 + d : centre + reach + d]) for d in range(lags)
    ]
    solution = lstsq(toeplitz(covariance), r, cond=1e-8)[0]
    return max(float(count * (r @ solution)), 0.0)
