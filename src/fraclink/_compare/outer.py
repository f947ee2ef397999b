"""Outer controllers that are more than a filter: sliding mode, and the algebraic estimator with GPI."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fraclink._compare.linear import Filter, tustin

__all__ = [
    "Algebraic",
    "Linear",
    "Outer",
    "Seen",
    "Sliding",
    "gpi_control",
    "gpi_correction",
    "pd_correction",
    "sliding_correction",
]

Real = NDArray[np.float64]


class Seen(NamedTuple):
    """What an outer controller gets in one tick, all in radians: θt*, e, Γ/c, F θ̈t*."""

    reference: float
    error: float
    deflection: float
    feed_forward: float


class Outer(Protocol):
    """One tick of an outer controller: what it adds to θt* + F θ̈t* [rad]."""

    def __call__(self, seen: Seen) -> float:
        """Return the addition [rad]."""
        ...


class Linear:
    """A filter on the tip error; one object for one run."""

    def __init__(self, correction: Filter) -> None:
        self._filter = correction
        self._state = np.zeros(correction.order)

    def __call__(self, seen: Seen) -> float:
        """Return Ĉ e."""
        f, error = self._filter, seen.error
        output = float(f.c @ self._state) + f.d * error
        self._state = f.a @ self._state + f.b * error
        return output


def pd_correction(gain: float, *, corner: float, filter_time: float, period: float) -> Filter:
    """Return gain·(1 + s/corner)/(1 + filter_time s) by Tustin."""
    a, b = np.array([[-1.0 / filter_time]]), np.ones(1)
    direct = gain / (corner * filter_time)
    return tustin(a, b, np.array([(gain - direct) / filter_time]), direct, period)


def sliding_correction(rate: float, frequency: float, *, filter_time: float, period: float) -> Filter:
    """Return what the sliding mode is inside its boundary layer: poles of the error at −rate, twice.

    θ̈t = ω²(θm − θt), θm = θt + (θ̈t* + Λ ė + κ (ė + Λ e))/ω² with Λ = κ = rate, so that with C = 1 + Ĉ
    Ĉ e = (rate²/ω² − 1) e + 2 rate/ω² ė.
    """
    proportional = rate**2 / frequency**2 - 1.0
    derivative = 2.0 * rate / frequency**2
    a, b = np.array([[-1.0 / filter_time]]), np.ones(1)
    direct = derivative / filter_time
    return tustin(a, b, np.array([-direct / filter_time]), proportional + direct, period)


class Sliding:
    """The sliding mode with its boundary layer: the switching term stops growing at `bound`."""

    def __init__(
        self, rate: float, frequency: float, bound: float, *, filter_time: float, period: float
    ) -> None:
        self._rate, self._square, self._bound = rate, frequency**2, bound
        self._derivative = tustin(
            np.array([[-1.0 / filter_time]]),
            np.ones(1),
            np.array([-1.0 / filter_time**2]),
            1.0 / filter_time,
            period,
        )
        self._state = np.zeros(1)

    def __call__(self, seen: Seen) -> float:
        """Return −e + (Λ ė + sat(κ s))/ω²."""
        f, error = self._derivative, seen.error
        speed = float(f.c @ self._state) + f.d * error
        self._state = f.a @ self._state + f.b * error
        surface = self._rate * (speed + self._rate * error)
        switching = math.copysign(min(abs(surface), self._bound), surface)
        return -error + (self._rate * speed + switching) / self._square


def gpi_control(rate: float, frequency: float, *, filter_time: float, period: float) -> Filter:
    """Return the GPI control C of θ̈t = ω² u with four error poles at −rate, behind a low-pass filter.

    C = (6 r² s² + 4 r³ s + r⁴)/(ω² s (s + 4 r)); the integral replaces the velocity that is not measured.
    """
    r = rate
    a = np.array([[0.0, 1.0], [0.0, -4.0 * r]])
    # (6r²s² + 4r³s + r⁴)/(s² + 4rs) = 6r² + (−20r³ s + r⁴)/(s² + 4rs)
    c = np.array([r**4, -20.0 * r**3]) / frequency**2
    control = tustin(a, np.array([0.0, 1.0]), c, 6.0 * r**2 / frequency**2, period)
    smooth = tustin(np.array([[-1.0 / filter_time]]), np.ones(1), np.array([1.0 / filter_time]), 0.0, period)
    return control.after(smooth)


def gpi_correction(rate: float, frequency: float, *, filter_time: float, period: float) -> Filter:
    """Return Ĉ = C − 1 of `gpi_control`."""
    control = gpi_control(rate, frequency, filter_time=filter_time, period=period)
    return Filter(control.a, control.b, control.c, control.d - 1.0)


class _Integral:
    """A running integral by the trapezoid rule; at 4 ms a rectangle rule would bias ω² by 8 %."""

    def __init__(self) -> None:
        self.value = 0.0
        self._last = 0.0

    def add(self, integrand: float, period: float) -> float:
        """Go on to the next sample and return the integral up to it."""
        self.value += 0.5 * period * (self._last + integrand)
        self._last = integrand
        return self.value


class Algebraic:
    """Algebraic estimate of the payload while the move begins, then GPI with the frequency it gives.

    From θ̈t = ω² δ, δ = Γ/c, multiplied by t² and integrated twice:
    ω² ∫∫ t² δ = t² θt − 4 ∫ t θt + 2 ∫∫ θt; both sides are fitted by least squares until `until` [s], then
    ω is fixed, within a factor of two of the nominal one. Until then ω is the nominal one.
    Source: the adaptive predecessor that the paper cites as [18]; it assumes a gauge without offset.
    """

    def __init__(
        self, rate: float, frequency: float, *, filter_time: float, period: float, until: float
    ) -> None:
        self._nominal, self._period, self._until = frequency**2, period, until
        self._filter = gpi_control(rate, frequency, filter_time=filter_time, period=period)
        self._state = np.zeros(self._filter.order)
        self._integrals, self._tick = tuple(_Integral() for _ in range(7)), 0
        self.square = frequency**2  # ω² in use

    def _estimate(self, tip: float, deflection: float) -> None:
        h, t = self._period, self._tick * self._period
        bend, bend_twice, moment, angle, angle_twice, product, square = self._integrals
        right = bend_twice.add(bend.add(t * t * deflection, h), h)
        left = t * t * tip - 4.0 * moment.add(t * tip, h) + 2.0 * angle_twice.add(angle.add(tip, h), h)
        above, below = product.add(right * left, h), square.add(right * right, h)
        if t >= self._until and below > 0.0:
            self.square = min(max(above / below, 0.25 * self._nominal), 4.0 * self._nominal)
            self._until = math.inf

    def __call__(self, seen: Seen) -> float:
        """Return what GPI with the estimated ω adds, the feed-forward's change included."""
        if self._until < math.inf:
            self._estimate(seen.reference - seen.error, seen.deflection)
        self._tick += 1
        f = self._filter
        whole = float(f.c @ self._state) + f.d * seen.error
        self._state = f.a @ self._state + f.b * seen.error
        ratio = self._nominal / self.square
        return ratio * whole - seen.error + (ratio - 1.0) * seen.feed_forward
