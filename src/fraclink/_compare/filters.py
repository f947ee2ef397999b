"""Linear controllers at the control period, and the nominal loop that every rule of tuning looks at.

All rivals that use the tip estimate have the form of the corrected equation (22),

    θm* = θt* + F(z) θ̈t* + Ĉ(z) e,   e = θt* − (θm − Γ/c),

with one feed-forward F for all and a correction Ĉ of their own. The nominal loop is the one a designer
knows: L = Ĉ(z) z^−d ZOH{M G} with the lumped model of the nominal payload.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._law import Law
from fraclink._simulate.plant import LONGEST_STEP, Plant

__all__ = ["Filter", "fine_step", "law_filter", "sampled", "tustin"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Filter:
    """A discrete filter x⁺ = A x + b u, y = c x + d u."""

    a: Real
    b: Real
    c: Real
    d: float

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.b)

    def response(self, z: Complex) -> Complex:
        """Return the transfer function at z, shape kept."""
        if self.order == 0:
            return np.full(np.shape(z), self.d, dtype=np.complex128)
        # Solved and not inverted: near a pole z − A is nearly singular.
        matrix = np.asarray(z)[..., None, None] * np.eye(self.order) - self.a
        column = np.broadcast_to(self.b[:, None], (*matrix.shape[:-1], 1))
        return np.asarray(np.linalg.solve(matrix, column)[..., 0] @ self.c + self.d, dtype=np.complex128)

    def scaled(self, factor: float) -> Filter:
        """Return the filter times a factor."""
        return Filter(self.a, self.b, factor * self.c, factor * self.d)

    def after(self, first: Filter) -> Filter:
        """Return this filter behind `first`."""
        n, m = first.order, self.order
        a = np.zeros((n + m, n + m))
        a[:n, :n], a[n:, n:], a[n:, :n] = first.a, self.a, np.outer(self.b, first.c)
        return Filter(
            a,
            np.concatenate([first.b, self.b * first.d]),
            np.concatenate([self.d * first.c, self.c]),
            self.d * first.d,
        )


def tustin(a: Real, b: Real, c: Real, d: float, period: float) -> Filter:
    """Discretise ẋ = a x + b u, y = c x + d u by Tustin's rule at `period` [s]."""
    half = 0.5 * period
    # Tustin's rule keeps the order, and a pole is stable after it exactly if it was before.
    left = np.linalg.inv(np.eye(len(b)) - half * a)
    # The state is scaled so that the discrete b is left·b·T: no square roots of the period are needed.
    return Filter(
        left @ (np.eye(len(b)) + half * a), period * (left @ b), c @ left, float(d + half * c @ left @ b)
    )


def law_filter(law: Law) -> Filter:
    """Return the correction Ĉ(z) of a law: (1 − z⁻¹)(direct + Σ gain/(z − pole)), as law.c computes it."""
    modes = law.correction
    reals = len(modes.poles)
    size = 1 + reals + 2 * len(modes.pair_poles)
    a, b, c = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    # State 0 is the last error; every mode is driven by its change and read before its update.
    b[0], c[0] = 1.0, -modes.direct
    for i, (pole, gain) in enumerate(zip(modes.poles, modes.gains, strict=True), start=1):
        a[i, i], a[i, 0], b[i], c[i] = pole, -1.0, 1.0, gain
    for j, (turn, weight) in enumerate(zip(modes.pair_poles, modes.pair_gains, strict=True)):
        re = 1 + reals + 2 * j
        a[re, re], a[re, re + 1], a[re, 0], b[re] = turn.real, -turn.imag, -1.0, 1.0
        a[re + 1, re], a[re + 1, re + 1] = turn.imag, turn.real
        c[re], c[re + 1] = weight.real, -weight.imag
    return Filter(a, b, c, modes.direct)


def fine_step(period: float) -> float:
    """Return the longest step of at most 1 ms that divides the period [s]."""
    return period / max(1, math.ceil(period / LONGEST_STEP - 1e-9))


def sampled(plant: Plant, row: Real, period: float, delay: int, *, gain: float = 1.0) -> Filter:
    """Return gain·z^−delay·ZOH of an output `row` of a plant, exactly; the delay adds states."""
    step = fine_step(period)
    exact, n = plant.discretise(step), plant.order
    single, drive = exact.transition[:, :n].T, gain * exact.hub[:n]
    a, b = np.eye(n), np.zeros(n)
    for _ in range(round(period / step)):
        # The period is a whole number of fine steps with one held input: exact, as the plant's own steps are.
        a, b = single @ a, single @ b + drive
    held = Filter(a, b, row, 0.0)
    if delay == 0:
        return held
    return held.after(Filter(np.eye(delay, k=1), np.eye(delay)[-1], np.eye(delay)[0], 0.0))
