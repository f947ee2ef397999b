"""The H2 and H∞ norms of a stable system, fractional, rational or sampled."""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.loops import CallableLoop, FractionalLoop, SampledLoop, around
from fraclink._systems.rational import RationalApproximation
from fraclink._systems.stability import is_stable
from fraclink._systems.sweep import gain_slope, sweep, valleys, zero_of
from fraclink._systems.terms import Complexes, Reals
from fraclink._validate import Between, Where, checked
from fraclink.errors import FieldError, NotConvergedError, UnstableError

NORMS = Where(
    lambda p: p in (2.0, math.inf),
    "2 or inf",
    problem="not a norm offered here",
    remedy="use 2 or inf",
)
_FILTER = "multiply by a low-pass filter, as the real input would"
_TOLERANCE = 1e-13
# In ln ω: where terms a gap of orders apart differ by e^(−37) ≈ 1e-16 the response is
# its own asymptote.
_NEGLIGIBLE = 37.0


@checked
def norm(
    system: FractionalTransferFunction | Callable[[Complexes], Complexes],
    p: Annotated[float, Between(finite=False), NORMS],
) -> float:
    """Return the H2 norm (p = 2) or the H∞ norm (p = inf) of a stable system,
    continuous or sampled.

    ‖G‖₂² = (1/π) ∫₀^∞ |G(jω)|² dω,            ‖G‖∞ = sup |G(jω)|
    ‖G‖₂² = (1/2π) ∫₋π^π |G(e^jθ)|² dθ,         ‖G‖∞ = max |G(e^jθ)|        where G is sampled

    For p = 2 by adaptive quadrature over ln ω to 1e-13, with the tails beyond it by
    their known powers; for p = inf the highest peak polished to rounding, or a limit at
    ω → 0 or ∞. A rational model has its H2 norm from the Lyapunov equation of a
    realisation.

    Parameters
    ----------
    system
        Stable; for p = 2 with a relative degree > 1/2, for p = inf proper. Delays are
        allowed. Also a `RationalApproximation` or a python-control system of one input
        and output, continuous or sampled.
    p
        2 or `math.inf` [1].

    Raises
    ------
    UnstableError
        A pole in Re s > 0 or on the imaginary axis (an undamped resonance), an
        integrator.
    FieldError
        Another p; a system that decays too slowly for p = 2; an improper system for p =
        inf; a function of s of which nothing else is known.

    References
    ----------
    Malti et al., Automatica 47 (2011) 2425, for the H2 norm's condition on the relative
    degree.

    Examples
    --------
    >>> import math
    >>> from fraclink._systems.fractional import s
    >>> G = 100 / (s**2 + 2 * s + 100)
    >>> round(norm(G, 2), 12), round(norm(G, math.inf), 12)
    (5.0, 5.025189076296)
    >>> from fraclink._systems.rational import approximate
    >>> sampled = approximate(1 / (s**0.8 + 1), (0.01, 100.0), 6, period=0.01)
    >>> round(norm(sampled, math.inf), 3)
    0.975
    """
    if not isinstance(system, FractionalTransferFunction):
        known = getattr(system, "fractional", None)
        if not isinstance(known, FractionalTransferFunction):
            return _of_model(_model(system), p)
        system = known
    if not system.numerator:
        return 0.0
    verdict = is_stable(system)
    if not verdict:
        problem, remedy = (
            f"not stable: {verdict.reason}",
            "close a loop around it, add damping, or use margins",
        )
        raise UnstableError(
            "system", repr(system), problem, allowed="stable systems", remedy=remedy
        )
    degree = system.relative_degree
    if p == 2 and degree <= 0.5:
        problem = f"of relative degree {degree:g}: its H2 norm is infinite"
        raise FieldError(
            "system",
            repr(system),
            problem,
            allowed="relative degree > 1/2",
            remedy=_FILTER,
        )
    if degree < 0:
        problem = "improper: its gain grows without bound"
        raise FieldError(
            "system", repr(system), problem, allowed="proper systems", remedy=_FILTER
        )
    loop = FractionalLoop.of(system, None)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return _h2(system, loop) if p == 2 else _peak(loop)


def _h2(system: FractionalTransferFunction, loop: FractionalLoop) -> float:
    gap = min((b - a for a, b in _neighbours(system)), default=1.0)
    # Beyond the last corner G approaches a power of ω like ω^−gap: orders close to each
    # other need more decades.
    spare = _NEGLIGIBLE / max(gap, 0.02)
    low, high = loop.low - spare, loop.high + spare

    def density(x: Reals) -> Reals:
        return np.asarray(np.exp(2 * loop.log_modulus(x.ravel()).reshape(x.shape) + x))

    # The panels halve themselves where they must: a quarter of the points around each
    # resonance starts them.
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


def _peak(loop: SampledLoop) -> float:
    x, values, _ = sweep(loop)
    size = np.abs(values)
    largest = float(size.max())
    # A supremum is where the slope of ln|L| vanishes; the grid's own largest value is
    # too small at every resonance.
    for i in valleys(-size, spare=0.5):
        _, value = zero_of(loop, gain_slope, float(x[i - 1]), float(x[i + 1]))
        largest = max(largest, abs(value))
    # A response that approaches its supremum at ω → 0 or ∞ has it as the ratio of two
    # coefficients.
    return max(largest, *(abs(limit) for limit in loop.ends if not cmath.isnan(limit)))


# --- Rational models: zeros, poles and gain, or a python-control system -------------------------------


@dataclass(frozen=True)
class _Model:
    """A realisation, its poles and its response as a function of s or z."""

    matrices: tuple[Reals, Reals, Reals, Reals]
    poles: Complexes
    response: Callable[[Complexes], Complexes]
    sampled: bool
    name: str


def _model(system: Any) -> _Model:
    if isinstance(system, RationalApproximation):
        sampled = system.period is not None
        return _Model(
            system.state_space(),
            system.poles,
            system,
            sampled,
            f"{system.method} approximation",
        )
    if not (hasattr(system, "num") or hasattr(system, "A")) or not hasattr(
        system, "dt"
    ):
        allowed = "a fractional transfer function, a RationalApproximation or a python-control system"
        remedy = "a function of s has no poles to judge: give the model itself"
        problem = "not a model"
        raise FieldError(
            "system", type(system).__name__, problem, allowed=allowed, remedy=remedy
        )
    if (system.ninputs, system.noutputs) != (1, 1):
        problem, remedy = (
            "of several inputs or outputs",
            "select one channel, such as system[0, 0]",
        )
        shape, allowed = (system.noutputs, system.ninputs), "one input and one output"
        raise FieldError("system", shape, problem, allowed=allowed, remedy=remedy)
    import control

    matrices = control.ssdata(control.ss(system))
    sampled = bool(
        system.dt
    )  # True is a sampled system of unstated period, on which no norm depends
    return _Model(
        matrices,
        np.asarray(system.poles(), complex),
        system,
        sampled,
        repr(type(system).__name__),
    )


def _of_model(model: _Model, p: float) -> float:
    bad = np.abs(model.poles) >= 1.0 if model.sampled else model.poles.real >= 0.0
    if np.any(bad):
        place = "|z| ≥ 1" if model.sampled else "Re s ≥ 0"
        problem = (
            f"not stable: a pole at {complex(model.poles[bad][0]):.6g} has {place}"
        )
        remedy = "close a loop around it or add damping"
        raise UnstableError(
            "system", model.name, problem, allowed="stable systems", remedy=remedy
        )
    a, b, c, d = model.matrices
    if p == math.inf:
        return _peak(
            _around_the_circle(model) if model.sampled else _up_the_axis(model)
        )
    if not model.sampled and np.any(d):
        problem = "with a direct feedthrough: its H2 norm is infinite"
        raise FieldError(
            "system",
            model.name,
            problem,
            allowed="relative degree > 1/2",
            remedy=_FILTER,
        )
    # The Gramian gives the H2 norm of a rational system in closed form: no integral,
    # and no end of the band.
    solve = solve_discrete_lyapunov if model.sampled else solve_continuous_lyapunov
    states = (
        solve(a, b @ b.T if model.sampled else -b @ b.T) if len(a) else np.zeros((0, 0))
    )
    return math.sqrt(float((c @ states @ c.T + d @ d.T)[0, 0]))


def _around_the_circle(model: _Model) -> CallableLoop:
    """|G(e^jθ)| over ln θ, with θ in place of a frequency, and its values at θ = 0 and
    π as limits.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        near = np.log(
            np.log(model.poles)
        )  # ln of the pole that a continuous system with this one would have
    low = min(
        math.log(math.pi) - 14.0,
        float(np.min(near.real, initial=0.0, where=np.isfinite(near))) - 3.0,
    )
    ends = model.response(np.array([1.0 + 0j, -1.0 + 0j]))
    return CallableLoop(
        lambda s: model.response(np.exp(s)),
        low,
        math.log(math.pi),
        seeds=_beside(near),
        delayed=False,
        ends=(complex(ends[0]), complex(ends[1])),
    )


def _up_the_axis(model: _Model) -> CallableLoop:
    near = np.log(model.poles)
    # e^14: six decades beyond its outermost poles a rational response is at the limits
    # that `ends` has.
    low, high = (
        float(np.min(near.real, initial=0.0)) - 14.0,
        float(np.max(near.real, initial=0.0)) + 14.0,
    )
    ends = (
        complex(model.response(np.zeros(1, complex))[0]),
        complex(model.matrices[3][0, 0]),
    )
    return CallableLoop(
        model.response, low, high, seeds=_beside(near), delayed=False, ends=ends
    )


def _beside(logs: Complexes) -> Reals:
    """ln ω near each pole close to the axis, where the response is a resonance."""
    parts = [around(complex(z)) for z in logs if np.isfinite(z) and z.imag > 0.0]
    return np.concatenate(parts) if parts else np.empty(0)


# --- Adaptive Gauss–Legendre quadrature of a smooth function, all panels at once ----------------------

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_PANELS = 20_000


def integrate(
    f: Callable[[Reals], Reals], edges: Reals, tolerance: float, *, smooth: float
) -> float:
    """∫ f over the panels between `edges`; a panel is halved until its halves agree
    with the whole.

    `tolerance` is relative to the integral; f takes an array of any shape. On panels
    shorter than `smooth` the rule is exact to rounding: what they still disagree by is
    rounding, and no reason to go on.
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
        halves = _panels(
            f, np.concatenate([a, middle]), np.concatenate([middle, b])
        ).reshape(2, -1)
        fine = halves.sum(0)
        # The halves are 2^32 times better than the whole where f is smooth: their
        # difference is the error of the whole, and the error of the halves is far below
        # it.
        scale = max(scale, abs(total) + float(np.abs(fine).sum()))
        done = (np.abs(fine - coarse) <= tolerance * scale / 16) | (b - a < smooth)
        total += float(fine[done].sum())
        left = ~done
        coarse = np.concatenate([halves[0, left], halves[1, left]])
        a, b = (
            np.concatenate([a[left], middle[left]]),
            np.concatenate([middle[left], b[left]]),
        )
    return total


def _panels(f: Callable[[Reals], Reals], a: Reals, b: Reals) -> Reals:
    half = 0.5 * (b - a)
    x = 0.5 * (a + b)[:, None] + half[:, None] * _NODES
    return np.asarray((f(x) * _WEIGHTS).sum(1) * half)
