"""The closed procedure (54)–(57): two real equations for ω̄_c and β, reduced to one scalar equation.

Magnitude at the heaviest payload gives ``k_d = χ/ω_c^β`` (54). The phase of (55) is linear in β and gives
``β(ω̄_c) = (2/π)(φ_m - π - arg R(jω̄_c) G(jω̄_c; ω₀̄))``; its magnitude then leaves one equation in ω̄_c alone.
R is what stands in the loop beside Ĉ and G: one in the paper's reading; filter, M(s), hold and delay in
the loop's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fraclink._design.loop import OpenLoop

__all__ = ["Solution", "Specification", "filter_by_rule", "solve"]

Real = NDArray[np.float64]
MARGIN_SHARE = 0.1  # of the phase margin, what the filter may cost (section 6, step 5)
_GRID = 240


@dataclass(frozen=True)
class Specification:
    """What the two equations need. ``bare`` is the loop with gain 1 and β = 0: R·G, no rule's filter."""

    bare: OpenLoop
    low: float  # ω₀ of the heaviest payload
    high: float  # ω₀ of the lightest
    gain_crossover: float  # wanted at `low` [rad/s]
    phase_margin: float  # wanted at `high` [rad]
    highest: float  # frequency above which nothing is looked for [rad/s]
    rule: bool = False  # the filter inside (55) is the one that costs a tenth of the margin at ω̄_c


@dataclass(frozen=True)
class Solution:
    """One solution of (54), (55), whether or not it is admissible."""

    order: float  # β
    gain: float  # k_d
    upper: float  # ω̄_c [rad/s]
    chi: float
    filter_time: float
    slope_low: float  # d ln|L| / d ln ω at (ω₀ low, ω_c): negative means right of the peak
    slope_high: float  # the same at (ω₀ high, ω̄_c)

    def violated(self, link_order: float) -> str | None:
        """Name the first condition of Theorem 1 that fails, None where all hold.

        Right of the peak of |L| is the exact condition: the denominator of (49) is minus the slope times a
        positive factor, so its sign is what makes ω_c rise and φ_m fall with ω₀. (39) is only sufficient.
        """
        limit = min(link_order, 2.0)
        if self.order <= 0.0:
            return "β > 0"
        if self.order >= limit:
            return "β < λ" if link_order < 2.0 else "β < 2"
        if self.slope_low >= 0.0:
            return "gain crossover right of the peak at the heaviest payload"
        if self.slope_high >= 0.0:
            return "gain crossover right of the peak at the lightest payload"
        return None


def _rule_time(spec: Specification, upper: Real) -> Real:
    """δ that lags by a tenth of φ_m at ω̄_c: n·atan(δ ω̄_c) = φ_m/10."""
    n = spec.bare.filter_order
    return np.asarray(math.tan(MARGIN_SHARE * spec.phase_margin / n) / upper)


def _filter_log(time: Real, frequency: Real | float, n: int) -> NDArray[np.complex128]:
    return np.asarray(-n * np.log(1.0 + 1j * time * frequency), dtype=np.complex128)


def _state(spec: Specification, upper: Real) -> tuple[Real, Real, Real]:
    """(residual of the magnitude of (55), β, ln χ) at trial values of ω̄_c."""
    at_low = spec.bare.log(spec.gain_crossover, spec.low)
    at_high = spec.bare.log(upper, spec.high)
    if spec.rule:
        time = _rule_time(spec, upper)
        at_low = at_low + _filter_log(time, spec.gain_crossover, spec.bare.filter_order)
        at_high = at_high + _filter_log(time, upper, spec.bare.filter_order)
    beta = 2.0 / math.pi * (spec.phase_margin - math.pi - at_high.imag)
    chi = -at_low.real
    residual = chi + beta * (np.log(upper) - math.log(spec.gain_crossover)) + at_high.real
    return np.asarray(residual), np.asarray(beta), np.asarray(chi)


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Root of a continuous function between two points of opposite sign: secant steps kept in the bracket."""
    a, b, fa, fb = low, high, function(low), function(high)
    for _ in range(100):
        if fa == 0.0:
            return a
        if fb == 0.0 or abs(b - a) <= 4e-16 * abs(b):
            return b
        # Illinois: the retained end's value is halved, which keeps superlinear speed without a stall.
        c = b - fb * (b - a) / (fb - fa)
        if not min(a, b) < c < max(a, b):
            c = 0.5 * (a + b)
        fc = function(c)
        if (fc > 0.0) == (fb > 0.0):
            fa *= 0.5
        else:
            a, fa = b, fb
        b, fb = c, fc
    return b


def solve(spec: Specification) -> Iterator[Solution]:
    """Yield every solution of (54), (55) with ω̄_c between 0.9 ω_c and `spec.highest`, lowest ω̄_c first.

    One by one: the first is the admissible one as a rule, and the others then cost nothing.
    """
    top = min(spec.highest, 50.0 * spec.gain_crossover * (spec.high / spec.low) ** 2)
    grid = np.geomspace(0.9 * spec.gain_crossover, max(top, 1.1 * spec.gain_crossover), _GRID)
    residual = _state(spec, grid)[0]
    places = np.nonzero((residual[:-1] > 0.0) != (residual[1:] > 0.0))[0]

    def at(upper: float) -> float:
        return float(_state(spec, np.asarray(upper))[0])

    for i in places:
        yield _solution(spec, root(at, float(grid[i]), float(grid[i + 1])))


def _solution(spec: Specification, upper: float) -> Solution:
    _, beta, log_chi = (float(x) for x in _state(spec, np.asarray(upper)))
    time = float(_rule_time(spec, np.asarray(upper))) if spec.rule else spec.bare.filter_time
    loop = replace(spec.bare, order=beta, filter_time=time)
    chi = math.exp(log_chi)
    return Solution(
        order=beta,
        gain=chi / spec.gain_crossover**beta,
        upper=upper,
        chi=chi,
        filter_time=time,
        slope_low=float(loop.slope(spec.gain_crossover, spec.low).real),
        slope_high=float(loop.slope(upper, spec.high).real),
    )


def filter_by_rule(
    loop: OpenLoop, natural_frequency: float, upper: float, phase_margin: float, n: int
) -> float:
    """Return δ [s] with which the filtered loop keeps exactly 90 % of `phase_margin` at `natural_frequency`.

    The crossing moves down with the filter; both move together: δ(ω) follows from the phase, and the
    magnitude is one equation in ω (eq. (57) and the criterion after it).
    """
    kept = (1.0 - MARGIN_SHARE) * phase_margin

    def lag(frequency: float) -> float:
        return float(loop.log(frequency, natural_frequency).imag) + math.pi - kept

    def level(frequency: float) -> float:
        return float(loop.log(frequency, natural_frequency).real) + n * math.log(math.cos(lag(frequency) / n))

    # Below ω̄_c the unfiltered loop lags less and is louder: walk down until the filter can take enough of it.
    low = upper
    for _ in range(200):
        low *= 0.99
        if lag(low) >= 0.45 * math.pi * n or level(low) > 0.0:
            break
    crossing = root(level, low, upper)
    return math.tan(lag(crossing) / n) / crossing
