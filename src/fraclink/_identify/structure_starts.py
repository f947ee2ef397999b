"""Starts of the search for a structure: draws of orders and delays, coefficients by
linear least squares.

Sanathanan and Koerner, IEEE Trans. Autom. Control 8 (1963) 56: the equation N U = D Y
is linear in the coefficients, and divided by the previous D its error is that of the
output.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from fraclink._identify.structure_data import Spectrum
from fraclink._identify.structure_problem import STEP, StructureProblem
from fracsys.checks import Complex, Real

__all__ = ["drawn_starts"]


_DRAWS = 180
_USUAL_ORDERS = (0.1, 2.5)  # range of the draws: a descent covers the rest by itself
_ROUNDS = 5  # iterations of Sanathanan and Koerner


def drawn_starts(problem: StructureProblem, spectrum: Spectrum) -> dict[str, Real]:
    """Starting values of all free parameters, shape (M,) each.

    Coefficients by least squares are close if there is little noise; random ones are
    sometimes close with any noise.
    """
    names, roles = problem.names, problem.structure.roles
    # Evenly spread and the same in every run: with 60 random draws some orders would be
    # found with some seeds only.
    starts = {
        name: _drawn(problem, spectrum, name, column)
        for name, column in zip(names, _halton(_DRAWS, len(names)).T, strict=True)
    }
    coefficients = tuple(name for name in names if roles[name] == "coefficient")
    if not coefficients:
        return starts
    least = starts | _least_squares_coefficients(
        problem, spectrum, starts, coefficients
    )
    # Least squares do not enforce stability: a negative result is also tried with the
    # opposite sign.
    mirror = least | {
        name: math.copysign(1.0, problem.limits[name][1]) * np.abs(least[name])
        for name in coefficients
    }
    return {
        name: np.concatenate([least[name], mirror[name], starts[name]])
        for name in names
    }


def _drawn(
    problem: StructureProblem, spectrum: Spectrum, name: str, uniform: Real
) -> Real:
    low, high = problem.limits[name]
    role = problem.structure.roles[name]
    if role == "order":
        least = max(low, min(_USUAL_ORDERS[0], high))
        most = min(high, max(_USUAL_ORDERS[1], low))
        return np.asarray(least + (most - least) * uniform)
    size = np.abs(spectrum.points)
    slowest, fastest = float(size.min()), float(size.max())
    if role == "delay":
        # Small delays matter most, and no delay at all is the most usual case.
        longest = min(high, 1.0 / slowest)
        shortest = longest * slowest / fastest
        length = longest * (fastest / slowest) ** (uniform - 1.0) - shortest
        return np.where(uniform < 0.25, low, np.maximum(length, low))
    if name == problem.gain:
        return np.ones(uniform.size)
    if low > 0.0:
        # A range was given; spaced logarithmically, like the coordinate.
        return np.asarray(low * (high / low) ** uniform)
    # ω^(−4 … 4) for a frequency of the band: coefficients are powers of a frequency,
    # whatever the structure.
    frequency = slowest * (fastest / slowest) ** ((uniform * 7.0) % 1.0)
    sign = np.where((uniform * 31.0) % 1.0 < 0.25, -1.0, 1.0) if low < 0.0 else 1.0
    return np.clip(sign * frequency ** (8.0 * uniform - 4.0), low, high)


def _least_squares_coefficients(
    problem: StructureProblem,
    spectrum: Spectrum,
    draws: Mapping[str, Real],
    names: tuple[str, ...],
) -> dict[str, Real]:
    """Coefficients of every draw by iterated least squares of N U = D Y, shape (M,)
    each.

    The equation is linear in a coefficient that stands alone before its term, so one
    step gives its solution; the steps of the others are Gauss-Newton steps.
    """
    values = {name: np.array([[value]]) for name, value in problem.fixed.items()}
    values |= {name: column[:, None] for name, column in draws.items()}
    columns, divisor = _equation(problem, spectrum, values, names)
    row = np.broadcast_to(spectrum.weight, divisor.shape)
    for _ in range(_ROUNDS):
        # In the first round all weights are 1, as in Levy's method, which favours high
        # frequencies; from the second round on, division by the previous denominator
        # removes this.
        own = [row * column for column in columns]
        if spectrum.of_constant is not None and math.isnan(problem.offset):
            # N U + c D/s − D Y: an offset in the output passes the same denominator.
            own.append(row * spectrum.of_constant * divisor)
        if spectrum.of_state is not None:
            own += [row * state for state in spectrum.of_state]
        steps = _real_solutions(np.stack(own[1:], axis=1), -own[0])
        for k, name in enumerate(names):
            values[name] = np.clip(
                values[name] + steps[:, k : k + 1], *problem.limits[name]
            )
        columns, divisor = _equation(problem, spectrum, values, names)
        row = spectrum.weight / np.maximum(np.abs(divisor), 1e-300)
    return {name: values[name][:, 0] for name in names}


def _equation(
    problem: StructureProblem,
    spectrum: Spectrum,
    values: Mapping[str, Any],
    names: tuple[str, ...],
) -> tuple[list[Complex], Complex]:
    """N U − D Y and its slopes along coefficients, and D, shape (M, K) each."""
    top, bottom = problem.structure.quotient
    count = max(np.shape(value)[0] for value in values.values())
    shape = (count, spectrum.points.size)

    def parts(here: Mapping[str, Any]) -> tuple[Complex, Complex]:
        n, d = (part.response(here, spectrum.points) for part in (top, bottom))
        return n * spectrum.input - d * spectrum.output, d

    error, divisor = (np.broadcast_to(part, shape) for part in parts(values))
    columns = [error]
    for name in names:
        step = STEP * np.where(values[name] == 0.0, 1.0, values[name])
        there = parts({**values, name: values[name] + step})[0]
        columns.append(np.broadcast_to((there - error) / step, shape))
    return columns, divisor


def _real_solutions(matrix: Complex, right: Complex) -> Real:
    """Real solutions (M, n) of M complex systems, matrix (M, n, K), right (M, K);
    columns are scaled.
    """
    real = np.concatenate([matrix.real, matrix.imag], axis=2)
    target = np.nan_to_num(np.concatenate([right.real, right.imag], axis=1))
    size = np.sqrt(np.einsum("mnk,mnk->mn", real, real))
    size = np.where((size > 0) & np.isfinite(size), size, 1.0)
    # QR instead of the normal matrix: columns of nearly equal orders are nearly
    # parallel, and its condition is squared.
    q, r = np.linalg.qr(np.nan_to_num(real / size[:, :, None]).transpose(0, 2, 1))
    diagonal = np.einsum("mnn->mn", r)
    # Two equal columns (orders drawn alike): the pivot is kept away from zero, and the
    # start is merely a bad one.
    small = np.abs(diagonal) < 1e-10
    r[:, range(r.shape[1]), range(r.shape[1])] = np.where(small, 1e-10, diagonal)
    across = np.einsum("mkn,mk->mn", q, target)
    return np.asarray(np.linalg.solve(r, across[:, :, None])[:, :, 0] / size)


def _halton(count: int, size: int) -> Real:
    """Points spread evenly over the unit cube, the same in every run, shape (count,
    size).
    """
    primes = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37)
    result = np.zeros((count, size))
    for k in range(size):
        number, weight = np.arange(1, count + 1), 1.0
        while number.any():
            weight /= primes[k]
            number, digit = np.divmod(number, primes[k])
            result[:, k] += weight * digit
    return result
