"""The wiring check, within 5° of motion and before any loop is closed: signs, scales,
function of the sensors, delay.

The arm is moved by doublets, a voltage followed by its opposite, each slightly larger
than the last, until the encoder responds. A train of such moves is then fitted: the
motor to the angle, the link to the torque. Every sign is a fitted gain with its standard
error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._arm.rig import Rig
from fraclink._files import document
from fraclink._identify import identify
from fraclink.errors import FraclinkError
from fraclink.lab._tune_doublets import PULSE, edges_of, motor_of_doublets
from fraclink.lab._tune_guard import RECOVERY, Guard, LimitReached, Record, largest
from fracsys.checks import Real

__all__ = ["FAR", "Wiring", "WiringFault", "check_wiring"]


# [s] in which the noise of the sensors is measured: the standard deviation of a hundred
# samples (4 ms) is accurate to 7 %.
_REST = 0.4
# share of the voltage limit; growth: a motion that has just begun must not reach 5° at
# the next doublet
_FIRST, _GROWTH = (0.01, 1.25)
# [rad], 0.7°: size of motion at which the doublets stop growing, half of what the plan
# allows them
_ANSWER = 0.012
# [rad], 2.3°: farthest from where the arm stood
MOST = 0.040
# [rad/s²] at the voltage limit, the strongest motor that is expected if none is stated:
# a geared one that reaches 12 rad/s with a time constant of 40 ms
STRONGEST = 300.0
# counts of an encoder, at least: with fewer, the motion, and thus K/J, is known to no
# better than an eighth
_COUNTS = 8
# The plan states the largest motion; this factor leaves room for a later, larger
# attempt.
_LARGER = 1.6
COUNT = MOST / _LARGER / _COUNTS  # [rad]: the coarsest encoder with that many counts
_PULLED = (
    f"small doublets take the motor {math.degrees(MOST):.2g}° from where it stood: its weight, a cable or a "
    "spring pulls it; take that away, or level the arm"
)
# Standard errors required of a sign: a wrong sign closes a loop that runs away; the
# probability of chance is one in two million.
SURE = 5.0
# Six of each sign: drift or drag to one side cancels.
_DOUBLETS = 12
# multiple of a stated or an earlier value: the fit to small motions is accurate to a
# tenth, payload and gear may differ by a third
FAR = 1.6


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
    gain
        of the motor, a first guess: A = K/J [rad/(s²·V)].
    delay
        from a voltage to the motion [s].
    stiffness, natural_frequency
        of the link, a first guess [N·m/rad], [s^(-λ/2)].
    gauge_delay
        by which the torque lags the motor angle [s].
    gauge_noise, encoder_noise
        standard deviations at rest [N·m], [rad].
    encoder_step
        smallest difference of two readings [rad].
    evidence
        sentences, one for each conclusion.
    """

    gain: float
    delay: float
    stiffness: float
    natural_frequency: float
    gauge_delay: float
    gauge_noise: float
    encoder_noise: float
    encoder_step: float
    evidence: tuple[str, ...]

    @property
    def count(self) -> float:
        """Step of the encoder [rad], or if larger, the step whose rounding, s/√12, is
        its noise."""
        return max(self.encoder_step, math.sqrt(12.0) * self.encoder_noise)


def check_wiring(
    guard: Guard, stated: Rig | None, tell: Callable[[str], None] = lambda line: None
) -> Wiring:
    """Find signs, scales and delays with small motions; `WiringFault` where one is
    wrong.

    `stated` is the user's description of the arm: scales are compared with its motor
    and stiffness. `tell` as in `tune_motor`.
    """
    # Samples of a mean: half of a doublet's half, short enough to keep its motion.
    width = max(1, round(0.5 * PULSE / guard.period))
    for _ in range(math.ceil(RECOVERY / _REST)):
        start = guard.count
        guard.rest(_REST)
        still = guard.record(start)
        # Second differences, to which an arm that still rings adds almost nothing. For
        # white noise they have six times its variance: 1 + 4 + 1.
        shake, noise = (
            float(np.std(np.diff(x, 2))) / math.sqrt(6.0)
            for x in (still.angle, still.torque)
        )
        angle = np.ptp(_smoothed(still.angle, width))
        # A drift by a tenth of the doublets changes what they show by no more than the
        # error of their fit.
        if angle <= 0.1 * MOST + SURE * shake / math.sqrt(width):
            break
    else:
        raise WiringFault(
            f"the motor turns by {math.degrees(angle):.2g}° at 0 V: the drive is not off, its weight pulls it "
            "(the axis must be upright), or the arm is being moved"
        )
    # The zero of the gauge is its mean at rest, not its first sample.
    guard.offset += float(np.mean(still.torque))
    # Before the first doublet, which the noise of a coarse encoder's speed would
    # otherwise end.
    guard.allow(shake)
    strongest = (
        STRONGEST if stated is None else FAR * stated.motor.gain * guard.limits.voltage
    )
    doublets = partial(_Doublets, guard, still, shake, strongest, width)
    motion = partial(_checked, guard, start, doublets, noise, stated)
    return guard.sized(motion, noise, tell)[0]


def _checked(
    guard: Guard,
    start: int,
    smallest: Callable[[], _Doublets],
    noise: float,
    stated: Rig | None,
    size: float,
) -> Wiring:
    """The wiring, from doublets that are `size` times as large; `noise` of the gauge
    [N·m]; the last rest began in period `start`.
    """
    doublets = smallest()
    goal, largest = max(size * _ANSWER, doublets.clear), size * MOST / _LARGER
    fault = WiringFault(_PULLED)
    try:
        while doublets.grow(goal):
            record, earlier = doublets.train()
            _refuse_swapped(guard, start)
            try:
                return _concluded(record, earlier, noise, doublets, stated)
            except _Unsure as unsure:
                fault = unsure
            if goal >= largest or not doublets.room:
                break
            # Continue with larger doublets, for a motion that the noise hides; the last
            # one may exceed its goal by one growth.
            goal = min(_LARGER * goal, largest)
        raise fault
    except (WiringFault, LimitReached):
        # Swapped channels may look like anything: each has the other's scale and limit.
        _refuse_swapped(guard, start)
        raise


class _Doublets:
    """Doublets about the place where the arm stood, each larger than the last. Internal,
    mutable.

    Until the encoder has shown a motion, which the guard needs, a half is no longer
    than the strongest motor takes to reach `MOST` or the speed limit.
    """

    def __init__(
        self,
        guard: Guard,
        still: Record,
        shake: float,
        strongest: float,
        width: int,
    ) -> None:
        self._guard, self._strongest, self._width = guard, strongest, width
        self._start, self._first = guard.count, float(np.mean(still.angle))
        # An answer must exceed the noise of the difference of two means, one over `width`,
        # the other over twice that.
        self.shake, self.clear = shake, SURE * shake * math.sqrt(1.5 / width)
        self._swing = float(np.var(still.torque))
        self._longest = max(2, round(PULSE / guard.period))
        self.voltage, self.half, self._sign = 0.0, self._longest, 1
        self.travel, self._apart, self._seen = 0.0, 0.0, False

    def once(self) -> Record:
        """The record of one doublet."""
        guard, before = self._guard, self._guard.count
        angle = float(np.mean(guard.record(max(before - 2 * self._width, 0)).angle))
        for part in (self._sign, -self._sign):
            for _ in range(self.half):
                guard.step(part * self.voltage)
        guard.rest(4 * PULSE)
        # Signs alternate, so that each doublet cancels the remaining motion of the last
        # one.
        self._sign = -self._sign
        record = guard.record(before)
        self.travel = largest(_smoothed(record.angle, self._width) - angle)
        self._apart = float(np.mean(record.angle[-self._width :])) - self._first
        return record

    def grow(self, goal: float) -> bool:
        """Enlarge the doublets until one moves the encoder by `goal` [rad], if the
        voltage suffices; return whether there is room for more of them.
        """
        while self._enlarged():
            record = self.once()
            if not self.room:
                return False
            # The resolution of the encoder is determined each time, since it is unknown
            # before something moves; but never beyond the plan, so that a coarse
            # encoder is reported as such.
            count = min(_step(record.angle), COUNT)
            self._seen = self._seen or self.travel > max(self.clear, count)
            if self.travel >= max(goal, _COUNTS * count):
                return True
        if self._seen:
            return True
        # The mean square of n samples scatters by √(2/n).
        torque = self._guard.record(self._start).torque
        noise = self._swing * (1.0 + SURE * math.sqrt(2.0 / torque.size))
        if np.var(torque) <= noise:
            limits = self._guard.limits
            beyond = (
                f"; more could take the motor beyond {limits.speed:g} rad/s within a period: if friction holds it, "
                "raise that limit"
                if self.voltage < limits.voltage
                else ""
            )
            raise WiringFault(
                f"neither encoder nor gauge answers {self.voltage:.3g} V: drive not enabled, voltage not "
                "connected, brake on, both sensors dead, or the encoder dead and the gauge "
                f"noisy{beyond}"
            )
        raise WiringFault(
            "encoder dead, or its channel is the gauge's: it shows no motion while the other channel answers "
            f"the drive ({self.voltage:.3g} V) with "
            f"{np.ptp(_smoothed(torque, self._width)):.3g} N·m"
        )

    def _enlarged(self) -> bool:
        """Whether the next doublet is larger: longer, or with more voltage."""
        most = self._guard.limits.voltage
        if self._seen:
            # As the last doublet has shown, with the same acceleration in both halves.
            shown = max(self.travel, 1e-12) / (self.half * self._guard.period) ** 2
            if (longer := self._longest_half(shown, MOST / _LARGER)) > self.half:
                self.half = longer
                return True
        if self.voltage == most:
            return False
        voltage = min(max(_GROWTH * self.voltage, _FIRST * most), most)
        strongest = self._strongest * voltage / most
        half = self.half if self._seen else self._longest_half(strongest, MOST)
        if half > 0:
            self.voltage, self.half = voltage, half
        return half > 0

    def _longest_half(self, acceleration: float, travel: float) -> int:
        """Periods in which a motor with that `acceleration` [rad/s²] neither exceeds the
        speed limit nor, with the other half, the `travel` [rad].
        """
        speed = self._guard.limits.speed
        duration = min(math.sqrt(travel / acceleration), speed / acceleration)
        return min(int(duration / self._guard.period), self._longest)

    @property
    def room(self) -> bool:
        """Whether a doublet of either sign stays within the plan, as far as the noise
        shows.
        """
        return 0.5 * abs(self._apart) + max(self.travel - self.clear, 0.0) <= MOST

    def train(self) -> tuple[Record, Record]:
        """Doublets with pauses of different lengths, so that no vibration builds up; and
        the earlier record since the last rest.
        """
        guard = self._guard
        guard.rest(0.2)
        start = guard.count
        guard.rest(0.1)
        for k in range(_DOUBLETS):
            if not self.room:
                break
            self.once()
            # Equal pauses would excite a link with that period; four different ones
            # excite none.
            guard.rest(0.05 * (k % 4))
        guard.rest(0.3)
        guard.release()
        return guard.record(start), guard.record(0, start)


def _smoothed(values: Real, width: int) -> Real:
    return np.convolve(values, np.full(width, 1 / width), "valid")


def _concluded(
    record: Record,
    earlier: Record,
    noise: float,
    doublets: _Doublets,
    stated: Rig | None,
) -> Wiring:
    degrees = f"{math.degrees(np.ptp(record.angle)):.2g}°"
    link = _link(record.period, record.angle, record.torque, earlier.angle)
    gain, error, delay = motor_of_doublets(
        record, doublets.half, 0.0 if link is None else max(link[3], 0.0)
    )
    # Checked before the gauge: with the counts of another encoder the torque would not
    # fit a link either, and would be blamed. FAR is allowed for each of two measured
    # values (here the gain and, downwards only, the friction; then stiffness and gain);
    # wrong units are off by ten.
    if (
        stated is not None
        and abs(gain) > SURE * error
        and not 1 / FAR**2 < abs(gain) / stated.motor.gain < FAR
    ):
        raise WiringFault(
            f"encoder scale wrong: the motor turns {abs(gain) / stated.motor.gain:.2g} times as far as its K/J of "
            f"{stated.motor.gain:.3g} rad/(s²·V) allows; check counts per turn, gear and the unit of the angle"
        )
    if link is None or abs(link[0]) < SURE * link[1]:
        share = "nothing" if link is None else f"{100 * (1 - link[4]):.0f} %"
        raise _Unsure(
            f"gauge dead: the motor's motion of {degrees} explains {share} of its signal; its noise is "
            f"{noise:.2g} N·m"
        )
    stiffness, spread, frequency, gauge_delay, nmse = link
    voltage = f"{doublets.voltage:.3g} V turns the encoder by {degrees}, K/J = {gain:+.3g} ± {error:.1g} rad/(s²·V)"
    if abs(gain) < SURE * error:
        # A train that ended for want of room is too short for its signs.
        raise _Unsure(
            f"signs not sure: {voltage}, at {math.degrees(_step(record.angle)):.2g}° a count; a finer or quieter "
            "encoder, or less play in the gear, helps"
            if doublets.room
            else _PULLED
        )
    bend = f"torque over angle {stiffness:+.3g} ± {spread:.1g} N·m/rad, {100 * (1 - nmse):.0f} % explained"
    if min(gain, stiffness) < 0:
        wrong = "gauge" if gain > 0 else "encoder" if stiffness < 0 else "motor"
        raise WiringFault(
            f"{wrong} reversed: {voltage}, and {bend}; turn the {wrong}'s sign (the same is seen where the other "
            "two are both reversed)"
        )
    return Wiring(
        gain=gain,
        delay=delay,
        stiffness=stiffness,
        natural_frequency=frequency,
        gauge_delay=gauge_delay,
        gauge_noise=noise,
        encoder_noise=doublets.shake,
        encoder_step=_step(record.angle),
        evidence=(
            f"encoder and voltage: right, {voltage}",
            f"gauge: right, alive, {bend}, noise {noise:.2g} N·m at rest",
            f"delay: {1e3 * delay:.2g} ms from voltage to motion, {1e3 * gauge_delay:.2g} ms of the gauge",
            *_scales(gain, stiffness, stated),
        ),
    )


def _scales(gain: float, stiffness: float, stated: Rig | None) -> tuple[str, ...]:
    """The message about the scales, or the fault of a wrong one."""
    if stated is None:
        return (
            "scales of encoder and gauge: not shown, as nothing is stated to compare them with (--rig)",
        )
    encoder = gain / stated.motor.gain
    # The stiffness is torque over angle, so a wrong encoder scale divides it; the
    # product is the ratio of the gauge's scale to the true one.
    bend = stiffness / stated.link.stiffness * encoder
    messages = (
        f"encoder scale: K/J is {encoder:.2g} of what the rig states",
        f"gauge scale: torque over angle is {stiffness / stated.link.stiffness:.2g} of the rig's stiffness",
    )
    if not 1 / FAR**2 < bend < FAR**2:
        raise WiringFault(
            f"gauge scale wrong: it shows {bend:.2g} times the torque of a link of "
            f"{stated.link.stiffness:.3g} N·m/rad; check its calibration and the unit of the torque"
        )
    return messages


def _refuse_swapped(guard: Guard, start: int) -> None:
    """Raise `WiringFault` if the record from `start` on shows swapped channels.

    Either channel may be the motor's, which stands between the doublets, and the other
    one the link's response to it: the more likely way round has the smaller product of
    the two unexplained shares.
    """
    guard.release()
    record = guard.record(start)
    link = _link(record.period, record.angle, record.torque)
    other = _link(record.period, record.torque, record.angle)
    if other is None or abs(other[0]) < SURE * other[1]:
        return
    straight = (1.0 if link is None else link[4]) * _unsettled(record, record.angle)
    swapped = other[4] * _unsettled(record, record.torque)
    if swapped < straight:
        raise WiringFault(
            "channels swapped: what is read as the torque stays where the motor was moved to, and turns what "
            f"is read as the angle: {100 * swapped:.0f} % of both remain unexplained, the other way round "
            f"{100 * straight:.0f} %"
        )


def _unsettled(record: Record, channel: Real) -> float:
    """The share of a channel's mean square that is motion while the motor stands."""
    # In the second half of every pause: the delay, at most `PULSE`, and coasting end in
    # the first.
    half = np.ones(round(2 * PULSE / record.period))
    driven = np.convolve(record.voltage != 0.0, half)
    standing = np.flatnonzero(driven[: channel.size] == 0.0)
    pause = np.searchsorted(edges_of(record), standing, side="right")
    values = channel[standing]
    means = np.bincount(pause, values) / np.maximum(np.bincount(pause), 1)
    whole = float(np.var(values))
    return float(np.var(values - means[pause])) / whole if whole > 0.0 else 1.0


def _step(angle: Real) -> float:
    """The smallest difference of two readings: the resolution of an encoder."""
    apart = np.abs(np.diff(angle))
    # Readings that differ by rounding are equal.
    apart = apart[apart > 1e-12]
    return float(np.min(apart)) if apart.size else 0.0


def _link(
    period: float, angle: Real, torque: Real, earlier: Real | None = None
) -> tuple[float, float, float, float, float] | None:
    """Signed gain, its standard error, ω₀, delay and NMSE of a link from the angle to
    the torque.

    It includes the angle that was recorded `earlier`: a lightly damped link still
    swings from that motion, and with the train alone it looked reversed.
    """
    try:
        fit = identify(
            Experiment(
                period=period,
                motor_angle=angle,
                output=torque,
                earlier_angle=earlier,
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
    # Either channel may be sampled first, but neither shows a motion before it happens:
    # a vibration that leads is one of the opposite sign that lags by the rest of half
    # its period, like that of the second mode with a late gauge. For a slow first mode,
    # half a period is longer than the delay of any gauge, and the lead is an error of
    # the fit.
    gain, delay, opposite = (
        fit.gain,
        fit.delay,
        fit.delay + math.pi / fit.model.resonance,
    )
    if delay < -period and opposite <= PULSE:
        gain, delay = -gain, opposite
    return gain, error, fit.model.natural_frequency, delay, fit.nmse
