"""The wiring check, within 5° of motion and before any loop is closed: signs, scales,
function of the sensors, delay.

The arm is moved by doublets, a voltage followed by its opposite, each slightly larger
than the last, until encoder or gauge responds. A train of such moves is then fitted:
the motor to the angle, the link to the torque. Every sign is a fitted gain with its
standard error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._arm.rig import Rig
from fraclink._files import document
from fraclink._identify import identify
from fraclink.errors import FraclinkError
from fraclink.lab._tune_doublets import edges_of, motor_of_doublets
from fraclink.lab._tune_guard import Guard, Record
from fracsys.checks import Real

__all__ = ["FAR", "Wiring", "WiringFault", "check_wiring"]


# [s] in which the noise of the sensors is measured: the standard deviation of a hundred
# samples (4 ms) is accurate to 7 %.
_REST = 0.4
# checks for which an arm may take to come to rest: three seconds, for an arm that was
# just released
_LOOKS = 8
_STILL = 0.004  # [rad]
# [s] of each half of a doublet: shorter than a quarter of the vibration period of any
# laboratory arm
_PULSE = 0.04
_PAUSE = 0.16  # [s] after a doublet
# share of the voltage limit; growth: a motion that has just begun must not reach 5° at
# the next doublet
_FIRST, _GROWTH = (0.01, 1.25)
_ANSWER = 0.012  # [rad], 0.7°: size of motion at which the doublets stop growing
# [rad], 2.3°: size of motion if the gauge does not respond to the first one
_MOST = 0.040
# [N·m], at least: if only the gauge responds, possibly with an angle, the response must
# be a real motion
_FELT = 0.006
# share of the wanted motion below which there is none, if the gauge responds
_MISSING = 0.5
# counts of an encoder, at least: with fewer, the motion, and thus K/J, is known to no
# better than an eighth
_COUNTS = 8
# The plan states the largest motion; this factor leaves room for a later, larger
# attempt.
_LARGER = 1.6
COUNT = _MOST / _LARGER / _COUNTS  # [rad]: the coarsest encoder with that many counts
# Standard errors required of a sign: a wrong sign closes a loop that runs away; the
# probability of chance is one in two million.
_SURE = 5.0
# share of a motion that follows the doublets: about half for an angle, a tenth for a
# torque
_KEPT = 0.3
# share of the link's residual: with correct wires the residual of the exchanged fit is
# larger
_REVERSED = 0.6
# Standard deviations that noise does not reach, be it the largest of many samples or
# the best gain of a fit over all frequencies.
_CLEAR = 8.0
# Six of each sign: drift or drag to one side cancels.
_DOUBLETS = 12
# multiple of a stated or an earlier value: the fit to small motions is accurate to a
# tenth, payload and gear may differ by a third
FAR = 1.6
# allowed factor of a stated value: friction, payload and gauge differ by a third, wrong
# units by ten
_SCALE = 2.5
# NMSE above which one signal is not the response of a link to the other; for noise it
# is 1
_EXPLAINED = 0.85


class WiringFault(FraclinkError):
    """A wire, a sign or a scale is wrong; the drive is off."""


class _Unsure(WiringFault):
    """A suspected fault that a larger motion may still refute."""


@document("wiring")
@dataclass(frozen=True)
class Wiring:
    """What the first motions showed.

    Parameters
    ----------
    gain, friction
        of the motor, a first guess: A = K/J [rad/(s²·V)], Coulomb friction as a voltage
        [V].
    delay
        from a voltage to the motion [s].
    stiffness, natural_frequency
        of the link, a first guess [N·m/rad], [s^(-λ/2)].
    gauge_delay
        of the torque behind the motor angle [s].
    encoder_noise, gauge_noise
        standard deviations at rest [rad], [N·m].
    encoder_step
        smallest difference of two readings [rad].
    pulse
        voltage of the doublets at the end [V].
    motion
        farthest from the start [rad].
    evidence
        sentences, one for each conclusion.
    """

    gain: float
    friction: float
    delay: float
    stiffness: float
    natural_frequency: float
    gauge_delay: float
    encoder_noise: float
    gauge_noise: float
    encoder_step: float
    pulse: float
    motion: float
    evidence: tuple[str, ...]


def check_wiring(guard: Guard, stated: Rig | None) -> Wiring:
    """Find signs, scales and delays with small motions; `WiringFault` where one is
    wrong.

    `stated` is the user's description of the arm: scales are compared with its motor
    and stiffness.
    """
    for _ in range(_LOOKS):
        start = guard.count
        guard.rest(_REST)
        still = guard.record(start)
        # Second differences, to which an arm that still rings adds almost nothing. For
        # white noise they have six times its variance: 1 + 4 + 1.
        shake, noise = (
            float(np.std(np.diff(x, 2))) / math.sqrt(6.0)
            for x in (still.angle, still.torque)
        )
        angle = float(np.ptp(_smoothed(still.angle)))
        if angle <= _STILL + _CLEAR * shake / math.sqrt(_SMOOTH):
            break
    else:
        raise WiringFault(
            f"the motor turns by {math.degrees(angle):.2g}° at 0 V: the drive is not off, or the arm is "
            "being moved"
        )
    # The zero of the gauge is its mean at rest, not its first sample.
    guard.offset += float(np.mean(still.torque))
    # Before the first doublet: six standard deviations of a coarse encoder's speed
    # would end it.
    guard.allow(shake)
    # An answer must exceed the noise after smoothing over five samples.
    goal = max(_ANSWER, _CLEAR * shake / math.sqrt(_SMOOTH))
    pulse = _grown(guard, goal, still.torque)
    while True:
        record, earlier = _train(guard, pulse)
        guard.release()
        conclusion = _concluded(record, earlier, shake, noise, pulse, stated)
        if isinstance(conclusion, Wiring):
            return conclusion
        if not isinstance(conclusion, _Unsure) or goal >= _MOST / _LARGER:
            raise conclusion
        # Continue from there: a motion too small for the noise is enlarged, and may
        # exceed its goal by one growth.
        goal = min(_LARGER * goal, _MOST / _LARGER)
        pulse = _grown(guard, goal, still.torque, pulse)


def _grown(guard: Guard, goal: float, still: Real, pulse: float = 0.0) -> float:
    """The voltage of a doublet that moves the encoder by `goal` [rad], or the gauge
    visibly more than it moved at rest [N·m].
    """
    most, swings = guard.limits.voltage, [float(np.var(still))]
    pulse = max(pulse, _FIRST * most / _GROWTH)
    # Signs alternate, so that each doublet cancels the remaining motion of the last
    # one.
    sign = 1.0
    while pulse < most:
        pulse = min(_GROWTH * pulse, most)
        before = guard.count
        angle = float(np.mean(guard.record(max(before - 2 * _SMOOTH, 0)).angle))
        _doublet(guard, sign * pulse)
        sign = -sign
        record = guard.record(before)
        travel = float(np.max(np.abs(_smoothed(record.angle) - angle)))
        # The resolution of the encoder is determined each time, since it is unknown
        # before something moves; but never beyond the plan, so that a coarse encoder is
        # reported as such.
        counts = min(_COUNTS * _step(record.angle), _COUNTS * COUNT)
        if travel >= max(goal, counts):
            return pulse
        # Over two doublets: the mean square of their 2n samples scatters by 1/√n.
        swings.append(float(np.var(record.torque)))
        noise = swings[0] * (1.0 + _SURE / math.sqrt(record.torque.size))
        if travel < _MISSING * goal and 0.5 * sum(swings[-2:]) > max(
            noise, 0.5 * _FELT**2
        ):
            return pulse
    raise WiringFault(
        f"neither encoder nor gauge answers {most:g} V: drive not enabled, voltage not connected, brake "
        "on, or both sensors dead"
    )


_SMOOTH = 5


def _smoothed(values: Real) -> Real:
    return np.convolve(values, np.full(_SMOOTH, 1 / _SMOOTH), "valid")


def _doublet(guard: Guard, voltage: float) -> None:
    for part in (voltage, -voltage):
        for _ in range(_half(guard.period)):
            guard.step(part)
    guard.rest(_PAUSE)


def _half(period: float) -> int:
    """Periods of one half of a doublet."""
    return max(2, round(_PULSE / period))


def _train(guard: Guard, pulse: float) -> tuple[Record, Record]:
    """Doublets of both signs with pauses of different lengths, so that no vibration
    builds up; and the earlier record since the last rest.
    """
    guard.rest(0.2)
    start = guard.count
    guard.rest(0.1)
    for k in range(_DOUBLETS):
        _doublet(guard, pulse if k % 2 == 0 else -pulse)
        # Equal pauses would excite a link with that period; four different ones excite
        # none.
        guard.rest(0.05 * (k % 4))
    guard.rest(0.3)
    return guard.record(start), guard.record(0, start)


def _concluded(
    record: Record,
    earlier: Record,
    shake: float,
    noise: float,
    pulse: float,
    stated: Rig | None,
) -> Wiring | WiringFault:
    step = _step(record.angle)
    travel = float(np.ptp(record.angle))
    degrees = f"{math.degrees(travel):.2g}°"
    # An encoder at rest between two marks may show two counts.
    if travel < 3 * step or travel == 0.0:
        return WiringFault(
            f"encoder dead: it stands still while the gauge answers the drive ({pulse:.3g} V) with "
            f"{float(np.ptp(_smoothed(record.torque))):.3g} N·m"
        )
    link = _link(record, earlier)
    gain, error, friction, delay = motor_of_doublets(
        record, _half(record.period), 0.0 if link is None else max(link[3], 0.0)
    )
    # Checked before the gauge: with the counts of another encoder the torque would not
    # fit a link either, and would be blamed.
    if stated is not None and gain > FAR * stated.motor.gain and gain > _SURE * error:
        return WiringFault(_encoder_scale(gain, stated))
    shares = _kept(record, record.angle), _kept(record, record.torque)
    if shares[1] > max(_KEPT, 2.0 * shares[0]) or (
        shares[1] > max(_KEPT, shares[0]) and _swapped(record, earlier, link)
    ):
        return WiringFault(
            "channels swapped: what is read as the torque stays where the motor was moved to "
            f"({100 * shares[1]:.0f} % of its motion), what is read as the angle does not "
            f"({100 * max(shares[0], 0.0):.0f} %)"
        )
    if link is None or (link[4] > _EXPLAINED and abs(link[0]) < _CLEAR * link[1]):
        share = "nothing" if link is None else f"{100 * (1 - link[4]):.0f} %"
        return _Unsure(
            f"gauge dead: of its signal the motor's motion of {degrees} explains {share}; its noise is "
            f"{noise:.2g} N·m"
        )
    stiffness, spread, frequency, gauge_delay, nmse = link
    if abs(stiffness) < _SURE * spread or abs(gain) < _SURE * error:
        return _Unsure("signs not sure: the motion is too small for the sensors' noise")
    voltage = f"{pulse:.3g} V turns the encoder by {degrees}, K/J = {gain:+.3g} ± {error:.1g} rad/(s²·V)"
    bend = f"torque over angle {stiffness:+.3g} ± {spread:.1g} N·m/rad, {100 * (1 - nmse):.0f} % explained"
    if gain < 0 and stiffness < 0:
        return WiringFault(
            f"encoder reversed: {voltage}, and {bend}; turn the encoder's sign (the same is seen where motor "
            "and gauge are both reversed)"
        )
    if gain < 0:
        return WiringFault(
            f"motor reversed: {voltage}, while {bend} is right; turn the sign of the voltage (the same is "
            "seen where encoder and gauge are both reversed)"
        )
    if stiffness < 0:
        return WiringFault(
            f"gauge reversed: {bend}, while {voltage} is right; turn the gauge's sign (the same is seen "
            "where motor and encoder are both reversed)"
        )
    scales, fault = _scales(gain, stiffness, stated)
    if fault:
        return WiringFault(fault)
    return Wiring(
        gain=gain,
        friction=friction,
        delay=delay,
        stiffness=stiffness,
        natural_frequency=frequency,
        gauge_delay=gauge_delay,
        encoder_noise=shake,
        gauge_noise=noise,
        encoder_step=step,
        pulse=pulse,
        motion=float(np.max(np.abs(record.angle))),
        evidence=(
            f"encoder and voltage: right, {voltage}",
            f"gauge: right, alive, {bend}, noise {noise:.2g} N·m at rest",
            f"delay: {1e3 * delay:.2g} ms from voltage to motion, {1e3 * gauge_delay:.2g} ms of the gauge",
            *scales,
        ),
    )


def _scales(
    gain: float, stiffness: float, stated: Rig | None
) -> tuple[tuple[str, ...], str]:
    """The message about the scales, and which of them is wrong."""
    if stated is None:
        return (
            "scales of encoder and gauge: not shown, as nothing is stated to compare them with (--rig)",
        ), ""
    motor = stated.motor.gain
    encoder = gain / motor
    # The stiffness is torque over angle, so a wrong encoder scale divides it; the
    # product is the ratio of the gauge's scale to the true one.
    bend = stiffness / stated.link.stiffness * encoder
    messages = (
        f"encoder scale: K/J is {encoder:.2g} of what the rig states",
        f"gauge scale: torque over angle is {stiffness / stated.link.stiffness:.2g} of the rig's stiffness",
    )
    if not 1 / _SCALE < encoder < FAR:
        return messages, _encoder_scale(gain, stated)
    if not 1 / _SCALE < bend < _SCALE:
        return messages, (
            f"gauge scale wrong: it shows {bend:.2g} times the torque of a link of "
            f"{stated.link.stiffness:.3g} N·m/rad; check its calibration and the unit of the torque"
        )
    return messages, ""


def _encoder_scale(gain: float, stated: Rig) -> str:
    return (
        f"encoder scale wrong: the motor turns {gain / stated.motor.gain:.2g} times as far as its K/J of "
        f"{stated.motor.gain:.3g} rad/(s²·V) allows; check counts per turn, gear and the unit of the angle"
    )


def _kept(record: Record, channel: Real) -> float:
    """The share of a channel's motion that follows the motor positions reached by the
    doublets.
    """
    place = np.zeros(channel.size)
    for begin in edges_of(record):
        # A doublet leaves the motor where its first half has moved it: a staircase with
        # its steps in the middle of the doublets.
        place[begin + _half(record.period) :] += np.sign(record.voltage[begin])
    matrix = np.column_stack([place, np.ones(channel.size)])
    rest = channel - matrix @ np.linalg.lstsq(matrix, channel, rcond=None)[0]
    whole = float(np.sum((channel - np.mean(channel)) ** 2))
    return 1.0 - float(rest @ rest) / whole if whole > 0 else 0.0


def _step(angle: Real) -> float:
    """The smallest difference of two readings: the resolution of an encoder."""
    apart = np.abs(np.diff(angle))
    # Readings that differ by rounding are equal.
    apart = apart[apart > 1e-12]
    return float(np.min(apart)) if apart.size else 0.0


def _link(
    record: Record, earlier: Record, *, swapped: bool = False
) -> tuple[float, float, float, float, float] | None:
    """Signed gain, its standard error, ω₀, delay and NMSE of a link from the angle to
    the torque, or from the torque to the angle.

    It includes what was recorded `earlier`: a lightly damped link still swings from
    that motion, and with the train alone it looked reversed.
    """
    angle, torque, before = record.angle, record.torque, earlier.angle
    if swapped:
        angle, torque, before = torque, angle, earlier.torque
    try:
        fit = identify(
            Experiment(
                period=record.period,
                motor_angle=angle,
                output=torque,
                earlier_angle=before,
            ),
            "UD-FOM",
            heldout=0.0,
            hold="first",
            details=False,
        )
    except FraclinkError:
        return None
    # A fit without standard errors, for example with its gain at a bound, gets one from
    # its residual.
    error = fit.standard_errors.get("gain", abs(fit.gain) * math.sqrt(fit.nmse))
    return fit.gain, error, fit.model.natural_frequency, fit.delay, fit.nmse


def _swapped(
    record: Record,
    earlier: Record,
    link: tuple[float, float, float, float, float] | None,
) -> bool:
    """Whether the signal read as angle is the response of the link to the signal read
    as torque.
    """
    other = _link(record, earlier, swapped=True)
    # The exchanged fit must be clearly better, since a torque fitted to an angle also
    # explains a little with the signals exchanged.
    reference = 1.0 if link is None else link[4]
    return (
        other is not None
        and other[0] > _SURE * other[1]
        and other[4] < _REVERSED * reference
    )
