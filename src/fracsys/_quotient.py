"""A delay-free quotient N(s)/D(s) on the log-plane z = ln s, and its poles.

There every term is c·exp(a z), an entire function. The cut of the principal sheet is
the line Im z = π; the next sheet lies above it. Poles are simple, or clusters: zeros of
D so close to each other that their residues cancel (a double pole, merging resonances).
A cluster is kept whole.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fracsys._precision import BLUR, EPSILON, ROUNDS
from fracsys._roots import zeros_of_terms
from fracsys._terms import Term, collect, same
from fracsys.checks import Complex, Real
from fracsys.errors import FieldError

# poles up to a quarter turn beyond the cut bend the integrand on it
SHEET = 1.5 * math.pi
# limit of |ln |s||: squares of poles and of spans stay within doubles
_RANGE = math.log(math.sqrt(sys.float_info.max))
_VAGUE = 1e3  # largest shift of a pole [units of rounding]
_NEAR = 0.02  # zeros closer than this in ln s would lose two digits if kept apart


@dataclass(frozen=True)
class Cluster:
    """Zeros of D near `centre` (in ln s), `count` of them with multiplicity, within
    `radius`.
    """

    centre: complex
    count: int
    radius: float


@dataclass(frozen=True)
class Quotient:
    """N/D as arrays; `zeros` are the zeros of D with 0 ≤ Im z ≤ 3π/2, z = ln s."""

    top: tuple[Term, ...]
    bottom: tuple[Term, ...]
    zeros: Complex

    @classmethod
    def of(cls, top: Sequence[Term], bottom: Sequence[Term]) -> Quotient:
        zeros = zeros_of_terms(bottom, SHEET)
        if len(zeros) and np.abs(zeros.real).max() > _RANGE:
            worst = float(zeros.real[np.argmax(np.abs(zeros.real))])
            raise FieldError(
                "denominator",
                f"a pole at exp({worst:.6g}) rad/s",
                "beyond the range of floating-point numbers",
                f"exp(±{_RANGE:g}) rad/s",
                "look for two orders that are nearly equal",
            )
        return cls(tuple(top), tuple(bottom), zeros)

    def integrated(self) -> Quotient:
        """G/s: its step response is the ramp response of G."""
        bottom = tuple(Term(t.coefficient, t.order + 1.0) for t in self.bottom)
        return Quotient(self.top, bottom, self.zeros)

    @property
    def is_meromorphic(self) -> bool:
        """True if all orders are integers: there is no branch cut."""
        return all(float(t.order).is_integer() for t in (*self.top, *self.bottom))

    def value(self, z: Complex) -> Complex:
        """G(e^z) at points of the log-plane, on any sheet."""
        return _sum(self.top, z) / _sum(self.bottom, z)

    def slope(self, z: Complex) -> Real:
        """d ln |G|/d ln |s| at points of the log-plane."""
        top, bottom = (_sum(s, z, 1) / _sum(s, z) for s in (self.top, self.bottom))
        return (top - bottom).real

    @cached_property
    def misplaced(self) -> Quotient:
        """The quotient with its poles shifted by their possible rounding errors,
        neighbours in opposite directions.
        """
        # e^(az) is off by |az| units of rounding, and a product by two.
        z, moduli = self.zeros, [Term(abs(t.coefficient), t.order) for t in self.bottom]
        size = 2.0 * _sum(moduli, z.real) + np.abs(z) * _sum(moduli, z.real, 1)
        units = size.real / np.abs(_sum(self.bottom, z, 1))
        # A pole with a larger error has a close neighbour, and their errors cancel.
        shift = EPSILON * np.minimum(units, _VAGUE)
        turns = (-1.0) ** np.arange(len(self.zeros))
        return Quotient(self.top, self.bottom, self.zeros + turns * shift)

    def on_cut(self, x: Real) -> Real:
        """Im G(r e^{iπ}) at x = ln r.

        The angle of every term is πa reduced modulo 2π beforehand, so that integer
        orders are exactly real.
        """
        lowest = self.bottom[
            -1
        ].order  # divided out, so that r^a does not underflow to 0/0 for very small r
        with np.errstate(under="ignore"):
            quotient = _sum_on_cut(self.top, x, lowest) / _sum_on_cut(
                self.bottom, x, lowest
            )
        return quotient.imag

    def residue(self, z: complex) -> complex:
        """Residue of G(e^z) at a simple zero of D."""
        point = np.array([z])
        return complex((_sum(self.top, point) / _sum(self.bottom, point, 1))[0])

    @cached_property
    def is_sparse(self) -> bool:
        """True if no two zeros are close: every pole is simple at any resolution."""
        # A loop over pairs takes an eighth of the time of an array of gaps for the two
        # or three zeros of a link, and the same time for ten.
        return all(
            abs(z - w) >= _NEAR
            for z, w in itertools.combinations(self.zeros.tolist(), 2)
        )

    def grouped(
        self, reach: Callable[[complex], float]
    ) -> tuple[list[complex], list[Cluster]]:
        """Split the zeros of D into simple ones and clusters.

        Two zeros belong together if they are closer than `reach` (in ln s): zeros that
        can be separated over the given times are simple, and their residues are of the
        size of the response.
        """
        if self.is_sparse:
            return self.zeros.tolist(), []
        groups: list[list[complex]] = []
        for z in self.zeros.tolist():
            # A chain is one cluster even if its ends are farther apart than `reach`: a
            # circle around a part of it would pass between two zeros.
            near = [
                g for g in groups if min(abs(z - w) for w in g) < min(_NEAR, reach(z))
            ]
            groups = [g for g in groups if g not in near]
            groups.append([z, *(w for g in near for w in g)])
        clusters = []
        for group in (g for g in groups if len(g) > 1):
            centre = sum(group) / len(group)
            # Rounding turns a double zero on the negative axis into a pair about it.
            if abs(centre.imag - math.pi) < BLUR:
                centre = complex(centre.real, math.pi)  # so that its modes are real
            clusters.append(
                Cluster(centre, len(group), max(abs(z - centre) for z in group))
            )
        return [g[0] for g in groups if len(g) == 1], clusters

    def circle(
        self,
        cluster: Cluster,
        radius: float,
        clearance: float,
        kernel: Callable[[Complex], Complex],
    ) -> tuple[Complex, Complex]:
        """Points z and weights w with Σ w φ(z) = Σ Res G(e^z) kernel(z) φ(z) over the
        cluster's zeros.

        `radius` (in ln s) is where φ is best evaluated; `clearance` is the distance
        from the centre to the next singularity of `kernel`. The circle also keeps away
        from other poles. Trapezoidal rule on the circle, which converges geometrically.
        """
        others = [
            abs(z - cluster.centre)
            for z in self.zeros
            if abs(z - cluster.centre) > cluster.radius
        ]
        # At least 1.5 radii of the cluster: the points must enclose every zero, and at
        # 1.5^-106 the rule still converges to rounding.
        size = max(
            min(radius, 0.5 * clearance, *(0.5 * o for o in others)),
            1.5 * cluster.radius,
        )
        # each point gains a bit where the next obstacle is at twice the distance
        turn = np.exp(2j * np.pi * (np.arange(ROUNDS) + 0.5) / ROUNDS)
        points = cluster.centre + size * turn
        return points, self.value(points) * kernel(points) * size * turn / ROUNDS


def _sum(terms: Sequence[Term], z: Complex | Real, derivative: int = 0) -> Complex:
    """The sum at s = e^z, or one of its derivatives over z."""
    total = np.zeros(z.shape, np.complex128)
    for t in terms:
        factor = t.coefficient * t.order**derivative
        # A constant needs no exponential; half of the terms of a link are constants.
        total += factor * np.exp(t.order * z) if t.order else factor
    return total


def _sum_on_cut(terms: Sequence[Term], x: Real, lowest: float) -> Complex:
    total = np.zeros(x.shape, np.complex128)
    for t in terms:
        total += t.coefficient * np.exp((t.order - lowest) * x) * _turn(t.order)
    return total


def _turn(order: float) -> complex:
    """e^{iπa}, exact for integers and halves."""
    # The period is 2, and `fmod` is exact, while the product πa loses digits as a
    # grows.
    part = math.fmod(order, 2.0)
    quarter = round(2.0 * part)
    rest = math.pi * (part - 0.5 * quarter)
    return complex(math.cos(rest), math.sin(rest)) * (1, 1j, -1, -1j)[quarter % 4]


# --- What a transfer function does at s → 0 -----------------------------------------------------------
#
# An integrator is a mode of its own, with a decay of exactly 1, and is split off before
# the rest is expanded: G = c/s + rest. A rest weaker than s^-0.94 follows from the
# branch cut; anything stronger has no modes whose sum stays accurate from one period to
# the whole span.

# The quadrature along the cut begins where r^(1-a) is below rounding, 36/(1-a) e-folds
# down. At 0.94 these are 600, close to the exponent range of a double.
STRONG = 0.94


def without_integrator(
    top: tuple[Term, ...], bottom: tuple[Term, ...]
) -> tuple[float, tuple[Term, ...]]:
    """c and the numerator of G - c/s; 0 and the whole numerator if G is no integrator
    at low frequency.
    """
    if not top or not same(bottom[-1].order - top[-1].order, 1.0):
        return 0.0, top
    gain = top[-1].coefficient / bottom[-1].coefficient
    # The lowest term cancels exactly by construction; with rounding a pole at 0 would
    # remain.
    remainder = [Term(-gain * t.coefficient, t.order - 1.0) for t in bottom[:-1]]
    return gain, tuple(collect([*top[:-1], *remainder]))


def singular_order(top: Sequence[Term], bottom: Sequence[Term]) -> float:
    """Exponent a of the strongest s^-a at low frequency; 0 or less if there is none."""
    return bottom[-1].order - top[-1].order if top else 0.0
