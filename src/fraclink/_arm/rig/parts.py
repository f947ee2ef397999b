"""The parts of a rig: motor, link, payloads, sensors and the inner loop that is asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from fraclink._arm.rig.quantities import Quantity, check_fields
from fraclink.errors import FieldError
from fraclink.findings import Finding

__all__ = ["DesignRequest", "Encoder", "Gauge", "Inner", "Link", "Motor", "Payloads"]

# Gram and kilogram are 1000 apart, and no arm carries payloads a hundred times beyond its own range.
_ANOTHER_UNIT = 100.0


@dataclass(frozen=True)
class Motor:
    """The motor with its servo-amplifier and gear, eq. (1) of the source paper.

    With everything but `gear_ratio` n referred to the motor's side of the gear,

        J n θm'' + ν n θm' = K V − sign(θm') Γc − Γ/n,      θm/V = A/(s(s + B)),  A = K/(nJ),  B = ν/J

    where θm is the angle of the gear's output. With n = 1 this is eq. (1).

    Arguments:
        inertia: J [kg·m²], > 0.
        viscous_friction: ν [N·m·s], >= 0.
        torque_constant: K [N·m/V], > 0: motor torque for one volt at the amplifier's input.
        gear_ratio: n, motor turns for one turn of the output, > 0; 1 where J, ν, K are already at the output.
        coulomb_torque: Γc [N·m], >= 0, at the motor.
        voltage_limit: |V| that the amplifier accepts [V], > 0; infinity where there is none.

    Raises FieldError. Source: Benftima, Gharab, Feliu-Batlle (2023), eq. (1), Table 1.

    >>> motor = Motor(inertia=6.87e-5, viscous_friction=1.041e-3, torque_constant=0.21)
    >>> round(motor.gain, 4), round(motor.decay, 6)
    (3056.7686, 15.152838)
    """

    inertia: Annotated[float, Quantity("inertia_kg_m2", "kg·m²", above=0)]
    viscous_friction: Annotated[float, Quantity("viscous_friction_Nm_s", "N·m·s", at_least=0)]
    torque_constant: Annotated[float, Quantity("torque_constant_Nm_per_V", "N·m/V", above=0)]
    gear_ratio: Annotated[float, Quantity("gear_ratio", "", above=0)] = 1.0
    coulomb_torque: Annotated[float, Quantity("coulomb_torque_Nm", "N·m", at_least=0)] = 0.0
    voltage_limit: Annotated[float, Quantity("voltage_limit_V", "V", above=0, may_be_infinite=True)] = (
        math.inf
    )

    def __post_init__(self) -> None:
        check_fields(self, "motor")

    @property
    def gain(self) -> float:
        """A = K/(nJ) [rad/(V·s²)] of eq. (1)."""
        return self.torque_constant / (self.gear_ratio * self.inertia)

    @property
    def decay(self) -> float:
        """B = ν/J [1/s] of eq. (1)."""
        return self.viscous_friction / self.inertia


@dataclass(frozen=True)
class Link:
    """The flexible link.

    Arguments:
        length: L [m], > 0.
        flexural_rigidity: EI [N·m²], > 0.
        stiffness: measured c [N·m/rad], > 0; None takes c = 3EI/L of a uniform beam.
        mass: mass of the link itself [kg], >= 0; the lumped models neglect it, the twin does not.

    Raises FieldError. Source: Benftima et al. (2023), section 2.2, eq. (3).

    >>> round(Link(length=0.65, flexural_rigidity=0.260).stiffness, 12)
    1.2
    """

    length: Annotated[float, Quantity("length_m", "m", above=0)]
    flexural_rigidity: Annotated[float, Quantity("flexural_rigidity_Nm2", "N·m²", above=0)]
    # None stands for "not measured" in the call only: the attribute is always a number.
    stiffness: Annotated[float, Quantity("stiffness_Nm_per_rad", "N·m/rad", above=0)] = None  # type: ignore[assignment]
    mass: Annotated[float, Quantity("mass_kg", "kg", at_least=0)] = 0.0

    def __post_init__(self) -> None:
        unmeasured = self.stiffness is None
        if unmeasured:
            object.__setattr__(self, "stiffness", 1.0)  # replaced below, once EI and L are known to be good
        check_fields(self, "link")
        if unmeasured:
            object.__setattr__(self, "stiffness", self.beam_stiffness)

    @property
    def beam_stiffness(self) -> float:
        """3EI/L [N·m/rad], the stiffness of a uniform beam clamped at the motor."""
        return 3 * self.flexural_rigidity / self.length


@dataclass(frozen=True)
class Payloads:
    """The payloads that the arm carries: lightest, heaviest and nominal mass [kg], all > 0.

    Raises FieldError where they are not in the order low <= nominal <= high.

    >>> Payloads(low=0.020, high=0.040, nominal=0.030).nominal
    0.03
    """

    low: Annotated[float, Quantity("low_kg", "kg", above=0)]
    high: Annotated[float, Quantity("high_kg", "kg", above=0)]
    nominal: Annotated[float, Quantity("nominal_kg", "kg", above=0)]

    def __post_init__(self) -> None:
        check_fields(self, "payloads")
        if self.low > self.high:
            raise FieldError(
                "payloads.low",
                self.low,
                f"above payloads.high = {self.high:g} kg",
                allowed="low <= nominal <= high [kg]",
                remedy="exchange the two",
            )
        if not self.low <= self.nominal <= self.high:
            raise FieldError(
                "payloads.nominal",
                self.nominal,
                "outside the payload range",
                allowed=f"{self.low:g} … {self.high:g} kg",
                remedy="choose a nominal payload between low and high",
            )

    def doubt(self, payload: float) -> Finding | None:
        """Return finding W105 where a payload [kg] is so far off the range that its unit must be wrong.

        >>> finding = Payloads(low=0.020, high=0.040, nominal=0.030).doubt(30)
        >>> finding.message
        'a payload of 30 kg is 750 times the heaviest that the rig states'
        """
        if self.low / _ANOTHER_UNIT <= payload <= self.high * _ANOTHER_UNIT:
            return None
        above = payload > self.high
        share = payload / self.high if above else payload / self.low
        return Finding(
            "W105",
            "warning",
            f"a payload of {payload:.4g} kg is {share:.3g} times the {'heaviest' if above else 'lightest'} "
            "that the rig states",
            {"payload": payload, "low": self.low, "high": self.high},
            "payloads are stated in kg: 30 g is 0.030",
        )


@dataclass(frozen=True)
class Encoder:
    """The encoder of the gear's output: counts for one turn, or None where it is taken as exact.

    >>> round(Encoder(counts_per_revolution=4096).resolution, 6)
    0.001534
    """

    counts_per_revolution: Annotated[
        int | None, Quantity("counts_per_revolution", "", at_least=1, integer=True)
    ] = None

    def __post_init__(self) -> None:
        check_fields(self, "encoder")

    @property
    def resolution(self) -> float:
        """Angle of one count [rad]; 0 where the encoder is taken as exact."""
        return 0.0 if self.counts_per_revolution is None else 2 * math.pi / self.counts_per_revolution


@dataclass(frozen=True)
class Gauge:
    """The strain gauges at the base of the link, calibrated as coupling torque.

    Arguments:
        noise: standard deviation of the noise of one sample [N·m], >= 0.
        offset: constant added to every reading [N·m].
        limit: largest |torque| that the amplifier shows [N·m], > 0; infinity where there is none.
        quantum: step of the converter [N·m], >= 0; 0 where it is taken as exact.

    Raises FieldError.

    >>> Gauge(noise=0.01).limit
    inf
    """

    noise: Annotated[float, Quantity("noise_Nm", "N·m", at_least=0)] = 0.0
    offset: Annotated[float, Quantity("offset_Nm", "N·m")] = 0.0
    limit: Annotated[float, Quantity("limit_Nm", "N·m", above=0, may_be_infinite=True)] = math.inf
    quantum: Annotated[float, Quantity("quantum_Nm", "N·m", at_least=0)] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "gauge")


@dataclass(frozen=True)
class Inner:
    """The inner loop that is asked for, eq. (19)–(21): M(s) = 1/(1 + s/pole)².

    Arguments:
        pole: p [rad/s], > 0; the four closed-loop poles lie at −p.
        delay_samples: samples between reading the sensors and the drive's answer, 0 to 100.

    Raises FieldError.

    >>> Inner().pole
    80.0
    """

    pole: Annotated[float, Quantity("pole_rad_per_s", "rad/s", above=0)] = 80.0
    delay_samples: Annotated[
        int, Quantity("delay_samples", "samples", at_least=0, at_most=100, integer=True)
    ] = 1

    def __post_init__(self) -> None:
        check_fields(self, "inner_loop")


@dataclass(frozen=True)
class DesignRequest:
    """What a design for this rig is asked for where the user does not say: the `[design]` table.

    Arguments:
        gain_crossover: least gain crossover over the payload range [rad/s], > 0.
        phase_margin_deg: least phase margin over the payload range [degrees], above 0 and below 180.
        filter_time: δ [s], >= 0; 0 for no filter, None for the 10 % rule.

    Raises FieldError.

    >>> round(DesignRequest(gain_crossover=12.0, phase_margin_deg=50.0).phase_margin, 6)
    0.872665
    """

    gain_crossover: Annotated[float, Quantity("gain_crossover_rad_per_s", "rad/s", above=0)]
    phase_margin_deg: Annotated[float, Quantity("phase_margin_deg", "°", above=0, at_most=179)]
    filter_time: Annotated[float | None, Quantity("filter_time_s", "s", at_least=0)] = None

    def __post_init__(self) -> None:
        check_fields(self, "design")

    @property
    def phase_margin(self) -> float:
        """Least phase margin [rad]."""
        return math.radians(self.phase_margin_deg)
