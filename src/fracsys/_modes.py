"""The response to a held input as a recursion of exponential modes, and the expansion
that gives the modes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebpts1

from fracsys import _kernels
from fracsys._precision import FOLDS, LARGEST_LOG, RESOLUTION
from fracsys._quotient import Cluster, Quotient
from fracsys.checks import Complex, Real
from fracsys.checks.equality import compared
from fracsys.errors import FieldError

TOLERANCE = RESOLUTION  # largest error of a response, relative to its peak


@compared
@dataclass(frozen=True, eq=False)
class DiscreteModes:
    """Exact response of G to a held input, at the samples, with O(modes) memory.

        y[k] = direct·v[k] + first·v[k-1] + Σ gains_i x_i[k] + Re Σ pole_gains_j z_j[k],   v[k] = u[k - lag]
        x_i[k+1] = decays_i x_i[k] + v[k],   z_j[k+1] = pole_decays_j z_j[k] + v[k],   x, z = 0 at rest

    `hold` is "zero" (u is constant from sample to sample) or "first" (straight lines
    from sample to sample, the first one from u[-1] = 0; with a delay between samples
    y[k] then also contains early·v[k+1]). Valid for `span` [s] after a change of the
    input; `tolerance` is the error of the step response relative to its peak, as
    requested. `decays` = exp(`log_decays`): the logarithms keep the digits that a slow
    mode's decay, near 1, loses to rounding. An integrator is a real mode with a decay
    of exactly 1.
    """

    period: float
    hold: str
    direct: float
    first: float
    log_decays: Real
    gains: Real
    pole_log_decays: Complex
    pole_gains: Complex
    span: float
    lag: int = 0
    early: float = 0.0
    tolerance: float = TOLERANCE
    decays: Real = field(init=False)
    pole_decays: Complex = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "decays", np.exp(self.log_decays))
        object.__setattr__(self, "pole_decays", np.exp(self.pole_log_decays))
        for name in (
            "log_decays",
            "gains",
            "pole_log_decays",
            "pole_gains",
            "decays",
            "pole_decays",
        ):
            getattr(self, name).flags.writeable = False

    @property
    def count(self) -> int:
        """Number of real modes plus two for each complex pair: the doubles of state."""
        return len(self.gains) + 2 * len(self.pole_gains)

    def respond(self, u: Real, *, initial: Real | None = None) -> Real:
        """Return y for the samples u, from rest (or from `initial`: x, then z as re, im
        pairs).
        """
        start = np.zeros(self.count) if initial is None else initial
        values = np.ascontiguousarray(u, np.float64)
        count = max(len(values) - self.lag, 0)
        inputs = (
            np.concatenate((np.zeros(len(values) - count), values[:count]))
            if self.lag
            else values
        )
        output: Real = _kernels.modes_response(
            inputs,
            self.direct,
            self.first,
            self.log_decays,
            self.gains,
            self.pole_log_decays,
            self.pole_gains,
            start,
        )
        if self.early and self.lag <= len(values):
            output[self.lag - 1 :] += self.early * values[: len(values) - self.lag + 1]
        return output

    def frequency_response(self, frequency: Real) -> Complex:
        """Return the pulse transfer function at e^(jωT), ω = `frequency` [rad/s]."""
        shift = np.exp(-1j * np.asarray(frequency, np.float64) * self.period)
        total = self.early / shift + self.direct + self.first * shift
        half, pairs = 0.5 * self.pole_gains, self.pole_decays
        gains = np.concatenate([self.gains, half, half.conj()])
        poles = np.concatenate([self.decays, pairs, pairs.conj()])
        for gain, pole in zip(gains, poles, strict=True):
            total = total + gain * shift / (1.0 - pole * shift)
        return total * shift**self.lag


def split_delay(delay: float, period: float) -> tuple[int, float]:
    """Whole periods of delay, rounded up, and the time [s] by which a sample then
    follows the delayed input.
    """
    steps = delay / period
    # 3 · 0.1 s is 3.0000000000000004 periods of 0.1 s; rounded up to four, it would
    # make `ahead` a whole period.
    lag = (
        round(steps)
        if abs(steps - round(steps)) < 1e-9 * max(1.0, steps)
        else math.ceil(steps)
    )
    ahead = lag * period - delay
    return lag, (0.0 if abs(ahead) < 1e-9 * max(period, delay) else ahead)


# --- The step response as a sum of exponentials, uniformly accurate between two times -----------------
#
#     S(t) = const + Σ_j W_j e^(-r_j t) + 2 Re Σ_p w_p e^(p t),   shortest ≤ t ≤ longest
#
# The branch cut gives (1/π) ∫ Im G(r e^{iπ}) e^(-rt) dr/r, by the trapezoid rule in ln
# r. A pole z_p (in ln s) at a moderate distance from the cut, on this sheet or the
# next, would spoil the rule; the rule is made exact by multiplying the residue by
# κ(z_p) = 1/(1 - exp(-2πi (z_p - iπ - x_0)/h)): 1 far below the cut, 1/2 on it midway
# between two nodes, 0 far above. So no pole is a special case, not even one on the cut.
#
# The constant is left out: responses use increments of S only, which makes the integral
# converge at r → 0 for every G weaker than 1/s there.

# Eight nodes fail test_servo_and_link_a_double_pole_on_the_cut and
# test_undamped_double_resonance.
_SEGMENT = 18  # nodes that represent a cluster of poles
# Chebyshev nodes for all rates below 1/longest: there the polynomial through them
# equals e^(-rt) to 5e-13.
_FOLD = 10


@dataclass(frozen=True)
class Expansion:
    """`rates`, `weights` of the real modes; `poles`, `pole_weights` of the complex ones
    (upper half).
    """

    rates: Real
    weights: Real
    poles: Complex
    pole_weights: Complex

    @property
    def count(self) -> int:
        """Number of real modes plus two for each complex one."""
        return len(self.rates) + 2 * len(self.poles)

    def increments(self, times: Real) -> Real:
        """S(t) − S(0) at times [s]: in S itself, the huge weight of a pole near 0 would
        mask everything else.
        """
        value = np.expm1(-np.outer(times, self.rates)) @ self.weights
        pairs = np.expm1(np.outer(times, self.poles)) @ self.pole_weights
        return value + 2.0 * pairs.real


def expand(
    quotient: Quotient, *, shortest: float, longest: float, tolerance: float
) -> Expansion:
    """Return the modes of G's step response, accurate for shortest ≤ t ≤ longest [s]."""
    _refuse_overflow(quotient, longest)
    # The error of the trapezoid rule is exp(-2π a/h) with a = 1.5, just below the
    # quarter turn π/2 beyond which e^(st) grows. The factor before it was below 1/2 for
    # every function tried.
    step = math.tau * 1.5 / math.log(0.5 / tolerance)
    simple, clusters = quotient.grouped(
        lambda z: (
            0.1
            * _half_length(abs(complex(np.exp(z)).real), longest)
            * math.exp(-z.real)
        )
    )
    origin = _origin(simple, clusters, step)

    def kernel(z: Complex) -> Complex:
        return np.asarray(
            1.0 / (1.0 - np.exp(-2j * np.pi * (z - 1j * math.pi - origin) / step))
        )

    def share(pole: complex) -> Callable[[Complex], Complex]:
        if not quotient.is_meromorphic:
            return kernel
        # without a cut a pole counts once, or by one half at each of ln s = x ± iπ
        beyond = np.sign(np.round((pole.imag - math.pi) / RESOLUTION))
        return lambda z: np.full(z.shape, 0.5 - 0.5 * beyond, np.complex128)

    # A mode that has decayed to e^-3 of the tolerance at the shortest time is
    # negligible at all later ones.
    last = math.log((math.log(1.0 / tolerance) + 3.0) / shortest)
    modes = _Modes()
    for z in simple:
        modes.add_pole(z, quotient.residue(z) * share(z)(np.array([z]))[0])
    for cluster in clusters:
        node = (cluster.centre - 1j * math.pi - origin) / step
        gap = step * abs(node - round(node.real))
        _add_cluster(modes, quotient, cluster, share(cluster.centre), gap, longest)
    if not quotient.is_meromorphic:
        _add_cut(modes, quotient, origin, step, last, longest)
    return modes.expansion(shortest, tolerance)


def _refuse_overflow(quotient: Quotient, longest: float) -> None:
    unstable = quotient.zeros[quotient.zeros.imag < 0.5 * math.pi]
    growth = float(np.exp(unstable).real.max(initial=0.0))
    # e^709 is the largest double; the weights and the input take a part of that range.
    if growth * longest > 690.0:
        raise FieldError(
            "span",
            longest,
            f"too long for the unstable pole at {growth:.4g} 1/s: the response leaves the range of numbers",
            f"at most {690.0 / growth:.4g} s",
            "shorten it, or close a stabilising loop first",
        )


class _Modes:
    """The modes collected so far: arrays of (rate, weight) and of (pole, weight)."""

    def __init__(self) -> None:
        self.real: list[Real] = [np.empty((2, 0))]
        self.complex: list[Complex] = [np.empty((2, 0), np.complex128)]

    def add_poles(self, z: complex, places: Complex, weights: Complex) -> None:
        """Add 2 Re Σ weights·e^(st) at s = `places`, or half of it for a positive pole
        e^z.
        """
        if abs(z.imag - math.pi) < RESOLUTION:
            self.real.append(np.array([-places.real, 2.0 * weights.real]))
        elif z.imag == 0.0:  # real: its own conjugate
            self.real.append(np.array([-places.real, weights.real]))
        else:
            self.complex.append(np.array([places, weights]))

    def add_pole(self, z: complex, weight: complex) -> None:
        self.add_poles(z, np.exp(np.array([z])), np.array([weight]))

    def expansion(self, shortest: float, tolerance: float) -> Expansion:
        """The modes above 1e-3 · tolerance at the shortest time."""
        (rates, weights), (poles, shares) = (
            np.concatenate(self.real, axis=1),
            np.concatenate(self.complex, axis=1),
        )
        with np.errstate(over="ignore", under="ignore"):
            size = np.abs(weights) * np.exp(np.minimum(-rates * shortest, 700.0))
            seen_pair = np.abs(shares) * np.exp(
                np.minimum(poles.real * shortest, 700.0)
            )
        limit = (
            1e-3 * tolerance * max(size.max(initial=0.0), seen_pair.max(initial=0.0))
        )
        # The increments of a slow mode are small although the mode matters in the end;
        # only fast modes may be dropped.
        keep = np.flatnonzero(
            ((size > limit) | (rates * shortest < 1.0)) & (weights != 0.0)
        )
        keep = keep[np.argsort(rates[keep])]
        keep_pair = ((seen_pair > limit) | (np.abs(poles) * shortest < 1.0)) & (
            shares != 0.0
        )
        return Expansion(
            rates[keep], weights[keep], poles[keep_pair], shares[keep_pair]
        )


def _origin(simple: list[complex], clusters: list[Cluster], step: float) -> float:
    """The origin of the grid that keeps its nodes farthest from the poles near the cut."""
    near = [
        z
        for z in (*simple, *(c.centre for c in clusters))
        if abs(z.imag - math.pi) < step
    ]
    if not near:
        return 0.0
    places = np.array(near) - 1j * math.pi
    candidates = np.linspace(0.0, step, 64, endpoint=False)
    offsets = (places.real[None, :] - candidates[:, None]) / step
    distance = np.hypot(offsets - np.round(offsets), places.imag[None, :] / step).min(
        axis=1
    )
    return float(candidates[int(np.argmax(distance))])


def _add_cut(
    modes: _Modes,
    quotient: Quotient,
    origin: float,
    step: float,
    last: float,
    longest: float,
) -> None:
    fold = -math.log(longest)
    slowest = min([fold, *quotient.zeros.real.tolist()])
    singular = max(0.0, quotient.bottom[-1].order - quotient.top[-1].order)
    # Towards r = 0 the integrand falls like r^(1 − a): the e-folds are those of the
    # integrand, not of r.
    first = max(slowest - FOLDS / (1.0 - singular), -LARGEST_LOG)
    nodes = origin + step * np.arange(
        math.ceil((first - origin) / step), math.ceil((last - origin) / step)
    )
    weights = quotient.on_cut(nodes) * step / math.pi
    rates = np.exp(nodes)
    slow = nodes < fold
    modes.real.append(np.array([rates[~slow], weights[~slow]]))
    if slow.any():
        modes.real.append(_folded(rates[slow], weights[slow], math.exp(fold)))


def _folded(rates: Real, weights: Real, limit: float) -> Real:
    """Modes with rates below `limit` gathered on a few Chebyshev nodes.

    Increments of e^(-rt) are r times a smooth function of r, so r·W is interpolated.
    """
    nodes = 0.5 * limit * (1.0 + chebpts1(_FOLD))
    moments = (weights * rates) @ _lagrange(2.0 * rates / limit - 1.0, _FOLD)
    return np.array([nodes, moments / nodes])


def _add_cluster(
    modes: _Modes,
    quotient: Quotient,
    cluster: Cluster,
    kernel: Callable[[Complex], Complex],
    clearance: float,
    longest: float,
) -> None:
    """Modes on a short real segment around a cluster that represent all its residues
    together.

    A double pole is (a + bt) e^(pt), a derivative with respect to p; on Chebyshev nodes
    p + δ it becomes a sum of simple exponentials without large cancelling weights.
    """
    centre = complex(np.exp(cluster.centre))
    half = _half_length(abs(centre.real), longest)
    # At 0.3 of the half length from the segment, the Lagrange polynomials are hardly
    # larger than on it.
    points, weights = quotient.circle(
        cluster, 0.3 * half / abs(centre), clearance, kernel
    )
    shares = weights @ _lagrange((np.exp(points) - centre) / half, _SEGMENT)
    nodes = np.asarray(centre + half * chebpts1(_SEGMENT))
    modes.add_poles(cluster.centre, nodes, shares)


def _half_length(damping: float, longest: float) -> float:
    """Half the length of a segment on which 18 nodes resolve e^(δt) e^(-σt) to 1e-13
    for all t.

    Relative to the damping σ the error is (0.3/2)^18; without damping it is
    (δt/2)^18/18!, with δt = 2.5 at the end of the span.
    """
    return max(0.3 * damping, 2.5 / longest)


def _lagrange(x: Complex | Real, count: int) -> Any:
    """Lagrange polynomials of the Chebyshev nodes in [-1, 1] at points x, one row for
    each point.
    """
    nodes = chebpts1(count)
    gap = x[:, None] - nodes
    # On a node itself the barycentric formula is 1/0; a tiny gap gives that node all of
    # the weight.
    gap[gap == 0.0] = np.finfo(float).tiny
    basis = (-1.0) ** np.arange(count) * np.sqrt(1.0 - nodes**2) / gap
    return basis / basis.sum(axis=1, keepdims=True)
