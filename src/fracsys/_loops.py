"""The systems accepted as a loop, and the frequencies at which its response must be
evaluated.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from fracsys._exponential import ExponentialSum
from fracsys._fractional import FractionalTransferFunction
from fracsys._precision import COINCIDENT, DIFFERENCE_STEP, LARGEST_LOG
from fracsys._roots import newton_polygon, zeros_of_terms
from fracsys._terms import Term
from fracsys.checks import Complex, Real
from fracsys.errors import FieldError

# Twelve decades around 1 rad/s cover every mechanical and electrical loop that is
# likely to be given as a function.
_LOW, _HIGH = 1e-6, 1e6


@dataclass(frozen=True)
class SampledLoop:
    """A loop for the sweep along the axis, and what is known of it beforehand.

    `response`: L(j e^x), x = ln ω. `low`, `high`: ln of the frequencies [rad/s] that
    can matter. `seeds`: ln ω where the response moves fast, near poles and zeros close
    to the axis. `delayed`: whether there may be a delay, so that phase crossings are
    countless where |L| is small; up to `follow` (ln ω) the phase is followed however
    small |L| is. `ends`: L at ω → 0 and ω → ∞ if it has a known limit, else NaN.
    `system`: the transfer function that L is, `span` ln of its lowest and highest
    corner or asymptotic gain crossing, and `unstable_poles` the number of its poles
    with Re s > 0, conjugates counted; None where it is not known.
    """

    response: Callable[[Real], object]
    low: float
    high: float
    seeds: Real = field(default_factory=lambda: np.empty(0))
    delayed: bool = True  # assumed where the structure is unknown
    follow: float = -math.inf
    ends: tuple[complex, complex] = (complex(math.nan), complex(math.nan))
    system: FractionalTransferFunction | None = None
    span: tuple[float, float] = (-math.inf, math.inf)
    unstable_poles: int | None = None

    def __call__(self, x: Real) -> Complex:
        """L(j e^x)."""
        values = np.asarray(self.response(x), complex)
        if values.shape != x.shape:
            raise FieldError(
                "loop",
                values.shape,
                "of another shape than its argument",
                f"shape {x.shape}",
                "write the callable with numpy operations on arrays of s",
            )
        if np.isnan(values).any():
            raise FieldError(
                "loop",
                "nan",
                f"not a number at {math.exp(float(x[np.isnan(values)][0])):.6g} rad/s",
                "finite values (infinite at a pole on the axis)",
                "check the callable there or lower limit=",
            )
        return values

    def slope(self, x: Real) -> Complex:
        """d ln L/dx by central differences, one-sided at the upper limit; NaN at a pole
        or zero on the axis.
        """
        # Exact to 1e-10; the brackets catch the errors.
        above = np.minimum(x + DIFFERENCE_STEP, self.high)
        below = x - DIFFERENCE_STEP
        low, high = np.split(self(np.concatenate([below, above])), 2)
        return np.asarray(np.log(high / low) / (above - below))


def as_loop(loop: object, limit: float | None) -> SampledLoop:
    """Return the loop with its range of frequencies and its seeds."""
    if isinstance(loop, FractionalTransferFunction) and loop.numerator:
        return _fractional_loop(loop, limit)
    if not callable(loop):
        raise FieldError(
            "loop",
            type(loop).__name__,
            "not a loop",
            "a transfer function or a callable of s",
            "pass a FractionalTransferFunction or a function of s = jω",
        )
    return _callable_loop(loop, limit)


def _callable_loop(loop: Callable[..., object], limit: float | None) -> SampledLoop:
    """A function of s, or a python-control system (recognised by its `dt`; sampled ones
    stop at π/dt).
    """
    period = getattr(loop, "dt", None)
    # a response over z; read as a function of s it would give wrong margins
    if period is True:
        raise FieldError(
            "loop",
            "dt = True",
            "sampled, without a period",
            "a sampling period in seconds, or continuous time",
            "give it one, such as control.tf(num, den, 0.01)",
        )
    step = float(period) if isinstance(period, (int, float)) else 0.0
    if step > 0.0:
        # Beyond the Nyquist frequency a sampled response is only its mirrored
        # repetition.
        limit = math.pi / step if limit is None else min(limit, math.pi / step)

    def response(x: Real) -> object:
        s = 1j * np.exp(x)
        return loop(np.exp(s * step) if step > 0.0 else s)

    high = _HIGH if limit is None else limit
    # At least six decades below the highest frequency, however low that limit is.
    return SampledLoop(response, math.log(min(_LOW, high * 1e-6)), math.log(high))


# --- A fractional transfer function as a loop: its own range of frequencies, its resonances, exact slopes

# A zero of numerator or denominator at a distance d from the axis (in ln s) bends the
# response within about d of it. Points at d sinh(0.45 k), up to 0.15 away, keep the
# change between neighbours below 25° in phase and a factor of 1.6 in modulus; farther
# out the ordinary points, 0.12 apart, suffice.
_NEAR = 0.3  # 20 points per decade resolve zeros farther from the axis than this
FAINT = 1e-3  # |L| of −60 dB, below which crossings do not matter


def _fractional_loop(
    system: FractionalTransferFunction, limit: float | None
) -> SampledLoop:
    """A transfer function as a loop, with the frequencies at which to evaluate it."""
    terms = (*system.numerator, *system.denominator)
    span, reach = _corner_span(system)
    slowest = max(t.delay for t in terms)
    steepest = max(
        abs(system.numerator[i].order - system.denominator[i].order) for i in (0, -1)
    )
    # Corner frequencies of terms of neighbouring orders may lie anywhere, even at 1e100
    # rad/s; the steepest asymptote must not overflow at the farthest frequency.
    farthest = 0.9 * LARGEST_LOG / max(1.0, steepest)
    within = span[0] >= -farthest and span[1] <= farthest
    span = (max(span[0], -farthest), min(span[1], farthest))
    low = max(span[0] - reach, -farthest - 1)
    high = min(span[1] + reach, farthest + 1)
    follow = high
    if slowest:
        # A delay whose phase is below 0.1 rad changes no margin visibly.
        low = min(low, math.log(0.1 / slowest))
        # includes the first two phase crossings
        follow = math.log(4 * math.pi / slowest)
        high = max(high, follow, min(_faint(system), farthest))
    if limit is not None:
        high = min(high, math.log(limit))
        # A limit below every corner leaves a factor e of the low asymptote; an empty
        # range would have no margins.
        low = min(low, high - 1.0)
    bottom, certain = _near_axis(system.denominator)
    top, _ = _near_axis(system.numerator)
    # `bottom` holds the upper one of each pair; a real zero is its own conjugate.
    right = [z for z in bottom if z.imag < 0.5 * math.pi - COINCIDENT]
    end = _limit(system, 0) if limit is None else complex(math.nan)
    return SampledLoop(
        lambda x: system(1j * np.exp(x)),
        low,
        high,
        seeds=np.concatenate([np.empty(0), *(around(z) for z in (*bottom, *top))]),
        delayed=bool(slowest),
        follow=follow,
        ends=(_limit(system, -1), end),
        system=system,
        span=span,
        unstable_poles=sum(1 if z.imag == 0 else 2 for z in right)
        if certain and within
        else None,
    )


def _faint(system: FractionalTransferFunction) -> float:
    """ln of the frequency where the high asymptote falls to −60 dB; −inf where it does
    not fall.
    """
    up, down = system.numerator[0], system.denominator[0]
    slope = up.order - down.order
    level = math.log(abs(up.coefficient / down.coefficient))
    return (level + math.log(1.0 / FAINT)) / -slope if slope < 0 else -math.inf


def _limit(system: FractionalTransferFunction, end: int) -> complex:
    """L at ω → 0 (end = −1) or ω → ∞ (end = 0): a ratio of coefficients, 0, or NaN if
    there is none.
    """
    up, down = system.numerator[end], system.denominator[end]
    falls = up.order > down.order if end else up.order < down.order
    if falls:
        return 0j
    turning = any(t.delay for t in (*system.numerator, *system.denominator))
    if up.order != down.order or (turning and not end):
        return complex(math.nan)
    sides = (system.numerator, system.denominator)
    # Several delayed terms may share the lowest order: at ω → 0 the delays turn no
    # phase, and the terms add up.
    sums = [
        math.fsum(t.coefficient for t in side if t.order == up.order) for side in sides
    ]
    return complex(sums[0] / sums[1]) if sums[1] else complex(math.nan)


def _near_axis(terms: Sequence[Term]) -> tuple[list[complex], bool]:
    """Zeros (in ln s) with an argument up to π/2 + 0.3, and whether the search
    succeeded.
    """
    if len(terms) < 2:
        return [], True
    if any(t.delay != terms[0].delay for t in terms):
        return [], False
    return zeros_of_terms(terms, 0.5 * math.pi + _NEAR).tolist(), True


def around(zero: complex) -> Real:
    distance = abs(zero.imag - 0.5 * math.pi)
    if distance > _NEAR:
        return np.empty(0)
    # on the axis itself: a gap that is not evaluated
    if distance < COINCIDENT:
        steps = 0.45 * COINCIDENT * 1.7 ** np.arange(37)
    else:
        steps = distance * np.sinh(
            0.45 * np.arange(math.asinh(0.5 * _NEAR / distance) / 0.45)
        )
    return zero.real + np.concatenate([-steps, steps])


def _corner_span(
    system: FractionalTransferFunction,
) -> tuple[tuple[float, float], float]:
    """ln of the outermost corner frequencies, and the distance beyond them at which the
    response has reached its asymptote.
    """
    marks, reach = [], 1.0
    for terms in (system.numerator, system.denominator):
        corners = log_corners(terms)
        marks += corners
        orders = sorted(t.order for t in terms)
        for a, b in itertools.pairwise(orders):
            # A neighbouring term of order b − a away falls to 1e-3 of the leading term
            # within 7/(b − a).
            reach = max(reach, min(20.0, 7.0 / max(b - a, 0.1)))
    for end in (-1, 0):
        up, down = system.numerator[end], system.denominator[end]
        slope = up.order - down.order
        if slope:
            marks.append(-math.log(abs(up.coefficient / down.coefficient)) / slope)
    return (min(marks, default=0.0), max(marks, default=0.0)), reach


def log_corners(terms: Sequence[Term]) -> list[float]:
    """ln ω at which neighbouring terms of a sum are equal: corners of the magnitude's
    asymptotes.
    """
    if len(terms) < 2 or terms[0].order == terms[-1].order:
        return []
    sum_ = ExponentialSum.of([t.coefficient for t in terms], [t.order for t in terms])
    a, nu = np.log(np.abs(sum_.coefficients)), sum_.rates
    return [float((a[j] - a[k]) / (nu[k] - nu[j])) for j, k in newton_polygon(sum_)]
