"""The motor loop as seen by the outer controller: ideal, or the sampled PID on its
motor.

At the period Ts, with x = z⁻¹, e = exp(-B Ts) and d samples of delay, the motor under
its held voltage is ``P(x) = x^{1+d}(m1 + m2 x)/((1-x)(1-e x))``. The placement "tustin"
discretises (19), (20); "direct" solves ``(1-x)²(1-e x)(1-r x) + x^{1+d}(m1 + m2 x) S(x)
= (1-z₀x)³ f(x)`` for the PID itself, z₀ = exp(-p Ts): the placement then takes the
delay into account instead of losing margin to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from fraclink._arm.motor import (
    DiscretePid,
    MotorConstants,
    MotorGain,
    held_motor,
    place_pid,
)
from fraclink.errors import FieldError
from fracsys.checks import Between, Complex, Frequency, Real, checked

__all__ = [
    "MotorGain",
    "MotorLoop",
    "SampledMotorLoop",
    "direct_placement",
]


# With r closer to -1, the filter would ring at the Nyquist frequency for longer than the
# loop takes to settle.
_FILTER_POLE_LIMIT = 0.8


@checked
@dataclass(frozen=True)
class MotorLoop:
    """The motor loop as the outer controller sees it: its pole, its delay, and how it
    is realised.

    Parameters
    ----------
    pole
        double pole at -p [rad/s], p > 0: ``M(s) = 1/(1 + s/p)²`` (eq. (21)).
    delay_samples
        computation delay in whole control periods, 0 … 100.
    kind
        "ideal" (M(s) as it is written) or "sampled" (the 2-DOF PID at the control
        period, on the motor).
    placement
        for ``kind="sampled"``: "tustin" discretises the continuous PID, "direct" places
        the poles in z.

    Raises
    ------
    FieldError
        a value out of its range.

    Examples
    --------
    >>> from fraclink._arm.rig import Rig
    >>> loop = MotorLoop(pole=80.0, kind="sampled").sampled(Rig.named("paper-2023").motor, 0.004)
    >>> round(float(abs(loop.poles()[0])), 3)
    0.951
    """

    pole: Frequency = 80.0
    # A motor loop with a longer delay is useless for an arm.
    delay_samples: Annotated[int, Between(0, 100, "samples")] = 1
    # Assumptions of a design, not properties of a rig.
    kind: Literal["ideal", "sampled"] = field(
        default="ideal", metadata={"stated": False}
    )
    placement: Literal["tustin", "direct"] = field(
        default="tustin", metadata={"stated": False}
    )

    def pid(self, motor: MotorConstants, period: float) -> DiscretePid:
        """Return the PID that law.c runs at `period` [s] for this pole and placement."""
        if self.placement == "direct":
            return direct_placement(motor, self.pole, period, self.delay_samples)
        return place_pid(motor, self.pole).discretize(period)

    def sampled(
        self, motor: MotorConstants, period: float, *, ratio: float = 1.0
    ) -> SampledMotorLoop:
        """Return the loop, with its computation delay, of a motor with `ratio` times the
        gain of `motor` under the PID that was placed for `motor`.
        """
        true = MotorGain(motor.gain * ratio, motor.decay)
        return SampledMotorLoop(self.pid(motor, period), true, self.delay_samples)

    def correction(
        self, motor: MotorConstants, period: float, *, ratio: float = 1.0
    ) -> Callable[[Real], Complex] | None:
        """Return ω ↦ ln(sampled motor loop and hold / their stand-in), None for the
        ideal motor loop.

        The stand-in is ``M(s) e^{-(d+1/2)Ts s}``; see `SampledMotorLoop.ratio` and, for
        `ratio`, `sampled`.
        """
        return (
            _correction(self, motor, period, ratio) if self.kind == "sampled" else None
        )


@lru_cache(maxsize=16)  # the same few motor loops recur
def _correction(
    settings: MotorLoop, motor: MotorConstants, period: float, ratio: float
) -> Callable[[Real], Complex]:
    loop = settings.sampled(motor, period, ratio=ratio)
    # the ratio is close to one, where log1p is several times as fast
    return lambda w: np.log1p(loop.ratio(settings.pole, w) - 1.0)


@dataclass(frozen=True)
class SampledMotorLoop:
    """The sampled PID with its motor.

    ``pid`` holds the coefficients that law.c runs; `delay_samples` whole periods pass
    between reading the encoder and the new voltage.
    """

    pid: DiscretePid
    motor: MotorConstants
    delay_samples: int

    def controllers(self, x: Complex) -> tuple[Complex, Complex]:
        """(Cm1, Cm2) at x = z⁻¹."""
        k = self.pid
        integral = (k.integral_now + k.integral_before * x) / (1.0 - x)
        filtered = (k.filter_now + k.filter_before * x) / (1.0 - k.filter_decay * x)
        first = k.direct + k.integral_gain * integral + k.filter_gain * filtered
        return first, k.angle_direct + k.angle_filter_gain * filtered

    def plant(self, x: Complex) -> Complex:
        """The held motor without its computation delay, at x = z⁻¹."""
        m1, m2, e = held_motor(self.motor, self.pid.period)
        return x * (m1 + m2 * x) / ((1.0 - x) * (1.0 - e * x))

    def loop_gain(self, frequency: ArrayLike) -> Complex:
        """Open loop of the motor loop, ``(Cm1 + Cm2) z^{-d} P`` at `frequency` [rad/s]."""
        x = np.exp(-1j * np.asarray(frequency) * self.pid.period)
        first, second = self.controllers(x)
        return (first + second) * x**self.delay_samples * self.plant(x)

    def voltage(self, frequency: ArrayLike) -> Complex:
        """Transfer from θm* to the applied voltage, ``z^{-d} Cm1/(1 + (Cm1 + Cm2)
        z^{-d} P)``, at ω [rad/s].
        """
        x = np.exp(-1j * np.asarray(frequency) * self.pid.period)
        return x**self.delay_samples * self._undelayed(x)

    def _undelayed(self, x: Complex) -> Complex:
        """`voltage` without the computation delay before it, at x = z⁻¹."""
        first, second = self.controllers(x)
        loop = (first + second) * x**self.delay_samples * self.plant(x)
        return first / (1.0 + loop)

    def poles(self) -> Complex:
        """Poles of the closed motor loop in z, largest modulus first."""
        k = self.pid
        m1, m2, e = held_motor(self.motor, k.period)
        # Polynomials in δ = z − 1: at a short period four poles meet near z = 1, where
        # powers of z do not resolve them.
        delta, motor = Polynomial([0.0, 1.0]), Polynomial([1.0 - e, 1.0])
        lag = Polynomial([1.0 - k.filter_decay, 1.0])
        integral = Polynomial([k.integral_now + k.integral_before, k.integral_now])
        filtered = Polynomial([k.filter_now + k.filter_before, k.filter_now])
        controller = (
            (k.direct + k.angle_direct) * delta * lag
            + k.integral_gain * integral * lag
            + (k.filter_gain + k.angle_filter_gain) * filtered * delta
        )
        late = Polynomial([1.0, 1.0]) ** self.delay_samples
        closed = late * delta**2 * motor * lag + Polynomial([m1 + m2, m1]) * controller
        poles = 1.0 + np.asarray(closed.roots(), np.complex128)
        return poles[np.argsort(-np.abs(poles))]

    def ratio(self, pole: float, frequency: ArrayLike) -> Complex:
        """Return the ratio of hold, PID and motor to the approximation
        ``M(s)·e^{-(d+1/2)Ts s}``, at ω [rad/s].

        Aliases are omitted: with the paper's motor at 4 ms they are 3 % of it at half
        the Nyquist frequency, and 1e-7 at the crossover.
        """
        w = np.asarray(frequency)
        s, period = 1j * w, self.pid.period
        # both delay by d periods, and (1 − e^(−sT))/(sT) is a sinc and half a period
        hold = np.sinc(0.5 * period / math.pi * w)
        motor = self.motor.gain * (1.0 + s / pole) ** 2 / (s * (s + self.motor.decay))
        return self._undelayed(np.exp(-period * s)) * hold * motor


@lru_cache(maxsize=16)  # the same one for every arm of a box
def direct_placement(
    motor: MotorConstants, pole: float, period: float, delay_samples: int
) -> DiscretePid:
    """Return the PID with three closed-loop poles at ``z₀ = exp(-p Ts)``, with the
    delay in the equation.

    The PID has three feedback gains and one filter pole r; with d samples of delay, 1 +
    d poles remain. r is chosen such that the slowest of them is as fast as possible.
    Both zeros of Cm1 lie at z₀.

    Parameters
    ----------
    motor
        A and B.
    pole
        p [rad/s], > 0 and below π/Ts.
    period
        Ts [s], > 0.
    delay_samples
        d, 0 … 100.

    Raises
    ------
    FieldError
        no filter pole leaves the loop stable: the pole is too fast for this delay.
    """
    # The largest modulus has a kink wherever two remaining poles meet, so derivatives
    # do not help. Two grids determine r to 1e-3.
    grid = np.linspace(-_FILTER_POLE_LIMIT, _FILTER_POLE_LIMIT, 61)
    radii = [_left_over(motor, pole, period, delay_samples, float(r))[1] for r in grid]
    best = int(np.argmin(radii))
    fine = np.linspace(grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)], 41)
    radii = [_left_over(motor, pole, period, delay_samples, float(r))[1] for r in fine]
    r = float(fine[int(np.argmin(radii))])
    feedback, radius = _left_over(motor, pole, period, delay_samples, r)
    if radius >= 1.0:
        raise FieldError(
            "motor_loop.pole",
            pole,
            "too fast for this delay",
            "a slower motor loop",
            f"with a delay of {delay_samples} × {period:g} s an unstable pole is left over",
        )
    return _parallel(feedback, r, math.exp(-pole * period), period)


def _left_over(
    motor: MotorConstants, pole: float, period: float, delay: int, r: float
) -> tuple[Real, float]:
    """(S, modulus of the slowest remaining pole) for one filter pole: a linear system
    in S and f(x).
    """
    m1, m2, e = held_motor(motor, period)
    base, target = np.array([1.0]), np.array([1.0])
    # Open loop: the motor's poles 1 and e, the integrator's 1 and the filter's r, all
    # as factors 1 − p x.
    for place in (1.0, 1.0, e, r):
        base = np.convolve(base, [1.0, -place])
    # Diophantine equation base + x^(1+d) (m1 + m2 x) S(x) = (1 − z₀x)³ f(x) in S and f
    # = 1 + f1 x + ...: it has as many unknowns as powers of x, so z₀ is met exactly,
    # and f holds the remaining poles.
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
    # The equation of the power 0 reads 1 = 1 and is left out.
    solution = np.linalg.solve(matrix[1:], right[1:])
    left_over = np.roots(np.concatenate([[1.0], solution[3:]]))
    return np.asarray(solution[:3], float), float(np.max(np.abs(left_over)))


def _parallel(s: Real, r: float, z0: float, period: float) -> DiscretePid:
    """S(x) split into Cm1, with a double zero at z₀, and Cm2, in the form of the two
    one-pole filters of law.c.
    """
    half = 0.5 * period
    rate = (1.0 - r) / (half * (1.0 + r))  # c of 1/(s + c) under Tustin
    scale = half / (1.0 + rate * half)
    # Both zeros of Cm1 at z₀ cancel two of the three poles; only one remains in the
    # response to the reference.
    first = float(np.sum(s)) * np.array([1.0, -2.0 * z0, z0**2]) / (1.0 - z0) ** 2
    rest = s - first  # divisible by (1 - x), since both have the same value at x = 1
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
    return DiscretePid(
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
