"""Analysis of residuals: spectrum, tests of whiteness, and the second vibration mode."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import lstsq, toeplitz
from scipy.special import gammaincc

from fraclink._arm.link import SecondMode
from fraclink._identify.problem import CERTAIN, LEVEL
from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import Window, columns_of, mask_of
from fracsys._precision import ROUNDS
from fracsys.checks import Real

_LAGS = 25  # lags of the portmanteau tests: the usual number in residual analysis
# Order of the residual's autoregression: a few resonances, mains hum and slow drift
# together.
_AR_MOST = 30


def autocovariance(first: Real, second: Real | None = None) -> Real:
    """Sample covariances Σ_k x_{k+l} y_k / n of two series (or of one with itself) at
    lags 0..n−1.
    """
    count = first.size
    size = next_fast_len(2 * count, real=True)
    spectrum = rfft(first, size)
    other = spectrum if second is None else rfft(second, size)
    return irfft(spectrum * other.conj(), size)[:count] / count


def long_run_covariance(scores: Real, lags: int) -> Real:
    """Newey and West's estimate of n Σ_l Γ_l with Bartlett's weights up to `lags`;
    scores have shape (p, n).

    Bartlett's weights are the Fejér kernel in frequency: a single matrix product
    instead of a sum over lags.
    """
    count = scores.shape[1]
    # Padded beyond the lags that are used, because the convolution of the transform is
    # circular.
    size = next_fast_len(count + lags + 1, real=True)
    spectrum = rfft(scores, size, axis=1)
    half = np.pi * np.arange(1, spectrum.shape[1]) / size
    kernel = np.concatenate(
        [[lags + 1.0], (np.sin((lags + 1) * half) / np.sin(half)) ** 2 / (lags + 1)]
    )
    kernel[1 : (size + 1) // 2] *= 2  # the negative frequencies
    return ((spectrum * kernel) @ spectrum.conj().T).real / size


def autoregression(series: Real) -> tuple[Real, float]:
    """Coefficients (1, a₁ … a_p) and innovation variance of the autoregression that
    describes a series.

    Levinson's recursion gives all orders up to `_AR_MOST` from the autocovariances;
    Akaike's criterion picks one.
    """
    gamma = autocovariance(series)
    # At least ten samples per coefficient: a longer autoregression fits the particular
    # noise.
    most = min(_AR_MOST, gamma.size // 10)
    best, coefficients, variance = (
        (math.inf, np.ones(1), float(gamma[0])),
        np.ones(1),
        float(gamma[0]),
    )
    for order in range(most + 1):
        value = gamma.size * math.log(max(variance, 1e-300)) + 2 * order
        best = min(best, (value, coefficients, variance), key=lambda item: item[0])
        if (
            order == most or variance <= 1e-12 * gamma[0]
        ):  # the series is predicted exactly
            break
        # Levinson: the last coefficient of the next order, from the correlation left by
        # the present one at that lag.
        reflection = -float(coefficients @ gamma[order + 1 : 0 : -1]) / variance
        longer = np.append(coefficients, 0.0)
        coefficients = longer + reflection * longer[::-1]
        variance *= 1 - reflection**2
    return best[1], best[2]


def noise_behind(regressors: Real, residual: Real) -> tuple[Real, float]:
    """The covariance (p, p) of regressors (p, n) · noise, with the noise that caused the
    residual of their fit, and the trace of the same for orthonormal regressors and the
    residual itself:

        Σ_k Σ_l x_k γ(k − l) x_lᵀ

    with the autocovariance γ of an autoregression. The estimate of Newey and West from
    the products x_k e_k cuts off their correlation after some lags and tapers it before:
    at five correlation times its standard errors were 15 to 20 % too small under slow
    noise (83 % of "95 %" intervals held the truth). An autoregression has no such lag.
    It assumes that noise and motion are independent, as they are for the residual of a
    complete model.

    A fit removes from slow noise the part that resembles the link's response, and the
    rest looks faster and smaller; and a short log shows the correlation of such noise
    badly. Its slowest real root ρ is therefore not taken from the residual, but
    integrated over its restricted likelihood (`_with_slow_root`).
    """
    scale = np.maximum(np.linalg.norm(regressors, axis=1), 1e-300)
    columns, triangle = np.linalg.qr((regressors / scale[:, None]).T)
    weights = scale[:, None] * triangle.T
    count, size = residual.size, max(float(np.linalg.norm(residual)), 1e-300)
    series = np.vstack([columns.T, residual / size])
    coefficients, variance = autoregression(residual)
    fast = _without_slow_root(coefficients)
    # Schwarz's criterion decides whether the fast roots belong to the noise: in a short
    # log they may only describe the gap that the fit has left at its resonance.
    evidence, roots, levels = _with_slow_root(series, np.ones(1), fast.size)
    better = _with_slow_root(series, fast, fast.size)
    if better[0] - 0.5 * (fast.size - 1) * math.log(count) > evidence:
        _, roots, levels = better
    else:
        fast = np.ones(1)
    # No lag within the record wraps around.
    length = next_fast_len(2 * count, real=True)
    spectra = rfft(columns.T, length, axis=1)
    turn = np.exp(-2j * np.pi / length * np.arange(spectra.shape[1]))
    slow = size**2 * levels @ (1 / np.abs(1 - roots[:, None] * turn) ** 2)

    def met(power: Real) -> Real:
        """The covariance of basis · noise with this spectrum."""
        # Each line but the first counts for its negative frequency, too.
        both = np.where(np.arange(power.size) > 0, 2.0, 1.0) / length
        return ((spectra * (power * both)) @ spectra.conj().T).real

    meat = weights @ met(slow / np.abs(rfft(fast, length)) ** 2) @ weights.T
    observed = met(variance / np.abs(rfft(coefficients, length)) ** 2)
    return meat, float(np.trace(observed))


def _without_slow_root(coefficients: Real) -> Real:
    """An autoregression without its largest positive real root."""
    roots = np.roots(coefficients)
    real = np.where(np.isreal(roots), roots.real, 0.0)
    if not real.max(initial=0.0) > 0:
        return coefficients
    return np.atleast_1d(np.poly(np.delete(roots, real.argmax())).real)


def _with_slow_root(series: Real, fast: Real, start: int) -> tuple[float, Real, Real]:
    """Logarithm of the likelihood, averaged over ρ, of noise that is an autoregression
    `fast` with one more root ρ; the ρ (K,) that are likely, and for each the variance
    of the innovations times its probability.

    `series` (p + 1, n) are an orthonormal basis of the regressors and the residual,
    scaled likewise; the samples from `start` on count. For ρ = sin φ, the restricted
    likelihood (Patterson and Thompson, Biometrika 58 (1971) 545)

        √(1 − ρ²) |XᵀR⁻¹X|^(−1/2) q^(−(n − p)/2)

    with the sum of squares q that the regressors leave of the whitened residual is that
    of the part of the noise that no regressor can remove. With φ uniform it is the
    posterior for the reference prior (Berger and Yang, Econometric Theory 10 (1994)
    461), and its standard deviation in φ is 1/√n for every ρ, so that the rectangle rule
    with that step is exact.
    """
    rows = np.stack([np.convolve(row, fast, "valid") for row in series])
    rows = rows[:, start - fast.size :]
    free = rows.shape[1] - len(rows) + 1
    count = math.ceil(math.pi * math.sqrt(rows.shape[1]))
    roots = np.sin(math.pi * ((np.arange(count) + 0.5) / count - 0.5))
    # Noise that is correlated over the whole log, (1 + ρ)/(1 − ρ) samples, is an offset.
    roots = roots[1 + roots < (1 - roots) * rows.shape[1]]
    across = rows[:, 1:] @ rows[:, :-1].T
    ends = [rows[:, [k]] @ rows[:, [k]].T for k in (0, -1)]
    whole = rows @ rows.T
    # RᵀR of x_k − ρ x_(k−1), and of √(1 − ρ²) x_0.
    grams = (
        whole
        - np.multiply.outer(roots, across + across.T)
        + np.multiply.outer(roots**2, whole - ends[0] - ends[1])
        # Rounding: `fast` may be the very vibration that a regressor is.
        + np.finfo(np.float64).eps * np.eye(len(rows))
    )
    model = np.linalg.slogdet(grams[:, :-1, :-1])[1]
    square = np.linalg.slogdet(grams)[1] - model
    likelihood = 0.5 * (np.log(1 - roots**2) - model - free * square)
    most = float(likelihood.max())
    chance = np.exp(likelihood - most)
    # What is left out changes a standard error by less than a thousandth.
    likely = chance > LEVEL * chance.max()
    levels = chance * np.exp(square) / free / chance[likely].sum()
    return most + math.log(chance.mean()), roots[likely], levels[likely]


def correlated_lags(series: Real) -> int:
    """Lags over which products of a series are summed: five correlation times contain
    its colour up to e^-5, and more than a fifth of its length would make its covariance
    too noisy.

    The correlation ends with the first lag after which the autocorrelation stays below
    0.1. Under slow noise that may be far too long, since the autocorrelation itself
    scatters: of 8000 samples of AR(1), ρ = 0.95, it falls below 0.1 after 45 lags and
    may pass it once more after a thousand.
    """
    # A quarter of the record: at larger lags the autocovariance averages few products.
    quarter = np.abs(autocovariance(series)[: series.size // 4])
    beyond = np.flatnonzero(quarter > 0.1 * quarter[0]).max(initial=0)
    return min(max(5 * (int(beyond) + 1), 10), series.size // 5)


# --- tests --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ResidualTests:
    """What the residual still contains, over the samples of the fit.

    A real arm's residual is never white in a thousand samples (second mode, friction,
    quantisation): a small `whiteness` says that standard errors must allow for colour,
    which they then do, not that the model is useless. A small `input_independence` says
    that the motor's motion explains part of the residual: the structure misses
    something.

    Parameters
    ----------
    whiteness
        p-value of Ljung and Box's test that the residual is white (25 lags).
    input_independence
        p-value of the test that it does not depend on the motor's motion (25 lags).
    """

    whiteness: float
    input_independence: float


def residual_tests(residual: Real, motion: Real) -> ResidualTests:
    """Test a residual against whiteness and against the motor's `motion` (its
    increments).
    """
    count = residual.size
    centred = residual - residual.mean()
    variance = float(centred @ centred) / count
    if variance == 0:
        return ResidualTests(1.0, 1.0)
    lags = min(_LAGS, count // 4)
    rho = autocovariance(centred)[1 : lags + 1] / variance
    # Ljung and Box (1978): (n + 2)/(n − k) in place of 1 makes χ² accurate for a few
    # hundred samples as well.
    ljung_box = (
        count * (count + 2) * float(np.sum(rho**2 / (count - np.arange(1, lags + 1))))
    )
    return ResidualTests(
        whiteness=float(gammaincc(lags / 2, ljung_box / 2)),
        input_independence=float(
            gammaincc(lags / 2, _input_statistic(centred, motion, lags) / 2)
        ),
    )


def _input_statistic(residual: Real, motion: Real, lags: int) -> float:
    """Score statistic n rᵀ R⁻¹ r/σ² of the motion at lags 0..lags−1 in a residual that is
    an autoregression: its filter makes the residual white, and is applied to both.
    """
    coefficients, variance = autoregression(residual)
    white, moved = (
        np.convolve(x, coefficients, "valid")
        for x in (residual, motion - motion.mean())
    )
    # A periodic motion makes R singular: directions that it does not excite are left
    # out of the statistic.
    r = autocovariance(white, moved)[:lags]
    solution = lstsq(toeplitz(autocovariance(moved)[:lags]), r, cond=1e-8)[0]
    return max(float(white.size * (r @ solution) / max(variance, 1e-300)), 0.0)


# --- the second mode ----------------------------------------------------------------------------------------

# Geometric mean of both modes, in units of the first: the second mode of a clamped beam
# is at 6.27, and a mass at its tip moves it farther away. A mode found below this mean
# is nearer to the first, as a misfit of the first is.
_LOWEST = 2.5
# fraction of the Nyquist frequency: beyond it the input between the samples is not
# known well enough
_HIGHEST = 0.8
# step of the scan in ln ω₂, and its ζ: such a resonance is 2ζ wide
_STEP, _RATIO = (0.04, 0.03)
# a more strongly damped one is friction or a filter rather than a mode
_RATIO_LIMITS = (5e-4, 0.2)
# Standard deviations of the mode's gain. The scan tries a few hundred frequencies, among
# which noise alone reaches 3.5; the spread of a coloured residual is itself known to a
# third only.
_SIGNIFICANT = 6.0
# A mode with this share of the gain matters for a design: at ζ = 0.02 its peak is 1.25 c.
_SEEN = 0.05


def find_second_mode(
    search: Search, solution: Solution, motor_angle: Real, whole: Real
) -> tuple[SecondMode | None, float | None]:
    """The second mode in the residual of a fit, or else the frequency [rad/s] up to
    which none was found.

    In addition to the fitted mode the output may contain gain · g₂ s²/(s² + 2 ζ ω₂ s +
    ω₂²) θm, the same kernel with λ = 2. Every candidate ω₂ is a regression of the
    residual on that response, made orthogonal to everything that the parameters of the
    first mode can explain; otherwise a slightly wrong λ or delay would pass for a mode.

    `motor_angle` and `whole` are the angle (with that before a cut) and the residual of
    the whole log: a mode in the fitted part must also appear in the held-out part.
    """
    window, shape = search.window, solution.shape
    columns = columns_of(search.kernel, shape, mask_of(solution.free))
    residual = whole[: window.samples]
    basis = np.linalg.qr(np.vstack([columns, np.ones(window.samples)]).T)[0]
    low, high = (
        math.log(_LOWEST) + shape[1],
        math.log(_HIGHEST * math.pi / window.period),
    )
    if high - low < 0.5 or not np.any(residual):
        return None, None
    rest = Window(window.input, residual, window.period, window.hold)
    kernel = search.kernel_of(rest)

    def row(log_frequency: float, ratio: float) -> Real:
        return np.array([2.0, log_frequency, ratio, 1.0, shape[4]])

    def response(place: Real) -> Real:
        column = columns_of(kernel, place)[0]
        return column - basis @ (basis.T @ column)

    grid = np.arange(low, high, _STEP)
    costs = kernel.costs(np.array([row(x, _RATIO) for x in grid]), math.nan, math.nan)
    lower, upper = row(low, _RATIO_LIMITS[0]), row(high, _RATIO_LIMITS[1])
    # The three deepest minima, since the deepest one on the grid need not pass the
    # gates below.
    for start in grid[np.argsort(costs)[:3]]:
        optimum = kernel.solve(
            row(start, _RATIO),
            mask_of((1, 2)),
            lower,
            upper,
            math.nan,
            math.nan,
            ROUNDS,
        )[1]
        # The lower limit of the damping is no objection, as a mode of steel has hardly
        # any; an optimum at another limit is a misfit of the first mode, noise, or a
        # filter.
        at_limit = optimum[1] - lower[1] < 1e-6 or np.any(
            upper[1:3] - optimum[1:3] < 1e-6
        )
        gain, error = regressed(residual, response(optimum))
        share = gain / solution.gain
        # The second mode bends the link in the same direction at its base; the opposite
        # sign means a misfit of the first mode.
        certain = not at_limit and share > 0 and abs(gain) > _SIGNIFICANT * error
        if certain and _shows_again(window, optimum, gain, motor_angle, whole):
            return SecondMode(math.exp(optimum[1]), share, float(optimum[2])), None
    # Noise of high frequency, since a slow misfit does not mask a fast mode; the variance
    # of the second difference of white noise is 1² + 2² + 1² times its own.
    noise = float(np.std(np.diff(residual, 2))) / math.sqrt(6.0)
    highest = None
    for log_frequency in grid:
        # ζ = 0.02, typical of steel and aluminium arms; a more damped mode has a lower
        # peak and matters less.
        size = float(np.linalg.norm(response(row(log_frequency, 0.02))))
        if _SIGNIFICANT * noise > _SEEN * abs(solution.gain) * size:
            break
        highest = math.exp(log_frequency)
    return None, highest


def _shows_again(
    window: Window, place: Real, gain: float, motor_angle: Real, whole: Real
) -> bool:
    """Whether the held-out part shows the same mode."""
    if whole.size - window.samples < 100:
        return True
    log = Window(motor_angle, whole, window.period, window.hold)
    column = columns_of(
        log.kernel(math.exp(place[1]), longest_delay=abs(place[4])), place
    )[0]
    again, error = regressed(whole[window.samples :], column[window.samples :])
    # Within a factor of three: a mode is linear, while effects of friction or backlash
    # vary with the motion.
    return (
        again * gain > 0 and abs(again) > CERTAIN * error and 1 / 3 < again / gain < 3
    )


def regressed(residual: Real, response: Real) -> tuple[float, float]:
    """Coefficient of the response in the residual and its standard error, with the
    colour accounted for.
    """
    power = float(response @ response)
    gain = float(response @ residual) / power
    rest = residual - gain * response
    scores: Real = (response * rest)[None, :]
    variance = max(
        float(long_run_covariance(scores, correlated_lags(rest))[0, 0]),
        power * float(rest @ rest) / rest.size,
    )
    return gain, math.sqrt(variance) / power
