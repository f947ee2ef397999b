"""Covariance of a least-squares point, white and coloured, in the link's own parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import structure
from fraclink._identify.problem import columns_of
from fraclink._identify.search import Search
from fraclink._identify.shape import NAMES, mask_of, model_gradients
from fraclink._identify.solution import Solution
from fraclink._identify.statistics import correlation_lag, long_run_covariance
from fraclink._kernels import FitProblem

__all__ = ["Uncertainty", "uncertainty"]

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariances of the free parameters, in the order of `names`.

    `white` holds for independent residuals, `coloured` for residuals of any (short) correlation; None
    where it was not asked for. `lag` is the residual's correlation in samples, `effective` the number of
    parameters that the residual's colour makes of those fitted (Takeuchi's trace), `singular` says that
    the log does not determine all of them.
    """

    names: tuple[str, ...]
    white: Matrix
    coloured: Matrix | None
    lag: int
    effective: float
    singular: bool


def uncertainty(search: Search, solution: Solution, kernel: FitProblem, *, coloured: bool) -> Uncertainty:
    """Covariance at a solution; `coloured` adds the sandwich estimate from the residual's scores."""
    inside = [i for i in solution.free if i not in solution.at_bound]
    linear = [c for c, value in ((1, search.gain), (2, search.offset)) if np.isnan(value)]
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
    if not coloured:
        return Uncertainty(names, white, None, 1, float(basis.shape[1]), singular)
    raw = columns_of(kernel, solution.shape, mask_of(solution.free))
    residual = search.window.output - solution.gain * raw[0] - solution.offset
    by_column = {1: raw[0], 2: np.ones(samples)} | {3 + k: raw[1 + k] for k in range(len(solution.free))}
    scores = basis.T @ (scale[:, None] * np.array([by_column[c] for c in columns]) * residual)
    lag = correlation_lag(residual)
    # Five correlation times catch the sum; a fifth of the log is the most that can be averaged.
    meat = long_run_covariance(scores, min(max(5 * lag, 10), samples // 5))
    sandwich = through @ inverse @ meat @ inverse @ through.T
    effective = float(np.trace(inverse @ meat)) / variance if variance > 0 else float(basis.shape[1])
    return Uncertainty(names, white, sandwich, lag, effective, singular)


def _basis(solution: Solution, inside: list[int], linear: int) -> Matrix:
    """Directions in which the point may move: all, but on ω₀ = 0 the damping ratio follows α."""
    basis = np.eye(len(inside) + linear)
    if solution.on_edge and 2 in inside and 3 in inside:
        basis[inside.index(2), inside.index(3)] = np.pi / 4 / np.cos(solution.shape[3] * np.pi / 2) ** 2
        basis = np.delete(basis, inside.index(2), axis=1)
    return basis


def _names(solution: Solution, inside: list[int], linear: list[int]) -> tuple[str, ...]:
    """Names of the parameters that have an error: free and inside their limits."""
    needed = {"natural_frequency": 1, "order": 0, "damping": 2, "damping_order": 3}
    own = [name for name in structure(solution.structure).free if needed[name] in inside]
    if solution.on_edge:
        own = [name for name in own if name != "natural_frequency"]
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


def _inverse(normal: Matrix) -> tuple[Matrix, bool]:
    size = np.sqrt(np.diag(normal))
    size[size == 0] = 1.0
    values, vectors = np.linalg.eigh(normal / np.outer(size, size))
    singular = bool(values[0] < 1e-10)
    values = np.maximum(values, 1e-14)
    inverse: Matrix = (vectors / values) @ vectors.T / np.outer(size, size)
    return inverse, singular
