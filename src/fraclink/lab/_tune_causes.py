"""Why an arm gets no law, as its record shows: a clipping gauge, a coarse encoder, a
delayed voltage, a sticking motor, a delayed gauge, a long period; and the arms for
which a law can be expected.
"""

from __future__ import annotations

import math

import numpy as np

from fraclink._arm.link import LinkModel
from fraclink._identify import Fit, simulated_torque
from fraclink._identify.columns import rails
from fraclink.lab._tune_guard import Record
from fraclink.lab._tune_link import second_torque
from fraclink.lab._tune_motor import MotorResult, unlimited_pole
from fraclink.lab._tune_wiring import COUNT, Wiring
from fracsys.checks import Real

__all__ = ["causes", "domain", "sensor_noise", "unexplained"]


# Phase that the delay of the gauge may cost at the vibration frequency: half of a phase
# margin of 30°.
_LATE = math.radians(15.0)
# Periods per vibration, at least: a voltage takes effect one period after its sample
# and is held for one. These 1.5 periods cost the phase allowed for a gauge if a period
# is 1/36 of the vibration period.
_PERIODS = round(1.5 * 2.0 * math.pi / _LATE)


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
        *_clipping(record.torque),
        *_long_period(
            wiring.natural_frequency if model is None else model.resonance,
            record.period,
        ),
        *(() if motor is None else _slow_loop(motor, wiring, record.period, voltage)),
        *(() if model is None else _late_gauge(model)),
    )


def _clipping(torque: Real) -> tuple[str, ...]:
    """A saturated gauge repeats its extreme value."""
    ends = [f"{held} samples read exactly {end:.3g} N·m" for end, held in rails(torque)]
    if not ends:
        return ()
    return (
        f"the gauge clips: {' and '.join(ends)}; a smaller gain of its amplifier, or a limit of the torque "
        "below that, helps",
    )


def _slow_loop(
    motor: MotorResult, wiring: Wiring, period: float, voltage: float
) -> tuple[str, ...]:
    """The speed that the motor loop would gain with a finer encoder, or without the
    delay.
    """
    sentences, pole = [], motor.loop.pole
    finer = unlimited_pole(motor, period, motor.fit.delay)
    if finer is not None and finer > pole:
        sentences.append(
            f"the encoder is coarse: a count, or its noise, is {math.degrees(wiring.count):.2g}°, and the motor loop "
            f"is held at {pole:g} rad/s instead of {finer:g}, where a count would take a quarter of {voltage:g} V; "
            "a finer encoder helps"
        )
    prompt = unlimited_pole(motor, period, period)
    if prompt is not None and finer is not None and prompt > finer:
        sentences.append(
            f"the voltage acts {1e3 * motor.fit.delay:.2g} ms late, {motor.loop.delay_samples} periods: the "
            f"motor loop is held at {finer:g} rad/s instead of {prompt:g}; a faster amplifier, or a shorter "
            "path from the sample to the voltage, helps"
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
        f"until it is {math.degrees(slip):.2g}° off, and then it slips, over and over again; "
        + ("an amplifier without a dead zone" if dead else "less friction")
        + ", or no play in the gear, helps",
    )


def _long_period(resonance: float, period: float) -> tuple[str, ...]:
    count = math.tau / (resonance * period)
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
    part = f"a period of at most 1/{_PERIODS} of the vibration's"
    if period is not None:
        part += f" ({1e3 * period:g} ms: vibrations up to {1.0 / (_PERIODS * period):.2g} Hz)"
    return (
        f"domain: {part}; a gauge that is late by at most 1/{math.tau / _LATE:.0f} of the vibration's period and does "
        f"not clip; {math.ceil(math.tau / COUNT)} encoder counts a turn or more; no play in the gear, "
        "no cable that pulls"
    )


def _late_gauge(link: LinkModel) -> tuple[str, ...]:
    phase = link.resonance * link.gauge_delay
    if phase <= _LATE:
        return ()
    return (
        f"the gauge is {1e3 * link.gauge_delay:.2g} ms late, which costs {math.degrees(phase):.0f}° of phase at "
        f"the vibration of {link.resonance:.3g} rad/s; a faster amplifier or filter of the gauge helps",
    )


def unexplained(
    residual: Real, model: LinkModel, record: Record, wiring: Wiring, least: float
) -> tuple[str, ...]:
    """A sentence on the bending that the model does not explain, from the `residual`
    [N·m] of moves; none if it is below `least` [rad] or the noise of the sensors.
    """
    # What the gauge reads before the first voltage, hum included, is not a response of
    # the link.
    rest = record.torque[: int(np.argmax(record.voltage != 0.0))]
    noise = max(
        sensor_noise(model, record.torque, record.period, wiring),
        float(np.std(rest)) if rest.size else 0.0,
    )
    power = float(np.mean(np.square(residual)))
    left = math.sqrt(max(power - noise**2, 0.0)) / model.stiffness
    bound = max(least, noise / model.stiffness)
    # A gauge without any noise is simulated: the residual is an error of the fit.
    if left <= bound or wiring.gauge_noise == 0.0:
        return ()
    return (
        f"a linear link leaves a bend of {math.degrees(left):.2g}° unexplained, more than the "
        f"{math.degrees(bound):.2g}° of noise or of the band of the move: play in the gear, a loose clamp or a cable "
        "that pulls; less of it helps",
    )


def sensor_noise(
    model: LinkModel, torque: Real, period: float, wiring: Wiring
) -> float:
    """The standard deviation [N·m] of the residual that is due to the sensors: the noise
    and the step of the gauge, and the count of the encoder, to which the link responds
    as to a motion of the motor and which it amplifies at its resonances.
    """
    # From the readings in motion: at rest, those of a coarse gauge do not change.
    step = float(np.min(np.diff(np.unique(torque)), initial=math.inf))
    # At the second sample: the first one is the motor's angle at rest, and no motion.
    pulse = np.zeros(torque.size)
    pulse[1] = wiring.count
    answer = simulated_torque(model, pulse, period, hold="first")
    if model.second_mode is not None:
        answer = answer + second_torque(model.second_mode, model, pulse, period)
    # From rest on the variance grows with every sample: its mean over the record.
    count = math.sqrt(float(np.mean(np.cumsum(answer**2))))
    # Rounding to a step s leaves s/√12.
    return math.hypot(
        wiring.gauge_noise, step / math.sqrt(12.0), count / math.sqrt(12.0)
    )
