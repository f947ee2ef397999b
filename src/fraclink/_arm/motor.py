"""The motor and the PID that closes its loop, by pole placement.

The motor at the gear's output is θm/u' = A/(s(s + B)) (1). Two controllers with a
common filter pole close it, u' = Cm1(s)(θm* − θm) − Cm2(s) θm with Cm1 = (a2 s² + a1 s +
a0)/(s(s + c)) (19), Cm2 = (b1 s + b0)/(s + c) (20), so that θm/θm* = M(s) = 1/(1 +
s/p)² (21). Source: Benftima et al. 2023; the printed c of (19) is the filter's pole,
not the link's stiffness, and the values below are recomputed from A, B and p.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from fraclink._arm.rig_parts import Motor
from fraclink.errors import FieldError
from fracsys._fractional import FractionalTransferFunction
from fracsys._terms import Term
from fracsys.checks import Period, checked

__all__ = [
    "ContinuousPid",
    "DiscretePid",
    "MotorConstants",
    "MotorGain",
    "held_motor",
    "place_pid",
]


@dataclass(frozen=True)
class MotorGain:
    """A = K/J [rad/(s²·V)] and B = ν/J [1/s] of a motor, both at the gear's output."""

    gain: float
    decay: float


MotorConstants = Motor | MotorGain


@dataclass(frozen=True)
class DiscretePid:
    """The PID of the motor loop at its period: two one-pole filters in parallel, as
    law.c computes them.

    With ε = θm* − θm the control is

        u' = a2 ε − b1 θm + H1(z) (a0/c) ε + H2(z) (ρ1 ε − ρ2 θm),
        H(z) = (now + before z⁻¹)/(1 − decay z⁻¹),

    where H1 represents 1/s and H2 represents 1/(s + c).

    >>> from types import SimpleNamespace
    >>> loop = place_pid(SimpleNamespace(gain=3056.7686, decay=15.152838), 80.0).discretize(0.004)
    >>> round(loop.filter_decay, 6)
    0.242472
    """

    period: float
    direct: float  # a2: ε -> u' [V/rad]
    angle_direct: float  # b1: θm -> −u' [V/rad]
    integral_gain: float  # a0/c [V/(rad·s)]
    filter_gain: float  # ρ1, residue of Cm1 at −c [V/(rad·s)]
    angle_filter_gain: float  # ρ2, residue of Cm2 at −c [V/(rad·s)]
    integral_now: float  # [s]
    integral_before: float
    filter_now: float  # [s]
    filter_before: float
    filter_decay: float

    @property
    def stiffness(self) -> float:
        """Voltage per constant angle error, before the integral acts [V/rad]."""
        filtered = (
            self.filter_gain
            * (self.filter_now + self.filter_before)
            / (1 - self.filter_decay)
        )
        return self.direct + filtered


@dataclass(frozen=True)
class ContinuousPid:
    """Coefficients of the PID (19), (20) that closes the motor loop, for one pole p
    [rad/s].

    Every closed-loop pole and both zeros lie at −p, so the loop is M(s) = 1/(1 + s/p)²
    exactly (21).

    >>> from fraclink._arm.rig import Rig
    >>> loop = place_pid(Rig.named("paper-2023").motor, 80.0)
    >>> round(abs(loop.closed()(80.0j)), 3)
    0.5
    """

    pole: float
    gain: float  # A = K/J [rad/(s²·V)]
    decay: float  # B = ν/J [1/s]
    a0: float
    a1: float
    a2: float
    b0: float
    b1: float
    filter_pole: float  # c of (19), (20) [rad/s]

    def closed(self) -> FractionalTransferFunction:
        """Return M(s) = θm/θm* = 1/(1 + s/p)² (21)."""
        p = self.pole
        return FractionalTransferFunction(
            (Term(1.0, 0.0),),
            (Term(1.0 / p**2, 2.0), Term(2.0 / p, 1.0), Term(1.0, 0.0)),
        )

    @checked
    def discretize(self, period: Period) -> DiscretePid:
        """Return the loop at `period` [s] > 0 by Tustin's rule.

        A backward difference or a zero-order hold would shift the PID's phase: at 4 ms
        with one sample of delay and p = 80, the loop is unstable with either.
        """
        c, half = self.filter_pole, 0.5 * period
        filtered = half / (1 + c * half)
        return DiscretePid(
            period=period,
            direct=self.a2,
            angle_direct=self.b1,
            integral_gain=self.a0 / c,
            # Partial fractions of (a2 s² + a1 s + a0)/(s(s + c)) and of b1 + ρ2/(s +
            # c).
            filter_gain=self.a1 - self.a2 * c - self.a0 / c,
            angle_filter_gain=self.b0 - self.b1 * c,
            integral_now=half,
            integral_before=half,
            filter_now=filtered,
            filter_before=filtered,
            filter_decay=(1 - c * half) / (1 + c * half),
        )


def place_pid(motor: MotorConstants, pole: float = 80.0) -> ContinuousPid:
    """Place all poles of the motor loop at −`pole` [rad/s] (19)–(21).

    a0 = p⁴/A, a1 = b0 = 2p³/A, a2 = p²/A, b1 = (5p² − 4pB + B²)/A, filter pole 4p − B.

    Parameters
    ----------
    motor
        gain A [rad/(s²·V)] > 0 and decay B [1/s] ≥ 0.
    pole
        [rad/s], > B/4, so that the filter is stable.

    Raises
    ------
    FieldError
        a value out of its range.

    Source: Benftima et al. (2023), equations (19) to (21), corrected.

    >>> from types import SimpleNamespace
    >>> loop = place_pid(SimpleNamespace(gain=0.21 / 6.87e-5, decay=1.041e-3 / 6.87e-5), 80.0)
    >>> f"{loop.a0:.3f} {loop.a1:.5f} {loop.a2:.7f} {loop.b1:.7f} {loop.filter_pole:.5f}"
    '13399.771 334.99429 2.0937143 8.9574005 304.84716'
    """
    gain, decay = float(motor.gain), float(motor.decay)
    if not (math.isfinite(gain) and gain > 0):
        raise FieldError(
            "motor.gain",
            gain,
            "not positive",
            "> 0 rad/(s²·V)",
            "check K and J of the rig",
        )
    # The four closed-loop poles at −p have the same sum as those of the open loop: the
    # motor's B and the filter's c.
    if not (math.isfinite(pole) and pole > decay / 4):
        raise FieldError(
            "motor_loop.pole",
            pole,
            "too slow for this motor",
            f"> B/4 = {decay / 4:.4g} rad/s",
            "ask for a faster motor loop; its filter pole 4p − B must be positive",
        )
    p = float(pole)
    return ContinuousPid(
        pole=p,
        gain=gain,
        decay=decay,
        # Six unknowns including c: the four coefficients of (s + p)⁴ and the two zeros
        # of Cm1 at −p determine them.
        a0=p**4 / gain,
        a1=2 * p**3 / gain,
        a2=p**2 / gain,
        b0=2 * p**3 / gain,
        b1=(5 * p**2 - 4 * p * decay + decay**2) / gain,
        filter_pole=4 * p - decay,
    )


def held_motor(motor: MotorConstants, period: float) -> tuple[float, float, float]:
    """Return (m1, m2, e) of ``A/(s(s+B))`` under a zero-order hold: ``x(m1 + m2
    x)/((1-x)(1-e x))``.

    >>> from fraclink._arm.rig import Rig
    >>> m1, m2, e = held_motor(Rig.named("paper-2023").motor, 0.004)
    >>> print(f"{m1:.6f} {m2:.6f} {e:.6f}")
    0.023967 0.023488 0.941189
    """
    gain, decay = motor.gain, motor.decay
    e = math.exp(-decay * period)
    # T − (1 − e^(−BT))/B is BT²/2: at BT = 1e-8 the subtraction has lost eight digits,
    # while neglecting B costs 1e-8. This also covers motors without friction.
    if decay * period < 1e-8:
        return 0.5 * gain * period**2, 0.5 * gain * period**2, e
    weight = -math.expm1(-decay * period) / decay
    return gain * (period - weight) / decay, gain * (weight - period * e) / decay, e
