"""The whole twin of a rig: link, motor with friction, amplifier and sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

from fraclink._arm.beam import Beam
from fraclink._arm.rig import Motor, Rig
from fraclink._simulate.twin.damping import Damping, FractionalKelvinVoigt, KelvinVoigt, PowerLaw
from fraclink._simulate.twin.plant import LONGEST_STEP, Plant, assemble
from fraclink._simulate.twin.sensors import Sensors
from fraclink._validate import checked_between, checked_noun, checked_whole
from fraclink.errors import FieldError
from fraclink.findings import Finding

if TYPE_CHECKING:
    from fraclink._arm.link import LinkModel

__all__ = ["Twin", "damping_of", "geared"]

# Hub inertia over the arm's below which the compensation of the coupling torque, late by a period and a half,
# feeds the mode more than the inner loop takes from it. Seen on the paper's rig with 8 to 40 g at 4 ms: 0.5 %
# (as printed) and 2 % are unstable, 4.5 % rings at 8 g, 12 % and more hold.
LIGHT_HUB = 0.1

# A model's frequency and equation (5) may differ by what the mass of the link does, up to 17 % at 8 g.
SAME_ARM = 0.2


def geared(rig: Rig, ratio: float = 50.0) -> Rig:
    """Return the rig with its printed motor behind a gear: the hub the twin of the paper's arm needs.

    Table 1 gives J = 6.87e-5 kg·m² and no gear ratio; taken at the gear's output that is 0.5 % of the arm's
    own inertia, and no sampled compensation of the coupling torque holds such a hub (see W601). The text
    names a harmonic drive; 50 is its smallest usual ratio. A = K/(nJ) and the inner loop follow.

    ratio: n, motor turns for one turn of the output, > 0
    """
    checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")
    return replace(rig, motor=replace(rig.motor, gear_ratio=ratio))


def damping_of(model: LinkModel) -> Damping:
    """Return the material whose massless link is the given lumped model.

    UD-FOM is a power law, D-IOM viscous with η = μ/ω₀², D-FOM fractional with η = μ/ω₀², UD-IOM undamped.

    >>> from fraclink._arm.link import LinkModel
    >>> damping_of(LinkModel(stiffness=1.56, natural_frequency=10.0, order=1.92))
    PowerLaw(order=1.92)
    """
    if model.order < 2.0:
        return PowerLaw(model.order)
    factor = model.damping / model.natural_frequency**2
    if model.damping == 0.0 or model.damping_order == 1.0:
        return KelvinVoigt(factor)
    return FractionalKelvinVoigt(factor, model.damping_order)


def _agree(rig: Rig, model: LinkModel) -> None:
    """Refuse a rig whose model is another arm than its length, stiffness and payload make."""
    if model.payload is None:
        return
    lumped = rig.natural_frequency(model.payload)
    if abs(model.natural_frequency / lumped - 1.0) > SAME_ARM:
        raise FieldError(
            "model.natural_frequency",
            model.natural_frequency,
            f"contradicting stiffness, length and payload, which make {lumped:.4g}",
            allowed=f"within {100 * SAME_ARM:g} % of eq. (5)",
            remedy="correct the rig, or give damping= and the beam yourself",
        )


@dataclass(frozen=True)
class Twin:
    """An arm that is not the model.

    Parameters
    ----------
    beam
        link and payload
    damping
        what the link's material does
    motor
        motor and amplifier as in the rig file; its inertia, friction and torques act at the gear's
        output as n²J, n²ν, nΓc and nK V
    sensors
        encoder and gauge
    stiction
        breakaway torque at the motor's side [N·m], >= the Coulomb torque; default 1.2 times that
    voltage_delay
        control periods between reading the sensors and the voltage's effect, 0 to 100
    modes
        number of modes; default as many of the first three as the step resolves
    step
        longest exact step [s]

    >>> from fraclink._arm.rig import Rig
    >>> twin = Twin.from_rig(Rig.named("paper-2023"), link_mass=0.00735)
    >>> [round(w, 1) for w in twin.plant(0.001).modes.frequencies.tolist()]
    [10.8, 202.4, 649.7]
    """

    beam: Beam
    damping: Damping
    motor: Motor
    sensors: Sensors = field(default_factory=Sensors)
    stiction: float | None = None
    voltage_delay: int = 1
    modes: int | None = None
    step: float = LONGEST_STEP

    def __post_init__(self) -> None:
        if self.stiction is not None:
            checked_between(
                "stiction",
                self.stiction,
                self.motor.coulomb_torque,
                1e6,
                "N·m",
                remedy="a motor that slides more easily than it starts has stiction above its friction",
            )
        checked_whole("voltage_delay", self.voltage_delay, 0, 100, "periods")

    @staticmethod
    def from_rig(
        rig: Rig,
        *,
        payload: float | None = None,
        link_mass: float | None = None,
        damping: Damping | None = None,
        rigidity: Literal["stiffness", "tabulated"] = "stiffness",
        gauge_delay: float = 0.0,
        stiction: float | None = None,
        modes: int | None = None,
    ) -> Twin:
        """Return the twin of a rig.

        Parameters
        ----------
        payload, link_mass [kg], rigidity: see `Beam.from_rig`
        damping
            default the material of the rig's model (`damping_of`)
        gauge_delay
            of the strain amplifier [s]
        """
        checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")
        if damping is None:
            if rig.model is None:
                raise FieldError(
                    "damping",
                    None,
                    "missing, and the rig has no model",
                    allowed="KelvinVoigt, FractionalKelvinVoigt or PowerLaw",
                    remedy="give damping=, or a [model] in the rig file",
                )
            _agree(rig, rig.model)
            damping = damping_of(rig.model)
        gauge = rig.gauge
        sensors = Sensors(
            counts_per_revolution=rig.encoder.counts_per_revolution,
            gauge_noise=gauge.noise,
            gauge_offset=gauge.offset,
            gauge_quantum=gauge.quantum,
            gauge_limit=None if math.isinf(gauge.limit) else gauge.limit,
            gauge_delay=gauge_delay,
        )
        return Twin(
            beam=Beam.from_rig(rig, payload=payload, link_mass=link_mass, rigidity=rigidity),
            damping=damping,
            motor=rig.motor,
            sensors=sensors,
            stiction=stiction,
            voltage_delay=rig.inner.delay_samples,
            modes=modes,
        )

    def with_payload(self, payload: float) -> Twin:
        """Return the same arm with another mass [kg] at its tip."""
        return replace(self, beam=self.beam.with_payload(payload))

    @property
    def coulomb(self) -> float:
        """Sliding friction at the gear's output [N·m]."""
        return self.motor.gear_ratio * self.motor.coulomb_torque

    @property
    def breakaway(self) -> float:
        """Stiction at the gear's output [N·m]."""
        # 1.2: the excess of static over sliding friction of greased harmonic drives; the paper gives none.
        at_motor = 1.2 * self.motor.coulomb_torque if self.stiction is None else self.stiction
        return self.motor.gear_ratio * at_motor

    @property
    def hub_inertia(self) -> float:
        """Inertia of motor and hub at the gear's output, n²J [kg·m²]."""
        return self.motor.gear_ratio**2 * self.motor.inertia

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is doubtful about this arm (code W601)."""
        share = self.hub_inertia / self.beam.inertia
        if share >= LIGHT_HUB:
            return ()
        return (
            Finding(
                "W601",
                "warning",
                f"hub inertia {self.hub_inertia:.3g} kg·m² is {100 * share:.2g} % of the arm's "
                f"{self.beam.inertia:.3g} kg·m²: a late compensation of the coupling torque may be unstable",
                {"hub_inertia": self.hub_inertia, "arm_inertia": self.beam.inertia},
                "check whether the rig's J is at the motor's side, and give its gear_ratio",
            ),
        )

    def plant(self, step: float) -> Plant:
        """Return the linear part with the motor's inertia and viscous friction, for steps of `step` [s]."""
        return assemble(
            self.beam,
            self.damping,
            drive="motor",
            modes=self.modes,
            step=step,
            hub_inertia=self.hub_inertia,
            hub_friction=self.motor.gear_ratio**2 * self.motor.viscous_friction,
        )
