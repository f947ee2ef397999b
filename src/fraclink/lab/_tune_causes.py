"""The causes, found in its record, why an arm gets no law: a clipping gauge, a coarse
encoder, a delayed voltage, a sticking motor, a delayed gauge, a long period; and the
domain that follows from these.
"""

from __future__ import annotations

import math

import numpy as np

from fraclink._arm.link import LinkModel
from fraclink._identify import Fit
from fraclink.lab._tune_guard import Record
from fraclink.lab._tune_motor import MotorResult, unlimited_pole
from fraclink.lab._tune_wiring import COUNT, Wiring
from fracsys.checks import Real

__all__ = ["UNEXPLAINED", "causes", "domain"]


# Phase that the delay of the gauge may cost at the vibration: half of a phase margin of
# 30°.
_LATE = math.radians(15.0)
# Periods per vibration, at least: a voltage takes effect one period after its sample
# and is held for one. These 1.5 periods cost the phase allowed for a gauge if a period
# is 1/36 of the vibration period.
_PERIODS = round(1.5 * 2.0 * math.pi / _LATE)
# Multiple of the gauge's noise, or of what a tuning left, that a residual reaches only if
# something is there that the model lacks.
UNEXPLAINED = 4.0
_CLIPPED = 5  # samples at the extreme; fewer are a peak


def causes(
    record: Record,
    wiring: Wiring,
    motor: MotorResult | None,
    link: Fit | None,
    voltage: float,
    hunts: bool = False,
) -> tuple[str, ...]:
    """Sentences, each with a visible cause and its remedy; `voltage` is the limit [V],
    and `hunts` whether a move did not come to rest.
    """
    # The model of a fit that failed a gate is not reliable.
    model = link.model if link is not None and link.passed else None
    return (
        *(_sticking(motor, record.period) if motor is not None and hunts else ()),
        *_clipping(record.torque, wiring.gauge_noise),
        *_long_period(
            wiring.natural_frequency if model is None else abs(model.pole),
            record.period,
        ),
        *(() if motor is None else _slow_loop(motor, wiring, record.period, voltage)),
        *(() if model is None else _late_gauge(model)),
        *(() if link is None else _not_linear(link, record.torque, wiring.gauge_noise)),
    )


def _clipping(torque: Real, noise: float) -> tuple[str, ...]:
    """A saturated gauge repeats its extreme value, with few samples just below it."""
    for extreme, inwards in (
        (torque.max(), torque.max() - torque),
        (torque.min(), torque - torque.min()),
    ):
        at_rail = int(np.count_nonzero(inwards == 0.0))
        below = int(np.count_nonzero((inwards > 0.0) & (inwards <= 2.0 * noise)))
        if noise > 0.0 and at_rail >= _CLIPPED and at_rail > below:
            return (
                f"the gauge clips: {at_rail} samples read exactly {extreme:.3g} N·m; a smaller gain of its "
                "amplifier, or a limit of the torque below that, helps",
            )
    return ()


def _slow_loop(
    motor: MotorResult, wiring: Wiring, period: float, voltage: float
) -> tuple[str, ...]:
    """The speed that the motor loop would gain with a finer encoder, or without the
    delay.
    """
    sentences = []
    pole = motor.loop.pole
    finer = unlimited_pole(motor, period, motor.fit.delay)
    if finer is not None and finer > pole:
        sentences.append(
            f"the encoder is coarse: one count is {math.degrees(wiring.encoder_step):.2g}°, and the motor loop "
            f"is held at {pole:g} rad/s instead of {finer:g}, where a count would take a quarter of {voltage:g} V; "
            "a finer encoder helps"
        )
    prompt = unlimited_pole(motor, period, period)
    if prompt is not None and finer is not None and prompt > finer:
        sentences.append(
            f"the voltage acts {1e3 * motor.fit.delay:.2g} ms late, {motor.loop.delay_samples} periods: the "
            f"motor loop is held at {finer:g} rad/s instead of {prompt:g}; a faster amplifier, or less way "
            "from the sample to the voltage, helps"
        )
    return tuple(sentences)


def _sticking(motor: MotorResult, period: float) -> tuple[str, ...]:
    """The cause of stick-slip of the motor: its friction, or the dead zone of its
    amplifier, whichever is larger.
    """
    fit = motor.fit
    # Until the integral has reversed the voltage, an error of this angle causes no
    # motion.
    slip = motor.friction / motor.loop.pid(motor.gain, period).stiffness
    dead = fit.dead_zone > fit.coulomb_voltage
    cause = "the amplifier has a dead zone" if dead else "the motor sticks"
    return (
        f"{cause}: {fit.dead_zone:.2g} V of dead zone and {fit.coulomb_voltage:.2g} V of friction hold the motor "
        f"until it is {math.degrees(slip):.2g}° off, and it slips by as much again and again; "
        + ("an amplifier without one" if dead else "less friction")
        + ", or no play in the gear, helps",
    )


def _long_period(resonance: float, period: float) -> tuple[str, ...]:
    count = 2.0 * math.pi / (resonance * period)
    if count >= _PERIODS:
        return ()
    return (
        f"the period of {1e3 * period:.3g} ms is long: a vibration of {resonance:.3g} rad/s has {count:.0f} of "
        f"them, and needs {_PERIODS}; {1e3 * period * count / _PERIODS:.2g} ms or a slower arm (more payload, a "
        "longer link) helps",
    )


def domain(period: float | None) -> str:
    """The arms for which a law can be expected, in a sentence; `period` [s] if it is
    known.
    """
    late = math.degrees(_LATE) / 360.0
    part = f"a period of at most 1/{_PERIODS} of the vibration's"
    if period is not None:
        part += f" ({1e3 * period:g} ms: vibrations up to {1.0 / (_PERIODS * period):.2g} Hz)"
    return (
        f"domain: {part}; a gauge that is late by at most 1/{1.0 / late:.0f} of it and does not clip; "
        f"{math.ceil(math.tau / COUNT)} encoder counts a turn or more; no play in the gear, no cable that pulls"
    )


def _late_gauge(link: LinkModel) -> tuple[str, ...]:
    phase = abs(link.pole) * link.gauge_delay
    if phase <= _LATE:
        return ()
    return (
        f"the gauge is {1e3 * link.gauge_delay:.2g} ms late, which costs {math.degrees(phase):.0f}° of phase at "
        f"the vibration of {abs(link.pole):.3g} rad/s; a faster amplifier or filter of the gauge helps",
    )


def _not_linear(fit: Fit, torque: Real, noise: float) -> tuple[str, ...]:
    # At rest, the reading of a coarse gauge does not change.
    step = float(np.min(np.diff(np.unique(torque)), initial=math.inf))
    left = math.sqrt(fit.mse) / math.hypot(noise, step / math.sqrt(12.0))
    # A reading without any noise is a simulation's, whose residual is no cause.
    if noise == 0.0 or left <= UNEXPLAINED:
        return ()
    return (
        f"a linear link leaves {left:.0f} times the gauge's noise of what was recorded, as with play in the "
        "gear, a loose clamp or a cable that pulls; less of it helps",
    )
