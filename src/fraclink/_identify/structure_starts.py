"""Where the search for a structure begins: draws of orders and delays, coefficients by
linear least squares.

Sanathanan and Koerner, IEEE Trans. Autom. Control 8 (1963) 56: the equation N U = D Y
is straight in the coefficients, and divided by the last D its error is that of the
output.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._identify.structure_data import Spectrum
from fraclink._identify.structure_problem import StructureProblem

__all__ = ["drawn_starts"]

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_DRAWS = 60  # for each order or delay that is free, up to three
_DRAWS_AT_RANDOM = 600
_USUAL_ORDERS = (0.1, 2.5)  # of draws: a descent finds the rest of the range by itself
_ROUNDS = 5  # of Sanathanan and Koerner


def drawn_starts(problem: StructureProblem, spectrum: Spectrum) -> dict[str, Reals]:
    """Values of all free parameters to begin at, shape (M,) each.

    Coefficients by least squares are near where there is little noise; those at random
    are near some of the time under any.
    """
    names, roles = problem.names, problem.structure.roles
    linear = _linear_coefficients(problem, spectrum)
    shaped = [name for name in names if roles[name] != "coefficient"]
    solved = _DRAWS * min(max(len(shaped), 1), 3) if linear else 0
    # Evenly spread and the same in every run: of 60 draws at random some orders would
    # be found by some seeds only.
    count = solved + _DRAWS_AT_RANDOM // (3 if linear else 1)
    starts = {
        name: _drawn(problem, spectrum, name, column)
        for name, column in zip(names, _halton(count, len(names)).T, strict=True)
    }
    if not linear:
        return starts
    first = {name: column[:solved] for name, column in starts.items()}
    least = first | _least_squares_coefficients(problem, spectrum, first, linear)
    # Least squares know neither a range nor that a machine is stable: what came out
    # negative is tried as large with the other sign, too.
    turned = least | {
        name: math.copysign(1.0, problem.limits[name][1]) * np.abs(least[name])
        for name in linear
    }
    return {
        name: np.concatenate([least[name], turned[name], column[solved:]])
        for name, column in starts.items()
    }


def _drawn(
    problem: StructureProblem, spectrum: Spectrum, name: str, uniform: Reals
) -> Reals:
    low, high = problem.limits[name]
    role = problem.structure.roles[name]
    if role == "order":
        least = max(low, min(_USUAL_ORDERS[0], high))
        most = min(high, max(_USUAL_ORDERS[1], low))
        return np.asarray(least + (most - least) * uniform)
    size = np.abs(spectrum.points)
    slowest, fastest = float(size.min()), float(size.max())
    if role == "delay":
        # Small ones matter most, and none at all is the most usual.
        longest = min(high, 1.0 / slowest)
        shortest = longest * slowest / fastest
        scaled = longest * (fastest / slowest) ** (uniform - 1.0) - shortest
        return np.where(uniform < 0.25, low, np.maximum(scaled, low))
    if name == problem.gain:
        return np.ones(uniform.size)
    if low > 0.0:
        # Somebody knows where it lies; evenly in the logarithm, as its coordinate is.
        return np.asarray(low * (high / low) ** uniform)
    # ω^(−4 … 4) for a frequency of the band: coefficients are powers of one, whatever
    # the structure.
    frequency = slowest * (fastest / slowest) ** ((uniform * 7.0) % 1.0)
    sign = np.where((uniform * 31.0) % 1.0 < 0.25, -1.0, 1.0) if low < 0.0 else 1.0
    return np.clip(sign * frequency ** (8.0 * uniform - 4.0), low, high)


def _linear_coefficients(
    problem: StructureProblem, spectrum: Spectrum
) -> tuple[str, ...]:
    """Free coefficients in which numerator and denominator are straight together."""
    # Straight if, and at points in general position only if, the values at zero and one
    # unit of each coefficient add up to those at any other place.
    points = spectrum.points[:: max(1, spectrum.points.size // 5)]
    points = points / np.median(np.abs(points))
    middle = problem.middle()
    whole = [part[0] for part in _affine(problem, middle, (), points)]

    def are_straight(names: tuple[str, ...]) -> bool:
        sizes = np.array([1.0, *(middle[name][0, 0] for name in names)])
        parts = _affine(problem, middle, names, points)
        built = [np.tensordot(sizes, part, 1) for part in parts]
        return np.allclose(built, whole, rtol=1e-9, atol=1e-12)

    linear: tuple[str, ...] = ()
    for name in problem.names:
        if problem.structure.roles[name] == "coefficient":
            with_it = (*linear, name)
            linear = with_it if are_straight(with_it) else linear
    return linear


def _affine(
    problem: StructureProblem,
    values: Mapping[str, Any],
    names: tuple[str, ...],
    points: Complexes,
) -> tuple[Complexes, Complexes]:
    """Numerator and denominator without the coefficients `names`, and what a unit of
    each adds, shape (1 + n, M, K).
    """
    none = {**values, **dict.fromkeys(names, np.zeros((1, 1)))}
    probes = [none, *({**none, name: np.ones((1, 1))} for name in names)]
    count = max(np.shape(value)[0] for value in values.values())
    parts = []
    for part in problem.structure.quotient:
        rows = [part.response(probe, points) for probe in probes]
        found = np.stack([np.broadcast_to(r, (count, points.size)) for r in rows])
        found[1:] -= found[0]
        parts.append(found)
    return parts[0], parts[1]


def _least_squares_coefficients(
    problem: StructureProblem,
    spectrum: Spectrum,
    values: Mapping[str, Reals],
    names: tuple[str, ...],
) -> dict[str, Reals]:
    """Coefficients of every draw by iterated linear least squares, shape (M,) each."""
    drawn = {name: np.array([[value]]) for name, value in problem.fixed.items()}
    drawn |= {name: column[:, None] for name, column in values.items()}
    tops, bottoms = _affine(problem, drawn, names, spectrum.points)
    equations = tops * spectrum.input - bottoms * spectrum.output  # N U − D Y is zero
    divisor = np.ones(equations.shape[1:], dtype=np.complex128)
    found = np.ones((len(divisor), len(names)))
    for _ in range(_ROUNDS):
        # The first round weighs by one: what Levy did alone, which favours high
        # frequencies; from the second on the last denominator takes that away.
        row = spectrum.weight / np.maximum(np.abs(divisor), 1e-300)
        columns = [row * equation for equation in equations[1:]]
        if spectrum.of_constant is not None and math.isnan(problem.offset):
            # N U + c D/s − D Y: an offset in the output passes the same denominator.
            columns.append(row * spectrum.of_constant * divisor)
        if spectrum.of_state is not None:
            columns += [row * state for state in spectrum.of_state]
        solution = _real_solutions(np.stack(columns, axis=1), -row * equations[0])
        found = solution[:, : len(names)]
        divisor = bottoms[0] + np.einsum("nmk,mn->mk", bottoms[1:], found)
    return {name: found[:, k] for k, name in enumerate(names)}


def _real_solutions(matrix: Complexes, right: Complexes) -> Reals:
    """Real solutions (M, n) of M complex systems, matrix (M, n, K), right (M, K);
    columns are scaled.
    """
    real = np.concatenate([matrix.real, matrix.imag], axis=2)
    wanted = np.nan_to_num(np.concatenate([right.real, right.imag], axis=1))
    size = np.sqrt(np.einsum("mnk,mnk->mn", real, real))
    size = np.where((size > 0) & np.isfinite(size), size, 1.0)
    # QR and not the normal matrix: columns of nearly equal orders are nearly parallel,
    # and its square would lose twice the digits.
    q, r = np.linalg.qr(np.nan_to_num(real / size[:, :, None]).transpose(0, 2, 1))
    diagonal = np.einsum("mnn->mn", r)
    # Two columns that are one (orders that were drawn alike): the pivot is held away
    # from zero, and the start is merely a bad one.
    small = np.abs(diagonal) < 1e-10
    r[:, range(r.shape[1]), range(r.shape[1])] = np.where(small, 1e-10, diagonal)
    across = np.einsum("mkn,mk->mn", q, wanted)
    return np.asarray(np.linalg.solve(r, across[:, :, None])[:, :, 0] / size)


def _halton(count: int, size: int) -> Reals:
    """Points that fill the unit cube evenly, the same in every run, shape (count,
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
