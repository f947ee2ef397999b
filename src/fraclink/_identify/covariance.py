"""How sure a fit is: information criteria, covariance under coloured residuals, tests of the residual."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq, toeplitz
from scipy.signal import lfilter
from scipy.special import gammaincc

from fraclink._arm.link import STRUCTURES, structure
from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import (
    COORDINATE,
    NAMES,
    columns_of,
    mask_of,
    model_gradients,
)

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_LAGS = 25  # of the portmanteau tests
_AR_MOST = 30  # order of the residual's autoregression: a few resonances, mains hum and slow drift together


def aic(mse: float, samples: int, parameters: int) -> float:
    """Return Akaike's criterion 2k + n ln(MSE), equation (18); lower is better.

    Parameters
    ----------
    mse
        mean squared error > 0 [unit of the output, squared].
    samples
        n, number of fitted samples.
    parameters
        k of the structure (1, 2, 2, 3 in the order of the table).

    Examples
    --------
    With n = 5001 it gives Table 2 of the paper:

    >>> [round(aic(mse, 5001, k)) for mse, k in ((0.05845, 1), (0.00531, 2), (0.00524, 2), (0.00524, 3))]
    [-14199, -26192, -26258, -26256]
    """
    return 2.0 * parameters + samples * math.log(mse) if mse > 0 else -math.inf


def bic(mse: float, samples: int, parameters: int) -> float:
    """Return Schwarz's criterion k ln(n) + n ln(MSE), arguments as for `aic`; lower is better.

    >>> round(bic(0.00524, 5001, 2))
    -26245
    """
    return parameters * math.log(samples) + samples * math.log(mse) if mse > 0 else -math.inf


@dataclass(frozen=True)
class ResidualTests:
    """What the residual still holds, over the samples of the fit.

    A real arm's residual is never white in a thousand samples (second mode, friction, quantisation): a
    small `whiteness` says that standard errors must allow for colour, which they then do, not that the
    model is useless. A small `input_independence` says that the motor's motion explains part of the
    residual: the structure misses something.

    Parameters
    ----------
    whiteness
        p-value of Ljung and Box's test that the residual is white (25 lags).
    input_independence
        p-value of the test that it does not depend on the motor's motion (25 lags).
    correlation_time
        time after which its autocorrelation stays below 0.1 [s].
    variance_inflation
        by how much its colour widens the variance of the least well supported parameter.
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


def autoregression(series: Vector) -> tuple[Vector, float]:
    """Coefficients (1, a₁ … a_p) and innovation variance of the autoregression that describes a series.

    Levinson's recursion gives all orders up to `_AR_MOST` from the autocovariances; Akaike's criterion
    picks one.
    """
    gamma = autocovariance(series)
    most = min(_AR_MOST, series.size // 10)
    best, coefficients, variance = (math.inf, np.ones(1), float(gamma[0])), np.ones(1), float(gamma[0])
    for order in range(most + 1):
        value = series.size * math.log(max(variance, 1e-300)) + 2 * order
        best = min(best, (value, coefficients, variance), key=lambda item: item[0])
        if order == most or variance <= 1e-12 * gamma[0]:  # the series is predicted exactly
            break
        reflection = -float(coefficients @ gamma[order + 1 : 0 : -1]) / variance
        longer = np.append(coefficients, 0.0)
        coefficients = longer + reflection * longer[::-1]
        variance *= 1 - reflection**2
    return best[1], best[2]


def coloured_covariance(regressors: Matrix, residual: Vector) -> Matrix:
    """Covariance of regressors · residual, regressors of shape (p, n), for a residual of any spectrum.

        Σ_k Σ_l x_k γ(k − l) x_lᵀ = ∫ S(ω) X(ω) X(ω)ᴴ dω / 2π

    S is that of an autoregression. The estimate of Newey and West from the products x_k e_k cuts off their
    correlation after some lags and tapers it before: at five correlation times its standard errors were
    15 to 20 % too small under slow noise (83 % of "95 %" intervals held the truth), a fault that the
    autoregression does not have. It takes noise and motion for independent, which is what a residual of a
    model that misses nothing is.
    """
    coefficients, variance = autoregression(residual)
    count = regressors.shape[1]
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(regressors, size, axis=1)
    density = variance / np.abs(np.fft.rfft(coefficients, size)) ** 2
    density[1 : (size + 1) // 2] *= 2  # the negative frequencies
    return np.asarray(((spectrum * density) @ spectrum.conj().T).real / size, dtype=np.float64)


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


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariances of the free parameters, in the order of `names`.

    `white` holds for independent residuals, `coloured` for residuals of any (short) correlation; None
    where it was not asked for. `lag` is the residual's correlation in samples, `effective` the number of
    parameters that the residual's colour makes of those fitted (Takeuchi's trace), `singular` says that
    the log does not determine all of them. `resonance` is the relative standard error of the resonance Ω,
    NaN where Ω ended at a limit; unlike ω₀ it does not trade with α and λ.
    """

    names: tuple[str, ...]
    white: Matrix
    coloured: Matrix | None
    lag: int
    effective: float
    singular: bool
    resonance: float


def uncertainty(search: Search, solution: Solution, *, coloured: bool) -> Uncertainty:
    """Covariance at a solution; `coloured` adds the sandwich estimate from the residual's scores."""
    inside, linear = _moving(search, solution)
    columns = [3 + solution.free.index(i) for i in inside] + linear
    scale = np.array([solution.gain] * len(inside) + [1.0] * len(linear))
    basis = _basis(solution, inside, len(linear))
    names = _names(solution, inside, linear)
    through = _gradients(solution, names, inside, linear) @ basis
    normal = basis.T @ (solution.gram[np.ix_(columns, columns)] * np.outer(scale, scale)) @ basis
    inverse, singular = _inverse(normal)
    samples = search.window.samples
    variance = solution.cost / max(samples - basis.shape[1], 1)
    white = variance * through @ inverse @ through.T
    resonance = basis[inside.index(1)] if 1 in inside else np.full(basis.shape[1], np.nan)
    if not coloured:
        error = float(np.sqrt(variance * resonance @ inverse @ resonance))
        return Uncertainty(names, white, None, 1, float(basis.shape[1]), singular, error)
    regressors, residual = _linearised(search, solution)
    lag = correlation_lag(residual)
    meat = coloured_covariance(regressors, residual)
    # Misfit that depends on the motion is no independent noise; there the products of both tell more.
    products = long_run_covariance(regressors * residual, min(max(5 * lag, 10), samples // 5))
    wider = np.sqrt(np.maximum(_diagonal(inverse, products) / _diagonal(inverse, meat), 1.0))
    sandwich = inverse @ meat @ inverse * np.outer(wider, wider)
    effective = float(np.trace(inverse @ meat)) / variance if variance > 0 else float(basis.shape[1])
    error = float(np.sqrt(np.maximum(resonance @ sandwich @ resonance, 0.0)))
    return Uncertainty(names, white, through @ sandwich @ through.T, lag, effective, singular, error)


def _moving(search: Search, solution: Solution) -> tuple[list[int], list[int]]:
    """Coordinates that are free and inside their limits, and the linear parameters that are free."""
    inside = [i for i in solution.free if i not in solution.at_bound]
    return inside, [c for c, value in ((1, search.gain), (2, search.offset)) if np.isnan(value)]


def _linearised(search: Search, solution: Solution) -> tuple[Matrix, Vector]:
    """∂(output)/∂(free parameters), one row for each direction of `_basis`, and the residual."""
    inside, linear = _moving(search, solution)
    raw = columns_of(search.kernel, solution.shape, mask_of(solution.free))
    residual = search.window.output - solution.gain * raw[0] - solution.offset
    shapes = [solution.gain * raw[1 + solution.free.index(i)] for i in inside]
    straight = [{1: raw[0], 2: np.ones(residual.size)}[c] for c in linear]
    return _basis(solution, inside, len(linear)).T @ np.array([*shapes, *straight]), residual


def _basis(solution: Solution, inside: list[int], linear: int) -> Matrix:
    """Directions in which the point may move: all, but on ω₀ = 0 the damping ratio follows α."""
    basis = np.eye(len(inside) + linear)
    if solution.on_edge and 2 in inside and 3 in inside:
        basis[inside.index(2), inside.index(3)] = np.pi / 4 / np.cos(solution.shape[3] * np.pi / 2) ** 2
        basis = np.delete(basis, inside.index(2), axis=1)
    return basis


def _names(solution: Solution, inside: list[int], linear: list[int]) -> tuple[str, ...]:
    """Names of the parameters that have an error: free and inside their limits."""
    own = [name for name in structure(solution.structure).free if COORDINATE[name] in inside]
    if solution.on_edge and "natural_frequency" in own:
        own.remove("natural_frequency")
    delay = ["delay"] if 4 in inside else []
    return (*own, *delay, *({1: "gain", 2: "offset"}[c] for c in linear))


def _gradients(solution: Solution, names: tuple[str, ...], inside: list[int], linear: list[int]) -> Matrix:
    """∂(named parameters)/∂(coordinates inside their limits, then gain, then offset)."""
    model = model_gradients(solution.shape)
    rows = np.zeros((len(names), len(inside) + len(linear)))
    for row, name in zip(rows, names, strict=True):
        if name in ("gain", "offset"):
            row[len(inside) + linear.index(1 if name == "gain" else 2)] = 1.0
        elif name == "delay":
            row[inside.index(4)] = 1.0
        else:
            row[: len(inside)] = [model[NAMES.index(name), i] if i < 4 else 0.0 for i in inside]
    return rows


def _diagonal(inverse: Matrix, meat: Matrix) -> Vector:
    return np.asarray(np.maximum(np.diag(inverse @ meat @ inverse), 1e-300))


def _inverse(normal: Matrix) -> tuple[Matrix, bool]:
    size = np.sqrt(np.diag(normal))
    size[size == 0] = 1.0
    values, vectors = np.linalg.eigh(normal / np.outer(size, size))
    singular = bool(values[0] < 1e-10)
    values = np.maximum(values, 1e-14)
    inverse: Matrix = (vectors / values) @ vectors.T / np.outer(size, size)
    return inverse, singular


# --- which structure? -------------------------------------------------------------------------------------

_SCORE_LAGS = 5  # what an autoregression leaves of a misfit lasts a few samples; more lags only add noise


def structure_criteria(search: Search, errors: Mapping[str, Uncertainty]) -> dict[str, tuple[float, float]]:
    """Two criteria of every structure under the noise of this log, both the AIC where it is white.

    `errors` are the coloured uncertainties of all structures.

        n ln(MSE) + 2 tr(H⁻¹J)    and    n ln(σ²)/k + 2 p

    The AIC of eq. (18) takes every sample for a witness. Under noise that wanders (AR(1), ρ = 0.98) that
    makes a wiggle of the noise look like a parameter.

    The first, Takeuchi's, counts parameters as the residual's colour does. It is cautious, but it too finds a
    superfluous α in one coloured log of ten. For the second all residuals pass one filter, the autoregression
    of what the richest structure leaves, which makes the noise white; each fit takes the Gauss–Newton
    step to its optimum behind that filter, and σ² is the variance of what is left. It tells more structures
    apart under slow noise, but on a log whose residual is misfit (friction, a motor that is not straight
    between two samples) the filter magnifies the misfit; k, by how much the richest fit's scores vary more
    than white noise would let them, does not make up for all of that. Each errs where the other does not, so
    that only what both say is taken for shown.
    """
    solutions = {name: search.solve(name) for name in STRUCTURES}
    richest = max(STRUCTURES, key=lambda name: len(structure(name).free))
    filtered = autoregression(_linearised(search, solutions[richest])[1])[0]
    found = {name: _innovations(search, solution, filtered) for name, solution in solutions.items()}
    scores, left = found[richest]
    variance = max(float(left @ left) / left.size, 1e-300)
    meat = long_run_covariance(scores * left, _SCORE_LAGS)
    inflation = max(float(np.trace(_inverse(scores @ scores.T)[0] @ meat)) / variance / len(scores), 1.0)
    samples = search.window.samples
    return {
        name: (
            # A parameter at its limit counts, as it was free to leave it.
            samples * _log(solution.cost / samples)
            + 2.0 * (errors[name].effective + len(solution.at_bound) + solution.on_edge),
            found[name][1].size * _log(float(np.mean(found[name][1] ** 2))) / inflation
            + 2.0 * len(structure(name).free),
        )
        for name, solution in solutions.items()
    }


def _log(value: float) -> float:
    return math.log(max(value, 1e-300))


def _innovations(search: Search, solution: Solution, coefficients: Vector) -> tuple[Matrix, Vector]:
    """Regressors and residual behind the filter that makes the noise white, after one Gauss–Newton step."""
    regressors, residual = _linearised(search, solution)
    rows = lfilter(coefficients, [1.0], np.vstack([regressors, residual]), axis=1)[:, coefficients.size :]
    size = np.linalg.norm(rows[:-1], axis=1)
    columns = rows[:-1] / np.where(size > 0, size, 1.0)[:, None]
    step = lstsq(columns.T, rows[-1], cond=1e-9)[0]
    return columns, np.asarray(rows[-1] - step @ columns)
