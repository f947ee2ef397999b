"""Poles on the principal sheet, the verdict on stability, the H2 and H∞ norms."""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from fraclink._systems.exponential import right_half_plane_zeros
from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.loops import FractionalLoop
from fraclink._systems.roots import log_zeros
from fraclink._systems.sweep import gain_slope, sweep, zero_of
from fraclink._systems.terms import Complexes, Reals, Term
from fraclink._validate import Between, Where, checked
from fraclink.errors import FieldError, NotConvergedError, UnstableError

_SAME = 1e-10  # relative distance at which a zero cancels a pole: what twelve-digit coefficients can tell
_ON_AXIS = 1e-12  # rad between a pole and the imaginary axis below which it lies on it


@dataclass(frozen=True)
class StabilityVerdict:
    """Whether a system is stable, and why; true or false where a bool is asked for.

    Attributes
    ----------
    stable
        No pole of the principal sheet in Re s ≥ 0 and no integrator: bounded inputs give bounded outputs
        (of an improper system: inputs with bounded derivatives).
    reason
        One sentence.
    unstable_poles
        Poles with Re s ≥ 0, conjugates included; empty for a delay in the denominator (only counted).
    integrators
        a where s^a divides the denominator, 0 for none.
    winding
        Certified number of poles with Re s > 0 (argument principle), multiplicities counted; −1 where they
        are infinitely many or come as near to the axis as one likes.
    """

    stable: bool
    reason: str
    unstable_poles: tuple[complex, ...]
    integrators: float
    winding: int

    def __bool__(self) -> bool:
        return self.stable

    def __str__(self) -> str:
        return f"{'stable' if self.stable else 'not stable'}: {self.reason}"


@checked
def poles(system: FractionalTransferFunction) -> Complexes:
    """Return the poles on the principal sheet, −π < arg s ≤ π, with conjugates and multiplicities.

    Σ d_k s^(b_k) = 0. Poles that a zero of the numerator cancels are left out. A factor s^n with an integer
    n of a system of integer orders gives n poles 0; a factor s^a of a fractional system is a branch point
    and no pole: `is_stable` names it. Poles on other sheets shape the response but have no mode.

    They are sorted by argument [rad/s], each pair together; 1/(s^0.5 + 1) has none.

    Parameters
    ----------
    system
        Orders of any kind; no delay in the denominator.

    Raises
    ------
    FieldError
        A delay in the denominator: such a system has infinitely many poles.

    References
    ----------
    Matignon, Proc. IMACS-SMC (1996) 963, for orders with any common base; here without one.

    Examples
    --------
    >>> from fraclink._systems.fractional import s
    >>> poles(1.56 * s**1.92 / (s**1.92 + 100)).round(4)
    array([-0.7199+10.9834j, -0.7199-10.9834j])
    """
    return _both_halves(_pole_logs(system)[0], _poles_at_origin(system))


@checked
def is_stable(system: FractionalTransferFunction) -> StabilityVerdict:
    """Return the verdict on stability: every pole of the principal sheet in Re s < 0 and no integrator.

    The number of poles is certified by the argument principle on the log-plane. With a delay in the
    denominator the poles in Re s > 0 are counted along the imaginary axis. A loop of neutral type (its direct
    path is delayed) is stable only if that path's gain is below 1: otherwise every harmonic of the delay
    grows, or decays as slowly as one likes.

    The verdict is usable as a bool.

    Parameters
    ----------
    system

    Raises
    ------
    FieldError
        A delay in the denominator, and a pole on the imaginary axis or too close to it to tell.

    Examples
    --------
    >>> from fraclink._systems.fractional import s
    >>> is_stable(1 / (s**1.5 + 1)).stable
    True
    >>> print(is_stable(1 / (s**0.5 * (s + 1))).reason)
    s^0.5 divides the denominator: a step gives an unbounded output
    """
    integrators = _integrators(system)
    if any(t.delay for t in system.denominator):
        count = right_half_plane_zeros(system.denominator)
        return _verdict(system, (), integrators, count, delayed=True)
    logs, cancelled = _pole_logs(system)
    bad = logs[logs.imag < 0.5 * math.pi + _ON_AXIS]
    inside = bad[bad.imag < 0.5 * math.pi - _ON_AXIS]
    winding = 2 * len(inside) - int(np.sum(inside.imag == 0))
    found = tuple(complex(p) for p in _both_halves(bad, 0))
    verdict = _verdict(system, found, integrators, winding, delayed=False)
    hidden = cancelled[cancelled.imag < 0.5 * math.pi + _ON_AXIS]
    if not hidden.size:
        return verdict
    where = _shown(complex(_both_halves(hidden, 0)[0]))
    note = f"; a zero cancels the pole at {where} rad/s, which stays inside the system"
    return replace(verdict, reason=verdict.reason + note)


def _verdict(
    system: FractionalTransferFunction,
    bad: tuple[complex, ...],
    integrators: float,
    winding: int,
    *,
    delayed: bool,
) -> StabilityVerdict:
    if winding < 0:
        reason = "a delayed direct path has a gain of 1 or more: infinitely many poles tend to Re s ≥ 0"
    elif delayed and winding:
        reason = f"{_counted(winding)} Re s > 0"
    elif winding:
        worst = max(bad, key=lambda p: p.real)
        reason = f"{_counted(winding)} Re s > 0, the rightmost at {_shown(worst)} rad/s"
    elif bad:
        reason = f"a pole lies on the imaginary axis at {_shown(bad[0])} rad/s"
    elif integrators:
        power = "s" if integrators == 1 else f"s^{integrators:g}"
        reason = f"{power} divides the denominator: a step gives an unbounded output"
    else:
        reason = "no pole has Re s ≥ 0"
        if not system.is_proper:
            reason += "; the system is improper: its output is bounded for smooth inputs only"
    stable = not bad and not winding and not integrators
    return StabilityVerdict(stable, reason, bad, integrators, winding)


def _counted(count: int) -> str:
    return "1 pole has" if count == 1 else f"{count} poles have"


def _shown(p: complex) -> str:
    return f"{p.real:.6g}" if p.imag == 0 else f"{p.real:.6g} ± {abs(p.imag):.6g}j"


def _integrators(system: FractionalTransferFunction) -> float:
    """a > 0 where G ~ s^(−a) at s = 0; numerator and denominator may both have terms that cancel there."""
    return max(0.0, _lowest(system.denominator) - _lowest(system.numerator)) if system.numerator else 0.0


def _lowest(terms: Sequence[Term]) -> float:
    return min(t.order for t in terms)


def _poles_at_origin(system: FractionalTransferFunction) -> int:
    orders = [t.order for t in (*system.numerator, *system.denominator)]
    return int(_integrators(system)) if all(float(a).is_integer() for a in orders) else 0


def _pole_logs(system: FractionalTransferFunction) -> tuple[Complexes, Complexes]:
    """z = ln s of the poles with 0 ≤ Im z ≤ π, and of those that a zero of the numerator cancels."""
    if any(t.delay for t in system.denominator):
        allowed, problem = "delays in the numerator only", "delayed: it has infinitely many poles"
        remedy = "use is_stable or margins"
        raise FieldError("denominator", repr(system), problem, allowed=allowed, remedy=remedy)
    left, cancelled = _logs(system.denominator).tolist(), []
    top = system.numerator
    if len(top) > 1 and all(t.delay == top[0].delay for t in top):
        for zero in _logs(top).tolist():
            near = [p for p in left if abs(p - zero) < _SAME][:1]
            if near:
                left.remove(near[0])
                cancelled += near
    return np.array(left, dtype=complex), np.array(cancelled, dtype=complex)


def _logs(terms: Sequence[Term]) -> Complexes:
    return log_zeros([t.coefficient for t in terms], [t.order for t in terms], angle=math.pi)


def _both_halves(z: Complexes, at_origin: int) -> Complexes:
    """s = e^z and its conjugates, exact on the axes."""
    found: list[complex] = [0j] * at_origin
    for log in z:
        size, angle = math.exp(log.real), float(log.imag)
        if angle in (0.0, math.pi):
            found.append(complex(math.copysign(size, math.cos(angle))))
        elif abs(angle - 0.5 * math.pi) < _ON_AXIS:
            found += [complex(0, size), complex(0, -size)]
        else:
            p = complex(np.exp(log))
            found += [p, p.conjugate()]
    return np.array(found, dtype=complex)


# --- The norms of a stable system ---------------------------------------------------------------------


NORMS = Where(
    lambda p: p in (2.0, math.inf), "2 or inf", problem="not a norm offered here", remedy="use 2 or inf"
)
_FILTER = "multiply by a low-pass filter, as the real input would"
_TOLERANCE = 1e-13
# In ln ω: where terms a gap of orders apart differ by e^(−37) ≈ 1e-16 the response is its own asymptote.
_NEGLIGIBLE = 37.0


@checked
def norm(system: FractionalTransferFunction, p: Annotated[float, Between(finite=False), NORMS]) -> float:
    """Return the H2 norm (p = 2) or the H∞ norm (p = inf) of a stable system.

    ‖G‖₂² = (1/π) ∫₀^∞ |G(jω)|² dω,      ‖G‖∞ = sup |G(jω)|

    For p = 2 by adaptive quadrature over ln ω to 1e-13, with the tails beyond it by their known powers; for
    p = inf the highest peak polished to rounding, or a limit at ω → 0 or ∞.

    Parameters
    ----------
    system
        Stable; for p = 2 with a relative degree > 1/2, for p = inf proper. Delays are allowed.
    p
        2 or `math.inf` [1].

    Raises
    ------
    UnstableError
        A pole in Re s > 0 or on the imaginary axis (an undamped resonance), an integrator.
    FieldError
        Another p; a system that decays too slowly for p = 2; an improper system for p = inf.

    References
    ----------
    Malti et al., Automatica 47 (2011) 2425, for the H2 norm's condition on the relative degree.

    Examples
    --------
    >>> import math
    >>> from fraclink._systems.fractional import s
    >>> G = 100 / (s**2 + 2 * s + 100)
    >>> round(norm(G, 2), 12), round(norm(G, math.inf), 12)
    (5.0, 5.025189076296)
    """
    if not system.numerator:
        return 0.0
    verdict = is_stable(system)
    if not verdict:
        problem, remedy = (
            f"not stable: {verdict.reason}",
            "close a loop around it, add damping, or use margins",
        )
        raise UnstableError("system", repr(system), problem, allowed="stable systems", remedy=remedy)
    degree = system.relative_degree
    if p == 2 and degree <= 0.5:
        problem = f"of relative degree {degree:g}: its H2 norm is infinite"
        raise FieldError("system", repr(system), problem, allowed="relative degree > 1/2", remedy=_FILTER)
    if degree < 0:
        problem = "improper: its gain grows without bound"
        raise FieldError("system", repr(system), problem, allowed="proper systems", remedy=_FILTER)
    loop = FractionalLoop.of(system, None)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return _h2(system, loop) if p == 2 else _peak(loop)


def _h2(system: FractionalTransferFunction, loop: FractionalLoop) -> float:
    gap = min((b - a for a, b in _neighbours(system)), default=1.0)
    spare = _NEGLIGIBLE / max(gap, 0.02)
    low, high = loop.low - spare, loop.high + spare

    def density(x: Reals) -> Reals:
        return np.asarray(np.exp(2 * loop.log_modulus(x.ravel()).reshape(x.shape) + x))

    seeds = loop.seeds[::4]
    edges = np.unique(np.concatenate([np.arange(low, high, 2.0), [high], seeds]))
    # A pole at the distance d from the axis: 16 Gauss points on d/4 are exact to 1e-16.
    distance = min((abs(z.imag - 0.5 * math.pi) for z in loop.zeros), default=0.3)
    inside = integrate(density, edges, _TOLERANCE, smooth=0.25 * min(distance, 0.3))
    # Beyond the edges |G|² ω ~ ω^p: ∫ = density/|p|.
    rise = 1 + 2 * _order_at(system, -1)
    fall = 2 * system.relative_degree - 1
    ends = density(np.array([low, high]))
    return math.sqrt((inside + float(ends[0]) / rise + float(ends[1]) / fall) / math.pi)


def _neighbours(system: FractionalTransferFunction) -> list[tuple[float, float]]:
    """Pairs of neighbouring orders in numerator and denominator that differ."""
    pairs = []
    for terms in (system.numerator, system.denominator):
        orders = sorted({t.order for t in terms})
        pairs += list(itertools.pairwise(orders))
    return pairs


def _order_at(system: FractionalTransferFunction, end: int) -> float:
    """Order of G at ω → 0 (end = −1) or at ω → ∞ (end = 0)."""
    return system.numerator[end].order - system.denominator[end].order


def _peak(loop: FractionalLoop) -> float:
    x, values, _ = sweep(loop)
    size = np.abs(values)
    inner = (size[1:-1] >= size[:-2]) & (size[1:-1] >= size[2:])
    largest = float(size.max())
    for i in (np.flatnonzero(inner) + 1).tolist():
        if size[i] > 0.5 * largest:
            _, value = zero_of(loop, gain_slope, float(x[i - 1]), float(x[i + 1]))
            largest = max(largest, abs(value))
    # A response that approaches its supremum at ω → 0 or ∞ has it as the ratio of two coefficients.
    return max(largest, *(abs(limit) for limit in loop.ends if not cmath.isnan(limit)))


# --- Adaptive Gauss–Legendre quadrature of a smooth function, all panels at once ----------------------

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_PANELS = 20_000


def integrate(f: Callable[[Reals], Reals], edges: Reals, tolerance: float, *, smooth: float) -> float:
    """∫ f over the panels between `edges`; a panel is halved until its halves agree with the whole.

    `tolerance` is relative to the integral; f takes an array of any shape. On panels shorter than `smooth`
    the rule is exact to rounding: what they still disagree by is rounding, and no reason to go on.
    """
    a, b = edges[:-1], edges[1:]
    coarse = _panels(f, a, b)
    total, scale = 0.0, float(np.abs(coarse).sum())
    while a.size:
        if a.size > _PANELS:
            raise NotConvergedError(
                "quadrature of the norm",
                reached=float(a.size),
                wanted=_PANELS,
                remedy="a pole lies extremely close to the imaginary axis",
            )
        middle = 0.5 * (a + b)
        halves = _panels(f, np.concatenate([a, middle]), np.concatenate([middle, b])).reshape(2, -1)
        fine = halves.sum(0)
        # The halves are 2^32 times better than the whole where f is smooth: their difference is the error
        # of the whole, and the error of the halves is far below it.
        scale = max(scale, abs(total) + float(np.abs(fine).sum()))
        done = (np.abs(fine - coarse) <= tolerance * scale / 16) | (b - a < smooth)
        total += float(fine[done].sum())
        left = ~done
        coarse = np.concatenate([halves[0, left], halves[1, left]])
        a, b = np.concatenate([a[left], middle[left]]), np.concatenate([middle[left], b[left]])
    return total


def _panels(f: Callable[[Reals], Reals], a: Reals, b: Reals) -> Reals:
    half = 0.5 * (b - a)
    x = 0.5 * (a + b)[:, None] + half[:, None] * _NODES
    return np.asarray((f(x) * _WEIGHTS).sum(1) * half)
