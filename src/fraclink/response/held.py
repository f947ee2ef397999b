"""Held responses of a delay-free quotient: exact weights at lags 0 and 1, modes from lag 2 on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink.fractional import Term
from fraclink.fractional.terms import collect, same, snap
from fraclink.response.contour import held_response
from fraclink.response.expansion import Expansion, expand
from fraclink.response.lowfrequency import LowFrequency, split_low_frequency
from fraclink.response.modes import DiscreteModes
from fraclink.response.powers import convolve, jump_response, power_response, power_weights
from fraclink.response.quotient import Quotient

__all__ = ["HeldQuotient", "split_delay"]

Reals = NDArray[np.float64]

_CHECKS = 5  # times at which the modes are compared with the contour integral
_CHUNK = 4096  # times that are evaluated together: 60 modes are 2 MB


@dataclass(frozen=True)
class HeldQuotient:
    """N/D without delays, split at low frequency, with its poles: from here any period and hold is cheap."""

    low: LowFrequency
    quotient: Quotient | None
    direct: float

    @classmethod
    def of(cls, top: tuple[Term, ...], bottom: tuple[Term, ...]) -> HeldQuotient:
        low = split_low_frequency(top, bottom)
        quotient = Quotient.of(low.top, low.bottom) if low.top else None
        same_degree = bool(low.top) and low.top[0].order == low.bottom[0].order
        direct = low.top[0].coefficient / low.bottom[0].coefficient if same_degree else 0.0
        return cls(low, quotient, direct)

    def expansion(self, period: float, span: float, tolerance: float) -> Expansion:
        """Modes of the step response from one period to the span, two periods later for the last hold."""
        if self.quotient is None:
            none = np.empty(0)
            return Expansion(none, none, none.astype(complex), none.astype(complex))
        return expand(self.quotient, shortest=period, longest=span + 2.0 * period, tolerance=tolerance)

    def exact(self, times: list[float], power: int) -> list[float]:
        """Step (power 1) or ramp (2) response at single times ≥ 0, without integrator and singular powers."""
        if self.quotient is None:
            return [0.0] * len(times)
        start = self.direct if power == 1 else 0.0
        later = [t for t in times if t > 0.0]
        values = iter(held_response(self.quotient, np.array(later), power).tolist())
        return [start if t == 0.0 else (0.0 if t < 0.0 else next(values)) for t in times]

    def modes(
        self, period: float, *, hold: str, span: float, tolerance: float, delay: float = 0.0
    ) -> DiscreteModes:
        """The recursion: exact weights at lags 0 and 1, modes from lag 2 on."""
        lag, ahead = split_delay(delay, period)
        modes = self.expansion(period, span, tolerance)
        rates = np.concatenate((modes.rates, [0.0] if self.low.integrator else []))
        logs, pole_logs = -rates * period, modes.poles * period
        weights = 2.0 * modes.pole_weights * np.exp(modes.poles * ahead)
        slopes = self.low.integrator * period
        if hold == "zero":
            at, next_at = self.exact([ahead, period + ahead], 1)
            zeroth, one = at + self.low.integrator * ahead, next_at - at + slopes
            gains = modes.weights * np.expm1(-modes.rates * period)
            pole_gains = weights * np.expm1(pole_logs)
        else:
            before, at, next_at = self.exact([ahead, period + ahead, 2.0 * period + ahead], 2)
            zeroth = (at - 2.0 * before) / period + _hat_area(self.low.integrator, ahead, period)
            one = (next_at - 2.0 * at + before) / period + slopes
            gains = modes.weights * np.expm1(-modes.rates * period) ** 2 / (-modes.rates * period)
            pole_gains = weights * np.expm1(pole_logs) ** 2 / pole_logs
        gains = gains * np.exp(-modes.rates * ahead)
        if self.low.integrator:
            gains = np.append(gains, slopes)
        first = one - float(gains.sum()) - float(pole_gains.sum().real)
        return DiscreteModes(
            period, hold, zeroth, first, logs, gains, pole_logs, pole_gains, span, lag, tolerance
        )

    def respond(
        self, u: Reals, period: float, *, hold: str, tolerance: float, delay: float
    ) -> tuple[Reals, float, int]:
        """Response to the samples u, its estimated error, and the number of modes."""
        span = max(len(u), 1) * period
        modes = self.modes(period, hold=hold, span=span, tolerance=tolerance, delay=delay)
        output = modes.respond(u)
        ahead, lag = modes.lag * period - delay, modes.lag
        ahead = 0.0 if abs(ahead) < 1e-9 * max(period, delay) else ahead
        inside = len(u) - lag  # samples that see the input at all
        if inside > 0 and self.low.powers:
            weights = power_weights(self.low.powers, period, ahead, inside, hold)
            output[lag:] += convolve(weights, u[:inside])
        if inside > 0 and hold == "first" and u[0] != 0.0:
            output[lag:] += u[0] * self._jump(inside, period, ahead, tolerance)
        error = 4.0 * self.error(period, span, tolerance) * float(np.max(np.abs(u), initial=0.0))
        return output, error + 4e-15 * float(np.max(np.abs(output), initial=0.0)), modes.count

    def _jump(self, count: int, period: float, ahead: float, tolerance: float) -> Reals:
        """Response to a jump at 0 minus that to the straight rise from -T to 0 that a hat would give."""
        step, (ramp, next_ramp) = self.exact([ahead], 1)[0], self.exact([ahead, ahead + period], 2)
        modes = self.expansion(period, count * period, tolerance)

        x = -modes.rates * period
        gains = modes.weights * np.exp(-modes.rates * ahead) * (1.0 - np.expm1(x) / x)
        poles = modes.poles * period
        pole_gains = 2.0 * modes.pole_weights * np.exp(modes.poles * ahead) * (1.0 - np.expm1(poles) / poles)
        start = np.concatenate((np.ones(len(x)), np.tile([1.0, 0.0], len(poles))))
        rest = np.zeros(count)
        output: Reals = _kernels.modes_response(rest, 0.0, 0.0, x, gains, poles, pole_gains, start)
        output[0] = step - (next_ramp - ramp) / period
        output -= 0.5 * self.low.integrator * period
        times = np.arange(count, dtype=np.float64) * period + ahead
        return np.asarray(output + jump_response(self.low.powers, period, times))

    def at(self, times: Reals, degree: int, tolerance: float) -> tuple[Reals, float, int]:
        """Impulse (degree 0) or step (1) response at any times [s]; 0 before time 0."""
        output, later = np.zeros(len(times)), times > 0.0
        output[times == 0.0] = self._initial(degree)
        if not later.any():
            return output, 0.0, 0
        t = times[later]
        shortest, longest = float(t.min()), float(t.max())
        modes = self.expansion(shortest, longest, tolerance)
        scale, pole_scale = (1.0, 1.0) if degree else (-modes.rates, modes.poles)
        value = np.empty(len(t))
        for k in range(0, len(t), _CHUNK):
            part = t[k : k + _CHUNK, None]
            value[k : k + _CHUNK] = np.exp(-modes.rates * part) @ (modes.weights * scale)
            value[k : k + _CHUNK] += (
                2.0 * (np.exp(modes.poles * part) @ (modes.pole_weights * pole_scale)).real
            )
        if degree:
            # The modes hold increments only: one exact value fixes the constant.
            index = int(np.argmin(t))
            value += self.exact([shortest], 1)[0] - value[index]
        value += self.low.integrator * (t if degree else 1.0) + power_response(self.low.powers, t, degree)
        output[later] = value
        error = self.error(shortest, longest, tolerance) * (1.0 if degree else 1.0 / shortest)
        return output, error + 4e-15 * float(np.max(np.abs(value))), len(modes.rates) + 2 * len(modes.poles)

    def _initial(self, degree: int) -> float:
        """Value just after 0 of the step response, or of the impulse response without its δ."""
        if degree:
            return self.direct
        if self.quotient is None:
            tail, gap = 0.0, math.inf
        else:
            tail, gap = _leading(self.low.top, self.low.bottom, self.direct)
        strongest = min([gap, *([1.0] if self.low.integrator else []), *(a for _, a in self.low.powers)])
        if strongest < 1.0:
            return math.copysign(math.inf, tail)
        return (tail if gap == 1.0 else 0.0) + self.low.integrator

    def error(self, shortest: float, longest: float, tolerance: float) -> float:
        """Largest difference between modes and contour integral in the increments of the step response."""
        if self.quotient is None:
            return 0.0
        modes = self.expansion(shortest, longest, tolerance)
        times = np.geomspace(shortest, max(longest, 1.0001 * shortest), _CHECKS)
        value = np.exp(-np.outer(times, modes.rates)) @ modes.weights
        value += 2.0 * (np.exp(np.outer(times, modes.poles)) @ modes.pole_weights).real
        gap = value - np.array(self.exact(times.tolist(), 1))
        return float(np.ptp(gap))


def _hat_area(integrator: float, ahead: float, period: float) -> float:
    """Integral over time of the hat of half-width `period` from its beginning to `ahead` after its peak."""
    return integrator * (0.5 * period + ahead - 0.5 * ahead**2 / period)


def split_delay(delay: float, period: float) -> tuple[int, float]:
    """Whole periods of delay, rounded up, and how far the sample then is ahead of the delayed input [s]."""
    steps = delay / period
    lag = round(steps) if abs(steps - round(steps)) < 1e-9 * max(1.0, steps) else math.ceil(steps)
    ahead = lag * period - delay
    return lag, (0.0 if abs(ahead) < 1e-9 * max(period, delay) else ahead)


def _leading(top: tuple[Term, ...], bottom: tuple[Term, ...], direct: float) -> tuple[float, float]:
    """Coefficient and order of the leading power of 1/s in N/D - direct."""
    rest = collect([*top, *(Term(-direct * t.coefficient, t.order) for t in bottom)] if direct else top)
    rest = [t for t in rest if not direct or not same(t.order, bottom[0].order)]
    if not rest:
        return 0.0, math.inf
    return rest[0].coefficient / bottom[0].coefficient, snap(bottom[0].order - rest[0].order)
