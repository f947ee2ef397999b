"""Held responses of a delay-free quotient: exact weights at lags 0 and 1, modes from
lag 2 on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fracsys._contour import convolve, step_error, step_values
from fracsys._modes import TOLERANCE, DiscreteModes, Expansion, expand, split_delay
from fracsys._precision import EPSILON, ROUNDING
from fracsys._quotient import STRONG, Quotient, singular_order, without_integrator
from fracsys._terms import TOGETHER, Term, collect, largest, same, snap
from fracsys.checks import Real

# Times at which the modes are compared with the contour integral.
_CHECKS = 9
_SWING = 6.0  # The error oscillates in ln t, and nine times need not hit its maximum.
# Number of jumps of the input whose errors may add up; those of all others alternate in
# sign.
_ADDED = 4.0
# Error relative to the peak above which the modes cancel, and one contour per lag is
# used instead.
_ENOUGH = 3e-11


@dataclass(frozen=True)
class Part:
    """A response, its estimated error, the number of modes (0 if none) and the method."""

    output: Real
    error_estimate: float
    modes: int
    method: str


@dataclass(frozen=True)
class HeldQuotient:
    """G = N/D without delays: its integrator c/s, and the rest.

    `whole` is G and `rest` is G - c/s, None if that is only the gain `direct`. After
    this split any period and hold is cheap.
    """

    whole: Quotient
    integrator: float
    rest: Quotient | None
    direct: float

    @classmethod
    def of(cls, whole: Quotient) -> HeldQuotient:
        """Split a quotient at low frequency."""
        integrator, top = without_integrator(whole.top, whole.bottom)
        direct = _direct(top, whole.bottom)
        alone = len(top) == len(whole.bottom) == 1
        gain = not top or (alone and top[0].order == whole.bottom[0].order)
        # The only pole of an integrator is 0; the other poles are computed once, for
        # the whole quotient.
        rest = None if gain else Quotient(top, whole.bottom, whole.zeros)
        return cls(whole, integrator, rest, direct)

    @property
    def has_modes(self) -> bool:
        """Whether the response is a sum of modes: the rest must be weaker than s^-0.94
        at low frequency.
        """
        rest = self.rest
        return rest is None or singular_order(rest.top, rest.bottom) < STRONG

    def expansion(self, period: float, span: float, tolerance: float) -> Expansion:
        """Modes of the step response from one period to two periods beyond the span,
        which the last hold needs.
        """
        if self.rest is None:
            none = np.empty(0)
            return Expansion(none, none, none.astype(complex), none.astype(complex))
        longest = span + 2.0 * period
        return expand(self.rest, shortest=period, longest=longest, tolerance=tolerance)

    def exact(self, times: Sequence[float], *, ramp: bool = False) -> list[float]:
        """Response to a step or a ramp at single times ≥ 0, without the integrator."""
        if self.rest is None:
            return [self.direct * (t if ramp else 1.0) for t in times]
        # At t = 0 the parabola has no scale; the response there follows from the
        # highest powers.
        start = 0.0 if ramp else self.direct
        quotient = self.rest.integrated() if ramp else self.rest
        later = iter(step_values(quotient, np.array([t for t in times if t > 0.0])))
        return [float(next(later)) if t > 0.0 else start for t in times]

    def modes(
        self,
        period: float,
        *,
        hold: str,
        span: float,
        tolerance: float,
        delay: float = 0.0,
    ) -> DiscreteModes:
        """The recursion whose step response meets a tolerance relative to its peak.

        The step of an expansion follows from the error of simple poles; two that
        (nearly) coincide increase it by a factor of up to eleven. If the contour shows
        a larger error than requested, the expansion is repeated with half the tolerance
        that should suffice.
        """
        target, parts = tolerance, self.expansion(period, span, tolerance)
        error, peak, _ = self.error(parts, period, span)
        while error > tolerance * peak and target > ROUNDING:
            target = max(0.5 * target * tolerance * peak / error, ROUNDING)
            parts = self.expansion(period, span, target)
            error, peak, _ = self.error(parts, period, span)
        return self._recursion(parts, period, hold, span, tolerance, delay)

    def _recursion(
        self,
        parts: Expansion,
        period: float,
        hold: str,
        span: float,
        tolerance: float,
        delay: float,
        step: float | None = None,
    ) -> DiscreteModes:
        """Exact weights at lags 0 and 1, modes from lag 2 on; `step` is the step
        response after one period, without the integrator, where it is known.
        """
        lag, ahead = split_delay(delay, period)
        integrator, early = self.integrator, 0.0
        x, z = -parts.rates * period, parts.poles * period
        if hold == "zero":
            if ahead or step is None:
                at, next_at = self.exact([ahead, period + ahead])
            else:
                at, next_at = self.direct, step
            zeroth, one = at + integrator * ahead, next_at - at + integrator * period
            gains = parts.weights * np.expm1(x)
            pole_gains = 2.0 * parts.pole_weights * np.expm1(z)
        else:
            times = [ahead, period + ahead, 2.0 * period + ahead]
            before, at, next_at = self.exact(times, ramp=True)
            early = before / period + 0.5 * integrator * ahead**2 / period
            zeroth = (at - 2.0 * before) / period
            zeroth += integrator * (0.5 * period + ahead - 0.5 * ahead**2 / period)
            one = (next_at - 2.0 * at + before) / period + integrator * period
            # The response to a hat function is a second difference of ramp responses:
            # (e^x − 1)²/x for each mode, without the cancellation of three
            # exponentials.
            gains = parts.weights * np.expm1(x) ** 2 / x
            pole_gains = 2.0 * parts.pole_weights * np.expm1(z) ** 2 / z
        # A sample lies `ahead` later than the input that it responds to; each mode has
        # decayed for that long.
        gains = gains * np.exp(x * ahead / period)
        pole_gains = pole_gains * np.exp(z * ahead / period)
        if integrator:
            x, gains = np.append(x, 0.0), np.append(gains, integrator * period)
        return DiscreteModes(
            period=period,
            hold=hold,
            direct=zeroth,
            # The weight at lag 1 is exact by construction: within the first period the
            # modes do not represent the response.
            first=one - float(gains.sum()) - float(pole_gains.sum().real),
            log_decays=x,
            gains=gains,
            pole_log_decays=z,
            pole_gains=pole_gains,
            span=span,
            lag=lag,
            early=early,
            tolerance=tolerance,
        )

    def respond(
        self, u: Real, period: float, *, hold: str, tolerance: float, delay: float
    ) -> Part:
        """Response to the samples u; those of a linear hold begin with 0."""
        span = max(len(u), 1) * period
        checked = self._checked(period, span, tolerance, len(u))
        if checked is None:
            return self._by_weights(u, period, hold, delay)
        parts, error, step = checked
        modes = self._recursion(parts, period, hold, span, tolerance, delay, step)
        output = modes.respond(u)
        changes = float(np.abs(np.diff(u, prepend=0.0)).sum())
        # Each jump of the input contributes this error.
        error *= min(changes, _ADDED * largest(u))
        error += ROUNDING * largest(output)
        return Part(output, error, modes.count, "modes")

    def _checked(
        self, shortest: float, longest: float, tolerance: float, steps: int
    ) -> tuple[Expansion, float, float] | None:
        """The modes, the error of their step response after `steps` steps, and its
        first exact value without the integrator; None where there are no modes or they
        cancel.
        """
        if not self.has_modes:
            return None
        parts = self.expansion(shortest, longest, tolerance)
        # Each response is compared with the contour integral, since cancellation among
        # the modes depends on the span as well as on G.
        error, peak, first = self.error(parts, shortest, longest)
        # Modes that overflow give NaN, which must not pass for a small error.
        if not error <= _ENOUGH * peak:
            return None
        return parts, _SWING * error + self._unseen(parts, longest, steps), first

    def _by_weights(self, u: Real, period: float, hold: str, delay: float) -> Part:
        """The response by one contour per lag, where modes would cancel.

        This takes a few microseconds per lag. It is needed for poles and singular
        powers much slower than the whole span, which need a contour that grows with
        time.
        """
        lag, ahead = split_delay(delay, period)
        output, count = np.zeros(len(u)), len(u) - lag
        if count <= 0:
            return Part(output, 0.0, 0, "contour")
        quotient, start, forcing = self.whole, self.direct, u[:count]
        # the first-order hold of u is the integral of its held slopes
        if hold == "first":
            slopes = np.diff(u, append=u[-1])[:count] / period
            quotient, start, forcing = quotient.integrated(), 0.0, slopes
        times = np.arange(count, dtype=np.float64) * period + ahead
        values, error = _sampled(quotient, times, start)
        output[lag:] = convolve(np.diff(values, prepend=0.0), forcing)
        # The error common to neighbouring lags counts with twice the largest input. The
        # independent part counts with the root of the sum of squares of the input's
        # changes, at four standard deviations.
        changes = float(np.linalg.norm(np.diff(forcing, prepend=0.0)))
        error *= 2.0 * largest(forcing) + 4.0 * changes
        return Part(output, error + ROUNDING * largest(output), 0, "contour")

    def at(self, times: Real) -> Part:
        """Step response at any times [s]; 0 before time 0."""
        output, later = np.zeros(len(times)), times > 0.0
        output[times == 0.0] = self.direct
        if not later.any():
            return Part(output, 0.0, 0, "modes")
        t = times[later]
        checked = self._checked(float(t.min()), float(t.max()), TOLERANCE, 0)
        if checked is None:
            output[later], error = _sampled(self.whole, t, self.direct)
            count, method = 0, "contour"
        else:
            parts, error, first = checked
            output[later] = self._by_modes(parts, t, first)
            count, method = parts.count, "modes"
        return Part(output, error + ROUNDING * largest(output), count, method)

    def _by_modes(self, parts: Expansion, t: Real, first: float) -> Real:
        value = np.empty(len(t))
        for k in range(0, len(t), TOGETHER):
            value[k : k + TOGETHER] = parts.increments(t[k : k + TOGETHER])
        # The modes hold increments only; one exact value fixes the constant. It is
        # taken at the first time, where the value is smallest and an error in the
        # constant shows most.
        value += first - value[int(np.argmin(t))]
        return value + self.integrator * t

    def impulse(self, times: Real) -> Part:
        """Impulse response without its δ at any times [s]: the step response of s(G - D).

        At 0 it is the limit from the right, t^(a−1)/Γ(a) for G - D ~ s^-a.
        """
        return self._slope.at(times)

    @cached_property
    def _slope(self) -> HeldQuotient:
        """s(G - D), which has the poles of G; improper where G - D falls by less than
        one order.
        """
        whole = self.whole
        falling = _without_direct(whole.top, whole.bottom)
        raised = tuple(Term(t.coefficient, snap(t.order + 1.0)) for t in falling)
        return HeldQuotient.of(Quotient(raised, whole.bottom, whole.zeros))

    def _unseen(self, parts: Expansion, span: float, steps: int) -> float:
        """Rounding that the comparison of modes with the contour cannot show: each mode
        is multiplied once in sixteen steps, always by the same rounded factor.
        """
        rates = np.concatenate((-parts.rates, parts.poles))
        size = np.concatenate((np.abs(parts.weights), 2.0 * np.abs(parts.pole_weights)))
        # A decaying mode accumulates rounding only during its lifetime, not over the
        # whole span.
        life = 1.0 / np.maximum(1.0, -rates.real * span)
        # A slow mode contributes only its weight times |p| t; the weight itself may be
        # huge near p = 0 but never shows in the output.
        size *= np.exp(np.maximum(rates.real * span, 0.0))
        size *= np.minimum(np.abs(rates) * span * life, 1.0) * (
            2.0 + steps * life / 16.0
        )
        # The errors of the modes are independent: three times the root of the sum of
        # their squares. `hypot`, because squares of growing modes beyond e^355
        # overflow.
        return 3.0 * EPSILON * math.hypot(*size.tolist())

    def error(
        self, parts: Expansion, shortest: float, longest: float
    ) -> tuple[float, float, float]:
        """Error of the modes' step response compared with a contour integral, its peak,
        and its first exact value without the integrator.
        """
        if self.rest is None:
            return 0.0, 1.0, self.direct
        # Logarithmic spacing; geomspace is avoided because its own checks take a
        # twentieth of the time of a short response.
        growth = math.log(max(longest / shortest, 1.0001)) / (_CHECKS - 1)
        times = shortest * np.exp(growth * np.arange(_CHECKS))
        # The contour integrates the whole function, so that digits lost by splitting
        # off the integrator show.
        exact = step_values(self.whole.misplaced, times)
        first = float(exact[0])
        if self.integrator:
            first = float(step_values(self.rest, times[:1])[0])
        value = parts.increments(times)
        value += first - value[0] + self.integrator * times
        return float(np.max(np.abs(value - exact))), float(np.max(np.abs(exact))), first


def _sampled(quotient: Quotient, times: Real, start: float) -> tuple[Real, float]:
    """Step response by one contour per time, with the value `start` at t = 0, and an
    estimate of its error.
    """
    values, later = np.where(times == 0.0, start, 0.0), times > 0.0
    if not later.any():
        return values, 0.0
    values[later] = step_values(quotient, times[later])
    return values, step_error(quotient, times[later], values[later])


def _direct(top: Sequence[Term], bottom: Sequence[Term]) -> float:
    """The direct part of N/D, which does not fall at high frequency and is the initial
    value of its step response; infinite for an improper quotient.
    """
    if not top or top[0].order < bottom[0].order:
        return 0.0
    ratio = top[0].coefficient / bottom[0].coefficient
    return ratio if top[0].order == bottom[0].order else math.copysign(math.inf, ratio)


def _without_direct(top: Sequence[Term], bottom: Sequence[Term]) -> list[Term]:
    """Numerator of N/D minus its direct part, in descending orders."""
    direct = _direct(top, bottom)
    if not direct:
        return list(top)
    rest = collect([*top, *(Term(-direct * t.coefficient, t.order) for t in bottom)])
    # The leading term cancels by construction; rounding would leave a direct part of
    # 1e-16.
    return [t for t in rest if not same(t.order, bottom[0].order)]
