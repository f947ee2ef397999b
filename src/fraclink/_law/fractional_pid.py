"""A fractional PID as a law of law.c: the motor loop's PI after the outer law's filter.

law.c computes θm* = θt* + Ĉ(z) (θt* − θte) and u = P(z) (θm* − θm). A law without a
gauge has θte = θm, so that u = P(z) (1 + Ĉ(z)) (θt* − θm): with the measurement y in
place of θm and the reference r in place of θt* this is a controller of the error r − y.
P = k_P + k_I T (z + 1)/(2 (z − 1)) provides the integral action, exactly and with the
anti-windup of law.c. The rest of C is 1 + Ĉ = C/P, which is 1 at ω = 0: s^(−λ) becomes
s^(−1) s^(1−λ), and the second factor is a filter like that of every other law.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from fraclink._arm.fractional_pid import FractionalPid
from fraclink._arm.motor import DiscretePid
from fraclink._law.block import (
    PAIR_MODES,
    REAL_MODES,
    DiscreteMotorLoop,
    Modes,
    MotorModel,
    Precision,
    correction_values,
    mode_norms,
)
from fraclink._law.discretization import correction_fits, modes_from
from fraclink._law.law import Law
from fraclink._law.limits import Limits
from fraclink.errors import FieldError
from fracsys._discrete import Band, Order, checked_band
from fracsys.checks import Complex, Positive, Real, above, checked

__all__ = ["discretize_pid", "pid_response"]


# Below ω_b/3, where ω_b is the lower end of the band, the integral is an integer one
# with k_I = k_i (ω_b/3)^(1−λ). The phase turns by 90° (1 − λ) where the two meet; the
# factor of 3 keeps this out of the band itself.
JOINT = 3.0
# length of the default band: 8 states represent s^(1−λ) over this many decades within
# the tolerance
DECADES = 4.0
Range = Annotated[float, above(0.0, 1e6)]


@checked
def discretize_pid(
    controller: FractionalPid,
    period: Positive,
    *,
    output_limit: Range,
    measurement_limit: Range,
    order: Order | None = None,
    precision: Precision = "single",
    band: Band | None = None,
) -> Law:
    """Return the law that runs a fractional PID at `period` [s]: u = C(z) (r − y),
    computed by law.c like any other law.

    On `band` C(z) meets C(jω) to 0.1 dB and 0.5° where 8 states can
    (`Law.correction_error` is the error reached); below it k_i/s^λ turns into an
    integer integral, so that a lasting error is always removed. u is limited to
    ±`output_limit`, and the integral does not wind up there.

    On the board the measurement is `law_input.motor_angle`, the reference
    `law_input.reference`, and u `law_output.voltage`; `torque`, `payload` and
    `reference_acceleration` stay 0. u follows from the samples of the same period,
    and takes effect when the board writes it.

    Parameters
    ----------
    output_limit
        largest |u|, in the output's unit.
    measurement_limit
        largest credible |r| and |y|: samples beyond it are rejected, and five in a row
        switch the output off.
    order
        states of 1 + Ĉ, 0 to 8; without it the fewest that meet the tolerance, else the
        best of 8.
    precision
        "single" or "double".
    band
        [rad/s]; four decades up to half of the Nyquist frequency when it is left out.

    Raises
    ------
    FieldError
        a value out of its range, and a controller that has neither a proportional nor
        an integral part.

    Examples
    --------
    >>> import fraclink as fl
    >>> pid = fl.extend.FractionalPid(2.0, integral=3.0, integral_order=0.5)
    >>> law = fl.extend.discretize_pid(pid, 0.01, output_limit=10.0, measurement_limit=2.0)
    >>> law.correction_error[0] < 0.1, law.correction_error[1] < 0.5
    (True, True)
    """
    reach = _band(period) if band is None else checked_band(band, period)
    base = _integer_part(controller, period, reach)

    # A proportional controller is P itself: there is nothing to fit, and a relative
    # error of 0 is undefined.
    correction, errors = Modes(0.0), (0.0, 0.0)
    if controller.integral or controller.derivative:
        correction, errors = _fitted(controller, base, period, reach, order)
    # No friction and no coupling torque, since the plant is not a motor. The speed of 1
    # only avoids a division by zero.
    motor_loop = DiscreteMotorLoop(
        base, output_limit, torque_voltage=0.0, coulomb_voltage=0.0, coulomb_speed=1.0
    )
    return Law(
        period=period,
        precision=precision,
        # A compliance 1/c of zero removes the torque from the tip estimate: θte = θm,
        # the measurement.
        stiffness=math.inf,
        correction=correction,
        feedforward=Modes(0.0),
        motor_loop_pole=0.0,
        motor_model=MotorModel(0.0, 0.0, 0.0),  # no motor: its model stands still
        limits=_limits(correction, measurement_limit),
        motor_loop=motor_loop,
        correction_error=errors,
        feedforward_error=(0.0, 0.0),
        band=reach,
    )


def _fitted(
    controller: FractionalPid,
    base: DiscretePid,
    period: float,
    band: tuple[float, float],
    order: int | None,
) -> tuple[Modes, tuple[float, float]]:
    """Ĉ = C/P − 1 as modes, and its largest error on the band [dB], [°]."""

    def rest(frequency: Real) -> Complex:
        return controller.response(frequency) / _response(base, frequency) - 1.0

    # 1 + Ĉ = C/P is 1 at ω = 0 only if P has the entire integral of C: Ĉ has a zero at z
    # = 1, and a lasting error only reaches the integer integral.
    fit = correction_fits(rest, period=period, band=band).fit(order)
    return modes_from("order", fit, REAL_MODES, PAIR_MODES), (
        fit.error_db,
        fit.error_deg,
    )


def pid_response(law: Law, frequency: ArrayLike) -> Complex:
    """Return C(e^(jωT)) of a law that `discretize_pid` made, at ω [rad/s]; any shape."""
    if law.motor_loop is None or law.has_gauge:
        raise FieldError(
            "law",
            repr(law),
            "not the law of a PID",
            "the law of a FractionalPid",
            "discretize_pid makes one; Law.frequency_response serves every other law",
        )
    return _response(law.motor_loop.pid, frequency) * (
        1.0 + law.frequency_response(frequency)
    )


def _band(period: float) -> tuple[float, float]:
    high = 0.5 * math.pi / period
    return high / 10.0**DECADES, high


def _integer_part(
    controller: FractionalPid, period: float, band: tuple[float, float]
) -> DiscretePid:
    """P(z): k_P, and the integral that continues k_i/s^λ below the band."""
    joint = band[0] / JOINT
    # k_i/s^λ and k_I/s have the same magnitude at the joint: |k_i ω^(−λ)| = k_I/ω.
    integral = controller.integral * joint ** (1.0 - controller.integral_order)
    if not (controller.proportional or integral):
        raise FieldError(
            "proportional",
            0.0,
            "zero in a controller without an integral: at rest it would do nothing",
            "> 0",
            "give a proportional or an integral gain",
        )
    return DiscretePid(
        period=period,
        direct=controller.proportional,
        angle_direct=0.0,
        integral_gain=integral,
        filter_gain=0.0,
        angle_filter_gain=0.0,
        integral_now=0.5 * period,
        integral_before=0.5 * period,
        filter_now=0.0,
        filter_before=0.0,
        filter_decay=0.0,
    )


def _response(loop: DiscretePid, frequency: ArrayLike) -> Complex:
    """P(e^(jωT)): Tustin's integral is T/(2j tan(ωT/2))."""
    w = np.asarray(frequency, float)
    integral = 0.5 * loop.period / (1j * np.tan(0.5 * w * loop.period))
    return loop.direct + loop.integral_gain * integral


def _limits(correction: Modes, reach: float) -> Limits:
    """The guards of a loop of which only the range of the measurement is known.

    |r| and |y| are at most Y = `reach`, errors at most 2Y. The limits follow from the l1
    norms of the parts of the filter, so that no such error is limited. The guards that compare a motor with its
    model (residual, frozen encoder) can never act, and a torque, which a loop without a
    gauge does not have, is rejected without any effect on the output.
    """
    # r and y of opposite signs differ by 2Y; one per cent is added so that rounding in
    # single precision trips nothing.
    error = 2.0 * reach * 1.01
    largest, gain = mode_norms(correction_values(correction))
    command = gain * error
    motor = reach + command
    return Limits(
        sum_limit=command,
        correction_limit=2.0 * largest * error,
        forward_limit=1.0,
        angle_limit=reach,
        angle_step=2.0 * error,
        torque_limit=0.0,
        torque_step=0.0,
        torque_trip=1.0,
        torque_block=1.0,
        reference_step=2.0 * error,
        reference_rate=1.0,
        acceleration_limit=0.0,
        payload_limit=0.0,
        scale_step=1.0,
        motor_limit=motor,
        motor_step=2.0 * motor,
        fade_step=0.0,
        residual_angle=2.0 * motor,
        frozen_angle=2.0 * motor,
        swing_angle=2.0 * motor,
        stuck_torque=1.0,
        wiring_energy=1.0,
    )
