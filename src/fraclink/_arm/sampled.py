"""The sampled plant of the loop: the zero-order-hold plant, including the alias sum.

Between two ticks the motor reference is held, so the computer sees ``P_d(e^{jωTs}) =
z^{-d} (1 - z^{-1})/Ts · Σ_k F(s_k)/s_k``, ``s_k = j(ω + kω_s)``, ``F = M·B``: the exact
zero-order-hold discretisation, without a state-space model of an irrational plant. B is
the bracket of `fraclink._arm.loop`, with gauge delay, gauge gain and second mode;
delays need not be whole samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fraclink._arm.link import LinkModel
from fraclink._arm.motor import MotorConstants
from fraclink._arm.motor_loop import MotorLoop
from fracsys.checks import Complex, Real

__all__ = ["SampledPlant", "sampled_plant"]


# Aliases on either side: F/s falls at least like s^-3, and 1e-9 of the sum is left out,
# or with a late or wrong gauge 1e-6 near the Nyquist frequency.
_ALIASES = 60


@dataclass(frozen=True)
class SampledPlant:
    """``P_d``: hold, computation delay, motor loop and link, sampled at `period` [s].

    ``response(s)`` is F(s), vectorised over complex s. ``delay`` [s] need not be a whole
    number of samples. ``before`` is the part before the hold, a function of ω.
    """

    response: Callable[[Complex], Complex]
    period: float
    delay: float
    before: Callable[[Real], Complex] | None = None

    def __call__(self, frequency: ArrayLike, aliases: int = _ALIASES) -> Complex:
        """Return P_d at `frequency` [rad/s], 0 < ω <= π/Ts, in the shape of
        `frequency`.

        With ``aliases=1``, for coarse tables, the error is of the order of 1e-2 at the
        Nyquist frequency and 1e-5 at a tenth of it, with 3 terms instead of 121.
        """
        w = np.asarray(frequency, float)
        rate = math.tau / self.period
        s = 1j * (w[..., None] + rate * np.arange(-aliases, aliases + 1))
        # 1/s comes from the integral of the hold; its factor 1 − e^(−sT) is the same
        # for every alias and is factored out of the sum.
        total = np.sum(
            self.response(s) / s * (np.exp(-self.delay * s) if self.delay else 1.0),
            axis=-1,
        )
        # The factor 1 − z⁻¹ of the hold by expm1: at low frequencies the alias sum is
        # large and this factor small.
        response = -np.expm1(-1j * self.period * w) / self.period * total
        return response if self.before is None else response * self.before(w)


def sampled_plant(
    model: LinkModel,
    motor_loop: MotorLoop,
    motor: MotorConstants,
    period: float,
    *,
    ratio: float = 1.0,
    higher: Callable[[Complex], Complex] | None = None,
) -> SampledPlant:
    """Return the exactly sampled plant of the law, from motor reference to tip
    estimate.

    Parameters
    ----------
    model
        link and gauge, with ω₀ at its payload.
    motor_loop
        pole and computation delay; "sampled" puts the PID on the `motor` in place of
        M(s).
    motor
        A and B of the motor for which the PID is designed.
    period
        control period [s], > 0.
    ratio
        of true to stated motor gain or, if the motor loop is ideal, of the loop's pole,
        which varies in the same direction.
    higher
        part of Γ/(c θm) outside the model, such as the higher modes of a beam, at
        complex s.
    """
    sampled = None
    if motor_loop.kind == "sampled":
        sampled = motor_loop.sampled(motor, period, ratio=ratio)
    lag, spring = 1.0 / (motor_loop.pole * ratio), model.natural_frequency**2

    def response(s: Complex) -> Complex:
        # With the sampled PID, the hold drives the bare motor, and the PID comes before
        # the hold (`before`).
        drive = (
            s * (s + motor.decay) / (motor.gain * ratio)
            if sampled
            else (1.0 + lag * s) ** 2
        )
        ln_s = np.log(s)
        inertia: Complex = np.exp(model.order * ln_s)
        # Most links have no damping, and many gauges no delay: each exponential over all
        # aliases is a quarter of the work.
        drag: Complex = np.asarray(
            model.damping * np.exp(model.damping_order * ln_s) if model.damping else 0.0
        )
        whole = inertia + drag + spring
        late = np.exp(-model.gauge_delay * s) if model.gauge_delay else 1.0
        gauge: Complex = np.asarray(model.gauge_gain * late)
        # One fraction: far above the resonance Γ/(c θm) is close to 1, and its
        # difference from 1 would cancel.
        bracket = (drag + spring + inertia * (1.0 - gauge)) / whole
        if higher is not None:
            bracket = bracket - gauge * higher(s)
        if model.second_mode is not None:
            bracket = bracket - gauge * model.second_mode.response(s)
        return bracket / drive

    # The voltage of the PID already includes the computation delay.
    return SampledPlant(
        response=response,
        period=period,
        delay=0.0 if sampled else motor_loop.delay_samples * period,
        before=sampled.voltage if sampled else None,
    )
