"""Logs of the twin: the same CSV file a real rig writes, marked as simulated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.beam import Beam
from fraclink._simulate.twin.damping import Damping
from fraclink._simulate.twin.plant import LONGEST_STEP, StepMatrices, assemble
from fraclink._simulate.twin.sensors import Sensors
from fraclink._validate import checked_between, checked_choice, checked_noun, checked_series, checked_whole
from fraclink.errors import FieldError, SizeError

__all__ = ["TwinLog", "simulate_log", "substeps"]

Vector = NDArray[np.float64]

MOST_SAMPLES = 2_000_000


@dataclass(frozen=True)
class TwinLog:
    """A recorded move of the twin.

    time [s], motor_angle [rad] and torque [N·m] are what the sensors gave; true_motor_angle, tip_angle [rad]
    and true_torque [N·m] what was there. `header` holds the lines of the file's head.
    """

    time: Vector
    motor_angle: Vector
    torque: Vector
    true_motor_angle: Vector
    tip_angle: Vector
    true_torque: Vector
    header: Mapping[str, str]

    def text(self) -> str:
        """Return the file's text: ``# key: value`` lines, names with units, one row per sample."""
        lines = [f"# {key}: {value}" for key, value in self.header.items()]
        lines.append("time_s,motor_angle_rad,torque_Nm")
        # Nine digits: a thousandth of the finest quantum, and short files.
        lines += [
            f"{t:.9g},{a:.9g},{g:.9g}"
            for t, a, g in zip(
                self.time.tolist(), self.motor_angle.tolist(), self.torque.tolist(), strict=True
            )
        ]
        return "\n".join(lines) + "\n"

    def save(self, path: Path | str) -> None:
        """Write the log as CSV, complete or not at all."""
        from fraclink._files import write_text

        write_text(path, self.text())


def substeps(period: float, step: float) -> int:
    """Return how many steps of at most `step` fill one period."""
    checked_between("period", period, 0.0, 10.0, "s", open_low=True, remedy="give the sampling period")
    checked_between("step", step, 1e-6, LONGEST_STEP, "s", remedy="1 ms is exact for three modes")
    return max(1, math.ceil(period / step - 1e-9))


def _samples(reference: ArrayLike) -> Vector:
    values = checked_series("reference", reference)
    if values.size > MOST_SAMPLES:
        raise SizeError(
            "reference",
            values.size,
            "too long",
            allowed=f"{MOST_SAMPLES} samples",
            remedy="simulate a shorter log",
        )
    if values.size < 2 or not np.all(np.isfinite(values)):
        raise FieldError(
            "reference",
            f"array of shape {values.shape}",
            "not a finite sequence of samples",
            allowed="one angle [rad] per period, at least 2",
            remedy="sample the reference at the period",
        )
    return values


def simulate_log(
    beam: Beam,
    damping: Damping,
    reference: ArrayLike,
    *,
    period: float = 0.004,
    drive: Literal["servo", "prescribed"] = "servo",
    sensors: Sensors | None = None,
    modes: int | None = None,
    step: float = LONGEST_STEP,
    servo_pole: float = 80.0,
    seed: int = 0,
    title: str = "",
) -> TwinLog:
    """Simulate a recorded move: the hub follows a reference, the link swings, the sensors look.

    Parameters
    ----------
    reference
        hub reference, one value per period [rad], shape (N,). With ``drive="servo"`` it is held over
        the period and the hub follows through M(s) = 1/(1 + s/p)², equation (21); with ``"prescribed"`` the
        hub passes through the samples on straight lines.
    sensors
        imperfections; default none
    modes
        modes of the link; default as many of the first three as `step` resolves
    step
        longest exact step [s], at most 1 ms
    seed
        of the gauge's noise

    >>> import numpy as np
    >>> from fraclink._simulate.twin import PowerLaw
    >>> rod = Beam(0.65, 0.338, 0.00735, 0.030)
    >>> log = simulate_log(rod, PowerLaw(1.92), np.full(251, 0.1))
    >>> round(float(log.motor_angle[-1]), 6), bool(abs(log.tip_angle[-1] - 0.1) < 0.05)
    (0.1, True)
    """
    checked_noun("beam", beam, Beam, remedy="Beam(...), or Twin.from_rig(rig).beam")
    values = _samples(reference)
    if sensors is None:
        sensors = Sensors()
    checked_noun("sensors", sensors, Sensors, remedy="Sensors(...) makes them")
    checked_choice("drive", drive, ("servo", "prescribed"), remedy="a motor needs run_twin")
    checked_whole("seed", seed, 0, 2**64 - 1)
    count = substeps(period, step)
    fine = period / count
    lag = round(sensors.gauge_delay / fine)
    if abs(lag * fine - sensors.gauge_delay) > 1e-9:
        raise FieldError(
            "gauge_delay",
            sensors.gauge_delay,
            "between two steps",
            allowed=f"multiples of {fine:g} s",
            remedy="choose a step that divides the delay",
        )
    plant = assemble(beam, damping, drive=drive, modes=modes, step=fine, servo_pole=servo_pole)
    outputs = _march(plant.discretise(fine), values, count, drive == "prescribed", fine)
    angle, tip, torque = outputs[:, 0], outputs[:, 2], outputs[:, 3]
    delayed = np.concatenate([np.full(lag, torque[0]), torque])[: torque.size][::count]
    generator = np.random.default_rng(seed)
    hub = angle[::count].copy()
    time = np.round(period * np.arange(values.size), 9)
    return TwinLog(
        time=time,
        motor_angle=sensors.encoder(hub),
        torque=sensors.gauge(delayed, period=period, generator=generator),
        true_motor_angle=hub,
        tip_angle=tip[::count].copy(),
        true_torque=torque[::count].copy(),
        header=_header(
            beam, damping, sensors, plant.modes.frequencies, period, fine, drive, servo_pole, seed, title
        ),
    )


def _march(matrices: StepMatrices, reference: Vector, count: int, prescribed: bool, fine: float) -> Vector:
    """Outputs at every fine step, shape ((N−1)·count + 1, 6); the twin starts at rest at the first sample."""
    from fraclink._kernels import twin_march

    inputs = np.diff(reference) / (fine * count) if prescribed else reference[:-1] - reference[0]
    marched = twin_march(*matrices.arrays, inputs, count, matrices.rest())
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
    drive: str,
    servo_pole: float,
    seed: int,
    title: str,
) -> dict[str, str]:
    counts = sensors.counts_per_revolution
    return {
        **({"title": title} if title else {}),
        "simulated": "true",
        "source": "digital twin of fraclink, tools/make_logs.py" if title else "digital twin of fraclink",
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
        "hub": f"servo with double pole at {servo_pole:g} rad/s" if drive == "servo" else "prescribed",
        "encoder_counts": str(counts) if counts else "none",
        "gauge_noise_Nm": f"{sensors.gauge_noise:g}",
        "gauge_offset_Nm": f"{sensors.gauge_offset:g}",
        "gauge_drift_Nm_per_s": f"{sensors.gauge_drift:g}",
        "gauge_quantum_Nm": f"{sensors.gauge_quantum:g}",
        "gauge_delay_s": f"{sensors.gauge_delay:g}",
        "seed": str(seed),
    }
