"""The twin of a rig: link, motor with friction, amplifier and sensors; and the logs
that it records.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.beam import Beam
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Motor, Rig
from fraclink._files import write_text
from fraclink._simulate.damping import (
    Damping,
    FractionalKelvinVoigt,
    KelvinVoigt,
    PowerLaw,
)
from fraclink._simulate.plant import (
    LONGEST_STEP,
    Plant,
    StepMatrices,
    assemble,
    substeps,
)
from fraclink._simulate.sensors import Sensors
from fraclink.errors import FieldError, SizeError
from fraclink.findings import Finding
from fracsys.checks import (
    Array,
    Between,
    Frequency,
    Period,
    Positive,
    Seed,
    Time,
    checked,
)

__all__ = ["Twin", "TwinLog", "damping_of", "geared", "simulate_log"]

Vector = NDArray[np.float64]

MOST_SAMPLES = 2_000_000  # two hours at 4 ms

# Hub inertia over the arm's below which the compensation of the coupling torque, late
# by a period and a half, feeds the mode more than the motor loop takes from it. Seen on
# the paper's rig with 8 to 40 g at 4 ms: 0.5 % (as printed) and 2 % are unstable, 4.5 %
# rings at 8 g, 12 % and more hold.
LIGHT_HUB = 0.1

# A model's frequency and equation (5) may differ by what the mass of the link does, up
# to 17 % at 8 g.
SAME_ARM = 0.2


@checked
def geared(rig: Rig, ratio: Positive = 50.0) -> Rig:
    """Return the rig with its printed motor behind a gear: the hub the twin of the
    paper's arm needs.

    Table 1 gives J = 6.87e-5 kg·m² and no gear ratio; taken at the gear's output that
    is 0.5 % of the arm's own inertia, and no sampled compensation of the coupling
    torque holds such a hub (see W601). The text names a harmonic drive; 50 is its
    smallest usual ratio. A = K/(nJ) and the motor loop follow.

    ratio: n, motor turns for one turn of the output, > 0
    """
    return replace(rig, motor=replace(rig.motor, gear_ratio=ratio))


@checked
def damping_of(model: LinkModel) -> Damping:
    """Return the material whose massless link is the given lumped model.

    UD-FOM is a power law, D-IOM viscous with η = μ/ω₀², D-FOM fractional with η =
    μ/ω₀², UD-IOM undamped.

    >>> from fraclink._arm.link import LinkModel
    >>> damping_of(LinkModel(stiffness=1.56, natural_frequency=10.0, order=1.92))
    PowerLaw(order=1.92)
    """
    if model.order < 2.0:
        return PowerLaw(model.order)
    # (15) and (16) have μ s^α beside ω₀²: divided by ω₀² it is D − 1, whatever the
    # payload is.
    factor = model.damping / model.natural_frequency**2
    if model.damping == 0.0 or model.damping_order == 1.0:
        return KelvinVoigt(factor)
    return FractionalKelvinVoigt(factor, model.damping_order)


def _agree(rig: Rig, model: LinkModel) -> None:
    """Refuse a rig whose model is another arm than its length, stiffness and payload
    make.
    """
    # A model that does not know its payload cannot contradict one.
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


@checked
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
        motor and amplifier as in the rig file; its inertia, friction and torques act at
        the gear's output as n²J, n²ν, nΓc and nK V
    sensors
        encoder and gauge
    stiction
        breakaway torque at the motor's side [N·m], >= the Coulomb torque; default 1.2
        times that
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
    voltage_delay: Annotated[int, Between(0, 100, "periods")] = 1
    modes: int | None = None
    step: float = LONGEST_STEP

    def __post_init__(self) -> None:
        if self.stiction is not None:
            remedy = "a motor that slides more easily than it starts has stiction above its friction"
            breakaway = Between(self.motor.coulomb_torque, 1e6, "N·m", remedy=remedy)
            breakaway.check("stiction", self.stiction)

    @staticmethod
    @checked
    def from_rig(
        rig: Rig,
        *,
        model: LinkModel | None = None,
        payload: float | None = None,
        link_mass: float | None = None,
        damping: Damping | None = None,
        gauge_delay: Time | None = None,
        gauge_gain: float | None = None,
        stiction: float | None = None,
        modes: int | None = None,
    ) -> Twin:
        """Return the twin of a rig.

        Parameters
        ----------
        payload, link_mass [kg]: see `Beam.from_rig`
        model
            the link as it was identified; the rig's own where it is left out
        damping
            default the material of the model (`damping_of`)
        gauge_delay, gauge_gain
            of the strain amplifier [s], [1]; what was identified where they are left
            out
        """
        link = rig.model if model is None else model
        if damping is None:
            if link is None:
                raise FieldError(
                    "damping",
                    None,
                    "missing",
                    allowed="KelvinVoigt, FractionalKelvinVoigt or PowerLaw",
                    remedy="give damping=, or a [model] in the rig file",
                )
            _agree(rig, link)
            damping = damping_of(link)
        gauge = rig.gauge
        sensors = Sensors(
            counts_per_revolution=rig.encoder.counts_per_revolution,
            gauge_noise=gauge.noise,
            gauge_offset=gauge.offset,
            gauge_quantum=gauge.quantum,
            gauge_limit=None if math.isinf(gauge.limit) else gauge.limit,
            # A gauge that leads is the fit's way to say that the motor angle is late;
            # no arm runs ahead.
            gauge_delay=max(link.gauge_delay if link else 0.0, 0.0)
            if gauge_delay is None
            else gauge_delay,
            gauge_gain=(link.gauge_gain if link else 1.0)
            if gauge_gain is None
            else gauge_gain,
        )
        return Twin(
            beam=Beam.from_rig(rig, payload=payload, link_mass=link_mass),
            damping=damping,
            motor=rig.motor,
            sensors=sensors,
            stiction=stiction,
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
        # 1.2: the excess of static over sliding friction of greased harmonic drives;
        # the paper gives none.
        at_motor = (
            1.2 * self.motor.coulomb_torque if self.stiction is None else self.stiction
        )
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
        """Return the linear part with the motor's inertia and viscous friction, for
        steps of `step` [s].
        """
        return assemble(
            self.beam,
            self.damping,
            drive="motor",
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
        return 2.0 * math.pi / frequency


# ── logs
# ────────────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True)
class TwinLog:
    """A recorded move of the twin.

    time [s], motor_angle [rad] and torque [N·m] are what the sensors gave;
    true_motor_angle, tip_angle [rad] and true_torque [N·m] what was there. `header`
    holds the lines of the file's head.
    """

    time: Vector
    motor_angle: Vector
    torque: Vector
    true_motor_angle: Vector
    tip_angle: Vector
    true_torque: Vector
    header: Mapping[str, str]

    def text(self) -> str:
        """Return the file's text: ``# key: value`` lines, names with units, one row per
        sample.
        """
        lines = [f"# {key}: {value}" for key, value in self.header.items()]
        lines.append("time_s,motor_angle_rad,torque_Nm")
        # Nine digits: a thousandth of the finest quantum, and short files.
        rows = np.column_stack([self.time, self.motor_angle, self.torque]).tolist()
        lines += [f"{t:.9g},{a:.9g},{g:.9g}" for t, a, g in rows]
        return "\n".join(lines) + "\n"

    def save(self, path: Path | str) -> None:
        """Write the log as CSV, complete or not at all."""
        write_text(path, self.text())


@checked
def simulate_log(
    beam: Beam,
    damping: Damping,
    reference: Annotated[Vector, Array(1, finite=False, min_size=2)],
    *,
    period: Period = 0.004,
    sensors: Sensors | None = None,
    modes: int | None = None,
    step: float = LONGEST_STEP,
    motor_loop_pole: Frequency = 80.0,
    seed: Seed = 0,
    title: str = "",
) -> TwinLog:
    """Simulate a recorded move: the hub follows a reference, the link swings, the
    sensors look.

    Parameters
    ----------
    reference
        hub reference, one value per period [rad], shape (N,): held over the period, and
        followed through M(s) = 1/(1 + s/p)², equation (21).
    sensors
        imperfections; default none
    modes
        modes of the link; default as many of the first three as `step` resolves
    step
        longest exact step [s], at most 1 ms
    seed
        of the gauge's noise

    >>> import numpy as np
    >>> from fraclink._simulate import PowerLaw
    >>> rod = Beam(0.65, 0.338, 0.00735, 0.030)
    >>> log = simulate_log(rod, PowerLaw(1.92), np.full(251, 0.1))
    >>> round(float(log.motor_angle[-1]), 6), bool(abs(log.tip_angle[-1] - 0.1) < 0.05)
    (0.1, True)
    """
    if reference.size > MOST_SAMPLES:
        raise SizeError(
            "reference",
            reference.size,
            "too long",
            allowed=f"{MOST_SAMPLES} samples",
            remedy="simulate a shorter log",
        )
    # After the size: a month of samples takes a gigabyte to look through.
    if not np.isfinite(reference).all():
        raise FieldError(
            "reference",
            "NaN",
            "not finite",
            allowed="finite",
            remedy="check the reference",
        )
    sensors = Sensors() if sensors is None else sensors
    count = substeps(period, step)
    fine = period / count
    plant = assemble(
        beam,
        damping,
        drive="servo",
        modes=modes,
        step=fine,
        motor_loop_pole=motor_loop_pole,
    )
    outputs = _march(plant.discretise(fine), reference, count)
    angle, tip, torque = outputs[:, 0], outputs[:, 2], outputs[:, 3]
    # Delayed at the fine steps, then sampled: a delay of half a period is not to be
    # rounded to one.
    delayed = sensors.delayed(torque, fine)[::count]
    generator = np.random.default_rng(seed)
    hub = angle[::count].copy()
    time = np.round(period * np.arange(reference.size), 9)
    return TwinLog(
        time=time,
        motor_angle=sensors.encoder(hub),
        torque=sensors.gauge(delayed, period=period, generator=generator),
        true_motor_angle=hub,
        tip_angle=tip[::count].copy(),
        true_torque=torque[::count].copy(),
        header=_header(
            beam,
            damping,
            sensors,
            plant.modes.frequencies,
            period,
            fine,
            motor_loop_pole,
            seed,
            title,
        ),
    )


def _march(matrices: StepMatrices, reference: Vector, count: int) -> Vector:
    """Outputs at every fine step, shape ((N−1)·count + 1, 6); the twin starts at rest
    at the first sample.
    """
    inputs = reference[:-1] - reference[0]
    marched = _kernels.twin_march(*matrices.arrays, inputs, count, matrices.rest())
    # Linear and at rest at first: marched from zero, and only the angles know where
    # zero is.
    result = np.vstack([np.zeros(marched.shape[1]), marched])
    result[:, 0] += reference[0]
    result[:, 2] += reference[0]
    return result


def _header(
    beam: Beam,
    damping: Damping,
    sensors: Sensors,
    frequencies: Vector,
    period: float,
    fine: float,
    motor_loop_pole: float,
    seed: int,
    title: str,
) -> dict[str, str]:
    counts = sensors.counts_per_revolution
    return {
        **({"title": title} if title else {}),
        "simulated": "true",
        "source": "digital twin of fraclink, tools/make_logs.py"
        if title
        else "digital twin of fraclink",
        "columns": "time_s [s], motor_angle_rad [rad], torque_Nm [N m]",
        "period_s": f"{period:g}",
        "payload_kg": f"{beam.payload:.3f}",
        "link_mass_kg": f"{beam.link_mass:g}",
        "length_m": f"{beam.length:g}",
        "flexural_rigidity_Nm2": f"{beam.flexural_rigidity:.6g}",
        "stiffness_Nm": f"{beam.stiffness:.6g}",
        "damping": damping.label,
        "modes_rad_per_s": " ".join(f"{w:.6g}" for w in frequencies),
        "step_s": f"{fine:g}",
        "hub": f"servo with double pole at {motor_loop_pole:g} rad/s",
        "encoder_counts": str(counts) if counts else "none",
        "gauge_noise_Nm": f"{sensors.gauge_noise:g}",
        "gauge_offset_Nm": f"{sensors.gauge_offset:g}",
        "gauge_drift_Nm_per_s": f"{sensors.gauge_drift:g}",
        "gauge_quantum_Nm": f"{sensors.gauge_quantum:g}",
        "gauge_delay_s": f"{sensors.gauge_delay:g}",
        **(
            {"gauge_gain": f"{sensors.gauge_gain:g}"}
            if sensors.gauge_gain != 1.0
            else {}
        ),
        "seed": str(seed),
    }
