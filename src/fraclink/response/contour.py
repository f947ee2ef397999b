"""Step and ramp responses at single times: trapezoid on a parabola, with exact correction of its poles.

    f(t) = 1/(2πi) ∫ G(s) s^(-n) e^(st) ds,   s = μ (1 + iu)²,   u = kh

17 nodes give 1e-14 for any singularity on the negative axis and at 0. A pole p elsewhere enters with the
weight 1/(1 - exp(-2πi u_p/h)) of its residue, u_p its place in the u-plane: 1 outside the parabola, 0 deep
inside, and exact in between.

Source: Weideman and Trefethen, Math. Comp. 76 (2007) 1341, parabola with h = 3/N, μ = πN/(12 t).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fraclink.response.quotient import Complexes, Quotient

__all__ = ["held_response"]

_NODES = 16  # error e^(-2πN/3) = 3e-15; more nodes only raise the rounding error e^(πN/12)
_H = 3.0 / _NODES


def held_response(quotient: Quotient, times: NDArray[np.float64], power: int) -> NDArray[np.float64]:
    """Return the inverse Laplace transform of G(s)/s^power at times > 0 [s] (1 step, 2 ramp, 0 impulse)."""
    return np.array([_single(quotient, float(t), power) for t in np.ravel(times)])


def _single(quotient: Quotient, time: float, power: int) -> float:
    scale = math.pi * _NODES / (12.0 * time)
    simple, clusters = quotient.clusters()
    inside = [z for z in simple if z.imag < math.pi - 1e-9]
    packed = [c for c in clusters if c.centre.imag < math.pi - 1e-9]
    places = np.array([_place(z, scale) for z in (*inside, *(c.centre for c in packed))])
    # Only these two grids are symmetric, so that conjugate poles have conjugate weights.
    offset = max((0.0, 0.5), key=lambda o: _distance(places, o))

    def kernel(z: Complexes) -> Complexes:
        u = (np.exp(0.5 * (z - math.log(scale))) - 1.0) / 1j
        return np.asarray(1.0 / (1.0 - np.exp(-2j * np.pi * (u / _H - offset))))

    u = (np.arange(-_NODES - 1, _NODES + 2) + offset) * _H
    root = 1.0 + 1j * u
    z = 2.0 * np.log(root) + math.log(scale)
    values = quotient.value(z) * np.exp(z * (1 - power) + scale * root**2 * time) / root
    total = float((values.real * _H / math.pi).sum())
    for pole in inside:
        point = np.array([pole])
        weight = kernel(point) * np.exp(-(power - 1) * point + np.exp(point) * time)
        total += (1.0 if pole.imag == 0.0 else 2.0) * float((quotient.residue(pole) * weight[0]).real)
    for cluster in packed:
        gap = _clearance(cluster.centre, scale, offset)
        points, weights = quotient.circle(cluster, gap, kernel)
        part = weights * np.exp(-(power - 1) * points + np.exp(points) * time)
        total += (1.0 if cluster.centre.imag == 0.0 else 2.0) * float(part.sum().real)
    return total


def _place(z: complex, scale: float) -> complex:
    return complex((np.exp(0.5 * (z - math.log(scale))) - 1.0) / 1j)


def _distance(places: Complexes, offset: float) -> float:
    """Distance, in steps, of the nearest pole to a node of the shifted grid."""
    if not places.size:
        return -offset
    steps = places / _H - offset
    return float(np.min(np.abs(steps - np.round(steps.real))))


def _clearance(centre: complex, scale: float, offset: float) -> float:
    """Distance in ln s from a cluster to the nearest node of the parabola or to the cut."""
    nodes = 2.0 * np.log(1.0 + 1j * (np.arange(-40, 41) + offset) * _H) + math.log(scale)
    return float(min(np.abs(nodes - centre).min(), math.pi - centre.imag))
