"""Statistics of residuals against explicit sums; what a fit derives from its errors and
its log.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import chi2
from scipy.stats import t as student

from fraclink._identify.residual import (
    correlated_lags,
    long_run_covariance,
    noise_behind,
    residual_tests,
)

Array = NDArray[np.float64]


def wandering(count: int, correlation: float, seed: int = 0) -> Array:
    """AR(1) noise of unit variance."""
    white = np.random.default_rng(seed).normal(size=count + 500)
    return np.asarray(
        lfilter([math.sqrt(1 - correlation**2)], [1, -correlation], white)
    )[500:]


def direct(first: Array, second: Array) -> list[float]:
    """Σ_k x_{k+l} y_k / n, one lag after another."""
    count = first.size
    return [float(first[lag:] @ second[: count - lag]) / count for lag in range(count)]


@pytest.mark.parametrize(("count", "lags"), [(40, 0), (40, 5), (41, 7), (64, 12)])
def test_newey_and_wests_sum_with_bartletts_weights(count: int, lags: int) -> None:
    """n Γ₀ + n Σ (1 − l/(L+1)) (Γ_l + Γ_lᵀ), of Newey and West (1987)."""
    scores = np.random.default_rng(count).normal(size=(3, count))
    wanted = scores @ scores.T
    for lag in range(1, lags + 1):
        across = scores[:, lag:] @ scores[:, : count - lag].T
        wanted = wanted + (1 - lag / (lags + 1)) * (across + across.T)
    assert long_run_covariance(scores, lags) == pytest.approx(wanted, abs=1e-10)


@pytest.mark.slow
def test_the_covariance_of_a_regression_under_coloured_noise() -> None:
    """Σ_kl x_k γ(k − l) x_lᵀ with the known γ(l) = 0.9^|l| of the noise."""
    count = 1500
    regressors = np.stack([np.sin(0.02 * np.arange(count)), np.ones(count)])
    lags = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    wanted = regressors @ (0.9**lags) @ regressors.T
    found = np.mean(
        [
            noise_behind(regressors, wandering(count, 0.9, seed))[0]
            for seed in range(20)
        ],
        axis=0,
    )
    # The variance of 1500 such samples is itself known to 10 %, and their sum over lags
    # in 20 runs to 7 %.
    assert np.diag(found) == pytest.approx(np.diag(wanted), rel=0.2)
    white = noise_behind(regressors, np.random.default_rng(0).normal(0, 3.0, count))[0]
    assert np.diag(white) == pytest.approx(
        9.0 * np.diag(regressors @ regressors.T), rel=0.25
    )


@pytest.mark.slow
def test_what_a_fit_took_out_of_slow_noise_is_given_back() -> None:
    """The variance of the coefficients of a regression, estimated from its residual,
    against that from the known γ(l). 600 samples with ρ = 0.9 correspond to 32
    independent ones, and five regressors absorb a third of the noise.
    """
    count, t = 600, np.linspace(0, 1, 600)
    rows = np.array(
        [
            np.ones(count),
            np.sin(3 * t),
            np.cos(3 * t),
            t * np.sin(9 * t),
            t * np.cos(9 * t),
        ]
    )
    inverse = np.linalg.inv(rows @ rows.T)
    gamma = 0.9 ** np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    true = np.diag(inverse @ rows @ gamma @ rows.T @ inverse)
    ratios, inside = [], []
    for seed in range(100):
        noise = wandering(count, 0.9, seed)
        error = inverse @ rows @ noise
        meat = noise_behind(rows, noise - error @ rows)[0]
        found = np.diag(inverse @ meat @ inverse)
        ratios.append(found / true)
        inside.append(np.abs(error) < 1.96 * np.sqrt(found))
    # 0.7 with the residual as it is. More than 1, since the level of the noise is not
    # known either: the two thirds that are left show it with ν = n/2T degrees of freedom,
    # T = (1 + ρ)/(1 − ρ), and 1.96 standard errors hold what Student's quantile would.
    freedom = 2 / 3 * count / (2 * (1 + 0.9) / (1 - 0.9))
    wider = (student.ppf(0.975, freedom) / 1.96) ** 2
    assert np.median(ratios, axis=0) == pytest.approx(np.full(5, wider), rel=0.15)
    # 0.87 with that and the 1.96 of the normal distribution
    assert 0.93 < np.mean(inside) < 0.98


@pytest.mark.parametrize(
    ("correlation", "least", "most"),
    [(0.0, 10, 10), (0.8, 30, 100), (0.95, 125, 10_000)],
)
def test_the_lags_over_which_a_residual_is_correlated(
    correlation: float, least: int, most: int
) -> None:
    """Five times the lag after which the autocorrelation of AR(1) noise falls below 0.1,
    ln 0.1/ln ρ samples: 10 and 45. With 60 000 samples the error of the autocorrelation itself, √((1 + ρ²)/((1
    − ρ²) n)), is below a fifth of 0.1.

    60 000 samples: the autocorrelation's own error, √((1 + ρ²)/((1 − ρ²) n)), is then
    below a fifth of 0.1.
    """
    lags = correlated_lags(wandering(60_000, correlation, seed=1))
    assert least <= lags <= most


# --- tests --------------------------------------------------------------------------------------------------


def test_ljung_and_box_written_out() -> None:
    residual = wandering(600, 0.1, seed=4) + 0.3
    found = residual_tests(residual, np.random.default_rng(1).normal(size=600))
    centred = residual - residual.mean()
    rho = np.array(direct(centred, centred)[1:26]) / (centred @ centred / 600)
    statistic = 600 * 602 * np.sum(rho**2 / (600 - np.arange(1, 26)))
    assert found.whiteness == pytest.approx(float(chi2.sf(statistic, 25)), rel=1e-9)
