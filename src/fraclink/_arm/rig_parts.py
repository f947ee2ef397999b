"""The parts of a rig: motor, link, payloads, sensors, and their tolerances."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from fraclink.errors import FieldError
from fraclink.findings import Finding
from fracsys.checks import Between, Frequency, Where, above, checked, length
from fracsys.checks.ranges import CHECK_UNIT

__all__ = [
    "DesignDefaults",
    "Encoder",
    "Gauge",
    "Link",
    "Motor",
    "Moves",
    "Payloads",
    "StatedTolerances",
]

# Gram and kilogram differ by 1000, and no arm carries a hundred times its payload
# range.
_ANOTHER_UNIT = 100.0
# Products of a few values within these limits stay far from overflow (1e308) and
# underflow.
_SMALLEST, _LARGEST = 1e-15, 1e15


def positive(unit: str = "", *, remedy: str = CHECK_UNIT) -> Between:
    """Return the range of a quantity that divides or is divided by others."""
    return Between(_SMALLEST, _LARGEST, unit, remedy=remedy)


def at_least_zero(unit: str = "", *, remedy: str = CHECK_UNIT) -> Between:
    """Return the range of a quantity that may be absent."""
    return Between(0.0, _LARGEST, unit, remedy=remedy)


def _limit(unit: str) -> Between:
    return Between(_SMALLEST, math.inf, unit, finite=False)


def _is_unicode(text: str) -> bool:
    return not any(0xD800 <= ord(character) <= 0xDFFF for character in text)


_UNICODE = Where(
    _is_unicode,
    "Unicode text",
    "not valid Unicode (a lone surrogate)",
    "remove that character",
)
Name = Annotated[str, length(1, 100), _UNICODE]
Source = Annotated[str, length(0, 500), _UNICODE]
Sentence = Annotated[str, length(1, 500), _UNICODE]


@checked(prefix="moves.")
@dataclass(frozen=True)
class Moves:
    """The largest move the arm is meant to make; the law's guards treat anything far
    beyond it as a fault.

    The default covers 1 rad in 0.4 s along the quintic of `smooth_step` (4.7 rad/s, 36
    rad/s²).

    Parameters
    ----------
    angle
        of the reference and the motor reference, to either side of `centre` [rad], > 0;
        a law does not start beyond it.
    velocity, acceleration
        of the reference [rad/s], [rad/s²], > 0.
    torque
        of the link [N·m], > 0, at which the motor is held; if infinite, it follows from
        the other limits.
    vibration
        of the tip [rad], > 0: if a vibration exceeds it on both sides and does not
        decay, the motor is held. None: a vibration of 0.05 rad is only flagged.
    centre
        what the encoder reads in the middle of `angle` [rad].
    rest_torque
        what the gauge reads with the arm at rest [N·m]: offset and gravity, which do
        not count as bending.

    Raises
    ------
    FieldError
        a value out of its range.

    Examples
    --------
    >>> Moves().velocity
    6.0
    """

    angle: Annotated[float, above(0.0, 1e6, "rad")] = math.tau
    velocity: Annotated[float, above(0.0, 1e6, "rad/s")] = 6.0
    acceleration: Annotated[float, above(0.0, 1e6, "rad/s²")] = 60.0
    torque: Annotated[float, _limit("N·m")] = math.inf
    vibration: Annotated[float | None, positive("rad")] = None
    centre: Annotated[float, Between(-1e6, 1e6, "rad")] = 0.0
    rest_torque: Annotated[float, Between(-_LARGEST, _LARGEST, "N·m")] = 0.0


@checked(prefix="motor.")
@dataclass(frozen=True)
class Motor:
    """The motor with its servo-amplifier and gear, eq. (1) of the source paper.

    With everything but `gear_ratio` n referred to the motor's side of the gear,

        J n θm'' + ν n θm' = K V − sign(θm') Γc − Γ/n,      θm/V = A/(s(s + B)),  A = K/(nJ),  B = ν/J

    where θm is the angle of the gear's output. With n = 1 this is eq. (1).

    Parameters
    ----------
    inertia
        J [kg·m²], > 0.
    viscous_friction
        ν [N·m·s], >= 0.
    torque_constant
        K [N·m/V], > 0: motor torque for one volt at the amplifier's input.
    gear_ratio
        n, motor turns for one turn of the output, > 0; 1 where J, ν, K are already at the output.
    coulomb_torque
        Γc [N·m], >= 0, at the motor.
    voltage_limit
        |V| that the amplifier accepts [V], > 0; infinity where there is none.

    Raises
    ------
    FieldError
        a value out of its range.

    References
    ----------
    Benftima, Gharab, Feliu-Batlle (2023), eq. (1), Table 1.

    Examples
    --------
    >>> motor = Motor(inertia=6.87e-5, viscous_friction=1.041e-3, torque_constant=0.21)
    >>> round(motor.gain, 4), round(motor.decay, 6)
    (3056.7686, 15.152838)
    """

    inertia: Annotated[float, positive("kg·m²")]
    viscous_friction: Annotated[float, at_least_zero("N·m·s")]
    torque_constant: Annotated[float, positive("N·m/V")]
    gear_ratio: Annotated[float, positive()] = 1.0
    coulomb_torque: Annotated[float, at_least_zero("N·m")] = 0.0
    voltage_limit: Annotated[float, _limit("V")] = math.inf

    @property
    def gain(self) -> float:
        """A = K/(nJ) [rad/(V·s²)] of eq. (1)."""
        return self.torque_constant / (self.gear_ratio * self.inertia)

    @property
    def decay(self) -> float:
        """B = ν/J [1/s] of eq. (1)."""
        return self.viscous_friction / self.inertia


@checked(prefix="link.")
@dataclass(frozen=True)
class Link:
    """The flexible link: length L [m], flexural rigidity EI [N·m²], measured stiffness
    c [N·m/rad] > 0.

    One of c and EI may be left out; it then follows from c = 3EI/L, eq. (3) for a
    uniform beam. The `mass` [kg] is the link's own: the lumped models neglect it, the twin
    does not.

    >>> round(Link(length=0.65, flexural_rigidity=0.260).stiffness, 12)
    1.2
    >>> round(Link(length=0.65, stiffness=1.2).flexural_rigidity, 12)
    0.26
    """

    # No arm is 100 m long; the space station's measures 17 m.
    length: Annotated[float, Between(_SMALLEST, 100.0, "m", remedy=CHECK_UNIT)]
    # None means "not measured" in the call only: the attributes are always numbers.
    flexural_rigidity: Annotated[float, positive("N·m²")] = None  # type: ignore[assignment]
    stiffness: Annotated[float, positive("N·m/rad")] = None  # type: ignore[assignment]
    mass: Annotated[float, at_least_zero("kg")] = 0.0

    def __post_init__(self) -> None:
        if self.stiffness is None and self.flexural_rigidity is None:
            raise FieldError(
                "link.stiffness",
                "(nothing)",
                "missing",
                "a stiffness [N·m/rad] or EI [N·m²]",
                "state stiffness, or flexural_rigidity",
            )
        if self.flexural_rigidity is None:
            # Eq. (3), c = 3 EI/L: whichever was measured, the torque at rest is the
            # same in the twin and in the lumped model.
            object.__setattr__(
                self, "flexural_rigidity", self.stiffness * self.length / 3.0
            )
        if self.stiffness is None:
            object.__setattr__(self, "stiffness", self.beam_stiffness)

    @property
    def tip_mass(self) -> float:
        """The equivalent mass of the link at its tip [kg], 33/140 of its own
        (Rayleigh).
        """
        # A cantilever with a force at its end deflects by (3x² − x³)/2 of the tip
        # deflection at x; the integral of the square over the length is 33/140.
        return 33.0 / 140.0 * self.mass

    @property
    def beam_stiffness(self) -> float:
        """3EI/L [N·m/rad], the stiffness of a uniform beam clamped at the motor."""
        return 3 * self.flexural_rigidity / self.length


@checked(prefix="payloads.")
@dataclass(frozen=True)
class Payloads:
    """The payloads that the arm carries: lightest, heaviest and nominal mass [kg], low
    <= nominal <= high; and the mass of the empty gripper, at most the lightest.

    The default nominal payload is the mean of the two. If the empty gripper's mass is
    not stated, a design assumes 0.4 of the lightest payload.

    >>> Payloads(low=0.020, high=0.040).nominal
    0.03
    """

    low: Annotated[float, positive("kg")]
    high: Annotated[float, positive("kg")]
    # None means "the mean" in the call only.
    nominal: Annotated[float, positive("kg")] = None  # type: ignore[assignment]
    empty: Annotated[float, positive("kg")] | None = None

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise FieldError(
                "payloads.low",
                self.low,
                f"above payloads.high = {self.high:g} kg",
                "low <= nominal <= high [kg]",
                "exchange the two",
            )
        if self.empty is not None and self.empty > self.low:
            raise FieldError(
                "payloads.empty",
                self.empty,
                "above the lightest payload",
                f"at most {self.low:g} kg",
                "give what the gripper weighs at the tip without a load",
            )
        if self.nominal is None:
            object.__setattr__(self, "nominal", 0.5 * (self.low + self.high))
        if not self.low <= self.nominal <= self.high:
            raise FieldError(
                "payloads.nominal",
                self.nominal,
                "outside the payload range",
                f"{self.low:g} … {self.high:g} kg",
                "choose a nominal payload between low and high",
            )

    def doubt(self, payload: float) -> Finding | None:
        """Return finding W105 where a payload [kg] is so far off the range that its
        unit must be wrong.

        >>> finding = Payloads(low=0.020, high=0.040, nominal=0.030).doubt(30)
        >>> finding.message
        'a payload of 30 kg is 750 times the heaviest that the rig states'
        """
        # In both directions: if a rig states grams as kilograms, a correct payload
        # looks too light.
        if self.low / _ANOTHER_UNIT <= payload <= self.high * _ANOTHER_UNIT:
            return None
        nearest, word = (
            (self.high, "heaviest") if payload > self.high else (self.low, "lightest")
        )
        return Finding(
            "W105",
            "error",
            f"a payload of {payload:.4g} kg is {payload / nearest:.3g} times the {word} that the rig states",
            {"payload": payload, "low": self.low, "high": self.high},
            "payloads are stated in kg: 30 g is 0.030",
        )


@checked(prefix="encoder.")
@dataclass(frozen=True)
class Encoder:
    """The encoder at the gear's output: counts per turn, or None for an exact one.

    >>> round(Encoder(counts_per_revolution=4096).resolution, 6)
    0.001534
    """

    counts_per_revolution: Annotated[int | None, Between(1, 10**15)] = None

    @property
    def resolution(self) -> float:
        """Angle of one count [rad]; 0 where the encoder is taken as exact."""
        return (
            0.0
            if self.counts_per_revolution is None
            else math.tau / self.counts_per_revolution
        )


@checked(prefix="gauge.")
@dataclass(frozen=True)
class Gauge:
    """The strain gauges at the base of the link, calibrated as coupling torque.

    Parameters
    ----------
    noise
        standard deviation of the noise of one sample [N·m], >= 0.
    offset
        constant added to every reading [N·m].
    limit
        largest |torque| that the amplifier outputs [N·m], > 0; infinity where there is
        none.
    quantum
        step of the converter [N·m], >= 0; 0 where it is taken as exact.
    delay_in_loop
        whether the delay identified between motor angle and torque is in the control
        loop; False if only the logger is late, not the signal that the controller
        reads.

    Examples
    --------
    >>> Gauge(noise=0.01).limit
    inf
    """

    noise: Annotated[float, at_least_zero("N·m")] = 0.0
    offset: Annotated[float, Between(-_LARGEST, _LARGEST, "N·m")] = 0.0
    limit: Annotated[float, _limit("N·m")] = math.inf
    quantum: Annotated[float, at_least_zero("N·m")] = 0.0
    delay_in_loop: bool = True


@checked(prefix="design.")
@dataclass(frozen=True)
class DesignDefaults:
    """Defaults of a design for this rig: the `[design]` table.

    `gain_crossover` [rad/s] and `phase_margin_deg` [°] are minima over the payload
    range; `filter_time` δ [s] is 0 for no filter and None to choose it with the
    controller.

    >>> round(DesignDefaults(gain_crossover=12.0, phase_margin_deg=50.0).phase_margin, 6)
    0.872665
    """

    gain_crossover: Frequency
    phase_margin_deg: Annotated[float, above(0.0, 179.0, "°")]
    filter_time: Annotated[float | None, at_least_zero("s")] = None

    @property
    def phase_margin(self) -> float:
        """Least phase margin [rad]."""
        return math.radians(self.phase_margin_deg)


@checked(prefix="tolerances.")
@dataclass(frozen=True)
class StatedTolerances:
    """Tolerances of the arm relative to its model: the least that a proof covers,
    even if the intervals of a fit are narrower.

    natural_frequency, gauge_gain and motor_pole are relative [1]; order λ is absolute
    [1]; gauge_delay is the largest delay beyond the identified one [s]. The defaults
    are those of a careful laboratory: 3 % of ω₀², a strain gauge calibrated to 5 %,
    an undeclared delay of half a period of 4 ms.

    >>> StatedTolerances().order
    0.03
    """

    natural_frequency: Annotated[float, Between(0.0, 0.5)] = 0.015
    order: Annotated[float, Between(0.0, 0.5)] = 0.03
    gauge_gain: Annotated[float, Between(0.0, 0.9)] = 0.05
    gauge_delay: Annotated[float, Between(0.0, 1.0, "s")] = 0.002
    motor_pole: Annotated[float, Between(0.0, 0.9)] = 0.10
