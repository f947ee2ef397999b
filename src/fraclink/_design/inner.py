"""The motor loop as it is sampled: the 2-DOF PID at its period, on the motor under a held, late voltage.

With x = z⁻¹, e = exp(-B Ts) and d samples of delay the motor is ``P(x) = x^{1+d}(m1 + m2 x)/((1-x)(1-e x))``.
``direct_placement`` solves ``(1-x)²(1-e x)(1-r x) + x^{1+d}(m1 + m2 x) S(x) = (1-z₀x)³ f(x)`` for the PID
itself, z₀ = exp(-p Ts): the delay stands inside the equation instead of eating the margin afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.motor import DiscreteInnerLoop, inner_loop
from fraclink.errors import FieldError

if TYPE_CHECKING:
    from fraclink._arm.rig import Motor, Rig

__all__ = [
    "InnerCost",
    "SampledInner",
    "direct_placement",
    "inner_correction",
    "inner_costs",
    "inner_ratio",
    "sampled_inner",
]

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


def held_motor(motor: Motor, period: float) -> tuple[float, float, float]:
    """Return (m1, m2, e) of ``A/(s(s+B))`` under a zero-order hold: ``x(m1 + m2 x)/((1-x)(1-e x))``.

    >>> from fraclink._arm.rig import Rig
    >>> m1, m2, e = held_motor(Rig.named("paper-2023").motor, 0.004)
    >>> print(f"{m1:.6f} {m2:.6f} {e:.6f}")
    0.023967 0.023488 0.941189
    """
    gain, decay = motor.gain, motor.decay
    e = math.exp(-decay * period)
    if decay * period < 1e-8:
        return 0.5 * gain * period**2, 0.5 * gain * period**2, e
    weight = -math.expm1(-decay * period) / decay
    return gain * (period - weight) / decay, gain * (weight - period * e) / decay, e


@dataclass(frozen=True)
class SampledInner:
    """The discrete inner loop around its motor.

    ``loop`` holds the coefficients that law.c runs; `delay_samples` whole periods pass between reading the
    encoder and the new voltage.
    """

    loop: DiscreteInnerLoop
    motor: Motor
    delay_samples: int

    def controllers(self, x: Complex) -> tuple[Complex, Complex]:
        """(Cm1, Cm2) at x = z⁻¹."""
        k = self.loop
        integral = (k.integral_now + k.integral_before * x) / (1.0 - x)
        filtered = (k.filter_now + k.filter_before * x) / (1.0 - k.filter_decay * x)
        first = k.direct + k.integral_gain * integral + k.filter_gain * filtered
        return first, k.angle_direct + k.angle_filter_gain * filtered

    def plant(self, x: Complex) -> Complex:
        """The held motor without its computation delay, at x = z⁻¹."""
        m1, m2, e = held_motor(self.motor, self.loop.period)
        return x * (m1 + m2 * x) / ((1.0 - x) * (1.0 - e * x))

    def loop_gain(self, frequency: ArrayLike) -> Complex:
        """Open loop of the motor loop, ``(Cm1 + Cm2) z^{-d} P`` at `frequency` [rad/s]."""
        x = np.exp(-1j * np.asarray(frequency, dtype=float) * self.loop.period)
        first, second = self.controllers(x)
        return np.asarray((first + second) * x**self.delay_samples * self.plant(x))

    def voltage(self, frequency: ArrayLike) -> Complex:
        """From θm* to the applied voltage, ``z^{-d} Cm1/(1 + (Cm1 + Cm2) z^{-d} P)``, at ω [rad/s]."""
        x = np.exp(-1j * np.asarray(frequency, dtype=float) * self.loop.period)
        first, second = self.controllers(x)
        late = x**self.delay_samples
        return np.asarray(first * late / (1.0 + (first + second) * late * self.plant(x)))

    def poles(self) -> Complex:
        """Poles of the closed motor loop in z, largest modulus first."""
        k = self.loop
        m1, m2, e = held_motor(self.motor, k.period)
        one, slow, motor = (np.array([1.0, -a]) for a in (1.0, k.filter_decay, e))
        direct = k.direct + k.angle_direct
        integral = k.integral_gain * np.array([k.integral_now, k.integral_before])
        filtered = (k.filter_gain + k.angle_filter_gain) * np.array([k.filter_now, k.filter_before])
        both = np.polyadd(
            np.polyadd(direct * np.polymul(one, slow), np.polymul(integral, slow)), np.polymul(filtered, one)
        )
        left = np.polymul(np.polymul(one, motor), np.polymul(one, slow))
        right = np.concatenate([np.zeros(1 + self.delay_samples), np.polymul([m1, m2], both)])
        left = np.concatenate([left, np.zeros(right.size - left.size)])
        found = np.roots(left + right)
        return np.asarray(found[np.argsort(-np.abs(found))], dtype=np.complex128)


def direct_placement(motor: Motor, pole: float, period: float, delay_samples: int) -> DiscreteInnerLoop:
    """Return the PID that has three closed-loop poles at ``z₀ = exp(-p Ts)``, its delay in the equation.

    The PID has three feedback gains and one filter pole r; with d samples of delay 1 + d poles are left over.
    r is chosen so that the slowest of them is as fast as it can be. Both zeros of Cm1 lie at z₀.

    Parameters
    ----------
    motor
        A and B.
    pole
        p [rad/s], > 0 and below π/Ts.
    period
        Ts [s], > 0.
    delay_samples
        d, 0 … 8.

    Raises
    ------
    FieldError
        no filter pole leaves the loop stable: the pole is too fast for this delay.
    """
    grid = np.linspace(-_FASTEST_FILTER, _FASTEST_FILTER, 61)
    radii = [_left_over(motor, pole, period, delay_samples, float(r))[1] for r in grid]
    best = int(np.argmin(radii))
    fine = np.linspace(grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)], 41)
    radii = [_left_over(motor, pole, period, delay_samples, float(r))[1] for r in fine]
    r = float(fine[int(np.argmin(radii))])
    feedback, radius = _left_over(motor, pole, period, delay_samples, r)
    if radius >= 1.0:
        raise FieldError(
            "inner.pole",
            pole,
            "not to be placed with this delay",
            allowed="a slower motor loop",
            remedy=f"with {delay_samples} samples of {period:g} s an unstable pole is left over",
        )
    return _parallel(feedback, r, math.exp(-pole * period), period)


# Beyond it the filter rings at the Nyquist frequency for longer than the loop itself takes to settle.
_FASTEST_FILTER = 0.8


def _left_over(motor: Motor, pole: float, period: float, delay: int, r: float) -> tuple[Real, float]:
    """(S, modulus of the slowest left-over pole) for one filter pole: a linear system in S and f(x)."""
    m1, m2, e = held_motor(motor, period)
    base, target = np.array([1.0]), np.array([1.0])
    for place in (1.0, 1.0, e, r):
        base = np.convolve(base, [1.0, -place])
    for _ in range(3):
        target = np.convolve(target, [1.0, -math.exp(-pole * period)])
    size = 4 + delay
    matrix, right = np.zeros((size + 1, size)), np.zeros(size + 1)
    for k in range(3):  # s0, s1, s2
        matrix[1 + delay + k : 3 + delay + k, k] = m1, m2
    for k in range(1, delay + 2):  # f1 … f(1+d)
        matrix[k : k + 4, 2 + k] = -target
    right[:4] += target
    right[:5] -= base
    solution = np.linalg.solve(matrix[1:], right[1:])
    left_over = np.roots(np.concatenate([[1.0], solution[3:]]))
    return np.asarray(solution[:3], dtype=float), float(np.max(np.abs(left_over)))


def _parallel(s: Real, r: float, z0: float, period: float) -> DiscreteInnerLoop:
    """S(x) split into Cm1 with a double zero at z₀ and Cm2, as the two one-pole filters of law.c."""
    half = 0.5 * period
    rate = (1.0 - r) / (half * (1.0 + r))  # c of 1/(s + c) under Tustin
    scale = half / (1.0 + rate * half)
    first = float(np.sum(s)) * np.array([1.0, -2.0 * z0, z0**2]) / (1.0 - z0) ** 2
    rest = s - first  # divisible by (1 - x): both have the same value at x = 1
    t0, t1 = float(rest[0]), float(-rest[2])
    # first = D(1-x)(1-r x) + I half (1+x)(1-r x) + F scale (1+x)(1-x)
    basis = np.array(
        [
            [1.0, half, scale],
            [-(1.0 + r), half * (1.0 - r), 0.0],
            [r, -half * r, -scale],
        ]
    )
    direct, integral, filtered = np.linalg.solve(basis, first)
    angle_direct = (t0 - t1) / (1.0 + r)
    return DiscreteInnerLoop(
        period=period,
        direct=float(direct),
        angle_direct=angle_direct,
        integral_gain=float(integral),
        filter_gain=float(filtered),
        angle_filter_gain=(t0 - angle_direct) / scale,
        integral_now=half,
        integral_before=half,
        filter_now=scale,
        filter_before=scale,
        filter_decay=r,
    )


def sampled_inner(rig: Rig, pole: float, delay_samples: int, *, placement: str = "tustin") -> SampledInner:
    """Return the sampled inner loop of a rig: "tustin" discretises (19), (20); "direct" places poles in z."""
    return _inner_of(rig.motor, pole, rig.period, delay_samples, placement)


def _inner_of(motor: Motor, pole: float, period: float, delay_samples: int, placement: str) -> SampledInner:
    if placement == "direct":
        loop = direct_placement(motor, pole, period, delay_samples)
    else:
        loop = inner_loop(motor, pole).discretize(period)
    return SampledInner(loop, motor, delay_samples)


@dataclass(frozen=True)
class InnerCost:
    """What one way of discretising the inner loop costs."""

    placement: str
    radius: float  # largest |z| of the closed motor loop; below 1 it is stable
    modulus_margin: float  # min |1 + L_inner|
    lag: float  # [rad] that θm/θm* lags behind M(s) with hold and delay, at `frequency`
    frequency: float  # [rad/s]
    voltage_per_step: float  # [V/rad] first voltage after a unit step of θm*
    voltage_per_noise: float  # [V/rad] largest gain from the encoder's noise to the voltage


def inner_costs(rig: Rig, *, frequency: float) -> tuple[InnerCost, ...]:
    """Return what "tustin" and "direct" cost at the rig's pole, delay and period, at `frequency` [rad/s].

    >>> from fraclink._arm.rig import Rig
    >>> [cost.placement for cost in inner_costs(Rig.named("paper-2023"), frequency=18.0)]
    ['tustin', 'direct']
    """
    found = []
    pole, samples, period = rig.inner.pole, rig.inner.delay_samples, rig.period
    grid = np.geomspace(1e-2, math.pi / period, 2000)
    for placement in ("tustin", "direct"):
        try:
            inner = sampled_inner(rig, pole, samples, placement=placement)
        except FieldError:
            continue
        first = inner.controllers(np.zeros(1, dtype=np.complex128))[0]
        found.append(
            InnerCost(
                placement=placement,
                radius=float(np.max(np.abs(inner.poles()))),
                modulus_margin=float(np.min(np.abs(1.0 + inner.loop_gain(grid)))),
                lag=float(-np.angle(inner_ratio(inner, rig, np.array([frequency])))[0]),
                frequency=frequency,
                voltage_per_step=float(first.real[0]),
                voltage_per_noise=float(np.max(np.abs(_noise_gain(inner, grid)))),
            )
        )
    return tuple(found)


def _noise_gain(inner: SampledInner, frequency: Real) -> Complex:
    first, second = inner.controllers(np.exp(-1j * frequency * inner.loop.period))
    return np.asarray((first + second) / (1.0 + inner.loop_gain(frequency)))


@lru_cache(maxsize=16)
def inner_correction(
    motor: Motor, pole: float, period: float, delay_samples: int, placement: str
) -> Callable[[Real], Complex]:
    """Return ``ω -> ln(sampled loop / stand-in)``; the same few motor loops are asked for over and over."""
    inner = _inner_of(motor, pole, period, delay_samples, placement)
    return lambda w: np.log(_ratio(inner, pole, w))


def inner_ratio(inner: SampledInner, rig: Rig, frequency: Real) -> Complex:
    """What the sampled loop makes of M(s)·e^{-(d+1/2)Ts s}: hold, PID and motor over that stand-in.

    The aliases are left out: at half the Nyquist frequency they are 1e-4 of it, at the crossing 1e-9.
    """
    return _ratio(inner, rig.inner.pole, frequency)


def _ratio(inner: SampledInner, pole: float, frequency: Real) -> Complex:
    w = np.asarray(frequency, dtype=float)
    s, period = 1j * w, inner.loop.period
    hold = -np.expm1(-s * period) / (s * period)
    motor = inner.motor.gain / (s * (s + inner.motor.decay))
    ideal = np.exp(-(inner.delay_samples + 0.5) * period * s) / (1.0 + s / pole) ** 2
    return np.asarray(inner.voltage(w) * hold * motor / ideal)
