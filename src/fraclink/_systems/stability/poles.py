"""Poles on the principal sheet and the verdict on stability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.fractional import FractionalTransferFunction, Term
from fraclink._systems.fractional.checks import checked_system
from fraclink._systems.roots import log_zeros
from fraclink._systems.stability.delays import right_half_plane_zeros
from fraclink.errors import FieldError

__all__ = ["StabilityVerdict", "is_stable", "poles"]

Complex = NDArray[np.complex128]

_SAME = 1e-10  # relative distance at which a zero cancels a pole: what twelve-digit coefficients can tell
_ON_AXIS = 1e-12  # rad between a pole and the imaginary axis below which it lies on it


@dataclass(frozen=True)
class StabilityVerdict:
    """Whether a system is stable, and why; true or false where a bool is asked for.

    Attributes
    ----------
    stable : bool
        No pole of the principal sheet in Re s ≥ 0 and no integrator: bounded inputs give bounded outputs
        (of an improper system: inputs with bounded derivatives).
    reason : str
        One sentence.
    unstable_poles : tuple of complex
        Poles with Re s ≥ 0, conjugates included; empty for a delay in the denominator (only counted).
    integrators : float
        a where s^a divides the denominator, 0 for none.
    winding : int
        Certified number of poles with Re s > 0 (argument principle), multiplicities counted.
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


def poles(system: FractionalTransferFunction) -> Complex:
    """Return the poles on the principal sheet, −π < arg s ≤ π, with conjugates and multiplicities.

    Σ d_k s^(b_k) = 0. Poles that a zero of the numerator cancels are left out. A factor s^n with an integer
    n of a system of integer orders gives n poles 0; a factor s^a of a fractional system is a branch point
    and no pole: `is_stable` names it. Poles on other sheets shape the response but have no mode.

    Parameters
    ----------
    system : FractionalTransferFunction
        Orders of any kind; no delay in the denominator.

    Returns
    -------
    ndarray of complex128 [rad/s]
        Sorted by argument, each pair together; possibly empty (1/(s^0.5 + 1) has none).

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
    checked_system("system", system)
    return _both_halves(_pole_logs(system)[0], _poles_at_origin(system))


def is_stable(system: FractionalTransferFunction) -> StabilityVerdict:
    """Return the verdict on stability: every pole of the principal sheet in Re s < 0 and no integrator.

    The number of poles is certified by the argument principle on the log-plane. With a delay in the
    denominator the poles in Re s > 0 are counted along the imaginary axis, which needs a highest order
    without delay (retarded type).

    Parameters
    ----------
    system : FractionalTransferFunction

    Returns
    -------
    StabilityVerdict
        Usable as a bool.

    Raises
    ------
    FieldError
        A denominator whose highest order is delayed (neutral type).

    Examples
    --------
    >>> from fraclink._systems.fractional import s
    >>> is_stable(1 / (s**1.5 + 1)).stable
    True
    >>> print(is_stable(1 / (s**0.5 * (s + 1))).reason)
    s^0.5 divides the denominator: a step gives an unbounded output
    """
    checked_system("system", system)
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
    if delayed and winding:
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


def _pole_logs(system: FractionalTransferFunction) -> tuple[Complex, Complex]:
    """z = ln s of the poles with 0 ≤ Im z ≤ π, and of those that a zero of the numerator cancels."""
    if any(t.delay for t in system.denominator):
        raise FieldError(
            "denominator",
            repr(system),
            "delayed: it has infinitely many poles",
            allowed="delays in the numerator only",
            remedy="use is_stable or margins",
        )
    left, cancelled = _logs(system.denominator).tolist(), []
    top = system.numerator
    if len(top) > 1 and all(t.delay == top[0].delay for t in top):
        for zero in _logs(top).tolist():
            near = [p for p in left if abs(p - zero) < _SAME][:1]
            if near:
                left.remove(near[0])
                cancelled += near
    return np.array(left, dtype=complex), np.array(cancelled, dtype=complex)


def _logs(terms: Sequence[Term]) -> Complex:
    return log_zeros([t.coefficient for t in terms], [t.order for t in terms], angle=math.pi)


def _both_halves(z: Complex, at_origin: int) -> Complex:
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
