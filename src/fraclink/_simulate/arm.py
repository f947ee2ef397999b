"""The twin of a rig: link, motor with friction, amplifier and sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Annotated

from fraclink._arm.beam import Beam
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Encoder, Gauge, Motor, Rig
from fraclink._simulate.damping import (
    Damping,
    FractionalKelvinVoigt,
    KelvinVoigt,
    PowerLaw,
)
from fraclink._simulate.plant import (
    LONGEST_STEP,
    Plant,
    assemble,
)
from fraclink.errors import FieldError, required
from fraclink.findings import Finding
from fracsys.checks import (
    Between,
    Positive,
    Time,
    checked,
)

__all__ = ["Twin", "damping_of", "geared"]

# Ratio of the hub's inertia to the arm's, below which the compensation of the coupling
# torque, delayed by 1.5 periods, feeds more energy into the mode than the motor loop
# removes. On the paper's rig with 8 to 40 g at 4 ms, 0.5 % (as printed) and 2 % are
# unstable, 4.5 % rings at 8 g, and 12 % or more is stable.
LIGHT_HUB = 0.1

# The model's frequency may differ from that of equation (5) by the effect of the link's
# mass: 9 % for the default link with 8 g, 15 % for one of 12.5 g.
SAME_ARM = 0.2


@checked
def geared(rig: Rig, ratio: Positive = 50.0) -> Rig:
    """Return the rig with a gear on its motor as printed: the twin of the paper's arm
    needs the larger hub inertia.

    Table 1 gives J = 6.87e-5 kg·m² and no gear ratio; taken at the gear's output that
    is 0.5 % of the arm's own inertia, and no sampled compensation of the coupling
    torque stabilises such a hub (see W601). The text names a harmonic drive; 50 is its
    smallest usual ratio. A = K/(nJ) and the motor loop change with it.

    ratio: n, motor turns for one turn of the output, > 0
    """
    return replace(rig, motor=replace(rig.motor, gear_ratio=ratio))


@checked
def damping_of(model: LinkModel) -> Damping:
    """Return the material whose massless link is the given lumped model.

    UD-FOM is a power law, D-IOM viscous with η = μ/ω₀², D-FOM fractional with η =
    μ/ω₀², UD-IOM undamped. Where both λ < 2 and μ damp, a dashpot beside the power law
    has the loss of μ s^α at the pole.

    >>> from fraclink._arm.link import LinkModel
    >>> damping_of(LinkModel(stiffness=1.56, natural_frequency=10.0, order=1.92))
    PowerLaw(order=1.92, higher=None, dashpot=0.0)
    """
    if model.order < 2.0:
        # Newton's s² in place of s^λ multiplies μ s^α by s^(2−λ).
        power = model.damping_order + 2.0 - model.order
        loss = math.sin(0.5 * math.pi * power) * model.resonance ** (power - 1.0)
        return PowerLaw(model.order, dashpot=model.loss * loss)
    if model.damping == 0.0 or model.damping_order == 1.0:
        return KelvinVoigt(model.loss)
    return FractionalKelvinVoigt(model.loss, model.damping_order)


def _agree(rig: Rig, model: LinkModel) -> None:
    """Reject a rig whose model contradicts its length, stiffness and payload."""
    # A model without a known payload cannot contradict one.
    if model.payload is None:
        return
    frequency = rig.natural_frequency(model.payload)
    if abs(model.natural_frequency / frequency - 1.0) > SAME_ARM:
        raise FieldError(
            "model.natural_frequency",
            float(f"{model.natural_frequency:.4g}"),
            f"contradicting stiffness, length and payload, which give {frequency:.4g}",
            f"within {100 * SAME_ARM:g} % of that",
            "correct these in the rig; in Python, damping= and a beam may be given instead",
        )


@checked
@dataclass(frozen=True)
class Twin:
    """A simulated arm, with the effects that the model leaves out.

    Parameters
    ----------
    beam
        link and payload
    damping
        damping law of the link's material
    motor
        motor and amplifier as in the rig file; its inertia, friction and torques act at
        the gear's output as n²J, n²ν, nΓc and nK V
    encoder, gauge
        the rig's; the gauge reads gauge_gain times the torque of gauge_delay [s] ago, 0
        to 100 periods
    voltage_delay
        control periods between reading the sensors and the voltage's effect, 0 to 100
    modes
        number of modes; default as many of the first three as the step resolves
    step
        longest exact step [s]
    stiction
        ratio of static to sliding friction; the paper states none, 1.2 is usual for a
        greased harmonic drive

    >>> from fraclink._arm.rig import Rig
    >>> twin = Twin.from_rig(Rig.named("paper-2023"), link_mass=0.00735)
    >>> [round(w, 1) for w in twin.plant(0.001).modes.frequencies.tolist()]
    [10.8, 202.4, 649.7]
    """

    beam: Beam
    damping: Damping
    motor: Motor
    encoder: Encoder = field(default_factory=Encoder)
    gauge: Gauge = field(default_factory=Gauge)
    gauge_delay: Time = 0.0
    gauge_gain: Annotated[float, Between(-1e6, 1e6)] = 1.0
    voltage_delay: Annotated[int, Between(0, 100, "periods")] = 1
    modes: int | None = None
    step: float = LONGEST_STEP
    stiction: Annotated[float, Between(1.0, 100.0)] = 1.2

    @staticmethod
    @checked
    def from_rig(
        rig: Rig,
        *,
        model: LinkModel | None = None,
        payload: float | None = None,
        link_mass: float | None = None,
        damping: Damping | None = None,
        modes: int | None = None,
    ) -> Twin:
        """Return the twin of a rig.

        Parameters
        ----------
        payload, link_mass [kg]: see `Beam.from_rig`
        model
            the identified link; default: the rig's own
        damping
            default: the model's material (`damping_of`)

        Delay and gain of the gauge are the model's: the same bend gives the same
        reading as in the log.
        """
        link = rig.model if model is None else model
        if damping is None:
            link = required(
                "damping",
                link,
                "KelvinVoigt, FractionalKelvinVoigt or PowerLaw",
                "give damping=, or a [model] in the rig file",
            )
            _agree(rig, link)
            damping = damping_of(link)
        # A fit expresses a delayed motor angle as a leading gauge; a real gauge never
        # leads.
        # A torque log only determines the product of stiffness and gain; the beam has
        # the rig's stiffness.
        late, gain = (
            (
                link.gauge_lag,
                link.gauge_gain * link.stiffness / rig.link.stiffness,
            )
            if link
            else (0.0, 1.0)
        )
        return Twin(
            beam=Beam.from_rig(rig, payload=payload, link_mass=link_mass),
            damping=damping,
            motor=rig.motor,
            encoder=rig.encoder,
            gauge=rig.gauge,
            gauge_delay=late,
            gauge_gain=gain,
            voltage_delay=rig.motor_loop.delay_samples,
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
        return self.stiction * self.coulomb

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
        """Return the linear part with the motor's inertia and viscous friction, for
        steps of `step` [s].
        """
        return assemble(
            self.beam,
            self.damping,
            modes=self.modes,
            step=step,
            hub_inertia=self.hub_inertia,
            hub_friction=self.motor.gear_ratio**2 * self.motor.viscous_friction,
        )

    @property
    def vibration_period(self) -> float:
        """Period of the first mode with its damping [s]."""
        frequency = float(self.beam.modes(1).frequencies[0])
        # With a power law ω is not in rad/s: the mode is at ω^(2/λ), where |s²| = ω²
        # |D(s)|.
        if isinstance(self.damping, PowerLaw):
            frequency = frequency ** (2.0 / self.damping.order)
        return math.tau / frequency
