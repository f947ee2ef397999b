"""Poles on the principal sheet, and the verdict on stability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fracsys._fractional import FractionalTransferFunction
from fracsys._loops import as_loop
from fracsys._nyquist import modulus_margin, unstable_closed_loop_poles
from fracsys._precision import COINCIDENT, RESOLUTION
from fracsys._quotient import singular_order
from fracsys._roots import zeros_of_terms
from fracsys._sweep import sweep
from fracsys._terms import Term
from fracsys.checks import Complex, checked
from fracsys.errors import FieldError


@dataclass(frozen=True)
class StabilityVerdict:
    """Whether a system is stable, and why; true or false where a bool is asked for.

    Attributes
    ----------
    stable
        No pole of the principal sheet in Re s ≥ 0 and no integrator: bounded inputs
        give bounded outputs (of an improper system: inputs with bounded derivatives).
    reason
        One sentence.
    unstable_poles
        Poles with Re s ≥ 0, conjugates included; empty with a delay in the denominator,
        where they are only counted.
    integrators
        a where s^a divides the denominator, 0 for none.
    winding
        Certified number of poles with Re s > 0 (argument principle), multiplicities
        counted; −1 where they are infinitely many or arbitrarily close to the axis.
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
def poles(system: FractionalTransferFunction) -> Complex:
    """Return the poles on the principal sheet, −π < arg s ≤ π, with conjugates and
    multiplicities.

    Σ d_k s^(b_k) = 0. Poles that a zero of the numerator cancels are left out. In a
    system of integer orders a factor s^n gives n poles at 0; a factor s^a of a
    fractional system is a branch point and no pole: `is_stable` names it. Poles on
    other sheets shape the response but have no mode.

    They are in rad/s, sorted by argument, each pair together; 1/(s^0.5 + 1) has no
    poles.

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
    Matignon, Proc. IMACS-SMC (1996) 963, for orders with any common base; here without
    one.

    Examples
    --------
    >>> from fracsys._fractional import s
    >>> poles(1.56 * s**1.92 / (s**1.92 + 100)).round(4)
    array([-0.7199+10.9834j, -0.7199-10.9834j])
    """
    return _both_halves(_pole_logs(system)[0], _poles_at_origin(system))


@checked
def is_stable(system: FractionalTransferFunction) -> StabilityVerdict:
    """Return the verdict on stability: every pole of the principal sheet in Re s < 0
    and no integrator.

    The number of poles is certified by the argument principle on the log-plane. With a
    delay in the denominator the poles in Re s > 0 are counted along the imaginary axis.
    A loop of neutral type (its direct path is delayed) is stable only if that path's
    gain is below 1: otherwise the harmonics of the delay grow, or decay arbitrarily
    slowly.

    The verdict is usable as a bool.

    Parameters
    ----------
    system
        Orders and delays of any kind.

    Raises
    ------
    FieldError
        A delay in the denominator, and a pole on the imaginary axis or too close to it
        to tell.

    Examples
    --------
    >>> from fracsys._fractional import s
    >>> is_stable(1 / (s**1.5 + 1)).stable
    True
    >>> print(is_stable(1 / (s**0.5 * (s + 1))).reason)
    s^0.5 divides the denominator: a step gives an unbounded output
    """
    integrators = _integrators(system)
    if any(t.delay for t in system.denominator):
        count = _delayed_zeros(system.denominator)
        return _verdict(system, (), integrators, count, delayed=True)
    # `log_zeros` returns exactly as many poles as the argument principle certifies, so
    # counting those with Re s > 0 gives a certified number.
    logs, cancelled = _pole_logs(system)
    bad = logs[logs.imag < 0.5 * math.pi + RESOLUTION]
    inside = bad[bad.imag < 0.5 * math.pi - RESOLUTION]
    # Only the upper half plane was searched: each pole off the real axis counts for
    # itself and its conjugate.
    winding = 2 * len(inside) - int(np.sum(inside.imag == 0))
    unstable = tuple(complex(p) for p in _both_halves(bad, 0))
    verdict = _verdict(system, unstable, integrators, winding, delayed=False)
    # A cancelled pole is not part of the transfer function, but the corresponding state
    # still grows; it is therefore reported.
    hidden = cancelled[cancelled.imag < 0.5 * math.pi + RESOLUTION]
    if not hidden.size:
        return verdict
    where = _shown(complex(_both_halves(hidden, 0)[0]))
    note = f"; a zero cancels the pole at {where} rad/s, which stays inside the system"
    return replace(verdict, reason=verdict.reason + note)


def _delayed_zeros(terms: Sequence[Term]) -> int:
    """Number of zeros with Re s > 0 of a sum with delays, −1 for infinitely many.

    Zeros of A + B, with the delayed terms in B, are the poles of 1/(1 + B/A), which the
    Nyquist criterion counts. For the neutral type (delays on the highest order as well)
    this holds if the moduli of the delayed coefficients add up to less than that of the
    undelayed one. Otherwise there are zeros of arbitrarily large modulus in Re s > 0 or
    arbitrarily close to the axis. Raises `FieldError` for zeros on the axis.

    Source: Hale and Verduyn Lunel, Introduction to Functional Differential Equations
    (1993), chapter 9.
    """
    leading = [t for t in terms if t.order == terms[0].order]
    if leading[0].delay or 2.0 * abs(leading[0].coefficient) <= sum(
        abs(t.coefficient) for t in leading
    ):
        return -1
    late = tuple(t for t in terms if t.delay)
    plain = tuple(t for t in terms if not t.delay)
    # One octave above the largest zero, |B/A| is below 1 on the whole arc that closes
    # the contour.
    loop = as_loop(FractionalTransferFunction(late, plain), 2.0 * _largest_zero(terms))
    # Poles and zeros on the axis give infinities here, which are not errors.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        x, values, _ = sweep(loop)
        count = None
        if loop.unstable_poles is not None:
            count = unstable_closed_loop_poles(
                loop, x, values, open_loop=loop.unstable_poles, ends_real=False
            )
        if count is None or modulus_margin(loop, x, values)[0] < RESOLUTION:
            raise FieldError(
                "denominator",
                list(terms),
                "zero on the imaginary axis, or too close to it to tell",
                "poles away from the axis",
                "change the gain or the delay a little, or cancel what is zero at s = 0",
            )
    return count


def _largest_zero(terms: Sequence[Term]) -> float:
    """A frequency [rad/s] beyond which a sum with delays has no zero with Re s >= 0.

    Beyond it the undelayed leading term exceeds the sum of all others, since |e^(-sL)|
    ≤ 1: each lower term is at most its share of what the leading terms leave.
    """
    top = terms[0].order
    lower = [t for t in terms if t.order < top]
    spare = 2.0 * abs(terms[0].coefficient) - sum(
        abs(t.coefficient) for t in terms if t.order == top
    )
    # Without lower terms there is no such zero, and any frequency will do.
    return max(
        (
            (len(lower) * abs(t.coefficient) / spare) ** (1.0 / (top - t.order))
            for t in lower
        ),
        default=1.0,
    )


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
            reason += (
                "; the system is improper: its output is bounded for smooth inputs only"
            )
    stable = not bad and not winding and not integrators
    return StabilityVerdict(stable, reason, bad, integrators, winding)


def _counted(count: int) -> str:
    return "1 pole has" if count == 1 else f"{count} poles have"


def _shown(p: complex) -> str:
    return f"{p.real:.6g}" if p.imag == 0 else f"{p.real:.6g} ± {abs(p.imag):.6g}j"


def _integrators(system: FractionalTransferFunction) -> float:
    """a > 0 with G ~ s^(−a) at s = 0; the lowest terms of numerator and denominator may
    cancel.
    """
    return max(0.0, singular_order(system.numerator, system.denominator))


def _poles_at_origin(system: FractionalTransferFunction) -> int:
    orders = [t.order for t in (*system.numerator, *system.denominator)]
    # s^2.5 has a branch point at 0 and no pole; only a system of integer orders has
    # poles there.
    return (
        int(_integrators(system)) if all(float(a).is_integer() for a in orders) else 0
    )


def _pole_logs(system: FractionalTransferFunction) -> tuple[Complex, Complex]:
    """z = ln s of the poles with 0 ≤ Im z ≤ π, and of those cancelled by a zero of the
    numerator.
    """
    if any(t.delay for t in system.denominator):
        raise FieldError(
            "denominator",
            repr(system),
            "delayed: it has infinitely many poles",
            "delays in the numerator only",
            "use is_stable or margins",
        )
    rest = zeros_of_terms(system.denominator, math.pi).tolist()
    cancelled: list[complex] = []
    top = system.numerator
    # A common delay moves no zero; several delays give infinitely many zeros, none of
    # which cancels a pole exactly.
    if len(top) > 1 and all(t.delay == top[0].delay for t in top):
        for zero in zeros_of_terms(top, math.pi).tolist():
            # A zero cancels one of the poles that it coincides with: a double pole with
            # one zero on it leaves a simple pole.
            near = [p for p in rest if abs(p - zero) < COINCIDENT][:1]
            if near:
                rest.remove(near[0])
                cancelled += near
    return np.array(rest, complex), np.array(cancelled, complex)


def _both_halves(z: Complex, at_origin: int) -> Complex:
    """s = e^z and its conjugates, exact on the axes."""
    points: list[complex] = [0j] * at_origin
    for log in z:
        size, angle = math.exp(log.real), float(log.imag)
        # `log_zeros` puts zeros on the edges exactly there. e^z would leave an
        # imaginary part of 1e-16, and a real pole would count as a pair.
        if angle in (0.0, math.pi):
            points.append(complex(math.copysign(size, math.cos(angle))))
        elif abs(angle - 0.5 * math.pi) < RESOLUTION:
            points += [complex(0, size), complex(0, -size)]
        else:
            p = complex(np.exp(log))
            points += [p, p.conjugate()]
    return np.array(points, complex)
