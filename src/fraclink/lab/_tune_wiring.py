"""The wiring, found within 5° of motion and before any loop is closed: signs, scales,
liveness, delay.

The arm is pushed with doublets, a voltage and then its opposite, each just a little
stronger than the last, until encoder or gauge answers. A train of such moves is then
fitted: the motor to the angle, the link to the torque. Every sign is a fitted gain with
its standard error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._arm.rig import Rig
from fraclink._files import document
from fraclink._identify import identify
from fraclink.errors import FraclinkError
from fraclink.lab._tune_doublets import edges_of, motor_of_doublets
from fraclink.lab._tune_guard import Guard, Record

__all__ = ["Wiring", "WiringFault", "check_wiring"]

Real = NDArray[np.float64]

# A hundred samples at 4 ms: their deviation is known to 7 %.
_REST = 0.4  # [s] in which the noise of the sensors is measured
# Three seconds, for an arm that somebody has just let go.
_LOOKS = 8  # that an arm may take to come to rest
_STILL = 0.004  # [rad]
# [s] of one half of a doublet: shorter than a quarter vibration of any arm of a
# laboratory
_PULSE = 0.04
_PAUSE = 0.16  # [s] behind it
_FIRST, _GROWTH = (
    0.01,
    1.25,
)  # of the voltage limit; a motion that has just begun must not be 5° the next time
_ANSWER = 0.012  # [rad], 0.7°: the motion that the doublets grow to
_MOST = 0.040  # [rad], 2.3°: grown to this where the gauge does not show the first
# [N·m], at least: where the gauge alone answers, be it with an angle, it must be a
# motion
_FELT = 0.006
_MISSING = 0.5  # of the wanted motion: less is none where the gauge answers
# A motion of fewer counts is known to no better than an eighth, and so is K/J.
_COUNTS = 8  # of an encoder, at least
# What a later, larger try leaves of the motion that the plan states, for the first one.
_LARGER = 1.6
COUNT = _MOST / _LARGER / _COUNTS  # [rad]: the coarsest that shows as many
# A wrong sign closes a loop that runs away: one in two million is allowed to be chance.
_SURE = 5.0  # standard errors that a sign needs
_DEVIATIONS = 8.0  # of the gauge's noise, smoothed, that are an answer
# of a motion that follows the doublets: of an angle about half, of a torque a tenth
_KEPT = 0.3
# of what the link leaves unexplained: with the right wires the reverse leaves more
_REVERSED = 0.6
# standard errors of the torque's gain that a fit over all frequencies does not find in
# noise
_CLEAR = 8.0
# Of both signs, six each: what drifts or drags to one side cancels.
_DOUBLETS = 12
# times the stated K/J: the fit to small motions is within a tenth, payload and gear a
# third off
_FAR = 1.6
# that a stated value may be off: friction, payload and gauge differ by a third, units
# by ten
_SCALE = 2.5
# nmse above which one signal is not the other's link; of noise nothing is explained,
# nmse 1
_EXPLAINED = 0.85


class WiringFault(FraclinkError):
    """A wire, a sign or a scale is not what it must be; the drive is off."""


class _Unsure(WiringFault):
    """What a larger motion may still refute."""


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

    `stated` is what the user says of the arm: scales are compared with its motor and
    its stiffness.
    """
    for _ in range(_LOOKS):
        start = guard.count
        guard.rest(_REST)
        still = guard.record(start)
        # Second differences: an arm that still rings adds nothing to them.
        # Second differences of white noise have six times its variance: 1 + 4 + 1.
        shake, noise = (
            float(np.std(np.diff(x, 2))) / math.sqrt(6.0)
            for x in (still.angle, still.torque)
        )
        turned = float(np.ptp(_smoothed(still.angle)))
        if turned <= _STILL + _DEVIATIONS * shake / math.sqrt(_SMOOTH):
            break
    else:
        raise WiringFault(
            f"the motor turns by {math.degrees(turned):.2g}° at 0 V: the drive is not off, or the arm is "
            "being moved"
        )
    # The gauge's zero is its mean at rest, not its first sample.
    guard.offset += float(np.mean(still.torque))
    # Before the first doublet: six deviations of a coarse encoder's speed would end it.
    guard.allow(shake)
    # What must be seen above noise that a mean of five samples has smoothed.
    answers = (
        max(_ANSWER, _DEVIATIONS * shake / math.sqrt(_SMOOTH)),
        max(_FELT, _DEVIATIONS * noise / math.sqrt(_SMOOTH)),
    )
    pulse = _grown(guard, answers)
    while True:
        record, earlier = _train(guard, pulse)
        guard.release()
        found = _concluded(record, earlier, shake, noise, pulse, stated)
        if isinstance(found, Wiring):
            return found
        moved = float(np.ptp(record.angle))
        if not isinstance(found, _Unsure) or moved > _MOST / _LARGER:
            raise found
        # Grown on from there: a motion that was too small for the noise is made
        # larger, up to 2.3°.
        pulse = _grown(guard, (_LARGER * max(moved, answers[0]), answers[1]), pulse)


def _grown(guard: Guard, answers: tuple[float, float], pulse: float = 0.0) -> float:
    """The voltage of a doublet that encoder [rad] or gauge [N·m] answers by as much."""
    most, (wanted, felt) = guard.limits.voltage, answers
    pulse = max(pulse, _FIRST * most / _GROWTH)
    # Signs alternate, so that what one doublet leaves of motion the next takes back.
    sign, alone = 1.0, 0
    while pulse < most:
        pulse = min(_GROWTH * pulse, most)
        before, (angle, torque) = guard.count, _settled(guard)
        _doublet(guard, sign * pulse)
        sign = -sign
        record = guard.record(before)
        moved = float(np.max(np.abs(_smoothed(record.angle) - angle)))
        # The encoder's own step is looked at each time: it is not known before
        # something moves.
        # Never beyond what the plan says: a coarse encoder is told as one.
        counts = min(_COUNTS * _step(record.angle), _COUNTS * COUNT)
        if moved >= max(wanted, counts):
            return pulse
        # Twice, as one swing of the gauge may be chance.
        answer = float(np.max(np.abs(_smoothed(record.torque) - torque)))
        alone = alone + 1 if answer > felt and moved < _MISSING * wanted else 0
        if alone == 2:
            return pulse
    raise WiringFault(
        f"neither encoder nor gauge answers {most:g} V: drive not enabled, voltage not connected, brake "
        "on, or both sensors dead"
    )


_SMOOTH = 5


def _smoothed(values: Real) -> Real:
    return np.convolve(values, np.full(_SMOOTH, 1 / _SMOOTH), "valid")


def _settled(guard: Guard) -> tuple[float, float]:
    last = guard.record(max(guard.count - 2 * _SMOOTH, 0))
    return float(np.mean(last.angle)), float(np.mean(last.torque))


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
    builds up; and what was recorded before, from rest on.
    """
    guard.rest(0.2)
    start = guard.count
    guard.rest(0.1)
    for k in range(_DOUBLETS):
        _doublet(guard, pulse if k % 2 == 0 else -pulse)
        # Equal pauses would feed a link whose period they are; four different ones feed
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
    moved = float(np.ptp(record.angle))
    degrees = f"{math.degrees(moved):.2g}°"
    # Two counts are what a standing encoder shows between two marks.
    if moved < 3 * step or moved == 0.0:
        return WiringFault(
            f"encoder dead: it stands still while the gauge answers the drive ({pulse:.3g} V) with "
            f"{float(np.ptp(_smoothed(record.torque))):.3g} N·m"
        )
    gain, error, friction, delay = motor_of_doublets(record, _half(record.period))
    # Before the gauge is looked at: with counts of another encoder the torque fits no
    # link either, and would be blamed.
    if stated is not None and gain > _FAR * stated.motor.gain and gain > _SURE * error:
        return WiringFault(_encoder_scale(gain, stated))
    link = _link(record, earlier)
    kept = _kept(record, record.angle), _kept(record, record.torque)
    if kept[1] > max(_KEPT, 2.0 * kept[0]) or (
        kept[1] > max(_KEPT, kept[0]) and _swapped(record, earlier, link)
    ):
        return WiringFault(
            "channels swapped: what is read as the torque stays where the motor was moved to "
            f"({100 * kept[1]:.0f} % of its motion), what is read as the angle does not "
            f"({100 * max(kept[0], 0.0):.0f} %)"
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
    """What is said of the scales, and which of them is wrong."""
    if stated is None:
        return (
            "scales of encoder and gauge: not shown, as nothing is stated to compare them with (--rig)",
        ), ""
    motor = stated.motor.gain
    encoder = gain / motor
    # The stiffness is torque over angle, so that a wrong encoder's scale divides it;
    # the product is the gauge's alone.
    bend = (
        stiffness / stated.link.stiffness * encoder
    )  # the gauge's scale over the true one
    said = (
        f"encoder scale: K/J is {encoder:.2g} of what the rig states",
        f"gauge scale: torque over angle is {stiffness / stated.link.stiffness:.2g} of the rig's stiffness",
    )
    if not 1 / _SCALE < encoder < _FAR:
        return said, _encoder_scale(gain, stated)
    if not 1 / _SCALE < bend < _SCALE:
        return said, (
            f"gauge scale wrong: it shows {bend:.2g} times the torque of a link of "
            f"{stated.link.stiffness:.3g} N·m/rad; check its calibration and the unit of the torque"
        )
    return said, ""


def _encoder_scale(gain: float, stated: Rig) -> str:
    return (
        f"encoder scale wrong: the motor turns {gain / stated.motor.gain:.2g} times as far as its K/J of "
        f"{stated.motor.gain:.3g} rad/(s²·V) allows; check counts per turn, gear and the unit of the angle"
    )


def _kept(record: Record, channel: Real) -> float:
    """The share of a channel's motion that follows the places the doublets move the
    motor to.
    """
    place = np.zeros(channel.size)
    for begin in edges_of(record):
        # A doublet leaves the motor where its first half has thrown it: stairs, each
        # from the doublet's middle on.
        place[begin + _half(record.period) :] += np.sign(record.voltage[begin])
    matrix = np.column_stack([place, np.ones(channel.size)])
    left = channel - matrix @ np.linalg.lstsq(matrix, channel, rcond=None)[0]
    whole = float(np.sum((channel - np.mean(channel)) ** 2))
    return 1.0 - float(left @ left) / whole if whole > 0 else 0.0


def _step(angle: Real) -> float:
    """The smallest difference of two readings, the encoder's count where it has one."""
    apart = np.abs(np.diff(angle))
    # Readings that are equal but for rounding are equal.
    apart = apart[apart > 1e-12]
    return float(np.min(apart)) if apart.size else 0.0


def _link(
    record: Record, earlier: Record, *, swapped: bool = False
) -> tuple[float, float, float, float, float] | None:
    """Gain with its sign, its standard error, ω₀, delay and nmse of the torque as a
    link on that angle, or of the angle on that torque.

    With what was recorded `earlier`: a lightly damped link still swings by that, and of
    the train alone it looked reversed.
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
    # A fit without errors, as of a gain at its bound, is known to what it leaves
    # unexplained.
    error = fit.standard_errors.get("gain", abs(fit.gain) * math.sqrt(fit.nmse))
    return fit.gain, error, fit.model.natural_frequency, fit.delay, fit.nmse


def _swapped(
    record: Record,
    earlier: Record,
    link: tuple[float, float, float, float, float] | None,
) -> bool:
    """Whether what is read as the angle is the link's answer to what is read as the
    torque.
    """
    other = _link(record, earlier, swapped=True)
    # The reverse must explain clearly more: torque on angle, read as angle on torque,
    # fits a little, too.
    left = 1.0 if link is None else link[4]
    return (
        other is not None
        and other[0] > _SURE * other[1]
        and other[4] < _REVERSED * left
    )
