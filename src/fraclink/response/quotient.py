"""A delay-free quotient N(s)/D(s) on the log-plane z = ln s, and its poles.

There every term is c·exp(a z), entire; the cut of the principal sheet is the line Im z = π and what lies
above it is the next sheet. Poles are simple, or clusters: zeros of D so close to each other that their
residues cancel (a double pole, merging resonances). A cluster is kept whole.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fraclink.fractional import Term
from fraclink.roots import log_zeros

__all__ = ["Cluster", "Quotient"]

Complexes = NDArray[np.complex128]

SHEET = 1.5 * math.pi  # poles up to a quarter turn beyond the cut bend the integrand on it
_CIRCLE = 64  # points of a circle at half the distance to the next obstacle: 2^-64
_SYMMETRIC = 1e-7  # a double zero on the negative axis comes as a pair about it, 1e-8 apart by rounding
_NEAR = 0.02  # zeros closer than this in ln s would lose two digits and more if kept apart


@dataclass(frozen=True)
class Cluster:
    """Zeros of D near `centre` (in ln s), `count` of them with multiplicity, within `radius`."""

    centre: complex
    count: int
    radius: float


@dataclass(frozen=True)
class Quotient:
    """N/D as arrays; `zeros` are the zeros of D with 0 ≤ Im z ≤ 3π/2, z = ln s."""

    top: tuple[Term, ...]
    bottom: tuple[Term, ...]
    zeros: Complexes

    @classmethod
    def of(cls, top: Sequence[Term], bottom: Sequence[Term]) -> Quotient:
        found = log_zeros([t.coefficient for t in bottom], [t.order for t in bottom], angle=SHEET)
        return cls(tuple(top), tuple(bottom), np.asarray(found, np.complex128))

    @property
    def is_meromorphic(self) -> bool:
        """True where all orders are integers: there is no branch cut."""
        return all(float(t.order).is_integer() for t in (*self.top, *self.bottom))

    def value(self, z: Complexes) -> Complexes:
        """G(e^z) at points of the log-plane, on any sheet."""
        return _sum(self.top, z) / _sum(self.bottom, z)

    def on_cut(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Im G(r e^{iπ}) at x = ln r.

        The angle of every term is πa reduced modulo 2π beforehand, so that integer orders are exactly real.
        """
        lowest = self.bottom[-1].order  # divided out, so that r^a does not underflow to 0/0 far down
        with np.errstate(under="ignore"):
            quotient = _sum_on_cut(self.top, x, lowest) / _sum_on_cut(self.bottom, x, lowest)
        return quotient.imag

    def residue(self, z: complex) -> complex:
        """Residue of G(e^z) at a simple zero of D."""
        point = np.array([z])
        slope = tuple(Term(t.coefficient * t.order, t.order) for t in self.bottom if t.order)
        return complex((_sum(self.top, point) / _sum(slope, point))[0])

    @cached_property
    def clusters(self) -> tuple[list[complex], list[Cluster]]:
        """Split the zeros of D into simple ones and clusters."""
        groups: list[list[complex]] = []
        for z in self.zeros.tolist():
            near = [g for g in groups if min(abs(z - w) for w in g) < _NEAR]
            groups = [g for g in groups if g not in near]
            groups.append([z, *(w for g in near for w in g)])
        simple = [g[0] for g in groups if len(g) == 1]
        packed = []
        for group in (g for g in groups if len(g) > 1):
            centre = sum(group) / len(group)
            if abs(centre.imag - math.pi) < _SYMMETRIC:
                centre = complex(centre.real, math.pi)  # so that its modes are real
            packed.append(Cluster(centre, len(group), max(abs(z - centre) for z in group)))
        return simple, packed

    def circle(
        self, cluster: Cluster, clearance: float, kernel: Callable[[Complexes], Complexes]
    ) -> tuple[Complexes, Complexes]:
        """Points z and weights w with Σ w φ(z) = Σ Res G(e^z) kernel(z) φ(z) over the cluster's zeros.

        `clearance` is the distance from the centre to the next singularity of `kernel`; other poles are
        respected here. Trapezoid on a circle, which converges geometrically.
        """
        others = [abs(z - cluster.centre) for z in self.zeros if abs(z - cluster.centre) > cluster.radius]
        outer = min([clearance, 0.5, *others])
        radius = math.sqrt(max(cluster.radius, 0.25 * outer) * outer)
        turn = np.exp(2j * np.pi * (np.arange(2 * _CIRCLE) + 0.5) / (2 * _CIRCLE))
        points = cluster.centre + radius * turn
        return points, self.value(points) * kernel(points) * radius * turn / (2 * _CIRCLE)


def _sum(terms: Sequence[Term], z: Complexes) -> Complexes:
    total = np.zeros(z.shape, np.complex128)
    for t in terms:
        total += t.coefficient * np.exp(t.order * z)
    return total


def _sum_on_cut(terms: Sequence[Term], x: NDArray[np.float64], lowest: float) -> Complexes:
    total = np.zeros(x.shape, np.complex128)
    for t in terms:
        total += t.coefficient * np.exp((t.order - lowest) * x) * _turn(t.order)
    return total


def _turn(order: float) -> complex:
    """e^{iπa}, exact for integers and halves."""
    part = math.fmod(order, 2.0)
    quarter = round(2.0 * part)
    rest = math.pi * (part - 0.5 * quarter)
    return complex(math.cos(rest), math.sin(rest)) * (1, 1j, -1, -1j)[quarter % 4]
