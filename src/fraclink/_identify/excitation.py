"""Design the experiment: how large and how fast must the motor move for λ to be known
well enough?
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel
from fraclink._arm.reference import prbs
from fraclink._arm.rig import Motor
from fraclink._identify.shape import COORDINATE, Window, columns_of, mask_of, shape_of
from fraclink.errors import InfeasibleError
from fracsys.checks import Between, checked
from fracsys.checks.equality import compared

Reals = NDArray[np.float64]

# Of the resonance, for the PRBS's bit or the multisine's centre.
_BANDS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
_LEAST_SAMPLES, _MOST_SAMPLES = (
    200,
    1_000_000,
)  # of a log; each band is simulated sample by sample


Deflection = Annotated[
    float,
    Between(0.0, unit="rad", low_open=True, finite=False, remedy="give radians"),
]


@compared
@dataclass(frozen=True, eq=False)
class ExperimentDesign:
    """An excitation that reaches a wanted standard error of λ.

    Parameters
    ----------
    kind
        "prbs" or "multisine".
    amplitude
        largest motor angle asked for [rad].
    bit
        duration of a PRBS bit [s], else None.
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

    kind: str
    amplitude: float
    bit: float | None
    band: tuple[float, float]
    duration: float
    standard_error: float
    peak_deflection: float
    peak_voltage: float | None
    limit: str
    time: Reals = field(repr=False)
    motor_angle: Reals = field(repr=False)


@checked
def design_experiment(
    model: LinkModel,
    *,
    standard_error: Annotated[float, Between(1e-12, 1.0)],
    noise: Annotated[float, Between(1e-12, 1e6, "N·m")],
    period: Annotated[float, Between(1e-6, 1.0, "s")],
    duration: Annotated[float, Between(0.0, 1e6, "s", low_open=True)] = 20.0,
    kind: Literal["prbs", "multisine"] = "prbs",
    motor: Motor | None = None,
    deflection_limit: Deflection = math.inf,
    inner_pole: Annotated[float, Between(0.1, 1e6, "rad/s")] = 80.0,
) -> ExperimentDesign:
    """Choose amplitude and band of an excitation for a wanted standard error of λ,
    within limits.

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
    kind
        "prbs" (±amplitude, tried with several bit lengths) or "multisine" (flat in a
        band around the resonance, phases with a low crest factor).
    motor
        gives the voltage limit and what the motion costs, V = (θm'' + Bθm')/A + Γ/(nK);
        friction is left to the compensation.
    deflection_limit
        largest |θm − θt| [rad].
    inner_pole
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
    wanted = standard_error
    tried = [
        _unit(model, bit, band, motion, noise, period, motor)
        for bit, band, motion in _motions(kind, model, period, duration, inner_pole)
    ]
    found = [_scaled(unit, wanted, deflection_limit, motor) for unit in tried]
    allowed = [design for design, reached in found if reached]
    if allowed:
        # The smallest motion that does: it wears the arm least and bends the link least
        # out of its straight range.
        return replace(min(allowed, key=lambda design: design.amplitude), kind=kind)
    best = min(
        (design for design, _ in found), key=lambda design: design.standard_error
    )
    # The error of an estimate falls with the square root of the samples.
    enough = duration * (best.standard_error / wanted) ** 2
    longer = f"; a log of {math.ceil(enough)} s may do" if enough <= longest else ""
    raise InfeasibleError(
        f"{best.limit} limit",
        f"standard error {wanted:.3g} of λ needs more than {best.amplitude:.3g} rad{longer}",
        # A hair more than what was reached, or rounding would refuse what is offered
        # here.
        {"standard_error": best.standard_error * (1 + 1e-6)},
    )


def _motions(
    kind: str, model: LinkModel, period: float, duration: float, inner_pole: float
) -> Sequence[tuple[float | None, tuple[float, float], Reals]]:
    """(bit, band, motion of amplitude 1 after the motor loop) for every band that is
    tried.
    """
    resonance = abs(model.pole)
    time: Reals = np.asarray(
        period * np.arange(round(duration / period) + 1), dtype=np.float64
    )
    result: list[tuple[float | None, tuple[float, float], Reals]] = []
    for share in _BANDS:
        centre = share * resonance
        if kind == "prbs":
            # Half a period of the centre a bit: power then lies from the lowest line to
            # 0.44/bit, where it has fallen by half. Whole samples: the controller that
            # plays it can change its reference at a sample only.
            bit = max(round(math.pi / centre / period), 2) * period
            # 0.2 s of rest before it, for the offset, and 0.3 s after it, so that its
            # last bit is answered.
            path = prbs(
                1.0,
                bit,
                bits=max(int((duration - 0.5) / bit), 1),
                register=9,
                start=0.2,
            )
            band = (2 * math.pi / duration, 0.44 * 2 * math.pi / bit)
            result.append((bit, band, _followed(path.angle(time), period, inner_pole)))
        else:
            band = (0.5 * centre, 2.0 * centre)
            result.append(
                (None, band, _followed(_multisine(time, band), period, inner_pole))
            )
    return result


def _multisine(time: Reals, band: tuple[float, float]) -> Reals:
    """Unit-peak multisine with Schroeder's phases, faded in over a second so that it
    starts at rest.
    """
    span = time[-1]
    lines = np.arange(
        math.ceil(band[0] * span / 2 / math.pi),
        math.floor(band[1] * span / 2 / math.pi) + 1,
    )
    lines = lines[lines > 0]
    # Schroeder's phases sweep the lines in time: a peak of 1.7 times the RMS where
    # equal phases give √(2N).
    phases = (
        -math.pi
        * np.arange(lines.size)
        * (np.arange(lines.size) - 1)
        / max(lines.size, 1)
    )
    wave = np.zeros_like(time)
    for line, phase in zip(lines, phases, strict=True):
        wave += np.cos(2 * math.pi * line * time / span + phase)
    # 3t² − 2t³: the slope begins and ends at zero, and so the motor's speed does not
    # jump.
    wave *= np.clip(time, 0, 1) ** 2 * (3 - 2 * np.clip(time, 0, 1))
    return np.asarray(wave / np.max(np.abs(wave)))


def _followed(reference: Reals, period: float, pole: float) -> Reals:
    """The reference, held between samples, after 1/(1 + s/pole)²."""
    # The double pole by its exact solution over a period, whatever the period is.
    fade, level, slope = math.exp(-pole * period), 0.0, 0.0
    result = np.empty_like(reference)
    for k, target in enumerate(reference):
        result[k] = level
        gap = level - target
        push = slope + pole * gap
        level = target + (gap + push * period) * fade
        slope = (push - pole * (gap + push * period)) * fade
    return result


@dataclass(frozen=True, eq=False)
class _Unit:
    """What a motion of amplitude 1 does."""

    bit: float | None
    band: tuple[float, float]
    motion: Reals
    period: float
    error: float
    deflection: float
    voltage: float | None


def _unit(
    model: LinkModel,
    bit: float | None,
    band: tuple[float, float],
    motion: Reals,
    noise: float,
    period: float,
    motor: Motor | None,
) -> _Unit:
    window = Window(motion, np.zeros_like(motion), period, "first")
    kernel = window.kernel(abs(model.pole), longest_delay=2 * period)
    # Without its damping: λ alone is asked for, and a fit of λ beside μ would need
    # another amplitude.
    fractional = LinkModel(model.stiffness, model.natural_frequency, model.order)
    mask = mask_of(
        [COORDINATE[name] for name in ("order", "natural_frequency", "delay")]
    )
    columns = columns_of(kernel, shape_of(fractional), mask)
    scaled = np.vstack([model.stiffness * columns, np.ones(motion.size)])
    scaled[0] /= model.stiffness  # the gain's own derivative
    size = np.linalg.norm(scaled, axis=1)
    # Columns of length one: derivatives by λ and by the offset differ by orders of
    # magnitude.
    inverse = np.linalg.inv((scaled / size[:, None]) @ (scaled / size[:, None]).T)
    # Row 0 is the gain's, row 1 that of λ.
    error = noise * math.sqrt(inverse[1, 1]) / float(size[1])
    voltage = None
    if motor is not None:
        # Differences of the motion after the motor's loop: it has a double pole, so
        # that θm'' is finite.
        speed = np.gradient(motion, period)
        load = model.stiffness * columns[0] / (motor.gear_ratio * motor.torque_constant)
        drive = (np.gradient(speed, period) + motor.decay * speed) / motor.gain + load
        voltage = float(np.max(np.abs(drive)))
    return _Unit(
        bit, band, motion, period, error, float(np.max(np.abs(columns[0]))), voltage
    )


def _scaled(
    unit: _Unit, wanted: float, deflection_limit: float, motor: Motor | None
) -> tuple[ExperimentDesign, bool]:
    """The motion at the amplitude that meets the request, or at the largest the limits
    admit.
    """
    needed = unit.error / wanted
    most = {"deflection": deflection_limit / unit.deflection}
    if motor is not None and unit.voltage:
        most["voltage"] = motor.voltage_limit / unit.voltage
    # The limit that binds first is the one that is named.
    limit = min(most, key=lambda name: most[name])
    reached = needed <= most[limit]
    amplitude = needed if reached else most[limit]
    return ExperimentDesign(
        kind="",
        amplitude=amplitude,
        bit=unit.bit,
        band=unit.band,
        duration=unit.period * (unit.motion.size - 1),
        standard_error=unit.error / amplitude,
        peak_deflection=amplitude * unit.deflection,
        peak_voltage=None if unit.voltage is None else amplitude * unit.voltage,
        limit="none" if reached else limit,
        time=np.asarray(unit.period * np.arange(unit.motion.size), dtype=np.float64),
        motor_angle=amplitude * unit.motion,
    ), reached
