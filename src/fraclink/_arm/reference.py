"""References: where the tip or the motor shall be, with velocity and acceleration known exactly.

A reference is a piecewise polynomial of time (or a chirp), so that the law's feed-forward gets the true
acceleration and never a difference of samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._validate import checked_between, checked_whole, is_whole
from fraclink.errors import FieldError, SizeError

__all__ = ["Chirp", "Path", "Reference", "chirp", "hold", "prbs", "pulse", "sampled", "smooth_step"]

Real = NDArray[np.float64]

# Samples of one reference: 2 h at 4 ms, 48 MB of angle, velocity and acceleration.
LONGEST = 2_000_000
# A quintic divides by the fifth power of its duration: beyond these the quotients leave a float's range.
_SHORTEST, _LARGEST = 1e-9, 1e9
_QUINTIC = (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)  # rest to rest, velocity and acceleration continuous


@runtime_checkable
class Reference(Protocol):
    """What every reference offers; times in [s], any shape, kept."""

    @property
    def duration(self) -> float:
        """Time at which its last change ends [s]."""
        ...

    def angle(self, time: ArrayLike) -> Real:
        """Angle [rad]."""
        ...

    def velocity(self, time: ArrayLike) -> Real:
        """Velocity [rad/s]."""
        ...

    def acceleration(self, time: ArrayLike) -> Real:
        """Acceleration [rad/s²]."""
        ...


@dataclass(frozen=True, eq=False)
class Path:
    """A piecewise polynomial: piece i holds from breaks[i] on, in powers of time − breaks[i].

    Attributes: `kind`, a word for plots; `breaks` (n,) [s], rising; `coefficients` (n, m) [rad/s^j];
    `duration` [s]. Before the first break the first piece's constant holds. A jump of the angle has no
    velocity: velocity and acceleration are those of the pieces.
    """

    kind: str
    breaks: Real
    coefficients: Real
    duration: float

    def __post_init__(self) -> None:
        for name in ("breaks", "coefficients"):
            array = np.array(getattr(self, name), dtype=float)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def _evaluated(self, time: ArrayLike, derivative: int) -> Real:
        t = np.asarray(time, dtype=float)
        piece = np.clip(np.searchsorted(self.breaks, t, side="right") - 1, 0, None)
        local = np.maximum(t - self.breaks[piece], 0.0)
        value = np.zeros_like(local)
        for power in range(self.coefficients.shape[1] - 1, derivative - 1, -1):
            value = value * local + math.perm(power, derivative) * self.coefficients[piece, power]
        return value

    def angle(self, time: ArrayLike) -> Real:
        """Return the angle [rad] at `time` [s]."""
        return self._evaluated(time, 0)

    def velocity(self, time: ArrayLike) -> Real:
        """Return the velocity [rad/s] at `time` [s]."""
        return self._evaluated(time, 1)

    def acceleration(self, time: ArrayLike) -> Real:
        """Return the acceleration [rad/s²] at `time` [s]."""
        return self._evaluated(time, 2)

    def then(self, later: Path) -> Path:
        """Return this path followed by `later`, whose angles add to the last angle of this one."""
        end = float(self.angle(self.duration))
        width = max(self.coefficients.shape[1], later.coefficients.shape[1])
        first, second = (
            np.pad(p.coefficients, ((0, 0), (0, width - p.coefficients.shape[1]))) for p in (self, later)
        )
        # What starts later than at once needs this path's rest before it; what starts at once replaces it.
        keep = self.breaks <= self.duration if later.breaks[0] > 0 else self.breaks < self.duration
        second = second + np.eye(1, width) * end
        return Path(
            f"{self.kind}, {later.kind}",
            np.concatenate([self.breaks[keep], self.duration + later.breaks]),
            np.concatenate([first[keep], second]),
            self.duration + later.duration,
        )


@dataclass(frozen=True)
class Chirp:
    """A sine whose frequency rises linearly: a sin(2π(f₀ t + (f₁ − f₀)t²/(2T))), 0 before and after."""

    amplitude: float
    start_frequency_hz: float
    end_frequency_hz: float
    duration: float
    kind: str = "chirp"

    def _phase(self, time: ArrayLike) -> tuple[Real, Real, float, Real]:
        t = np.asarray(time, dtype=float)
        rate = 2 * math.pi * (self.end_frequency_hz - self.start_frequency_hz) / self.duration
        speed = 2 * math.pi * self.start_frequency_hz + rate * t
        phase = 2 * math.pi * self.start_frequency_hz * t + 0.5 * rate * t**2
        inside = np.where((t >= 0) & (t <= self.duration), self.amplitude, 0.0)
        return phase, speed, rate, inside

    def angle(self, time: ArrayLike) -> Real:
        """Return the angle [rad] at `time` [s]."""
        phase, _, _, inside = self._phase(time)
        return np.asarray(inside * np.sin(phase))

    def velocity(self, time: ArrayLike) -> Real:
        """Return the velocity [rad/s] at `time` [s]."""
        phase, speed, _, inside = self._phase(time)
        return np.asarray(inside * speed * np.cos(phase))

    def acceleration(self, time: ArrayLike) -> Real:
        """Return the acceleration [rad/s²] at `time` [s]."""
        phase, speed, rate, inside = self._phase(time)
        return np.asarray(inside * (rate * np.cos(phase) - speed**2 * np.sin(phase)))


def _number(
    field: str, value: float, unit: str, *, positive: bool = False, at_least: float | None = None
) -> float:
    """A number whose powers and quotients a float still holds."""
    low = _SHORTEST if positive else -_LARGEST if at_least is None else at_least
    return checked_between(field, value, low, _LARGEST, unit, remedy="give one number in this range")


def checked_reference(value: object) -> Reference:
    """Return `value` where it is a reference; FieldError for anything else, a number among it."""
    if not isinstance(value, Reference):
        raise FieldError(
            "reference",
            repr(value),
            "no reference",
            allowed="an angle over time",
            remedy="smooth_step, pulse, prbs, chirp and hold make one",
        )
    return value


def smooth_step(amplitude: float, duration: float, start: float = 0.0) -> Path:
    """Return a rest-to-rest move by the quintic θ = a(10x³ − 15x⁴ + 6x⁵), x = (t − start)/duration.

    Velocity and acceleration are continuous; their peaks are 1.875 a/T and 5.774 a/T². Parameters:
    `amplitude` a [rad], `duration` T > 0 [s], `start` ≥ 0 [s]. Raises FieldError.

    >>> move = smooth_step(1.0, 0.5)
    >>> float(move.angle(0.25)), float(move.velocity(0.25)), move.duration
    (0.5, 3.75, 0.5)
    """
    height = _number("amplitude", amplitude, "rad")
    length = _number("duration", duration, "s", positive=True)
    begin = _number("start", start, "s", at_least=0.0)
    row = [height * c / length**power for power, c in enumerate(_QUINTIC)]
    rest = [height] + [0.0] * 5
    return Path("smooth step", np.array([begin, begin + length]), np.array([row, rest]), begin + length)


def pulse(amplitude: float, width: float, start: float = 0.0, *, rise: float = 0.0) -> Path:
    """Return a pulse of `amplitude` [rad] and `width` [s] > 0; its edges take `rise` [s], 0 for jumps.

    >>> bool(pulse(1.0, 7.0).angle(3.0) == 1.0), float(pulse(1.0, 7.0).angle(7.5))
    (True, 0.0)
    """
    height = _number("amplitude", amplitude, "rad")
    wide = _number("width", width, "s", positive=True)
    begin = _number("start", start, "s", at_least=0.0)
    edge = _number("rise", rise, "s", at_least=0.0)
    if edge >= _SHORTEST:
        if edge > wide:
            raise FieldError(
                "rise", edge, "longer than the pulse", allowed=f"<= {wide} s", remedy="widen the pulse"
            )
        up = smooth_step(height, edge, begin)
        path = up.then(smooth_step(-height, edge, wide - edge))
        return Path("pulse", path.breaks, path.coefficients, path.duration)
    return _steps("pulse", [0.0, begin, begin + wide], [0.0, height, 0.0], begin + wide)


def hold(angle: float, duration: float = 0.0) -> Path:
    """Return a constant `angle` [rad] for `duration` [s] ≥ 0, and ever after.

    >>> float(hold(0.3).angle(5.0))
    0.3
    """
    level = _number("angle", angle, "rad")
    return _steps("hold", [0.0], [level], _number("duration", duration, "s", at_least=0.0))


def prbs(amplitude: float, bit: float, *, bits: int = 127, register: int = 7, start: float = 0.0) -> Path:
    """Return a pseudo-random binary sequence ±`amplitude` [rad] of `bits` bits of `bit` [s] each.

    A maximum-length shift register of `register` stages (3 to 12); its sequence repeats after 2^register − 1
    bits and has a flat spectrum up to about 0.44/bit [Hz]. The angle is 0 before `start` [s] and after the
    end.

    >>> path = prbs(0.1, 0.2)
    >>> len(path.breaks), round(path.duration, 1)
    (128, 25.4)
    """
    taps = {3: 2, 4: 3, 5: 3, 6: 5, 7: 6, 9: 5, 10: 7, 11: 9}  # x^n + x^k + 1 is primitive
    if not is_whole(register, 3, 12) or register not in taps:
        raise FieldError(
            "register", register, "not offered", allowed=", ".join(map(str, taps)), remedy="7 gives 127 bits"
        )
    checked_whole("bits", bits, 1, LONGEST)
    height = _number("amplitude", amplitude, "rad")
    length = _number("bit", bit, "s", positive=True)
    begin = _number("start", start, "s", at_least=0.0)
    stages = [1] * register
    levels = [0.0]
    for _ in range(bits):
        levels.append(height if stages[-1] else -height)
        stages = [stages[-1] ^ stages[taps[register] - 1], *stages[:-1]]
    times = [0.0 if begin > 0 else -math.inf, *(begin + length * np.arange(bits + 1))]
    path = _steps("prbs", times, [*levels, 0.0], begin + length * bits)
    if begin > 0:
        return path
    return Path("prbs", path.breaks[1:], path.coefficients[1:], path.duration)


def chirp(amplitude: float, start_frequency_hz: float, end_frequency_hz: float, duration: float) -> Chirp:
    """Return a sine sweep of `amplitude` [rad] from one frequency [Hz] to another in `duration` [s], all > 0.

    >>> round(float(chirp(0.1, 0.1, 5.0, 20.0).angle(0.5)), 4)
    0.0485
    """
    return Chirp(
        _number("amplitude", amplitude, "rad"),
        _number("start_frequency_hz", start_frequency_hz, "Hz", at_least=0.0),
        _number("end_frequency_hz", end_frequency_hz, "Hz", positive=True),
        _number("duration", duration, "s", positive=True),
    )


def sampled(reference: Reference, period: float, count: int) -> Real:
    """Return angle, velocity and acceleration at 0, period, 2 period ..., shape (3, count).

    Raises SizeError above 2 000 000 samples, before memory is taken.
    """
    if count > LONGEST:
        raise SizeError(
            "duration",
            f"{count} samples ({48e-6 * count:.0f} MB)",
            "too long",
            allowed=f"<= {LONGEST} samples",
            remedy="simulate a shorter time or a longer period",
        )
    time = period * np.arange(count)
    return np.array([reference.angle(time), reference.velocity(time), reference.acceleration(time)])


def _steps(kind: str, times: list[float], levels: list[float], duration: float) -> Path:
    return Path(kind, np.array(times), np.array(levels)[:, None], duration)
