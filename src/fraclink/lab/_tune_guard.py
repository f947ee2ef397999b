"""The limits of a tuning and the guard that enforces them: it checks every voltage
before it is sent.
"""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Annotated, TypeVar

import numpy as np

from fraclink.errors import FraclinkError
from fraclink.lab._line import ArmLine, Reading
from fracsys.checks import Between, Real, checked

Found = TypeVar("Found")

__all__ = ["Guard", "LimitReached", "MotionLimits", "Record"]


# Share of the limits that a stage plans to use. The rest is for noise, overshoot, a
# gauge that reads too low, and for coming to rest after the guard has switched the
# drive off.
PLANNED = 0.6
# Shares of the limits, since a voltage takes effect one or two periods later. At the
# first, no voltage accelerates the motor any further, and angle or torque switches the
# drive off; at the second, the speed does.
_TRIP, _SPEED_TRIP = (0.8, 0.95)
RECOVERY = 5.0  # [s] at most until a swing has decayed, and the arm is at rest
# [s] in which the link's ringing shows beside the gauge's noise: the standard deviation of
# 150 samples (4 ms) scatters by 6 %, and includes vibrations with periods up to twice
# this window.
WINDOW = 0.6
# shares of the planned motion, tried if it reaches a limit: torque falls with size and
# speed
_SIZES = (1.0, 0.5, 0.25)


def largest(values: Real) -> float:
    """Return the largest size of some values."""
    return float(np.max(np.abs(values)))


class LimitReached(FraclinkError):
    """A limit would have been exceeded; the drive is off."""


@checked
@dataclass(frozen=True)
class MotionLimits:
    """How far, how fast and how hard an arm may be moved while it is tuned.

    Parameters
    ----------
    angle
        of the motor, to each side of where it stands at the start [rad], at least 10°.
    speed
        of the motor at the gear's output [rad/s].
    torque
        of the link as the gauge reads it, beyond its reading at rest [N·m].
    voltage
        at the amplifier's input [V].

    Examples
    --------
    >>> MotionLimits(angle=0.5, speed=3.0, torque=2.0, voltage=5.0).angle
    0.5
    """

    angle: Annotated[float, Between(math.radians(10.0), 1e3, "rad")]
    speed: Annotated[float, Between(1e-3, 1e4, "rad/s")]
    torque: Annotated[float, Between(1e-6, 1e6, "N·m")]
    voltage: Annotated[float, Between(1e-3, 1e4, "V")]


@dataclass(frozen=True, eq=False)
class Record:
    """One value per period, shape (N,): motor angle [rad] and torque [N·m], both relative
    to the start, and the voltage [V] sent in response.
    """

    period: float
    voltage: Real
    angle: Real
    torque: Real

    @property
    def duration(self) -> float:
        """[s]."""
        return self.period * len(self.angle)


class Guard:
    """Passes voltages on to the arm, keeps the record, and ends the session before a
    limit is exceeded.

    The connection to the arm is opened whenever it is needed and closed by `release`.
    The angle limit applies to the position at which the arm would come to rest if the
    drive were switched off now: at the present speed for the loop's delay and then
    coasting, `coast` [s] times the speed. `shake` is the speed that the encoder's noise
    alone may show [rad/s].
    """

    def __init__(
        self,
        opened: Callable[[], AbstractContextManager[tuple[ArmLine, Reading]]],
        limits: MotionLimits,
    ) -> None:
        # A geared motor coasts for a few hundredths of a second: with ν/J of 5 to 20
        # 1/s alone it would be 50 to 200 ms, but friction stops it sooner.
        self.limits, self.coast, self.shake = limits, 0.05, 0.0
        self._driven, self._gain = False, 0.0
        # the voltage that acted last, and those still in transit
        self._sent: deque[float] = deque([0.0], maxlen=1)
        self._opened, self._stack, self._line = opened, contextlib.ExitStack(), None
        self._rows: list[tuple[float, float, float]] = []
        # rows at which the connection to the arm was opened
        self.starts: list[int] = []
        self.lost = 0  # samples that did not arrive in time
        self.reading = self.connect()
        self.origin, self.offset = self.reading.angle, self.reading.torque

    _line: ArmLine | None

    def connect(self) -> Reading:
        """Open the connection to the arm if it is closed, and return the newest
        reading.
        """
        if self._line is None:
            self._line, self.reading = self._stack.enter_context(self._opened())
            self.starts.append(len(self._rows))
            self.period = self._line.period
            self._before = self.reading.angle
        return self.reading

    def release(self) -> None:
        """Switch the drive off and close the connection, since nothing controls the arm
        during computations.
        """
        self._line = None
        self._stack.close()

    @property
    def angle(self) -> float:
        """Newest motor angle relative to the start [rad], with the connection opened if
        necessary: a swinging link turns a motor that is off.
        """
        return self.connect().angle - self.origin

    @property
    def torque(self) -> float:
        """Newest torque relative to that at rest [N·m]."""
        return self.reading.torque - self.offset

    @property
    def count(self) -> int:
        """Periods so far."""
        return len(self._rows)

    def step(self, voltage: float) -> Reading:
        """Send one voltage [V], clipped to the limit, and return the next reading."""
        self.connect()
        # an arm that has not been moved yet breaks no limit, whatever its sensors read
        if self._driven:
            self._check()
        most = self.limits.voltage
        # NaN would be sent unclipped, since comparisons with it are false.
        sent = min(max(voltage, -most), most) if math.isfinite(voltage) else 0.0
        sent = self._slowed(sent)
        self._sent.append(sent)
        self._driven = self._driven or sent != 0.0
        last = self.reading
        reading = self._line.exchange(sent)  # type: ignore[union-attr]  # connected above
        self.lost += reading.periods - 1
        self._sent.extend([sent] * (reading.periods - 1))  # the arm held the voltage
        # lost samples are replaced by linear interpolation to the next one
        for k in range(reading.periods):
            part = k / reading.periods
            angle = last.angle + part * (reading.angle - last.angle)
            self._rows.append(
                (sent, angle, last.torque + part * (reading.torque - last.torque))
            )
        self._before, self.reading = last.angle, reading
        return reading

    def learn(self, gain: float, delay: float) -> None:
        """Use K/J [rad/(s²·V)] and the delay [s] for prediction: no voltage is sent
        that would drive the motor beyond the speed limit when it takes effect.
        """
        # A delay of 4.1 ms is one period of 4 ms plus the error of the fit, not two
        # periods.
        count = max(1, math.ceil(delay / self.period - 0.1))
        self._gain, self._sent = gain, deque([0.0] * (count + 1), maxlen=count + 1)

    @property
    def speed(self) -> float:
        """Speed at the newest sample [rad/s]: the difference of the last two, plus the
        effect of the voltage since.
        """
        # A mean over more samples would miss a fast vibration.
        turned = self.reading.angle - self._before
        mean = turned / (self.reading.periods * self.period)
        return mean + 0.5 * self._gain * self.period * self._sent[0]

    def _slowed(self, voltage: float) -> float:
        # The motor is unknown before its first doublets, which are small anyway.
        if self._gain <= 0.0:
            return voltage
        step = self._gain * self.period
        # Voltages in transit cannot be called back.
        speed = self.speed + step * (sum(self._sent) - self._sent[0])
        most = _TRIP * self.limits.speed
        # Zero is always allowed: the guard limits requested voltages, but never drives
        # the arm itself.
        low, high = min((-most - speed) / step, 0.0), max((most - speed) / step, 0.0)
        return min(max(voltage, low), high)

    def allow(self, noise: float) -> None:
        """Allow for an encoder with this noise [rad]: six standard deviations of the
        speed.
        """
        self.shake = 6.0 * math.sqrt(2.0) * noise / self.period

    def rest(self, seconds: float) -> None:
        """Keep the drive at 0 V."""
        for _ in range(math.ceil(seconds / self.period)):
            self.step(0.0)

    def quiet(self, noise: float, longest: float) -> None:
        """Keep the drive at 0 V until the link rings less than the gauge's noise [N·m],
        or `longest` [s].
        """
        window = math.ceil(WINDOW / self.period)
        last = self.count + math.ceil(longest / self.period)
        self.rest(WINDOW)
        # A tenth above the noise, so that its scatter does not pass for ringing.
        while (
            self.count < last
            and np.std([row[2] for row in self._rows[-window:]]) > 1.1 * noise
        ):
            self.rest(WINDOW / 4)

    def sized(
        self,
        motion: Callable[[float], Found],
        noise: float,
        tell: Callable[[str], None],
    ) -> tuple[Found, float]:
        """The result of a motion and its size: 1, or if it reaches a limit, a half and
        then a quarter; `noise` of the gauge [N·m].
        """
        for size in _SIZES[:-1]:
            try:
                return motion(size), size
            except LimitReached as error:
                tell(f"{error}; once more, half as large")
                # Unguarded until the arm rests, since nothing is driven.
                self.release()
                self._driven = False
                self.quiet(noise, RECOVERY)
                self.release()
        return motion(_SIZES[-1]), _SIZES[-1]

    def record(self, start: int = 0, end: int | None = None) -> Record:
        """The record from period `start` to `end`."""
        voltage, angle, torque = np.array(self._rows[start:end]).reshape(-1, 3).T
        return Record(
            self.period, voltage.copy(), angle - self.origin, torque - self.offset
        )

    def _check(self) -> None:
        limits, speed = self.limits, self.speed
        # A coarse encoder at rest shows speeds of one count per period, which are not
        # motion.
        speed -= math.copysign(min(abs(speed), self.shake), speed)
        # The position at which the arm would come to rest: checked at the present
        # position, a limit would be passed before it is noticed.
        ends = self.angle + speed * (self.coast + 2 * self.period)
        for name, value, most, unit in (
            ("angle", ends, limits.angle, "rad"),
            ("speed", speed, limits.speed, "rad/s"),
            ("torque", self.torque, limits.torque, "N·m"),
        ):
            # Written so that NaN also stops.
            if not abs(value) <= (_SPEED_TRIP if name == "speed" else _TRIP) * most:
                raise LimitReached(
                    f"{name}: {value:.3g} {unit} is about to exceed the limit of {most:g} {unit}; the drive "
                    "is off"
                )
