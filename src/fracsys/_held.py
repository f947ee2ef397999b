"""Held responses of a delay-free quotient: exact weights at lags 0 and 1, modes from
lag 2 on.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fracsys import _kernels
from fracsys._contour import (
    careful_response,
    convolve,
    respond_by_weights,
    sample_response,
)
from fracsys._modes import (
    DiscreteModes,
    Expansion,
    expand,
    mean_growth,
    split_delay,
)
from fracsys._quotient import (
    LowFrequency,
    Quotient,
    jump_response,
    power_response,
    power_weights,
    split_low_frequency,
)
from fracsys._terms import Reals, Term, collect, grid, largest, same, snap

# times at which the modes are compared with the contour integral; their error swings in
# ln t
_CHECKS = 9
_SWING = (
    6.0  # that error swings in ln t, and nine times need not meet its largest value
)
_ADDED = (
    4.0  # jumps of an input whose errors may fall together: its other swings take turns
)
_ENOUGH = (
    3e-11  # of the peak: above this the modes cancel, and a contour per lag is used …
)
_MOST_WEIGHTS = (
    200_000  # … for so many samples (about 2 s); the error estimate tells the rest
)
_CORRECTIONS = 3  # of the tolerance that an expansion is asked for
_FINEST = 1e-14  # where rounding begins
# units of rounding: a pole less certain than that has a neighbour, and their errors
# cancel
_VAGUE = 1e3
_POWER_UNITS = 20.0  # of rounding in t^a/Γ(1+a) and in its convolution by FFT
# times that are evaluated together: 60 modes are 2 MB; and differences that are added
_CHUNK = 4096


@dataclass(frozen=True)
class Part:
    """A response, its estimated error, the number of modes (0 without) and the method."""

    output: Reals
    error: float
    modes: int
    method: str


@dataclass(frozen=True)
class HeldQuotient:
    """N/D without delays, split at low frequency, with its poles: from here any period
    and hold is cheap.
    """

    low: LowFrequency
    quotient: Quotient | None
    direct: float
    whole: Quotient

    @classmethod
    def of(cls, top: tuple[Term, ...], bottom: tuple[Term, ...]) -> HeldQuotient:
        low = split_low_frequency(top, bottom)
        whole = Quotient.of(top, bottom)
        # What is taken off at low frequency has its poles at 0 alone: the others
        # are found once, for the whole.
        quotient = Quotient(low.top, whole.bottom, whole.zeros) if low.top else None
        same_degree = bool(low.top) and low.top[0].order == low.bottom[0].order
        direct = (
            low.top[0].coefficient / low.bottom[0].coefficient if same_degree else 0.0
        )
        if len(low.top) == len(low.bottom) == 1 and same_degree:
            quotient = None  # a pure gain
        return cls(low, quotient, direct, whole)

    def expansion(self, period: float, span: float, tolerance: float) -> Expansion:
        """Modes of the step response from one period to the span, two periods later for
        the last hold.
        """
        if self.quotient is None or not self.low.is_split:
            none = np.empty(0)
            return Expansion(none, none, none.astype(complex), none.astype(complex))
        return expand(
            self.quotient,
            shortest=period,
            longest=span + 2.0 * period,
            tolerance=tolerance,
        )

    def exact(self, times: list[float], power: int) -> list[float]:
        """Step (power 1) or ramp (2) response at single times ≥ 0, without integrator
        and singular powers.
        """
        if self.quotient is None:
            return [self.direct * (t if power == 2 else 1.0) for t in times]
        # At 0 itself the parabola has no scale; what the response is there follows from
        # its highest powers.
        start = self.direct if power == 1 else 0.0
        later = [t for t in times if t > 0.0]
        values = iter(_judge(self.quotient, np.array(later), power).tolist())
        return [
            start if t == 0.0 else (0.0 if t < 0.0 else next(values)) for t in times
        ]

    def modes(
        self,
        period: float,
        *,
        hold: str,
        span: float,
        tolerance: float,
        delay: float = 0.0,
    ) -> DiscreteModes:
        """The recursion: exact weights at lags 0 and 1, modes from lag 2 on."""
        return self._recursion(
            self._kept(period, span, tolerance), period, hold, span, tolerance, delay
        )

    def _kept(self, period: float, span: float, tolerance: float) -> Expansion:
        """The expansion that keeps a tolerance of the step response relative to its
        peak.

        Its step follows from the error of simple poles; two that coincide, or nearly,
        cost up to a factor of eleven. Where the contour shows more than was asked for,
        half of what would do is asked for.
        """
        asked = tolerance
        for _ in range(_CORRECTIONS):
            parts = self.expansion(period, span, asked)
            error, peak, _ = self.error(parts, period, span)
            if error <= tolerance * peak or asked <= _FINEST:
                break
            asked = max(0.5 * asked * tolerance * peak / error, _FINEST)
        return parts

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
        lag, ahead = split_delay(delay, period)
        integrator, early = self.low.integrator, 0.0
        x, z = -parts.rates * period, parts.poles * period
        if hold == "zero":
            if ahead or step is None:
                at, next_at = self.exact([ahead, period + ahead], 1)
            else:
                at, next_at = self.direct, step  # known from the check of the modes
            zeroth, one = at + integrator * ahead, next_at - at + integrator * period
            gains, pole_gains = (
                parts.weights * np.expm1(x),
                2.0 * parts.pole_weights * np.expm1(z),
            )
        else:
            before, at, next_at = self.exact(
                [ahead, period + ahead, 2.0 * period + ahead], 2
            )
            early = before / period + 0.5 * integrator * ahead**2 / period
            zeroth = (at - 2.0 * before) / period
            zeroth += integrator * (0.5 * period + ahead - 0.5 * ahead**2 / period)
            one = (next_at - 2.0 * at + before) / period + integrator * period
            # A hat is a second difference of ramps: (e^x − 1)²/x of each mode, without
            # the cancellation of three exponentials.
            gains = parts.weights * np.expm1(x) ** 2 / x
            pole_gains = 2.0 * parts.pole_weights * np.expm1(z) ** 2 / z
        # A sample is `ahead` later than the input that it answers, and each mode has
        # moved on by as much.
        gains, pole_gains = (
            gains * np.exp(x * ahead / period),
            pole_gains * np.exp(z * ahead / period),
        )
        if integrator:
            x, gains = np.append(x, 0.0), np.append(gains, integrator * period)
        # The weight at lag 1 is exact by construction: within the first period the
        # modes are not what they stand for.
        first = one - float(gains.sum()) - float(pole_gains.sum().real)
        return DiscreteModes(
            period,
            hold,
            zeroth,
            first,
            x,
            gains,
            z,
            pole_gains,
            span,
            lag,
            early,
            tolerance,
        )

    def respond(
        self, u: Reals, period: float, *, hold: str, tolerance: float, delay: float
    ) -> Part:
        """Response to the samples u."""
        span = max(len(u), 1) * period
        parts = self.expansion(period, span, tolerance)
        # Every response is judged by the contour: whether modes cancel depends
        # on the span, and not on G alone.
        error, peak, step = self.error(parts, period, span)
        if self._needs_contour(error, peak, len(u)):
            lag, ahead = split_delay(delay, period)
            output, error = respond_by_weights(
                self.whole, self.direct, u, period, hold, lag, ahead
            )
            return Part(output, error + 4e-15 * largest(output), 0, "contour")
        modes = self._recursion(parts, period, hold, span, tolerance, delay, step)
        output = modes.respond(u)
        lag, ahead = split_delay(delay, period)
        if lag < len(u) and self.low.powers:
            weights = power_weights(self.low.powers, period, ahead, len(u) - lag, hold)
            output[lag:] += convolve(weights, u[: len(u) - lag])
        if lag <= len(u) and hold == "first":
            self._add_edges(output, u, parts, period, lag, ahead)
        error = _SWING * error + self._unseen(parts, span, 1, len(u))
        return Part(
            output,
            error * _jumps(u) + 4e-15 * largest(output),
            modes.count,
            self._method,
        )

    def _add_edges(
        self,
        output: Reals,
        u: Reals,
        parts: Expansion,
        period: float,
        lag: int,
        ahead: float,
    ) -> None:
        """Turn hats that start one period before their sample into a jump at 0 and
        straight lines after it.

        With a delay between samples a hat is seen `ahead` before its peak: the singular
        powers' share of that (the modes' is in `early`), less what the jump's own hat
        has of it.
        """
        if ahead:
            rise = (
                float(power_response(self.low.powers, np.array([ahead]), 2)[0]) / period
            )
            output[lag - 1 :] += rise * u[: len(u) - lag + 1]
            early = (
                self.exact([ahead], 2)[0] / period
                + 0.5 * self.low.integrator * ahead**2 / period
            )
            output[lag - 1] -= u[0] * (rise + early)
        if lag < len(u) and u[0] != 0.0:
            output[lag:] += u[0] * self._jump(len(u) - lag, parts, period, ahead)

    def _jump(self, count: int, parts: Expansion, period: float, ahead: float) -> Reals:
        """Response to a jump at 0 minus that to a straight rise from -T to 0, `ahead`
        after each sample.
        """
        step, (ramp, next_ramp) = (
            self.exact([ahead], 1)[0],
            self.exact([ahead, ahead + period], 2),
        )
        x, z = -parts.rates * period, parts.poles * period
        gains = -parts.weights * np.exp(x * ahead / period) * mean_growth(x)
        pole_gains = (
            -2.0 * parts.pole_weights * np.exp(z * ahead / period) * mean_growth(z)
        )
        # An unforced run of the modes from 1: what a jump at time 0 leaves of itself at
        # every later sample.
        start = np.concatenate((np.ones(len(x)), np.tile([1.0, 0.0], len(z))))
        output: Reals = _kernels.modes_response(
            np.zeros(count), 0.0, 0.0, x, gains, z, pole_gains, start
        )
        output[0] = step - (next_ramp - ramp) / period
        output -= 0.5 * self.low.integrator * period
        times = grid(count, period) + ahead
        return np.asarray(output + jump_response(self.low.powers, period, times))

    def at(self, times: Reals, degree: int, tolerance: float) -> Part:
        """Impulse (degree 0) or step (1) response at any times [s]; 0 before time 0."""
        output, later = np.zeros(len(times)), times > 0.0
        output[times == 0.0] = self._initial(degree)
        if not later.any():
            return Part(output, 0.0, 0, "modes")
        t = times[later]
        shortest, longest = float(t.min()), float(t.max())
        parts = self.expansion(shortest, longest, tolerance)
        first = None
        if degree:
            error, peak, first = self.error(parts, shortest, longest)
        else:
            error, peak = self.impulse_error(parts, shortest, longest)
        if self._needs_contour(error, peak, len(t)):
            function = self.whole if degree else self.falling
            output[later], error = sample_response(function, t, degree, 0.0)
            return Part(output, error + 4e-15 * largest(output[later]), 0, "contour")
        scale, pole_scale = (1.0, 1.0) if degree else (-parts.rates, parts.poles)
        basis = np.expm1 if degree else np.exp
        value = np.empty(len(t))
        for k in range(0, len(t), _CHUNK):
            part = t[k : k + _CHUNK, None]
            real = basis(-parts.rates * part) @ (parts.weights * scale)
            pair = basis(parts.poles * part) @ (parts.pole_weights * pole_scale)
            value[k : k + _CHUNK] = real + 2.0 * pair.real
        if degree:
            # The modes hold increments only: one exact value fixes the constant. At the
            # first time: there the value is smallest, and a constant that is off shows
            # most.
            index = int(np.argmin(t))
            value += (self.exact([shortest], 1)[0] if first is None else first) - value[
                index
            ]
        value += self.low.integrator * (t if degree else 1.0) + power_response(
            self.low.powers, t, degree
        )
        output[later] = value
        count = len(parts.rates) + 2 * len(parts.poles)
        error = _SWING * error + self._unseen(parts, longest, degree, 0)
        return Part(output, error + 4e-15 * largest(value), count, self._method)

    def _unseen(self, parts: Expansion, span: float, degree: int, steps: int) -> float:
        """Error that the comparison of modes and contour cannot show: what both share,
        and the recursion's.

        Both use the same poles, known to some units of rounding in ln s: after the time
        t such a mode is off by |p| t of them. The recursion multiplies a mode once for
        sixteen steps, each time with the same rounded factor. Singular powers are large
        where they cancel each other or the modes.
        """
        rates = np.concatenate((-parts.rates, parts.poles))
        size = np.concatenate((np.abs(parts.weights), 2.0 * np.abs(parts.pole_weights)))
        moving = (rates.imag != 0.0) | (
            rates.real > 0.0
        )  # the others are gone before their error matters
        place = np.ones(len(rates))
        place[moving] += np.minimum(
            self.whole.place_error(np.log(rates[moving])), _VAGUE
        )
        # A mode that dies errs for as long as it lives, and not for the whole span.
        life = span / np.maximum(1.0, -rates.real * span)
        turned = np.abs(rates) * life
        # A slow mode moves by its weight times |p| t only: the weight itself, huge
        # beside 0, is never seen.
        size *= np.exp(np.maximum(rates.real * span, 0.0)) * np.minimum(turned, 1.0)
        if degree == 0:
            size *= np.abs(rates) / np.minimum(turned, 1.0)
        units = 2.0 + turned * place + steps * life / (16.0 * span)
        shared = 0.0
        if self.low.powers:
            powers = [
                (abs(c) * (_POWER_UNITS + a * abs(math.log(span))), a)
                for c, a in self.low.powers
            ]
            shared = float(power_response(powers, np.array([span]), degree)[0])
        # The modes' errors are independent: three times the root of the sum of their
        # squares. By `hypot`, as the squares of what grows beyond e^355 leave the range
        # of doubles.
        return sys.float_info.epsilon * (
            3.0 * math.hypot(*(size * units).tolist()) + shared
        )

    @property
    def _method(self) -> str:
        return "modes+convolution" if self.low.powers else "modes"

    def _needs_contour(self, error: float, peak: float, count: int) -> bool:
        # `not <=` and not `>`: modes that overflowed into each other leave nan, which
        # is no small error.
        return not self.low.is_split or (
            not error <= _ENOUGH * peak and count <= _MOST_WEIGHTS
        )

    def _initial(self, degree: int) -> float:
        """Value just after 0 of the step response, or of the impulse response without
        its δ.
        """
        if degree:
            return self.direct
        if self.quotient is None:
            tail, gap = 0.0, math.inf
        else:
            tail, gap = _leading(self.low.top, self.low.bottom, self.direct)
        strongest = min(
            [
                gap,
                *([1.0] if self.low.integrator else []),
                *(a for _, a in self.low.powers),
            ]
        )
        # h ~ t^(a−1)/Γ(a): infinite at 0 for a < 1, finite for 1/s alone, else 0.
        if strongest < 1.0:
            return math.copysign(math.inf, tail)
        return (tail if gap == 1.0 else 0.0) + self.low.integrator

    @cached_property
    def falling(self) -> Quotient:
        """N/D less its direct part, which an impulse response does not show.

        Left in, a constant would be integrated along the contour to zero, with an error
        of ε·direct/t.
        """
        rest = _without_direct(self.whole.top, self.whole.bottom, self.direct)
        return Quotient(tuple(rest), self.whole.bottom, self.whole.zeros)

    def impulse_error(
        self, parts: Expansion, shortest: float, longest: float
    ) -> tuple[float, float]:
        """Error of the modes' impulse response against a contour integral, and its
        peak.

        Not that of the step response over a time: modes of high rates err most just
        after the first time.
        """
        # Nothing but a gain and an integrator: there is no mode whose error could be
        # seen.
        if not self.falling.top or (self.quotient is None and not self.low.powers):
            return 0.0, 1.0
        times = _check_times(shortest, longest)
        value = -np.exp(-np.outer(times, parts.rates)) @ (parts.rates * parts.weights)
        value += (
            2.0
            * (
                np.exp(np.outer(times, parts.poles))
                @ (parts.poles * parts.pole_weights)
            ).real
        )
        value += self.low.integrator + power_response(self.low.powers, times, 0)
        exact = _judge(self.falling, times, 0)
        return float(np.max(np.abs(value - exact))), float(np.max(np.abs(exact)))

    def error(
        self, parts: Expansion, shortest: float, longest: float
    ) -> tuple[float, float, float | None]:
        """Error of the modes' step response against a contour integral, its peak, and
        its first exact value.

        The contour integrates the whole function, so that what the split at low
        frequency loses is seen. The exact value at `shortest` is that without the parts
        split off; None where nothing was integrated.
        """
        if (
            self.quotient is None
            and len(self.low.powers) + bool(self.low.integrator) <= 1
        ):
            return 0.0, 1.0, None
        times = _check_times(shortest, longest)
        # Increments from 0 (expm1): the huge weight of a pole beside 0 would hide all
        # else in a constant.
        value = np.expm1(-np.outer(times, parts.rates)) @ parts.weights
        value += (
            2.0 * (np.expm1(np.outer(times, parts.poles)) @ parts.pole_weights).real
        )
        exact = _judge(self.whole, times, 1)
        split = bool(self.low.integrator or self.low.powers)
        first = float(exact[0])
        if split and self.quotient is not None:
            first = float(_judge(self.quotient, times[:1], 1)[0])
        elif split:
            first = self.exact([shortest], 1)[0]
        value += first - value[0]
        if split:
            value += self.low.integrator * times + power_response(
                self.low.powers, times, 1
            )
        return float(np.max(np.abs(value - exact))), float(np.max(np.abs(exact))), first


def _jumps(u: Reals) -> float:
    """How many errors of a step add up over an input: each jump brings its own, and
    they swing in ln t.
    """
    most, seen = _ADDED * largest(u), 0
    moved = abs(float(u[0])) if len(u) else 0.0
    # In chunks that stay in the cache, and no further than it takes: a busy input is at
    # its bound at once.
    while moved < most and seen < len(u) - 1:
        part = u[seen : seen + _CHUNK + 1]
        moved += float(np.abs(part[1:] - part[:-1]).sum())
        seen += _CHUNK
    return min(moved, most)


def _judge(quotient: Quotient, times: Reals, power: int) -> Reals:
    """The response accurate relative to itself: a single early time has no later peak
    to hide its error.
    """
    return careful_response(quotient, times, power, bounded=False)[0]


def _check_times(shortest: float, longest: float) -> Reals:
    """Times at which the modes are judged, even on a logarithmic scale."""
    # geomspace by hand: its own checks cost an eighth of a short response.
    growth = math.log(max(longest / shortest, 1.0001)) / (_CHECKS - 1)
    return np.asarray(shortest * np.exp(growth * np.arange(_CHECKS)))


def _without_direct(
    top: tuple[Term, ...], bottom: tuple[Term, ...], direct: float
) -> list[Term]:
    """Numerator of N/D - direct, in falling orders."""
    if not direct:
        return list(top)
    rest = collect([*top, *(Term(-direct * t.coefficient, t.order) for t in bottom)])
    # The leading term cancels by construction; left to rounding it would be a direct
    # part of 1e-16.
    return [t for t in rest if not same(t.order, bottom[0].order)]


def _leading(
    top: tuple[Term, ...], bottom: tuple[Term, ...], direct: float
) -> tuple[float, float]:
    """Coefficient and order of the leading power of 1/s in N/D - direct."""
    rest = _without_direct(top, bottom, direct)
    if not rest:
        return 0.0, math.inf
    return rest[0].coefficient / bottom[0].coefficient, snap(
        bottom[0].order - rest[0].order
    )
