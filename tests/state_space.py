"""The shipped law and a twin in state space: an independent computation of their
sampled loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

import fraclink as fl
from fraclink._arm.beam import residual_inertia

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x⁺ = A x + b u, y = c x + d u."""

    a: Real
    b: Real
    c: Real
    d: float

    def response(self, z: Complex) -> Complex:
        """Return the transfer function at each z, shape (N,)."""
        # one point at a time: 90 states of a beam at 3000 points are 400 MB of matrices
        one = np.eye(len(self.b))
        values = [self.c @ np.linalg.solve(x * one - self.a, self.b) for x in z]
        return np.array(values, dtype=np.complex128) + self.d


def of_law(law: fl.Law) -> StateSpace:
    """Return the correction (1 − z⁻¹)(direct + Σ gain/(z − pole)), as law.c computes
    it.
    """
    modes = law.correction
    size = 1 + len(modes.poles) + 2 * len(modes.pair_poles)
    a, b, c = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    # State 0 is the last error; every mode is driven by its change and is read before
    # the update.
    b[0], c[0] = 1.0, -modes.direct
    reals = zip(modes.poles, modes.gains, strict=True)
    for i, (pole, gain) in enumerate(reals, start=1):
        a[i, i], a[i, 0], b[i], c[i] = pole, -1.0, 1.0, gain
    pairs = zip(modes.pair_poles, modes.pair_gains, strict=True)
    for i, (turn, weight) in zip(
        range(1 + len(modes.poles), size, 2), pairs, strict=True
    ):
        a[i : i + 2, i : i + 2] = [[turn.real, -turn.imag], [turn.imag, turn.real]]
        a[i, 0], b[i] = -1.0, 1.0
        c[i : i + 2] = weight.real, -weight.imag
    return StateSpace(a, b, c, modes.direct)


def of_plant(plant: Any, row: Real, period: float, delay: int) -> StateSpace:
    """Return z^−delay·ZOH of an output `row` of a plant."""
    n = plant.order
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = plant.dynamics * period, plant.inputs[:, 0] * period
    exact = expm(block)
    a, b = np.zeros((n + delay, n + delay)), np.zeros(n + delay)
    a[:n, :n], b[-1] = exact[:n, :n], 1.0
    if delay:
        # The plant is driven by the oldest input in the queue.
        a[:n, n] = exact[:n, n]
        a[n:, n:] = np.eye(delay, k=1)
    else:
        b[:] = exact[:n, n]
    return StateSpace(a, b, np.append(row, np.zeros(delay)), 0.0)


def spectral_radius(plant: StateSpace, correction: StateSpace) -> float:
    """Return the spectral radius of the closed loop: stable below 1."""
    p, k, n = plant, correction, len(plant.b)
    closed = np.block(
        [
            [p.a - k.d * np.outer(p.b, p.c), np.outer(p.b, k.c)],
            [-np.outer(k.b, p.c), k.a],
        ]
    )
    assert closed.shape[0] == n + len(k.b)
    return float(np.abs(np.linalg.eigvals(closed)).max())


def energy_matrix(plant: Any, hub_inertia: float) -> Real:
    """Return E with xᵀ E x = kinetic plus stored energy of hub and link [J]."""
    modes, chain, n = plant.modes, plant.chain, plant.order
    energy = np.zeros((n, n))
    energy[1, 1] = 0.5 * (hub_inertia + residual_inertia(plant.beam, modes))
    for i, (omega, load) in enumerate(
        zip(modes.frequencies, modes.participation, strict=True)
    ):
        at = 2 + i * (2 + chain.rates.size)
        bend = np.zeros(n)
        bend[at], bend[0] = 1.0, -load
        energy[at + 1, at + 1] += 0.5
        energy += 0.5 * omega**2 * chain.spring * np.outer(bend, bend)
        own = range(at + 2, at + 2 + chain.rates.size)
        energy[own, own] += 0.5 * omega**2 * chain.weights
    return energy
