"""The minimisation of a joint fit: Levenberg–Marquardt on the Gram matrices of all logs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import structure as structure_row
from fraclink._identify.errors_of_fit import uncertainty
from fraclink._identify.joint import Coordinates
from fraclink._identify.profile import reduced
from fraclink._identify.search import Search
from fraclink._identify.shape import ALPHA_LIMITS, ORDER_LIMITS, Shape, damping_and_square
from fraclink._identify.solution import Solution
from fraclink.errors import NotConvergedError

__all__ = ["make_coordinates", "minimise", "start_of", "weight_of"]

_ITERATIONS = 60


def weight_of(search: Search, solution: Solution) -> float:
    """1/(σ² k): a coloured residual counts as fewer samples."""
    errors = uncertainty(search, solution, search.kernel, coloured=True)
    variance = solution.cost / search.window.samples
    own = [i for i, name in enumerate(errors.names) if name in ("order", "natural_frequency", "damping")]
    if errors.coloured is None or not own:
        return 1 / variance
    ratios = np.diag(errors.coloured)[own] / np.maximum(np.diag(errors.white)[own], 1e-300)
    return 1 / (variance * max(1.0, float(np.median(ratios)))) if variance > 0 else 1.0


def make_coordinates(
    structure: str,
    names: tuple[str, ...],
    tied: bool,
    logs: int,
    delay: float | None,
    payloads: tuple[float, ...] | None,
) -> Coordinates:
    own = [n for n in structure_row(structure).free if n != "natural_frequency"]
    everything = ("frequency", *own, *(() if delay is not None else ("delay",)))
    shared = (("frequency",) if tied else ()) + tuple(n for n in names if n in everything)
    return Coordinates(everything, shared, logs, delay, payloads)


def start_of(coordinates: Coordinates, alone: Sequence[Solution], structure: str) -> NDArray[np.float64]:
    """Every parameter where its log alone has it; common ones in the mean."""
    theta = np.zeros(coordinates.size)
    count = np.zeros(coordinates.size)
    for i, solution in enumerate(alone):
        shape = solution.shape.copy()
        if structure == "D-FOM" and solution.on_edge:
            # ω₀ = 0 holds for one μ only; from the middle of the valley a common μ finds its place.
            ratio = float(shape[2])
            shape[2:4] = ratio, 1.0
        values = _values(shape, coordinates, i)
        for name in coordinates.names:
            k = coordinates.index(name, i)
            theta[k] += values[name]
            count[k] += 1
    return theta / count


def _values(shape: Shape, coordinates: Coordinates, log: int) -> dict[str, float]:
    damping, square = damping_and_square(shape)
    frequency = float(shape[1])
    if coordinates.payloads is not None:
        frequency = math.log(max(square, 1e-12) * coordinates.payloads[log])
    return {
        "frequency": frequency,
        "order": float(shape[0]),
        "damping": math.log(max(damping, 1e-6)),
        "damping_order": float(shape[3]),
        "delay": float(shape[4]),
    }


def _evaluate(
    coordinates: Coordinates, searches: Sequence[Search], weights: Sequence[float], theta: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Weighted cost, its normal matrix and slope in θ; the cost is infinite outside of what a link can be."""
    size = coordinates.size
    normal, slope, total = np.zeros((size, size)), np.zeros(size), 0.0
    for i, (search, weight) in enumerate(zip(searches, weights, strict=True)):
        shape, rates = coordinates.shape(theta, i)
        most = math.tan(shape[3] * math.pi / 2) / 2 if shape[3] < 1 else 0.9
        inside = (
            ORDER_LIMITS[0] <= shape[0] <= ORDER_LIMITS[1] and ALPHA_LIMITS[0] <= shape[3] <= ALPHA_LIMITS[1]
        )
        moving = [k for k in range(5) if np.any(rates[k])]
        mask = sum(1 << k for k in moving)
        gram = search.kernel.gram(shape, mask) if inside and shape[2] <= most else None
        if gram is None:
            return math.inf, normal, slope
        inner, own_slope, cost = reduced(gram, search)
        part = rates[moving]
        normal += weight * part.T @ inner @ part
        slope += weight * part.T @ own_slope
        total += weight * cost
    return total, normal, slope


def minimise(
    coordinates: Coordinates, searches: Sequence[Search], weights: Sequence[float], theta: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Levenberg–Marquardt on all logs at once."""
    orders = [coordinates.index("order", i) for i in range(coordinates.logs) if "order" in coordinates.names]
    theta[orders] = np.clip(theta[orders], *ORDER_LIMITS)
    cost, normal, slope = _evaluate(coordinates, searches, weights, theta)
    if not math.isfinite(cost):
        raise NotConvergedError(
            "the joint fit",
            reached=math.inf,
            wanted=0.0,
            remedy="fit each log alone first, they may not belong together",
        )
    damping = 1e-3
    for _ in range(_ITERATIONS):
        size = np.maximum(np.diag(normal), 1e-300)
        step = np.linalg.solve(normal + damping * np.diag(size), slope)
        step *= min(1.0, 0.4 / max(float(np.max(np.abs(step))), 1e-300))
        trial = theta + step
        trial[orders] = np.clip(trial[orders], *ORDER_LIMITS)
        next_cost, next_normal, next_slope = _evaluate(coordinates, searches, weights, trial)
        if next_cost < cost:
            gained = cost - next_cost
            theta, cost, normal, slope = trial, next_cost, next_normal, next_slope
            damping *= 0.1
            if gained < 1e-10 * cost:
                break
        else:
            damping *= 10
            if damping > 1e8 or float(step @ slope) < 1e-10 * cost:
                break
    return theta, normal
