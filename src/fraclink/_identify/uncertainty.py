"""Uncertainty of a fit: covariances under coloured residuals, profile-likelihood
intervals, criteria.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.linalg import lstsq

from fraclink._arm.link import STRUCTURES
from fraclink._identify.link_problem import LinkProblem
from fraclink._identify.problem import (
    QUANTILE,
    RESOLUTION,
    Interval,
    interval_ends,
    inverted,
)
from fraclink._identify.residual import (
    autoregression,
    correlated_lags,
    long_run_covariance,
    noise_behind,
)
from fraclink._identify.search import Search, Solution
from fracsys.checks import Real


@dataclass(frozen=True, eq=False)
class Covariance:
    """Covariances (p, p) of parameters.

    `inverse` is the inverse normal matrix; times the residual's `variance` it is the
    covariance for independent residuals. `wide` holds for residuals of any (short)
    correlation, and equals the former if the colour was not requested. `effective` is the
    effective number of fitted parameters with the residual's colour (Takeuchi's trace),
    `unseen` (p, k) are the directions that the data leave undetermined.
    """

    names: tuple[str, ...]
    inverse: Real
    variance: float
    wide: Real
    effective: float
    unseen: Real

    @classmethod
    def of(
        cls, names: tuple[str, ...], normal: Real, cost: float, samples: int
    ) -> Covariance:
        """For independent residuals, from the normal matrix (p, p) of the parameters."""
        inverse, unseen = inverted(normal)
        # n − p: the fit uses p of the residual's degrees of freedom.
        variance = cost / max(samples - len(normal), 1)
        return cls(
            names,
            inverse,
            variance,
            wide=variance * inverse,
            effective=float(len(normal)),
            unseen=unseen,
        )

    def of_lines(self, regressors: Real, residual: Real) -> Covariance:
        """For the lines of a response, which are measured one by one: their errors are
        independent, and larger at some lines than at others (White, Econometrica 48
        (1980) 817).
        """
        scores = self.inverse @ (regressors * residual)
        return replace(self, wide=scores @ scores.T)

    def coloured(self, regressors: Real, residual: Real) -> Covariance:
        """For a residual (n,) of any colour, from ∂(prediction)/∂(parameters), shape (p,
        n).
        """
        noise, observed = noise_behind(regressors, residual)
        # A misfit that depends on the motion is not independent noise; there the
        # products of both give more information.
        products = long_run_covariance(regressors * residual, correlated_lags(residual))
        return replace(
            self,
            wide=_sandwich(self.inverse, noise, products),
            # Takeuchi's tr(H⁻¹J): the number of parameters under white noise, and
            # larger under slow noise in proportion to its lack of independent samples.
            # From the residual as it is, since rivals are compared by these numbers and
            # the noise behind it is estimated for each structure separately.
            effective=observed / self.variance if self.variance > 0 else self.effective,
        )

    def of_functions(self, names: tuple[str, ...], gradients: Real) -> Covariance:
        """Covariance of functions of the parameters with `gradients` (q, p)."""
        inverse, wide = (gradients @ x @ gradients.T for x in (self.inverse, self.wide))
        return replace(self, names=names, inverse=inverse, wide=wide)

    @cached_property
    def _variances(self) -> tuple[Real, Real]:
        """Of every parameter, for independent residuals and with the colour accounted
        for.

        Colour may also reduce a variance, but the sandwich covariance is too noisy to
        be trusted there.
        """
        # Rounding may leave a variance slightly below zero.
        white = np.maximum(self.variance * np.diag(self.inverse), 0.0)
        return white, np.maximum(white, np.diag(self.wide))

    @cached_property
    def inflation(self) -> dict[str, float]:
        """The factor by which the residual's colour widens each variance."""
        white, wide = self._variances
        ratios = np.clip(wide / np.where(white > 0, white, np.inf), 1.0, 1e12)
        return dict(zip(self.names, ratios.tolist(), strict=True))

    @cached_property
    def errors(self) -> dict[str, float]:
        """Standard errors, with the colour accounted for."""
        return dict(zip(self.names, np.sqrt(self._variances[1]).tolist(), strict=True))


def link_covariance(
    search: Search, solution: Solution, *, coloured: bool
) -> tuple[Covariance, float]:
    """Covariance of a link's parameters, gain and offset at a solution, and the relative
    standard error of the resonance Ω; cached in the search.

    The error is NaN if Ω ended at a limit; unlike ω₀, Ω is not correlated with α and λ.
    """
    key = (solution, coloured)
    if key in search.covariances:
        return search.covariances[key]
    problem = LinkProblem.of(search, solution, inside=True)
    free = tuple(map(str, problem.free))
    joint = Covariance.of(
        (*free, *problem.linear), problem.normal, solution.cost, problem.samples
    )
    if coloured:
        joint = joint.coloured(*problem.linearised())
    own = problem.parameters(problem.place[None, :], problem.names)[1][0]
    gradients = np.eye(len(joint.names))
    gradients[: len(own), : len(own)] = own
    search.covariances[key] = (
        joint.of_functions((*problem.names, *problem.linear), gradients),
        joint.errors.get("1", math.nan),
    )
    return search.covariances[key]


def _sandwich(inverse: Real, noise: Real, products: Real) -> Real:
    """Covariance under coloured `noise`, at least as wide as the `products` of
    regressors and residual imply.

    `inverse` is the inverse of the regressors' normal matrix.
    """
    wider = np.sqrt(
        np.maximum(_diagonal(inverse, products) / _diagonal(inverse, noise), 1.0)
    )
    return inverse @ noise @ inverse * np.outer(wider, wider)


def _diagonal(inverse: Real, meat: Real) -> Real:
    # Where parameters compensate each other the terms cancel: a remainder below their
    # rounding may be negative, and depends on the machine.
    terms = np.diag(np.abs(inverse) @ np.abs(meat) @ np.abs(inverse))
    float64 = np.finfo(np.float64)
    floor = np.maximum(float64.eps * terms, float64.tiny)
    return np.maximum(np.diag(inverse @ meat @ inverse), floor)


def link_intervals(
    search: Search, solution: Solution, covariance: Covariance
) -> dict[str, Interval]:
    """The 95 % intervals of the link's parameters and the delay: n ln(cost/least cost)
    ≤ 1.96² times the factor by which the residual's colour widens a variance.

    α has an interval even if it ended at a limit.
    """
    problem = LinkProblem.of(search, solution, inside=False)
    if solution.cost <= RESOLUTION * problem.power:
        # The likelihood of a perfect fit is rounding noise.
        at = LinkProblem.of(search, solution, inside=True)
        values = at.parameters(at.place[None, :], at.names)[0][0].tolist()
        return {
            name: Interval(value - reach, value + reach, False, False)
            for name, value in zip(at.names, values, strict=True)
            for reach in (QUANTILE * covariance.errors[name],)
        }
    selection = {*covariance.names, "damping_order"}
    if solution.on_edge:
        selection.add("natural_frequency")
    names = tuple(name for name in problem.names if name in selection)
    ends = interval_ends(
        problem,
        problem.place,
        solution.cost,
        # ω₀² is linear up to the edge ω₀ = 0, and ω₀ is not.
        partial(problem.parameters, names=names, squared=True),
        np.array([covariance.inflation.get(name, 1.0) for name in names]),
    )
    intervals = dict(zip(names, ends, strict=True))
    if squares := intervals.get("natural_frequency"):
        low, high = (math.sqrt(max(x, 0.0)) for x in (squares.low, squares.high))
        # At its limit an end is open; the square is accurate to rounding, 1e-8.
        low_open = squares.low_open or low <= 1e-4 * high
        intervals["natural_frequency"] = Interval(
            low, high, low_open, squares.high_open
        )
    return intervals


# --- criteria: which structure? --------------------------------------------------------------------------

# After an autoregression a misfit is correlated over a few samples; more lags only add
# noise.
_SCORE_LAGS = 5


def structure_criteria(search: Search) -> dict[str, tuple[float, float]]:
    """Two criteria of every structure under the noise of this log, both equal to the
    AIC if it is white.

        n ln(MSE) + 2 tr(H⁻¹J)    and    n ln(σ²)/k + 2 p

    The AIC of eq. (18) takes every sample as independent. Under slow noise (AR(1), ρ =
    0.98) a fluctuation of the noise then looks like a parameter.

    The first, Takeuchi's, counts parameters according to the residual's colour. It is
    cautious, but still finds a superfluous α in one coloured log of ten. For the
    second, all residuals pass the same whitening filter, the autoregression of the
    residual of the richest structure; each fit takes the Gauss–Newton step to its
    optimum after that filter, and σ² is the variance of the rest. It distinguishes more
    structures under slow noise, but on a log whose residual is a misfit (friction, a
    motor angle that is not a straight line between samples) the filter amplifies the
    misfit; k, the ratio of the variance of the richest fit's scores to that under white
    noise, does not compensate for all of that. The two fail in different cases, so only
    a conclusion of both counts as shown.
    """
    solutions = {name: search.solve(name) for name in STRUCTURES}
    effective = {
        name: link_covariance(search, solution, coloured=True)[0].effective
        for name, solution in solutions.items()
    }
    # If any residual is noise alone, it is the richest structure's; the filter of a
    # poorer one would whiten its misfit away.
    richest = max(STRUCTURES, key=lambda name: len(STRUCTURES[name].free))
    filtered = autoregression(
        LinkProblem.of(search, solutions[richest], inside=True).linearised()[1]
    )[0]
    series = {
        name: _innovations(search, solution, filtered)
        for name, solution in solutions.items()
    }
    scores, residual = series[richest]
    variance = max(float(residual @ residual) / residual.size, 1e-300)
    meat = long_run_covariance(scores * residual, _SCORE_LAGS)
    inflation = max(
        float(np.trace(inverted(scores @ scores.T)[0] @ meat)) / variance / len(scores),
        1.0,
    )
    samples = search.window.samples
    floor = max(RESOLUTION * float(np.var(search.window.output)), 1e-300)
    return {
        name: (
            # A parameter at its limit counts, since it was free to leave it.
            samples * math.log(max(solution.cost / samples, floor))
            + 2.0 * (effective[name] + len(solution.at_bound) + solution.on_edge),
            series[name][1].size
            * math.log(max(float(np.mean(series[name][1] ** 2)), 1e-300))
            / inflation
            + 2.0 * len(STRUCTURES[name].free),
        )
        for name, solution in solutions.items()
    }


def _innovations(
    search: Search, solution: Solution, coefficients: Real
) -> tuple[Real, Real]:
    """Regressors and residual after the whitening filter, with one Gauss–Newton step."""
    regressors, residual = LinkProblem.of(search, solution, inside=True).linearised()
    # scipy.signal has such a filter, but its import takes as long as the fit.
    rows = np.stack(
        [np.convolve(row, coefficients, "valid")[1:] for row in (*regressors, residual)]
    )
    size = np.linalg.norm(rows[:-1], axis=1)
    columns = rows[:-1] / np.where(size > 0, size, 1.0)[:, None]
    # One step is enough: the fit without the filter is within a few standard errors of
    # the filtered one, where the prediction is linear.
    step = lstsq(columns.T, rows[-1], cond=1e-9)[0]
    return columns, rows[-1] - step @ columns
