"""What a residual holds, against sums written out; what a fit makes of its errors and
of its log.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import chi2
from scipy.stats import t as student

from fraclink._arm.link import SecondMode
from fraclink._identify import Fit, Interval, identify
from fraclink._identify.fitting import (
    _bounds,
    _deviations,
    _identified,
    _tests,
    _variances,
    make_search,
)
from fraclink._identify.residual import (
    ResidualTests,
    _noise,
    _regressed,
    _shows_again,
    autocovariance,
    autoregression,
    coloured_covariance,
    correlation_lag,
    long_run_covariance,
    noise_behind,
    residual_tests,
)
from fraclink._identify.search import Solution
from fraclink._identify.shape import Window, columns_of, largest_ratio
from fraclink._identify.uncertainty import Uncertainty
from identify_cases import made_log

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


@pytest.mark.parametrize("count", [1, 2, 7, 8, 9, 33])
def test_covariances_are_their_sums(count: int) -> None:
    first, second = np.random.default_rng(count).normal(size=(2, count))
    assert autocovariance(first) == pytest.approx(direct(first, first), abs=1e-13)
    assert autocovariance(first, second) == pytest.approx(
        direct(first, second), abs=1e-13
    )


@pytest.mark.parametrize(("count", "lags"), [(40, 0), (40, 5), (41, 7), (64, 12)])
def test_newey_and_wests_sum_with_bartletts_weights(count: int, lags: int) -> None:
    """n Γ₀ + n Σ (1 − l/(L+1)) (Γ_l + Γ_lᵀ), of Newey and West (1987)."""
    scores = np.random.default_rng(count).normal(size=(3, count))
    wanted = scores @ scores.T
    for lag in range(1, lags + 1):
        across = scores[:, lag:] @ scores[:, : count - lag].T
        wanted = wanted + (1 - lag / (lags + 1)) * (across + across.T)
    assert long_run_covariance(scores, lags) == pytest.approx(wanted, abs=1e-10)


def test_an_autoregression_is_found_with_its_order() -> None:
    series = np.asarray(
        lfilter([1.0], [1.0, -1.5, 0.8], np.random.default_rng(3).normal(size=6000))
    )[500:]
    coefficients, variance = autoregression(series)
    assert coefficients[:3] == pytest.approx([1.0, -1.5, 0.8], abs=0.04)
    assert np.abs(coefficients[3:]).max(initial=0.0) < 0.06
    assert variance == pytest.approx(1.0, rel=0.05)


def test_white_noise_needs_no_autoregression_and_a_line_is_predicted_exactly() -> None:
    coefficients, variance = autoregression(
        np.random.default_rng(1).normal(0, 2.0, 4000)
    )
    assert coefficients.size <= 3
    assert variance == pytest.approx(4.0, rel=0.05)
    # A sine obeys x_k = 2 cos(ω) x_{k−1} − x_{k−2}: two coefficients leave what the
    # ends make alone.
    wave = np.sin(0.3 * np.arange(20000))
    coefficients, variance = autoregression(wave)
    assert variance < 1e-3 * 0.5
    assert abs(np.polyval(coefficients, np.exp(0.3j))) < 1e-2


@pytest.mark.parametrize("count", [9, 10, 45])
def test_a_short_series_has_a_tenth_of_its_samples_as_coefficients(count: int) -> None:
    series = wandering(count, 0.9, seed=2) + 0.01 * np.sin(np.arange(count))
    assert autoregression(series)[0].size <= 1 + count // 10


def _covariance(regressors: Array, residual: Array) -> tuple[Array, float]:
    coefficients, variance, freedom = noise_behind(regressors, residual)
    return coloured_covariance(regressors, coefficients, variance), freedom


@pytest.mark.slow
def test_the_covariance_of_a_regression_under_coloured_noise() -> None:
    """Σ_kl x_k γ(k − l) x_lᵀ with the known γ(l) = 0.9^|l| of the noise."""
    count = 1500
    regressors = np.stack([np.sin(0.02 * np.arange(count)), np.ones(count)])
    lags = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    wanted = regressors @ (0.9**lags) @ regressors.T
    found = np.mean(
        [_covariance(regressors, wandering(count, 0.9, seed))[0] for seed in range(20)],
        axis=0,
    )
    # The variance of 1500 such samples is itself known to 10 %, their sum over lags in
    # 20 runs to 7 %.
    assert np.diag(found) == pytest.approx(np.diag(wanted), rel=0.2)
    white, freedom = _covariance(
        regressors, np.random.default_rng(0).normal(0, 3.0, count)
    )
    assert np.diag(white) == pytest.approx(
        9.0 * np.diag(regressors @ regressors.T), rel=0.25
    )
    assert freedom == pytest.approx(
        count / 2, rel=0.25
    )  # of a first-order spectrum's level at 0


@pytest.mark.slow
def test_what_a_fit_took_out_of_slow_noise_is_given_back() -> None:
    """The variance of a regression's coefficients, from its residual, against that from
    the known γ(l).

    600 samples with ρ = 0.9 are 32 independent ones, and five regressors take a third
    of the noise.
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
        meat, freedom = _covariance(rows, noise - error @ rows)
        found = np.diag(inverse @ meat @ inverse)
        ratios.append(found / true)
        inside.append(np.abs(error) < student.ppf(0.975, freedom) * np.sqrt(found))
    assert np.mean(ratios, axis=0) == pytest.approx(
        np.ones(5), abs=0.15
    )  # 0.7 from the residual as it is
    assert (
        0.91 < np.mean(inside) < 0.98
    )  # 0.87 with that, and the normal distribution's 1.96


@pytest.mark.parametrize(
    ("correlation", "least", "most"), [(0.0, 1, 1), (0.8, 6, 20), (0.95, 25, 2000)]
)
def test_the_lag_after_which_a_residual_forgets(
    correlation: float, least: int, most: int
) -> None:
    """Of AR(1) the autocorrelation falls below 0.1 after ln 0.1/ln ρ samples: 10 and
    45.

    60 000 samples: the autocorrelation's own error, √((1 + ρ²)/((1 − ρ²) n)), is then
    below a fifth of 0.1.
    """
    assert least <= correlation_lag(wandering(60_000, correlation, seed=1)) <= most


def test_lags_count_to_the_last_large_one_within_a_quarter() -> None:
    assert correlation_lag(np.zeros(50)) == 1
    # ±1 every ten samples: autocovariance 1 − l/n at lags of 10, so the last in a
    # quarter of 400 is lag 90.
    comb = np.where(np.arange(400) % 10 == 0, 1.0, 0.0)
    assert correlation_lag(comb) == 91


# --- tests --------------------------------------------------------------------------------------------------


def test_ljung_and_box_written_out() -> None:
    residual = wandering(600, 0.1, seed=4) + 0.3
    found = residual_tests(
        residual, np.random.default_rng(1).normal(size=600), 0.01, 7, 2.5
    )
    centred = residual - residual.mean()
    rho = np.array(direct(centred, centred)[1:26]) / (centred @ centred / 600)
    statistic = 600 * 602 * np.sum(rho**2 / (600 - np.arange(1, 26)))
    assert found.whiteness == pytest.approx(float(chi2.sf(statistic, 25)), rel=1e-9)
    assert found.correlation_time == pytest.approx(0.07)
    assert found.variance_inflation == 2.5


def test_a_short_residual_is_tested_at_a_quarter_of_its_lags() -> None:
    residual = wandering(40, 0.5, seed=4)
    found = residual_tests(
        residual, np.random.default_rng(1).normal(size=40), 0.01, 1, 1.0
    )
    centred = residual - residual.mean()
    rho = np.array(direct(centred, centred)[1:11]) / (centred @ centred / 40)
    statistic = 40 * 42 * np.sum(rho**2 / (40 - np.arange(1, 11)))
    assert found.whiteness == pytest.approx(float(chi2.sf(statistic, 10)), rel=1e-9)


def test_a_residual_of_zero_holds_nothing() -> None:
    assert residual_tests(np.zeros(100), np.ones(100), 0.02, 3, 9.0) == ResidualTests(
        1.0, 1.0, 0.02, 1.0
    )


def test_a_residual_that_follows_the_motor_is_told_from_one_that_does_not() -> None:
    rng = np.random.default_rng(5)
    motion = np.asarray(lfilter([1.0], [1.0, -0.7], rng.normal(size=3000)))
    p_values = []
    for seed in range(20):
        noise = wandering(3000, 0.6, seed=seed)
        p_values.append(
            residual_tests(noise, motion + 5.0, 0.01, 1, 1.0).input_independence
        )
    # Uniform where nothing depends: the colour of both series is allowed for.
    assert 0.2 < np.mean(p_values) < 0.8
    assert min(p_values) > 1e-3
    late = np.concatenate([np.zeros(3), motion[:-3]])
    assert (
        residual_tests(noise + 0.2 * late, motion, 0.01, 1, 1.0).input_independence
        < 1e-6
    )
    # Before the motor moved: what is left of it at lag 0 and after, 0.7³, is no
    # consequence.
    early = np.concatenate([motion[3:], np.zeros(3)])
    assert (
        residual_tests(noise + 0.2 * early, motion, 0.01, 1, 1.0).input_independence
        > 1e-3
    )


# --- the second mode ----------------------------------------------------------------------------------------


def test_a_regression_knows_its_error() -> None:
    """Over forty noises the scatter of the coefficient is its standard error, colour
    allowed for.
    """
    response = np.sin(0.05 * np.arange(1500))
    for correlation in (0.0, 0.8):
        found = np.array(
            [
                _regressed(
                    0.3 * response + wandering(1500, correlation, seed), response
                )
                for seed in range(40)
            ]
        )
        assert abs(found[:, 0].mean() - 0.3) < 3 * found[:, 0].std() / math.sqrt(40)
        assert 0.6 < np.median(found[:, 1]) / found[:, 0].std() < 1.6
    exact, error = _regressed(0.3 * response, response)
    assert (exact, error) == (pytest.approx(0.3), pytest.approx(0.0, abs=1e-12))


def test_noise_as_a_high_frequency_meets_it() -> None:
    white = np.random.default_rng(0).normal(0, 0.2, 50_000)
    assert _noise(white) == pytest.approx(0.2, rel=0.02)
    slow = (
        5.0 * np.sin(0.001 * np.arange(50_000)) + 3.0
    )  # a misfit that no fast mode has
    assert _noise(white + slow) == pytest.approx(0.2, rel=0.02)


def test_a_mode_must_show_again_in_what_was_held_out() -> None:
    """Of the same sign, three standard errors large and within a factor of three."""
    period, count = 0.004, 3000
    angle = np.asarray(
        lfilter(
            [0.1], [1, -0.9], np.repeat(np.random.default_rng(1).normal(size=60), 50)
        )
    )
    window = Window(angle[:1800], np.zeros(1800), period, "first")
    place = np.array([2.0, math.log(80.0), 0.02, 1.0, 0.0])
    whole = Window(angle, np.zeros(count), period, "first")
    mode = columns_of(whole.kernel(80.0, longest_delay=0.0), place)[0]
    noise = 0.05 * float(mode.std()) * np.random.default_rng(2).normal(size=count)

    def again(size: float, loud: float = 1.0) -> bool:
        return _shows_again(window, place, 1.0, angle, size * mode + loud * noise)

    assert again(1.0) and again(2.9) and again(0.35)
    assert not again(3.1) and not again(0.32) and not again(-1.0) and not again(0.0)
    assert not again(1.0, loud=500.0)  # it drowns
    short = Window(angle[:2950], np.zeros(2950), period, "first")
    assert _shows_again(
        short, place, 1.0, angle, noise
    )  # fifty samples show nothing, and refuse nothing


# --- what a fit makes of its log ----------------------------------------------------------------------------


def made_fit(**changes: object) -> Fit:
    log = made_log(noise=0.05, samples=1501)
    return replace(identify(log, "UD-FOM", details=False), **changes)  # type: ignore[arg-type]


def test_what_the_log_showed_travels_in_the_model() -> None:
    intervals = {
        "order": Interval(1.9, 1.94, False, False),
        "delay": Interval(0.001, 0.003, False, False),
    }
    mode = SecondMode(80.0, 0.4, 0.02)
    fit = made_fit(
        gain=-1.5, delay=0.002, intervals=intervals, standard_errors={"gain": 0.01}
    )
    model = _identified(fit, (mode, None), None)
    assert (model.stiffness, model.gauge_gain, model.gauge_delay) == (1.5, 1.0, 0.002)
    assert (model.second_mode, model.unseen_up_to) == (mode, None)
    assert model.interval("order") == (1.9, 1.94)
    assert model.interval("gauge_delay") == (0.001, 0.003)
    assert model.interval("delay") is None
    assert model.interval("stiffness") == (
        pytest.approx(1.5 - 0.0196),
        pytest.approx(1.5 + 0.0196),
    )
    bent = replace(fit, output_kind="deflection")
    for stiffness, wanted in ((2.5, 2.5), (None, 1.0)):
        deflection = _identified(bent, (None, 321.0), stiffness)
        assert (deflection.stiffness, deflection.gauge_gain) == (wanted, 1.5)
        assert deflection.interval("gauge_gain") == (
            pytest.approx(1.4804),
            pytest.approx(1.5196),
        )
        assert deflection.interval("stiffness") is None
        assert deflection.unseen_up_to == 321.0
    bare = _identified(replace(fit, intervals={}), (None, None), None)
    assert bare.intervals == ()
    unknown = _identified(replace(fit, standard_errors={}), (None, None), None)
    assert unknown.interval("stiffness") is None
    assert _identified(replace(fit, gain=0.0), (None, None), None).stiffness == 1e-12


def test_colour_widens_and_never_narrows() -> None:
    white, coloured = np.diag([1.0, 4.0]), np.diag([9.0, 1.0])
    errors = Uncertainty(("order", "gain"), white, coloured, 5, 2.0, False, 0.01)
    assert _variances(errors, True).tolist() == [9.0, 4.0]
    assert _variances(errors, False).tolist() == [1.0, 4.0]
    assert _variances(replace(errors, coloured=None), True).tolist() == [1.0, 4.0]
    assert _deviations(("a", "b"), np.array([9.0, -1e-20])) == {"a": 3.0, "b": 0.0}
    log = made_log(noise=0.05, samples=1501)
    search = make_search(
        log, heldout=0.0, stiffness=None, fixed=None, guess=None, hold="auto"
    )
    tests = _tests(search, np.random.default_rng(0).normal(size=1501), errors)
    assert tests.variance_inflation == 9.0
    assert tests.correlation_time == pytest.approx(5 * 0.004)
    assert (
        _tests(search, np.ones(1501), replace(errors, coloured=None)).variance_inflation
        == 1.0
    )


def test_bounds_are_named_in_the_order_of_the_coordinates() -> None:
    low, high = np.array([1.0, 0.0, 0.0, 0.1, 0.0]), np.array([2.0, 5.0, 0.9, 1.9, 0.1])
    made = Solution(
        "D-FOM", (1, 2, 3, 4), low.copy(), 1.0, 0.0, 1.0, np.eye(8), low, high, 0, 1
    )
    assert _bounds(made) == ("natural_frequency", "damping", "damping_order", "delay")
    edge = np.array([2.0, 2.0, largest_ratio(0.5), 0.5, 0.05])
    assert _bounds(replace(made, shape=edge)) == ("natural_frequency",)
    assert _bounds(replace(made, shape=edge, free=(1, 2, 4))) == ()
