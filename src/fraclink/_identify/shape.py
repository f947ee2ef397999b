"""The coordinates a fit moves in, and the way from them to the link's parameters.

A shape is (λ, ln Ω, ζ, α, τ): order of inertia, logarithm of the resonance [rad/s], damping ratio there,
order of the damping, delay [s]. With S = sin(απ/2), C = cos(απ/2)

    μ = 2ζ Ω^(λ−α) / S,    ω₀² = Ω^λ (1 − 2ζ C/S).

In (ω₀, μ, α) a D-FOM fit runs along a valley, since α, μ and ω₀ shift one resonance and one width
between three numbers; in (Ω, ζ, α) the valley is the α axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel

__all__ = [
    "ALPHA_LIMITS",
    "COORDINATES",
    "FREE",
    "NAMES",
    "ORDER_LIMITS",
    "mask_of",
    "model_gradients",
    "model_of",
    "on_physical_side",
    "shape_of",
    "undamped_as_damped",
]

Shape = NDArray[np.float64]

COORDINATES = ("order", "resonance", "ratio", "damping_order", "delay")
FREE: dict[str, tuple[int, ...]] = {"UD-IOM": (1,), "D-IOM": (1, 2), "UD-FOM": (0, 1), "D-FOM": (1, 2, 3)}
NAMES = ("natural_frequency", "order", "damping", "damping_order")
# At λ = 1 the vibration pole lies on the branch cut and there is no vibration left to identify.
ORDER_LIMITS = (1.01, 2.0)
# Beyond, s^α is stiffness (0) or inertia (2). The lower limit is that close so that UD-FOM with λ = 2 − α
# lies inside up to λ = 1.9999.
ALPHA_LIMITS = (1e-4, 1.9)


def mask_of(free: Sequence[int]) -> int:
    """Bits of the free coordinates, as the kernel wants them."""
    return sum(1 << i for i in free)


def damping_and_square(shape: Shape) -> tuple[float, float]:
    """(μ, ω₀²) of a shape; a rounding error below zero is zero."""
    order, log_resonance, ratio, other = (float(x) for x in shape[:4])
    sine, cosine = math.sin(other * math.pi / 2), math.cos(other * math.pi / 2)
    whole = math.exp(order * log_resonance)
    damping = 2 * ratio * math.exp((order - other) * log_resonance) / sine
    return damping, max(whole * (1 - 2 * ratio * cosine / sine), 0.0)


def model_of(shape: Shape, stiffness: float, payload: float | None) -> LinkModel:
    """The link model of a shape."""
    damping, square = damping_and_square(shape)
    order, other = float(shape[0]), float(shape[3])
    # 1e-9 of the stiffness is below what any double-precision fit resolves: the D-FOM that is a UD-FOM.
    square = 0.0 if damping > 0 and square < 1e-9 * math.exp(order * shape[1]) else square
    return LinkModel(stiffness, math.sqrt(square), order, damping, other if damping > 0 else 1.0, payload)


def shape_of(model: LinkModel, delay: float = 0.0) -> Shape:
    """The shape of a link model (for λ = 2 exact; a general model's damping is matched at its pole)."""
    pole = model.pole
    if model.damping == 0:
        return np.array([model.order, math.log(abs(pole)), 0.0, 1.0, delay])
    turn = model.damping_order * math.pi / 2
    resonance = abs(pole)
    for _ in range(60):  # Ω² = ω₀² + μ Ω^α cos(απ/2): a contraction for a weakly damped link
        reach = model.damping * resonance**model.damping_order
        resonance = math.sqrt(max(model.natural_frequency**2 + reach * math.cos(turn), 1e-12))
    ratio = reach * math.sin(turn) / (2 * resonance**2)
    return np.array([model.order, math.log(resonance), ratio, model.damping_order, delay])


def undamped_as_damped(shape: Shape) -> Shape:
    """The D-FOM that is the UD-FOM of `shape`: ω₀ = 0, μ = ω₀², α = 2 − λ (its inertia divided by s^α)."""
    order = float(shape[0])
    other = min(max(2 - order, ALPHA_LIMITS[0]), ALPHA_LIMITS[1])
    turn = other * math.pi / 2
    log_resonance = shape[1] + math.log(math.cos(turn)) / order
    return np.array([2.0, log_resonance, math.tan(turn) / 2, other, shape[4]])


def model_gradients(shape: Shape) -> NDArray[np.float64]:
    """∂(ω₀, λ, μ, α)/∂(λ, ln Ω, ζ, α), shape (4, 4), by central differences (exact to 1e-9 here)."""

    def values(point: Shape) -> NDArray[np.float64]:
        damping, square = damping_and_square(point)
        return np.array([math.sqrt(square), point[0], damping, point[3]])

    columns = []
    for i in range(4):
        step = 1e-6
        up, down = shape.copy(), shape.copy()
        up[i] += step
        down[i] -= step
        columns.append((values(up) - values(down)) / (2 * step))
    return np.stack(columns, axis=1)


def on_physical_side(shape: Shape) -> Shape:
    """The shape with ζ no larger than tan(απ/2)/2, beyond which ω₀² would be negative."""
    other = float(shape[3])
    if other < 1 and shape[2] > (most := math.tan(other * math.pi / 2) / 2):
        shape = shape.copy()
        shape[2] = most
    return shape
