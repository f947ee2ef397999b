"""Covariance of a least-squares point, white and coloured, in the link's own parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._kernels import FitProblem
from fraclink.identify.problem import columns_of
from fraclink.identify.search import Search, Solution
from fraclink.identify.shape import NAMES, mask_of, model_gradients
from fraclink.identify.statistics import correlation_lag, long_run_covariance
from fraclink.link import structure

__all__ = ["Uncertainty", "parameter_names", "uncertainty"]

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariances of the free parameters, in the order of `names`.

    `white` holds for independent residuals, `coloured` for residuals of any (short) correlation; None
    where it was not asked for. `singular` says that the log does not determine all of them.
    """

    names: tuple[str, ...]
    white: Matrix
    coloured: Matrix | None
    lag: int
    singular: bool


def parameter_names(solution: Solution, search: Search) -> tuple[str, ...]:
    """Names of the parameters that have an error: free and inside their limits."""
    inside = [i for i in solution.free if i not in solution.at_bound]
    own = [n for n in structure(solution.structure).free if _is_inside(n, solution, inside)]
    extra = ["delay"] if 4 in inside else []
    extra += ["gain"] if np.isnan(search.gain) else []
    extra += ["offset"] if np.isnan(search.offset) else []
    return (*own, *extra)


def _is_inside(name: str, solution: Solution, inside: list[int]) -> bool:
    needed = {"natural_frequency": (1,), "order": (0,), "damping": (2,), "damping_order": (3,)}[name]
    return all(i in inside for i in needed)


def gradients(solution: Solution, names: tuple[str, ...], inside: tuple[int, ...], linear: int) -> Matrix:
    """∂(named parameters)/∂(coordinates inside their limits, then gain, then offset)."""
    model = model_gradients(solution.shape)
    rows = []
    tail = [n for n in names if n in ("gain", "offset")]
    for name in names:
        row = np.zeros(len(inside) + linear)
        if name in tail:
            row[len(inside) + tail.index(name)] = 1.0
        elif name == "delay":
            row[inside.index(4)] = 1.0
        else:
            row[: len(inside)] = [model[NAMES.index(name), i] if i < 4 else 0.0 for i in inside]
        rows.append(row)
    return np.array(rows)


def uncertainty(search: Search, solution: Solution, kernel: FitProblem, *, coloured: bool) -> Uncertainty:
    """Covariance at a solution; `coloured` adds the sandwich estimate from the residual's scores."""
    names = parameter_names(solution, search)
    inside = tuple(i for i in solution.free if i not in solution.at_bound)
    columns = [3 + solution.free.index(i) for i in inside]
    scale = [solution.gain] * len(inside)
    for value, column in ((search.gain, 1), (search.offset, 2)):
        if np.isnan(value):
            columns.append(column)
            scale.append(1.0)
    linear = len(columns) - len(inside)
    normal = solution.gram[np.ix_(columns, columns)] * np.outer(scale, scale)
    inverse, singular = _inverse(normal)
    samples = search.window.samples
    variance = solution.cost / max(samples - len(columns), 1)
    through = gradients(solution, names, inside, linear)
    white = variance * through @ inverse @ through.T
    if not coloured:
        return Uncertainty(names, white, None, 1, singular)
    raw = columns_of(kernel, solution.shape, mask_of(solution.free))
    residual = search.window.output - solution.gain * raw[0] - solution.offset
    by_column = {1: raw[0], 2: np.ones(samples)} | {3 + k: raw[1 + k] for k in range(len(solution.free))}
    scores = np.array([s * by_column[c] * residual for c, s in zip(columns, scale, strict=True)])
    lag = correlation_lag(residual)
    # Five correlation times catch the sum; a fifth of the log is the most that can be averaged.
    meat = long_run_covariance(scores, min(max(5 * lag, 10), samples // 5))
    sandwich = through @ inverse @ meat @ inverse @ through.T
    return Uncertainty(names, white, sandwich, lag, singular)


def _inverse(normal: Matrix) -> tuple[Matrix, bool]:
    size = np.sqrt(np.diag(normal))
    size[size == 0] = 1.0
    values, vectors = np.linalg.eigh(normal / np.outer(size, size))
    singular = bool(values[0] < 1e-10)
    values = np.maximum(values, 1e-14)
    inverse: Matrix = (vectors / values) @ vectors.T / np.outer(size, size)
    return inverse, singular
