"""Design of the experiment: the size and speed of motor motion that determine λ to a
required accuracy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from scipy.signal import cont2discrete, lfilter

from fraclink._arm.link import LinkModel
from fraclink._arm.reference import prbs
from fraclink._arm.rig import Motor
from fraclink._display import Overview, Row, displayed, number
from fraclink._identify.problem import inverted
from fraclink._identify.shape import COORDINATE, Window, columns_of, mask_of, shape_of
from fraclink.errors import InfeasibleError
from fracsys.checks import Between, Real, checked
from fracsys.checks.equality import compared

# Centres of the bands that are tried, relative to the resonance.
_BANDS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
# [s] longest log, since each band is simulated sample by sample
_LEAST_SAMPLES, _MOST_SAMPLES = (200, 1_000_000)


Deflection = Annotated[
    float,
    Between(0.0, unit="rad", low_open=True, finite=False, remedy="give radians"),
]


@displayed
@compared
@dataclass(frozen=True, eq=False)
class ExperimentDesign:
    """An excitation that reaches a wanted standard error of λ.

    Parameters
    ----------
    amplitude
        motor angle asked for, in either direction [rad].
    bit
        duration of a bit of the random sequence [s].
    band
        (low, high) where its power lies [rad/s].
    duration
        of the motion [s].
    standard_error
        of λ that is to be expected [1].
    peak_deflection
        largest θm − θt [rad].
    peak_voltage
        largest |V| [V], None without a motor.
    limit
        what kept the amplitude down: "none", "deflection" or "voltage".
    time, motor_angle
        the motion itself, shape (N,) [s], [rad].
    """

    amplitude: float
    bit: float
    band: tuple[float, float]
    duration: float
    standard_error: float
    peak_deflection: float
    peak_voltage: float | None
    limit: str
    time: Real = field(repr=False)
    motor_angle: Real = field(repr=False)

    def overview(self) -> Overview:
        """What moves, how far, how long, and how sure λ will be."""
        rows = (
            Row("amplitude", "amplitude", self.amplitude, "rad"),
            Row("bit", "bit", self.bit, "s"),
            Row("band", "band", self.band, "rad/s", digits=3),
            Row("duration", "duration", self.duration, "s"),
            Row("standard_error", "standard error of λ", self.standard_error),
            Row("peak_deflection", "peak deflection", self.peak_deflection, "rad"),
            Row("peak_voltage", "peak voltage", self.peak_voltage, "V"),
        )
        return Overview(f"PRBS of {number(self.duration)} s", rows=rows)


@checked
def design_experiment(
    model: LinkModel,
    *,
    standard_error: Annotated[float, Between(1e-12, 1.0)],
    noise: Annotated[float, Between(1e-12, 1e6, "N·m")],
    period: Annotated[float, Between(1e-6, 1.0, "s")],
    duration: Annotated[float, Between(0.0, 1e6, "s", low_open=True)] = 20.0,
    motor: Motor | None = None,
    deflection_limit: Deflection = math.inf,
    motor_loop_pole: Annotated[float, Between(0.1, 1e6, "rad/s")] = 80.0,
) -> ExperimentDesign:
    """Choose amplitude and band of a random binary sequence for a wanted standard error
    of λ, within limits.

        s.e.(λ) = σ √[(JᵀJ)⁻¹]_λλ,    J = ∂(output)/∂(λ, ω₀, delay, gain, offset) ∝ amplitude

    Of all bands the one with the smallest amplitude that meets the request within the
    limits is taken.

    Parameters
    ----------
    model
        the link one expects.
    standard_error
        wanted of λ [1].
    noise
        standard deviation of the gauge, white [N·m].
    period, duration
        of the sampling and of the log [s]; 200 to 1e6 samples.
    motor
        gives the voltage limit and what the motion costs, V = (θm'' + Bθm')/A + Γ/(nK);
        friction is left to the compensation.
    deflection_limit
        largest |θm − θt| [rad].
    motor_loop_pole
        double pole of the motor loop that follows the reference [rad/s].

    Raises
    ------
    InfeasibleError
        the limits forbid it; its `nearest` is the standard error that can be reached.

    Examples
    --------
    >>> link = LinkModel(1.56, 10.0, order=1.92)
    >>> wanted = design_experiment(link, standard_error=0.001, noise=0.05, period=0.004)
    >>> wanted.limit, wanted.standard_error <= 0.001 * (1 + 1e-9), 0.01 < wanted.amplitude < 1
    ('none', True, True)
    """
    longest = _MOST_SAMPLES * period
    duration = Between(_LEAST_SAMPLES * period, longest, "s").check(
        "duration", duration
    )
    target = standard_error
    units = [
        _unit(model, share, noise, period, duration, motor, motor_loop_pole)
        for share in _BANDS
    ]
    designs = [_scaled(unit, target, deflection_limit, motor) for unit in units]
    allowed = [design for design, reached in designs if reached]
    if allowed:
        # The smallest sufficient motion: it wears the arm least and keeps the link
        # closest to its linear range.
        return min(allowed, key=lambda design: design.amplitude)
    best = min(
        (design for design, _ in designs), key=lambda design: design.standard_error
    )
    # The error of an estimate falls with the square root of the number of samples.
    enough = duration * (best.standard_error / target) ** 2
    longer = f"; a log of {math.ceil(enough)} s may do" if enough <= longest else ""
    raise InfeasibleError(
        f"{best.limit} limit",
        f"standard error {target:.3g} of λ needs more than {best.amplitude:.3g} rad{longer}",
        # Slightly more than the value reached; otherwise rounding could make this offer
        # infeasible.
        {"standard_error": best.standard_error * (1 + 1e-6)},
    )


def _unit(
    model: LinkModel,
    share: float,
    noise: float,
    period: float,
    duration: float,
    motor: Motor | None,
    motor_loop_pole: float,
) -> ExperimentDesign:
    """The effect of a random sequence of amplitude 1 whose band is centred at a share
    of the resonance.
    """
    samples = round(duration / period) + 1
    time = np.asarray(period * np.arange(samples), dtype=np.float64)
    # Half a period of the centre frequency per bit: the power then extends from the
    # lowest line to 0.44/bit, where it has fallen by half. A whole number of samples,
    # because the controller can only change its reference at a sample.
    bit = max(round(math.pi / (share * abs(model.pole)) / period), 2) * period
    # 0.2 s of rest before it, for the offset, and 0.3 s after it, for the response to
    # its last bit.
    bits = max(int((duration - 0.5) / bit), 1)
    reference = prbs(1.0, bit, bits=bits, register=9, start=0.2).angle(time)
    # The motor loop follows it, held between samples, with 1/(1 + s/pole)².
    loop = ([1.0], [motor_loop_pole**-2, 2 / motor_loop_pole, 1.0])
    numerator, denominator, _ = cont2discrete(loop, period)
    motion = np.asarray(lfilter(numerator[0], denominator, reference))
    window = Window(motion, np.zeros_like(motion), period, "first")
    kernel = window.kernel(abs(model.pole), longest_delay=2 * period)
    # Without damping: only λ is wanted, and a fit of λ together with μ would need
    # another amplitude.
    fractional = LinkModel(model.stiffness, model.natural_frequency, model.order)
    mask = mask_of(
        [COORDINATE[name] for name in ("order", "natural_frequency", "delay")]
    )
    columns = columns_of(kernel, shape_of(fractional), mask)
    rows = np.vstack([model.stiffness * columns, np.ones(motion.size)])
    rows[0] /= model.stiffness  # derivative with respect to the gain
    # Row 0 belongs to the gain, row 1 to λ.
    inverse = inverted(rows @ rows.T)[0]
    voltage = None
    if motor is not None:
        # Differences of the motion after the motor loop, whose double pole makes θm''
        # finite.
        speed = np.gradient(motion, period)
        load = model.stiffness * columns[0] / (motor.gear_ratio * motor.torque_constant)
        drive = (np.gradient(speed, period) + motor.decay * speed) / motor.gain + load
        voltage = float(np.max(np.abs(drive)))
    return ExperimentDesign(
        amplitude=1.0,
        bit=bit,
        band=(2 * math.pi / duration, 0.44 * 2 * math.pi / bit),
        duration=period * (time.size - 1),
        standard_error=noise * math.sqrt(inverse[1, 1]),
        peak_deflection=float(np.max(np.abs(columns[0]))),
        peak_voltage=voltage,
        limit="none",
        time=time,
        motor_angle=motion,
    )


def _scaled(
    unit: ExperimentDesign, wanted: float, deflection_limit: float, motor: Motor | None
) -> tuple[ExperimentDesign, bool]:
    """The motion at the amplitude that meets the request, or at the largest amplitude
    that the limits allow.
    """
    most = {"deflection": deflection_limit / unit.peak_deflection}
    if motor is not None and unit.peak_voltage:
        most["voltage"] = motor.voltage_limit / unit.peak_voltage
    # The limit that is reached first is reported.
    limit = min(most, key=lambda name: most[name])
    least = unit.standard_error / wanted
    feasible = least <= most[limit]
    amplitude = min(least, most[limit])
    return replace(
        unit,
        amplitude=amplitude,
        standard_error=unit.standard_error / amplitude,
        peak_deflection=amplitude * unit.peak_deflection,
        peak_voltage=unit.peak_voltage and amplitude * unit.peak_voltage,
        limit="none" if feasible else limit,
        motor_angle=amplitude * unit.motor_angle,
    ), feasible
